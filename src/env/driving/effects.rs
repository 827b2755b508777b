//! Effects of an episode on background traffic: how near agents come to the vehicles that SUMO
//! drives and to pedestrians, and what that costs these.

use super::agents::{Slot, Status};
use super::geometry::time_to_contact;
use super::map::Map;
use super::metrics::BackgroundMetrics;

/// Deceleration above which braking counts as hard \[m/s²\]. SUMO's cars, which brake with
/// 4.5 m/s² and some imprecision, do not exceed this value by themselves.
const HARD: f64 = 6.0;
/// Time to collision below which an agent counts as close \[s\].
const CLOSE: f64 = 1.5;
/// Upper limit of times to collision and post-encroachment times \[s\]. Vehicles further apart in
/// time do not affect each other.
pub const MAX_TIME_APART: f64 = 5.0;

/// What is recorded about one background vehicle.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct RoadUser {
    /// SUMO's time loss of the vehicle \[s\].
    pub(super) time_loss: f64,
    /// The vehicle's hardest braking \[m/s²\].
    pub(super) braking: f64,
    /// Whether an agent came closer than [`CLOSE`] or the vehicle crashed.
    close: bool,
    /// Whether the vehicle collided with an agent or a wreck.
    crashed: bool,
    /// Whether SUMO has been told to stop the vehicle, which is a wreck.
    pub(super) stopped: bool,
}

/// Times at which an agent and a background vehicle passed their conflict point \[s\]: when the
/// front of each entered and when its rear left. A time that is still to come is infinite. One from
/// before the two were first seen together is unknown, and negative infinite.
#[derive(Debug, Clone, Copy)]
struct Pass {
    agent: [f64; 2],
    other: [f64; 2],
    /// Where the agent and the other vehicle come to the conflict point.
    places: [Place; 2],
}

/// A conflict point on a vehicle's route.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Place {
    route: usize,
    /// Position on the route \[m\].
    at: f64,
    /// Width of the vehicle that crosses there \[m\].
    wide: f64,
}

const NOWHERE: Place = Place { route: 0, at: f64::INFINITY, wide: 0.0 };
const NOT_YET: Pass =
    Pass { agent: [f64::INFINITY; 2], other: [f64::INFINITY; 2], places: [NOWHERE; 2] };

impl Place {
    /// Returns whether the front of a vehicle has reached the place, and whether its rear has left
    /// it. The place is as long as the vehicle that crosses there is wide.
    fn passed_by(&self, slot: &Slot) -> [bool; 2] {
        let (half, margin) = (slot.size[0] / 2.0, self.wide / 2.0);
        [slot.s + half >= self.at - margin, slot.s - half >= self.at + margin]
    }
}

impl Pass {
    /// Notes where the two vehicles are at time `now` \[s\]; `at`: positions of the conflict point
    /// on the agent's and the other vehicle's route \[m\].
    fn look(&mut self, at: [f64; 2], agent: &Slot, other: &Slot, now: f64) {
        let is_first = self.places[0].at != at[0];
        if is_first {
            *self = NOT_YET;
        }
        self.places = [
            Place { route: agent.route, at: at[0], wide: other.size[1] },
            Place { route: other.route, at: at[1], wide: agent.size[1] },
        ];
        let now = if is_first { f64::NEG_INFINITY } else { now };
        note(&mut self.agent, self.places[0].passed_by(agent), now);
        note(&mut self.other, self.places[1].passed_by(other), now);
    }
}

/// A vehicle of the road.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Party {
    Agent(usize),
    RoadUser(usize),
}

/// A vehicle that is still to come to a conflict point, which another one has left that is gone
/// since.
#[derive(Debug, Clone, Copy)]
struct Awaited {
    who: Party,
    place: Place,
    /// When the rear of the one that is gone left the conflict point \[s\].
    left: f64,
}

/// What is recorded about the background traffic of an episode.
#[derive(Debug, Clone)]
pub(super) struct Effects {
    /// Records of the vehicles and pedestrians on the road, by slot.
    pub(super) road_users: Vec<RoadUser>,
    /// Times at the conflict points, `[N, road users]`.
    passes: Vec<Pass>,
    /// Vehicles that are still to come where others have been.
    awaited: Vec<Awaited>,
    /// Records of the vehicles, and of the pedestrians, whose slots have become free.
    left: [Vec<RoadUser>; 2],
    /// Smallest time to collision with an agent so far \[s\].
    ttc: f64,
    /// Smallest post-encroachment time with an agent so far \[s\].
    pet: f64,
}

