//! Surrogates of two tasks with quadrupeds: a gate to pass, and sheep to drive through a gate
//! (multi-agent quadruped environment, ziyanx02/multiagent-quadruped-environment; the paper's
//! Go1Gate and Go1Sheep).
//!
//! The originals simulate legs, joints and contacts in three dimensions. Here a robot is a box in
//! the plane that follows its commanded velocities with a lag of first order. So results must not
//! be set beside those of the originals: rewards, success and difficulty differ.
//!
//! Other differences: a decision lasts 0.1 s (originals: 0.02 s). Rewards that the originals give
//! in each step are given in each decision, so that they weigh a fifth of theirs beside rewards for
//! progress. Robots cannot fall. A robot that would touch a wall or the other robot is stopped.

mod gate;
mod sheep;

pub use gate::GateSurrogate;
pub use sheep::SheepSurrogate;

use super::driving::{Pose, Size, boxes_overlap};
use super::frame::Frame;
use super::picture::{Backdrop, Figure, FigureStatus, Zone};
use super::spec::{ActionDimension, ActionSpace, Described, Features};
use crate::rng::{self, Rng};

/// Number of robots.
const ROBOTS: usize = 2;
/// Duration of a decision, and of one of its ticks \[s\].
const DECISION: f64 = 0.1;
const TICK: f64 = 0.02;
/// Time constant with which a robot follows its command \[s\].
const LAG: f64 = 0.2;
/// Length and width of a robot \[m\].
const BODY: Size = [0.65, 0.3];
/// Largest commands: forward and to the left \[m/s\], and turning \[rad/s\].
const COMMAND: [f64; 3] = [2.0, 0.5, 0.5];
/// Unit of places in features \[m\].
const UNIT: f64 = 5.0;
/// Features of a place, and of a robot's pose.
const PLACE: [Described; 2] = [("x", "5 m", 0.0, 3.0), ("y", "5 m", -1.0, 1.0)];
const POSE: [Described; 4] = [
    ("x", "5 m", 0.0, 3.0),
    ("y", "5 m", -1.0, 1.0),
    ("cos", "1", -1.0, 1.0),
    ("sin", "1", -1.0, 1.0),
];
/// Features of a robot's velocity.
const VELOCITY: [Described; 3] =
    [("forward", "m/s", -2.0, 2.0), ("left", "m/s", -0.5, 0.5), ("turning", "rad/s", -0.5, 0.5)];

/// Returns the commands of a robot: velocities in units of [`COMMAND`].
fn commands() -> ActionSpace {
    vec![
        ActionDimension::named("forward"),
        ActionDimension::named("left"),
        ActionDimension::named("turning"),
    ]
    .into()
}

/// Returns what a robot observes in both tasks: itself, the other robot, the gate, and its number.
fn observed() -> Features {
    let mut features = Features::default();
    features.push("own", 1, &POSE);
    features.push("other", 1, &POSE);
    features.push("gate", 1, &PLACE);
    features.push("robot", 1, &[("first", "1", 0.0, 1.0), ("second", "1", 0.0, 1.0)]);
    features
}

/// Returns the privileged state of both tasks: an observation, the robots' velocities and the time.
fn privileged(observation: &Features) -> Features {
    let mut features = observation.clone();
    features.push("own_velocity", 1, &VELOCITY);
    features.push("other_velocity", 1, &VELOCITY);
    features.push("time", 1, &[("left", "episode", 0.0, 1.0)]);
    features
}

/// A robot.
#[derive(Debug, Clone, Copy, Default)]
struct Robot {
    pose: Pose,
    /// Velocities forward and to the left \[m/s\], and turning \[rad/s\].
    velocity: [f64; 3],
}

impl Robot {
    /// Returns a robot that stands near a place, with its heading along the track.
    fn near(rng: &mut Rng, [x, y]: [f64; 2]) -> Self {
        let (dx, dy) = (0.1 * rng::symmetric(rng), 0.1 * rng::symmetric(rng));
        Self { pose: Pose { x: x + dx, y: y + dy, heading: 0.0 }, velocity: [0.0; 3] }
    }

