//! State that all backends share: the names and positions of the vehicles of all worlds, and which
//! vehicles SUMO knows.
//!
//! The vehicle in slot `s` of world `w` is called `w<w>s<s>`. With more than one world the net is
//! tiled, and routes and coordinates are those of the world's tile.

use std::{
    ffi::OsString,
    fmt::Write as _,
    fs::File,
    io::{Seek as _, Write as _},
    os::fd::AsRawFd as _,
    path::PathBuf,
    sync::Arc,
};

use rustix::fs::{MemfdFlags, memfd_create};

use super::{
    Body, Collision, Command, Departure, Error, Route, SimulationConfig, Snapshot, VehicleState,
    constants as c,
    net::{Net, tile, tiled_id},
};

/// A route in one of the tiles, with the tile's ids.
#[derive(Debug, Clone)]
pub(super) struct TileRoute {
    pub(super) id: String,
    pub(super) edges: Vec<String>,
    pub(super) lane: u32,
    pub(super) walked: bool,
}

/// A vehicle or pedestrian of this simulation.
#[derive(Debug, Clone, Copy)]
pub(super) struct Vehicle<'a> {
    /// Index into the vectors of [`Fleet`].
    #[cfg_attr(not(feature = "libsumo"), expect(dead_code, reason = "TraCI goes by names"))]
    pub(super) index: usize,
    /// Name in SUMO.
    pub(super) name: &'a str,
}

/// SUMO's lane change mode in which a vehicle never changes lanes by itself.
const NO_LANE_CHANGES: i32 = 0;

