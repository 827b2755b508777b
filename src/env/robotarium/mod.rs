//! Robotarium: small robots in an arena of 3.2 × 2 m (Pickem et al. 2017, "The Robotarium: a
//! remotely accessible swarm robotics research testbed"; `robotarium_python_simulator` before its
//! version of 2024, and the tasks of MARBLER, GT-STAR-Lab/MARBLER).
//!
//! Robots choose among four moves and staying. A controller drives the point 0.05 m in front of each
//! robot towards the place of its choice, with a barrier certificate that keeps robots apart. A move
//! begins at the robot's centre, so that a robot which stays moves back by these 0.05 m. Robots do
//! not see each other; every robot can hear every other one. An episode ends with the first
//! violation: two robots collide, or one leaves the arena.

mod arena;
mod certificate;
mod navigation;
mod transport;

pub use navigation::Navigation;
pub use transport::Transport;

use nalgebra::Vector2;

use self::arena::{DIAMETER, HALF, Robot};
use super::frame::Frame;
use super::picture::{Backdrop, Figure, FigureStatus, Zone};
use super::spec::ActionSpace;
use crate::rng::{self, Rng};

/// Number of robots.
const ROBOTS: usize = 4;

/// What the metric `safe_robots` means.
const SAFE: &str = "Share of robots that have neither collided nor left the arena.";

/// Returns what a robot can choose.
fn moves() -> ActionSpace {
    ActionSpace::Discrete(vec!["left", "right", "up", "down", "stay"])
}

/// Returns where a robot at `centre` wants to go: a step of the length `step` \[m\] away, at most
/// `limits` \[m\] from the middle of the arena.
fn target(centre: Vector2<f64>, choice: f32, step: f64, limits: [f64; 2]) -> Vector2<f64> {
    let [x, y] = match choice as usize {
        0 => [-1.0, 0.0],
        1 => [1.0, 0.0],
        2 => [0.0, 1.0],
        3 => [0.0, -1.0],
        _ => [0.0, 0.0],
    };
    let wanted = centre + step * Vector2::new(x, y);
    Vector2::new(wanted.x.clamp(-limits[0], limits[0]), wanted.y.clamp(-limits[1], limits[1]))
}

/// A grid of places from which starts and goals are drawn (`rps/utilities/misc.py`,
/// `generate_initial_conditions`).
struct Grid {
    /// Smallest coordinates \[m\].
    corner: [f64; 2],
    columns: usize,
    rows: usize,
    /// Distance between neighbouring places \[m\].
    spacing: f64,
}

impl Grid {
    /// Draws `count` different places. The reference counts places from 1, so that the lowest one
    /// of the first column is never drawn, and the lowest one of a further column is.
    fn draw(&self, rng: &mut Rng, count: usize) -> Vec<Vector2<f64>> {
        let mut numbers: Vec<usize> = (1..=self.columns * self.rows).collect();
        rng::shuffle(rng, &mut numbers);
        let place = |number: usize| {
            let (column, row) = (number / self.rows, number % self.rows);
            let [x, y] = self.corner;
            Vector2::new(x + column as f64 * self.spacing, y + row as f64 * self.spacing)
        };
        numbers.into_iter().take(count).map(place).collect()
    }
}

/// Lets all robots act, and hear each other.
fn begin(frame: &mut Frame) {
    frame.active.fill(1.0);
    frame.comm.fill(1.0);
}

/// Ends the episode for all robots if it is `over`, and truncates it at the time limit.
fn finish(frame: &mut Frame, over: bool, truncated: bool) {
    for robot in 0..ROBOTS {
        if over {
            frame.end(robot);
        } else if truncated {
            frame.truncate(robot);
        }
    }
}

/// Returns how pictures show a robot.
fn figure(robot: &Robot, failed: bool) -> Figure {
    Figure {
        centre: robot.centre.into(),
        heading: robot.heading,
        size: [DIAMETER; 2],
        speed: robot.linear,
        status: if failed { FigureStatus::Failed } else { FigureStatus::Active },
    }
}

/// Returns the arena as pictures show it, with decisions of this duration \[s\].
fn backdrop(step_length: f64) -> Backdrop {
    let [x, y] = HALF;
    Backdrop {
        step_length,
        size: [DIAMETER; 2],
        range: f64::INFINITY,
        zones: vec![Zone::rectangle("arena", [-x, -y], [x, y])],
        ..Backdrop::default()
    }
}