    /// Writes [`POSE`] and [`VELOCITY`].
    fn features(&self) -> [f32; 7] {
        let (sin, cos) = self.pose.heading.sin_cos();
        let [forward, left, turning] = self.velocity;
        let [x, y] = [self.pose.x / UNIT, self.pose.y / UNIT];
        [x, y, cos, sin, forward, left, turning].map(|value| value as f32)
    }

    fn figure(&self) -> Figure {
        Figure {
            centre: [self.pose.x, self.pose.y],
            heading: self.pose.heading,
            size: BODY,
            speed: self.velocity[0].hypot(self.velocity[1]),
            status: FigureStatus::Active,
        }
    }
}

/// A wall along the axes, from its lower left to its upper right corner \[m\].
#[derive(Debug, Clone, Copy)]
struct Wall {
    low: [f64; 2],
    high: [f64; 2],
}

impl Wall {
    fn centre(&self) -> Pose {
        let [x, y] = [0, 1].map(|axis| f64::midpoint(self.low[axis], self.high[axis]));
        Pose { x, y, heading: 0.0 }
    }

    fn size(&self) -> Size {
        [0, 1].map(|axis| self.high[axis] - self.low[axis])
    }

    /// Returns the point of the wall that is nearest to a point.
    fn nearest(&self, point: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|axis| point[axis].clamp(self.low[axis], self.high[axis]))
    }
}

/// A track along the x axis, with a wall across it that has a gate.
#[derive(Debug, Clone, Default)]
struct Track {
    /// Middle of the gate \[m\].
    gate: [f64; 2],
    walls: Vec<Wall>,
}

impl Track {
    /// Returns a track of this length and width \[m\], whose wall is 0.1 m thick and has a gate of
    /// the width `opening` \[m\].
    fn new([length, width]: [f64; 2], gate: [f64; 2], opening: f64) -> Self {
        let half = width / 2.0;
        let outer = |low, high| Wall { low, high };
        let across =
            |bottom, top| Wall { low: [gate[0] - 0.05, bottom], high: [gate[0] + 0.05, top] };
        let walls = vec![
            outer([-0.1, -half], [0.0, half]),
            outer([length, -half], [length + 0.1, half]),
            outer([-0.1, half], [length + 0.1, half + 0.1]),
            outer([-0.1, -half - 0.1], [length + 0.1, -half]),
            across(-half, gate[1] - opening / 2.0),
            across(gate[1] + opening / 2.0, half),
        ];
        Self { gate, walls }
    }

    fn blocks(&self, pose: &Pose) -> bool {
        self.walls.iter().any(|wall| boxes_overlap((pose, BODY), (&wall.centre(), wall.size())))
    }

    /// Returns the track as pictures show it; the place of the gate, which differs from episode to
    /// episode, is left out.
    fn backdrop([length, width]: [f64; 2]) -> Backdrop {
        let half = width / 2.0;
        Backdrop {
            step_length: DECISION,
            size: BODY,
            range: f64::INFINITY,
            zones: vec![Zone::rectangle("track", [0.0, -half], [length, half])],
            ..Backdrop::default()
        }
    }

    /// Returns the wall with the gate as pictures show it.
    fn figures(&self) -> impl Iterator<Item = Figure> {
        self.walls[4..].iter().map(|wall| Figure {
            centre: [wall.centre().x, wall.centre().y],
            size: wall.size(),
            status: FigureStatus::Active,
            ..Figure::default()
        })
    }
}

