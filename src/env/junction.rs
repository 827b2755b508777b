//! Traffic junction (Sukhbaatar et al. 2016, "Learning multiagent communication with
//! backpropagation"; IC3Net and MAGIC, `traffic_junction_env.py`): cars on a grid enter a junction
//! by given routes, and each only chooses whether to move or to stay. Cars do not observe each
//! other, so that they depend on messages.
//!
//! In each step, a new car comes at each entry with a probability, as long as a slot is free. It may
//! come onto an occupied cell. Cars in one cell collide and go on. An episode is a success if nobody
//! collides in it.
//!
//! Differences from IC3Net and MAGIC on purpose:
//!
//! - A car observes its own cell and route, and nothing of its surroundings (IC3Net's vision 0;
//!   MAGIC's script has 1).
//! - In each episode of a training, cars come with another probability, from a range whose upper
//!   end is that of evaluations (IC3Net: ever more often; MAGIC: always as in evaluations).
//! - A car that comes onto an occupied cell gets no reward for the collision in that step, because
//!   it has not acted yet; the other car does.
//! - A slot becomes free one step after its car has left.
//! - The privileged state also has the car's age and the time that is left, on which its rewards
//!   depend.
//!
//! The paper's motivating example (its appendix, "Simple Traffic Junction") has the medium grid, 10
//! cars and 40 steps as well. There, cars can also make a U-turn, observe the route alone, without
//! their cell, and share one reward; it does not say the amounts of rewards and arrivals.

use std::collections::BTreeMap;

use rand::RngExt as _;

use super::frame::Frame;
use super::multi_agent::{MultiAgentEnv, Simple};
use super::picture::{Backdrop, Figure, FigureStatus, Lane, Picture};
use super::spec::{ActionSpace, Better, EnvSpec, Features, OwnMetric};
use crate::rng::{self, Rng, Seed};

/// Reward of a car in a collision, and of each step that a car has been on the road.
const COLLISION: f32 = -10.0;
const WAITING: f32 = -0.01;
/// Number of other cars in the privileged state.
const NEAREST: usize = 4;
/// Scale of distances and numbers of steps in features.
const FAR: f32 = 14.0;

/// A cell, by row from the top and column from the left.
type Cell = [i32; 2];

/// Which grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum JunctionSize {
    /// Two one-way roads on a grid of 7 × 7 cells (IC3Net's `--dim 6`, to which it adds 1), 5 cars,
    /// 20 steps.
    Easy,
    /// Two roads for both directions on a grid of 14 × 14 cells, each car straight, right or left,
    /// 10 cars, 40 steps.
    Medium,
}

impl JunctionSize {
    fn side(self) -> i32 {
        match self {
            Self::Easy => 7,
            Self::Medium => 14,
        }
    }

    fn cars(self) -> usize {
        match self {
            Self::Easy => 5,
            Self::Medium => 10,
        }
    }

    fn steps(self) -> u32 {
        match self {
            Self::Easy => 20,
            Self::Medium => 40,
        }
    }

    /// Returns the cells of each route from each entry.
    fn routes(self) -> Vec<Vec<Vec<Cell>>> {
        let (side, middle) = (self.side(), self.side() / 2);
        let down = |column: i32, from: i32, to: i32| (from..to).map(move |row| [row, column]);
        match self {
            Self::Easy => {
                let first: Vec<Cell> = down(middle, 0, side).collect();
                let second = first.iter().map(|[row, column]| [*column, *row]).collect();
                vec![vec![first], vec![second]]
            }
            Self::Medium => {
                let column = middle - 1;
                let straight: Vec<Cell> = down(column, 0, side).collect();
                let west = (0..column).rev().map(|column| [middle - 1, column]);
                let right: Vec<Cell> = down(column, 0, middle).chain(west).collect();
                let east = (column + 1..side).map(|column| [middle, column]);
                let left: Vec<Cell> = down(column, 0, middle + 1).chain(east).collect();
                let from_top = [straight, right, left];
                // Entries at the top, the bottom, the left and the right.
                let turned = |turns: usize| {
                    let turn = |[row, column]: Cell| [column, side - 1 - row];
                    let cell = |cell: &Cell| (0..turns).fold(*cell, |cell, _| turn(cell));
                    from_top.iter().map(|route| route.iter().map(cell).collect()).collect()
                };
                [0, 2, 3, 1].map(turned).to_vec()
            }
        }
    }
}

