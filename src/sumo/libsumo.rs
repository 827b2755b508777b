//! A [`Simulation`] within this process: SUMO as the library libsumo, through its Python module.
//!
//! libsumo runs one simulation per process. The worlds are therefore tiles of one net, and a second
//! simulation is refused. One decision is one call of `python_bridge/libsumo_bridge.py`. The calls
//! are those of the batch that would go out over TraCI, and the results are bit-identical.

mod module;

use std::sync::atomic::{AtomicBool, Ordering};

use pyo3::{
    exceptions::PyValueError,
    prelude::*,
    types::{PyList, PyString},
};

use super::{
    Batch, Command, Error, Meter, Renewal, Simulation, SimulationConfig, Snapshot,
    TrafficLightState, Value, constants as c, fleet::Fleet,
};
pub use module::LibsumoModule;

/// Index of the first refused call, and SUMO's reason.
type Refusals = Vec<(usize, String)>;

static OCCUPIED: AtomicBool = AtomicBool::new(false);

/// Permission to run the one simulation of libsumo; dropping it releases the permission.
#[derive(Debug)]
struct SoleUse;

impl SoleUse {
    fn take() -> Result<Self, Error> {
        if OCCUPIED.swap(true, Ordering::AcqRel) { Err(Error::Occupied) } else { Ok(SoleUse) }
    }
}

impl Drop for SoleUse {
    fn drop(&mut self) {
        OCCUPIED.store(false, Ordering::Release);
    }
}

/// A simulation of one or more worlds in this process.
#[derive(Debug)]
pub struct LibsumoSimulation {
    fleet: Fleet,
    module: Py<PyModule>,
    step: Py<PyAny>,
    /// Python strings of `fleet.names`.
    names: Vec<Py<PyString>>,
    /// Vehicles whose state is read after each step, as indices and as a Python list of names; both
    /// are rebuilt when the set changes.
    asked: Vec<usize>,
    asked_names: Py<PyList>,
    /// Pedestrians whose state is read after each step, in the same two forms.
    on_foot: Vec<usize>,
    asked_on_foot: Py<PyList>,
    /// Names of the traffic lights as a Python list.
    traffic_lights: Py<PyList>,
    batch: Batch,
    awaiting: bool,
    exchanges: u64,
    /// Declared last, so that the simulation is closed before the permission is released.
    _place: SoleUse,
}

impl LibsumoSimulation {
    /// Starts the simulation and defines its vehicle types and routes.
    ///
    /// # Errors
    /// [`Error::Occupied`] while another simulation runs; [`Error::Libsumo`] if Python or libsumo
    /// fails; otherwise as [`super::TraciSimulation::start`].
    pub fn start(config: SimulationConfig) -> Result<Self, Error> {
        let place = SoleUse::take()?;
        let fleet = Fleet::new(config)?;
        let loaded = LibsumoModule::load()?;
        loaded.warn();
        Python::attach(|py| {
            let importing = |e: PyErr| failed("import it", py, &e);
            let module = loaded.bridge(py).clone();
            let step = module.getattr("step").map_err(importing)?.unbind();
            let names = fleet.names.iter().map(|name| PyString::new(py, name).unbind()).collect();
            let lights = PyList::new(py, &fleet.traffic_lights).map_err(importing)?;
            let mut simulation = LibsumoSimulation {
                traffic_lights: lights.unbind(),
                fleet,
                module: module.unbind(),
                step,
                names,
                asked: Vec::new(),
                asked_names: PyList::empty(py).unbind(),
                on_foot: Vec::new(),
                asked_on_foot: PyList::empty(py).unbind(),
                batch: Batch::new(),
                awaiting: false,
                exchanges: 0,
                _place: place,
            };
            simulation.begin(py)?;
            Ok(simulation)
        })
    }

    fn begin(&mut self, py: Python<'_>) -> Result<(), Error> {
        let started = self.module.bind(py).call_method1("start", (self.fleet.arguments()?,));
        let (api, peer): (i32, String) =
            started.and_then(|version| version.extract()).map_err(|e| failed("start", py, &e))?;
        if api < c::MINIMUM_API_VERSION {
            return Err(Error::Version { found: api, minimum: c::MINIMUM_API_VERSION, peer });
        }
        self.introduce(py)
    }

