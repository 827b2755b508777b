//! Surrogate of the sheep task: two robots drive nine sheep through a gate. Geometry and sheep from
//! `go1_sheep_config.py` and `npc/go1_sheep.py`, the paper's Go1Sheep-hard; the module above says
//! what differs.
//!
//! Sheep are discs. They wander, keep to their flock and flee from robots by the original's
//! formulas. Friction, which the original's physics engine computes, is a decay of their speed here.

use super::{
    DECISION, PLACE, ROBOTS, Robot, TICK, Track, UNIT, Wall, begin, commands, observed, privileged,
    tick,
};
use crate::env::frame::Frame;
use crate::env::multi_agent::{MultiAgentEnv, Simple};
use crate::env::picture::{Figure, FigureStatus, Picture};
use crate::env::spec::{Better, EnvSpec, OwnMetric};
use crate::rng::{self, Rng, Seed};

/// Decisions of an episode: 15 s.
const STEPS: u32 = 150;
/// Number of sheep, in three rows of three.
const SHEEP: usize = 9;
/// Length and width of the track, width of the gate, and how far the gate may be to the side in an
/// episode \[m\].
const TRACK: [f64; 2] = [15.0, 6.0];
const OPENING: f64 = 1.5;
const GATE: f64 = 8.5;
const DEVIATION: f64 = 1.0;
/// First place and spacing of the flock at the start, and how far a sheep may be from there \[m\].
const FLOCK: [f64; 2] = [3.5, -1.5];
const SPACING: f64 = 1.5;
const SCATTER: f64 = 0.3;
/// Changes of a sheep's velocity per tick: by chance, and by a robot \[m/s\].
const WANDER: f64 = 0.1;
const FLEE: f64 = 0.2;
/// Largest speed along an axis \[m/s\].
const FASTEST: f64 = 2.0;
/// Time constant with which a sheep's speed decays \[s\].
const FRICTION: f64 = 0.2;
/// Radius of a sheep \[m\].
const RADIUS: f64 = 0.2;

/// A sheep.
#[derive(Debug, Clone, Copy, Default)]
struct Sheep {
    place: [f64; 2],
    velocity: [f64; 2],
}

/// A world of the sheep task.
pub struct SheepSurrogate {
    spec: EnvSpec,
    track: Track,
    robots: [Robot; ROBOTS],
    sheep: [Sheep; SHEEP],
    rng: Rng,
    step: u32,
}

impl Default for SheepSurrogate {
    fn default() -> Self {
        Self::new()
    }
}

impl SheepSurrogate {
    /// Creates a world.
    pub fn new() -> Self {
        let mut observation = observed();
        observation.push("sheep", SHEEP, &PLACE);
        let mut state = privileged(&observation);
        let velocity = [("x", "m/s", -FASTEST as f32, FASTEST as f32), ("y", "m/s", -2.0, 2.0)];
        state.push("sheep_velocity", SHEEP, &velocity);
        let spec = EnvSpec {
            agents: ROBOTS,
            actions: commands(),
            observation,
            state,
            most_heard: None,
            metrics: vec![
                OwnMetric::count("sheep_through", Better::Higher)
                    .meaning("Sheep that are behind the gate at the end."),
            ],
        };
        Self {
            spec,
            track: Track::default(),
            robots: Default::default(),
            sheep: Default::default(),
            rng: Seed::new(0).rng(),
            step: 0,
        }
    }

    /// Returns an environment of such worlds.
    pub fn environment() -> Simple<impl Fn() -> Self + Send + Sync> {
        Simple::new("sheep_surrogate", Self::new).with_backdrop(Track::backdrop(TRACK))
    }

    fn through(&self) -> usize {
        self.sheep.iter().filter(|sheep| sheep.place[0] > self.track.gate[0]).count()
    }

