//! Vehicles that SUMO drives, and pedestrians: when they depart, where they are, what becomes of them among the agents, and what they met with.
//!
//! They have the slots behind the agents'. First come those that start at spawn places, then those of the route files, as many
//! as there is capacity for. One that collides with an agent or a wreck stands as a wreck itself, as long as an agent's; SUMO's
//! drivers among themselves are SUMO's business.

use rand::RngExt as _;

use super::super::geometry::{Pose, time_to_contact};
use super::super::metrics::Others as Record;
use super::super::slots::{EMPTY, Slot, Status};
use super::super::task::Task;
use super::World;
use super::motion::NO_CHECKS;
use crate::rng::{Rng, Seed};
use crate::scenario::Spacing;
use crate::sumo::{Command, Snapshot};

/// Braking above this is hard: SUMO's cars, which brake with 4.5 m/s² and some imprecision, do not do so by themselves \[m/s²\].
const HARD: f64 = 6.0;
/// An agent less than this away in time, if both go on as they do, is close \[s\].
const CLOSE: f64 = 1.5;
/// Longest times to collision and post-encroachment times that count \[s\]: vehicles further apart have nothing to do with each other.
const HORIZON: f64 = 5.0;

/// When the vehicles of a vehicle or flow depart.
#[derive(Debug, Clone)]
struct Clock {
    rng: Rng,
    /// Next departure, from the start of the episode \[s\].
    next: f64,
    left: u64,
}

/// What one of them met with.
#[derive(Debug, Clone, Copy, Default)]
struct Guest {
    time_loss: f64,
    /// Its hardest braking \[m/s²\].
    braking: f64,
    close: bool,
    crashed: bool,
    /// SUMO has been told that it stands.
    stopped: bool,
}

/// When an agent and one of them passed the place where their ways meet, fronts in and rears out \[s\].
#[derive(Debug, Clone, Copy)]
struct Pass {
    agent: [f64; 2],
    other: [f64; 2],
}

const NOT_YET: Pass = Pass { agent: [f64::INFINITY; 2], other: [f64::INFINITY; 2] };

/// The vehicles of an episode that SUMO drives.
#[derive(Debug, Clone)]
pub(super) struct Others {
    clocks: Vec<Clock>,
    guests: Vec<Guest>,
    /// `[N, others]`.
    passes: Vec<Pass>,
    /// The vehicles that have left, and the pedestrians.
    left: [Vec<Guest>; 2],
    ttc: f64,
    pet: f64,
}

impl Others {
    pub(super) fn new(task: &Task) -> Self {
        Self {
            clocks: Vec::with_capacity(task.demand.sources.len()),
            guests: vec![Guest::default(); task.others],
            passes: vec![NOT_YET; task.agents * task.others],
            left: [Vec::with_capacity(4 * task.others), Vec::with_capacity(4 * task.others)],
            ttc: HORIZON,
            pet: HORIZON,
        }
    }

    /// A new episode.
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
        self.guests.fill(Guest::default());
        self.passes.fill(NOT_YET);
        self.left.iter_mut().for_each(Vec::clear);
        (self.ttc, self.pet) = (HORIZON, HORIZON);
    }

    /// One has left the road: its slot may be another's.
    fn dismiss(&mut self, guest: usize, walks: bool) {
        self.left[usize::from(walks)].push(std::mem::take(&mut self.guests[guest]));
        let others = self.guests.len();
        for row in self.passes.chunks_mut(others) {
            row[guest] = NOT_YET;
        }
    }
}

/// Seconds to the next departure.
fn gap(spacing: Spacing, rng: &mut Rng) -> f64 {
    match spacing {
        Spacing::Equal(gap) => gap,
        Spacing::Poisson(rate) => -(1.0 - rng.random::<f64>()).ln() / rate,
        // Tries, one a second, until the first that succeeds.
        Spacing::Chance(p) if p >= 1.0 => 1.0,
        Spacing::Chance(p) => ((1.0 - rng.random::<f64>()).ln() / (-p).ln_1p()).ceil().max(1.0),
    }
}

