//! Tests of signals against the real SUMO: what agents observe of them, what passing red costs, and
//! that neither depends on where worlds run.

use std::path::Path;
use std::sync::Arc;

use iwol_sumo::env::{Driver, Task, VecEnv, VecOptions};
use iwol_sumo::scenario::Scenario;
use iwol_sumo::sumo::{Backend, Hosting};

use crate::support::{agents_drive, folder, root, task, turn};

fn hosting(backend: Backend, processes: usize) -> Hosting {
    Hosting { backend, processes, ..Hosting::default() }
}

/// Returns the shipped scenario with other texts in the scenario file and in its net.
fn changed(folder: &Path, scenario: &[(&str, &str)], net: &[(&str, &str)]) -> Arc<Task> {
    let replace = |mut text: String, changes: &[(&str, &str)]| {
        for (from, to) in changes {
            assert!(text.contains(from), "{from}");
            text = text.replace(from, to);
        }
        text
    };
    let read = |name: &str| std::fs::read_to_string(root().join(name)).unwrap();
    std::fs::write(
        folder.join("a.net.xml"),
        replace(read("sumo_nets/signals/signals.net.xml"), net),
    )
    .unwrap();
    let there = ("../sumo_nets/signals/signals.net.xml", "a.net.xml");
    let changes: Vec<_> = scenario.iter().copied().chain([there]).collect();
    let file = folder.join("a.xml");
    std::fs::write(&file, replace(read("scenarios/signals.xml"), &changes)).unwrap();
    Arc::new(Task::new(&Scenario::load(&file).expect("a scenario"), 8).expect("a task"))
}

/// Returns the value of a feature of the next signal for each agent of each world.
fn feature(env: &VecEnv, name: &str) -> Vec<f32> {
    let features = &env.spec().observation;
    let at = features.list.iter().position(|f| f.name == format!("signal.{name}")).expect("known");
    let row = |observation: &[f32]| {
        observation.chunks_exact(features.len()).map(|row| row[at]).collect::<Vec<_>>()
    };
    env.worlds().flat_map(|world| row(&world.frame().observation)).collect()
}

#[test]
fn a_signal_changes_when_agents_observe_that_it_will() {
    let task = task("signals", 8);
    let mut seen = Vec::new();
    let mut all = vec![hosting(Backend::Traci, 1), hosting(Backend::Traci, 3)];
    if cfg!(feature = "libsumo") {
        all.push(hosting(Backend::Libsumo, 1));
    }
    for hosting in all {
        let _turn = turn(hosting.backend);
        let mut env = VecEnv::new(&task, &agents_drive(3, 4, hosting)).expect("SUMO runs");
        // Nobody moves, so that all agents stay before their signals.
        let actions = vec![-1.0; 3 * 8];
        let says = |env: &VecEnv| ["red", "yellow", "green"].map(|name| feature(env, name));
        let mut history = Vec::new();
        for _ in 0..500 {
            history.push((says(&env), feature(&env, "to_change_near"), feature(&env, "present")));
            env.step(&actions).expect("a step");
        }
        for agent in 0..3 * 8 {
            let at = |step: usize| history[step].0.each_ref().map(|column| column[agent]);
            for (step, (_, to_change, present)) in history.iter().enumerate() {
                assert_eq!(present[agent], 1.0);
                // The scale is 10 s, and steps take 0.1 s; longer times are cut off.
                let steps = (100.0 * to_change[agent]).round() as usize;
                for ahead in 1..=steps.min(history.len() - 1 - step) {
                    assert_eq!(at(step + ahead), at(step), "agent {agent}, step {step} + {ahead}");
                }
                if steps < 100 && step + steps + 1 < history.len() {
                    assert_ne!(at(step + steps + 1), at(step), "agent {agent}, step {step}");
                }
            }
        }
        seen.push(history);
    }
    assert!(seen.windows(2).all(|pair| pair[0] == pair[1]), "it does not depend on the hosting");
    let [red, _, green] = &seen[0][0].0;
    assert!(red.contains(&1.0) && green.contains(&1.0), "the worlds begin at different times");
}

