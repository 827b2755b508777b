//! Traffic lights.

use super::Scope;
use crate::sumo::{
    Client, Error,
    codec::{Value, Writer},
    value::{Argument, Fields, FromFields, FromValue, compound},
};

domain! {
    /// Calls for traffic lights.
    TrafficLight, "trafficlight", TRAFFIC_LIGHT
}
identifiers! { TrafficLight, "trafficlight" }

/// A phase of a traffic light's program.
#[derive(Debug, Clone, PartialEq)]
pub struct Phase {
    /// Duration \[s\].
    pub duration: f64,
    /// State of the signals, one letter for each, such as `GrGr`.
    pub state: String,
    /// Shortest duration of an adaptive program \[s\]; negative: none.
    pub min_dur: f64,
    /// Longest duration of an adaptive program \[s\]; negative: none.
    pub max_dur: f64,
    /// Indices of the phases that may follow; empty: the phase at the next index.
    pub next: Vec<i32>,
    /// Name.
    pub name: String,
}

impl Phase {
    /// Returns a phase without limits and name, of a duration \[s\] and with one letter for each
    /// signal.
    pub fn new(duration: f64, state: impl Into<String>) -> Self {
        Phase {
            duration,
            state: state.into(),
            min_dur: -1.0,
            max_dur: -1.0,
            next: Vec::new(),
            name: String::new(),
        }
    }
}

/// A program of a traffic light.
#[derive(Debug, Clone, PartialEq)]
pub struct Logic {
    /// Program identifier.
    pub program_id: String,
    /// Kind of program. 0: fixed times, 3: actuated, 4: NEMA (SUMO terminates if its parameters are
    /// not given), 5: based on delay.
    pub kind: i32,
    /// Index of the current phase.
    pub current_phase_index: i32,
    /// Phases.
    pub phases: Vec<Phase>,
    /// Parameters as pairs of name and value.
    pub parameters: Vec<(String, String)>,
}

/// A link, that is, a connection across the junction that a signal controls.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Link {
    /// The lane where the link begins.
    pub from: String,
    /// The lane where the link ends.
    pub to: String,
    /// The lane inside the junction.
    pub via: String,
}

record! {
    /// A constraint of a rail signal: a train waits at the signal until another train has passed.
    Constraint {
        /// The signal where the train waits.
        signal_id: String,
        /// The trip that waits.
        trip_id: String,
        /// The trip that has priority (the foe).
        foe_id: String,
        /// The signal that the foe passes.
        foe_signal: String,
        /// Number of latest trips at the foe's signal among which SUMO looks for the foe.
        limit: i32,
        /// Kind of constraint. 0: predecessor, 1: insertion predecessor; further kinds are in
        /// SUMO's manual.
        kind: i32,
        /// Whether the constraint holds the train up now.
        must_wait: bool,
        /// Whether the constraint is in force.
        active: bool,
        /// Parameters: name, value, name, value…
        parameters: Vec<String>,
    }
}
flat_list! { Constraint }

impl FromValue for Phase {
    fn from_value(value: Value) -> Result<Self, Error> {
        compound(value, |fields| {
            Ok(Phase {
                duration: fields.take()?,
                state: fields.take()?,
                min_dur: fields.take()?,
                max_dur: fields.take()?,
                next: compound(fields.take()?, Fields::rest)?,
                name: fields.take()?,
            })
        })
    }
}

impl FromValue for Logic {
    fn from_value(value: Value) -> Result<Self, Error> {
        compound(value, |fields| {
            Ok(Logic {
                program_id: fields.take()?,
                kind: fields.take()?,
                current_phase_index: fields.take()?,
                phases: compound(fields.take()?, Fields::rest)?,
                parameters: compound(fields.take()?, Fields::rest::<Vec<String>>)?
                    .into_iter()
                    .map(|pair| {
                        let mut pair = pair.into_iter();
                        (pair.next().unwrap_or_default(), pair.next().unwrap_or_default())
                    })
                    .collect(),
            })
        })
    }
}