impl Effects {
    pub(super) fn new(agents: usize, road_users: usize) -> Self {
        let left = || Vec::with_capacity(4 * road_users);
        Self {
            road_users: vec![RoadUser::default(); road_users],
            passes: vec![NOT_YET; agents * road_users],
            awaited: Vec::with_capacity(agents * road_users),
            left: [left(), left()],
            ttc: MAX_TIME_APART,
            pet: MAX_TIME_APART,
        }
    }

    /// Begins a new episode.
    pub(super) fn begin(&mut self) {
        self.road_users.fill(RoadUser::default());
        self.passes.fill(NOT_YET);
        self.awaited.clear();
        self.left.iter_mut().for_each(Vec::clear);
        (self.ttc, self.pet) = (MAX_TIME_APART, MAX_TIME_APART);
    }

    /// Stores the record of a vehicle or pedestrian (`walks`) that is gone, so that its
    /// slot may be used again.
    pub(super) fn dismiss(&mut self, road_user: usize, walks: bool) {
        self.left[usize::from(walks)].push(std::mem::take(&mut self.road_users[road_user]));
        for agent in 0..self.passes.len() / self.road_users.len() {
            self.part(agent, road_user);
        }
        self.awaited.retain(|awaited| awaited.who != Party::RoadUser(road_user));
    }

    /// Notes that the slot of an agent gets another agent.
    pub(super) fn renew(&mut self, agent: usize) {
        for road_user in 0..self.road_users.len() {
            self.part(agent, road_user);
        }
        self.awaited.retain(|awaited| awaited.who != Party::Agent(agent));
    }

    /// Notes that an agent and another vehicle are no longer on the road together. If one of them
    /// has left their conflict point, the other is awaited there.
    fn part(&mut self, agent: usize, road_user: usize) {
        let at = agent * self.road_users.len() + road_user;
        let Pass { agent: own, other, places } = std::mem::replace(&mut self.passes[at], NOT_YET);
        let parties = [Party::Agent(agent), Party::RoadUser(road_user)];
        for (who, place, [front, _], [_, left]) in
            [(parties[0], places[0], own, other), (parties[1], places[1], other, own)]
        {
            if left.is_finite() && front == f64::INFINITY {
                self.awaited.push(Awaited { who, place, left });
            }
        }
    }

    /// Notes at time `now` \[s\] which awaited vehicles have come, of the agents and of one other
    /// vehicle.
    fn receive(&mut self, agents: &[Slot], road_user: usize, other: &Slot, now: f64) {
        let Self { awaited, pet, .. } = self;
        awaited.retain(|Awaited { who, place, left }| {
            let slot = match *who {
                Party::Agent(agent) => &agents[agent],
                Party::RoadUser(number) if number == road_user => other,
                Party::RoadUser(_) => return now - left <= MAX_TIME_APART,
            };
            let on_way = slot.status == Status::Active && slot.route == place.route;
            let has_come = on_way && place.passed_by(slot)[0];
            if has_come {
                *pet = pet.min(now - left);
            }
            !has_come && now - left <= MAX_TIME_APART
        });
    }

    /// Notes that a vehicle or pedestrian collided with an agent or a wreck.
    pub(super) fn crash(&mut self, road_user: usize) {
        self.road_users[road_user].crashed = true;
        self.road_users[road_user].close = true;
        (self.ttc, self.pet) = (0.0, 0.0);
    }

