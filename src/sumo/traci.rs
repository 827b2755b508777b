//! A [`Simulation`] in a SUMO process of its own, spoken to over TraCI.
//!
//! One decision is one message: the setters, then the step; the reply holds the status of each setter
//! and what the subscriptions report after the step. Vehicle `s` of world `w` is called `w<w>s<s>`;
//! SUMO lets a name be used again in the very message that removes its former bearer. SUMO moves a
//! vehicle by its new speed times the step (its default method), so a commanded speed is a mean speed.

use std::{ffi::OsString, fmt::Write as _};

use super::{
    Batch, Client, Collision, Command, Departure, Error, Simulation, SimulationConfig, Snapshot, VehicleState,
    client::Version,
    codec::Reader,
    constants::{self as c, Domain},
    process::{Options, Process},
    reply::{Report, Sink, read_collision_count, read_value},
};

/// What is reported of each vehicle after each step.
const VEHICLE_VARIABLES: [u8; 3] = [c::VAR_POSITION, c::VAR_ANGLE, c::VAR_SPEED];

/// One world in one SUMO process.
#[derive(Debug)]
pub struct TraciSimulation {
    config: SimulationConfig,
    /// Goes before the process: an open connection is closed before its peer is killed.
    client: Client,
    process: Process,
    version: Version,
    batch: Batch,
    names: Vec<String>,
    /// `[slots]`: whether SUMO knows a vehicle of that name, on the road or waiting to be put there.
    known: Vec<bool>,
    /// `known` as it will be after the batch under way.
    next: Vec<bool>,
    snapshot: Snapshot,
    awaiting: bool,
}

impl TraciSimulation {
    /// Starts SUMO with the net, and makes the vehicle types and routes known to it.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a configuration that SUMO cannot have; [`Error::Refused`] for a type or
    /// route that SUMO refuses; what [`Process::start`] returns.
    pub fn start(config: SimulationConfig) -> Result<Self, Error> {
        let (process, client, version) = launch(&config)?;
        let slots = config.slots as usize;
        let mut simulation = TraciSimulation {
            client,
            process,
            version,
            batch: Batch::new(),
            names: (0..slots).map(|slot| format!("w0s{slot}")).collect(),
            known: vec![false; slots],
            next: vec![false; slots],
            snapshot: Snapshot { vehicles: vec![None; slots], ..Snapshot::default() },
            awaiting: false,
            config,
        };
        simulation.introduce()?;
        Ok(simulation)
    }

    /// What SUMO said in the handshake.
    pub fn version(&self) -> &Version {
        &self.version
    }

    /// Process identifier of SUMO.
    pub fn pid(&self) -> u32 {
        self.process.pid()
    }

    /// What the last step left, also when [`Simulation::receive`] returned a refusal.
    pub fn snapshot(&self) -> &Snapshot {
        &self.snapshot
    }

    /// Vehicle types, routes and the subscription of the simulation, in one message.
    fn introduce(&mut self) -> Result<(), Error> {
        let batch = &mut self.batch;
        batch.clear();
        for kind in &self.config.vehicle_types {
            batch.vehicle_type_copy("DEFAULT_VEHTYPE", &kind.id);
            for (variable, value) in [
                (c::VAR_LENGTH, kind.length),
                (c::VAR_WIDTH, kind.width),
                (c::VAR_MINGAP, kind.min_gap),
                (c::VAR_MAXSPEED, kind.max_speed),
                (c::VAR_ACCEL, kind.accel),
                // Before the comfortable one, which may not exceed it.
                (c::VAR_EMERGENCY_DECEL, kind.emergency_decel),
                (c::VAR_DECEL, kind.decel),
                (c::VAR_TAU, kind.tau),
                (c::VAR_IMPERFECTION, 0.0),
                (c::VAR_SPEED_FACTOR, 1.0),
                (c::VAR_SPEED_DEVIATION, 0.0),
            ] {
                batch.vehicle_type_set(&kind.id, variable, value);
            }
        }
        for route in &self.config.routes {
            batch.route_add(&route.id, &route.edges);
        }
        batch.subscribe(Domain::SIMULATION, "", &[c::VAR_TIME, c::VAR_COLLISIONS]);
        let outcomes = self.client.run(batch).map_err(|e| self.process.explain(e))?;
        outcomes.into_iter().try_for_each(|outcome| outcome.map(drop))
    }