#[test]
fn passing_red_is_punished_once_and_counted() {
    let folder = folder();
    // Only passing red has a reward, and vehicles that crash are gone at once.
    let weights = [(
        "progress=\"1\" speed=\"0.1\" arrive=\"10\" outOfRoad=\"-10\" crash=\"-10\" redLight=\"-100\"",
        "progress=\"0\" speed=\"0\" arrive=\"0\" outOfRoad=\"0\" crash=\"0\" redLight=\"-3\"",
    )];
    let task = changed(folder.path(), &weights, &[]);
    for (driver, throttle) in [(Driver::Agents, 1.0), (Driver::Sumo, 0.0)] {
        let options = VecOptions { driver, ..agents_drive(2, 9, Hosting::default()) };
        let mut env = VecEnv::new(&task, &options).expect("SUMO runs");
        let mut punished = [0; 2 * 8];
        let mut records = Vec::new();
        let mut counts = Vec::new();
        while records.len() < 6 {
            env.step(&[throttle; 2 * 8]).expect("a step");
            for (e, world) in env.worlds().enumerate() {
                for (i, &reward) in world.frame().reward.iter().enumerate() {
                    assert!(reward == 0.0 || reward == -3.0, "{reward}");
                    punished[8 * e + i] += usize::from(reward < 0.0);
                }
                if world.has_ended() {
                    counts.extend(punished[8 * e..8 * (e + 1)].iter().copied());
                    punished[8 * e..8 * (e + 1)].fill(0);
                }
            }
            records.extend(env.take_finished());
        }
        // Each route has one signal.
        assert!(counts.iter().all(|&count| count <= 1), "{counts:?}");
        let counted: f64 =
            records.iter().map(|r| 8.0 * r.driving().red_lights.expect("signals")).sum();
        assert_eq!(counted, counts.iter().sum::<usize>() as f64);
        assert_eq!(counted > 0.0, driver == Driver::Agents, "SUMO's driver obeys signals");
    }
}

/// The state of an actuated program depends on the vehicles that have passed. It is the same with
/// the same actions, also after worlds were restored.
#[test]
fn actuated_programs_are_reproducible() {
    let folder = folder();
    let actuated = [
        ("type=\"static\"", "type=\"actuated\""),
        ("duration=\"15\"", "duration=\"15\" minDur=\"4\" maxDur=\"20\""),
    ];
    let task = changed(folder.path(), &[("horizon=\"1000\"", "horizon=\"150\"")], &actuated);
    let options = agents_drive(2, 3, Hosting::default());
    let act = |step: usize| vec![if step % 40 < 15 { 1.0 } else { 0.2 }; 2 * 8];
    let play = |env: &mut VecEnv, steps: std::ops::Range<usize>| {
        let mut all = Vec::new();
        for step in steps {
            env.step(&act(step)).expect("a step");
            for world in env.worlds() {
                let lights: Vec<String> = world.traffic_lights().map(String::from).collect();
                all.push((lights, world.frame().observation.clone()));
            }
        }
        all
    };
    let mut env = VecEnv::new(&task, &options).expect("SUMO runs");
    let before = play(&mut env, 0..230);
    let states = env.states();
    let after = play(&mut env, 230..400);
    assert!(feature(&env, "change_known").iter().all(|&known| known == 0.0));
    drop(env);
    let mut again = VecEnv::new(&task, &options).expect("SUMO runs");
    assert!(play(&mut again, 0..230) == before, "the same seed gives the same bits");
    drop(again);
    let mut restored = VecEnv::restore(&task, &options, &states).expect("SUMO runs");
    assert!(play(&mut restored, 230..400) == after, "also after a restoration");
    let lengths = before.iter().step_by(2).map(|(lights, _)| lights[0].as_str());
    let lengths: Vec<&str> = lengths.collect();
    let runs = lengths.chunk_by(|a, b| a == b).filter(|run| run[0].contains('G'));
    assert!(runs.clone().any(|run| run.len() < 150), "the traffic shortens or extends a phase");
}

/// SUMO's own driver stops where a signal lets vehicles turn right on red after a stop, and then
/// passes it; who does not stop passes red.
#[test]
fn right_turns_on_red_need_a_stop() {
    let folder = folder();
    // Right turns are links 0, 3, 6 and 9.
    let after_stop = [
        ("state=\"GGgrrrGGgrrr\"", "state=\"GGgsrrGGgsrr\""),
        ("state=\"rrrGGgrrrGGg\"", "state=\"srrGGgsrrGGg\""),
    ];
    let task = changed(folder.path(), &[], &after_stop);
    let links = [("north_right", 0), ("east_right", 3), ("south_right", 6), ("west_right", 9)];
    let count = |driver, throttle: f32| {
        let options = VecOptions { driver, ..agents_drive(2, 9, Hosting::default()) };
        let mut env = VecEnv::new(&task, &options).expect("SUMO runs");
        let (mut records, mut passed) = (Vec::new(), 0);
        while records.len() < 8 {
            let before = feature(&env, "present");
            env.step(&[throttle; 2 * 8]).expect("a step");
            let after = feature(&env, "present");
            for (e, world) in env.worlds().enumerate() {
                let state = world.traffic_lights().next().expect("a traffic light").as_bytes();
                for (i, agent) in world.agents().enumerate() {
                    let name = task.map.route_id(agent.route);
                    let link = links.iter().find(|link| link.0 == name).map(|link| link.1);
                    let over = agent.driving && before[8 * e + i] > after[8 * e + i];
                    passed += usize::from(over && link.is_some_and(|link| state[link] == b's'));
                }
            }
            records.extend(env.take_finished());
        }
        let red: f64 =
            records.iter().map(|record| record.driving().red_lights.expect("signals")).sum();
        (red, passed)
    };
    let (red, passed) = count(Driver::Sumo, 0.0);
    assert_eq!(red, 0.0, "SUMO's driver stops");
    assert!(passed > 0);
    assert!(count(Driver::Agents, 1.0).0 > 0.0);
}
