//! Background traffic: the vehicles that SUMO drives, and pedestrians. This module decides when
//! they depart, reads where they are, turns them into wrecks after collisions, and records their
//! encounters with agents.
//!
//! Background traffic occupies the slots behind the agents'. First come the vehicles that start at
//! spawn places, then those of the route files, as many as the scenario's capacity allows. A
//! background vehicle that collides with an agent or a wreck becomes a wreck itself, for as long
//! as an agent's wreck. Collisions of background vehicles with each other are left to SUMO.

use rand::RngExt as _;

use super::super::geometry::{Pose, time_to_contact};
use super::super::metrics::BackgroundMetrics as Record;
use super::super::slots::{EMPTY, Slot, Status};
use super::super::task::Task;
use super::World;
use super::motion::NO_CHECKS;
use crate::rng::{Rng, Seed};
use crate::scenario::Spacing;
use crate::sumo::{Command, Snapshot};

/// Deceleration above which braking counts as hard \[m/s²\]. SUMO's cars, which brake with
/// 4.5 m/s² and some imprecision, do not exceed this value by themselves.
const HARD: f64 = 6.0;
/// Time to collision below which an agent counts as close \[s\].
const CLOSE: f64 = 1.5;
/// Upper limit of times to collision and post-encroachment times \[s\]. Vehicles further apart in
/// time do not affect each other.
const HORIZON: f64 = 5.0;

/// Departure times of a vehicle or flow of the route files.
#[derive(Debug, Clone)]
struct Clock {
    rng: Rng,
    /// Next departure, counted from the start of the episode \[s\].
    next: f64,
    /// Number of departures left.
    left: u64,
}

/// What is recorded about one background vehicle.
#[derive(Debug, Clone, Copy, Default)]
struct RoadUser {
    /// SUMO's time loss of the vehicle \[s\].
    time_loss: f64,
    /// The vehicle's hardest braking \[m/s²\].
    braking: f64,
    /// Whether an agent came closer than [`CLOSE`] or the vehicle crashed.
    close: bool,
    /// Whether the vehicle collided with an agent or a wreck.
    crashed: bool,
    /// Whether SUMO has been told to stop the vehicle, which is a wreck.
    stopped: bool,
}

/// Times at which an agent and a background vehicle passed their conflict point \[s\]: when the
/// front of each entered and when its rear left.
#[derive(Debug, Clone, Copy)]
struct Pass {
    agent: [f64; 2],
    other: [f64; 2],
}

const NOT_YET: Pass = Pass { agent: [f64::INFINITY; 2], other: [f64::INFINITY; 2] };

/// The background traffic of an episode.
#[derive(Debug, Clone)]
pub(super) struct BackgroundState {
    clocks: Vec<Clock>,
    road_users: Vec<RoadUser>,
    /// Times at the conflict points, `[N, others]`.
    passes: Vec<Pass>,
    /// Records of the vehicles that have left the road, and those of the pedestrians that have.
    left: [Vec<RoadUser>; 2],
    /// Smallest time to collision with an agent so far \[s\].
    ttc: f64,
    /// Smallest post-encroachment time with an agent so far \[s\].
    pet: f64,
}

impl BackgroundState {
    pub(super) fn new(task: &Task) -> Self {
        Self {
            clocks: Vec::with_capacity(task.demand.sources.len()),
            road_users: vec![RoadUser::default(); task.others],
            passes: vec![NOT_YET; task.agents * task.others],
            left: [Vec::with_capacity(4 * task.others), Vec::with_capacity(4 * task.others)],
            ttc: HORIZON,
            pet: HORIZON,
        }
    }

