//! The TraCI calls of the environments' commands. Every backend carries out the calls that this
//! module writes: TraCI sends the batch, and libsumo reads the calls back from it.

use std::fmt::Write as _;

use super::{Entry, Fleet, Slot};
use crate::sumo::{
    Batch, Command, Departure, Error, Route, SimulationConfig, constants as c,
    domain::{
        self,
        person::Walk,
        vehicle::{Addition, Placement},
    },
    net::tiled_id,
};

impl Fleet {
    /// Writes the calls that define the vehicle types and routes.
    pub(in crate::sumo) fn define(&self, batch: &mut Batch) {
        for kind in &self.config.vehicle_types {
            let mut types = batch.vehicle_type();
            types.copy("DEFAULT_VEHTYPE", &kind.id);
            types.set_length(&kind.id, kind.length);
            types.set_width(&kind.id, kind.width);
            if let Some(class) = &kind.class {
                types.set_vehicle_class(&kind.id, class);
            }
            types.set_min_gap(&kind.id, kind.min_gap);
            types.set_max_speed(&kind.id, kind.max_speed);
            types.set_accel(&kind.id, kind.accel);
            // This deceleration must be set before the comfortable one, which may not exceed it.
            types.set_emergency_decel(&kind.id, kind.emergency_decel);
            types.set_decel(&kind.id, kind.decel);
            types.set_tau(&kind.id, kind.tau);
            types.set_imperfection(&kind.id, 0.0);
            types.set_speed_factor(&kind.id, 1.0);
            types.set_speed_deviation(&kind.id, 0.0);
        }
        for route in self.routes.iter().filter(|route| !route.walked) {
            batch.route().add(&route.id, &route.edges);
        }
    }

    /// Checks the commands and writes their calls. After an error, the commands have no effect on
    /// this state, and the batch is not to be sent.
    pub(in crate::sumo) fn write(
        &mut self,
        commands: &[Command],
        batch: &mut Batch,
    ) -> Result<(), Error> {
        self.next.copy_from_slice(&self.slots);
        commands.iter().try_for_each(|command| self.call(command, batch))
    }

    /// Writes the calls of one command.
    fn call(&mut self, command: &Command, batch: &mut Batch) -> Result<(), Error> {
        match *command {
            Command::Add { world, slot, route, vehicle_type, depart_pos, depart_speed } => {
                let vehicle = self.vacant(world, slot)?;
                finite("a departure position", depart_pos)?;
                finite("a departure speed", depart_speed)?;
                let lane = f64::from(self.route(world, route)?.lane);
                for (text, number) in self.texts.iter_mut().zip([lane, depart_pos, depart_speed]) {
                    text.clear();
                    // Writing to a `String` cannot fail.
                    let _ = write!(text, "{number}");
                }
                let start = self.texts.each_ref().map(String::as_str);
                let addition = addition(self.route(world, route)?, self.kind(vehicle_type)?, start);
                batch.vehicle().add(&self.names[vehicle], &addition);
                let departed = depart_pos;
                let entry = if self.config.waits { Entry::Awaited } else { Entry::Done };
                self.next[vehicle] = Slot { known: true, departed, entry, ..Slot::default() };
            }
            Command::Depart { world, slot, departure: index, vehicle_type, until_from_now } => {
                let vehicle = self.vacant(world, slot)?;
                let others = self.config.others.as_ref();
                let departures = others.map_or(&[][..], |others| &others.departures);
                let unknown = || {
                    let known = departures.len();
                    Error::invalid(format!("there is no departure {index}: there are {known}"))
                };
                let departure = departures.get(index as usize).ok_or_else(unknown)?;
                let route = self.route(world, departure.route())?;
                let (name, kind) = (&self.names[vehicle], self.kind(vehicle_type)?);
                match departure {
                    Departure::Drive {
                        route: _,
                        lane,
                        pos,
                        speed,
                        arrival_lane,
                        arrival_pos,
                        arrival_speed,
                        line,
                        persons,
                        speed_factor,
                        stops,
                    } => {
                        let addition = Addition {
                            arrival_lane,
                            arrival_pos,
                            arrival_speed,
                            line,
                            person_number: *persons as i32,
                            ..addition(route, kind, [lane, pos, speed])
                        };
                        batch.vehicle().add(name, &addition);
                        if let Some(factor) = speed_factor {
                            batch.vehicle().set_speed_factor(name, *factor);
                        }
                        for stop in stops {
                            let edge = self.tiled(world, &stop.edge);
                            let clock = self.snapshot.time + until_from_now;
                            let [start_pos, end_pos] = stop.range;
                            let until = stop.until.map(|until| (clock + until).max(0.0));
                            let on_edge = domain::vehicle::Stop::on_edge(&edge, end_pos);
                            let stop = domain::vehicle::Stop {
                                lane: stop.lane as i8,
                                duration: stop.duration,
                                start_pos,
                                until: until.unwrap_or(on_edge.until),
                                ..on_edge
                            };
                            batch.vehicle().set_stop(name, &stop);
                        }
                    }
                    Departure::Walk { pos, arrival, .. } => {
                        let first = route.edges.first().map_or("", String::as_str);
                        batch.person().add(name, kind, first, c::DEPART_NOW, *pos);
                        let walk = Walk::to(*arrival);
                        batch.person().append_walking_stage(name, &route.edges, &walk);
                    }
                }
                // SUMO chooses the position; the distance of a vehicle that SUMO drives is not
                // used.
                let (walks, departure) = (route.walked, Some(index));
                let entry = if walks { Entry::Done } else { Entry::Awaited };
                self.next[vehicle] =
                    Slot { known: true, walks, departure, entry, ..Slot::default() };
            }
            Command::Remove { world, slot } => {
                let vehicle = self.vehicle(world, slot)?;
                if std::mem::take(&mut self.next[vehicle].known) {
                    let name = &self.names[vehicle];
                    if self.next[vehicle].walks {
                        batch.person().remove(name, c::REMOVE_VAPORIZED);
                    } else {
                        batch.vehicle().remove(name, c::REMOVE_VAPORIZED);
                    }
                }
            }
            Command::SetSpeed { world, slot, speed } => {
                finite("a speed", speed)?;
                let vehicle = self.vehicle(world, slot)?;
                if self.next[vehicle].walks {
                    batch.person().set_speed(&self.names[vehicle], speed);
                } else {
                    batch.vehicle().set_speed(&self.names[vehicle], speed);
                }
            }
            Command::SpeedMode { world, slot, mode } => {
                let vehicle = self.vehicle(world, slot)?;
                // Pedestrians have no speed mode.
                if !self.next[vehicle].walks {
                    batch.vehicle().set_speed_mode(&self.names[vehicle], mode);
                }
            }
            Command::LaneChangeMode { world, slot, mode } => {
                let name = &self.names[self.vehicle(world, slot)?];
                batch.vehicle().set_lane_change_mode(name, mode);
            }
            Command::ChangeLane { world, slot, lane } => {
                let name = &self.names[self.vehicle(world, slot)?];
                let lane = i8::try_from(lane)
                    .map_err(|_| Error::invalid(format!("no edge has a lane {lane}")))?;
                // With a duration of 0, the request ends with the coming step.
                batch.vehicle().change_lane(name, lane, 0.0);
            }
            Command::MoveTo { world, slot, x, y, heading, keep_route } => {
                finite("a coordinate", x)?;
                finite("a coordinate", y)?;
                finite("a heading", heading)?;
                let vehicle = self.vehicle(world, slot)?;
                let [dx, dy] = self.offsets[world as usize];
                let angle = (90.0 - heading.to_degrees()).rem_euclid(360.0);
                let placement = Placement { angle, keep_route, ..Placement::default() };
                batch.vehicle().move_to_xy(&self.names[vehicle], [x + dx, y + dy], &placement);
            }
            Command::StartPhase { world, traffic_light, phase, remaining } => {
                finite("a duration", remaining)?;
                let name = self.light(world, traffic_light)?;
                batch.traffic_light().set_phase(name, phase as i32);
                batch.traffic_light().set_phase_duration(name, remaining);
            }
        }
        Ok(())
    }