    /// Puts the commands into the batch; `self.next` becomes what SUMO will know.
    fn encode(&mut self, commands: &[Command]) -> Result<(), Error> {
        let Self { batch, names, next, config, .. } = self;
        batch.clear();
        next.copy_from_slice(&self.known);
        let place = |world: u32, slot: u32| {
            if world == 0 && slot < config.slots {
                return Ok(slot as usize);
            }
            Err(Error::invalid(format!("there is no slot {slot} in world {world}: world 0 has {}", config.slots)))
        };
        for command in commands {
            match *command {
                Command::Add { world, slot, route, vehicle_type, depart_pos, depart_speed } => {
                    let slot = place(world, slot)?;
                    if next[slot] {
                        return Err(Error::invalid(format!("slot {slot} holds a vehicle; remove it first")));
                    }
                    finite("a departure position", depart_pos)?;
                    finite("a departure speed", depart_speed)?;
                    let route = config.routes.get(route as usize).ok_or_else(|| {
                        Error::invalid(format!("there is no route {route}: there are {}", config.routes.len()))
                    })?;
                    let kind = config.vehicle_types.get(vehicle_type as usize).ok_or_else(|| {
                        let known = config.vehicle_types.len();
                        Error::invalid(format!("there is no vehicle type {vehicle_type}: there are {known}"))
                    })?;
                    let (route, vehicle_type) = (route.id.as_str(), kind.id.as_str());
                    let departure = Departure { route, vehicle_type, position: depart_pos, speed: depart_speed };
                    batch.vehicle_add(&names[slot], departure);
                    batch.subscribe(Domain::VEHICLE, &names[slot], &VEHICLE_VARIABLES);
                    next[slot] = true;
                }
                Command::Remove { world, slot } => {
                    let slot = place(world, slot)?;
                    if std::mem::take(&mut next[slot]) {
                        // Ended first, because SUMO complains of a subscription whose vehicle is gone.
                        batch.subscribe(Domain::VEHICLE, &names[slot], &[]);
                        batch.vehicle_remove(&names[slot]);
                    }
                }
                Command::SetSpeed { world, slot, speed } => {
                    finite("a speed", speed)?;
                    batch.vehicle_set_speed(&names[place(world, slot)?], speed);
                }
                Command::SpeedMode { world, slot, mode } => {
                    batch.vehicle_set_speed_mode(&names[place(world, slot)?], mode);
                }
            }
        }
        Ok(())
    }
}

impl Simulation for TraciSimulation {
    fn worlds(&self) -> u32 {
        1
    }

    fn slots(&self) -> u32 {
        self.config.slots
    }

    fn send(&mut self, commands: &[Command]) -> Result<(), Error> {
        if self.awaiting {
            return Err(Error::invalid("the answer to the last send has not been received"));
        }
        self.encode(commands)?;
        self.client.send(&mut self.batch, Some(0.0)).map_err(|e| self.process.explain(e))?;
        self.awaiting = true;
        Ok(())
    }

    fn receive(&mut self) -> Result<&Snapshot, Error> {
        if !std::mem::take(&mut self.awaiting) {
            return Err(Error::invalid("nothing was sent that could be answered"));
        }
        self.snapshot.vehicles.fill(None);
        self.snapshot.collisions.clear();
        self.known.fill(false);
        let mut sink = StepSink { snapshot: &mut self.snapshot, known: &mut self.known, slot: 0, refused: None };
        let received = self.client.receive(&self.batch, &mut sink);
        let refused = sink.refused;
        received.map_err(|e| self.process.explain(e))?;
        self.client.set_time(self.snapshot.time);
        match refused {
            Some((index, message)) => Err(self.batch.refusal(index, &message)),
            None => Ok(&self.snapshot),
        }
    }