    /// Begins a new episode.
    fn begin(&mut self, task: &Task, seed: Seed) {
        self.clocks.clear();
        for (index, source) in task.demand.sources.iter().enumerate() {
            let mut clock = Clock {
                rng: seed.index(index as u64).rng(),
                next: source.begin,
                left: source.number,
            };
            if !matches!(source.spacing, Spacing::Equal(_)) {
                clock.next += gap(source.spacing, &mut clock.rng);
            }
            self.clocks.push(clock);
        }
        self.road_users.fill(RoadUser::default());
        self.passes.fill(NOT_YET);
        self.left.iter_mut().for_each(Vec::clear);
        (self.ttc, self.pet) = (HORIZON, HORIZON);
    }

    /// Stores the record of a vehicle that has left the road, so that its slot may be used again.
    fn dismiss(&mut self, road_user: usize, walks: bool) {
        self.left[usize::from(walks)].push(std::mem::take(&mut self.road_users[road_user]));
        let others = self.road_users.len();
        for row in self.passes.chunks_mut(others) {
            row[road_user] = NOT_YET;
        }
    }
}

/// Returns the seconds to the next departure.
fn gap(spacing: Spacing, rng: &mut Rng) -> f64 {
    match spacing {
        Spacing::Equal(gap) => gap,
        Spacing::Poisson(rate) => -(1.0 - rng.random::<f64>()).ln() / rate,
        // Number of attempts, one per second, until the first success.
        Spacing::Chance(p) if p >= 1.0 => 1.0,
        Spacing::Chance(p) => ((1.0 - rng.random::<f64>()).ln() / (-p).ln_1p()).ceil().max(1.0),
    }
}

/// Draws an index from a list of indices and weights.
fn draw(mix: &[(usize, f64)], rng: &mut Rng) -> usize {
    if let [(only, _)] = mix {
        return *only;
    }
    let mut left = rng.random::<f64>() * mix.iter().map(|entry| entry.1).sum::<f64>();
    let hit = mix.iter().find(|(_, weight)| {
        left -= weight;
        left < 0.0
    });
    hit.or(mix.last()).map_or(0, |entry| entry.0)
}

impl World {
    /// Empties the slots of background traffic and adds the vehicles that start at spawn places,
    /// given as route and position of the centre \[m\].
    pub(super) fn spawn_others(
        &mut self,
        world: u32,
        places: &[(usize, f64)],
        commands: &mut Vec<Command>,
    ) {
        let task = std::sync::Arc::clone(&self.task);
        let seed = self.seed.index(self.episode).child("traffic");
        self.others.begin(&task, seed);
        let mut rng = seed.child("places").rng();
        for i in task.agents..task.slots() {
            let slot = &mut self.traffic.slots[i];
            if slot.added {
                commands.push(Command::Remove { world, slot: i as u32 });
            }
            *slot = EMPTY;
        }
        for (i, &(route, s)) in (task.agents..).zip(places) {
            let (vehicle_type, size) = task.place_type(draw(&task.place_mix, &mut rng));
            self.traffic.slots[i] = Slot { route, size, added: true, ..EMPTY };
            let depart_pos = s + size[0] / 2.0;
            commands.push(Command::Add {
                world,
                slot: i as u32,
                route: route as u32,
                vehicle_type,
                depart_pos,
                depart_speed: 0.0,
            });
        }
        self.let_depart(world, commands);
    }

    /// Appends the commands of the coming exchange for background traffic.
    pub(super) fn act_others(&mut self, world: u32, commands: &mut Vec<Command>) {
        let first = self.task.agents;
        for (i, slot) in self.traffic.slots.iter_mut().enumerate().skip(first) {
            if slot.status != Status::Wreck {
                continue;
            }
            let at = i as u32;
            if slot.wreck_steps == 0 {
                self.others.dismiss(i - first, self.task.routes[slot.route].is_walked());
                *slot = EMPTY;
                commands.push(Command::Remove { world, slot: at });
                continue;
            }
            slot.wreck_steps -= 1;
            if !std::mem::replace(&mut self.others.road_users[i - first].stopped, true) {
                commands.push(Command::SpeedMode { world, slot: at, mode: NO_CHECKS });
                commands.push(Command::SetSpeed { world, slot: at, speed: 0.0 });
            }
        }
        self.let_depart(world, commands);
    }

