//! The simulated workload of the speed measurements: vehicles drive their routes at changing speeds
//! and are all put back to their start every 80 steps. Other clients can run the same commands.

use serde_json::{Value, json};

use crate::env::Task;
use crate::sumo::{Command, Hosting, SimulationConfig, VehicleState};

/// Steps between two respawns of all vehicles.
pub(super) const EPISODE: u32 = 80;
/// SUMO speed mode with all checks off, as the environments use it.
const NO_CHECKS: i32 = 32;

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum Control {
    /// Commands set speeds, and SUMO moves the vehicles.
    Throttle,
    /// Commands set poses with moveToXY.
    Steering,
}

impl Control {
    pub(super) fn name(self) -> &'static str {
        match self {
            Control::Throttle => "throttle",
            Control::Steering => "steering",
        }
    }
}

#[derive(Debug)]
pub(super) struct Workload {
    pub(super) task: Task,
    pub(super) control: Control,
    /// Whether SUMO looks for collisions in junctions.
    pub(super) audit: bool,
    /// Distance travelled since the respawn, `[N, EPISODE]` \[m\].
    distances: Vec<f64>,
}

impl Workload {
    pub(super) fn new(task: Task, control: Control, audit: bool) -> Self {
        let interval = task.scenario.control.interval;
        let speed = |agent: usize, step: u32| {
            6.0 + 6.0 * (0.07 * f64::from(step) + 0.9 * agent as f64).sin()
        };
        let mut distances = Vec::with_capacity(task.agents * EPISODE as usize);
        for agent in 0..task.agents {
            let place = &task.places[agent];
            // A vehicle that has arrived stays there.
            let longest = task.map.routes[place.routes[0]].arrival - place.pos;
            let mut distance = 0.0_f64;
            for step in 0..EPISODE {
                distance = (distance
                    + f64::from(u8::from(step > 0)) * speed(agent, step) * interval)
                    .min(longest);
                distances.push(distance);
            }
        }
        Self { task, control, audit, distances }
    }

    fn distance(&self, agent: u32, step: u32) -> f64 {
        self.distances[(agent * EPISODE + step) as usize]
    }

    fn half(&self) -> f64 {
        self.task.scenario.vehicle.length / 2.0
    }

    /// Appends the commands of one world in step `step`.
    pub(super) fn commands(&self, world: u32, step: u32, out: &mut Vec<Command>) {
        let (agents, episode_step) = (self.task.agents as u32, step % EPISODE);
        if episode_step == 0 {
            for slot in 0..agents {
                if step > 0 {
                    out.push(Command::Remove { world, slot });
                }
                let place = &self.task.places[slot as usize];
                out.push(Command::Add {
                    world,
                    slot,
                    route: place.routes[0] as u32,
                    vehicle_type: 0,
                    depart_pos: place.pos + self.half(),
                    depart_speed: 0.0,
                });
                out.push(Command::SpeedMode { world, slot, mode: NO_CHECKS });
            }
            return;
        }
        for slot in 0..agents {
            match self.control {
                Control::Throttle => {
                    let driven =
                        self.distance(slot, episode_step) - self.distance(slot, episode_step - 1);
                    out.push(Command::SetSpeed {
                        world,
                        slot,
                        speed: driven / self.task.scenario.control.interval,
                    });
                }
                Control::Steering => {
                    let place = &self.task.places[slot as usize];
                    let (route, front) = (
                        place.routes[0],
                        place.pos + self.half() + self.distance(slot, episode_step),
                    );
                    let ([x, y], heading, segment) = self.task.map.routes[route]
                        .path
                        .body(front, self.task.scenario.vehicle.length);
                    let keep_route = self.task.map.locate(route, [x, y], segment).0.keep_route();
                    out.push(Command::MoveTo { world, slot, x, y, heading, keep_route });
                }
            }
        }
    }

    /// Returns x + y + navigational angle + speed of a vehicle. The sum shows whether two clients
    /// simulated the same.
    pub(super) fn checksum(&self, slot: usize, vehicle: &VehicleState) -> f64 {
        let path = &self.task.map.routes[self.task.places[slot].routes[0]].path;
        let ([x, y], heading, _) =
            path.body(path.arc_of_distance(vehicle.distance), self.task.scenario.vehicle.length);
        x + y + (90.0 - heading.to_degrees()).rem_euclid(360.0) + vehicle.speed
    }

    pub(super) fn config(&self, worlds: u32) -> SimulationConfig {
        self.task.simulation_config(1, worlds, &Hosting { audit: self.audit, ..Hosting::default() })
    }

    /// Returns the commands of one world as JSON, for clients in other languages.
    pub(super) fn export(&self, arguments: &[String], warmup: u32, steps: u32) -> Value {
        let config = self.config(1);
        let mut commands = Vec::new();
        let steps: Vec<Value> = (0..warmup + steps)
            .map(|step| {
                commands.clear();
                self.commands(0, step, &mut commands);
                commands.iter().map(exported).collect()
            })
            .collect();
        let types: Vec<Value> = config
            .vehicle_types
            .iter()
            .map(|t| {
                json!({
                    "id": t.id, "length": t.length, "width": t.width, "max_speed": t.max_speed, "accel": t.accel,
                    "decel": t.decel, "emergency_decel": t.emergency_decel, "min_gap": t.min_gap, "tau": t.tau,
                })
            })
            .collect();
        let routes: Vec<Value> =
            config.routes.iter().map(|r| json!({"id": r.id, "edges": r.edges})).collect();
        let vehicles: Vec<String> =
            (0..self.task.agents).map(|slot| format!("w0s{slot}")).collect();
        json!({
            "arguments": arguments, "vehicle_types": types, "routes": routes, "vehicles": vehicles,
            "warmup": warmup, "steps": steps,
        })
    }
}

fn exported(command: &Command) -> Value {
    match *command {
        Command::Add { slot, route, vehicle_type, depart_pos, depart_speed, .. } => {
            json!(["add", slot, route, vehicle_type, depart_pos, depart_speed])
        }
        Command::Remove { slot, .. } => json!(["remove", slot]),
        Command::SetSpeed { slot, speed, .. } => json!(["speed", slot, speed]),
        Command::SpeedMode { slot, mode, .. } => json!(["speed_mode", slot, mode]),
        Command::LaneChangeMode { slot, mode, .. } => json!(["lane_change_mode", slot, mode]),
        Command::Depart { .. } | Command::ChangeLane { .. } | Command::StartPhase { .. } => {
            unreachable!(
                "the workload has agents only, which keep their lanes, and no traffic lights"
            )
        }
        Command::MoveTo { slot, x, y, heading, keep_route, .. } => {
            json!(["move", slot, x, y, (90.0 - heading.to_degrees()).rem_euclid(360.0), keep_route])
        }
    }
}
