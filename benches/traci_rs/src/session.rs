//! A SUMO process and its TraCI client.

use std::{
    hint::black_box,
    net::TcpListener,
    process::{Child, Stdio},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, bail};
use traci_rs::{
    RouteScope, SimulationScope, TraciClient, TraciError, TraciValue, VehicleScope, VehicleTypeScope,
    constants::{
        CMD_SUBSCRIBE_SIM_VARIABLE, CMD_SUBSCRIBE_VEHICLE_VARIABLE, INVALID_DOUBLE_VALUE, REMOVE_VAPORIZED, VAR_ANGLE,
        VAR_POSITION, VAR_SPEED, VAR_TIME,
    },
};

use crate::workload::{Command, VehicleType, Workload};

/// The variable of the number of colliding vehicles; traci-rs has neither a constant nor a getter
/// for it.
const VAR_COLLIDING_VEHICLES_NUMBER: u8 = 0x80;
const CONNECT_WITHIN: Duration = Duration::from_secs(10);
/// End of a subscription \[s\], later than the end of any workload.
const FOREVER: f64 = 1e9;

/// How the state of the vehicles is read.
#[derive(Clone, Copy, PartialEq)]
pub(crate) enum Reading {
    /// One call per value.
    Getters,
    /// Variable subscriptions, whose results arrive with the step.
    Subscriptions,
}

/// A SUMO process with the vehicle types and routes of the workload.
pub(crate) struct Session<'a> {
    workload: &'a Workload,
    reading: Reading,
    client: TraciClient,
    // The session has its own scopes, because those of the client cannot be called while a call
    // borrows the client.
    vehicle: VehicleScope,
    simulation: SimulationScope,
    sumo: Sumo,
}

/// The SUMO process; it is killed on drop.
struct Sumo(Child);

