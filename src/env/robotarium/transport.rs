//! Material transport: two fast robots that carry little and two slow ones that carry much bring
//! material from two zones to a third (MARBLER, `scenarios/MaterialTransport`, with the rewards and
//! the five actions of IWoL: DongsuLeeTech/IWoL, `Robotarium/onpolicy/envs/robotarium`).
//!
//! An empty robot in a loading zone loads as much as it can carry, and a loaded one in the
//! unloading zone unloads. The reward is the team's. The episode ends when everything has been
//! unloaded.
//!
//! Differences on purpose: a robot also observes which kind it is (MARBLER's option
//! `capability_aware`; IWoL: not), since one policy drives both kinds; an episode has 70 decisions
//! (references: 71); the first observation is that of the start (references: zeros).

use super::arena::{Robot, drive};
use super::{Grid, HALF, ROBOTS, SAFE, Zone, backdrop, begin, figure, finish, moves, target};
use crate::env::frame::Frame;
use crate::env::multi_agent::{MultiAgentEnv, Simple};
use crate::env::picture::Picture;
use crate::env::spec::{Better, EnvSpec, Features, OwnMetric};
use crate::rng::{self, Rng, Seed};

/// Decisions of an episode, and ticks of 0.033 s per decision.
const STEPS: u32 = 70;
const TICKS: u32 = 74;
/// Largest coordinates of the place that a robot wants to go to \[m\].
const LIMITS: [f64; 2] = [1.4, 0.9];
/// The second loading zone begins at this x, and the unloading zone ends at its negative \[m\].
const BORDER: f64 = 1.0;
/// Radius of the first loading zone, around the middle of the arena \[m\].
const RADIUS: f64 = 0.35;
/// Mean and standard deviation of the material in each loading zone.
const MATERIAL: [(f32, f32); 2] = [(100.0, 10.0), (20.0, 4.0)];
/// Reward per unit that is loaded in each zone, and that is unloaded.
const LOADING: [f32; 2] = [0.025, 0.05];
const UNLOADING: f32 = 0.075;
/// Reward of each decision, and of a violation.
const TIME: f32 = -0.1;
const VIOLATION: f32 = -10.0;

const STARTS: Grid = Grid { corner: [-1.4, -0.9], columns: 1, rows: 6, spacing: 0.3 };

/// What a kind of robot can do.
struct Kind {
    /// Length of a move \[m\].
    step: f64,
    /// Units that it can carry.
    capacity: u32,
}

const FAST: Kind = Kind { step: 0.45, capacity: 5 };
const SLOW: Kind = Kind { step: 0.15, capacity: 15 };

fn kind(robot: usize) -> &'static Kind {
    if robot < ROBOTS / 2 { &FAST } else { &SLOW }
}

/// A world of the material transport task.
pub struct Transport {
    spec: EnvSpec,
    robots: Vec<Robot>,
    loads: [u32; ROBOTS],
    /// Material in the loading zones, at present and at the start.
    zones: [u32; 2],
    initial: [u32; 2],
    step: u32,
    violations: Vec<bool>,
}

impl Default for Transport {
    fn default() -> Self {
        Self::new()
    }
}

impl Transport {
    /// Creates a world.
    pub fn new() -> Self {
        let place = |name| (name, "m", -1.6, 1.6);
        let share = |name, of| (name, of, 0.0, 1.0);
        let observation = Features::of(
            "own",
            &[
                place("x"),
                place("y"),
                share("load", "capacity"),
                share("zone_1", "material at the start"),
                share("zone_2", "material at the start"),
                share("fast", "1"),
            ],
        );
        let component = |name| (name, "1", -1.0, 1.0);
        let mut state = observation.clone();
        state.push("heading", 1, &[component("cos"), component("sin")]);
        state.push("time", 1, &[share("left", "episode")]);
        let apart = |name| (name, "m", -3.2, 3.2);
        let other = [apart("dx"), apart("dy"), share("load", "capacity"), share("fast", "1")];
        state.push("other", ROBOTS - 1, &other);
        let spec = EnvSpec {
            agents: ROBOTS,
            actions: moves(),
            observation,
            state,
            most_heard: None,
            metrics: vec![
                OwnMetric::rate("safe_robots", Better::Higher).meaning(SAFE),
                OwnMetric::count("left_materials", Better::Lower)
                    .meaning("Units of material that were not unloaded."),
            ],
        };
        Self {
            spec,
            robots: Vec::new(),
            loads: [0; ROBOTS],
            zones: [0; 2],
            initial: [0; 2],
            step: 0,
            violations: vec![false; ROBOTS],
        }
    }

