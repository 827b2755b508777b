//! Traffic lights: which of them rule the routes, what their signals say in a world, and which
//! agents pass a red signal.
//!
//! An episode begins at a random time of the programs, which follows from the episode's seed; the
//! offsets between several traffic lights stay those of the net. From there on SUMO runs the
//! programs. A static program therefore goes through the same states in every SUMO. The state of
//! any other program depends on the traffic as well.

use super::agents::{NextSignal, Slot, Status};
use super::routes::RouteGeometry;
use crate::rng::{self, Seed};
use crate::sumo::net::{Aspect, Net, Path, Signal, TrafficLight};
use crate::sumo::{Command, Snapshot, TrafficLightState};

/// Greatest distance before a stop line at which a stop counts as one before the line \[m\].
const AT_LINE: f64 = 5.0;
/// Speed below which a vehicle stands, as in SUMO \[m/s\].
pub(super) const STANDING: f64 = 0.1;
/// Longest time of the programs after which an episode begins \[ms\].
const LONGEST: i64 = 24 * 3600 * 1000;

/// The traffic lights that rule routes, and where vehicles stop for them.
#[derive(Debug, Clone, Default)]
pub struct TrafficLights {
    /// The traffic lights.
    pub lights: Vec<TrafficLight>,
    /// Stop lines of each route, in driving order.
    pub lines: Vec<Vec<StopLine>>,
}

/// Where vehicles of a route stop for a signal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StopLine {
    /// Position along the route \[m\].
    pub at: f64,
    /// Index into [`TrafficLights::lights`].
    pub light: usize,
    /// Index of the signal in the states of the traffic light.
    pub signal: usize,
}

impl TrafficLights {
    /// Finds the signals of `routes`, which lie along `lanes`.
    pub(super) fn new(net: &Net, lanes: &[Path], routes: &[RouteGeometry]) -> Self {
        // SUMO 1.15 crashes when it is asked about a program that is off.
        let is_on =
            |(_, signal): &(usize, Signal)| net.traffic_lights[signal.traffic_light].kind != "off";
        let mut used: Vec<usize> = Vec::new();
        let of_route = |(path, route): (&Path, &RouteGeometry)| {
            let ends: Vec<f64> = path.lane_stretches().map(|(_, _, end)| end).collect();
            let signals = net.signals_on(path).into_iter().filter(is_on);
            let line = signals.map(|(lane, signal)| {
                let known = used.iter().position(|&light| light == signal.traffic_light);
                let light = known.unwrap_or_else(|| {
                    used.push(signal.traffic_light);
                    used.len() - 1
                });
                StopLine { at: route.on_path(ends[lane]), light, signal: signal.index }
            });
            line.collect()
        };
        let lines = lanes.iter().zip(routes).map(of_route).collect();
        let lights = used.iter().map(|&light| net.traffic_lights[light].clone()).collect();
        Self { lights, lines }
    }

    /// Whether the states of all traffic lights follow from the time alone.
    pub(super) fn are_static(&self) -> bool {
        self.lights.iter().all(TrafficLight::is_static)
    }

    /// Returns the number of stop lines of its route that a vehicle has passed with its front.
    fn passed(&self, slot: &Slot) -> usize {
        self.passed_at(slot.route, front(slot))
    }

    /// Returns the number of stop lines before a position on a route \[m\].
    pub(super) fn passed_at(&self, route: usize, front: f64) -> usize {
        self.lines[route].partition_point(|line| line.at < front)
    }
}

fn front(slot: &Slot) -> f64 {
    slot.s + slot.size[0] / 2.0
}

/// The traffic lights of a world.
#[derive(Debug, Clone, Default)]
pub(super) struct Signals {
    states: Vec<TrafficLightState>,
    /// Time until each traffic light's next phase begins \[ms\].
    remaining: Vec<i64>,
}

impl Signals {
    pub(super) fn new(lights: &TrafficLights) -> Self {
        let count = lights.lights.len();
        Self { states: vec![TrafficLightState::default(); count], remaining: vec![0; count] }
    }

    /// Returns the states of the traffic lights in the last step, in SUMO's letters.
    pub(super) fn states(&self) -> impl Iterator<Item = &str> {
        self.states.iter().map(|light| light.state.as_str())
    }