    /// Defines the vehicle types and routes.
    fn introduce(&mut self, py: Python<'_>) -> Result<(), Error> {
        self.batch.clear();
        self.fleet.define(&mut self.batch);
        let runs = self.runs(py)?;
        let carried_out = self.module.bind(py).call_method1("carry_out", (runs,));
        let (refusals, _): (Refusals, Py<PyAny>) = carried_out
            .and_then(|outcome| outcome.extract())
            .map_err(|e| failed("introduce vehicle types and routes", py, &e))?;
        self.check(refusals)
    }

    fn runs<'py>(&self, py: Python<'py>) -> Result<Bound<'py, PyList>, Error> {
        let name = |object: &str| match self.fleet.vehicle_named(object) {
            Some(vehicle) => self.names[vehicle].bind(py).clone(),
            None => PyString::new(py, object),
        };
        runs(py, &self.batch, name).map_err(|e| failed("list the commands", py, &e))
    }

    /// Records what SUMO has refused of departures; returns the first other error.
    fn check(&mut self, refusals: Refusals) -> Result<(), Error> {
        let mut first = None;
        for (index, message) in refusals {
            let error = self.fleet.refuse(self.batch.refusal(index, &message));
            first = first.or(error);
        }
        first.map_or(Ok(()), Err)
    }

    /// Sends the commands, takes one step and records the results, all in one call across the
    /// bridge.
    fn exchange(&mut self, py: Python<'_>) -> Result<(), Error> {
        type Bodies = (Vec<[f64; 2]>, Vec<f64>, Vec<String>, Vec<f64>);
        type Pedestrians = Vec<Option<([f64; 2], f64, f64)>>;
        type Collisions = Vec<(String, String)>;
        type Absent = [Vec<String>; 2];
        type Refused = (Collisions, Refusals);
        type Lights = Vec<(String, i32, f64)>;
        type Reply = (f64, Absent, Vec<f64>, Vec<f64>, Refused, Bodies, Pedestrians, Lights);
        self.ask(py).map_err(|e| failed("list the vehicles", py, &e))?;
        let others = self.fleet.config().others.is_some();
        let asked =
            (self.runs(py)?, &self.asked_names, others, &self.asked_on_foot, &self.traffic_lights);
        let reply = self.step.bind(py).call1(asked);
        let (
            time,
            [gone, dropped],
            distances,
            speeds,
            (collisions, refusals),
            (positions, angles, lanes, losses),
            pedestrians,
            lights,
        ) = reply.and_then(|reply| reply.extract::<Reply>()).map_err(|e| failed("step", py, &e))?;
        self.fleet.begin_step();
        self.fleet.snapshot.time = time;
        for name in &gone {
            self.fleet.gone(name);
        }
        for name in &dropped {
            self.fleet.dropped(name);
        }
        let mut values = distances.into_iter().zip(speeds);
        let mut bodies = positions.into_iter().zip(angles).zip(lanes).zip(losses);
        for &vehicle in &self.asked {
            if self.fleet.knows(vehicle)
                && let Some((distance, speed)) = values.next()
            {
                self.fleet.report(vehicle, distance, speed);
                if let Some((((position, angle), lane), loss)) = bodies.next() {
                    let lane = self.fleet.lane(&lane);
                    self.fleet.body(vehicle, position, angle, lane, loss);
                }
            }
        }
        for (&person, found) in self.on_foot.iter().zip(pedestrians) {
            if let Some((position, angle, speed)) = found {
                self.fleet.pedestrian(person, position, angle, speed);
            }
        }
        for (light, (state, phase, next_switch)) in
            self.fleet.snapshot.traffic_lights.iter_mut().zip(lights)
        {
            *light = TrafficLightState { state, phase, next_switch };
        }
        for (collider, victim) in &collisions {
            self.fleet.collision(collider, victim);
        }
        self.check(refusals)
    }

    /// Updates the lists of vehicles and pedestrians to read to those that SUMO knows after the
    /// commands.
    fn ask(&mut self, py: Python<'_>) -> PyResult<()> {
        let list = |of: &[usize]| {
            let names: Vec<_> = of.iter().map(|&vehicle| self.names[vehicle].bind(py)).collect();
            PyList::new(py, names).map(Bound::unbind)
        };
        let fleet = &self.fleet;
        if !fleet.expected(false).eq(self.asked.iter().copied()) {
            let asked: Vec<usize> = fleet.expected(false).collect();
            (self.asked_names, self.asked) = (list(&asked)?, asked);
        }
        if !fleet.expected(true).eq(self.on_foot.iter().copied()) {
            let on_foot: Vec<usize> = fleet.expected(true).collect();
            (self.asked_on_foot, self.on_foot) = (list(&on_foot)?, on_foot);
        }
        Ok(())
    }
}

