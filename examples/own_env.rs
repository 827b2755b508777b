//! An environment of your own: four robots in a square, each with a place to reach. The program has
//! the whole command line of `iwol`, with this environment beside the built-in ones:
//!
//! ```sh
//! cargo run --release --example own_env -- train --environment square --algorithm mappo --steps 60000
//! cargo run --release --example own_env -- evaluate runs/square/mappo/seed_0
//! ```

use std::process::ExitCode;

use iwol_sumo::env::{
    ActionDimension, Better, EnvSpec, Features, Figure, FigureStatus, Frame, MultiAgentEnv,
    OwnMetric, Picture, Simple,
};
use iwol_sumo::rng::{self, Seed};

const ROBOTS: usize = 4;
const STEPS: u32 = 40;

/// A world with four robots in a square.
pub(crate) struct Square {
    spec: EnvSpec,
    /// Place and goal of each robot, in 0..1.
    robots: [[f32; 4]; ROBOTS],
    arrived: [bool; ROBOTS],
    step: u32,
}

impl Square {
    /// Creates a world.
    pub(crate) fn new() -> Self {
        let number = |name| (name, "side of the square", -1.0, 1.0);
        let spec = EnvSpec {
            agents: ROBOTS,
            actions: vec![ActionDimension::named("x"), ActionDimension::named("y")].into(),
            observation: Features::of("goal", &["dx", "dy"].map(number)),
            state: Features::of("goal", &["dx", "dy"].map(number)),
            metrics: vec![
                OwnMetric::count("distance_left", Better::Lower)
                    .meaning("Mean distance of the robots from their places at the end."),
            ],
            ..EnvSpec::default()
        };
        Self { spec, robots: [[0.0; 4]; ROBOTS], arrived: [false; ROBOTS], step: 0 }
    }

    fn observe(&self, frame: &mut Frame) {
        for (i, [x, y, goal_x, goal_y]) in self.robots.into_iter().enumerate() {
            frame.observation_of(i).copy_from_slice(&[goal_x - x, goal_y - y]);
            frame.state_of(i).copy_from_slice(&[goal_x - x, goal_y - y]);
        }
    }
}

impl MultiAgentEnv for Square {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn reset(&mut self, seed: Seed, frame: &mut Frame) {
        rng::fill_uniform(&mut seed.rng(), self.robots.as_flattened_mut());
        (self.step, self.arrived) = (0, [false; ROBOTS]);
        frame.active.fill(1.0);
        frame.comm.fill(1.0); // everyone hears everyone
        self.observe(frame);
    }

    fn step(&mut self, actions: &[f32], frame: &mut Frame) {
        self.step += 1;
        for i in (0..ROBOTS).filter(|&i| frame.active[i] > 0.0).collect::<Vec<_>>() {
            let robot = &mut self.robots[i];
            let apart = |r: &[f32; 4]| (r[2] - r[0]).hypot(r[3] - r[1]);
            let before = apart(robot);
            for (place, action) in robot.iter_mut().zip(&actions[2 * i..2 * i + 2]) {
                *place = (*place + 0.1 * action).clamp(0.0, 1.0);
            }
            frame.reward[i] = before - apart(robot);
            if apart(robot) < 0.1 {
                frame.reward[i] += 1.0;
                self.arrived[i] = true;
                frame.end(i);
            } else if self.step == STEPS {
                frame.truncate(i);
            }
        }
        self.observe(frame);
    }

    fn success(&self) -> f64 {
        self.arrived.iter().filter(|arrived| **arrived).count() as f64 / ROBOTS as f64
    }

    fn metrics(&self) -> Vec<f64> {
        let apart = self.robots.map(|[x, y, goal_x, goal_y]| (goal_x - x).hypot(goal_y - y));
        vec![f64::from(apart.iter().sum::<f32>()) / ROBOTS as f64]
    }

    fn picture(&self) -> Option<Picture> {
        let body = |([x, y, goal_x, goal_y], arrived): (&[f32; 4], &bool)| Figure {
            centre: [f64::from(*x), f64::from(*y)],
            heading: f64::from((goal_y - y).atan2(goal_x - x)),
            size: [0.06, 0.04],
            status: if *arrived { FigureStatus::Arrived } else { FigureStatus::Active },
            ..Figure::default()
        };
        let agents = self.robots.iter().zip(&self.arrived).map(body).collect();
        Some(Picture { agents, ..Picture::default() })
    }
}

fn main() -> ExitCode {
    iwol_sumo::env::register(|| Box::new(Simple::new("square", Square::new)))
        .expect("no other environment is called square");
    iwol_sumo::cli::main()
}