    /// Returns an environment of such worlds.
    pub fn environment() -> Simple<impl Fn() -> Self + Send + Sync> {
        let mut all = backdrop(f64::from(TICKS) * 0.033);
        let [x, y] = HALF;
        let corner = |k: u32| f64::from(k) * std::f64::consts::TAU / 32.0;
        let circle = (0..32).map(|k| [RADIUS * corner(k).cos(), RADIUS * corner(k).sin()]);
        all.zones.extend([
            Zone::rectangle("unloading", [-x, -y], [-BORDER, y]),
            Zone { name: "loading".to_owned(), shape: circle.collect() },
            Zone::rectangle("loading", [BORDER, -y], [x, y]),
        ]);
        Simple::new("material_transport", Self::new).with_backdrop(all)
    }

    /// Returns the material that has not been unloaded.
    fn left(&self) -> u32 {
        self.zones.iter().sum::<u32>() + self.loads.iter().sum::<u32>()
    }

    /// Lets robots load and unload where they are. Returns the reward for it.
    fn handle(&mut self) -> f32 {
        let mut reward = 0.0;
        for (i, robot) in self.robots.iter().enumerate() {
            let load = &mut self.loads[i];
            let zone = match robot.centre {
                centre if centre.x > BORDER => Some(1),
                centre if centre.norm() <= RADIUS => Some(0),
                _ => None,
            };
            if *load > 0 && robot.centre.x < -BORDER {
                reward += UNLOADING * *load as f32;
                *load = 0;
            } else if let (0, Some(zone)) = (*load, zone) {
                *load = self.zones[zone].min(kind(i).capacity);
                self.zones[zone] -= *load;
                reward += LOADING[zone] * *load as f32;
            }
        }
        reward
    }

    fn show(&self, frame: &mut Frame) {
        let share = |of: u32, all: u32| if all == 0 { 0.0 } else { of as f32 / all as f32 };
        let fast = |i: usize| f32::from(u8::from(kind(i).step == FAST.step));
        let load = |i: usize| share(self.loads[i], kind(i).capacity);
        for (i, robot) in self.robots.iter().enumerate() {
            let zones = [0, 1].map(|zone| share(self.zones[zone], self.initial[zone]));
            let [x, y] = [robot.centre.x, robot.centre.y].map(|metres| metres as f32);
            let own = [x, y, load(i), zones[0], zones[1], fast(i)];
            frame.observation_of(i).copy_from_slice(&own);
            let (sin, cos) = robot.heading.sin_cos();
            let left = 1.0 - self.step as f32 / STEPS as f32;
            let others = self.robots.iter().enumerate().filter(|(j, _)| *j != i);
            let others = others.flat_map(|(j, other)| {
                let apart = other.centre - robot.centre;
                [apart.x as f32, apart.y as f32, load(j), fast(j)]
            });
            let all = own.into_iter().chain([cos as f32, sin as f32, left]).chain(others);
            frame.state_of(i).iter_mut().zip(all).for_each(|(out, value)| *out = value);
        }
    }
}

/// Draws an amount of material from a normal distribution.
fn amount(rng: &mut Rng, (mean, deviation): (f32, f32)) -> u32 {
    let mut normal = [0.0];
    rng::fill_normal(rng, &mut normal);
    (mean + deviation * normal[0]).max(0.0) as u32
}

impl MultiAgentEnv for Transport {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn reset(&mut self, seed: Seed, frame: &mut Frame) {
        let mut rng = seed.rng();
        self.robots = STARTS.draw(&mut rng, ROBOTS).into_iter().map(Robot::at).collect();
        self.initial = MATERIAL.map(|material| amount(&mut rng, material));
        self.zones = self.initial;
        self.loads = [0; ROBOTS];
        self.step = 0;
        self.violations.fill(false);
        begin(frame);
        self.show(frame);
    }

    fn step(&mut self, actions: &[f32], frame: &mut Frame) {
        self.step += 1;
        let robots = self.robots.iter().enumerate().zip(actions);
        let goals =
            robots.map(|((i, robot), choice)| target(robot.centre, *choice, kind(i).step, LIMITS));
        let goals: Vec<_> = goals.collect();
        self.violations = drive(&mut self.robots, &goals, TICKS);
        let violated = self.violations.contains(&true);
        let reward = if violated { VIOLATION } else { TIME + self.handle() };
        frame.reward.fill(reward);
        self.show(frame);
        finish(frame, violated || self.left() == 0, self.step == STEPS);
    }