impl FromValue for Vec<Logic> {
    fn from_value(value: Value) -> Result<Self, Error> {
        compound(value, Fields::rest)
    }
}

impl FromValue for Link {
    fn from_value(value: Value) -> Result<Self, Error> {
        match <[String; 3]>::try_from(Vec::from_value(value)?) {
            Ok([from, to, via]) => Ok(Link { from, to, via }),
            Err(other) => Err(Error::other_type("three lanes", format!("{} strings", other.len()))),
        }
    }
}

/// The links of one signal.
struct Links(Vec<Link>);

impl FromFields for Links {
    fn from_fields(fields: &mut Fields) -> Result<Self, Error> {
        let count: i32 = fields.take()?;
        Ok(Links((0..count).map(|_| fields.take()).collect::<Result<_, _>>()?))
    }
}

impl FromValue for Vec<Vec<Link>> {
    fn from_value(value: Value) -> Result<Self, Error> {
        let signals: Vec<Links> = compound(value, Fields::records)?;
        Ok(signals.into_iter().map(|links| links.0).collect())
    }
}

getters! { TrafficLight, "trafficlight";
    /// State of the signals, one letter for each.
    get_red_yellow_green_state "getRedYellowGreenState" TL_RED_YELLOW_GREEN_STATE 0x20 -> String;
    /// All programs.
    get_all_program_logics "getAllProgramLogics" TL_COMPLETE_DEFINITION_RYG 0x2b -> Vec<Logic>;
    /// The lane that each signal controls.
    get_controlled_lanes "getControlledLanes" TL_CONTROLLED_LANES 0x26 -> Vec<String>;
    /// The links that each signal controls.
    get_controlled_links "getControlledLinks" TL_CONTROLLED_LINKS 0x27 -> Vec<Vec<Link>>;
    /// Identifier of the current program.
    get_program "getProgram" TL_CURRENT_PROGRAM 0x29 -> String;
    /// Index of the current phase.
    get_phase "getPhase" TL_CURRENT_PHASE 0x28 -> i32;
    /// Name of the current phase.
    get_phase_name "getPhaseName" VAR_NAME 0x1b -> String;
    /// Simulation time at which the phase ends \[s\].
    get_next_switch "getNextSwitch" TL_NEXT_SWITCH 0x2d -> f64;
    /// Duration of the current phase \[s\].
    get_phase_duration "getPhaseDuration" TL_PHASE_DURATION 0x24 -> f64;
    /// Number of persons that the phase at the index would serve.
    get_served_person_count "getServedPersonCount" 0x67 (phase: i32) -> i32;
    /// Vehicles that block the track section behind a link of a rail signal.
    get_blocking_vehicles "getBlockingVehicles" 0x25 (link: i32) -> Vec<String>;
    /// Vehicles that also want to enter the track section behind a link of a rail signal.
    get_rival_vehicles "getRivalVehicles" 0x30 (link: i32) -> Vec<String>;
    /// Vehicles that have priority over the vehicles of a link of a rail signal.
    get_priority_vehicles "getPriorityVehicles" 0x31 (link: i32) -> Vec<String>;
    /// Constraints of a rail signal for a trip; for all trips if `trip` is empty.
    get_constraints "getConstraints" 0x2f (trip: &str) -> Vec<Constraint>;
    /// Constraints of other signals whose foe is a trip at this signal; for any trip if `foe` is
    /// empty.
    get_constraints_by_foe "getConstraintsByFoe" 0x34 (foe: &str) -> Vec<Constraint>;
    /// Exchanges the order of a trip and its foe, so that the foe waits; returns the resulting
    /// constraints.
    swap_constraints "swapConstraints" 0x32 [trip: &str, foe_signal: &str, foe: &str]
        -> Vec<Constraint>;
}

