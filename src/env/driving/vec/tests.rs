//! Tests of failures against a scripted simulator.

use std::collections::VecDeque;

use super::*;
use crate::env::driving::tests::scenario;
use crate::sumo::{Meter, Snapshot, VehicleState};

/// What the scripted simulator does in one exchange.
#[derive(Clone, Copy)]
enum Answer {
    Good,
    /// The vehicle of this world and slot is not on the road.
    Lost(usize, usize),
    Refusal,
    Defect,
}

/// Two worlds whose vehicles stay where they departed.
struct Scripted {
    script: VecDeque<Answer>,
    snapshot: Snapshot,
    places: Vec<Option<VehicleState>>,
}

impl Simulation for Scripted {
    fn worlds(&self) -> u32 {
        2
    }

    fn slots(&self) -> u32 {
        8
    }

    fn send(&mut self, commands: &[Command]) -> Result<(), sumo::Error> {
        for command in commands {
            match *command {
                Command::Add { world, slot, depart_pos, .. } => {
                    let state = VehicleState { distance: depart_pos, speed: 0.0 };
                    let place = self.places[(world * 8 + slot) as usize].replace(state);
                    assert!(place.is_none(), "slot {slot} of world {world} holds a vehicle");
                }
                Command::Remove { world, slot } => {
                    self.places[(world * 8 + slot) as usize] = None;
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn receive(&mut self) -> Result<&Snapshot, sumo::Error> {
        self.snapshot.vehicles.clone_from(&self.places);
        match self.script.pop_front().unwrap_or(Answer::Good) {
            Answer::Good => {}
            Answer::Lost(world, slot) => self.snapshot.vehicles[world * 8 + slot] = None,
            Answer::Refusal => {
                let [call, id, message] = ["vehicle.add", "w0s0", "no room"].map(str::to_owned);
                return Err(sumo::Error::Refused { command: 0xc4, call, id, message });
            }
            Answer::Defect => panic!("a defect"),
        }
        Ok(&self.snapshot)
    }

    fn renew(&mut self) -> Result<Renewal, sumo::Error> {
        self.places.fill(None);
        Ok(Renewal::Loaded)
    }

    fn reseed(&mut self, _: u64) {}

    fn meter(&self) -> Meter {
        Meter::default()
    }
}

fn scripted(script: &[Answer]) -> VecEnv {
    let task = Arc::new(Task::new(&scenario("intersection"), 8).unwrap());
    let worlds = (0..2).map(|e| {
        let mut world = World::new(Arc::clone(&task), Driver::Agents, Seed::new(0), e, 2, u64::MAX);
        world.reset(e);
        world
    });
    let host = Host {
        simulation: Box::new(Scripted {
            script: script.iter().copied().collect(),
            snapshot: Snapshot::default(),
            places: vec![None; 16],
        }),
        forgetful: false,
        seeded: false,
        lost: 0,
        first: 0,
        worlds: worlds.collect(),
        commands: Vec::new(),
        failed: None,
        failures: 0,
        loads: 0,
        restarts: 0,
    };
    VecEnv { task, hosts: vec![host], worlds: 2, rule: None }
}

fn episodes(env: &VecEnv) -> Vec<u64> {
    env.worlds().map(World::episode).collect()
}

#[test]
fn a_panic_in_a_worker_is_an_error_of_the_step() {
    match scripted(&[Answer::Defect]).step(&[0.0; 16]) {
        Err(Error::Panicked { message }) => assert_eq!(message, "a defect"),
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_lost_vehicle_costs_its_own_worlds_episode_only() {
    let mut env = scripted(&[Answer::Good, Answer::Good, Answer::Lost(1, 3)]);
    for _ in 0..3 {
        env.step(&[0.0; 16]).unwrap();
    }
    let finished = env.take_finished();
    assert_eq!(
        finished.iter().map(|r| (r.episode, r.interrupted)).collect::<Vec<_>>(),
        [(1, true)]
    );
    env.step(&[0.0; 16]).unwrap();
    assert_eq!((episodes(&env), env.resets().loads), (vec![0, 3], 0));
    assert_eq!(env.worlds().map(World::step_count).collect::<Vec<_>>(), [3, 0]);
}

#[test]
fn a_refusal_is_answered_by_loading_again() {
    let mut env = scripted(&[Answer::Good, Answer::Good, Answer::Refusal]);
    for _ in 0..4 {
        env.step(&[0.0; 16]).unwrap();
    }
    assert!(env.take_finished().iter().all(|record| record.interrupted));
    assert_eq!((episodes(&env), env.resets().loads, env.resets().restarts), (vec![2, 3], 1, 0));
}

#[test]
fn a_second_failure_within_an_episode_ends_the_run() {
    for failure in [Answer::Lost(0, 0), Answer::Refusal] {
        let mut env = scripted(&[Answer::Good, failure, failure]);
        env.step(&[0.0; 16]).unwrap();
        env.step(&[0.0; 16]).unwrap();
        let error = env.step(&[0.0; 16]).unwrap_err();
        assert!(matches!(error, Error::Vanished { slot: 0, .. } | Error::Sumo { .. }), "{error}");
    }
}
