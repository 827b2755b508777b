//! A scenario made ready for one number of agents.

mod simulation;

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex};

use super::geometry::Size;
use super::layout::Layout;
use super::map::Map;
use super::{observation, state};
use crate::env::error::Error;
use crate::env::spec::{ActionDimension, EnvSpec, Features};
use crate::scenario::{
    Control, Demand, LaneChange, PlannedSource, Scenario, Source, Spacing, SpawnPlace, Vehicle,
    VehicleKind, VehicleVariant,
};
use crate::sumo::Dropped;

/// Index of the agents' vehicle type in [`SimulationConfig::vehicle_types`].
pub(super) const AGENT_TYPE: u32 = 0;
/// Index of the vehicle type whose speed SUMO's own driver chooses.
pub(super) const SUMO_TYPE: u32 = 1;

/// What controls the agents' vehicles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Driver {
    /// The actions.
    Agents,
    /// The actions, which follow rules of the right of way: each world keeps the vehicles'
    /// priorities even if agents do not observe them.
    Rules,
    /// SUMO's own driver with SUMO's right of way; actions are ignored.
    Sumo,
}

/// Everything about a task that is the same in all episodes; shared by all worlds.
#[derive(Debug, Clone)]
pub struct Task {
    /// The scenario.
    pub scenario: Scenario,
    /// Agent slots N.
    pub agents: usize,
    /// Slots of background traffic, which come after the agents' slots.
    pub others: usize,
    /// Number of background vehicles that start at spawn places; their slots come before those of
    /// the route files' vehicles.
    pub(super) placed: usize,
    /// Largest number of agents that start at spawn places.
    pub starting: usize,
    /// Least number of agents that start at spawn places: each episode has a random number from
    /// this one to [`Task::starting`].
    pub fewest: usize,
    /// Control and vehicle of each kind of agents' vehicles: first those of the scenario, then those
    /// of its kinds.
    pub(crate) abilities: Vec<(Control, Vehicle)>,
    /// Spawn places, at least as many as vehicles that start at spawn places.
    pub places: Vec<SpawnPlace>,
    /// The net and the routes.
    pub map: Map,
    /// Contents of the route files.
    pub(super) demand: Demand,
    /// For every vehicle and flow of the route files, which of [`Demand::types`] are agents; empty
    /// if all agents start at spawn places.
    pub(super) recruits: Vec<Vec<bool>>,
    /// Vehicle types of the background traffic at spawn places, with their weights; empty if these
    /// vehicles have the agents' size and abilities.
    pub(super) place_mix: Vec<(usize, f64)>,
    /// For every route with a reserved destination, the first route that ends on the same edge.
    pub(super) reserved: Vec<Option<usize>>,
    /// The vehicles and flows, as indices into [`Demand::sources`], of which it has been said that
    /// SUMO drops them.
    dropped: Arc<Mutex<BTreeSet<usize>>>,
    /// Shapes and features for the learners.
    pub spec: EnvSpec,
    /// How observations are written.
    pub(super) observation: Layout,
    /// How privileged states are written.
    pub(super) state: Layout,
}