/// Moves robots for a tick by the commands `[N, 3]`. A robot that would touch a wall or the other
/// robot slides along an axis or stays where it is. Returns which robots touched something.
fn tick(robots: &mut [Robot; ROBOTS], actions: &[f32], track: &Track) -> [bool; ROBOTS] {
    let mut contacts = [false; ROBOTS];
    for i in 0..ROBOTS {
        let mut robot = robots[i];
        for (axis, velocity) in robot.velocity.iter_mut().enumerate() {
            let command = COMMAND[axis] * f64::from(actions[3 * i + axis]);
            *velocity += (command - *velocity) * TICK / LAG;
        }
        let [forward, left, turning] = robot.velocity;
        let (sin, cos) = robot.pose.heading.sin_cos();
        let (dx, dy) = (TICK * (cos * forward - sin * left), TICK * (sin * forward + cos * left));
        let Pose { x, y, heading } = robot.pose;
        let turned = heading + TICK * turning;
        // The whole motion, or the part of it that nothing blocks.
        let tries = [(dx, dy, turned), (dx, 0.0, heading), (0.0, dy, heading), (0.0, 0.0, turned)];
        let other = robots[1 - i].pose;
        let free =
            |pose: &Pose| !track.blocks(pose) && !boxes_overlap((pose, BODY), (&other, BODY));
        let poses = tries.map(|(dx, dy, heading)| Pose { x: x + dx, y: y + dy, heading });
        let found = poses.iter().position(free);
        if found != Some(0) {
            robot.velocity = [0.0; 3];
            contacts[i] = true;
            contacts[1 - i] |= boxes_overlap((&poses[0], BODY), (&other, BODY));
        }
        robot.pose = found.map_or(robot.pose, |number| poses[number]);
        robots[i] = robot;
    }
    contacts
}

/// Lets both robots act, and hear each other.
fn begin(frame: &mut Frame) {
    frame.active.fill(1.0);
    frame.comm.fill(1.0);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn robot(x: f64, y: f64) -> Robot {
        Robot { pose: Pose { x, y, heading: 0.0 }, velocity: [0.0; 3] }
    }

    /// A robot reaches 63 % of a commanded velocity after the time constant, and the whole of it
    /// later.
    #[test]
    fn velocities_follow_commands_with_a_lag() {
        let track = Track::new([100.0, 3.0], [90.0, 0.0], 0.6);
        let mut robots = [robot(1.0, -0.5), robot(1.0, 0.5)];
        let actions = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        for _ in 0..10 {
            assert_eq!(tick(&mut robots, &actions, &track), [false, false]);
        }
        // Euler steps of a tenth of the time constant: 1 − 0.9^10.
        assert!((robots[0].velocity[0] - 2.0 * (1.0 - 0.9_f64.powi(10))).abs() < 1e-9);
        for _ in 0..200 {
            tick(&mut robots, &actions, &track);
        }
        assert!((robots[0].velocity[0] - 2.0).abs() < 1e-6, "{robots:?}");
        assert_eq!(robots[1].pose, robot(1.0, 0.5).pose, "its command is to stand");
    }

    /// Nothing passes through walls or through the other robot, and only one robot at a time fits
    /// through the gate.
    #[test]
    fn walls_and_robots_block() {
        let track = Track::new([6.0, 3.0], [3.5, 0.0], 0.6);
        let mut rng = crate::rng::Seed::new(3).rng();
        let mut robots = [robot(1.0, -0.5), robot(1.0, 0.5)];
        let mut touched = false;
        for _ in 0..2000 {
            let actions: Vec<f32> = (0..6).map(|_| rng::symmetric(&mut rng) as f32 * 2.0).collect();
            let actions: Vec<f32> = actions.iter().map(|a| a.clamp(-1.0, 1.0)).collect();
            for _ in 0..5 {
                touched |= tick(&mut robots, &actions, &track).contains(&true);
                for robot in &robots {
                    assert!(!track.blocks(&robot.pose), "{robots:?}");
                }
                assert!(!boxes_overlap((&robots[0].pose, BODY), (&robots[1].pose, BODY)));
            }
        }
        assert!(touched);
        let mut robots = [robot(2.0, -0.4), robot(2.0, 0.4)];
        let ahead = [1.0, 0.3, 0.0, 1.0, -0.3, 0.0];
        for _ in 0..500 {
            tick(&mut robots, &ahead, &track);
        }
        assert!(robots.iter().all(|robot| robot.pose.x < 3.4), "both at once do not fit");
    }
}