/// A car on the road.
#[derive(Debug, Clone, Copy, Default)]
struct Car {
    entry: usize,
    route: usize,
    /// Number of the car's cell on its route.
    at: usize,
    /// Steps since the car came.
    age: u32,
    stayed: bool,
    collides: bool,
}

/// A world of the traffic junction.
pub struct TrafficJunction {
    size: JunctionSize,
    /// Range of the probability that a car comes at an entry in a step: training draws from it for
    /// each episode, evaluations have its upper end.
    arrivals: [f64; 2],
    spec: EnvSpec,
    /// Cells by entry and route.
    routes: Vec<Vec<Vec<Cell>>>,
    /// All cells of the roads, in order.
    roads: Vec<Cell>,
    cars: Vec<Option<Car>>,
    arrival: f64,
    rng: Rng,
    step: u32,
    collisions: u32,
    came: u32,
}

impl TrafficJunction {
    /// Creates a world. `arrivals`: range of the probability that a car comes at an entry in a step,
    /// of which evaluations have the upper end.
    pub fn new(size: JunctionSize, arrivals: [f64; 2]) -> Self {
        let routes = size.routes();
        let flag = |name| (name, "1", 0.0, 1.0);
        let mut roads: Vec<Cell> = routes.iter().flatten().flatten().copied().collect();
        roads.sort_unstable();
        roads.dedup();
        let mut own = vec![flag("present"), flag("stayed")];
        own.extend(["straight", "right", "left"].map(flag));
        let mut observation = Features::default();
        observation.push("own", 1, &own);
        observation.push("cell", roads.len(), &[flag("here")]);
        let mut state = observation.clone();
        state.push("time", 1, &[flag("age"), flag("time_left")]);
        let cells = |name| (name, "14 cells", -1.0, 1.0);
        let mut other = vec![flag("present"), cells("rows"), cells("columns")];
        other.extend(["straight", "right", "left"].map(flag));
        state.push("other", NEAREST, &other);
        let spec = EnvSpec {
            agents: size.cars(),
            actions: ActionSpace::Discrete(vec!["move", "stay"]),
            observation,
            state,
            most_heard: None,
            metrics: vec![
                OwnMetric::count("collisions", Better::Lower)
                    .meaning("Cars in a cell with another car, added up over the steps."),
                OwnMetric::count("cars", Better::Neither).meaning("Cars that came."),
            ],
        };
        Self {
            size,
            arrivals,
            spec,
            routes,
            roads,
            cars: vec![None; size.cars()],
            arrival: 0.0,
            rng: Seed::new(0).rng(),
            step: 0,
            collisions: 0,
            came: 0,
        }
    }

    /// Returns an environment of such worlds, with the roads in pictures.
    pub fn environment(
        size: JunctionSize,
        arrivals: [f64; 2],
    ) -> Simple<impl Fn() -> Self + Send + Sync> {
        let roads = size.routes().into_iter().map(|routes| Lane {
            id: "road".to_owned(),
            width: 1.0,
            internal: false,
            crossing: false,
            shape: routes[0].iter().copied().map(centre).collect(),
        });
        let backdrop = Backdrop {
            step_length: 1.0,
            size: [0.8, 0.5],
            range: f64::INFINITY,
            lanes: roads.collect(),
            ..Backdrop::default()
        };
        let name = match size {
            JunctionSize::Easy => "traffic_junction_easy",
            JunctionSize::Medium => "traffic_junction",
        };
        Simple::new(name, move || Self::new(size, arrivals)).with_backdrop(backdrop)
    }