impl Task {
    /// Loads the net for `vehicles` vehicles at spawn places, of which the scenario's share are
    /// agents, and works out the conflicts between the routes. If agents come from route files,
    /// `vehicles` is the number of agent slots, and as many vehicles start at spawn places as there
    /// are places for.
    ///
    /// # Errors
    /// If the scenario does not take this number of vehicles, or if its net or route files cannot
    /// be read or driven.
    pub fn new(scenario: &Scenario, vehicles: u32) -> Result<Self, Error> {
        let choice = scenario.net_for(vehicles)?;
        let (agents, placed) = (scenario.slots(vehicles), scenario.placed(vehicles));
        let starting = if placed > 0 { scenario.traffic.learners(placed) } else { 0 };
        let demand = Demand::load(&scenario.traffic.files)?;
        let of_kinds = |source: &Source| {
            let includes = |kind| scenario.agents.includes(&demand, source, kind);
            (0..demand.types.len()).map(includes).collect()
        };
        let from_files = scenario.agents.come_from_files();
        let recruits = demand.sources.iter().filter(|_| from_files).map(of_kinds).collect();
        let place_mix =
            scenario.traffic.kind.as_ref().and_then(|kind| demand.mix(kind)).unwrap_or_default();
        let map = Map::new(scenario, &demand, &choice.file)?;
        let capacity = if map.plan.sources.is_empty() { 0 } else { scenario.traffic.capacity };
        let end = |route: &crate::scenario::Route| route.edges.last().cloned();
        let first = |route| scenario.routes.iter().position(|other| end(other) == end(route));
        let reserved =
            scenario.routes.iter().map(|route| first(route).filter(|_| route.reserved)).collect();
        let mut scenario = scenario.clone();
        scenario.observation.signals &= !map.traffic_lights.lights.is_empty();
        let (observation, observed) = Layout::new(observation::GROUPS, &scenario);
        let (state, known) = Layout::new(state::GROUPS, &scenario);
        let nearest = scenario.communication.nearest;
        Ok(Self {
            agents: agents as usize,
            others: (placed - starting + capacity) as usize,
            placed: (placed - starting) as usize,
            starting: starting as usize,
            fewest: starting as usize,
            abilities: abilities(&scenario),
            places: choice.places().collect(),
            map,
            demand,
            recruits,
            place_mix,
            reserved,
            dropped: Arc::default(),
            spec: EnvSpec {
                agents: agents as usize,
                actions: actions(&scenario.control, &observed).into(),
                observation: observed,
                state: known,
                most_heard: (nearest > 0 && nearest + 1 < agents as usize).then_some(nearest),
                metrics: Vec::new(),
            },
            observation,
            state,
            scenario,
        })
    }

    /// Returns the same task with a random number of agents at spawn places in each episode, from
    /// `fewest` (at least 1) to the largest number.
    #[must_use]
    pub fn with_fewest(self, fewest: usize) -> Self {
        Self { fewest: fewest.max(1).min(self.starting), ..self }
    }

    /// Returns a line about vehicles and persons of the route files that are left out; `None` if
    /// none is.
    pub fn left_out(&self) -> Option<String> {
        self.map.plan.warning().map(|(what, hint)| format!("{what}; {hint}"))
    }

    /// Warns, once for each vehicle or flow, that SUMO drops a vehicle of it instead of letting it
    /// depart, or refuses one of its stops.
    pub(super) fn warn_of_dropped(&self, dropped: &Dropped) {
        let departures = &self.map.plan.departures;
        // The departures of agents come after those of the background traffic.
        let index = dropped.departure.and_then(|at| (at as usize).checked_rem(departures.len()));
        let planned = index.map(|index| &departures[index]);
        // Spawn places count as one source, after those of the files.
        let source = planned.map_or(usize::MAX, |planned| planned.source);
        let first = self.dropped.lock().is_ok_and(|mut known| known.insert(source));
        if first && planned.is_none() {
            tracing::warn!(
                "SUMO drops a vehicle of a spawn place when it departs, so that it never comes; `iwol scenario check` names the places"
            );
        }
        if let Some(planned) = planned.filter(|_| first) {
            let source = &self.demand.sources[planned.source];
            let (element, name) = (source.element, source.name());
            let what = if dropped.drives {
                format!("refuses a stop of the {element} {name}, which drives on without it")
            } else {
                format!("drops the {element} {name} when it departs, so that it is left out")
            };
            let reason = dropped.reason.as_ref().map(|text| format!(" ({})", text.trim()));
            let reason = reason.unwrap_or_default();
            tracing::warn!("SUMO {what}{reason}; `iwol scenario check` names all such vehicles");
        }
    }

