//! Lets everyone of the route files depart once, alone, to find those whom SUMO refuses.

use std::collections::{HashMap, hash_map::Entry};

use super::error::Error;
use super::task::Task;
use crate::scenario::LeftOut;
use crate::sumo::{self, Backend, Command, Departure, Hosting};

impl Task {
    /// Returns the vehicles and persons of the route files whom SUMO refuses, each with SUMO's
    /// reason.
    ///
    /// # Errors
    /// [`Error::Sumo`] if SUMO fails.
    pub fn refused_departures(&self, hosting: &Hosting) -> Result<Vec<LeftOut>, Error> {
        let plan = &self.map.plan;
        let mut refused: Vec<LeftOut> = Vec::new();
        if plan.departures.is_empty() {
            return Ok(refused);
        }
        let failed = |source| Error::Sumo { world: 0, episode: 0, step: 0, source };
        let config = self.simulation_config(0, 1, hosting);
        let departures = config.others.iter().flat_map(|others| others.departures.clone());
        let departures: Vec<Departure> = departures.collect();
        // Vehicles that depart alike share the answer, because there may be thousands of them.
        let mut answers: HashMap<(u32, String), Option<String>> = HashMap::new();
        let mut simulation = sumo::start(Backend::Traci, config).map_err(failed)?;
        let mut exchange = |commands: &[Command]| {
            simulation.send(commands)?;
            match simulation.receive() {
                Ok(snapshot) => {
                    let dropped = !snapshot.dropped.is_empty();
                    Ok(dropped.then(|| "SUMO drops it when it departs".to_owned()))
                }
                Err(sumo::Error::Refused { message, .. }) => {
                    Ok(Some(format!("SUMO refuses it: {}", message.trim())))
                }
                Err(error) => Err(error),
            }
        };
        let (world, slot) = (0, (self.agents + self.placed) as u32);
        for (index, planned) in plan.departures.iter().enumerate() {
            let source = &self.demand.sources[planned.source];
            for &(kind, _) in source.types.iter().filter(|entry| entry.1 > 0.0) {
                let (vehicle_type, _) = self.demand_type(kind);
                let departure = index as u32;
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
                if let Some(reason) = reason
                    && refused.last().is_none_or(|last| last.place != source.place)
                {
                    let (id, element) = (source.id.clone(), source.element);
                    refused.push(LeftOut { id, element, place: source.place.clone(), reason });
                }
            }
        }
        Ok(refused)
    }
}