    fn cell(&self, car: &Car) -> Cell {
        self.routes[car.entry][car.route][car.at]
    }

    /// Begins an episode.
    fn begin(&mut self, frame: &mut Frame) {
        self.cars.fill(None);
        (self.step, self.collisions, self.came) = (0, 0, 0);
        self.arrive(frame);
        self.collide();
        self.show(frame);
    }

    /// Lets new cars come.
    fn arrive(&mut self, frame: &mut Frame) {
        for entry in 0..self.routes.len() {
            let free: Vec<usize> =
                (0..self.cars.len()).filter(|&i| self.cars[i].is_none()).collect();
            if free.is_empty() || self.rng.random::<f64>() > self.arrival {
                continue;
            }
            let slot = free[rng::below(&mut self.rng, free.len())];
            let route = rng::below(&mut self.rng, self.routes[entry].len());
            self.cars[slot] = Some(Car { entry, route, ..Car::default() });
            self.came += 1;
            frame.begin_agent(slot);
        }
    }

    /// Notes which cars are in one cell with another one.
    fn collide(&mut self) {
        let mut count: BTreeMap<Cell, u32> = BTreeMap::new();
        let cells: Vec<Option<Cell>> =
            self.cars.iter().map(|car| Some(self.cell(car.as_ref()?))).collect();
        for cell in cells.iter().flatten() {
            *count.entry(*cell).or_default() += 1;
        }
        for (car, cell) in self.cars.iter_mut().zip(cells) {
            if let (Some(car), Some(cell)) = (car, cell) {
                car.collides = count[&cell] > 1;
                self.collisions += u32::from(car.collides);
            }
        }
    }

    fn show(&self, frame: &mut Frame) {
        let n = self.cars.len();
        let here = |i: usize| f32::from(u8::from(self.cars[i].is_some()));
        for i in 0..n {
            for j in 0..n {
                frame.comm[i * n + j] = here(i) * here(j);
            }
            let (seen, known) = (self.spec.observation.len(), self.spec.state.len());
            let mut all = vec![0.0; known];
            if let Some(car) = &self.cars[i] {
                self.describe(i, car, &mut all);
            }
            frame.observation_of(i).copy_from_slice(&all[..seen]);
            frame.state_of(i).copy_from_slice(&all);
        }
    }

    /// Writes the privileged state of a car, which begins with its observation.
    fn describe(&self, slot: usize, car: &Car, all: &mut [f32]) {
        let cell = self.cell(car);
        let [row, column] = cell;
        (all[0], all[1]) = (1.0, f32::from(u8::from(car.stayed)));
        all[2 + car.route] = 1.0;
        let here = self.roads.binary_search(&cell).expect("routes are on roads");
        all[5 + here] = 1.0;
        let all = &mut all[self.spec.observation.len()..];
        let others = self.cars.iter().enumerate().filter(|(j, _)| *j != slot);
        let mut others: Vec<(Cell, usize)> = others
            .filter_map(|(_, other)| Some((self.cell(other.as_ref()?), other.as_ref()?.route)))
            .map(|([r, c], route)| ([r - row, c - column], route))
            .collect();
        others.sort_by_key(|([rows, columns], route)| {
            (rows.abs() + columns.abs(), *rows, *columns, *route)
        });
        let steps = self.size.steps() as f32;
        (all[0], all[1]) = (car.age as f32 / steps, 1.0 - self.step as f32 / steps);
        for (([rows, columns], route), out) in others.into_iter().zip(all[2..].chunks_exact_mut(6))
        {
            out[..3].copy_from_slice(&[1.0, rows as f32 / FAR, columns as f32 / FAR]);
            out[3 + route] = 1.0;
        }
    }
}

