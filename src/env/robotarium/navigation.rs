//! Simple navigation: four robots go to one place (MARBLER, `scenarios/Simple`, with the
//! observation and the reward of IWoL: DongsuLeeTech/IWoL, `Robotarium/onpolicy/envs/robotarium`).
//!
//! Differences on purpose: an episode has 50 decisions (reference: 51), and the first observation
//! is that of the start (reference: zeros).

use nalgebra::Vector2;

use super::arena::{Robot, drive};
use super::{Grid, ROBOTS, SAFE, backdrop, begin, figure, finish, moves, target};
use crate::env::frame::Frame;
use crate::env::multi_agent::{MultiAgentEnv, Simple};
use crate::env::picture::{Figure, FigureStatus, Picture};
use crate::env::spec::{Better, EnvSpec, Features, OwnMetric};
use crate::rng::Seed;

/// Decisions of an episode, and ticks of 0.033 s per decision.
const STEPS: u32 = 50;
const TICKS: u32 = 29;
/// Length of a move \[m\].
const MOVE: f64 = 0.2;
/// Largest coordinates of the place that a robot wants to go to \[m\].
const LIMITS: [f64; 2] = [1.45, 0.9];
/// Reward of a robot per square metre to the goal, and in a violation.
const DISTANCE: f32 = -0.1;
const VIOLATION: f32 = -5.0;
/// Weight of the others' mean reward.
const COOPERATION: f32 = 0.3;
/// Distance to the goal at which a robot counts as arrived \[m\], a choice of this project: the
/// references define no success.
const NEAR: f64 = 0.3;

const STARTS: Grid = Grid { corner: [-1.45, -0.9], columns: 3, rows: 6, spacing: 0.3 };
const GOALS: Grid = Grid { corner: [0.5, -0.9], columns: 4, rows: 9, spacing: 0.2 };

/// A world of the navigation task.
pub struct Navigation {
    spec: EnvSpec,
    robots: Vec<Robot>,
    goal: Vector2<f64>,
    step: u32,
    violations: Vec<bool>,
}

impl Default for Navigation {
    fn default() -> Self {
        Self::new()
    }
}

impl Navigation {
    /// Creates a world.
    pub fn new() -> Self {
        let place = |name| (name, "m", -1.6, 1.6);
        let own = [place("x"), place("y"), place("goal_x"), place("goal_y")];
        let component = |name| (name, "1", -1.0, 1.0);
        let mut state = Features::of("own", &own);
        state.push("heading", 1, &[component("cos"), component("sin")]);
        state.push("time", 1, &[("left", "episode", 0.0, 1.0)]);
        let other = ["dx", "dy"].map(|name| (name, "m", -3.2, 3.2));
        state.push("other", ROBOTS - 1, &[other[0], other[1], component("cos"), component("sin")]);
        let spec = EnvSpec {
            agents: ROBOTS,
            actions: moves(),
            observation: Features::of("own", &own),
            state,
            most_heard: None,
            metrics: vec![
                OwnMetric::rate("safe_robots", Better::Higher).meaning(SAFE),
                OwnMetric::count("distance", Better::Lower)
                    .meaning("Mean distance of the robots from the goal at the end (m)."),
            ],
        };
        Self {
            spec,
            robots: Vec::new(),
            goal: Vector2::zeros(),
            step: 0,
            violations: vec![false; ROBOTS],
        }
    }

    /// Returns an environment of such worlds.
    pub fn environment() -> Simple<impl Fn() -> Self + Send + Sync> {
        Simple::new("navigation", Self::new).with_backdrop(backdrop(f64::from(TICKS) * 0.033))
    }

    fn distance(&self, robot: usize) -> f64 {
        (self.robots[robot].centre - self.goal).norm()
    }

