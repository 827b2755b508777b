//! Lets everyone of the route files depart once, alone, to find those whom SUMO refuses.

use std::collections::{HashMap, hash_map::Entry};

use super::task::{Driver, Task};
use crate::env::error::Error;
use crate::scenario::LeftOut;
use crate::sumo::{self, Backend, Command, Departure, Hosting};

/// What SUMO refuses of the route files, in their order.
#[derive(Debug, Clone, Default)]
pub struct Refused {
    /// Vehicles, persons and flows that do not depart.
    pub vehicles: Vec<LeftOut>,
    /// Vehicles and flows that drive on without one of their stops.
    pub stops: Vec<LeftOut>,
    /// Number of vehicles, persons and flows that the files let depart within an episode.
    pub of: usize,
}

/// SUMO's reason, and whether the vehicle drives without a stop.
type Answer = (String, bool);

impl Task {
    /// Returns the vehicles and persons of the route files whom SUMO refuses, or of whom SUMO refuses a
    /// stop, each with SUMO's reason.
    ///
    /// # Errors
    /// [`Error::Sumo`] if SUMO fails.
    pub fn refused_departures(&self, hosting: &Hosting) -> Result<Refused, Error> {
        let plan = &self.map.plan;
        let mut refused = Refused { of: plan.wanted, ..Refused::default() };
        if plan.departures.is_empty() {
            return Ok(refused);
        }
        let failed = |source| Error::Sumo { world: 0, episode: 0, step: 0, source };
        let config = self.simulation_config(0, 1, hosting);
        let departures = config.others.iter().flat_map(|others| others.departures.clone());
        let departures: Vec<Departure> = departures.collect();
        // Vehicles that depart alike share the answer, because there may be thousands of them.
        let mut answers: HashMap<(u32, String), Option<Answer>> = HashMap::new();
        let mut simulation = sumo::start(Backend::Traci, config).map_err(failed)?;
        let mut exchange = |commands: &[Command]| {
            simulation.send(commands)?;
            match simulation.receive() {
                Ok(snapshot) => Ok(snapshot.dropped.first().map(|dropped| {
                    let what = if dropped.drives {
                        "refuses its stop"
                    } else {
                        "drops it when it departs"
                    };
                    let why = dropped.reason.as_ref().map(|reason| format!(": {}", reason.trim()));
                    (format!("SUMO {what}{}", why.unwrap_or_default()), dropped.drives)
                })),
                Err(sumo::Error::Refused { message, .. }) => {
                    Ok(Some((format!("SUMO refuses it: {}", message.trim()), false)))
                }
                Err(error) => Err(error),
            }
        };
        let (world, slot) = (0, (self.agents + self.placed) as u32);
        for (index, planned) in plan.departures.iter().enumerate() {
            let source = &self.demand.sources[planned.source];
            for (departure, vehicle_type) in self.departures(index) {
                let until_from_now = -source.begin;
                let depart =
                    Command::Depart { world, slot, departure, vehicle_type, until_from_now };
                let reason = match answers.entry((vehicle_type, format!("{:?}", departures[index])))
                {
                    Entry::Occupied(known) => known.get().clone(),
                    Entry::Vacant(new) => {
                        // The one before may be on the road even if SUMO refused one of its stops.
                        let remove = Command::Remove { world, slot };
                        new.insert(exchange(&[remove, depart]).map_err(failed)?).clone()
                    }
                };
                let Some((reason, drives)) = reason else { continue };
                let list = if drives { &mut refused.stops } else { &mut refused.vehicles };
                if list.last().is_none_or(|last| last.place != source.place) {
                    let (id, element) = (source.id.clone(), source.element);
                    list.push(LeftOut { id, element, place: source.place.clone(), reason });
                }
            }
        }
        Ok(refused)
    }

    /// Returns what SUMO drops at the spawn places whose vehicles do not begin with the episode,
    /// standing still, as texts: a vehicle departs alone from each of them, on each of its routes.
    ///
    /// # Errors
    /// [`Error::Sumo`] if SUMO fails.
    pub fn dropped_at_places(&self, hosting: &Hosting) -> Result<Vec<String>, Error> {
        let failed = |source| Error::Sumo { world: 0, episode: 0, step: 0, source };
        let later = self.places.iter().filter(|place| !place.departure.is_immediate());
        let mut starts: Vec<(usize, f64, f64)> = Vec::new();
        for place in later {
            // Nearest to the junction, the vehicle has the shortest way to stop.
            let pos = place.pos + self.scenario.jitter.longitudinal;
            let speed = place.departure.depart_speed.min(self.scenario.vehicle.max_speed);
            starts.extend(place.routes.iter().map(|&route| (route, pos, speed)));
        }
        if starts.is_empty() {
            return Ok(Vec::new());
        }
        let config = self.simulation_config(0, 1, hosting);
        let mut simulation = sumo::start(Backend::Traci, config).map_err(failed)?;
        let mut dropped = Vec::new();
        let (world, slot) = (0, 0);
        for (route, pos, depart_speed) in starts {
            let depart_pos =
                self.map.routes[route].path.ahead(pos, self.scenario.vehicle.length / 2.0);
            let vehicle_type = Task::type_of_kind(Driver::Agents, 0);
            let add = Command::Add {
                world,
                slot,
                route: route as u32,
                vehicle_type,
                depart_pos,
                depart_speed,
            };
            simulation.send(&[Command::Remove { world, slot }, add]).map_err(failed)?;
            if !simulation.receive().map_err(failed)?.dropped.is_empty() {
                dropped.push(format!(
                    "SUMO drops a vehicle that departs on route `{}` at {pos} m with {depart_speed} m/s",
                    self.map.route_id(route)
                ));
            }
        }
        Ok(dropped)
    }

    /// Returns the departures, as indices into those that SUMO knows, and the vehicle types with
    /// which departure number `planned` of the plan takes place: as background traffic, and as an
    /// agent that acts.
    fn departures(&self, planned: usize) -> Vec<(u32, u32)> {
        let count = self.map.plan.departures.len();
        let source = self.map.plan.departures[planned].source;
        let (recruits, share) = (self.recruits.get(source), self.scenario.traffic.penetration);
        let mut all = Vec::new();
        for &(kind, _) in self.demand.sources[source].types.iter().filter(|entry| entry.1 > 0.0) {
            let may_be_agent = recruits.is_some_and(|recruits| recruits[kind]);
            if may_be_agent {
                all.push(((count + planned) as u32, self.agent_type(Driver::Agents, kind).0));
            }
            if !may_be_agent || share < 1.0 {
                all.push((planned as u32, self.demand_type(kind).0));
            }
        }
        all
    }
}
