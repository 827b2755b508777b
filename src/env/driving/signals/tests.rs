//! Tests of stop lines, of agents that pass red signals, and of the start of programs.

use super::*;
use crate::env::driving::task::Task;
use crate::env::driving::tests::scenario;

#[test]
fn cycles_have_a_common_multiple() {
    assert_eq!(common(1, 40_000), 40_000);
    assert_eq!(common(40_000, 60_000), 120_000);
    assert_eq!(common(40_001, 59_999), LONGEST);
}

fn task() -> Task {
    Task::new(&scenario("signals"), 8).expect("a task")
}

fn route(task: &Task, name: &str) -> usize {
    (0..task.map.routes.len()).find(|&route| task.map.route_id(route) == name).expect("a route")
}

/// Returns the traffic lights of a world in this state, with 2.5 s left in the phase.
fn signals(task: &Task, state: &str, phase: i32) -> Signals {
    let mut signals = Signals::new(&task.map.traffic_lights);
    signals.states[0] = TrafficLightState { state: state.to_owned(), phase, next_switch: 0.0 };
    signals.remaining[0] = 2500;
    signals
}

#[test]
fn each_route_has_a_stop_line_where_its_first_lane_ends() {
    let task = task();
    let lights = &task.map.traffic_lights;
    assert_eq!(lights.lights.len(), 1);
    for (lines, route) in lights.lines.iter().zip(&task.map.routes) {
        let end = route.path.lane_stretches().next().map(|(_, _, end)| end);
        assert_eq!(lines.iter().map(|line| line.at).collect::<Vec<_>>(), Vec::from_iter(end));
    }
    let signal = |name: &str| lights.lines[route(&task, name)][0].signal;
    assert_eq!((signal("north_right"), signal("west_left")), (0, 11), "as the net's linkIndex");
}

#[test]
fn an_agent_that_passes_red_counts_once() {
    let task = task();
    let lights = &task.map.traffic_lights;
    let west = route(&task, "west_straight");
    let line = lights.lines[west][0].at;
    let at = |front: f64, slot: &mut Slot| slot.s = front - slot.size[0] / 2.0;
    let mut slot =
        Slot { status: Status::Active, route: west, size: [4.5, 1.8], ..Slot::default() };
    at(line - 1.0, &mut slot);
    Signals::enter(lights, &mut slot);
    let pass = |state: &str, front: f64, slot: &mut Slot| {
        at(front, slot);
        signals(&task, state, 0).judge(lights, std::slice::from_mut(slot));
        (slot.ran_red, slot.red_lights)
    };
    let (red, green) = ("GGgrrrGGgrrr", "rrrGGgrrrGGg");
    assert_eq!(pass(red, line - 0.1, &mut slot), (false, 0));
    assert_eq!(pass(red, line + 0.1, &mut slot), (true, 1));
    assert_eq!(pass(red, line + 0.4, &mut slot), (false, 1), "once");
    // Back over the line and across it again.
    assert_eq!(pass(red, line - 0.4, &mut slot), (false, 1));
    assert_eq!(pass(red, line + 0.4, &mut slot), (false, 1), "not again");

    let mut over = Slot { lines_passed: 0, ran_red: false, red_lights: 0, ..slot.clone() };
    assert_eq!(pass(green, line + 0.1, &mut over), (false, 0));
    assert_eq!(pass(red, line + 0.4, &mut over), (false, 0), "red when it was over the line");
    let mut begun = Slot { lines_passed: 0, ..slot.clone() };
    (begun.ran_red, begun.red_lights) = (false, 0);
    at(line + 3.0, &mut begun);
    Signals::enter(lights, &mut begun);
    assert_eq!(pass(red, line + 4.0, &mut begun), (false, 0), "it began beyond the line");
}

