//! Tests of agents from route files in the fake simulator.

use super::agents::{Outcome, Slot, Status};
use super::departure::Departure;
use super::loitering::Loitering;
use super::*;

/// Returns `scenarios/flow_cross.xml` with this share of agents.
fn flow(agents: u32, penetration: f64, horizon: u32) -> Arc<Task> {
    let mut scenario = scenario("flow_cross");
    (scenario.traffic.penetration, scenario.termination.horizon) = (penetration, horizon);
    scenario.agents.min = 1;
    Arc::new(Task::new(&scenario, agents).expect("a task"))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Trajectories in a slot are separate: each begins with a start, ends with a termination (or
    /// with a truncation at the horizon), and the slot is empty for at least one frame before the
    /// next one. Nobody earns anything outside a trajectory, and the counts of the record are those
    /// of the frames.
    #[test]
    fn trajectories_in_a_slot_are_separate(
        agents in 1u32..9,
        penetration in 0.1f64..1.0,
        horizon in 30u32..500,
        seed in any::<u64>(),
        mean in -0.3f32..1.2,
    ) {
        let task = flow(agents, penetration, horizon);
        let n = agents as usize;
        let o = task.spec.observation.len();
        let (mut world, mut rails) = (world(&task, seed), Rails::new(&task));
        world.reset(0);
        let mut rng = Seed::new(seed).child("actions").rng();
        let mut actions = vec![0.0; n];
        let (mut departed, mut arrived, mut earned, mut episodes) = (0, 0, 0.0, 0);
        for _ in 0..800 {
            crate::rng::fill_normal(&mut rng, &mut actions);
            for action in &mut actions {
                *action += mean;
            }
            let before = world.frame().clone();
            exchange(&mut world, &mut rails, &actions);
            let first = world.step_count() == 0;
            let late = world.step_count() == horizon;
            let frame = world.frame();
            if first {
                (departed, arrived, earned) = (0, 0, 0.0);
                prop_assert!(frame.start.iter().all(|&start| start == 1.0));
            }
            for i in 0..n {
                let (active, was) = (frame.active[i] > 0.0, before.active[i] > 0.0 && !first);
                let [start, terminated, truncated] =
                    [&frame.start, &frame.terminated, &frame.truncated].map(|flags| flags[i] > 0.0);
                let present = frame.comm[i * n + i] > 0.0;
                prop_assert_eq!(present, active || truncated);
                prop_assert!(!(terminated && truncated));
                prop_assert!(!truncated || late, "only the horizon truncates");
                prop_assert_eq!(terminated, was && !present, "who is gone has arrived or failed");
                if !first {
                    prop_assert_eq!(start, present && !was, "a trajectory begins with a start");
                    prop_assert!(!start || before.comm[i * n + i] == 0.0, "there is a gap between two");
                    prop_assert!(was || frame.reward[i] == 0.0, "only who acted earns");
                }
                let seen = &frame.observation[i * o..(i + 1) * o];
                prop_assert!(present || seen.iter().all(|&x| x == 0.0));
                prop_assert!(seen.iter().all(|x| x.abs() <= 1.0));
                departed += u32::from(start && present);
                earned += f64::from(frame.reward[i]);
            }
            let views: Vec<AgentView> = world.agents().collect();
            arrived += (0..n).filter(|&i| frame.terminated[i] > 0.0 && views[i].outcome.arrived).count() as u32;
            if let Some(record) = world.take_finished() {
                episodes += 1;
                prop_assert_eq!(record.episode_length, horizon, "the flow does not end before");
                let flow = record.driving().flow.expect("agents come from a route file");
                prop_assert_eq!((flow.departed, flow.arrived), (departed, arrived));
                prop_assert!((record.reward * f64::from(departed) - earned).abs() < 1e-2 * earned.abs().max(1.0));
                prop_assert!(flow.waiting >= 0.0 && flow.on_road <= agents);
                prop_assert!(record.success <= 1.0 && record.driving().crash + record.driving().safety <= 1.0 + 1e-9);
            }
        }
        prop_assert!(episodes > 0);
    }

    /// Which vehicles are agents follows from the seed alone, and their share is the penetration.
    #[test]
    fn penetration_is_the_share_of_the_named_vehicles(seed in any::<u64>(), penetration in 0.1f64..0.9) {
        let task = flow(16, penetration, 1_000_000);
        let truck = task.demand.types.iter().position(|kind| kind.id == "truck").expect("a type");
        let planned = task.map.plan.departures.len() as u32;
        let departures = |task: &Arc<Task>, throttle: f32| {
            let (mut world, mut rails) = (world(task, seed), Rails::new(task));
            world.reset(1);
            let (mut departures, mut commands) = (Vec::new(), Vec::new());
            for _ in 0..3000 {
                commands.clear();
                world.act(0, &[throttle; 16], &mut commands);
                departures.extend(commands.iter().filter_map(|command| match command {
                    Command::Depart { departure, vehicle_type, .. } => Some((*departure, *vehicle_type)),
                    _ => None,
                }));
                let snapshot = rails.step(&commands);
                world.observe(0, &snapshot).expect("nothing vanishes on rails");
            }
            departures
        };
        let all = departures(&task, 0.4);
        prop_assert_eq!(&all, &departures(&task, 0.4));
        let (cars, trucks) = (task.agent_type(Driver::Agents, truck).0, task.demand_type(truck).0);
        prop_assert!(all.iter().all(|&(_, kind)| kind != cars), "no truck is an agent");
        let agents = all.iter().filter(|(departure, _)| *departure >= planned).count() as f64;
        let named = all.iter().filter(|(_, kind)| *kind != trucks).count() as f64;
        let deviation = (penetration * (1.0 - penetration) * named).sqrt();
        prop_assert!((agents - penetration * named).abs() < 5.0 * deviation + 1.0, "{agents} of {named}");
    }
}

/// An episode ends before the horizon once no agent is left and none can come.
#[test]
fn an_episode_ends_with_its_last_agent() {
    let mut task = Task::clone(&flow(4, 1.0, 5000));
    for source in &mut task.map.plan.sources {
        (source.number, source.begin) = (2, 3.0);
    }
    let task = Arc::new(task);
    let (mut world, mut rails) = (world(&task, 2), Rails::new(&task));
    world.reset(0);
    let mut longest_gap = 0;
    let mut gap = 0;
    let record = loop {
        exchange(&mut world, &mut rails, &[0.6; 4]);
        gap = if world.frame().active.contains(&1.0) { 0 } else { gap + 1 };
        longest_gap = longest_gap.max(gap);
        if let Some(record) = world.take_finished() {
            break record;
        }
    };
    let flow = record.driving().flow.expect("a flow");
    assert!(record.episode_length < 5000 && flow.departed <= 8 && flow.queued == 0);
    assert!(longest_gap >= 25, "nobody departs in the first three seconds");
}

/// Returns the lengths of episodes and the agents that departed, of demand with one vehicle per arm
/// in each episode of 200 steps.
fn sparse(types: &str, penetration: f64) -> Vec<(u32, u32)> {
    let mut scenario = scenario("flow_cross");
    (scenario.traffic.penetration, scenario.termination.horizon) = (penetration, 200);
    scenario.agents.types = vec![types.into()];
    let mut task = Task::new(&scenario, 4).expect("a task");
    for source in &mut task.map.plan.sources {
        source.number = 1;
        source.spacing = crate::scenario::Spacing::Equal(1.0);
    }
    let task = Arc::new(task);
    let (mut world, mut rails) = (world(&task, 5), Rails::new(&task));
    world.reset(0);
    let mut episodes = Vec::new();
    while episodes.len() < 12 {
        exchange(&mut world, &mut rails, &[1.0; 4]);
        if let Some(record) = world.take_finished() {
            episodes.push((record.episode_length, record.driving().flow.expect("a flow").departed));
        }
    }
    episodes
}

#[test]
fn of_sparse_demand_at_least_one_vehicle_is_an_agent() {
    let episodes = sparse("mix", 1e-9);
    assert!(episodes.iter().all(|&(length, agents)| length > 30 && agents == 1), "{episodes:?}");
}

/// Otherwise SUMO would load the net again in every step.
#[test]
fn an_episode_without_vehicles_that_may_be_agents_lasts_until_the_horizon() {
    // One vehicle in ten is a truck.
    let episodes = sparse("truck", 1.0);
    let without: Vec<u32> = episodes.iter().filter(|e| e.1 == 0).map(|e| e.0).collect();
    assert!(!without.is_empty() && without.iter().all(|&length| length == 200), "{episodes:?}");
    assert!(without.len() < episodes.len(), "{episodes:?}");
}

/// Vehicles for which no slot is free wait, and their waiting is counted.
#[test]
fn agents_wait_for_a_slot() {
    let play = |agents: u32| {
        let task = flow(agents, 1.0, 600);
        let (mut world, mut rails) = (world(&task, 3), Rails::new(&task));
        world.reset(0);
        let mut most = 0;
        loop {
            exchange(&mut world, &mut rails, &vec![0.2; agents as usize]);
            most = most.max(world.frame().active.iter().filter(|&&active| active > 0.0).count());
            if let Some(record) = world.take_finished() {
                break (most, record.driving().flow.expect("a flow"));
            }
        }
    };
    let ((few, crowded), (_, free)) = (play(1), play(16));
    assert_eq!(few, 1);
    assert!(crowded.queued > free.queued && crowded.waiting > free.waiting + 1.0);
    assert!(crowded.departed < free.departed && free.waiting < 3.0, "{free:?}");
}

/// An agent keeps the size of its type, and SUMO's drivers drive the types of the file.
#[test]
fn agents_have_the_size_of_their_type() {
    let mut scenario = scenario("flow_cross");
    (scenario.traffic.penetration, scenario.agents.types) = (1.0, vec!["truck".into()]);
    let task = Arc::new(Task::new(&scenario, 4).expect("a task"));
    let truck = task.demand.types.iter().position(|kind| kind.id == "truck").expect("a type");
    let kinds = task.simulation_config(0, 1, &crate::sumo::Hosting::default()).vehicle_types;
    let own = &kinds[task.agent_type(Driver::Agents, truck).0 as usize];
    assert_eq!((own.length, own.width, own.class.as_deref()), (7.1, 2.4, Some("truck")));
    assert_eq!(own.max_speed, scenario.vehicle.max_speed);
    assert_eq!(task.agent_type(Driver::Sumo, truck), task.demand_type(truck));
    let (mut world, mut rails) = (world(&task, 0), Rails::new(&task));
    world.reset(0);
    let mut seen = 0;
    for _ in 0..600 {
        exchange(&mut world, &mut rails, &[0.3; 4]);
        for slot in world.traffic().slots[..4].iter().filter(|slot| slot.status == Status::Active) {
            assert_eq!(slot.size, [7.1, 2.4]);
            // The centre of a vehicle that has just departed is half its length behind its front.
            assert!(slot.s >= DEPARTURE - 7.1 / 2.0 - 1e-6);
            seen += 1;
        }
    }
    assert!(seen > 0);
}

/// A route of a route file has the same conflicts as the same route of a scenario.
#[test]
fn routes_of_files_have_the_same_conflicts() {
    let file = flow(8, 0.5, 600);
    let placed = task(32, |_| {});
    assert_eq!(file.map.net_file().file_name(), placed.map.net_file().file_name());
    let conflicts = |task: &Task, id: &str| {
        let route = (0..task.map.routes.len())
            .find(|&route| task.map.route_id(route).split(' ').next() == Some(id))
            .expect("the route is there");
        let conflicts = &task.map.routes[route].conflicts;
        conflicts.iter().map(|c| (c.own, c.other)).collect::<Vec<_>>()
    };
    for id in ["eastbound", "westbound", "northbound", "southbound"] {
        let expected = conflicts(&placed, id);
        assert!(!expected.is_empty());
        assert_eq!(conflicts(&file, id), expected, "{id}");
    }
}

/// Flows take turns where slots are few: the vehicle that has waited longest departs first.
#[test]
fn no_flow_gets_every_slot() {
    let task = flow(1, 1.0, 1_000_000);
    let planned = task.map.plan.departures.len();
    let (mut world, mut rails) = (world(&task, 3), Rails::new(&task));
    world.reset(0);
    let (mut departures, mut commands) = (vec![0; 2 * planned], Vec::new());
    for _ in 0..3000 {
        commands.clear();
        world.act(0, &[0.4], &mut commands);
        for command in &commands {
            if let Command::Depart { departure, .. } = command {
                departures[*departure as usize] += 1;
            }
        }
        let snapshot = rails.step(&commands);
        world.observe(0, &snapshot).expect("nothing vanishes on rails");
    }
    let agents = &departures[planned..];
    let (least, most) = (agents.iter().min().copied(), agents.iter().max().copied());
    assert!(least >= most.map(|most| most / 3) && least > Some(0), "{departures:?}");
}

/// The vehicles of a flow that depart together are agents or not, each for itself, and every other
/// vehicle of the plan may be an agent: with a route that is drawn, with stops, of a file's later
/// hours. Vehicles that are left out are not.
#[test]
fn every_vehicle_of_the_plan_may_be_an_agent() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("cars.rou.xml");
    let text = r#"<routes>
        <vType id="car" length="4" width="1.8" scale="3"/>
        <vType id="bus" vClass="bus"/>
        <route id="a" edges="west_in east_out"/>
        <route id="b" edges="south_in north_out"/>
        <routeDistribution id="any" routes="a b"/>
        <flow id="gone" type="car" route="a" begin="0" end="50" period="1"/>
        <flow id="cars" type="car" route="any" begin="100" period="5"/>
        <trip id="lost" type="car" from="west_in" to="west_in" departSpeed="99" depart="101"/>
        <vehicle id="bus" type="bus" route="a" depart="102" departSpeed="25" personNumber="3" arrivalLane="0">
            <stop edge="west_in" endPos="20" duration="30"/>
        </vehicle>
    </routes>"#;
    std::fs::write(&file, text).expect("written");
    let flow = |penetration: f64, vehicles: &str| {
        let mut scenario = scenario("flow_cross");
        scenario.agents.types = Vec::new();
        scenario.agents.vehicles = vehicles.split(' ').map(Into::into).collect();
        (scenario.traffic.penetration, scenario.traffic.files) = (penetration, vec![file.clone()]);
        scenario.traffic.begin.0 = 100.0;
        (scenario.traffic.capacity, scenario.termination.horizon) = (1000, 400);
        Arc::new(Task::new(&scenario, 16).expect("a task"))
    };
    // Returns the departures of one episode: whether it is that of an agent, its source, its time.
    let departures = |task: &Arc<Task>, seed: u64| {
        let (mut world, mut rails) = (world(task, seed), Rails::new(task));
        world.reset(0);
        let planned = &task.map.plan.departures;
        let (mut departures, mut commands) = (Vec::new(), Vec::new());
        for step in 0..300 {
            commands.clear();
            world.act(0, &[0.6; 16], &mut commands);
            departures.extend(commands.iter().filter_map(|command| match command {
                Command::Depart { departure, .. } => {
                    let number = *departure as usize;
                    let source = planned[number % planned.len()].source;
                    Some((number >= planned.len(), task.demand.sources[source].id.clone(), step))
                }
                _ => None,
            }));
            let snapshot = rails.step(&commands);
            world.observe(0, &snapshot).expect("nothing vanishes on rails");
        }
        departures
    };
    let task = flow(1.0, "*");
    assert_eq!(task.map.plan.left_out.len(), 1, "{:?}", task.map.plan.left_out);
    let all = departures(&task, 1);
    assert!(all.iter().all(|(is_agent, ..)| *is_agent), "{all:?}");
    assert!(all.iter().all(|(_, id, _)| id == "cars" || id == "bus"), "{all:?}");
    let first = all.iter().filter(|(_, id, step)| id == "cars" && *step < 40).count();
    assert_eq!(first, 3, "three cars depart instead of one: {all:?}");

    let others = task.simulation_config(0, 1, &crate::sumo::Hosting::default()).others;
    let departures_of = others.expect("background traffic").departures;
    let bus = departures_of.iter().rev().find_map(|departure| match departure {
        crate::sumo::Departure::Drive { speed, persons, stops, arrival_lane, .. } => {
            (*persons == 3).then_some((speed.as_str(), stops.len(), arrival_lane.as_str()))
        }
        crate::sumo::Departure::Walk { .. } => None,
    });
    assert_eq!(bus, Some(("22.222", 0, "current")), "an agent drives as agents do");

    let bus = departures(&flow(1.0, "bus"), 1);
    assert!(bus.iter().all(|(is_agent, id, _)| *is_agent == (id == "bus")), "{bus:?}");
    let mut together = 0;
    for seed in 0..20 {
        let some = departures(&flow(0.5, "cars"), seed);
        let agents =
            some.iter().filter(|(is_agent, id, step)| *is_agent && id == "cars" && *step < 40);
        together += usize::from((1..3).contains(&agents.count()));
    }
    assert!(together > 5, "of three cars that depart together, some are agents: {together}");
}