    /// Returns the index of a slot that the commands so far leave empty.
    fn vacant(&self, world: u32, slot: u32) -> Result<usize, Error> {
        let vehicle = self.vehicle(world, slot)?;
        if self.next[vehicle].known {
            return Err(Error::invalid(format!("slot {slot} holds a vehicle; remove it first")));
        }
        Ok(vehicle)
    }

    fn vehicle(&self, world: u32, slot: u32) -> Result<usize, Error> {
        let SimulationConfig { worlds, slots, .. } = self.config;
        if world < worlds && slot < slots {
            return Ok((world * slots + slot) as usize);
        }
        Err(Error::invalid(format!(
            "there is no slot {slot} in world {world}: there are {worlds} worlds of {slots} slots"
        )))
    }

    /// Returns the name of a world's traffic light, given by its index.
    fn light(&self, world: u32, index: u32) -> Result<&str, Error> {
        let known = self.config.traffic_lights.len();
        if world < self.config.worlds && (index as usize) < known {
            return Ok(&self.traffic_lights[world as usize * known + index as usize]);
        }
        Err(Error::invalid(format!(
            "there is no traffic light {index} in world {world}: there are {known} in each of {} worlds",
            self.config.worlds
        )))
    }

    /// Returns a world's copy of a route, given by its index.
    fn route(&self, world: u32, route: u32) -> Result<&Route, Error> {
        let known = self.config.routes.len();
        if route as usize >= known {
            return Err(Error::invalid(format!("there is no route {route}: there are {known}")));
        }
        Ok(&self.routes[world as usize * known + route as usize])
    }

    /// Returns the id of an edge in a world's copy of the net.
    fn tiled(&self, world: u32, edge: &str) -> String {
        if self.config.worlds == 1 { edge.to_owned() } else { tiled_id(world, edge) }
    }

    /// Returns the id of a vehicle type, given by its index.
    fn kind(&self, index: u32) -> Result<&str, Error> {
        let own = self.config.vehicle_types.iter().map(|kind| &kind.id);
        let others = self.config.others.iter().flat_map(|others| &others.types);
        let all = own.chain(others);
        all.clone().nth(index as usize).map(String::as_str).ok_or_else(|| {
            let known = all.count();
            Error::invalid(format!("there is no vehicle type {index}: there are {known}"))
        })
    }
}

/// Returns a vehicle on a route; `start` holds lane, position and speed as strings, which SUMO
/// requires.
fn addition<'a>(route: &'a Route, vehicle_type: &'a str, start: [&'a str; 3]) -> Addition<'a> {
    let [depart_lane, depart_pos, depart_speed] = start;
    let on_route = Addition::on_route(&route.id);
    Addition { vehicle_type, depart_lane, depart_pos, depart_speed, ..on_route }
}

fn finite(what: &str, value: f64) -> Result<(), Error> {
    if value.is_finite() {
        return Ok(());
    }
    Err(Error::invalid(format!("{what} must be a number, not {value}")))
}
