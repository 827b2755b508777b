//! Vehicles that steer, and that SUMO has on no lane.

use rand::RngExt;

use super::*;
use crate::env::driving::map::RoutePosition;

const VEHICLES: usize = 5;

/// A fake simulator that knows which vehicles there are, and which of them may be on no lane.
#[derive(Default)]
struct Listed {
    there: [bool; VEHICLES],
    placed: [bool; VEHICLES],
    on_no_lane: u32,
}

impl Listed {
    /// Carries out commands. Afterwards, a vehicle that was told to be on any lane or on none is on
    /// none if `on_none` says so.
    fn step(&mut self, commands: &[Command], mut on_none: impl FnMut() -> bool) -> Snapshot {
        let anywhere = RoutePosition::Beside.keep_route();
        for command in commands {
            match *command {
                Command::Add { slot, .. } => {
                    assert!(!self.there[slot as usize], "slot {slot} already holds a vehicle");
                    (self.there[slot as usize], self.placed[slot as usize]) = (true, false);
                }
                Command::Remove { slot, .. } => {
                    assert!(self.there[slot as usize], "slot {slot} is empty");
                    self.there[slot as usize] = false;
                }
                Command::MoveTo { slot, keep_route, .. } => {
                    assert!(self.there[slot as usize], "slot {slot} is moved without a vehicle");
                    self.placed[slot as usize] |= keep_route == anywhere;
                }
                Command::SetSpeed { slot, .. } | Command::SpeedMode { slot, .. } => {
                    assert!(self.there[slot as usize], "slot {slot} is told without a vehicle");
                }
                ref other => panic!("{other:?}"),
            }
        }
        let vehicles = (0..VEHICLES).map(|slot| {
            let on_none = self.there[slot] && self.placed[slot] && on_none();
            self.on_no_lane += u32::from(on_none);
            let state = VehicleState { distance: 0.0, speed: 0.0 };
            (self.there[slot] && !on_none).then_some(state)
        });
        Snapshot { vehicles: vehicles.collect(), ..Snapshot::default() }
    }
}

/// Where SUMO has a vehicle on no lane depends on SUMO's version, and makes no difference to the
/// agents.
#[test]
fn a_vehicle_on_no_lane_of_sumo_drives_on() {
    for name in ["parking_lot", "intersection_turns_small"] {
        let task = Arc::new(Task::new(&scenario(name), VEHICLES as u32).expect("a task"));
        let mut worlds =
            [0, 1].map(|_| World::new(Arc::clone(&task), Driver::Agents, Seed::new(4), 0, 1, 20));
        let mut listed = [Listed::default(), Listed::default()];
        let (mut noise, mut chance) = (Seed::new(9).rng(), Seed::new(2).rng());
        let (mut commands, mut ended) = (Vec::new(), 0);
        for world in &mut worlds {
            world.reset(0);
        }
        while !worlds[0].is_idle() {
            // Pursuit forwards, backwards and forwards again, not quite along the route.
            let (step, episode) = (worlds[0].step_count(), worlds[0].episode());
            let speed = if (step / 25 + episode as u32) % 3 == 1 { -4.0 } else { 6.0 };
            let mut actions = Vec::new();
            for slot in 0..VEHICLES {
                let [steer, throttle] = worlds[0].pursuit(slot, speed);
                actions.extend([(steer + noise.random_range(-0.3..0.3)) as f32, throttle as f32]);
            }
            for (k, world) in worlds.iter_mut().enumerate() {
                commands.clear();
                world.act(0, &actions, &mut commands);
                let on_none = || k == 1 && chance.random_bool(0.2);
                let snapshot = listed[k].step(&commands, on_none);
                world.observe(0, &snapshot).expect("nothing vanishes");
            }
            let at = format!("{name}, episode {episode}, step {step}");
            assert!(worlds[0].frame() == worlds[1].frame(), "{at}");
            assert_eq!(worlds[0].is_idle(), worlds[1].is_idle(), "{at}");
            ended += worlds[0].frame().terminated.iter().filter(|&&end| end > 0.0).count();
        }
        let counts = listed.each_ref().map(|listed| listed.on_no_lane);
        assert!(counts[0] == 0 && counts[1] > 100, "{name}: {counts:?}");
        assert!(ended > 10, "{name}: {ended} trajectories ended");
    }
}

/// A vehicle that has left its route is placed in every step, also while it stands: SUMO removes
/// vehicles that stand at the end of a lane as arrived.
#[test]
fn a_vehicle_that_stands_beside_its_route_is_placed_in_every_step() {
    let task = Arc::new(Task::new(&scenario("parking_lot"), 1).expect("a task"));
    let mut world = World::new(Arc::clone(&task), Driver::Agents, Seed::new(4), 0, 1, 20);
    let state = VehicleState { distance: 0.0, speed: 0.0 };
    let snapshot = Snapshot { vehicles: vec![Some(state)], ..Snapshot::default() };
    let (mut commands, mut left, mut stood) = (Vec::new(), false, 0);
    world.reset(0);
    let mut before = None;
    for _ in 0..900 {
        let actions = if left { [0.0, 0.0] } else { [0.1, 0.3] };
        commands.clear();
        world.act(0, &actions, &mut commands);
        let placed = commands.iter().any(|command| matches!(command, Command::MoveTo { .. }));
        assert!(placed || !left, "{commands:?}");
        left |= placed;
        world.observe(0, &snapshot).expect("nothing vanishes");
        assert!(world.is_running(), "the vehicle stays on the road");
        let pose = world.agents().next().map(|agent| agent.pose);
        stood += u32::from(left && pose == before);
        before = pose;
    }
    assert!(left && stood > 10, "{left}, {stood} steps");
}
