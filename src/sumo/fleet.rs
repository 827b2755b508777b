//! State that all backends share: the names and positions of the vehicles of all worlds, and which
//! vehicles SUMO knows.
//!
//! The vehicle in slot `s` of world `w` is called `w<w>s<s>`. With more than one world the net is
//! tiled, and routes and coordinates are those of the world's tile.

mod arguments;
mod commands;

use std::{collections::HashMap, fs::File, sync::Arc};

use super::{
    Body, Collision, Dropped, Error, Route, SimulationConfig, Snapshot, TrafficLightState,
    VehicleState, constants as c,
    net::{Net, tiled_id},
};
use arguments::{in_memory, write_tiles};

/// The state of a slot.
#[derive(Debug, Clone, Copy, Default)]
struct Slot {
    /// Whether SUMO knows the vehicle of the slot, either on the road or waiting for insertion.
    known: bool,
    /// Whether the slot's last occupant is a pedestrian.
    walks: bool,
    /// The departure of background traffic that filled the slot: its index in the configuration.
    departure: Option<u32>,
    /// Position of the front bumper on the route's first edge at departure \[m\].
    departed: f64,
    /// Whether a background vehicle is still to enter the road.
    entry: Entry,
}

/// How far a background vehicle has come that SUMO has accepted.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
enum Entry {
    /// It has entered the road, or is none.
    #[default]
    Done,
    /// It has not been on the road yet.
    Awaited,
    /// SUMO reports that it waits for room on the road.
    Pending,
}

#[derive(Debug, Clone)]
pub(super) struct Fleet {
    config: SimulationConfig,
    /// Names of the vehicles, `[worlds * slots]` as all vectors of vehicles in this struct.
    pub(super) names: Vec<String>,
    /// Routes of all tiles, `[worlds * routes]`.
    routes: Vec<Route>,
    /// Id of one junction of each world; empty for a net without junctions.
    pub(super) junctions: Vec<String>,
    /// Names of the traffic lights, `[worlds * traffic lights]`.
    pub(super) traffic_lights: Vec<String>,
    /// Indices of these names.
    light_by_name: HashMap<String, usize>,
    /// Radius around a junction that covers all of its world and nothing of any other world \[m\].
    pub(super) diagonal: f64,
    offsets: Vec<[f64; 2]>,
    /// The tiled net, an unnamed file, so that no file remains however the program ends.
    tiled: Option<Arc<File>>,
    /// Definitions of vehicle types, an unnamed file as well.
    definitions: Option<Arc<File>>,
    /// Indices of the net's lanes by their ids without the colon of lanes in junctions: first those
    /// on roads, then those in junctions. Empty without background traffic.
    lanes: [HashMap<String, u32>; 2],
    /// State of each slot.
    slots: Vec<Slot>,
    /// State of each slot after the exchange in progress.
    next: Vec<Slot>,
    /// Lane, position and speed of the last [`Command::Add`] as strings, kept to reuse their
    /// buffers.
    texts: [String; 3],
    pub(super) snapshot: Snapshot,
}