    fn restart(&mut self) -> Result<(), Error> {
        let (process, client, version) = launch(&self.config)?;
        self.client = client;
        self.process = process;
        self.version = version;
        self.known.fill(false);
        self.snapshot.time = 0.0;
        self.snapshot.vehicles.fill(None);
        self.snapshot.collisions.clear();
        self.awaiting = false;
        self.introduce()
    }
}

/// Reads what one step leaves into the snapshot.
pub(super) struct StepSink<'a> {
    pub(super) snapshot: &'a mut Snapshot,
    pub(super) known: &'a mut [bool],
    /// Slot of the vehicle that the report of the moment is about.
    pub(super) slot: usize,
    /// The first command that was refused, and why.
    pub(super) refused: Option<(usize, String)>,
}

impl Sink for StepSink<'_> {
    fn refused(&mut self, index: usize, message: &str) {
        if self.refused.is_none() {
            self.refused = Some((index, message.to_owned()));
        }
    }

    fn report(&mut self, report: Report<'_>, value: &mut Reader<'_>) -> Result<(), Error> {
        if !report.after_step || !report.known {
            return read_value(report.response, report.variable, value).map(drop);
        }
        if report.response == Domain::SIMULATION.subscribe + 0x10 {
            return match report.variable {
                c::VAR_TIME => {
                    self.snapshot.time = value.double()?;
                    Ok(())
                }
                c::VAR_COLLISIONS => read_collisions(value, self.known.len(), &mut self.snapshot.collisions),
                _ => read_value(report.response, report.variable, value).map(drop),
            };
        }
        if report.variable == c::VAR_POSITION {
            // The first variable of each vehicle.
            self.slot = slot_of(report.object).unwrap_or(usize::MAX);
        }
        let Some(known) = self.known.get_mut(self.slot) else {
            return read_value(report.response, report.variable, value).map(drop);
        };
        *known = true;
        let vehicle = &mut self.snapshot.vehicles[self.slot];
        match report.variable {
            c::VAR_POSITION => {
                let [x, y] = value.position_2d()?;
                // A vehicle that waits to be put on the road has no position.
                let on_road = x != c::INVALID_DOUBLE_VALUE;
                *vehicle = on_road.then_some(VehicleState { x, y, heading: 0.0, speed: 0.0 });
                Ok(())
            }
            c::VAR_ANGLE => {
                let angle = value.double()?;
                if let Some(vehicle) = vehicle {
                    vehicle.heading = heading(angle);
                }
                Ok(())
            }
            c::VAR_SPEED => {
                let speed = value.double()?;
                if let Some(vehicle) = vehicle {
                    vehicle.speed = speed;
                }
                Ok(())
            }
            _ => read_value(report.response, report.variable, value).map(drop),
        }
    }
}

/// Reads the collisions between vehicles of ours.
fn read_collisions(value: &mut Reader<'_>, slots: usize, collisions: &mut Vec<Collision>) -> Result<(), Error> {
    let count = read_collision_count(value)?;
    for _ in 0..count {
        let collider = slot_of(value.string()?).filter(|s| *s < slots);
        let victim = slot_of(value.string()?).filter(|s| *s < slots);
        // Types, speeds, kind of collision, lane, position.
        value.string()?;
        value.string()?;
        value.double()?;
        value.double()?;
        value.string()?;
        value.string()?;
        value.double()?;
        if let (Some(collider), Some(victim)) = (collider, victim) {
            collisions.push(Collision { world: 0, collider: collider as u32, victim: victim as u32 });
        }
    }
    Ok(())
}

fn slot_of(name: &str) -> Option<usize> {
    name.strip_prefix("w0s")?.parse().ok()
}

/// Navigational angle (degrees, clockwise from north) to heading (radians in (-π, π], counter-clockwise from +x).
fn heading(navigational: f64) -> f64 {
    let degrees = 90.0 - navigational;
    (if degrees <= -180.0 { degrees + 360.0 } else { degrees }).to_radians()
}

