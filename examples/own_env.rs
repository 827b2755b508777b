//! An environment of your own: four robots in a square, each with a place to reach, trained with any
//! method without SUMO.
//!
//! `cargo run --release --example own_env -- mappo 60000` trains MAPPO for 60,000 steps.

use std::sync::atomic::AtomicBool;

use iwol_sumo::config::Layers;
use iwol_sumo::env::{ActionDimension, EnvSpec, Features, Frame, MultiAgentEnv, Simple};
use iwol_sumo::rng::{self, Seed};
use iwol_sumo::train::{RunDir, Trainer};
use toml::Value;

const ROBOTS: usize = 4;
const STEPS: u32 = 40;

/// A world with four robots in a square.
pub(crate) struct Square {
    spec: EnvSpec,
    /// Place and goal of each robot, in 0..1.
    robots: [[f32; 4]; ROBOTS],
    step: u32,
    arrived: usize,
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
            ..EnvSpec::default()
        };
        Self { spec, robots: [[0.0; 4]; ROBOTS], step: 0, arrived: 0 }
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
        (self.step, self.arrived) = (0, 0);
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
            (robot[0], robot[1]) =
                (robot[0] + 0.1 * actions[2 * i], robot[1] + 0.1 * actions[2 * i + 1]);
            frame.reward[i] = before - apart(robot);
            if apart(robot) < 0.1 {
                frame.reward[i] += 1.0;
                self.arrived += 1;
                frame.end(i);
            } else if self.step == STEPS {
                frame.truncate(i);
            }
        }
        self.observe(frame);
    }

    fn success(&self) -> f64 {
        self.arrived as f64 / ROBOTS as f64
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let method = args.next().unwrap_or_else(|| "mappo".to_owned());
    let steps = args.next().map_or(Ok(60_000), |steps| steps.parse())?;
    let flags = vec![("algorithm", Value::String(method)), ("steps", Value::Integer(steps))];
    let config = Layers { flags, sets: args.collect(), ..Layers::default() }
        .without_scenario(&Square::new().spec)?;
    let folder = tempfile::tempdir()?;
    let mut trainer = Trainer::new(config, Box::new(Simple::new("square", Square::new)))?;
    trainer.run(&RunDir::new(folder.path()), &AtomicBool::new(false), &mut |report| {
        println!("{:>7} steps  success {:?}", report.step, report.training_success);
    })?;
    let found = trainer.validate(&AtomicBool::new(false))?.metrics().ok_or("no episode")?;
    println!("robots that arrive: {:.1} %", 100.0 * found.success.mean);
    Ok(())
}