/// Receives the commands after their check, with the names that SUMO knows.
pub(super) trait Orders {
    fn add(
        &mut self,
        vehicle: Vehicle<'_>,
        route: &TileRoute,
        vehicle_type: &str,
        position: f64,
        speed: f64,
    );
    /// Adds a vehicle; `start` holds lane, position and speed as strings that SUMO understands.
    fn depart(
        &mut self,
        vehicle: Vehicle<'_>,
        route: &TileRoute,
        vehicle_type: &str,
        start: [&str; 3],
    );
    fn remove(&mut self, vehicle: Vehicle<'_>);
    /// Adds a pedestrian who walks between two positions, `ends` \[m\]: one on the route's first
    /// edge, one on the last.
    fn walk(&mut self, person: Vehicle<'_>, route: &TileRoute, person_type: &str, ends: [f64; 2]);
    fn remove_person(&mut self, person: Vehicle<'_>);
    fn set_walking_speed(&mut self, person: Vehicle<'_>, speed: f64);
    fn set_speed(&mut self, vehicle: Vehicle<'_>, speed: f64);
    fn set_speed_mode(&mut self, vehicle: Vehicle<'_>, mode: i32);
    fn set_lane_change_mode(&mut self, vehicle: Vehicle<'_>, mode: i32);
    /// Moves a vehicle to a pose; `angle` is navigational \[deg\].
    fn move_to(&mut self, vehicle: Vehicle<'_>, x: f64, y: f64, angle: f64, keep_route: u8);
}

#[derive(Debug, Clone)]
pub(super) struct Fleet {
    config: SimulationConfig,
    /// Names of the vehicles, `[worlds * slots]` as all vectors of vehicles in this struct.
    pub(super) names: Vec<String>,
    /// Routes of all tiles, `[worlds * routes]`.
    pub(super) routes: Vec<TileRoute>,
    /// Id of one junction of each world.
    pub(super) junctions: Vec<String>,
    /// Radius around a junction that covers all of its world and nothing of any other world \[m\].
    pub(super) diagonal: f64,
    offsets: Vec<[f64; 2]>,
    /// The tiled net, an unnamed file, so that no file remains however the program ends.
    tiled: Option<Arc<File>>,
    /// Definitions of vehicle types, an unnamed file as well.
    definitions: Option<Arc<File>>,
    /// Whether SUMO knows the vehicle of the slot, either on the road or waiting for insertion.
    pub(super) known: Vec<bool>,
    /// Value of `known` after the exchange in progress.
    next: Vec<bool>,
    /// Position of the front bumper on the route's first edge at departure \[m\].
    departed: Vec<f64>,
    /// Value of `departed` after the exchange in progress.
    next_departed: Vec<f64>,
    /// Whether the slot's last occupant is a pedestrian; empty without background traffic.
    walking: Vec<bool>,
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
        let junctions = net.junctions.first().map(|j| {
            if worlds == 1 {
                vec![j.id.clone()]
            } else {
                (0..worlds).map(|w| tiled_id(w, &j.id)).collect()
            }
        });
        let routes = (0..worlds).flat_map(|world| {
            config.routes.iter().map(move |route| {
                if worlds == 1 {
                    let Route { id, edges, lane, walked } = route.clone();
                    return TileRoute { id, edges, lane, walked };
                }
                let edges = route.edges.iter().map(|edge| tiled_id(world, edge)).collect();
                TileRoute {
                    id: tiled_id(world, &route.id),
                    edges,
                    lane: route.lane,
                    walked: route.walked,
                }
            })
        });
        Ok(Fleet {
            names: (0..worlds).flat_map(|w| (0..slots).map(move |s| format!("w{w}s{s}"))).collect(),
            routes: routes.collect(),
            junctions: junctions.unwrap_or_default(),
            diagonal: (high[0] - low[0]).hypot(high[1] - low[1]).max(0.0),
            offsets,
            tiled,
            definitions,
            known: vec![false; vehicles],
            next: vec![false; vehicles],
            departed: vec![0.0; vehicles],
            next_departed: vec![0.0; vehicles],
            walking: vec![false; bodies],
            snapshot: Snapshot {
                vehicles: vec![None; vehicles],
                bodies: vec![None; bodies],
                ..Snapshot::default()
            },
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
        self.known.fill(false);
        self.snapshot.time = 0.0;
        self.snapshot.vehicles.fill(None);
        self.snapshot.bodies.fill(None);
        self.snapshot.collisions.clear();
    }

    /// Clears the snapshot before the reports of a step are read.
    pub(super) fn begin_step(&mut self) {
        self.known.copy_from_slice(&self.next);
        self.departed.copy_from_slice(&self.next_departed);
        self.snapshot.vehicles.fill(None);
        self.snapshot.bodies.fill(None);
        self.snapshot.collisions.clear();
    }

    /// Records SUMO's report of a vehicle: the `distance` that it has driven since its departure
    /// \[m\] and its `speed` \[m/s\].
    pub(super) fn report(&mut self, vehicle: usize, distance: f64, speed: f64) {
        // A vehicle that waits for insertion has no distance.
        if distance != c::INVALID_DOUBLE_VALUE {
            let distance = self.departed[vehicle] + distance;
            self.snapshot.vehicles[vehicle] = Some(VehicleState { distance, speed });
        }
    }

    /// Records the pose of a vehicle that SUMO drives: the centre of its front bumper, `angle` in
    /// navigational degrees, and SUMO's time loss \[s\]. Ignores agents and vehicles that wait for
    /// insertion.
    pub(super) fn body(&mut self, vehicle: usize, [x, y]: [f64; 2], angle: f64, time_loss: f64) {
        let slots = self.config.slots as usize;
        let first = self.config.others.as_ref().map_or(slots, |others| others.first_slot as usize);
        if vehicle % slots >= first && x != c::INVALID_DOUBLE_VALUE {
            let [dx, dy] = self.offsets[vehicle / slots];
            let heading = (90.0 - angle).to_radians();
            self.snapshot.bodies[vehicle] = Some(Body { x: x - dx, y: y - dy, heading, time_loss });
        }
    }

    /// Records the pose and the speed of a pedestrian, with arguments as in [`Fleet::body`].
    pub(super) fn pedestrian(&mut self, person: usize, position: [f64; 2], angle: f64, speed: f64) {
        if self.walks(person) && position[0] != c::INVALID_DOUBLE_VALUE {
            self.body(person, position, angle, 0.0);
            self.snapshot.vehicles[person] = Some(VehicleState { distance: 0.0, speed });
        }
    }

    /// Whether the slot's last occupant is a pedestrian.
    pub(super) fn walks(&self, vehicle: usize) -> bool {
        self.walking.get(vehicle).is_some_and(|walks| *walks)
    }

    /// Whether any route is for pedestrians.
    pub(super) fn has_walks(&self) -> bool {
        self.routes.iter().any(|route| route.walked)
    }

    /// Records that SUMO no longer knows the vehicle or pedestrian of this name, which has arrived
    /// or was refused.
    pub(super) fn gone(&mut self, name: &str) {
        if let Some(vehicle) = self.vehicle_named(name) {
            self.known[vehicle] = false;
        }
    }

    /// Records a collision that SUMO reports. Ignores collisions with vehicles that are not in this
    /// fleet, and those with pedestrians, because SUMO's collision test gives pedestrians another
    /// shape.
    pub(super) fn collision(&mut self, collider: &str, victim: &str) {
        let (Some(collider), Some(victim)) =
            (self.vehicle_named(collider), self.vehicle_named(victim))
        else {
            return;
        };
        if self.walks(collider) || self.walks(victim) {
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

    /// Checks the commands and passes them to `orders`.
    pub(super) fn order(
        &mut self,
        commands: &[Command],
        orders: &mut impl Orders,
    ) -> Result<(), Error> {
        self.next.copy_from_slice(&self.known);
        self.next_departed.copy_from_slice(&self.departed);
        for command in commands {
            match *command {
                Command::Add { world, slot, route, vehicle_type, depart_pos, depart_speed } => {
                    let vehicle = self.vehicle(world, slot)?;
                    if self.next[vehicle] {
                        return Err(Error::invalid(format!(
                            "slot {slot} holds a vehicle; remove it first"
                        )));
                    }
                    finite("a departure position", depart_pos)?;
                    finite("a departure speed", depart_speed)?;
                    let known = self.config.routes.len();
                    if route as usize >= known {
                        return Err(Error::invalid(format!(
                            "there is no route {route}: there are {known}"
                        )));
                    }
                    let route = &self.routes[world as usize * known + route as usize];
                    let kind = self.kind(vehicle_type)?;
                    orders.add(self.named(vehicle), route, kind, depart_pos, depart_speed);
                    if let Some(walks) = self.walking.get_mut(vehicle) {
                        *walks = false;
                    }
                    self.next_departed[vehicle] = depart_pos;
                    self.next[vehicle] = true;
                }
                Command::Depart { world, slot, departure, vehicle_type } => {
                    let vehicle = self.vehicle(world, slot)?;
                    if self.next[vehicle] {
                        return Err(Error::invalid(format!(
                            "slot {slot} holds a vehicle; remove it first"
                        )));
                    }
                    let ways =
                        self.config.others.as_ref().map_or(&[][..], |others| &others.departures);
                    let unknown = || {
                        Error::invalid(format!(
                            "there is no departure {departure}: there are {}",
                            ways.len()
                        ))
                    };
                    let way = ways.get(departure as usize).ok_or_else(unknown)?;
                    let (route, known) = (way.route() as usize, self.config.routes.len());
                    if route >= known {
                        return Err(Error::invalid(format!(
                            "there is no route {route}: there are {known}"
                        )));
                    }
                    let route = &self.routes[world as usize * known + route];
                    let (named, kind) = (self.named(vehicle), self.kind(vehicle_type)?);
                    match way {
                        Departure::Drive { lane, pos, speed, .. } => {
                            orders.depart(named, route, kind, [lane, pos, speed]);
                        }
                        Departure::Walk { pos, arrival, .. } => {
                            orders.walk(named, route, kind, [*pos, *arrival]);
                        }
                    }
                    if let Some(walks) = self.walking.get_mut(vehicle) {
                        *walks = route.walked;
                    }
                    // SUMO chooses the position; the distance of a vehicle that SUMO drives is not
                    // used.
                    self.next_departed[vehicle] = 0.0;
                    self.next[vehicle] = true;
                }
                Command::Remove { world, slot } => {
                    let vehicle = self.vehicle(world, slot)?;
                    if std::mem::take(&mut self.next[vehicle]) {
                        if self.walks(vehicle) {
                            orders.remove_person(self.named(vehicle));
                        } else {
                            orders.remove(self.named(vehicle));
                        }
                    }
                }
                Command::SetSpeed { world, slot, speed } => {
                    finite("a speed", speed)?;
                    let vehicle = self.vehicle(world, slot)?;
                    if self.walks(vehicle) {
                        orders.set_walking_speed(self.named(vehicle), speed);
                    } else {
                        orders.set_speed(self.named(vehicle), speed);
                    }
                }
                Command::SpeedMode { world, slot, mode } => {
                    let vehicle = self.vehicle(world, slot)?;
                    // Pedestrians have no speed mode.
                    if !self.walks(vehicle) {
                        orders.set_speed_mode(self.named(vehicle), mode);
                    }
                }
                Command::KeepLane { world, slot } => {
                    orders.set_lane_change_mode(
                        self.named(self.vehicle(world, slot)?),
                        NO_LANE_CHANGES,
                    );
                }
                Command::MoveTo { world, slot, x, y, heading, keep_route } => {
                    finite("a coordinate", x)?;
                    finite("a coordinate", y)?;
                    finite("a heading", heading)?;
                    let vehicle = self.vehicle(world, slot)?;
                    let [dx, dy] = self.offsets[world as usize];
                    let angle = (90.0 - heading.to_degrees()).rem_euclid(360.0);
                    orders.move_to(self.named(vehicle), x + dx, y + dy, angle, keep_route);
                }
            }
        }
        Ok(())
    }

    /// Returns the indices of the vehicles that SUMO knows after the commands.
    #[cfg(feature = "libsumo")]
    pub(super) fn expected(&self) -> impl Iterator<Item = usize> {
        self.next.iter().enumerate().filter(|(_, next)| **next).map(|(vehicle, _)| vehicle)
    }

    /// Returns the id of a vehicle type, given by its index.
    fn kind(&self, index: u32) -> Result<&str, Error> {
        let own = self.config.vehicle_types.iter().map(|kind| kind.id.as_str());
        let others =
            self.config.others.iter().flat_map(|others| others.types.iter().map(String::as_str));
        let all = || own.clone().chain(others.clone());
        let unknown = || {
            Error::invalid(format!("there is no vehicle type {index}: there are {}", all().count()))
        };
        all().nth(index as usize).ok_or_else(unknown)
    }

    fn named(&self, vehicle: usize) -> Vehicle<'_> {
        Vehicle { index: vehicle, name: &self.names[vehicle] }
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

    /// Returns SUMO's command line, without the program and the port.
    pub(super) fn arguments(&self) -> Result<Vec<OsString>, Error> {
        let config = &self.config;
        let milliseconds = config.step_length * 1000.0;
        // SUMO counts time in whole milliseconds.
        if !((1.0..=1e6).contains(&milliseconds)
            && (milliseconds - milliseconds.round()).abs() < 1e-6)
        {
            let length = config.step_length;
            return Err(Error::invalid(format!(
                "the step length must be a whole number of milliseconds of at least 1 ms, not {length} s"
            )));
        }
        // SUMO's seed is a non-negative 32 bit number.
        let seed = config.seed % (1 << 31);
        let mut text = String::new();
        let _ = write!(text, "--step-length {} --seed {seed}", config.step_length);
        let net = self.tiled.as_deref().map_or_else(|| config.net.clone(), path_of);
        let mut arguments: Vec<OsString> = vec!["--net-file".into(), net.into()];
        arguments.extend(text.split(' ').chain(ALWAYS).map(OsString::from));
        if let Some(file) = &self.definitions {
            arguments.extend(["--additional-files".into(), path_of(file).into()]);
        }
        if config.audit {
            arguments.push("--collision.check-junctions".into());
        }
        Ok(arguments)
    }
}

/// Writes the net with one copy for each world; returns the file and the offsets of the copies.
fn write_tiles(config: &SimulationConfig, text: &str) -> Result<(Arc<File>, Vec<[f64; 2]>), Error> {
    let tiled = tile(text, &config.net, config.worlds).map_err(Box::new)?;
    Ok((in_memory("tiles.net.xml", &tiled.text)?, tiled.offsets))
}

/// Returns a file in memory for SUMO to read, so that no folder needs to be writable.
fn in_memory(name: &str, text: &str) -> Result<Arc<File>, Error> {
    let io = |source| Error::Io { doing: "keep a file for SUMO in memory", source };
    let memory = memfd_create(name, MemfdFlags::CLOEXEC).map_err(|e| io(e.into()))?;
    let mut file = File::from(memory);
    file.write_all(text.as_bytes()).and_then(|()| file.rewind()).map_err(io)?;
    Ok(Arc::new(file))
}

/// Returns the path under which SUMO can open an unnamed file of this process.
fn path_of(file: &File) -> PathBuf {
    PathBuf::from(format!("/proc/{}/fd/{}", std::process::id(), file.as_raw_fd()))
}

fn finite(what: &str, value: f64) -> Result<(), Error> {
    if value.is_finite() {
        Ok(())
    } else {
        Err(Error::invalid(format!("{what} must be a number, not {value}")))
    }
}

/// SUMO options of every simulation.
const ALWAYS: [&str; 12] = [
    // A vehicle that cannot be inserted does not delay the others that depart on its edge.
    "--eager-insert",
    // `none` disables the reports of collisions. `warn` does not move or remove vehicles either.
    "--collision.action",
    "warn",
    // Only vehicles that overlap collide, not those with a gap below the minimum gap.
    "--collision.mingap-factor",
    "0",
    "--time-to-teleport",
    "-1",
    "--xml-validation",
    "never",
    "--no-warnings",
    "--no-step-log",
    "--duration-log.disable",
];
