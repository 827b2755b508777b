//! A [`Simulation`] in a separate SUMO process, over TraCI.
//!
//! One decision is one message: the commands, then the step. The reply holds the status of each
//! command and what the subscriptions report after the step. SUMO allows a vehicle to be added
//! under a name whose former vehicle is removed in the same message. SUMO moves a vehicle by its
//! new speed times the step length (SUMO's default method), so a commanded speed is a mean speed.

mod reports;

use super::{
    Batch, Client, Command, Error, Meter, Renewal, Simulation, SimulationConfig, Snapshot,
    client::Version,
    constants::Domain,
    domain::{
        person,
        simulation::{
            VAR_ARRIVED_PERSONS_IDS, VAR_ARRIVED_VEHICLES_IDS, VAR_COLLISIONS,
            VAR_PENDING_VEHICLES, VAR_TIME,
        },
        traffic_light::{TL_CURRENT_PHASE, TL_NEXT_SWITCH, TL_RED_YELLOW_GREEN_STATE},
        vehicle::{VAR_ANGLE, VAR_DISTANCE, VAR_LANE_ID, VAR_POSITION, VAR_SPEED, VAR_TIMELOSS},
    },
    fleet::Fleet,
    process::{Options, Process},
};
pub(super) use reports::StepSink;

/// A simulation of one or more worlds in one SUMO process.
#[derive(Debug)]
pub struct TraciSimulation {
    fleet: Fleet,
    /// Declared before `process`, so that the connection is closed before SUMO is killed.
    client: Client,
    process: Process,
    version: Version,
    batch: Batch,
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
        self.version = self.process.load(&mut self.client, &arguments)?;
        self.introduce()
    }

    /// Defines the vehicle types and routes and makes all subscriptions, in one message.
    fn introduce(&mut self) -> Result<(), Error> {
        let batch = &mut self.batch;
        batch.clear();
        self.fleet.define(batch);
        let walks = self.fleet.has_walks();
        let mut of_simulation =
            vec![VAR_TIME.id(), VAR_COLLISIONS.id(), VAR_ARRIVED_VEHICLES_IDS.id()];
        of_simulation.extend(walks.then(|| VAR_ARRIVED_PERSONS_IDS.id()));
        of_simulation.extend(self.fleet.may_drop().then(|| VAR_PENDING_VEHICLES.id()));
        batch.subscribe(Domain::SIMULATION, "", &of_simulation);
        let all = [
            VAR_DISTANCE.id(),
            VAR_SPEED.id(),
            VAR_POSITION.id(),
            VAR_ANGLE.id(),
            VAR_LANE_ID.id(),
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
        let of_lights =
            [TL_RED_YELLOW_GREEN_STATE.id(), TL_CURRENT_PHASE.id(), TL_NEXT_SWITCH.id()];
        for light in &self.fleet.traffic_lights {
            batch.subscribe(Domain::TRAFFIC_LIGHT, light, &of_lights);
        }
        let outcomes = self.client.run(batch).map_err(|e| self.process.explain(e))?;
        outcomes.into_iter().try_for_each(|outcome| outcome.map(drop))
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
        self.fleet.write(commands, &mut self.batch)?;
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
            let error = self.fleet.refuse(self.batch.refusal(index, &message));
            first = first.or(error);
        }
        self.fleet.find_dropped();
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

fn launch(fleet: &Fleet) -> Result<(Process, Client, Version), Error> {
    Process::start(&Options {
        arguments: fleet.arguments()?,
        reply_timeout: fleet.config().timeout,
        ..Options::default()
    })
}

#[cfg(test)]
mod tests;