    /// Returns an upper bound of the number of agents of an episode. It is larger than
    /// [`Task::agents`] where slots are used again; numbers that are drawn exceed it once in a
    /// thousand million episodes.
    pub fn most_agents(&self) -> usize {
        if !self.has_flow() {
            return self.agents;
        }
        let control = &self.scenario.control;
        let horizon = f64::from(self.scenario.termination.horizon) * control.interval;
        let most = |source: &PlannedSource| {
            let time = (source.end.min(horizon) - source.begin).max(0.0);
            let drawn = |mean: f64| mean + 6.0 * mean.sqrt() + 6.0;
            let departures = match source.spacing {
                Spacing::Equal(gap) => time / gap + 1.0,
                Spacing::Poisson(rate) => drawn(rate * time),
                Spacing::Chance(_) => time + 1.0,
            };
            let types = self.demand.sources[source.source].types.iter();
            let scale =
                types.map(|entry| self.demand.types[entry.0].scale.ceil()).fold(1.0, f64::max);
            (departures.min(source.number as f64) * scale) as usize
        };
        let sources = self.map.plan.sources.iter();
        self.starting
            + sources.filter(|source| self.may_be_agents(source.source)).map(most).sum::<usize>()
    }

    /// Returns the number of slots of a world: those of agents and of background traffic.
    pub(super) fn slots(&self) -> usize {
        self.agents + self.others
    }

    /// Returns the share of the vehicles of an episode whose route needs a lane change, in expectation.
    pub(crate) fn lane_change_share(&self) -> f64 {
        let needs = |route: usize| f64::from(u8::from(self.map.lane_change[route].is_finite()));
        let mean = |routes: &mut dyn Iterator<Item = (usize, f64)>| {
            let [sum, all] = routes.fold([0.0, 0.0], |[sum, all], (route, weight)| {
                [sum + weight * needs(route), all + weight]
            });
            if all > 0.0 { sum / all } else { 0.0 }
        };
        let horizon = f64::from(self.scenario.termination.horizon) * self.scenario.control.interval;
        let (places, plan) = (self.places.len().max(1) as f64, &self.map.plan);
        let placed = (self.starting + self.placed) as f64;
        let mut shares: Vec<(f64, f64)> = (self.places.iter())
            .map(|place| {
                let mut routes = place.routes.iter().map(|&route| (route, 1.0));
                (placed / places, mean(&mut routes))
            })
            .collect();
        for source in &plan.sources {
            let departures = source.departures.iter().filter_map(|&(departure, weight)| {
                let departure = &plan.departures[departure?];
                departure.walk.is_none().then_some((departure.route, weight))
            });
            let mut departures = departures.peekable();
            if departures.peek().is_some() {
                shares.push((source.expected_number(horizon), mean(&mut departures)));
            }
        }
        let vehicles: f64 = shares.iter().map(|(count, _)| count).sum();
        shares.iter().map(|(count, share)| count * share).sum::<f64>() / vehicles.max(1e-9)
    }

    /// Returns an action with this steering and throttle, each -1 to 1, that keeps the lane. Where
    /// actions have one dimension, only the first number counts.
    pub(crate) fn action(&self, steer: f64, throttle: f64) -> [f64; 2] {
        if self.scenario.control.steering.is_some() { [steer, throttle] } else { [throttle, 0.0] }
    }

    /// Whether agents may change lanes, so that they are on the lanes that SUMO reports.
    pub(super) fn changes_lanes(&self) -> bool {
        self.scenario.control.lane_change != LaneChange::None
    }

    /// Whether agents steer under this driver, so that they follow their routes' paths instead of
    /// the lanes.
    pub(super) fn steers(&self, driver: Driver) -> bool {
        driver != Driver::Sumo && self.scenario.control.steering.is_some()
    }

    /// Returns the steps for which a wreck stays on the road.
    pub(super) fn wreck_steps(&self) -> u32 {
        (self.scenario.termination.wreck_time / self.scenario.control.interval).round() as u32
    }

    /// Returns the index in SUMO's list and the size of vehicle type number `kind` of the route
    /// files.
    pub(super) fn demand_type(&self, kind: usize) -> (u32, Size) {
        let VehicleKind { length, width, .. } = self.demand.types[kind];
        let ours = if self.has_flow() { self.demand.types.len() } else { 0 };
        (self.first_type_of_files() + (ours + kind) as u32, [length, width])
    }

    /// Returns the same as [`Task::demand_type`] for an agent: a type with the size and class of
    /// that type and the abilities of agents, or that type itself where SUMO drives.
    pub(super) fn agent_type(&self, driver: Driver, kind: usize) -> (u32, Size) {
        let (index, size) = self.demand_type(kind);
        let ours = self.first_type_of_files() + kind as u32;
        (if driver == Driver::Sumo { index } else { ours }, size)
    }