    /// Lets the vehicles of the route files depart whose time has come, as long as slots are free;
    /// the other vehicles wait.
    fn let_depart(&mut self, world: u32, commands: &mut Vec<Command>) {
        let task = &*self.task;
        let now = f64::from(self.step) * task.scenario.control.interval;
        let first = task.agents + task.placed();
        for (index, (source, clock)) in
            task.demand.sources.iter().zip(&mut self.others.clocks).enumerate()
        {
            // The margin is half a millisecond: SUMO's times are whole milliseconds, and our sums
            // are rounded.
            while clock.left > 0 && clock.next <= now + 5e-4 && clock.next < source.end {
                let free = |slot: &Slot| slot.status == Status::Empty && !slot.added;
                let Some(i) = (first..task.slots()).find(|&i| free(&self.traffic.slots[i])) else {
                    return;
                };
                let kind = draw(&source.types, &mut clock.rng);
                clock.next += gap(source.spacing, &mut clock.rng);
                clock.left -= 1;
                let (vehicle_type, size) = task.demand_type(kind);
                let route = task.demand_routes[source.route];
                self.traffic.slots[i] = Slot { route, size, added: true, ..EMPTY };
                commands.push(Command::Depart {
                    world,
                    slot: i as u32,
                    departure: index as u32,
                    vehicle_type,
                });
            }
        }
    }

    /// Reads from the snapshot where the background vehicles are, and which have come or gone.
    pub(super) fn place_others(&mut self, world: u32, snapshot: &Snapshot) {
        let task = &*self.task;
        let (first, interval) = (task.agents, task.scenario.control.interval);
        for (i, slot) in self.traffic.slots.iter_mut().enumerate().skip(first) {
            let at = world as usize * task.slots() + i;
            let (body, state) = (snapshot.bodies.get(at), snapshot.vehicles.get(at));
            let (Some(body), Some(state)) = (body.copied().flatten(), state.copied().flatten())
            else {
                if slot.departed {
                    // The vehicle came to the end of its route.
                    self.others.dismiss(i - first, task.routes[slot.route].is_walked());
                    *slot = EMPTY;
                }
                continue;
            };
            let route = &task.routes[slot.route];
            let (sin, cos) = body.heading.sin_cos();
            let half = slot.size[0] / 2.0;
            let pose =
                Pose { x: body.x - half * cos, y: body.y - half * sin, heading: body.heading };
            let front = [body.x, body.y];
            let road_user = &mut self.others.road_users[i - first];
            if slot.departed {
                slot.before = slot.pose;
                let (s, _, segment) = route.lanes().project(front, slot.segment);
                (slot.s, slot.segment) = (route.on_way(s - half), segment);
                if slot.status == Status::Active {
                    road_user.braking =
                        road_user.braking.max((slot.speed - state.speed) / interval);
                }
            } else {
                slot.before = pose;
                let (s, _, segment) = route.lanes().nearest(front);
                (slot.s, slot.segment) = (route.on_way(s - half), segment);
                (slot.departed, slot.status) = (true, Status::Active);
            }
            (slot.pose, slot.speed) = (pose, state.speed);
            if slot.status == Status::Active {
                road_user.time_loss = body.time_loss;
            }
        }
    }