/// Whether an agent counts does not depend on what becomes of it: agents crash sooner than they
/// arrive, so that to count all crashes would make them too frequent.
#[test]
fn agents_that_come_too_late_to_arrive_do_not_count() {
    let task = flow(4, 1.0, 600);
    let free = task.map.free_time[task.map.plan.departures[0].route];
    let interval = task.scenario.control.interval;
    let mut trips = super::trips::Trips::default();
    let mut end = |entered: f64, after: f64, crashed: bool| {
        let slot = Slot {
            entered: (entered / interval) as u32,
            route: task.map.plan.departures[0].route,
            departure: Some(Departure::default()),
            outcome: Outcome { arrived: !crashed, crashed, out_of_road: false },
            ..Slot::default()
        };
        trips.end(0, &slot, &Loitering::default(), ((entered + after) / interval) as u32);
    };
    // One vehicle a second; one in four crashes, after a third of the time of a route.
    let horizon = 600.0 * interval;
    for second in 0..horizon as u32 {
        let (entered, crashed) = (f64::from(second), second % 4 == 0);
        let after = if crashed { free / 3.0 } else { free * 1.5 };
        if entered + after < horizon {
            end(entered, after, crashed);
        }
    }
    let counts = trips.counts(&task, 600, &[], &[]);
    assert!(counts.count >= 12.0 && counts.count < counts.begun, "{}", counts.count);
    let share = counts.crashed / counts.count;
    assert!((share - 0.25).abs() < 0.05, "{share} of {}", counts.count);
    // The same agents count where the episode ends before the horizon, because no more come.
    let early = trips.counts(&task, 400, &[], &[]);
    assert_eq!((early.count, early.crashed), (counts.count, counts.crashed));
}

/// An episode whose agents all came too late to count says nothing about success.
#[test]
fn an_episode_without_an_agent_that_counts_is_undecided() {
    let record = |horizon: u32| {
        let task = flow(4, 1.0, horizon);
        let (mut world, mut rails) = (world(&task, 2), Rails::new(&task));
        world.reset(0);
        loop {
            exchange(&mut world, &mut rails, &[0.6; 4]);
            if let Some(record) = world.take_finished() {
                break record;
            }
        }
    };
    let (short, long) = (record(60), record(900));
    assert_eq!((short.success(), short.driving().undecided), (None, true));
    assert!(short.driving().flow.expect("a flow").departed > 0);
    assert!(long.success().is_some_and(|success| success > 0.0) && !long.driving().undecided);
}
