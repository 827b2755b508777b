//! Tests of the rule first come, first served.

use super::*;

/// With the rule first come, first served, all vehicles arrive, also in queues; without it, they
/// crash.
#[test]
fn under_first_come_first_served_all_vehicles_arrive() {
    for (agents, gives_way) in [(4, true), (8, true), (16, true), (48, true), (8, false)] {
        let task = task(agents, |s| s.termination.horizon = 5000);
        let (mut world, mut rails) = (ruled_world(&task, 7), Rails::new(&task));
        world.reset(0);
        let (mut actions, mut records) = (vec![0.0; agents as usize], Vec::new());
        while records.len() < 10 {
            world.pursue(Pursuit { speed: 6.0, gives_way }, &mut actions);
            exchange(&mut world, &mut rails, &actions);
            records.extend(world.take_finished());
        }
        let arrived = records.iter().filter(|record| record.success == 1.0).count();
        assert!(
            if gives_way { arrived == 10 } else { arrived < 5 },
            "{agents} agents, {gives_way}: {arrived} of 10"
        );
    }
}

/// Agents that observe priority can tell when the rule first come, first served waits, unless the
/// reason is beyond the observed distance.
#[test]
fn agents_observe_what_the_rule_goes_by() {
    let task = task(8, |s| s.observation.priority_distance = 50.0);
    let (mut world, mut rails) = (world(&task, 11), Rails::new(&task));
    world.reset(0);
    let named = |name: &str| {
        task.spec.observation.list.iter().position(|f| f.name.ends_with(name)).expect("a feature")
    };
    let [free, slow, blocked, entry] =
        ["free", "free_slow", "free_blocked", "to_entry_near"].map(named);
    let [gap, closing, leads] =
        ["leader.gap_far", "leader.relative_speed", "leader.present"].map(named);
    let (width, mut actions, mut observed) = (task.spec.observation.len(), [0.0; 8], [0; 2]);
    for _ in 0..600 {
        world.pursue(Pursuit { speed: 6.0, gives_way: true }, &mut actions);
        for (i, view) in world.agents().enumerate().filter(|(_, view)| view.driving) {
            let seen = &world.frame().observation[i * width..(i + 1) * width];
            let at = |k: usize| 15.0 * f64::from(seen[k]);
            let braking = view.speed * view.speed / 12.0;
            // Comparisons within the rounding of 32 bits are undecided; a value of 15 m stands for
            // any greater distance.
            let below = |x: f64, least: f64| x < least - 1e-4;
            let above = |x: f64, least: f64| x > least + 1e-4;
            let leader = view.speed + 10.0 * f64::from(seen[closing]);
            let behind = match seen[leads] {
                _ if leader <= 1e-4 => f64::INFINITY,
                0.0 => f64::INFINITY,
                _ => 50.0 * f64::from(seen[gap]) + leader * leader / 12.0,
            };
            let outside = seen[entry] >= 0.0 && below(at(entry), braking);
            let something = at(free).min(at(slow)) < 15.0;
            let waits = below(at(free).min(behind), braking + 4.0)
                || below(at(blocked), 4.0)
                || outside && something;
            let entered = seen[entry] < 0.0 || above(at(entry), braking);
            let drives =
                above(at(free).min(behind), braking + 4.0) && above(at(blocked), 4.0) && entered;
            assert!(!waits || actions[i] == -1.0, "{seen:?}");
            assert!(!drives || actions[i] > -1.0, "{seen:?}");
            observed[0] += usize::from(drives);
            observed[1] += usize::from(waits);
        }
        exchange(&mut world, &mut rails, &actions);
    }
    assert!(observed.iter().all(|&n| n > 100), "{observed:?}");
}