    /// Turns background vehicles that crashed in the step into wrecks, and records how near agents
    /// came to the others.
    pub(super) fn meet_others(&mut self, wreck_steps: u32) {
        let task = &*self.task;
        let first = task.agents;
        let slots = &mut self.traffic.slots;
        for i in first..slots.len() {
            let road_user = &mut self.others.road_users[i - first];
            if self.partners[i].is_some() && slots[i].status == Status::Active {
                (slots[i].status, slots[i].wreck_steps, slots[i].speed) =
                    (Status::Wreck, wreck_steps, 0.0);
                road_user.crashed = true;
                road_user.close = true;
                (self.others.ttc, self.others.pet) = (0.0, 0.0);
            }
            if slots[i].status != Status::Active {
                continue;
            }
            for agent in (0..first).filter(|&agent| slots[agent].status == Status::Active) {
                let ttc = time_to_collision(&slots[agent], &slots[i]);
                self.others.ttc = self.others.ttc.min(ttc);
                road_user.close |= ttc < CLOSE;
                let Some(met) = task.routes[slots[agent].route].meeting(slots[i].route) else {
                    continue;
                };
                let now = f64::from(self.step) * task.scenario.control.interval;
                let pass = &mut self.others.passes[agent * task.others + (i - first)];
                note(&mut pass.agent, &slots[agent], met.own, slots[i].size[1], now);
                note(&mut pass.other, &slots[i], met.other, slots[agent].size[1], now);
                self.others.pet = self.others.pet.min(post_encroachment(pass));
            }
        }
    }

    /// Returns whether a slot's vehicle is a pedestrian.
    pub(super) fn is_pedestrian(&self, slot: &Slot) -> bool {
        self.task.routes[slot.route].is_walked()
    }

    /// Returns the summary of the background traffic of the episode; `None` in tasks without any.
    pub(super) fn others_record(&self) -> Option<Record> {
        if self.task.others == 0 {
            return None;
        }
        let here = self.traffic.slots[self.task.agents..].iter().zip(&self.others.road_users);
        let of_kind = |walks: bool| -> Vec<&RoadUser> {
            let here =
                here.clone().filter(|(slot, _)| slot.departed && self.is_pedestrian(slot) == walks);
            self.others.left[usize::from(walks)]
                .iter()
                .chain(here.map(|(_, road_user)| road_user))
                .collect()
        };
        let (drivers, walkers) = (of_kind(false), of_kind(true));
        let share = |of: &[&RoadUser], is: fn(&RoadUser) -> bool| {
            of.iter().filter(|road_user| is(road_user)).count() as f64 / of.len().max(1) as f64
        };
        let mean = |of: fn(&RoadUser) -> f64| {
            drivers.iter().map(|road_user| of(road_user)).sum::<f64>() / drivers.len().max(1) as f64
        };
        Some(Record {
            vehicles: drivers.len() as u32,
            crash: share(&drivers, |road_user| road_user.crashed),
            delay: mean(|road_user| road_user.time_loss),
            braking: mean(|road_user| road_user.braking),
            hard_braking: share(&drivers, |road_user| road_user.braking > HARD),
            close: share(&drivers, |road_user| road_user.close),
            pedestrians: walkers.len() as u32,
            pedestrian_crash: share(&walkers, |road_user| road_user.crashed),
            pedestrian_close: share(&walkers, |road_user| road_user.close),
            ttc: self.others.ttc,
            pet: self.others.pet,
        })
    }
}

/// Returns the time from when the first of two vehicles left a place until the second reached
/// it \[s\]. It is 0 if both were there at once, and infinite as long as one of them has not
/// reached the place.
fn post_encroachment(pass: &Pass) -> f64 {
    let (first, second) = if pass.agent[0] <= pass.other[0] {
        (pass.agent, pass.other)
    } else {
        (pass.other, pass.agent)
    };
    if second[0].is_infinite() { f64::INFINITY } else { (second[0] - first[1]).max(0.0) }
}

/// Notes when the front of a vehicle reaches a conflict point on its route, and when its rear has
/// left it. The conflict point is as long as the vehicle that crosses there is wide.
fn note(times: &mut [f64; 2], slot: &Slot, place: f64, wide: f64, now: f64) {
    let half = slot.size[0] / 2.0;
    for (time, passed) in times
        .iter_mut()
        .zip([slot.s + half >= place - wide / 2.0, slot.s - half >= place + wide / 2.0])
    {
        if passed && time.is_infinite() {
            *time = now;
        }
    }
}