impl Fleet {
    pub(super) fn new(config: SimulationConfig) -> Result<Self, Error> {
        let (worlds, slots) = (config.worlds, config.slots);
        if worlds == 0 {
            return Err(Error::invalid("a simulation hosts at least one world"));
        }
        let vehicles = (worlds as usize) * slots as usize;
        let text = Net::text(&config.net).map_err(Box::new)?;
        let net = Net::parse(&text, &config.net).map_err(Box::new)?;
        let (tiled, offsets) = if worlds == 1 {
            (None, vec![[0.0; 2]])
        } else {
            let (file, offsets) = write_tiles(&config, &text)?;
            (Some(file), offsets)
        };
        let definitions = match &config.others {
            Some(others) if !others.definitions.is_empty() => Some(in_memory(
                "types.add.xml",
                &format!("<additional>\n{}</additional>\n", others.definitions),
            )?),
            _ => None,
        };
        let bodies = if config.others.is_some() { vehicles } else { 0 };
        let [low, high] = net.extent();
        let named = |world: u32, id: &String| {
            if worlds == 1 { id.clone() } else { tiled_id(world, id) }
        };
        let copy = |world: u32, route: &Route| Route {
            id: named(world, &route.id),
            edges: route.edges.iter().map(|edge| named(world, edge)).collect(),
            ..*route
        };
        let junction = net.junctions.first();
        let lights = |world| config.traffic_lights.iter().map(move |id| named(world, id));
        let traffic_lights: Vec<String> = (0..worlds).flat_map(lights).collect();
        Ok(Fleet {
            names: (0..worlds).flat_map(|w| (0..slots).map(move |s| format!("w{w}s{s}"))).collect(),
            routes: (0..worlds)
                .flat_map(|world| config.routes.iter().map(move |route| copy(world, route)))
                .collect(),
            junctions: junction
                .map(|j| (0..worlds).map(|world| named(world, &j.id)).collect())
                .unwrap_or_default(),
            light_by_name: traffic_lights.iter().cloned().zip(0..).collect(),
            diagonal: (high[0] - low[0]).hypot(high[1] - low[1]).max(0.0),
            lanes: if config.others.is_some() { lanes_by_id(&net) } else { Default::default() },
            offsets,
            tiled,
            definitions,
            slots: vec![Slot::default(); vehicles],
            next: vec![Slot::default(); vehicles],
            texts: Default::default(),
            snapshot: Snapshot {
                vehicles: vec![None; vehicles],
                bodies: vec![None; bodies],
                traffic_lights: vec![TrafficLightState::default(); traffic_lights.len()],
                ..Snapshot::default()
            },
            traffic_lights,
            config,
        })
    }

    pub(super) fn config(&self) -> &SimulationConfig {
        &self.config
    }

    pub(super) fn reseed(&mut self, seed: u64) {
        self.config.seed = seed;
    }

    /// Resets the state to that of a new SUMO instance, which has no vehicles.
    pub(super) fn empty(&mut self) {
        self.slots.iter_mut().for_each(|slot| slot.known = false);
        self.snapshot.time = 0.0;
        self.clear_snapshot();
    }

    /// Prepares for the reports of the step of the last commands.
    pub(super) fn begin_step(&mut self) {
        self.slots.copy_from_slice(&self.next);
        self.clear_snapshot();
    }

    fn clear_snapshot(&mut self) {
        self.snapshot.vehicles.fill(None);
        self.snapshot.bodies.fill(None);
        self.snapshot.collisions.clear();
        self.snapshot.dropped.clear();
        for slot in self.slots.iter_mut().filter(|slot| slot.entry == Entry::Pending) {
            slot.entry = Entry::Awaited;
        }
    }

    /// Records SUMO's report of a vehicle: the `distance` that it has driven since its departure
    /// \[m\] and its `speed` \[m/s\].
    pub(super) fn report(&mut self, vehicle: usize, distance: f64, speed: f64) {
        // A vehicle that waits for insertion has no distance.
        if distance != c::INVALID_DOUBLE_VALUE {
            let distance = self.slots[vehicle].departed + distance;
            self.snapshot.vehicles[vehicle] = Some(VehicleState { distance, speed });
        }
    }

    /// Records the pose of a vehicle that SUMO drives: the centre of its front bumper, `angle` in
    /// navigational degrees, the [`Fleet::lane`], and SUMO's time loss \[s\]. Ignores agents and
    /// vehicles that wait for insertion.
    pub(super) fn body(
        &mut self,
        vehicle: usize,
        [x, y]: [f64; 2],
        angle: f64,
        lane: Option<u32>,
        time_loss: f64,
    ) {
        let slots = self.config.slots as usize;
        let first = self.config.others.as_ref().map_or(slots, |others| others.first_slot as usize);
        if vehicle % slots >= first && x != c::INVALID_DOUBLE_VALUE {
            let [dx, dy] = self.offsets[vehicle / slots];
            let heading = (90.0 - angle).to_radians();
            self.snapshot.bodies[vehicle] =
                Some(Body { x: x - dx, y: y - dy, heading, lane, time_loss });
        }
    }

