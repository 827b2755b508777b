//! A [`Simulation`] in a separate SUMO process, over TraCI.
//!
//! One decision is one message: the commands, then the step. The reply holds the status of each
//! command and what the subscriptions report after the step. SUMO allows a vehicle to be added
//! under a name whose former vehicle is removed in the same message. SUMO moves a vehicle by its
//! new speed times the step length (SUMO's default method), so a commanded speed is a mean speed.

use std::{fmt::Write as _, time::Duration};

use super::{
    Batch, Client, Command, Error, Meter, Renewal, Simulation, SimulationConfig, Snapshot,
    client::Version,
    codec::Reader,
    constants::{self as c, Domain},
    domain::{
        person::{self, Walk},
        simulation::{VAR_ARRIVED_PERSONS_IDS, VAR_ARRIVED_VEHICLES_IDS, VAR_COLLISIONS, VAR_TIME},
        vehicle::{
            Addition, Placement, VAR_ANGLE, VAR_DISTANCE, VAR_POSITION, VAR_SPEED, VAR_TIMELOSS,
        },
    },
    fleet::{Fleet, Orders, TileRoute, Vehicle},
    process::{Options, Process},
    reply::{Report, Sink, read_collision_count, read_value},
};

/// Minimum time that SUMO has to load its net, even if its time for answers is shorter.
const LEAST_START: Duration = Duration::from_secs(10);

/// A simulation of one or more worlds in one SUMO process.
#[derive(Debug)]
pub struct TraciSimulation {
    fleet: Fleet,
    /// Declared before `process`, so that the connection is closed before SUMO is killed.
    client: Client,
    process: Process,
    version: Version,
    batch: Batch,
    texts: [String; 3],
    awaiting: bool,
    exchanges: u64,
}

impl TraciSimulation {
    /// Starts SUMO with the net and defines the vehicle types and routes.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a configuration that SUMO does not support; [`Error::Net`] for a net
    /// that cannot be tiled; [`Error::Refused`] for a vehicle type or route that SUMO refuses; the
    /// errors of [`Process::start`].
    pub fn start(config: SimulationConfig) -> Result<Self, Error> {
        let fleet = Fleet::new(config)?;
        let (process, client, version) = launch(&fleet)?;
        let mut simulation = TraciSimulation {
            fleet,
            client,
            process,
            version,
            batch: Batch::new(),
            texts: Default::default(),
            awaiting: false,
            exchanges: 0,
        };
        simulation.introduce()?;
        Ok(simulation)
    }

    /// Returns SUMO's version from the handshake.
    pub fn version(&self) -> &Version {
        &self.version
    }

    /// Returns SUMO's process identifier.
    pub fn pid(&self) -> u32 {
        self.process.pid()
    }

    /// Returns the result of the last step, also if [`Simulation::receive`] returned a refusal.
    pub fn snapshot(&self) -> &Snapshot {
        &self.fleet.snapshot
    }

    /// Makes SUMO load its net again.
    fn load(&mut self) -> Result<(), Error> {
        let arguments: Vec<String> =
            self.fleet.arguments()?.into_iter().map(|a| a.to_string_lossy().into_owned()).collect();
        self.client.load(&arguments)?;
        self.introduce()
    }

    /// Defines the vehicle types and routes and makes all subscriptions, in one message.
    fn introduce(&mut self) -> Result<(), Error> {
        let batch = &mut self.batch;
        batch.clear();
        for kind in &self.fleet.config().vehicle_types {
            batch.vehicle_type().copy("DEFAULT_VEHTYPE", &kind.id);
            let mut types = batch.vehicle_type();
            types.set_length(&kind.id, kind.length);
            types.set_width(&kind.id, kind.width);
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
        for route in self.fleet.routes.iter().filter(|route| !route.walked) {
            batch.route().add(&route.id, &route.edges);
        }
        let of_simulation = [
            VAR_TIME.id(),
            VAR_COLLISIONS.id(),
            VAR_ARRIVED_VEHICLES_IDS.id(),
            VAR_ARRIVED_PERSONS_IDS.id(),
        ];
        let walks = self.fleet.has_walks();
        batch.subscribe(Domain::SIMULATION, "", &of_simulation[..if walks { 4 } else { 3 }]);
        let all = [
            VAR_DISTANCE.id(),
            VAR_SPEED.id(),
            VAR_POSITION.id(),
            VAR_ANGLE.id(),
            VAR_TIMELOSS.id(),
        ];
        let of_vehicles = if self.fleet.config().others.is_some() { &all[..] } else { &all[..2] };
        // One subscription covers all vehicles of a world. SUMO takes longer to begin or end a
        // subscription the more there are, so that one subscription per vehicle would slow down
        // respawns.
        for junction in &self.fleet.junctions {
            batch.subscribe_context(
                Domain::JUNCTION,
                junction,
                Domain::VEHICLE,
                self.fleet.diagonal,
                of_vehicles,
            );
            if walks {
                let of_persons =
                    [person::VAR_POSITION.id(), person::VAR_ANGLE.id(), person::VAR_SPEED.id()];
                batch.subscribe_context(
                    Domain::JUNCTION,
                    junction,
                    Domain::PERSON,
                    self.fleet.diagonal,
                    &of_persons,
                );
            }
        }
        let outcomes = self.client.run(batch).map_err(|e| self.process.explain(e))?;
        outcomes.into_iter().try_for_each(|outcome| outcome.map(drop))
    }
}

/// Writes the commands of a step into its message.
struct Message<'a> {
    batch: &'a mut Batch,
    /// Position, speed and lane at departure as strings, which SUMO requires.
    texts: &'a mut [String; 3],
}