    fn show(&self, frame: &mut Frame) {
        for (i, robot) in self.robots.iter().enumerate() {
            let place = [robot.centre.x, robot.centre.y, self.goal.x, self.goal.y];
            let own = place.map(|metres| metres as f32);
            frame.observation_of(i).copy_from_slice(&own);
            let left = 1.0 - self.step as f32 / STEPS as f32;
            let others = self.robots.iter().enumerate().filter(|(j, _)| *j != i);
            let others = others.flat_map(|(_, other)| {
                let apart = other.centre - robot.centre;
                let (sin, cos) = other.heading.sin_cos();
                [apart.x, apart.y, cos, sin].map(|value| value as f32)
            });
            let (sin, cos) = robot.heading.sin_cos();
            let all = own.into_iter().chain([cos as f32, sin as f32, left]).chain(others);
            frame.state_of(i).iter_mut().zip(all).for_each(|(out, value)| *out = value);
        }
    }
}

impl MultiAgentEnv for Navigation {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn reset(&mut self, seed: Seed, frame: &mut Frame) {
        let mut rng = seed.rng();
        self.robots = STARTS.draw(&mut rng, ROBOTS).into_iter().map(Robot::at).collect();
        self.goal = GOALS.draw(&mut rng, 1)[0];
        self.step = 0;
        self.violations.fill(false);
        begin(frame);
        self.show(frame);
    }

    fn step(&mut self, actions: &[f32], frame: &mut Frame) {
        self.step += 1;
        let goal = |(robot, choice): (&Robot, &f32)| target(robot.centre, *choice, MOVE, LIMITS);
        let goals: Vec<_> = self.robots.iter().zip(actions).map(goal).collect();
        self.violations = drive(&mut self.robots, &goals, TICKS);
        let own: Vec<f32> = (0..ROBOTS)
            .map(|i| {
                let distance = DISTANCE * self.distance(i).powi(2) as f32;
                if self.violations[i] { VIOLATION } else { distance }
            })
            .collect();
        let sum: f32 = own.iter().sum();
        for (reward, own) in frame.reward.iter_mut().zip(own) {
            let others = (sum - own) / (ROBOTS - 1) as f32;
            *reward = (1.0 - COOPERATION) * own + COOPERATION * others;
        }
        self.show(frame);
        finish(frame, self.violations.contains(&true), self.step == STEPS);
    }

    /// Returns the share of robots that end near the goal; 0 after a violation.
    fn success(&self) -> f64 {
        if self.violations.contains(&true) {
            return 0.0;
        }
        let near = (0..ROBOTS).filter(|&i| self.distance(i) <= NEAR).count();
        near as f64 / ROBOTS as f64
    }

    fn metrics(&self) -> Vec<f64> {
        let safe = self.violations.iter().filter(|violation| !**violation).count();
        let distance: f64 = (0..ROBOTS).map(|i| self.distance(i)).sum();
        vec![safe as f64 / ROBOTS as f64, distance / ROBOTS as f64]
    }