    /// Notes at time `now` \[s\] how near the active `agents` are to another vehicle.
    pub(super) fn watch(
        &mut self,
        map: &Map,
        agents: &[Slot],
        road_user: usize,
        other: &Slot,
        now: f64,
    ) {
        let count = self.road_users.len();
        self.receive(agents, road_user, other, now);
        for (i, agent) in agents.iter().enumerate() {
            if agent.status != Status::Active {
                self.part(i, road_user);
                continue;
            }
            let contact = |time: f64| {
                let at = |slot: &Slot| slot.s + slot.speed * time;
                let lengths = agent.size[0] + other.size[0];
                !map.routes[agent.route].passes_over(at(agent), other.route, at(other), lengths)
            };
            let ttc = Some(time_to_collision(agent, other)).filter(|time| contact(*time));
            let ttc = ttc.unwrap_or(MAX_TIME_APART);
            self.ttc = self.ttc.min(ttc);
            self.road_users[road_user].close |= ttc < CLOSE;
            let route = &map.routes[agent.route];
            let Some(met) = route.conflict_between(agent.s, other.route, other.s) else { continue };
            let pass = &mut self.passes[i * count + road_user];
            pass.look([met.own, met.other], agent, other, now);
            self.pet = self.pet.min(post_encroachment(pass));
        }
    }

    /// Returns the summary of the episode; `slots` are those of the background traffic, and
    /// `watched` says whether there was an agent.
    pub(super) fn metrics(&self, map: &Map, slots: &[Slot], watched: bool) -> BackgroundMetrics {
        let here = slots.iter().zip(&self.road_users);
        let of_kind = |walks: bool| -> Vec<&RoadUser> {
            let of_kind = |(slot, _): &(&Slot, _)| {
                slot.departed && map.routes[slot.route].is_walked() == walks
            };
            let here = here.clone().filter(of_kind).map(|(_, road_user)| road_user);
            self.left[usize::from(walks)].iter().chain(here).collect()
        };
        let (drivers, walkers) = (of_kind(false), of_kind(true));
        let share = |of: &[&RoadUser], is: fn(&RoadUser) -> bool| {
            of.iter().filter(|road_user| is(road_user)).count() as f64 / of.len().max(1) as f64
        };
        let mean = |of: fn(&RoadUser) -> f64| {
            drivers.iter().map(|road_user| of(road_user)).sum::<f64>() / drivers.len().max(1) as f64
        };
        BackgroundMetrics {
            vehicles: drivers.len() as u32,
            crash: share(&drivers, |road_user| road_user.crashed),
            delay: mean(|road_user| road_user.time_loss),
            braking: mean(|road_user| road_user.braking),
            hard_braking: share(&drivers, |road_user| road_user.braking > HARD),
            close: share(&drivers, |road_user| road_user.close),
            pedestrians: walkers.len() as u32,
            pedestrian_crash: share(&walkers, |road_user| road_user.crashed),
            pedestrian_close: share(&walkers, |road_user| road_user.close),
            ttc: watched.then_some(self.ttc),
            pet: watched.then_some(self.pet),
        }
    }
}

/// Returns the time from when the first of two vehicles left a place until the second reached
/// it \[s\]. It is 0 if both were there at once, and infinite as long as one of them has not
/// reached the place, or where one passed it before the two were first seen together.
fn post_encroachment(pass: &Pass) -> f64 {
    let (first, second) = if pass.agent[0] <= pass.other[0] {
        (pass.agent, pass.other)
    } else {
        (pass.other, pass.agent)
    };
    if second[0].is_infinite() { f64::INFINITY } else { (second[0] - first[1]).max(0.0) }
}

/// Notes when a vehicle's front has reached a place and when its rear has left it.
fn note(times: &mut [f64; 2], passed: [bool; 2], now: f64) {
    for (time, passed) in times.iter_mut().zip(passed) {
        if passed && *time == f64::INFINITY {
            *time = now;
        }
    }
}

/// Returns the time until two vehicles touch if both keep their speeds and headings, at most
/// [`MAX_TIME_APART`] \[s\].
fn time_to_collision(a: &Slot, b: &Slot) -> f64 {
    let reach = (a.size[0] + a.size[1] + b.size[0] + b.size[1]) / 2.0;
    if a.pose.distance(&b.pose) > reach + MAX_TIME_APART * (a.speed.abs() + b.speed.abs()) {
        return MAX_TIME_APART;
    }
    let contact = time_to_contact((&a.pose, a.size, a.speed), (&b.pose, b.size, b.speed));
    contact.map_or(MAX_TIME_APART, |time| time.min(MAX_TIME_APART))
}

#[cfg(test)]
mod tests {
    use super::super::geometry::Pose;
    use super::*;