/// Returns the centre of a cell in pictures, where the y axis points up.
fn centre([row, column]: Cell) -> [f64; 2] {
    [f64::from(column), -f64::from(row)]
}

impl MultiAgentEnv for TrafficJunction {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn reset(&mut self, seed: Seed, frame: &mut Frame) {
        self.rng = seed.rng();
        self.arrival = self.arrivals[1];
        self.begin(frame);
    }

    /// Begins an episode with a probability of arrivals that is drawn from the range.
    fn reset_for_training(&mut self, seed: Seed, frame: &mut Frame) {
        self.rng = seed.rng();
        let [least, most] = self.arrivals;
        self.arrival = least + (most - least) * self.rng.random::<f64>();
        self.begin(frame);
    }

    fn step(&mut self, actions: &[f32], frame: &mut Frame) {
        self.step += 1;
        for (i, action) in actions.iter().enumerate() {
            let Some(mut car) = self.cars[i] else { continue };
            car.age += 1;
            car.stayed = *action > 0.5;
            car.at += usize::from(!car.stayed);
            let leaves = car.at >= self.routes[car.entry][car.route].len();
            self.cars[i] = (!leaves).then_some(car);
            if leaves {
                frame.end(i);
            }
        }
        // A slot that has been left is free from the next step on, so that its end can be seen.
        let left: Vec<usize> =
            (0..self.cars.len()).filter(|&i| frame.terminated[i] > 0.0).collect();
        for &i in &left {
            self.cars[i] = Some(Car::default());
        }
        self.arrive(frame);
        for &i in &left {
            self.cars[i] = None;
        }
        self.collide();
        for (i, car) in self.cars.iter().enumerate() {
            if let Some(car) = car.filter(|car| car.age > 0) {
                frame.reward[i] = WAITING * car.age as f32;
                frame.reward[i] += if car.collides { COLLISION } else { 0.0 };
            }
        }
        self.show(frame);
        if self.step == self.size.steps() {
            for i in 0..self.cars.len() {
                if frame.active[i] > 0.0 {
                    frame.truncate(i);
                }
            }
        }
    }

    fn goes_on(&self) -> bool {
        self.step < self.size.steps()
    }

    fn success(&self) -> f64 {
        f64::from(u8::from(self.collisions == 0))
    }

    fn metrics(&self) -> Vec<f64> {
        vec![f64::from(self.collisions), f64::from(self.came)]
    }