/// Draws one of several by weight.
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
    /// Empties the slots of the others and lets those at spawn places begin, at the places behind the agents'.
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

    /// Commands of the coming exchange for those that SUMO drives.
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
            if !std::mem::replace(&mut self.others.guests[i - first].stopped, true) {
                commands.push(Command::SpeedMode { world, slot: at, mode: NO_CHECKS });
                commands.push(Command::SetSpeed { world, slot: at, speed: 0.0 });
            }
        }
        self.let_depart(world, commands);
    }

    /// Vehicles of the route files whose time has come, if there is a slot for them; the others go on waiting.
    fn let_depart(&mut self, world: u32, commands: &mut Vec<Command>) {
        let task = &*self.task;
        let now = f64::from(self.step) * task.scenario.control.interval;
        let first = task.agents + task.placed();
        for (index, (source, clock)) in
            task.demand.sources.iter().zip(&mut self.others.clocks).enumerate()
        {
            // Half a millisecond: SUMO's times are whole ones, and sums of ours are rounded.
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

    /// Reads from the snapshot where they are, and who has come or gone.
    pub(super) fn place_others(&mut self, world: u32, snapshot: &Snapshot) {
        let task = &*self.task;
        let (first, interval) = (task.agents, task.scenario.control.interval);
        for (i, slot) in self.traffic.slots.iter_mut().enumerate().skip(first) {
            let at = world as usize * task.slots() + i;
            let (body, state) = (snapshot.bodies.get(at), snapshot.vehicles.get(at));
            let (Some(body), Some(state)) = (body.copied().flatten(), state.copied().flatten())
            else {
                if slot.departed {
                    // It came to the end of its route.
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
            let guest = &mut self.others.guests[i - first];
            if slot.departed {
                slot.before = slot.pose;
                let (s, _, segment) = route.lanes().project(front, slot.segment);
                (slot.s, slot.segment) = (route.on_way(s - half), segment);
                if slot.status == Status::Active {
                    guest.braking = guest.braking.max((slot.speed - state.speed) / interval);
                }
            } else {
                slot.before = pose;
                let (s, _, segment) = route.lanes().nearest(front);
                (slot.s, slot.segment) = (route.on_way(s - half), segment);
                (slot.departed, slot.status) = (true, Status::Active);
            }
            (slot.pose, slot.speed) = (pose, state.speed);
            if slot.status == Status::Active {
                guest.time_loss = body.time_loss;
            }
        }
    }

    /// What becomes of them after a step: crashes, and how near agents came to them.
    pub(super) fn meet_others(&mut self, wreck_steps: u32) {
        let task = &*self.task;
        let first = task.agents;
        let slots = &mut self.traffic.slots;
        for i in first..slots.len() {
            let guest = &mut self.others.guests[i - first];
            if self.partners[i].is_some() && slots[i].status == Status::Active {
                (slots[i].status, slots[i].wreck_steps, slots[i].speed) =
                    (Status::Wreck, wreck_steps, 0.0);
                guest.crashed = true;
                guest.close = true;
                (self.others.ttc, self.others.pet) = (0.0, 0.0);
            }
            if slots[i].status != Status::Active {
                continue;
            }
            for agent in (0..first).filter(|&agent| slots[agent].status == Status::Active) {
                let ttc = time_to_collision(&slots[agent], &slots[i]);
                self.others.ttc = self.others.ttc.min(ttc);
                guest.close |= ttc < CLOSE;
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

    /// Whether a slot's vehicle is a pedestrian.
    pub(super) fn is_pedestrian(&self, slot: &Slot) -> bool {
        self.task.routes[slot.route].is_walked()
    }

    /// What they met with in the episode; `None` in tasks without any.
    pub(super) fn others_record(&self) -> Option<Record> {
        if self.task.others == 0 {
            return None;
        }
        let here = self.traffic.slots[self.task.agents..].iter().zip(&self.others.guests);
        let of_kind = |walks: bool| -> Vec<&Guest> {
            let here =
                here.clone().filter(|(slot, _)| slot.departed && self.is_pedestrian(slot) == walks);
            self.others.left[usize::from(walks)]
                .iter()
                .chain(here.map(|(_, guest)| guest))
                .collect()
        };
        let (drivers, walkers) = (of_kind(false), of_kind(true));
        let share = |of: &[&Guest], is: fn(&Guest) -> bool| {
            of.iter().filter(|guest| is(guest)).count() as f64 / of.len().max(1) as f64
        };
        let mean = |of: fn(&Guest) -> f64| {
            drivers.iter().map(|guest| of(guest)).sum::<f64>() / drivers.len().max(1) as f64
        };
        Some(Record {
            vehicles: drivers.len() as u32,
            crash: share(&drivers, |guest| guest.crashed),
            delay: mean(|guest| guest.time_loss),
            braking: mean(|guest| guest.braking),
            hard_braking: share(&drivers, |guest| guest.braking > HARD),
            close: share(&drivers, |guest| guest.close),
            pedestrians: walkers.len() as u32,
            pedestrian_crash: share(&walkers, |guest| guest.crashed),
            pedestrian_close: share(&walkers, |guest| guest.close),
            ttc: self.others.ttc,
            pet: self.others.pet,
        })
    }
}

/// Time from when the first of two left a place until the second came there; 0 where both were there at once, and for ever while
/// one has not come \[s\].
fn post_encroachment(pass: &Pass) -> f64 {
    let (first, second) = if pass.agent[0] <= pass.other[0] {
        (pass.agent, pass.other)
    } else {
        (pass.other, pass.agent)
    };
    if second[0].is_infinite() { f64::INFINITY } else { (second[0] - first[1]).max(0.0) }
}

/// Notes when the front of a vehicle reaches a place on its way, and when its rear has left it; the place is as long as the
/// vehicle that crosses there is wide.
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

/// Time until two vehicles touch if both go on as they do, at most [`HORIZON`] \[s\].
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

    /// A vehicle 4 m long whose middle is at `s`, at a speed.
    fn at(s: f64, speed: f64) -> Slot {
        let pose = Pose { x: s, y: 0.0, heading: 0.0 };
        Slot { size: [4.0, 2.0], s, speed, pose, ..EMPTY }
    }

    /// Both drive at 10 m/s; the other comes `late` seconds later to where their ways cross, 50 m from both starts.
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
        // From 47 m, with the front at 49, to 53 m, with the rear at 51, the place is taken: 0.6 s.
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
