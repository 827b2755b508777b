//! Reads the reply to a step into the snapshot.

use std::mem;

use crate::sumo::{
    Error, TrafficLightState,
    codec::Reader,
    constants::{self as c, Domain},
    domain::{
        simulation::{
            VAR_ARRIVED_PERSONS_IDS, VAR_ARRIVED_VEHICLES_IDS, VAR_COLLISIONS,
            VAR_PENDING_VEHICLES, VAR_TIME,
        },
        traffic_light::{TL_CURRENT_PHASE, TL_NEXT_SWITCH, TL_RED_YELLOW_GREEN_STATE},
        vehicle::{VAR_ANGLE, VAR_DISTANCE, VAR_LANE_ID, VAR_POSITION, VAR_SPEED, VAR_TIMELOSS},
    },
    fleet::Fleet,
    reply::{Report, Sink, read_collision_count, read_value},
};

const TIME: u8 = VAR_TIME.number();
const COLLISIONS: u8 = VAR_COLLISIONS.number();
const ARRIVED: u8 = VAR_ARRIVED_VEHICLES_IDS.number();
const ARRIVED_ON_FOOT: u8 = VAR_ARRIVED_PERSONS_IDS.number();
const PENDING: u8 = VAR_PENDING_VEHICLES.number();
const DISTANCE: u8 = VAR_DISTANCE.number();
const SPEED: u8 = VAR_SPEED.number();
const POSITION: u8 = VAR_POSITION.number();
const ANGLE: u8 = VAR_ANGLE.number();
const LANE: u8 = VAR_LANE_ID.number();
const TIME_LOSS: u8 = VAR_TIMELOSS.number();
const LIGHT_STATE: u8 = TL_RED_YELLOW_GREEN_STATE.number();
const LIGHT_PHASE: u8 = TL_CURRENT_PHASE.number();
const LIGHT_SWITCH: u8 = TL_NEXT_SWITCH.number();

/// A sink that reads the reply to a step into the snapshot. The order of a vehicle's variables in
/// its report does not matter.
pub(in crate::sumo) struct StepSink<'a> {
    fleet: &'a mut Fleet,
    /// Values read so far from the report of the current object.
    row: Row,
    /// Indices of the refused commands, with SUMO's reasons.
    pub(in crate::sumo) refused: Vec<(usize, String)>,
}

/// The variables of one vehicle or pedestrian.
#[derive(Debug, Default)]
struct Row {
    distance: Option<f64>,
    speed: Option<f64>,
    position: Option<[f64; 2]>,
    angle: Option<f64>,
    lane: Option<ReportedLane>,
    time_loss: Option<f64>,
    /// Whether SUMO reports that it does not know the object.
    gone: bool,
}

/// A reported lane as an index into the net's lanes, if the net has a lane of the reported id.
#[derive(Debug)]
struct ReportedLane(Option<u32>);

impl<'a> StepSink<'a> {
    pub(in crate::sumo) fn new(fleet: &'a mut Fleet) -> Self {
        Self { fleet, row: Row::default(), refused: Vec::new() }
    }
}

impl Sink for StepSink<'_> {
    fn refused(&mut self, index: usize, message: &str) {
        self.refused.push((index, message.to_owned()));
    }

    fn report(&mut self, report: Report<'_>, value: &mut Reader<'_>) -> Result<(), Error> {
        if !report.after_step || !report.known {
            self.row.gone |= !report.known;
            return read_value(report.response, report.variable, value).map(drop);
        }
        if report.response == Domain::TRAFFIC_LIGHT.subscribe + 0x10
            && let Some(light) = self.fleet.traffic_light(report.object)
        {
            return read_light(report.variable, value, light);
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
            PENDING if of_simulation => {
                value.kind(c::TYPE_STRINGLIST, "the vehicles that wait for room")?;
                for _ in 0..value.count(4, "the vehicles that wait for room")? {
                    self.fleet.pending(value.str()?);
                }
            }
            DISTANCE => self.row.distance = Some(finite(value)?),
            SPEED => self.row.speed = Some(finite(value)?),
            POSITION => self.row.position = Some(finite_point(value)?),
            ANGLE => self.row.angle = Some(finite(value)?),
            LANE => self.row.lane = Some(ReportedLane(self.fleet.lane(value.string()?))),
            TIME_LOSS => self.row.time_loss = Some(finite(value)?),
            _ => drop(read_value(report.response, report.variable, value)?),
        }
        Ok(())
    }

    fn object_ends(&mut self, report: Report<'_>, at: &Reader<'_>) -> Result<(), Error> {
        let row = mem::take(&mut self.row);
        if !report.after_step || report.around.is_none() || row.gone {
            return Ok(());
        }
        let (of_persons, of_vehicles) =
            (report.domain == Domain::PERSON.get, report.domain == Domain::VEHICLE.get);
        let vehicle = self.fleet.vehicle_named(report.object);
        let Some(vehicle) = vehicle.filter(|_| of_persons || of_vehicles) else { return Ok(()) };
        let lacks = |what| move || at.unexpected(what, format!("none for `{}`", report.object));
        let speed = row.speed.ok_or_else(lacks("the variable `speed`"))?;
        let position = || row.position.ok_or_else(lacks("the variable `position`"));
        let angle = || row.angle.ok_or_else(lacks("the variable `angle`"));
        if of_persons {
            self.fleet.pedestrian(vehicle, position()?, angle()?, speed);
        } else {
            let distance = row.distance.ok_or_else(lacks("the variable `distance`"))?;
            self.fleet.report(vehicle, distance, speed);
            if self.fleet.config().others.is_some() {
                let time_loss = row.time_loss.ok_or_else(lacks("the variable `time loss`"))?;
                let ReportedLane(lane) = row.lane.ok_or_else(lacks("the variable `lane`"))?;
                self.fleet.body(vehicle, position()?, angle()?, lane, time_loss);
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

/// Reads a variable of a traffic light.
fn read_light(
    variable: u8,
    value: &mut Reader<'_>,
    light: &mut TrafficLightState,
) -> Result<(), Error> {
    match variable {
        LIGHT_STATE => {
            light.state.clear();
            light.state.push_str(value.string()?);
        }
        LIGHT_PHASE => light.phase = value.integer()?,
        LIGHT_SWITCH => light.next_switch = finite(value)?,
        _ => drop(read_value(Domain::TRAFFIC_LIGHT.subscribe + 0x10, variable, value)?),
    }
    Ok(())
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

#[cfg(test)]
mod tests;