    fn picture(&self) -> Option<Picture> {
        let figure = |car: &Option<Car>| {
            let Some(car) = car else { return Figure::default() };
            let route = &self.routes[car.entry][car.route];
            let (here, next) = (centre(self.cell(car)), route.get(car.at + 1));
            let before = centre(route[car.at.saturating_sub(1)]);
            let [dx, dy] = match next {
                Some(next) => [centre(*next)[0] - here[0], centre(*next)[1] - here[1]],
                None => [here[0] - before[0], here[1] - before[1]],
            };
            Figure {
                centre: here,
                heading: dy.atan2(dx),
                size: [0.8, 0.5],
                speed: if car.stayed { 0.0 } else { 1.0 },
                status: if car.collides { FigureStatus::Failed } else { FigureStatus::Active },
            }
        };
        Some(Picture { agents: self.cars.iter().map(figure).collect(), ..Picture::default() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lengths and turns are those of the reference.
    #[test]
    fn routes_are_those_of_the_reference() {
        let routes = JunctionSize::Medium.routes();
        assert_eq!(routes.len(), 4);
        for routes in &routes {
            assert_eq!(routes.iter().map(Vec::len).collect::<Vec<_>>(), [14, 13, 15]);
            for route in routes {
                for pair in route.windows(2) {
                    let [[r, c], [next_r, next_c]] = [pair[0], pair[1]];
                    assert_eq!((next_r - r).abs() + (next_c - c).abs(), 1, "{route:?}");
                }
            }
        }
        let entries: Vec<Cell> = routes.iter().map(|routes| routes[0][0]).collect();
        assert_eq!(entries, [[0, 6], [13, 7], [7, 0], [6, 13]]);
        let ends: Vec<Cell> = routes[0].iter().map(|route| route[route.len() - 1]).collect();
        assert_eq!(ends, [[13, 6], [6, 0], [7, 13]]);
        let easy = JunctionSize::Easy.routes();
        let down: Vec<Cell> = (0..7).map(|row| [row, 3]).collect();
        let right: Vec<Cell> = (0..7).map(|column| [3, column]).collect();
        assert_eq!(easy, [[down], [right]]);
    }

    fn play(seed: u64, choose: impl Fn(&TrafficJunction, usize) -> f32) -> (TrafficJunction, f32) {
        let mut world = TrafficJunction::new(JunctionSize::Medium, [0.2, 0.2]);
        let mut frame = Frame::new(world.spec(), false);
        world.reset(Seed::new(seed), &mut frame);
        let mut sum = 0.0;
        while world.goes_on() {
            let actions: Vec<f32> = (0..world.cars.len()).map(|i| choose(&world, i)).collect();
            let before = frame.active.clone();
            frame.begin(false);
            frame.reward.fill(0.0);
            world.step(&actions, &mut frame);
            for (i, acted) in before.iter().enumerate() {
                let ended = frame.terminated[i] + frame.truncated[i] > 0.0;
                assert!(*acted == 0.0 || frame.active[i] > 0.0 || ended);
                assert!(!(frame.terminated[i] > 0.0 && frame.start[i] > 0.0), "one at a time");
            }
            sum += frame.reward.iter().sum::<f32>();
        }
        (world, sum)
    }

    /// A car that never stops passes in as many steps as its route has cells, and costs what its
    /// steps cost; cars in one cell collide.
    #[test]
    fn cars_move_wait_and_collide() {
        let (always, _) = play(3, |_, _| 0.0);
        assert!(always.came > 10 && always.collisions > 0);
        // A car that stays at its entry collides with the next one that comes there.
        let (never, reward) = play(3, |_, _| 1.0);
        assert!(never.collisions > 100 && reward < -1000.0, "{} {reward}", never.collisions);
        let mut world = TrafficJunction::new(JunctionSize::Medium, [0.0, 0.0]);
        let mut frame = Frame::new(world.spec(), false);
        world.reset(Seed::new(1), &mut frame);
        world.cars[2] = Some(Car { entry: 0, route: 1, ..Car::default() });
        frame.begin_agent(2);
        let mut sum = 0.0;
        for step in 1..=13 {
            frame.begin(false);
            frame.reward.fill(0.0);
            world.step(&[0.0; 10], &mut frame);
            sum += frame.reward[2];
            assert_eq!(frame.terminated[2] > 0.0, step == 13, "{step}");
        }
        assert!((sum + 0.01 * 78.0).abs() < 1e-5, "12 steps on the road: {sum}");
        assert!((world.success() - 1.0).abs() < f64::EPSILON);
    }

    /// What a car observes depends on itself alone.
    #[test]
    fn nobody_sees_the_others() {
        let mut world = TrafficJunction::new(JunctionSize::Medium, [0.0, 0.0]);
        let mut frame = Frame::new(world.spec(), false);
        world.reset(Seed::new(1), &mut frame);
        let car = |entry, at| Some(Car { entry, at, ..Car::default() });
        world.cars[0] = car(0, 5);
        world.show(&mut frame);
        let (alone, known) = (frame.observation_of(0).to_vec(), frame.state_of(0).to_vec());
        world.cars[1] = car(2, 4);
        world.show(&mut frame);
        assert_eq!(frame.observation_of(0), alone);
        assert_ne!(frame.state_of(0), known);
        assert_eq!((frame.comm[1], frame.comm[2]), (1.0, 0.0));
    }
}