    /// Returns the index of a lane in the net, given by its id in SUMO, where it may be a copy.
    pub(super) fn lane(&self, id: &str) -> Option<u32> {
        let (id, internal) = match id.strip_prefix(':') {
            Some(rest) => (rest, 1),
            None => (id, 0),
        };
        let id = if self.config.worlds == 1 { id } else { id.split_once('.')?.1 };
        self.lanes[internal].get(id).copied()
    }

    /// Returns the state of the traffic light of this name, to be recorded.
    pub(super) fn traffic_light(&mut self, name: &str) -> Option<&mut TrafficLightState> {
        let light = *self.light_by_name.get(name)?;
        self.snapshot.traffic_lights.get_mut(light)
    }

    /// Records the pose and the speed of a pedestrian, with arguments as in [`Fleet::body`].
    pub(super) fn pedestrian(&mut self, person: usize, position: [f64; 2], angle: f64, speed: f64) {
        if self.walks(person) && position[0] != c::INVALID_DOUBLE_VALUE {
            self.body(person, position, angle, None, 0.0);
            self.snapshot.vehicles[person] = Some(VehicleState { distance: 0.0, speed });
        }
    }

    /// Returns an error in which a vehicle or pedestrian of a route file has its own name instead
    /// of that of its slot.
    pub(super) fn named(&self, mut error: Error) -> Error {
        if let Error::Refused { id, message, .. } = &mut error
            && let Some(vehicle) = self.vehicle_named(id)
            && let Some(departure) = self.slots[vehicle].departure
            && let Some(name) =
                self.config.others.as_ref().and_then(|o| o.names.get(departure as usize))
        {
            *message = message.replace(&format!("'{id}'"), &format!("'{name}'"));
            id.clone_from(name);
        }
        error
    }

    /// Whether the slot's last occupant is a pedestrian.
    pub(super) fn walks(&self, vehicle: usize) -> bool {
        self.slots[vehicle].walks
    }

    /// Whether any route is for pedestrians.
    pub(super) fn has_walks(&self) -> bool {
        self.routes.iter().any(|route| route.walked)
    }

    /// Records that SUMO no longer knows the vehicle or pedestrian of this name, which has arrived
    /// or was refused.
    pub(super) fn gone(&mut self, name: &str) {
        if let Some(vehicle) = self.vehicle_named(name) {
            self.slots[vehicle].known = false;
        }
    }

    /// Whether vehicles may have to wait for room on the road, so that SUMO may drop some.
    pub(super) fn may_drop(&self) -> bool {
        let others = self.config.others.as_ref();
        self.config.waits || others.is_some_and(|others| !others.departures.is_empty())
    }

    /// Records that the vehicle of this name waits for room on the road.
    pub(super) fn pending(&mut self, name: &str) {
        let vehicle = self.vehicle_named(name);
        if let Some(vehicle) = vehicle.filter(|&at| self.slots[at].entry == Entry::Awaited) {
            self.slots[vehicle].entry = Entry::Pending;
        }
    }

    /// Finds the vehicles that SUMO has dropped: it has accepted them, and they neither are on the
    /// road, nor wait for room there, nor have arrived. Everything else of a step is to be recorded
    /// before.
    pub(super) fn find_dropped(&mut self) {
        for vehicle in 0..self.slots.len() {
            let slot = &mut self.slots[vehicle];
            if slot.entry != Entry::Done
                && (!slot.known || self.snapshot.vehicles[vehicle].is_some())
            {
                slot.entry = Entry::Done;
            }
            if slot.entry == Entry::Awaited {
                self.drop_out(vehicle, None);
            }
        }
    }