    /// Returns a vehicle of 4 m length with its centre at `s` and with this speed.
    fn at(s: f64, speed: f64) -> Slot {
        let pose = Pose { x: s, y: 0.0, heading: 0.0 };
        Slot { size: [4.0, 2.0], s, speed, pose, ..Slot::default() }
    }

    /// Returns the post-encroachment time of two vehicles at 10 m/s whose routes cross 50 m from
    /// both starts. The other vehicle reaches the conflict point `late` seconds after the agent;
    /// the two are on the road together from second `from`.
    fn encounter(late: f64, from: f64) -> f64 {
        let (mut pass, mut least) = (NOT_YET, f64::INFINITY);
        for now in (0..200).map(|step| f64::from(step) * 0.1).filter(|now| *now >= from) {
            let (agent, other) = (at(10.0 * now, 10.0), at(10.0 * (now - late), 10.0));
            pass.look([50.0, 50.0], &agent, &other, now);
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
            let found = encounter(late, 0.0);
            assert!((found - expected).abs() < 0.11 || found == expected, "{late}: {found}");
        }
    }

    /// Which of two vehicles is gone before the other one comes.
    #[derive(Clone, Copy)]
    enum Gone {
        Arrived,
        Replaced,
        Dismissed,
    }

    /// Returns the smallest post-encroachment time of an agent and another vehicle, of which the
    /// second comes to the conflict point 2 s after the first. The first one is gone one second
    /// after it has left the point.
    fn after_it_is_gone(gone: Gone) -> f64 {
        let mut effects = Effects::new(1, 1);
        let agent_first = !matches!(gone, Gone::Dismissed);
        for now in (0..100).map(|step| f64::from(step) * 0.1) {
            let at = |late: f64| {
                let slot = at(10.0 * (now - late), 10.0);
                Slot { status: Status::Active, ..slot }
            };
            let (mut agent, mut other) =
                if agent_first { (at(0.0), at(2.0)) } else { (at(2.0), at(0.0)) };
            let is_gone = now > 6.3;
            let just_gone = is_gone && now < 6.45;
            match gone {
                Gone::Dismissed if just_gone => effects.dismiss(0, false),
                Gone::Replaced if just_gone => effects.renew(0),
                Gone::Arrived if is_gone => agent = Slot::default(),
                _ => {}
            }
            let new = Slot { status: Status::Active, ..Slot::default() };
            match gone {
                Gone::Replaced if is_gone => agent = new.clone(),
                Gone::Dismissed if is_gone => other = new,
                _ => {}
            }
            effects.receive(std::slice::from_ref(&agent), 0, &other, now);
            if agent.status != Status::Active {
                effects.part(0, 0);
            } else if !is_gone {
                effects.passes[0].look([50.0, 50.0], &agent, &other, now);
                effects.pet = effects.pet.min(post_encroachment(&effects.passes[0]));
            }
        }
        assert!(effects.awaited.is_empty(), "nobody is awaited for more than 5 s");
        effects.pet
    }

    #[test]
    fn post_encroachment_counts_after_the_first_vehicle_is_gone() {
        for gone in [Gone::Arrived, Gone::Replaced, Gone::Dismissed] {
            let found = after_it_is_gone(gone);
            assert!((found - 1.4).abs() < 0.11, "{found}");
        }
    }

    /// A vehicle that was past the conflict point before the other one came left it at an unknown
    /// time.
    #[test]
    fn post_encroachment_is_unknown_where_nobody_saw_the_first_vehicle_pass() {
        assert_eq!(encounter(4.0, 6.0), f64::INFINITY);
        assert_eq!(encounter(-4.0, 6.0), f64::INFINITY);
        let (seen, from_the_place) = (encounter(4.0, 4.0), encounter(4.0, 5.0));
        assert!((seen - 3.4).abs() < 0.11 && seen == from_the_place, "{seen} {from_the_place}");
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
            MAX_TIME_APART,
            "it keeps its distance"
        );
        assert_eq!(time_to_collision(&at(0.0, 9.0), &at(900.0, 0.0)), MAX_TIME_APART, "it is far");
        assert_eq!(time_to_collision(&at(0.0, 9.0), &at(3.0, 9.0)), 0.0, "they overlap");
    }
}