impl Orders for Message<'_> {
    fn add(
        &mut self,
        vehicle: Vehicle<'_>,
        route: &TileRoute,
        vehicle_type: &str,
        position: f64,
        speed: f64,
    ) {
        for (text, number) in self.texts.iter_mut().zip([position, speed, f64::from(route.lane)]) {
            text.clear();
            // Writing to a `String` cannot fail.
            let _ = write!(text, "{number}");
        }
        let [depart_pos, depart_speed, depart_lane] = &*self.texts;
        let addition = Addition {
            vehicle_type,
            depart_lane,
            depart_pos,
            depart_speed,
            ..Addition::on_route(&route.id)
        };
        self.batch.vehicle().add(vehicle.name, &addition);
    }

    fn depart(
        &mut self,
        vehicle: Vehicle<'_>,
        route: &TileRoute,
        vehicle_type: &str,
        start: [&str; 3],
    ) {
        let [depart_lane, depart_pos, depart_speed] = start;
        let addition = Addition {
            vehicle_type,
            depart_lane,
            depart_pos,
            depart_speed,
            ..Addition::on_route(&route.id)
        };
        self.batch.vehicle().add(vehicle.name, &addition);
    }

    fn remove(&mut self, vehicle: Vehicle<'_>) {
        self.batch.vehicle().remove(vehicle.name, c::REMOVE_VAPORIZED);
    }

    fn walk(
        &mut self,
        person: Vehicle<'_>,
        route: &TileRoute,
        person_type: &str,
        [pos, arrival_pos]: [f64; 2],
    ) {
        let first = route.edges.first().map_or("", String::as_str);
        self.batch.person().add(person.name, person_type, first, c::DEPART_NOW, pos);
        self.batch.person().append_walking_stage(person.name, &route.edges, &Walk::to(arrival_pos));
    }

    fn remove_person(&mut self, person: Vehicle<'_>) {
        self.batch.person().remove(person.name, c::REMOVE_VAPORIZED);
    }

    fn set_walking_speed(&mut self, person: Vehicle<'_>, speed: f64) {
        self.batch.person().set_speed(person.name, speed);
    }

    fn set_speed(&mut self, vehicle: Vehicle<'_>, speed: f64) {
        self.batch.vehicle().set_speed(vehicle.name, speed);
    }

    fn set_speed_mode(&mut self, vehicle: Vehicle<'_>, mode: i32) {
        self.batch.vehicle().set_speed_mode(vehicle.name, mode);
    }

    fn set_lane_change_mode(&mut self, vehicle: Vehicle<'_>, mode: i32) {
        self.batch.vehicle().set_lane_change_mode(vehicle.name, mode);
    }

    fn move_to(&mut self, vehicle: Vehicle<'_>, x: f64, y: f64, angle: f64, keep_route: u8) {
        let placement = Placement { angle, keep_route, ..Placement::default() };
        self.batch.vehicle().move_to_xy(vehicle.name, [x, y], &placement);
    }
}

impl Simulation for TraciSimulation {
    fn worlds(&self) -> u32 {
        self.fleet.config().worlds
    }

    fn slots(&self) -> u32 {
        self.fleet.config().slots
    }