    /// Moves the sheep for a tick.
    fn graze(&mut self) {
        let sides = self.sheep.map(|sheep| sheep.place[0] < self.track.gate[0]);
        let mean = [0, 1].map(|axis| {
            self.sheep.iter().map(|sheep| sheep.place[axis]).sum::<f64>() / SHEEP as f64
        });
        for sheep in &mut self.sheep {
            let mut chance = [0.0; 2];
            rng::fill_normal(&mut self.rng, &mut chance);
            let place = sheep.place;
            let home = [0, 1].map(|axis| mean[axis] - place[axis]);
            let away = home[0].hypot(home[1]).max(1e-6);
            let fears =
                self.robots.map(|robot| fear([place[0] - robot.pose.x, place[1] - robot.pose.y]));
            for axis in [0, 1] {
                let mut change = 2.0 * WANDER * f64::from(chance[axis]);
                change += WANDER * home[axis] / away / 1.5;
                change += fears.iter().map(|fear| FLEE * fear[axis]).sum::<f64>();
                let velocity = sheep.velocity[axis] * (1.0 - TICK / FRICTION) + change;
                sheep.velocity[axis] = velocity.clamp(-FASTEST, FASTEST);
                sheep.place[axis] += TICK * sheep.velocity[axis];
            }
        }
        // Sheep give way to each other, to robots and, last, to walls.
        for i in 0..SHEEP {
            for j in 0..i {
                let [a, b] = [self.sheep[i].place, self.sheep[j].place];
                push(&mut self.sheep[i].place, b, 2.0 * RADIUS);
                push(&mut self.sheep[j].place, a, 2.0 * RADIUS);
            }
        }
        for (sheep, before) in self.sheep.iter_mut().zip(sides) {
            for robot in &self.robots {
                push(&mut sheep.place, [robot.pose.x, robot.pose.y], RADIUS + 0.2);
            }
            for wall in &self.track.walls {
                let nearest = wall.nearest(sheep.place);
                push(&mut sheep.place, nearest, RADIUS);
            }
            // Whatever pushes a sheep, the wall across the track keeps it on its side.
            for Wall { low, high } in &self.track.walls[4..] {
                let [x, y] = sheep.place;
                let [left, right] = [low[0] - RADIUS, high[0] + RADIUS];
                if (low[1]..high[1]).contains(&y) {
                    sheep.place[0] = if before { x.min(left) } else { x.max(right) };
                }
            }
            let half = TRACK[1] / 2.0 - RADIUS;
            sheep.place[0] = sheep.place[0].clamp(RADIUS, TRACK[0] - RADIUS);
            sheep.place[1] = sheep.place[1].clamp(-half, half);
        }
    }

    fn show(&self, frame: &mut Frame) {
        let features = self.robots.map(|robot| robot.features());
        let gate = self.track.gate.map(|metres| (metres / UNIT) as f32);
        let places: Vec<f32> = self
            .sheep
            .iter()
            .flat_map(|sheep| sheep.place)
            .map(|metres| (metres / UNIT) as f32)
            .collect();
        let velocities: Vec<f32> =
            self.sheep.iter().flat_map(|sheep| sheep.velocity).map(|speed| speed as f32).collect();
        for i in 0..ROBOTS {
            let (own, other) = (features[i], features[1 - i]);
            let number = [f32::from(u8::from(i == 0)), f32::from(u8::from(i == 1))];
            let left = [1.0 - self.step as f32 / STEPS as f32];
            let seen = [&own[..4], &other[..4], &gate, &number, &places].concat();
            let more = [&own[4..], &other[4..], &left, &velocities].concat();
            frame.state_of(i).copy_from_slice(&[seen.as_slice(), &more].concat());
            frame.observation_of(i).copy_from_slice(&seen);
        }
    }
}

/// Returns the change of a sheep's velocity away from a robot, in units of [`FLEE`], by its place
/// relative to the robot \[m\].
fn fear(from: [f64; 2]) -> [f64; 2] {
    // The originals take the norm of the squared coordinates.
    let distance = from.map(|metres| metres * metres);
    let distance = distance[0].hypot(distance[1]).max(1e-3);
    if distance > 9.0 { [0.0; 2] } else { from.map(|metres| metres / distance.powf(1.4)) }
}

/// Moves a place away from a point until they are `apart` metres apart.
fn push(place: &mut [f64; 2], point: [f64; 2], apart: f64) {
    let from = [place[0] - point[0], place[1] - point[1]];
    let distance = from[0].hypot(from[1]);
    if distance < apart && distance > 1e-9 {
        *place = [0, 1].map(|axis| point[axis] + from[axis] * apart / distance);
    }
}

impl MultiAgentEnv for SheepSurrogate {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn reset(&mut self, seed: Seed, frame: &mut Frame) {
        self.rng = seed.rng();
        let gate = [GATE, DEVIATION * rng::symmetric(&mut self.rng)];
        self.track = Track::new(TRACK, gate, OPENING);
        self.robots = [[1.0, 1.0], [1.0, -1.0]].map(|place| Robot::near(&mut self.rng, place));
        for (k, sheep) in self.sheep.iter_mut().enumerate() {
            let place = [
                FLOCK[0] + SPACING * (k / 3) as f64 + SCATTER * rng::symmetric(&mut self.rng),
                FLOCK[1] + SPACING * (k % 3) as f64 + SCATTER * rng::symmetric(&mut self.rng),
            ];
            *sheep = Sheep { place, velocity: [0.0; 2] };
        }
        self.step = 0;
        begin(frame);
        self.show(frame);
    }

    fn step(&mut self, actions: &[f32], frame: &mut Frame) {
        self.step += 1;
        for _ in 0..(DECISION / TICK).round() as usize {
            tick(&mut self.robots, actions, &self.track);
            self.graze();
        }
        // The paper's mixed sheep reward, and 1 for each sheep that is through.
        let [x, y] = self.track.gate;
        let mixed = self.sheep.iter().map(|sheep| match sheep.place {
            place if place[0] >= x => 1.0,
            place => (-(place[0] - x).hypot(place[1] - y) / 2.0).exp(),
        });
        let reward = mixed.sum::<f64>() + self.through() as f64;
        frame.reward.fill(reward as f32);
        self.show(frame);
        if self.step == STEPS {
            (0..ROBOTS).for_each(|robot| frame.truncate(robot));
        }
    }

