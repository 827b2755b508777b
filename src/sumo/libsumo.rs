//! A [`Simulation`] within this process: SUMO as the library libsumo, through Debian's Python
//! module.
//!
//! libsumo runs one simulation per process. The worlds are therefore tiles of one net, and a second
//! simulation is refused. One decision is one call of `python_bridge/libsumo_bridge.py`, with the
//! commands as columns of numbers and names. Commands and names are the same as with TraCI, and the
//! results are bit-identical.

use std::{
    ffi::{CStr, CString},
    sync::atomic::{AtomicBool, Ordering},
};

use pyo3::{
    prelude::*,
    types::{PyDict, PyList, PyString},
};

use super::{
    Command, Error, Meter, Renewal, Simulation, SimulationConfig, Snapshot,
    constants::{self as c, Domain},
    fleet::{Fleet, Orders, TileRoute, Vehicle},
};

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
    columns: Columns,
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
        Python::attach(|py| {
            let importing = |e: PyErr| failed("import it", py, &e);
            let module = bridge(py).map_err(importing)?;
            let step = module.getattr("step").map_err(importing)?.unbind();
            let names = fleet.names.iter().map(|name| PyString::new(py, name).unbind()).collect();
            let simulation = LibsumoSimulation {
                fleet,
                module: module.unbind(),
                step,
                names,
                asked: Vec::new(),
                asked_names: PyList::empty(py).unbind(),
                on_foot: Vec::new(),
                asked_on_foot: PyList::empty(py).unbind(),
                columns: Columns::default(),
                awaiting: false,
                exchanges: 0,
                _place: place,
            };
            simulation.begin(py)?;
            Ok(simulation)
        })
    }

    fn begin(&self, py: Python<'_>) -> Result<(), Error> {
        let started = self.module.bind(py).call_method1("start", (self.fleet.arguments()?,));
        let (api, peer): (i32, String) =
            started.and_then(|version| version.extract()).map_err(|e| failed("start", py, &e))?;
        if api < c::MINIMUM_API_VERSION {
            return Err(Error::Version { found: api, minimum: c::MINIMUM_API_VERSION, peer });
        }
        self.introduce(py)
    }

    fn introduce(&self, py: Python<'_>) -> Result<(), Error> {
        let describe = || -> PyResult<Option<(String, String)>> {
            let types = PyList::empty(py);
            for kind in &self.fleet.config().vehicle_types {
                let attributes = PyDict::new(py);
                attributes.set_item("id", &kind.id)?;
                for (key, value) in [
                    ("length", kind.length),
                    ("width", kind.width),
                    ("min_gap", kind.min_gap),
                    ("max_speed", kind.max_speed),
                    ("accel", kind.accel),
                    ("emergency_decel", kind.emergency_decel),
                    ("decel", kind.decel),
                    ("tau", kind.tau),
                    ("imperfection", 0.0),
                    ("speed_factor", 1.0),
                    ("speed_deviation", 0.0),
                ] {
                    attributes.set_item(key, value)?;
                }
                types.append(attributes)?;
            }
            let routes = PyList::empty(py);
            for route in self.fleet.routes.iter().filter(|route| !route.walked) {
                routes.append((&route.id, &route.edges))?;
            }
            self.module.bind(py).call_method1("introduce", (types, routes))?.extract()
        };
        match describe().map_err(|e| failed("introduce vehicle types and routes", py, &e))? {
            Some((id, message)) => Err(Error::Refused {
                command: Domain::ROUTE.set,
                call: "route.add".to_owned(),
                id,
                message,
            }),
            None => Ok(()),
        }
    }

    /// Sends the commands, takes one step and records the results, all in one call across the
    /// bridge.
    fn exchange(&mut self, py: Python<'_>) -> Result<(), Error> {
        type Bodies = (Vec<[f64; 2]>, Vec<f64>, Vec<f64>);
        type Refusal = Option<(String, String, String)>;
        type Pedestrians = Vec<Option<([f64; 2], f64, f64)>>;
        type Reply = (
            f64,
            Vec<String>,
            Vec<f64>,
            Vec<f64>,
            Vec<(String, String)>,
            Refusal,
            Bodies,
            Pedestrians,
        );
        self.ask(py).map_err(|e| failed("list the vehicles", py, &e))?;
        let orders =
            self.columns.list(py, &self.names).map_err(|e| failed("list the commands", py, &e))?;
        let others = self.fleet.config().others.is_some();
        let reply =
            self.step.bind(py).call1((orders, &self.asked_names, others, &self.asked_on_foot));
        let (
            time,
            gone,
            distances,
            speeds,
            collisions,
            refusal,
            (positions, angles, losses),
            pedestrians,
        ) = reply.and_then(|reply| reply.extract::<Reply>()).map_err(|e| failed("step", py, &e))?;
        self.fleet.begin_step();
        self.fleet.snapshot.time = time;
        for name in &gone {
            self.fleet.gone(name);
        }
        let mut values = distances.into_iter().zip(speeds);
        let mut bodies = positions.into_iter().zip(angles).zip(losses);
        for &vehicle in &self.asked {
            if self.fleet.known[vehicle]
                && let Some((distance, speed)) = values.next()
            {
                self.fleet.report(vehicle, distance, speed);
                if let Some(((position, angle), loss)) = bodies.next() {
                    self.fleet.body(vehicle, position, angle, loss);
                }
            }
        }
        for (&person, found) in self.on_foot.iter().zip(pedestrians) {
            if let Some((position, angle, speed)) = found {
                self.fleet.pedestrian(person, position, angle, speed);
            }
        }
        for (collider, victim) in &collisions {
            self.fleet.collision(collider, victim);
        }
        match refusal {
            Some((call, id, message)) => {
                Err(Error::Refused { command: Domain::VEHICLE.set, call, id, message })
            }
            None => Ok(()),
        }
    }

    /// Updates the lists of vehicles and pedestrians to read to those that SUMO knows after the
    /// commands.
    fn ask(&mut self, py: Python<'_>) -> PyResult<()> {
        let list = |of: &[usize]| {
            let names: Vec<_> = of.iter().map(|&vehicle| self.names[vehicle].bind(py)).collect();
            PyList::new(py, names).map(Bound::unbind)
        };
        let fleet = &self.fleet;
        let wanted =
            |walks: bool| fleet.expected().filter(move |&vehicle| fleet.walks(vehicle) == walks);
        if !wanted(false).eq(self.asked.iter().copied()) {
            let asked: Vec<usize> = wanted(false).collect();
            (self.asked_names, self.asked) = (list(&asked)?, asked);
        }
        if !wanted(true).eq(self.on_foot.iter().copied()) {
            let on_foot: Vec<usize> = wanted(true).collect();
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
        self.columns.clear();
        self.fleet.order(commands, &mut self.columns)?;
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
            let module = self.module.bind(py);
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

/// Returns the Python module of the bridge, which is executed once per process.
fn bridge(py: Python<'_>) -> PyResult<Bound<'_, PyModule>> {
    static MODULE: pyo3::sync::PyOnceLock<Py<PyModule>> = pyo3::sync::PyOnceLock::new();
    const NAME: &CStr = c"iwol_sumo_libsumo_bridge";
    let run = || {
        let code = CString::new(include_str!("../../python_bridge/libsumo_bridge.py"))?;
        PyModule::from_code(py, &code, c"python_bridge/libsumo_bridge.py", NAME).map(Bound::unbind)
    };
    Ok(MODULE.get_or_try_init(py, run)?.bind(py).clone())
}

fn failed(doing: &'static str, py: Python<'_>, error: &PyErr) -> Error {
    let kind = error.get_type(py).name().map_or_else(|_| String::new(), |name| format!("{name}: "));
    Error::Libsumo { doing, message: format!("{kind}{}", error.value(py)) }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Add,
    Remove,
    Speed,
    SpeedMode,
    LaneChangeMode,
    Move,
    Walk,
    RemovePerson,
    WalkingSpeed,
}

/// The commands of a step in order. Consecutive commands of the same kind form a run, which crosses
/// the bridge as columns.
#[derive(Debug, Default)]
struct Columns {
    rows: Vec<(Kind, usize, [f64; 4])>,
    /// Route, type, lane, position and speed of each vehicle to add.
    texts: Vec<[String; 5]>,
    /// Type and edges of each pedestrian to add.
    walks: Vec<(String, Vec<String>)>,
}

impl Columns {
    fn clear(&mut self) {
        self.rows.clear();
        self.texts.clear();
        self.walks.clear();
    }

    /// Returns the Python list of `(kind, vehicles, columns…)`.
    fn list<'py>(&self, py: Python<'py>, names: &[Py<PyString>]) -> PyResult<Bound<'py, PyList>> {
        let orders = PyList::empty(py);
        let (mut texts, mut walks) = (self.texts.iter(), self.walks.iter());
        for run in self.rows.chunk_by(|a, b| a.0 == b.0) {
            let vehicles = PyList::new(py, run.iter().map(|row| names[row.1].bind(py)))?;
            let numbers = |k: usize| PyList::new(py, run.iter().map(|row| row.2[k]));
            let integers = |k: usize| PyList::new(py, run.iter().map(|row| row.2[k] as i32));
            match run[0].0 {
                Kind::Add => {
                    let additions: Vec<&[String; 5]> = texts.by_ref().take(run.len()).collect();
                    let column =
                        |k: usize| PyList::new(py, additions.iter().map(|texts| texts[k].as_str()));
                    let [routes, types, lanes, positions, speeds] =
                        [column(0)?, column(1)?, column(2)?, column(3)?, column(4)?];
                    orders.append((
                        "vehicle.add",
                        vehicles,
                        routes,
                        types,
                        lanes,
                        positions,
                        speeds,
                    ))?;
                }
                Kind::Walk => {
                    let (types, edges): (Vec<_>, Vec<_>) =
                        walks.by_ref().take(run.len()).map(|(kind, edges)| (kind, edges)).unzip();
                    orders.append((
                        "person.add",
                        vehicles,
                        types,
                        edges,
                        numbers(0)?,
                        numbers(1)?,
                    ))?;
                }
                Kind::RemovePerson => orders.append(("person.remove", vehicles))?,
                Kind::WalkingSpeed => orders.append(("person.setSpeed", vehicles, numbers(0)?))?,
                Kind::Remove => orders.append(("vehicle.remove", vehicles))?,
                Kind::Speed => orders.append(("vehicle.setSpeed", vehicles, numbers(0)?))?,
                Kind::SpeedMode => {
                    orders.append(("vehicle.setSpeedMode", vehicles, integers(0)?))?;
                }
                Kind::LaneChangeMode => {
                    orders.append(("vehicle.setLaneChangeMode", vehicles, integers(0)?))?;
                }
                Kind::Move => {
                    orders.append((
                        "vehicle.moveToXY",
                        vehicles,
                        numbers(0)?,
                        numbers(1)?,
                        numbers(2)?,
                        integers(3)?,
                    ))?;
                }
            }
        }
        Ok(orders)
    }
}

impl Orders for Columns {
    fn add(
        &mut self,
        vehicle: Vehicle<'_>,
        route: &TileRoute,
        vehicle_type: &str,
        position: f64,
        speed: f64,
    ) {
        self.rows.push((Kind::Add, vehicle.index, [0.0; 4]));
        // SUMO expects these numbers as strings.
        let numbers = [f64::from(route.lane), position, speed].map(|number| number.to_string());
        let [lane, position, speed] = numbers;
        self.texts.push([route.id.clone(), vehicle_type.to_owned(), lane, position, speed]);
    }

    fn depart(
        &mut self,
        vehicle: Vehicle<'_>,
        route: &TileRoute,
        vehicle_type: &str,
        start: [&str; 3],
    ) {
        let [lane, pos, speed] = start.map(str::to_owned);
        self.rows.push((Kind::Add, vehicle.index, [0.0; 4]));
        self.texts.push([route.id.clone(), vehicle_type.to_owned(), lane, pos, speed]);
    }

    fn walk(
        &mut self,
        person: Vehicle<'_>,
        route: &TileRoute,
        person_type: &str,
        [pos, arrival]: [f64; 2],
    ) {
        self.rows.push((Kind::Walk, person.index, [pos, arrival, 0.0, 0.0]));
        self.walks.push((person_type.to_owned(), route.edges.clone()));
    }

    fn remove_person(&mut self, person: Vehicle<'_>) {
        self.rows.push((Kind::RemovePerson, person.index, [0.0; 4]));
    }

    fn set_walking_speed(&mut self, person: Vehicle<'_>, speed: f64) {
        self.rows.push((Kind::WalkingSpeed, person.index, [speed, 0.0, 0.0, 0.0]));
    }

    fn remove(&mut self, vehicle: Vehicle<'_>) {
        self.rows.push((Kind::Remove, vehicle.index, [0.0; 4]));
    }

    fn set_speed(&mut self, vehicle: Vehicle<'_>, speed: f64) {
        self.rows.push((Kind::Speed, vehicle.index, [speed, 0.0, 0.0, 0.0]));
    }

    fn set_speed_mode(&mut self, vehicle: Vehicle<'_>, mode: i32) {
        self.rows.push((Kind::SpeedMode, vehicle.index, [f64::from(mode), 0.0, 0.0, 0.0]));
    }

    fn set_lane_change_mode(&mut self, vehicle: Vehicle<'_>, mode: i32) {
        self.rows.push((Kind::LaneChangeMode, vehicle.index, [f64::from(mode), 0.0, 0.0, 0.0]));
    }

    fn move_to(&mut self, vehicle: Vehicle<'_>, x: f64, y: f64, angle: f64, keep_route: u8) {
        self.rows.push((Kind::Move, vehicle.index, [x, y, angle, f64::from(keep_route)]));
    }
}