    /// Records what SUMO has refused of a departure: the vehicle, or one of its stops. Returns any
    /// other error, with the vehicle's own name.
    pub(super) fn refuse(&mut self, error: Error) -> Option<Error> {
        let Error::Refused { call, id, message, .. } = &error else { return Some(error) };
        let vehicle = self.vehicle_named(id);
        let is_new = matches!(call.as_str(), "vehicle.add" | "person.add");
        match vehicle.filter(|&vehicle| self.slots[vehicle].departure.is_some()) {
            Some(vehicle) if is_new => self.drop_out(vehicle, Some(message.clone())),
            Some(vehicle) if call == "vehicle.setStop" && self.slots[vehicle].known => {
                self.report_drop(vehicle, Some(message.clone()), true);
            }
            // What else is said to a vehicle that SUMO has just refused.
            Some(vehicle) if self.is_dropped(vehicle) => {}
            _ => {
                if is_new {
                    let id = id.clone();
                    self.gone(&id);
                }
                return Some(self.named(error));
            }
        }
        None
    }

    fn is_dropped(&self, vehicle: usize) -> bool {
        let place = (vehicle as u32 / self.config.slots, vehicle as u32 % self.config.slots);
        self.snapshot.dropped.iter().any(|d| !d.drives && (d.world, d.slot) == place)
    }

    /// Records that SUMO has dropped the vehicle of this name.
    #[cfg(feature = "libsumo")]
    pub(super) fn dropped(&mut self, name: &str) {
        if let Some(vehicle) = self.vehicle_named(name) {
            self.drop_out(vehicle, None);
        }
    }

    fn drop_out(&mut self, vehicle: usize, reason: Option<String>) {
        let slot = &mut self.slots[vehicle];
        (slot.known, slot.entry) = (false, Entry::Done);
        self.report_drop(vehicle, reason, false);
    }

    fn report_drop(&mut self, vehicle: usize, reason: Option<String>, drives: bool) {
        let (slots, departure) = (self.config.slots, self.slots[vehicle].departure);
        let (world, slot) = (vehicle as u32 / slots, vehicle as u32 % slots);
        self.snapshot.dropped.push(Dropped { world, slot, departure, reason, drives });
    }

    /// Records a collision that SUMO reports. Ignores collisions with vehicles that are not in this
    /// fleet, those of a vehicle with itself, which SUMO reports on roads with `bidi`, and those with
    /// pedestrians, because SUMO's collision test gives pedestrians another shape.
    pub(super) fn collision(&mut self, collider: &str, victim: &str) {
        let (Some(collider), Some(victim)) =
            (self.vehicle_named(collider), self.vehicle_named(victim))
        else {
            return;
        };
        if collider == victim || self.walks(collider) || self.walks(victim) {
            return;
        }
        let slots = self.config.slots;
        let (collider, victim) = (collider as u32, victim as u32);
        if collider / slots == victim / slots {
            self.snapshot.collisions.push(Collision {
                world: collider / slots,
                collider: collider % slots,
                victim: victim % slots,
            });
        }
    }

    /// Returns the index of the vehicle of this name, or `None` if the name belongs to no slot.
    pub(super) fn vehicle_named(&self, name: &str) -> Option<usize> {
        let (world, slot) = name.strip_prefix('w')?.split_once('s')?;
        let (world, slot): (u32, u32) = (world.parse().ok()?, slot.parse().ok()?);
        (world < self.config.worlds && slot < self.config.slots)
            .then_some((world * self.config.slots + slot) as usize)
    }

    /// Whether SUMO knows the vehicle or pedestrian of the slot.
    #[cfg(feature = "libsumo")]
    pub(super) fn knows(&self, vehicle: usize) -> bool {
        self.slots[vehicle].known
    }

    /// Returns the indices of the vehicles, or of the pedestrians, that SUMO knows after the
    /// commands.
    #[cfg(feature = "libsumo")]
    pub(super) fn expected(&self, walk: bool) -> impl Iterator<Item = usize> {
        let known = self.next.iter().enumerate().filter(move |(_, s)| s.known && s.walks == walk);
        known.map(|(vehicle, _)| vehicle)
    }
}

fn lanes_by_id(net: &Net) -> [HashMap<String, u32>; 2] {
    let mut lanes = [HashMap::new(), HashMap::new()];
    for (lane, index) in net.lanes.iter().zip(0..) {
        match lane.id.strip_prefix(':') {
            Some(id) => lanes[1].insert(id.to_owned(), index),
            None => lanes[0].insert(lane.id.clone(), index),
        };
    }
    lanes
}

#[cfg(test)]
mod tests;