fn finite(what: &str, value: f64) -> Result<(), Error> {
    if value.is_finite() { Ok(()) } else { Err(Error::invalid(format!("{what} must be a number, not {value}"))) }
}

fn launch(config: &SimulationConfig) -> Result<(Process, Client, Version), Error> {
    Process::start(&Options { arguments: arguments(config)?, ..Options::default() })
}

/// SUMO's command line.
fn arguments(config: &SimulationConfig) -> Result<Vec<OsString>, Error> {
    let milliseconds = config.step_length * 1000.0;
    // SUMO counts time in milliseconds.
    if !((1.0..=1e6).contains(&milliseconds) && (milliseconds - milliseconds.round()).abs() < 1e-6) {
        let length = config.step_length;
        return Err(Error::invalid(format!(
            "the step length must be a whole number of milliseconds of at least 1 ms, not {length} s"
        )));
    }
    // SUMO's seed is a non-negative 32 bit number.
    let seed = config.seed % (1 << 31);
    let mut text = String::new();
    let _ = write!(text, "--step-length {} --seed {seed}", config.step_length);
    let mut arguments: Vec<OsString> = vec!["--net-file".into(), config.net.clone().into()];
    arguments.extend(text.split(' ').chain(ALWAYS).map(OsString::from));
    Ok(arguments)
}

/// Options that hold for every simulation.
const ALWAYS: [&str; 13] = [
    // A vehicle that finds no room to depart does not hold up the others of its edge.
    "--eager-insert",
    // "none" would not report collisions; "warn" leaves the vehicles where they are just the same.
    "--collision.action",
    "warn",
    "--collision.check-junctions",
    // Only overlap counts, not a gap below the minimum.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sumo::codec::Writer;
    use std::f64::consts::{FRAC_PI_2, PI};

    #[test]
    fn navigational_angles_become_headings() {
        for (angle, expected) in
            [(90.0, 0.0), (0.0, FRAC_PI_2), (180.0, -FRAC_PI_2), (270.0, PI), (360.0, -3.0 * FRAC_PI_2)]
        {
            let difference = heading(angle) - expected;
            assert!((difference / (2.0 * PI)).fract().abs() < 1e-12, "{angle}");
            assert!(heading(angle) > -PI && heading(angle) <= PI, "{angle}");
        }
    }

    #[test]
    fn collisions_of_strangers_and_hostile_counts_are_no_collisions() {
        let mut w = Writer::default();
        w.compound(19).integer(2);
        for pair in [["w0s1", "w0s0"], ["w0s1", "w0s2"]] {
            w.string(pair[0]).string(pair[1]).string("car").string("car").double(1.0).double(2.0);
            w.string("junction").string(":c_0_0").double(3.0);
        }
        let mut found = Vec::new();
        read_collisions(&mut Reader::new(&w.bytes()[4..], 4), 2, &mut found).unwrap();
        assert_eq!(found, [Collision { world: 0, collider: 1, victim: 0 }]);
        let mut w = Writer::default();
        w.compound(1).integer(i32::MAX);
        assert!(read_collisions(&mut Reader::new(&w.bytes()[4..], 4), 2, &mut found).is_err());
    }

    #[test]
    fn step_lengths_that_sumo_cannot_have_are_refused() {
        let config = |step_length| SimulationConfig {
            net: "n.net.xml".into(),
            step_length,
            seed: u64::MAX,
            slots: 1,
            vehicle_types: Vec::new(),
            routes: Vec::new(),
        };
        for bad in [0.0, -0.1, 0.0005, 0.10005, f64::NAN, f64::INFINITY] {
            assert!(matches!(arguments(&config(bad)), Err(Error::Invalid { .. })), "{bad}");
        }
        let words = arguments(&config(0.1)).unwrap();
        assert_eq!(words[2..6], ["--step-length", "0.1", "--seed", "2147483647"]);
    }
}
