//! What SUMO needs to know of a task: vehicle types, routes, and the background traffic.

use super::Task;
use crate::scenario::{Finish, PlannedDeparture, Start};
use crate::sumo::{BackgroundTraffic, Departure, Hosting, Route, SimulationConfig, VehicleType};

impl Task {
    /// Returns what a simulation of `worlds` worlds of this task needs to start.
    pub fn simulation_config(&self, seed: u64, worlds: u32, hosting: &Hosting) -> SimulationConfig {
        let control = &self.scenario.control;
        let of_kind = |kind: usize, id: &str, min_gap: f64| {
            let (control, vehicle) = &self.abilities[kind];
            let hardest = control.brake.last().map_or(control.drag, |point| point.1);
            VehicleType {
                id: id.to_owned(),
                length: vehicle.length,
                width: vehicle.width,
                class: None,
                max_speed: vehicle.max_speed,
                accel: control.accel,
                decel: hardest.min(4.5),
                emergency_decel: hardest,
                min_gap,
                tau: 1.0,
            }
        };
        let vehicle_type = |id: &str, min_gap: f64| of_kind(0, id, min_gap);
        // Agents may spawn as close to each other as the places allow. SUMO's driver keeps a gap,
        // but one that is small enough for vehicles to depart from neighbouring places under the
        // largest jitter.
        let own_types = (0..self.abilities.len()).flat_map(|kind| {
            let suffix =
                kind.checked_sub(1).map(|kind| format!(":{}", self.scenario.kinds[kind].id));
            let suffix = suffix.unwrap_or_default();
            let named = |name: &str, min_gap| of_kind(kind, &format!("{name}{suffix}"), min_gap);
            [named("agent", 0.0), named("sumo_driver", 1.0)]
        });
        let kinds = self.demand.types.iter().filter(|_| self.has_flow());
        SimulationConfig {
            net: self.map.net_file().to_owned(),
            step_length: control.interval,
            seed,
            worlds,
            slots: self.slots() as u32,
            others: (self.others > 0 || self.changes_lanes()).then(|| self.road_users()),
            timeout: hosting.timeout,
            audit: hosting.audit,
            waits: self.places.iter().any(|place| !place.departure.is_immediate()),
            traffic_lights: self.map.traffic_lights.lights.iter().map(|l| l.id.clone()).collect(),
            vehicle_types: own_types
                .chain(kinds.map(|kind| VehicleType {
                    length: kind.length,
                    width: kind.width,
                    class: Some(kind.class.to_owned()),
                    // Agents from route files depart with the gap that SUMO's cars keep.
                    ..vehicle_type(&self.unused_type(&kind.id), 2.5)
                }))
                .collect(),
            routes: (self.map.route_ids.iter().zip(&self.map.route_edges).zip(&self.map.routes))
                .take(self.map.given)
                .map(|((id, edges), geometry)| Route {
                    id: id.clone(),
                    edges: edges.clone(),
                    lane: geometry.first_lane,
                    walked: geometry.is_walked(),
                })
                .collect(),
        }
    }

    /// Returns an id for the type of agents that have the size of the type `id`.
    fn unused_type(&self, id: &str) -> String {
        let mut own = format!("agent:{id}");
        while self.demand.types.iter().any(|kind| kind.id == own) {
            own.push('_');
        }
        own
    }

    /// Returns what SUMO needs to know about background traffic and about agents from route files.
    fn road_users(&self) -> BackgroundTraffic {
        let departure = |planned: &PlannedDeparture| {
            let route = planned.route as u32;
            if let Some([pos, arrival]) = planned.walk {
                return Departure::Walk { route, pos, arrival };
            }
            let source = &self.demand.sources[planned.source];
            let Start { lane, pos, speed } = source.start.clone();
            let Finish { lane: arrival_lane, pos: arrival_pos, speed: arrival_speed } =
                source.finish.clone();
            Departure::Drive {
                route,
                lane,
                pos,
                speed,
                arrival_lane,
                arrival_pos,
                arrival_speed,
                line: source.line.clone(),
                persons: source.persons,
                speed_factor: source.speed_factor,
                stops: planned.stops.clone(),
            }
        };
        let departures = &self.map.plan.departures;
        let agents = departures.iter().filter(|_| self.has_flow());
        // An agent keeps the lane of its path, drives no faster than agents can, and makes no stops.
        let agent = |mut departure: Departure| {
            if let Departure::Drive { route, lane, speed, arrival_lane, stops, .. } = &mut departure
            {
                *lane = self.map.routes[*route as usize].first_lane.to_string();
                let most = self.scenario.vehicle.max_speed;
                if speed.parse().is_ok_and(|speed: f64| speed > most) {
                    *speed = most.to_string();
                }
                "current".clone_into(arrival_lane);
                stops.clear();
            }
            departure
        };
        let name = |planned: &PlannedDeparture| self.demand.sources[planned.source].name();
        BackgroundTraffic {
            first_slot: if self.has_flow() || self.changes_lanes() {
                0
            } else {
                self.agents as u32
            },
            definitions: self.demand.definitions.clone(),
            types: self.demand.types.iter().map(|kind| kind.id.clone()).collect(),
            departures: departures
                .iter()
                .map(departure)
                .chain(agents.clone().map(|planned| agent(departure(planned))))
                .collect(),
            names: departures.iter().chain(agents).map(name).collect(),
        }
    }
}