impl Drop for Sumo {
    fn drop(&mut self) {
        // This fails if the process has ended already; then nothing is left to do.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl<'a> Session<'a> {
    /// Starts `sumo` from PATH and adds the vehicle types and routes.
    pub(crate) fn start(workload: &'a Workload, reading: Reading) -> Result<Self> {
        let (sumo, mut client) = launch(&workload.arguments)?;
        for kind in &workload.vehicle_types {
            make(&mut client, kind).with_context(|| format!("vehicle type {}", kind.id))?;
        }
        let routes = RouteScope::default();
        for route in &workload.routes {
            routes.add(&mut client, &route.id, &route.edges).with_context(|| format!("route {}", route.id))?;
        }
        let variables: &[u8] = match reading {
            Reading::Getters => &[VAR_COLLIDING_VEHICLES_NUMBER],
            Reading::Subscriptions => &[VAR_TIME, VAR_COLLIDING_VEHICLES_NUMBER],
        };
        client.subscribe_object_variable(CMD_SUBSCRIBE_SIM_VARIABLE, "", 0.0, FOREVER, variables)?;
        let (vehicle, simulation) = (VehicleScope::default(), SimulationScope::default());
        Ok(Session { workload, reading, client, vehicle, simulation, sumo })
    }

    /// Sends a command and waits for SUMO's answer.
    pub(crate) fn command(&mut self, command: &Command) -> Result<()> {
        let Self { workload, client, vehicle: scope, .. } = self;
        let name = |vehicle: usize| {
            workload.vehicles.get(vehicle).map(String::as_str).with_context(|| format!("there is no vehicle {vehicle}"))
        };
        let subscribed = self.reading == Reading::Subscriptions;
        match *command {
            Command::Speed { vehicle, speed } => scope.set_speed(client, name(vehicle)?, speed),
            Command::Move { vehicle, x, y, angle, keep_route } => {
                scope.move_to_xy(client, name(vehicle)?, "", -1, x, y, angle, keep_route)
            }
            Command::SpeedMode { vehicle, mode } => scope.set_speed_mode(client, name(vehicle)?, mode),
            Command::Add { vehicle, route, kind, position, speed } => {
                let route = workload.routes.get(route).with_context(|| format!("there is no route {route}"))?;
                let kind = workload.vehicle_types.get(kind).with_context(|| format!("there is no type {kind}"))?;
                let (id, position, speed) = (name(vehicle)?, format!("{position:?}"), format!("{speed:?}"));
                scope
                    .add(
                        client,
                        id,
                        &route.id,
                        &kind.id,
                        "now".to_owned(),
                        "first",
                        &position,
                        &speed,
                        "current",
                        "max",
                        "current",
                        "",
                        "",
                        "",
                        0,
                        0,
                    )
                    .and_then(|()| if subscribed { subscribe(client, id) } else { Ok(()) })
            }
            Command::Remove { vehicle } => {
                let id = name(vehicle)?;
                // The subscription ends first, because SUMO reports an error for a subscription
                // whose vehicle is gone.
                if subscribed { unsubscribe(client, id) } else { Ok(()) }
                    .and_then(|()| scope.remove(client, id, REMOVE_VAPORIZED))
            }
        }
        .with_context(|| format!("{command:?}"))
    }

    /// Runs one simulation step and reads its results; returns the sum of the values that were read
    /// of the vehicles.
    pub(crate) fn step(&mut self) -> Result<f64> {
        if !self.client.simulation_step(0.0)? {
            bail!("SUMO ended the simulation");
        }
        let simulation = self.client.simulation.subscription_results.get("").context("no news of the simulation")?;
        black_box(simulation.get(&VAR_COLLIDING_VEHICLES_NUMBER).context("no number of colliding vehicles")?);
        match self.reading {
            Reading::Getters => self.get(),
            Reading::Subscriptions => {
                black_box(simulation.get(&VAR_TIME).context("no time")?);
                self.collect()
            }
        }
    }

    fn get(&mut self) -> Result<f64> {
        let Self { client, vehicle, simulation, .. } = self;
        black_box(simulation.get_time(client)?);
        let mut total = 0.0;
        for id in vehicle.get_id_list(client)? {
            let position = vehicle.get_position(client, &id)?;
            total += position.x + position.y + vehicle.get_angle(client, &id)? + vehicle.get_speed(client, &id)?;
        }
        Ok(total)
    }

    fn collect(&self) -> Result<f64> {
        let mut total = 0.0;
        for (id, values) in &self.client.vehicle.subscription_results {
            let values = (values.get(&VAR_POSITION), values.get(&VAR_ANGLE), values.get(&VAR_SPEED));
            let (Some(&TraciValue::Pos2D { x, y }), Some(&TraciValue::Double(angle)), Some(&TraciValue::Double(speed))) =
                values
            else {
                bail!("of vehicle {id} SUMO reported {values:?}");
            };
            // SUMO reports this value for a vehicle that waits to be inserted.
            #[allow(clippy::float_cmp)]
            if x != INVALID_DOUBLE_VALUE {
                total += x + y + angle + speed;
            }
        }
        Ok(total)
    }

    /// Ends SUMO.
    pub(crate) fn close(mut self) -> Result<()> {
        self.client.close()?;
        self.sumo.0.wait()?;
        Ok(())
    }
}

fn launch(arguments: &[String]) -> Result<(Sumo, TraciClient)> {
    // The port is free now; if another process takes it before SUMO does, SUMO ends with an error.
    let port = TcpListener::bind(("127.0.0.1", 0))?.local_addr()?.port();
    let mut command = std::process::Command::new("sumo");
    command.args(arguments).arg("--remote-port").arg(port.to_string()).stdin(Stdio::null()).stdout(Stdio::null());
    let mut sumo = Sumo(command.spawn().context("starting 'sumo'")?);
    let deadline = Instant::now() + CONNECT_WITHIN;
    loop {
        match TraciClient::connect("127.0.0.1", port) {
            Ok(client) => return Ok((sumo, client)),
            Err(error) if Instant::now() > deadline => return Err(error).context("connecting to SUMO"),
            Err(_) => thread::sleep(Duration::from_millis(5)),
        }
        if let Some(status) = sumo.0.try_wait()? {
            bail!("SUMO ended with {status}");
        }
    }
}

fn make(client: &mut TraciClient, kind: &VehicleType) -> Result<(), TraciError> {
    let (scope, id) = (VehicleTypeScope::default(), kind.id.as_str());
    scope.copy(client, "DEFAULT_VEHTYPE", id)?;
    scope.set_length(client, id, kind.length)?;
    scope.set_width(client, id, kind.width)?;
    scope.set_min_gap(client, id, kind.min_gap)?;
    scope.set_max_speed(client, id, kind.max_speed)?;
    scope.set_accel(client, id, kind.accel)?;
    scope.set_emergency_decel(client, id, kind.emergency_decel)?;
    scope.set_decel(client, id, kind.decel)?;
    scope.set_tau(client, id, kind.tau)?;
    scope.set_imperfection(client, id, 0.0)?;
    scope.set_speed_factor(client, id, 1.0)?;
    scope.set_speed_deviation(client, id, 0.0)
}

fn subscribe(client: &mut TraciClient, id: &str) -> Result<(), TraciError> {
    let variables = [VAR_POSITION, VAR_ANGLE, VAR_SPEED];
    client.subscribe_object_variable(CMD_SUBSCRIBE_VEHICLE_VARIABLE, id, 0.0, FOREVER, &variables)
}

fn unsubscribe(client: &mut TraciClient, id: &str) -> Result<(), TraciError> {
    client.subscribe_object_variable(CMD_SUBSCRIBE_VEHICLE_VARIABLE, id, 0.0, FOREVER, &[])
}
