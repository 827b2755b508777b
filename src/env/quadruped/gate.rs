//! Surrogate of the gate task: two robots pass through a gate that is wide enough for one. Geometry
//! from `go1_gate_config.py`, reward of the paper's Go1Gate; the module above says what differs.

use super::{
    DECISION, ROBOTS, Robot, TICK, Track, UNIT, begin, commands, observed, privileged, tick,
};
use crate::env::frame::Frame;
use crate::env::multi_agent::{MultiAgentEnv, Simple};
use crate::env::picture::Picture;
use crate::env::spec::{Better, EnvSpec, OwnMetric};
use crate::rng::{self, Seed};

/// Decisions of an episode: 10 s.
const STEPS: u32 = 100;
/// Length and width of the track, and width of the gate \[m\].
const TRACK: [f64; 2] = [6.0, 3.0];
const OPENING: f64 = 0.6;
/// Middle of the gate, and how far it may be from there in an episode \[m\].
const GATE: [f64; 2] = [3.5, 0.0];
const DEVIATION: f64 = 0.5;
/// Distance behind the gate from which a robot has passed \[m\].
const BEHIND: f64 = 0.25;
/// Rewards: per metre towards the target, per decision behind the gate, per decision with a
/// contact, and divided by the robots' squared distance where that is below [`CLOSE`] \[m²\].
const PROGRESS: f64 = 1.0;
const PASSED: f64 = 5.0;
const CONTACT: f64 = -2.0;
const NEARNESS: f64 = -0.025;
const CLOSE: f64 = 0.25;

/// A world of the gate task.
pub struct GateSurrogate {
    spec: EnvSpec,
    track: Track,
    robots: [Robot; ROBOTS],
    step: u32,
    contacts: u32,
}

impl Default for GateSurrogate {
    fn default() -> Self {
        Self::new()
    }
}

impl GateSurrogate {
    /// Creates a world.
    pub fn new() -> Self {
        let observation = observed();
        let state = privileged(&observation);
        let spec = EnvSpec {
            agents: ROBOTS,
            actions: commands(),
            observation,
            state,
            most_heard: None,
            metrics: vec![
                OwnMetric::rate("passed", Better::Higher)
                    .meaning("Share of robots that are behind the gate at the end."),
                OwnMetric::count("contacts", Better::Lower).meaning(
                    "Robots that touch a wall or the other robot, added up over the decisions.",
                ),
            ],
        };
        Self { spec, track: Track::default(), robots: Default::default(), step: 0, contacts: 0 }
    }

    /// Returns an environment of such worlds.
    pub fn environment() -> Simple<impl Fn() -> Self + Send + Sync> {
        Simple::new("gate_surrogate", Self::new).with_backdrop(Track::backdrop(TRACK))
    }

    fn has_passed(&self, robot: usize) -> bool {
        self.robots[robot].pose.x > self.track.gate[0] + BEHIND
    }

    /// Returns the distance to a robot's target behind the gate \[m\].
    fn to_target(&self, robot: usize) -> f64 {
        let pose = self.robots[robot].pose;
        let side = if robot == 0 { TRACK[1] / 4.0 } else { -TRACK[1] / 4.0 };
        (pose.x - (TRACK[0] - 0.5)).hypot(pose.y - side)
    }

    fn show(&self, frame: &mut Frame) {
        let features = self.robots.map(|robot| robot.features());
        let gate = self.track.gate.map(|metres| (metres / UNIT) as f32);
        for i in 0..ROBOTS {
            let (own, other) = (features[i], features[1 - i]);
            let number = [f32::from(u8::from(i == 0)), f32::from(u8::from(i == 1))];
            let seen = own[..4].iter().chain(&other[..4]).chain(&gate).chain(&number);
            let left = [1.0 - self.step as f32 / STEPS as f32];
            let more = own[4..].iter().chain(&other[4..]).chain(&left);
            let write = |out: &mut f32, value: &f32| *out = *value;
            let all = seen.clone().chain(more);
            frame.observation_of(i).iter_mut().zip(seen).for_each(|(out, v)| write(out, v));
            frame.state_of(i).iter_mut().zip(all).for_each(|(out, v)| write(out, v));
        }
    }
}

impl MultiAgentEnv for GateSurrogate {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn reset(&mut self, seed: Seed, frame: &mut Frame) {
        let mut rng = seed.rng();
        let gate = GATE.map(|middle| middle + DEVIATION * rng::symmetric(&mut rng));
        self.track = Track::new(TRACK, gate, OPENING);
        self.robots = [[1.0, 0.5], [1.0, -0.5]].map(|place| Robot::near(&mut rng, place));
        (self.step, self.contacts) = (0, 0);
        begin(frame);
        self.show(frame);
    }

    fn step(&mut self, actions: &[f32], frame: &mut Frame) {
        self.step += 1;
        let before: f64 = (0..ROBOTS).map(|robot| self.to_target(robot)).sum();
        let mut touched = [false; ROBOTS];
        for _ in 0..(DECISION / TICK).round() as usize {
            let contacts = tick(&mut self.robots, actions, &self.track);
            touched = [0, 1].map(|robot| touched[robot] || contacts[robot]);
        }
        let contacts = touched.iter().filter(|touched| **touched).count();
        self.contacts += contacts as u32;
        let after: f64 = (0..ROBOTS).map(|robot| self.to_target(robot)).sum();
        let passed = (0..ROBOTS).filter(|&robot| self.has_passed(robot)).count();
        let [a, b] = self.robots.map(|robot| robot.pose);
        let apart = (a.x - b.x).powi(2) + (a.y - b.y).powi(2);
        let nearness = if apart < CLOSE { ROBOTS as f64 * NEARNESS / apart } else { 0.0 };
        let reward = PROGRESS * (before - after)
            + PASSED * passed as f64
            + CONTACT * contacts as f64
            + nearness;
        frame.reward.fill(reward as f32);
        self.show(frame);
        if self.step == STEPS {
            (0..ROBOTS).for_each(|robot| frame.truncate(robot));
        }
    }