/// Returns the time until two vehicles touch if both keep their speeds and headings, at most
/// [`HORIZON`] \[s\].
fn time_to_collision(a: &Slot, b: &Slot) -> f64 {
    let reach = (a.size[0] + a.size[1] + b.size[0] + b.size[1]) / 2.0;
    if a.pose.distance(&b.pose) > reach + HORIZON * (a.speed.abs() + b.speed.abs()) {
        return HORIZON;
    }
    let contact = time_to_contact((&a.pose, a.size, a.speed), (&b.pose, b.size, b.speed));
    contact.map_or(HORIZON, |time| time.min(HORIZON))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a vehicle of 4 m length with its centre at `s` and with this speed.
    fn at(s: f64, speed: f64) -> Slot {
        let pose = Pose { x: s, y: 0.0, heading: 0.0 };
        Slot { size: [4.0, 2.0], s, speed, pose, ..EMPTY }
    }

    /// Returns the post-encroachment time of two vehicles at 10 m/s whose routes cross 50 m from
    /// both starts. The other vehicle reaches the conflict point `late` seconds after the agent.
    fn encounter(late: f64) -> f64 {
        let (mut pass, mut least) = (NOT_YET, f64::INFINITY);
        for step in 0..200 {
            let now = f64::from(step) * 0.1;
            note(&mut pass.agent, &at(10.0 * now, 10.0), 50.0, 2.0, now);
            note(&mut pass.other, &at(10.0 * (now - late), 10.0), 50.0, 2.0, now);
            least = least.min(post_encroachment(&pass));
        }
        least
    }

    #[test]
    fn post_encroachment_is_the_time_between_leaving_and_coming() {
        // A vehicle occupies the place while its centre drives from 47 m (front at 49 m) to 53 m
        // (rear at 51 m), which takes 0.6 s.
        for (late, expected) in
            [(2.0, 1.4), (-2.0, 1.4), (0.3, 0.0), (0.0, 0.0), (19.0, f64::INFINITY)]
        {
            let found = encounter(late);
            assert!((found - expected).abs() < 0.11 || found == expected, "{late}: {found}");
        }
    }

    #[test]
    fn time_to_collision_with_one_ahead_is_gap_over_closing_speed() {
        let (own, ahead) = (at(0.0, 15.0), at(34.0, 5.0));
        assert!(
            (time_to_collision(&own, &ahead) - 3.0).abs() < 1e-9
                && (time_to_collision(&ahead, &own) - 3.0).abs() < 1e-9
        );
        assert_eq!(
            time_to_collision(&at(0.0, 5.0), &at(34.0, 5.0)),
            HORIZON,
            "it keeps its distance"
        );
        assert_eq!(time_to_collision(&at(0.0, 9.0), &at(900.0, 0.0)), HORIZON, "it is far");
        assert_eq!(time_to_collision(&at(0.0, 9.0), &at(3.0, 9.0)), 0.0, "they overlap");
    }

    #[test]
    fn gaps_of_departures_have_their_means() {
        let mut rng = Seed::new(1).rng();
        for (spacing, mean) in
            [(Spacing::Equal(7.0), 7.0), (Spacing::Poisson(0.2), 5.0), (Spacing::Chance(0.25), 4.0)]
        {
            let sum: f64 = (0..20_000).map(|_| gap(spacing, &mut rng)).sum();
            assert!((sum / 20_000.0 - mean).abs() < 0.03 * mean, "{spacing:?}: {}", sum / 20_000.0);
        }
        let mut counts = [0; 3];
        for _ in 0..10_000 {
            counts[draw(&[(0, 1.0), (1, 0.0), (2, 3.0)], &mut rng)] += 1;
        }
        assert!(counts[1] == 0 && (2300..2700).contains(&counts[0]), "{counts:?}");
    }
}