/// SUMO's `s` lets vehicles pass that have stopped before it.
#[test]
fn a_stop_before_the_line_makes_a_stop_signal_green() {
    let task = task();
    let lights = &task.map.traffic_lights;
    let west = route(&task, "west_right");
    let line = &lights.lines[west][0];
    let state = ["r"; 12].concat();
    let now = |letter: &str| {
        let mut state = state.clone();
        state.replace_range(line.signal..=line.signal, letter);
        signals(&task, &state, 0)
    };
    let drive = |slot: &mut Slot, signals: &Signals, front: f64, speed: f64| {
        (slot.s, slot.speed) = (front - slot.size[0] / 2.0, speed);
        signals.judge(lights, std::slice::from_mut(slot));
        signals.look(lights, 1, std::slice::from_mut(slot));
        (slot.ran_red, slot.next_signal.map(|next| next.aspect))
    };
    let begin =
        || Slot { status: Status::Active, route: west, size: [4.5, 1.8], ..Slot::default() };
    let (stop, red) = (now("s"), now("r"));
    let (at, seen) = (line.at, Some(Aspect::Stop));
    let mut rolling = begin();
    assert_eq!(drive(&mut rolling, &stop, at - 1.0, 1.0), (false, seen));
    assert_eq!(drive(&mut rolling, &stop, at + 0.1, 1.0), (true, None));
    let mut far = begin();
    assert_eq!(drive(&mut far, &stop, at - 8.0, 0.0), (false, seen), "in a queue");
    assert_eq!(drive(&mut far, &stop, at + 0.1, 5.0), (true, None));
    let mut stopped = begin();
    assert_eq!(drive(&mut stopped, &red, at - 1.0, 0.0), (false, Some(Aspect::Red)));
    assert_eq!(drive(&mut stopped, &stop, at - 0.5, 1.0), (false, Some(Aspect::Green)));
    assert_eq!(drive(&mut stopped, &stop, at + 0.1, 1.0), (false, None));
    let mut waited = begin();
    assert_eq!(drive(&mut waited, &red, at - 1.0, 0.0), (false, Some(Aspect::Red)));
    assert_eq!(drive(&mut waited, &red, at + 0.1, 1.0), (true, None), "red is red");
}

#[test]
fn the_next_signal_is_that_of_the_route_and_its_lane() {
    let task = task();
    let lights = &task.map.traffic_lights;
    let mut slots = vec![Slot::default(); 2];
    for (slot, name) in slots.iter_mut().zip(["west_left", "north_left"]) {
        *slot =
            Slot { status: Status::Active, route: route(&task, name), s: 20.0, ..Slot::default() };
    }
    let now = signals(&task, "GGgrrrGGgrrr", 0);
    now.look(lights, 1, &mut slots);
    let [west, north] = [0, 1].map(|i| slots[i].next_signal.expect("a signal"));
    assert_eq!((west.aspect, north.aspect), (Aspect::Red, Aspect::Green));
    assert_eq!(west.distance, lights.lines[slots[0].route][0].at - 20.0);
    // Yellow of the others and the time in which all are red pass before it is green.
    assert_eq!((west.to_change, north.to_change), (Some(2.5 + 3.0 + 2.0), Some(2.5)));
    slots[0].lines_passed = 1;
    slots[1].status = Status::Wreck;
    now.look(lights, 1, &mut slots);
    assert!(slots.iter().all(|slot| slot.next_signal.is_none()));
}

#[test]
fn programs_begin_at_a_time_that_follows_from_the_seed() {
    let task = task();
    let begin = |seed: u64| {
        let mut commands = Vec::new();
        Signals::begin(&task.map.traffic_lights, 0.1, 3, Seed::new(seed), &mut commands);
        commands
    };
    assert_eq!(begin(1), begin(1));
    let starts: Vec<Command> = (0..40).flat_map(begin).collect();
    for command in &starts {
        let Command::StartPhase { world: 3, traffic_light: 0, phase, remaining } = *command else {
            panic!("{command:?}");
        };
        let all = task.map.traffic_lights.lights[0].phases[phase as usize].duration;
        assert!(remaining > 0.0 && remaining <= all as f64 / 1000.0);
    }
    let in_phase = |k: u32| {
        starts.iter().any(|c| matches!(c, Command::StartPhase { phase, .. } if *phase == k))
    };
    assert!((0..6).all(in_phase), "{starts:?}");
}