impl Simulation for LibsumoSimulation {
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
        self.awaiting = true;
        self.exchanges += 1;
        Ok(())
    }

    fn receive(&mut self) -> Result<&Snapshot, Error> {
        if !std::mem::take(&mut self.awaiting) {
            return Err(Error::invalid("nothing was sent that could be answered"));
        }
        Python::attach(|py| self.exchange(py))?;
        Ok(&self.fleet.snapshot)
    }

    fn renew(&mut self) -> Result<Renewal, Error> {
        self.awaiting = false;
        self.fleet.empty();
        Python::attach(|py| {
            let module = self.module.bind(py).clone();
            let arguments = self.fleet.arguments()?;
            let renewal = if module.call_method1("load", (&arguments,)).is_ok() {
                Renewal::Loaded
            } else {
                // Fails if there is no simulation left to close.
                let _ = module.call_method0("close");
                module.call_method1("start", (&arguments,)).map_err(|e| failed("start", py, &e))?;
                Renewal::Restarted
            };
            self.introduce(py)?;
            Ok(renewal)
        })
    }

    fn reseed(&mut self, seed: u64) {
        self.fleet.reseed(seed);
    }

    fn meter(&self) -> Meter {
        Meter { exchanges: self.exchanges, ..Meter::default() }
    }
}

impl Drop for LibsumoSimulation {
    fn drop(&mut self) {
        Python::attach(|py| {
            // A destructor cannot report an error.
            let _ = self.module.bind(py).call_method0("close");
        });
    }
}

fn failed(doing: &'static str, py: Python<'_>, error: &PyErr) -> Error {
    let kind = error.get_type(py).name().map_or_else(|_| String::new(), |name| format!("{name}: "));
    Error::Libsumo { doing, message: format!("{kind}{}", error.value(py)) }
}

/// Returns the calls of a batch as a Python list of `(name, objects, columns…)`, one for each run
/// of calls of the same name, with a column for each argument.
fn runs<'py>(
    py: Python<'py>,
    batch: &Batch,
    name: impl Fn(&str) -> Bound<'py, PyString>,
) -> PyResult<Bound<'py, PyList>> {
    let runs = PyList::empty(py);
    let mut last = "";
    let mut columns: Vec<Bound<'py, PyList>> = Vec::new();
    let end = |call: &str, columns: &mut Vec<Bound<'py, PyList>>| match columns.len() {
        0 => Ok(()),
        _ => runs.append((call, std::mem::take(columns))),
    };
    for (call, object, mut arguments) in batch.calls() {
        if call != last {
            end(last, &mut columns)?;
            last = call;
        }
        let broken = |e: Error| PyValueError::new_err(e.to_string());
        let arguments = match arguments.remaining() {
            0 => Vec::new(),
            _ => match arguments.value().map_err(broken)? {
                Value::Compound(items) => items,
                one => vec![one],
            },
        };
        columns.resize_with(1 + arguments.len(), || PyList::empty(py));
        columns[0].append(name(object))?;
        for (column, argument) in columns[1..].iter().zip(arguments) {
            match argument {
                Value::Double(v) => column.append(v)?,
                Value::Integer(v) => column.append(v)?,
                Value::Byte(v) => column.append(v)?,
                Value::String(v) => column.append(v)?,
                Value::StringList(v) => column.append(v)?,
                other => return Err(PyValueError::new_err(format!("{} in a call", other.kind()))),
            }
        }
    }
    end(last, &mut columns)?;
    Ok(runs)
}