    fn picture(&self) -> Option<Picture> {
        let robots = self.robots.iter().zip(&self.violations);
        let goal = Figure {
            centre: self.goal.into(),
            size: [0.06; 2],
            status: FigureStatus::Active,
            ..Figure::default()
        };
        Some(Picture {
            agents: robots.map(|(robot, failed)| figure(robot, *failed)).collect(),
            others: vec![goal],
            ..Picture::default()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn begun() -> (Navigation, Frame) {
        let mut world = Navigation::new();
        let mut frame = Frame::new(world.spec(), false);
        world.reset(Seed::new(1), &mut frame);
        (world, frame)
    }

    /// Robots start at the left and have one goal at the right; each observes itself and the goal.
    #[test]
    fn robots_start_at_the_left_and_have_one_goal() {
        for seed in 0..50 {
            let (mut world, mut frame) = begun();
            world.reset(Seed::new(seed), &mut frame);
            assert!(world.goal.x >= 0.5 && world.goal.x <= 1.1 + 1e-9, "{}", world.goal);
            for (i, robot) in world.robots.iter().enumerate() {
                assert!(robot.centre.x < -0.5 && robot.centre.y.abs() <= 0.9 + 1e-9, "{robot:?}");
                let seen = [robot.centre.x, robot.centre.y, world.goal.x, world.goal.y];
                assert_eq!(frame.observation_of(i), seen.map(|metres| metres as f32));
            }
        }
    }

    /// The reward is 0.7 of a robot's own -0.1 d², and 0.3 of the mean of the three others.
    #[test]
    fn rewards_are_those_of_the_reference() {
        let (mut world, mut frame) = begun();
        world.robots = [[0.0, 0.0], [0.0, 0.5], [0.0, -0.5], [-1.0, 0.0]]
            .map(|place| Robot::at(place.into()))
            .to_vec();
        world.goal = Vector2::new(1.0, 0.0);
        // Everybody stays, so that only the point ahead of a robot's centre goes to its place.
        world.step(&[4.0; 4], &mut frame);
        let own: Vec<f64> = (0..4).map(|i| -0.1 * world.distance(i).powi(2)).collect();
        assert!((own[0] + 0.1).abs() < 0.02 && (own[3] + 0.4).abs() < 0.03, "{own:?}");
        for i in 0..4 {
            let others = (own.iter().sum::<f64>() - own[i]) / 3.0;
            let expected = 0.7 * own[i] + 0.3 * others;
            assert!((f64::from(frame.reward[i]) - expected).abs() < 1e-5, "{:?}", frame.reward);
        }
        assert!(frame.active.iter().all(|active| *active == 1.0));
    }

    /// A violation costs the robot 5 instead of its distance, and ends the episode of all robots
    /// without success.
    #[test]
    fn a_violation_ends_the_episode() {
        let (mut world, mut frame) = begun();
        world.robots = [[0.0, 0.0], [0.1, 0.0], [0.0, -0.5], [-1.0, 0.0]]
            .map(|place| Robot::at(place.into()))
            .to_vec();
        world.goal = Vector2::new(1.0, 0.0);
        world.step(&[4.0; 4], &mut frame);
        assert_eq!(world.violations, [true, true, false, false]);
        let own: Vec<f64> = (2..4).map(|i| -0.1 * world.distance(i).powi(2)).collect();
        let expected = 0.7 * -5.0 + 0.1 * (-5.0 + own[0] + own[1]);
        assert!((f64::from(frame.reward[0]) - expected).abs() < 1e-5, "{:?}", frame.reward);
        assert_eq!((&frame.terminated[..], world.success()), (&[1.0; 4][..], 0.0));
        assert_eq!(world.metrics()[0], 0.5);
    }

    /// An episode has 50 decisions, and its success is the share of robots that end within 0.3 m of
    /// the goal. A robot that stays moves back by the 0.05 m that its controlled point is ahead.
    #[test]
    fn success_is_to_end_near_the_goal() {
        let (mut world, mut frame) = begun();
        for step in 1..50 {
            // Robots go up and down by turns.
            world.step(&[2.0 + (step % 2) as f32; 4], &mut frame);
            assert_eq!(frame.truncated, [0.0; 4], "{step}");
        }
        world.robots = [[1.0, 0.25], [1.0, -0.2], [0.5, 0.5], [-1.0, 0.0]]
            .map(|place| Robot::at(place.into()))
            .to_vec();
        world.goal = Vector2::new(1.0, 0.0);
        world.step(&[4.0; 4], &mut frame);
        assert_eq!(frame.truncated, [1.0; 4]);
        assert_eq!(world.success(), 0.5);
        let back: Vec<f64> = world.robots.iter().map(|robot| robot.centre.x).collect();
        let expected = [0.95, 0.95, 0.45, -1.05];
        assert!(back.iter().zip(expected).all(|(x, e)| (x - e).abs() < 0.02), "{back:?}");
    }
}