setters! { TrafficLight, "trafficlight";
    /// Sets the signals, one letter for each; afterwards the traffic light follows no program.
    set_red_yellow_green_state "setRedYellowGreenState" 0x20 (state: &str);
    /// Switches to a phase of the program.
    set_phase "setPhase" 0x22 (index: i32);
    /// Sets the name of the current phase.
    set_phase_name "setPhaseName" 0x1b (name: &str);
    /// Switches to a program.
    set_program "setProgram" 0x23 (program: &str);
    /// Sets the remaining duration of the current phase \[s\].
    set_phase_duration "setPhaseDuration" 0x24 (duration: f64);
    /// Removes the constraints of a trip for a foe at a signal; an empty argument matches any.
    remove_constraints "removeConstraints" 0x35 [trip: &str, foe_signal: &str, foe: &str];
    /// Removes the constraints that no longer match a vehicle's route. The argument is the
    /// identifier of the vehicle, not of its trip.
    update_constraints "updateConstraints" 0x36 (vehicle: &str);
    /// Adds a program, or replaces the program of the same identifier, and switches to it.
    set_program_logic "setProgramLogic" 0x2c (logic: &Logic);
}

impl<S: Scope> TrafficLight<'_, S> {
    /// Returns the phases that vehicles request at a NEMA controller, separated by commas.
    pub fn get_nema_phase_calls(&mut self, id: &str) -> S::Output<String> {
        self.get_parameter(id, "NEMA.phaseCall")
    }

    /// Sets the splits of a NEMA controller \[s\], separated by spaces.
    pub fn set_nema_splits(&mut self, id: &str, splits: &str) -> S::Output<()> {
        self.set_parameter(id, "NEMA.splits", splits)
    }

    /// Sets the longest green times of a NEMA controller \[s\], separated by spaces.
    pub fn set_nema_max_greens(&mut self, id: &str, greens: &str) -> S::Output<()> {
        self.set_parameter(id, "NEMA.maxGreens", greens)
    }

    /// Sets the cycle length of a NEMA controller \[s\].
    pub fn set_nema_cycle_length(&mut self, id: &str, length: f64) -> S::Output<()> {
        self.set_parameter(id, "NEMA.cycleLength", &length.to_string())
    }

    /// Sets the offset of a NEMA controller \[s\].
    pub fn set_nema_offset(&mut self, id: &str, offset: f64) -> S::Output<()> {
        self.set_parameter(id, "NEMA.offset", &offset.to_string())
    }
}

impl TrafficLight<'_, Client> {
    /// Sets one signal, by its index, and leaves the others unchanged. Takes two exchanges.
    ///
    /// # Errors
    /// As for all calls; [`Error::Invalid`] if no signal has this index.
    pub fn set_link_state(&mut self, id: &str, index: usize, state: char) -> Result<(), Error> {
        let mut states: Vec<char> = self.get_red_yellow_green_state(id)?.chars().collect();
        let count = states.len();
        let Some(signal) = states.get_mut(index) else {
            return Err(Error::invalid(format!(
                "`{id}` has {count} signals: there is none of index {index}"
            )));
        };
        *signal = state;
        self.set_red_yellow_green_state(id, &String::from_iter(states))
    }
}

impl Argument for &Logic {
    fn write(self, w: &mut Writer) {
        w.compound(5).string(&self.program_id).integer(self.kind).integer(self.current_phase_index);
        w.compound(self.phases.len() as i32);
        for phase in &self.phases {
            w.compound(6)
                .double(phase.duration)
                .string(&phase.state)
                .double(phase.min_dur)
                .double(phase.max_dur);
            w.compound(phase.next.len() as i32);
            for next in &phase.next {
                w.integer(*next);
            }
            w.string(&phase.name);
        }
        w.compound(self.parameters.len() as i32);
        for (name, value) in &self.parameters {
            w.string_list(&[name, value]);
        }
    }
}