    /// Appends the commands that start the programs at a random multiple of the decision interval
    /// \[s\]. Programs that cannot be started anywhere go on as they are.
    pub(super) fn begin(
        lights: &TrafficLights,
        interval: f64,
        world: u32,
        seed: Seed,
        commands: &mut Vec<Command>,
    ) {
        let lights =
            || lights.lights.iter().zip(0..).filter(|(light, _)| light.can_start_anywhere());
        let together = |all: i64, (light, _): (&TrafficLight, u32)| common(all, light.cycle());
        let step = (interval * 1000.0).round() as i64;
        let choice = lights().fold(1, together) / step;
        if choice == 0 {
            return;
        }
        let time = rng::below(&mut seed.rng(), choice as usize) as i64 * step;
        commands.extend(lights().map(|(light, index)| {
            let (phase, remaining) = light.at(time);
            Command::StartPhase {
                world,
                traffic_light: index,
                phase: phase as u32,
                remaining: remaining as f64 / 1000.0,
            }
        }));
    }

    /// Reads the states of world number `world` from the snapshot.
    pub(super) fn place(&mut self, world: u32, snapshot: &Snapshot) {
        let count = self.states.len();
        let all = snapshot.traffic_lights.iter().skip(world as usize * count);
        for ((state, remaining), found) in self.states.iter_mut().zip(&mut self.remaining).zip(all)
        {
            state.clone_from(found);
            *remaining = ((found.next_switch - snapshot.time) * 1000.0).round() as i64;
        }
    }

    fn aspect(&self, line: &StopLine) -> Aspect {
        Aspect::in_state(&self.states[line.light].state, line.signal)
    }

    /// Notes that a vehicle has just begun where it is: no stop line behind it counts.
    pub(super) fn enter(lights: &TrafficLights, slot: &mut Slot) {
        slot.lines_passed = lights.passed(slot);
    }

    /// Returns what a signal says to the vehicle of a slot, which comes to it next.
    fn aspect_for(&self, slot: &Slot, line: &StopLine) -> Aspect {
        let aspect = self.aspect(line);
        if slot.stood_at == Some(slot.lines_passed) { aspect.after_stop() } else { aspect }
    }

    /// Finds the agents that passed a red signal with their fronts in the last step, or a signal
    /// that demands a stop before which they have not stopped. A vehicle that comes to a line again,
    /// after it has driven backwards, does not count again.
    pub(super) fn judge(&self, lights: &TrafficLights, agents: &mut [Slot]) {
        for slot in agents.iter_mut().filter(|slot| slot.status == Status::Active) {
            let passed = lights.passed(slot).max(slot.lines_passed);
            let lines = &lights.lines[slot.route];
            let crossed = lines.get(slot.lines_passed..passed).unwrap_or_default();
            slot.ran_red = crossed.iter().enumerate().any(|(nth, line)| {
                let aspect = if nth == 0 { self.aspect_for(slot, line) } else { self.aspect(line) };
                aspect.demands_stop()
            });
            slot.red_lights += u32::from(slot.ran_red);
            let next = lines.get(passed);
            if slot.speed.abs() < STANDING
                && next.is_some_and(|line| line.at - front(slot) <= AT_LINE)
            {
                slot.stood_at = Some(passed);
            }
            slot.lines_passed = passed;
        }
    }

    /// Notes for each vehicle the signal that it comes to next. `agents` is the number of agents'
    /// slots.
    pub(super) fn look(&self, lights: &TrafficLights, agents: usize, slots: &mut [Slot]) {
        for (i, slot) in slots.iter_mut().enumerate() {
            let passed = if i < agents { slot.lines_passed } else { lights.passed(slot) };
            let line = lights.lines[slot.route].get(passed);
            let next = |line: &StopLine| {
                let (light, state) = (&lights.lights[line.light], &self.states[line.light]);
                let change = || {
                    let phase = usize::try_from(state.phase).unwrap_or(usize::MAX);
                    let change = light.until_change(phase, self.remaining[line.light], line.signal);
                    change.map_or(f64::INFINITY, |time| time as f64 / 1000.0)
                };
                NextSignal {
                    distance: line.at - front(slot),
                    aspect: self.aspect_for(slot, line),
                    to_change: light.is_static().then(change),
                }
            };
            slot.next_signal = line.filter(|_| slot.status == Status::Active).map(next);
        }
    }
}

/// Returns the least common multiple of two cycles, at most [`LONGEST`].
fn common(a: i64, b: i64) -> i64 {
    let (mut divisor, mut rest) = (a, b);
    while rest != 0 {
        (divisor, rest) = (rest, divisor % rest);
    }
    (a / divisor).saturating_mul(b).min(LONGEST)
}

#[cfg(test)]
mod tests;