    /// Returns the index in SUMO's list of the type of an agent with this kind of vehicle, an index
    /// into [`Task::abilities`].
    pub(super) fn type_of_kind(driver: Driver, kind: usize) -> u32 {
        2 * kind as u32 + if driver == Driver::Sumo { SUMO_TYPE } else { AGENT_TYPE }
    }

    /// Returns the index in SUMO's list of the first type that comes from route files.
    fn first_type_of_files(&self) -> u32 {
        2 * self.abilities.len() as u32
    }

    /// Returns whether vehicles of a vehicle or flow of the route files may be agents.
    pub(super) fn may_be_agents(&self, source: usize) -> bool {
        let types = &self.demand.sources[source].types;
        types.iter().any(|entry| self.may_be_agent(source, entry.0))
    }

    /// Returns whether a vehicle of type number `kind` of a vehicle or flow of the route files may be
    /// an agent.
    pub(super) fn may_be_agent(&self, source: usize, kind: usize) -> bool {
        self.recruits.get(source).is_some_and(|recruits| recruits[kind])
    }

    /// Whether each world needs a SUMO of its own, which is renewed for each episode, because what SUMO
    /// does depends on what it did before, and on distances that it computes from coordinates, whose
    /// rounding differs from tile to tile: with background traffic, SUMO's lane change model, or
    /// traffic lights that react to traffic.
    pub(super) fn needs_fresh_sumo(&self) -> bool {
        self.others > 0 || self.changes_lanes() || !self.map.traffic_lights.are_static()
    }

    /// Returns whether agents come from route files.
    pub(super) fn has_flow(&self) -> bool {
        !self.recruits.is_empty()
    }

    /// Returns the index in SUMO's list and the size of a vehicle type for background traffic at
    /// spawn places; `kind` is drawn from `place_mix`.
    pub(super) fn place_type(&self, kind: usize) -> (u32, Size) {
        if self.place_mix.is_empty() {
            let vehicle = &self.scenario.vehicle;
            return (SUMO_TYPE, [vehicle.length, vehicle.width]);
        }
        self.demand_type(kind)
    }
}

/// Returns control and vehicle of each kind of agents' vehicles.
fn abilities(scenario: &Scenario) -> Vec<(Control, Vehicle)> {
    let kinds = scenario.kinds.iter().map(|kind| {
        let VehicleVariant { length, width, max_speed, accel, .. } = *kind;
        let control = Control { accel, brake: kind.brake.clone(), ..scenario.control.clone() };
        (control, Vehicle { length, width, max_speed })
    });
    std::iter::once((scenario.control.clone(), scenario.vehicle)).chain(kinds).collect()
}

/// Factor on the noise of the action dimension that asks for a lane. With the noise of the throttle,
/// a vehicle would ask for another lane in most steps, and change lanes as often as it can.
const LANE_NOISE: f32 = 0.25;

/// Returns the dimensions of the agents' actions: steering, if vehicles steer, then throttle and
/// brake, then the lane, if actions change lanes.
///
/// Untrained policies accelerate on average: brakes are stronger than engines, so that a vehicle
/// with a mean throttle of 0 hardly moves under noise.
fn actions(control: &Control, observed: &Features) -> Vec<ActionDimension> {
    let feature = |name: &str| observed.list.iter().position(|feature| feature.name == name);
    let steer = ActionDimension {
        // docs/lab/decision-process.md#noise-that-lasts-in-the-throttle-alone
        noise_lasts: false,
        feature: feature("steering.last_steer"),
        ..ActionDimension::named("steer")
    };
    let throttle = ActionDimension {
        initial_mean: control.initial_throttle as f32,
        feature: feature("ego.last_action"),
        ..ActionDimension::named("throttle")
    };
    let lane = ActionDimension { noise_scale: LANE_NOISE, ..ActionDimension::named("lane") };
    match control.lane_change {
        _ if control.steering.is_some() => vec![steer, throttle],
        LaneChange::Action => vec![throttle, lane],
        LaneChange::None | LaneChange::Route => vec![throttle],
    }
}