    /// Returns the share of the sheep that are through the gate.
    fn success(&self) -> f64 {
        self.through() as f64 / SHEEP as f64
    }

    fn metrics(&self) -> Vec<f64> {
        vec![self.through() as f64]
    }

    fn picture(&self) -> Option<Picture> {
        let sheep = self.sheep.iter().map(|sheep| Figure {
            centre: sheep.place,
            size: [2.0 * RADIUS; 2],
            status: FigureStatus::Active,
            ..Figure::default()
        });
        Some(Picture {
            agents: self.robots.iter().map(Robot::figure).collect(),
            others: self.track.figures().chain(sheep).collect(),
            ..Picture::default()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sheep flee from a robot that is near, by the originals' formula, and not from one that is
    /// far away.
    #[test]
    fn sheep_flee_from_robots() {
        // |(1², 0²)| = 1: the whole distance counts; |(2², 0²)| = 4: 2 / 4^1.4.
        assert_eq!(fear([1.0, 0.0]), [1.0, 0.0]);
        assert!((fear([0.0, -2.0])[1] + 2.0 / 4.0_f64.powf(1.4)).abs() < 1e-12);
        assert_eq!(fear([3.1, 0.0]), [0.0, 0.0]);
    }

    /// Each sheep earns e^(-d/2) of its distance d to the gate before it, and 2 behind it.
    #[test]
    fn rewards_are_those_of_the_paper() {
        let mut world = SheepSurrogate::new();
        let mut frame = Frame::new(world.spec(), false);
        world.reset(Seed::new(2), &mut frame);
        world.robots[0].pose.x = 0.5;
        for (k, sheep) in world.sheep.iter_mut().enumerate() {
            // Four sheep are far behind the gate, and stay there for a decision.
            let x = if k < 4 { GATE + 2.0 + k as f64 } else { 4.0 + 0.5 * k as f64 };
            *sheep = Sheep { place: [x, 0.5 * k as f64 - 2.0], velocity: [0.0; 2] };
        }
        world.step(&[0.0; 6], &mut frame);
        let gate = world.track.gate;
        let before = world.sheep.iter().filter(|sheep| sheep.place[0] < gate[0]);
        let before: f64 = before
            .map(|sheep| (-(sheep.place[0] - gate[0]).hypot(sheep.place[1] - gate[1]) / 2.0).exp())
            .sum();
        assert_eq!(world.through(), 4);
        assert!((f64::from(frame.reward[0]) - (8.0 + before)).abs() < 1e-5);
        assert_eq!(frame.reward[0], frame.reward[1]);
        assert!((world.success() - 4.0 / 9.0).abs() < 1e-12);
    }

    /// Sheep stay on the track and go through the wall by the gate alone, also where robots press
    /// them against the wall.
    #[test]
    fn sheep_stay_on_their_track() {
        let mut world = SheepSurrogate::new();
        let mut frame = Frame::new(world.spec(), false);
        let mut through = 0;
        for seed in 0..6 {
            world.reset(Seed::new(seed), &mut frame);
            let mut last = world.sheep;
            for _ in 0..STEPS {
                // Each robot drives at the sheep that is nearest to the wall.
                let near = |sheep: &&Sheep| world.track.gate[0] - sheep.place[0];
                let before = world.sheep.iter().filter(|sheep| near(sheep) > 0.0);
                let target = before.min_by(|a, b| near(a).total_cmp(&near(b)));
                let target = target.map_or([GATE, 0.0], |sheep| sheep.place);
                let actions: Vec<f32> = world
                    .robots
                    .iter()
                    .flat_map(|robot| {
                        let aside = (target[1] - robot.pose.y).clamp(-1.0, 1.0) as f32;
                        [0.6, aside, 0.0]
                    })
                    .collect();
                world.step(&actions, &mut frame);
                for (sheep, before) in world.sheep.iter().zip(&last) {
                    let [x, y] = sheep.place;
                    assert!((0.0..=TRACK[0]).contains(&x) && y.abs() <= TRACK[1] / 2.0);
                    let [gate_x, gate_y] = world.track.gate;
                    let crossed = (before.place[0] - gate_x) * (x - gate_x) < 0.0;
                    assert!(!crossed || (y - gate_y).abs() < OPENING / 2.0, "{sheep:?}");
                    through += u32::from(crossed);
                }
                last = world.sheep;
            }
        }
        assert!(through > 10, "{through} sheep went through the gate");
        // Without robots near them, they stay where they are.
        world.reset(Seed::new(0), &mut frame);
        for _ in 0..STEPS {
            world.step(&[0.0; 6], &mut frame);
        }
        assert!(world.through() < 2, "{} sheep went by themselves", world.through());
    }
}