    fn send(&mut self, commands: &[Command]) -> Result<(), Error> {
        if self.awaiting {
            return Err(Error::invalid("the answer to the last send has not been received"));
        }
        self.batch.clear();
        let mut message = Message { batch: &mut self.batch, texts: &mut self.texts };
        self.fleet.order(commands, &mut message)?;
        self.client.send(&mut self.batch, Some(0.0)).map_err(|e| self.process.explain(e))?;
        self.awaiting = true;
        self.exchanges += 1;
        Ok(())
    }

    fn receive(&mut self) -> Result<&Snapshot, Error> {
        if !std::mem::take(&mut self.awaiting) {
            return Err(Error::invalid("nothing was sent that could be answered"));
        }
        self.fleet.begin_step();
        let mut sink = StepSink::new(&mut self.fleet);
        let received = self.client.receive(&self.batch, &mut sink);
        let refused = sink.refused;
        received.map_err(|e| self.process.explain(e))?;
        self.client.set_time(self.fleet.snapshot.time);
        let mut first = None;
        for (index, message) in refused {
            let error = self.batch.refusal(index, &message);
            if let Error::Refused { call, id, .. } = &error
                && ["vehicle.add", "person.add"].contains(&call.as_str())
            {
                self.fleet.gone(id);
            }
            first.get_or_insert(error);
        }
        first.map_or(Ok(&self.fleet.snapshot), Err)
    }

    fn renew(&mut self) -> Result<Renewal, Error> {
        // The reply that is still awaited would be taken for the reply to the load command.
        let awaited = std::mem::take(&mut self.awaiting);
        self.fleet.empty();
        if !awaited && self.load().is_ok() {
            return Ok(Renewal::Loaded);
        }
        let (process, client, version) = launch(&self.fleet)?;
        self.client = client;
        self.process = process;
        self.version = version;
        self.introduce()?;
        Ok(Renewal::Restarted)
    }

    fn reseed(&mut self, seed: u64) {
        self.fleet.reseed(seed);
    }

    fn meter(&self) -> Meter {
        let (sent, received) = self.client.bytes();
        Meter { exchanges: self.exchanges, sent, received, pid: Some(self.process.pid()) }
    }
}

const TIME: u8 = VAR_TIME.number();
const COLLISIONS: u8 = VAR_COLLISIONS.number();
const ARRIVED: u8 = VAR_ARRIVED_VEHICLES_IDS.number();
const ARRIVED_ON_FOOT: u8 = VAR_ARRIVED_PERSONS_IDS.number();
const DISTANCE: u8 = VAR_DISTANCE.number();
const SPEED: u8 = VAR_SPEED.number();
const POSITION: u8 = VAR_POSITION.number();
const ANGLE: u8 = VAR_ANGLE.number();
const TIME_LOSS: u8 = VAR_TIMELOSS.number();

/// A sink that reads the reply to a step into the snapshot.
pub(super) struct StepSink<'a> {
    pub(super) fleet: &'a mut Fleet,
    /// Values read so far of the vehicle or pedestrian whose report is being read.
    pub(super) distance: Option<f64>,
    pub(super) speed: Option<f64>,
    pub(super) position: Option<[f64; 2]>,
    pub(super) angle: Option<f64>,
    /// Indices of the refused commands, with SUMO's reasons.
    pub(super) refused: Vec<(usize, String)>,
}

impl<'a> StepSink<'a> {
    pub(super) fn new(fleet: &'a mut Fleet) -> Self {
        Self {
            fleet,
            distance: None,
            speed: None,
            position: None,
            angle: None,
            refused: Vec::new(),
        }
    }
}