    /// Returns 1 if both robots have passed, else 0.
    fn success(&self) -> f64 {
        f64::from(u8::from((0..ROBOTS).all(|robot| self.has_passed(robot))))
    }

    fn metrics(&self) -> Vec<f64> {
        let passed = (0..ROBOTS).filter(|&robot| self.has_passed(robot)).count();
        vec![passed as f64 / ROBOTS as f64, f64::from(self.contacts)]
    }

    fn picture(&self) -> Option<Picture> {
        Some(Picture {
            agents: self.robots.iter().map(Robot::figure).collect(),
            others: self.track.figures().collect(),
            ..Picture::default()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::BODY;
    use super::*;

    fn begun() -> (GateSurrogate, Frame) {
        let mut world = GateSurrogate::new();
        let mut frame = Frame::new(world.spec(), false);
        world.reset(Seed::new(1), &mut frame);
        (world, frame)
    }

    /// The team earns 1 per metre towards the targets, 5 per decision for each robot that is 0.25 m
    /// behind the gate, and loses 0.025 per robot, divided by the squared distance of two robots
    /// that are nearer than 0.5 m.
    #[test]
    fn rewards_are_those_of_the_paper() {
        let (mut world, mut frame) = begun();
        world.step(&[0.0; 6], &mut frame);
        assert_eq!(frame.reward, [0.0, 0.0], "two robots that stand");
        let before: f64 = [0, 1].map(|robot| world.to_target(robot)).iter().sum();
        world.step(&[1.0, 0.0, 0.0, 1.0, 0.0, 0.0], &mut frame);
        let after: f64 = [0, 1].map(|robot| world.to_target(robot)).iter().sum();
        assert!(before - after > 0.01);
        assert!((f64::from(frame.reward[0]) - (before - after)).abs() < 1e-6);
        assert_eq!(frame.reward[0], frame.reward[1]);

        let (mut world, mut frame) = begun();
        let gate = world.track.gate[0];
        world.robots[0].pose.x = gate + 0.26;
        world.robots[1].pose.x = gate + 0.8;
        (world.robots[0].pose.y, world.robots[1].pose.y) = (0.5, -0.5);
        world.step(&[0.0; 6], &mut frame);
        assert_eq!((frame.reward[0], world.success()), (10.0, 1.0));
        world.robots[0].pose.x = gate + 0.24;
        world.step(&[0.0; 6], &mut frame);
        assert_eq!((frame.reward[0], world.success()), (5.0, 0.0));

        let (mut world, mut frame) = begun();
        (world.robots[0].pose.y, world.robots[1].pose.y) = (0.22, -0.22);
        (world.robots[0].pose.x, world.robots[1].pose.x) = (1.0, 1.0);
        (world.robots[0].pose.heading, world.robots[1].pose.heading) = (0.0, 0.0);
        world.step(&[0.0; 6], &mut frame);
        let expected = -2.0 * 0.025 / (0.44 * 0.44);
        assert!((f64::from(frame.reward[0]) - expected).abs() < 1e-6, "{:?}", frame.reward);
    }

    /// A rule that lines up in front of the gate, one robot after the other, passes without a
    /// contact, so that the task can be solved.
    #[test]
    fn one_after_the_other_passes() {
        const { assert!(BODY[1] < OPENING && OPENING <= 2.0 * BODY[1]) };
        for seed in 0..20 {
            let mut world = GateSurrogate::new();
            let mut frame = Frame::new(world.spec(), false);
            world.reset(Seed::new(seed), &mut frame);
            for _ in 0..STEPS {
                let mut actions = [0.0; 6];
                for i in 0..ROBOTS {
                    let (pose, gate) = (world.robots[i].pose, world.track.gate);
                    let behind = pose.x > gate[0] + 0.6;
                    let wanted =
                        if behind { [TRACK[1] / 4.0, -TRACK[1] / 4.0][i] } else { gate[1] };
                    let aside = wanted - pose.y;
                    let first = i == 0 || world.robots[0].pose.x > gate[0] + 0.9;
                    let lined_up = aside.abs() < 0.05 || pose.x < gate[0] - 1.2 && i == 0;
                    let ahead = match () {
                        () if behind && pose.x > TRACK[0] - 0.7 => 0.0,
                        () if behind || first && lined_up => 0.5,
                        () => 0.0,
                    };
                    let waits = i == 1 && !first;
                    actions[3 * i] = ahead as f32;
                    actions[3 * i + 1] =
                        if waits { 0.0 } else { (2.0 * aside).clamp(-1.0, 1.0) as f32 };
                }
                world.step(&actions, &mut frame);
            }
            assert_eq!(
                (world.success(), world.contacts),
                (1.0, 0),
                "seed {seed}: {:?}",
                world.robots
            );
            assert!(frame.truncated.iter().all(|late| *late == 1.0));
        }
    }
}