    /// Returns the share of the material that has been unloaded; 0 after a violation.
    fn success(&self) -> f64 {
        let all: u32 = self.initial.iter().sum();
        if self.violations.contains(&true) || all == 0 {
            return 0.0;
        }
        1.0 - f64::from(self.left()) / f64::from(all)
    }

    fn metrics(&self) -> Vec<f64> {
        let safe = self.violations.iter().filter(|violation| !**violation).count();
        vec![safe as f64 / ROBOTS as f64, f64::from(self.left())]
    }

    fn picture(&self) -> Option<Picture> {
        let robots = self.robots.iter().zip(&self.violations);
        Some(Picture {
            agents: robots.map(|(robot, failed)| figure(robot, *failed)).collect(),
            ..Picture::default()
        })
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;

    /// Returns a world with 100 and 20 units, and robots at these places: two fast ones, two slow
    /// ones.
    fn world(places: [[f64; 2]; ROBOTS]) -> Transport {
        let mut world = Transport::new();
        let mut frame = Frame::new(world.spec(), false);
        world.reset(Seed::new(1), &mut frame);
        world.robots = places.map(|place| Robot::at(Vector2::from(place))).to_vec();
        (world.initial, world.zones) = ([100, 20], [100, 20]);
        world
    }

    /// Fast robots carry 5 units and slow ones 15; loading earns 0.025 per unit in the zone in the
    /// middle and 0.05 in that at the right, and unloading at the left 0.075.
    #[test]
    fn robots_load_and_unload() {
        let mut one = world([[0.0, 0.3], [1.2, 0.5], [0.0, -0.3], [1.2, -0.5]]);
        assert!((one.handle() - (20.0 * 0.025 + 20.0 * 0.05)).abs() < 1e-6);
        assert_eq!((one.loads, one.zones, one.left()), ([5, 5, 15, 15], [80, 0], 120));
        // A loaded robot loads nothing.
        assert_eq!((one.handle(), one.loads, one.zones), (0.0, [5, 5, 15, 15], [80, 0]));
        let home = [[-1.2, 0.6], [-1.2, 0.2], [-1.2, -0.2], [-1.2, -0.6]];
        one.robots = home.map(|place| Robot::at(Vector2::from(place))).to_vec();
        assert!((one.handle() - 40.0 * 0.075).abs() < 1e-6);
        assert_eq!((one.loads, one.left()), ([0; 4], 80));
        assert!((one.success() - 40.0 / 120.0).abs() < 1e-9);
        // An empty zone gives nothing.
        one.robots[1] = Robot::at(Vector2::new(1.2, 0.0));
        assert_eq!((one.handle(), one.loads), (0.0, [0; 4]));
    }

    /// The reward is the team's: that of loading, and -0.1 for each decision.
    #[test]
    fn each_decision_costs_time() {
        let mut one = world([[0.0, 0.2], [0.6, 0.5], [0.6, -0.5], [-0.6, 0.0]]);
        let mut frame = Frame::new(one.spec(), false);
        begin(&mut frame);
        one.step(&[4.0; 4], &mut frame);
        assert_eq!(one.loads, [5, 0, 0, 0]);
        assert!(frame.reward.iter().all(|r| (r - (5.0 * 0.025 - 0.1)).abs() < 1e-6));
        one.step(&[4.0; 4], &mut frame);
        assert!(frame.reward.iter().all(|r| (r + 0.1).abs() < 1e-6), "{:?}", frame.reward);
    }

    /// The episode ends when everything has been unloaded, after 70 decisions, or with a violation,
    /// which costs 10.
    #[test]
    fn episodes_end() {
        let far = [[-1.2, 0.6], [0.6, 0.5], [0.6, -0.5], [0.6, 0.0]];
        let mut one = world(far);
        let mut frame = Frame::new(one.spec(), false);
        (one.zones, one.loads) = ([0, 0], [5, 0, 0, 0]);
        one.step(&[4.0; 4], &mut frame);
        assert_eq!((&frame.terminated[..], one.success()), (&[1.0; 4][..], 1.0));

        let mut one = world(far);
        let mut frame = Frame::new(one.spec(), false);
        for step in 1..=70 {
            frame.truncated.fill(0.0);
            one.step(&[4.0; 4], &mut frame);
            assert_eq!(frame.truncated, [f32::from(u8::from(step == 70)); 4], "{step}");
        }

        let mut one = world([[-1.2, 0.6], [-1.1, 0.6], [0.6, -0.5], [0.6, 0.0]]);
        one.step(&[4.0; 4], &mut frame);
        assert_eq!((frame.reward[2], frame.terminated[2], one.success()), (-10.0, 1.0, 0.0));
    }
}