impl Sink for StepSink<'_> {
    fn refused(&mut self, index: usize, message: &str) {
        self.refused.push((index, message.to_owned()));
    }

    fn report(&mut self, report: Report<'_>, value: &mut Reader<'_>) -> Result<(), Error> {
        if !report.after_step || !report.known {
            return read_value(report.response, report.variable, value).map(drop);
        }
        let of_simulation = report.response == Domain::SIMULATION.subscribe + 0x10;
        match report.variable {
            TIME if of_simulation => self.fleet.snapshot.time = finite(value)?,
            COLLISIONS if of_simulation => read_collisions(value, self.fleet)?,
            ARRIVED | ARRIVED_ON_FOOT if of_simulation => {
                value.kind(c::TYPE_STRINGLIST, "the vehicles and persons that arrived")?;
                for _ in 0..value.count(4, "the vehicles and persons that arrived")? {
                    self.fleet.gone(value.str()?);
                }
            }
            DISTANCE => self.distance = Some(finite(value)?),
            SPEED => self.speed = Some(finite(value)?),
            POSITION => self.position = Some(finite_point(value)?),
            ANGLE => self.angle = Some(finite(value)?),
            // With background traffic, the time loss is the last variable in a vehicle's report.
            TIME_LOSS => {
                let loss = finite(value)?;
                if let (Some(position), Some(angle)) = (self.position.take(), self.angle.take())
                    && let Some(vehicle) = self.fleet.vehicle_named(report.object)
                {
                    self.fleet.body(vehicle, position, angle, loss);
                }
            }
            _ => drop(read_value(report.response, report.variable, value)?),
        }
        // The speed is the last variable in a pedestrian's report, which has no distance.
        if let (None, Some(position), Some(angle), Some(speed)) =
            (self.distance, self.position, self.angle, self.speed)
        {
            (self.position, self.angle, self.speed) = (None, None, None);
            if let Some(person) = self.fleet.vehicle_named(report.object) {
                self.fleet.pedestrian(person, position, angle, speed);
            }
        }
        if let (Some(distance), Some(speed)) = (self.distance, self.speed) {
            (self.distance, self.speed) = (None, None);
            if let Some(vehicle) = self.fleet.vehicle_named(report.object) {
                self.fleet.report(vehicle, distance, speed);
            }
        }
        Ok(())
    }
}

/// Reads a double and checks that it is finite, because the environments calculate with it.
fn finite(value: &mut Reader<'_>) -> Result<f64, Error> {
    let number = value.double()?;
    if number.is_finite() {
        Ok(number)
    } else {
        Err(value.unexpected("a finite number", number.to_string()))
    }
}

/// Reads a position and checks that its coordinates are finite.
fn finite_point(value: &mut Reader<'_>) -> Result<[f64; 2], Error> {
    let point = value.position_2d()?;
    let all = point.iter().all(|x| x.is_finite());
    if all { Ok(point) } else { Err(value.unexpected("finite coordinates", format!("{point:?}"))) }
}

/// Reads the collisions between vehicles of the fleet.
fn read_collisions(value: &mut Reader<'_>, fleet: &mut Fleet) -> Result<(), Error> {
    let count = read_collision_count(value)?;
    for _ in 0..count {
        fleet.collision(value.string()?, value.string()?);
        // Types, speeds, kind of collision, lane, position.
        value.string()?;
        value.string()?;
        value.double()?;
        value.double()?;
        value.string()?;
        value.string()?;
        value.double()?;
    }
    Ok(())
}

fn launch(fleet: &Fleet) -> Result<(Process, Client, Version), Error> {
    Process::start(&Options {
        arguments: fleet.arguments()?,
        // Loading takes longer than a step.
        connect_timeout: fleet.config().timeout.max(LEAST_START),
        reply_timeout: fleet.config().timeout,
        ..Options::default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sumo::{Collision, codec::Writer};

    fn config(step_length: f64) -> SimulationConfig {
        SimulationConfig {
            net: "sumo_nets/intersection/arm30.net.xml".into(),
            step_length,
            seed: u64::MAX,
            worlds: 1,
            slots: 2,
            vehicle_types: Vec::new(),
            routes: Vec::new(),
            timeout: std::time::Duration::from_secs(60),
            audit: true,
            others: None,
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
        let mut fleet = Fleet::new(config(0.1)).unwrap();
        read_collisions(&mut Reader::new(&w.bytes()[4..], 4), &mut fleet).unwrap();
        assert_eq!(fleet.snapshot.collisions, [Collision { world: 0, collider: 1, victim: 0 }]);
        let mut w = Writer::default();
        w.compound(1).integer(i32::MAX);
        assert!(read_collisions(&mut Reader::new(&w.bytes()[4..], 4), &mut fleet).is_err());
    }

    #[test]
    fn step_lengths_that_sumo_cannot_have_are_refused() {
        for bad in [0.0, -0.1, 0.0005, 0.10005, f64::NAN, f64::INFINITY] {
            let arguments = Fleet::new(config(bad)).unwrap().arguments();
            assert!(matches!(arguments, Err(Error::Invalid { .. })), "{bad}");
        }
        let words = Fleet::new(config(0.1)).unwrap().arguments().unwrap();
        assert_eq!(words[2..6], ["--step-length", "0.1", "--seed", "2147483647"]);
    }
}
