//! Files of a scenario and their locations: `scenarios/<name>.xml` with its schema, and in
//! `sumo_nets/<name>/` the net with its sources and the files with which SUMO alone shows it.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::super::write::escape;
use super::super::{
    AgentRange, Border, Communication, Control, Intention, Jitter, Lidar, NeighbourOrder, Net,
    Observation, ObservationGroups, Reward, Route, SCHEMA, Scenario, SpawnRow, Steering,
    Termination, Traffic, Vehicle, schema,
};
use super::{Error, SPACING, netconvert};
use crate::record::write_atomic;
use crate::sumo::net::Path as LanePath;

/// Detection range \[m\], longer than the braking distance from any speed that a template allows.
const DETECTION: f64 = 100.0;
/// Communication range \[m\].
const RADIO: f64 = 50.0;
/// Largest number of crossing or merging streams in the observation, which is the limit of the
/// scenario format.
const STREAMS: usize = 16;
/// Approximate speed at which vehicles that steer take narrow curves \[m/s\].
const CURVES: f64 = 5.0;
/// Ratio of the horizon to the steps that the longest route takes without waiting.
const PATIENCE: f64 = 8.0;

/// Paths of the files of a new scenario.
pub(super) struct Layout {
    pub(super) scenario: PathBuf,
    pub(super) folder: PathBuf,
    pub(super) net: PathBuf,
    name: String,
}

impl Layout {
    /// Returns the paths below the folder `root`.
    ///
    /// # Errors
    /// [`Error::Name`] if the name is not valid, [`Error::Exists`] if a file or folder is already
    /// there.
    pub(super) fn new(root: &Path, name: &str) -> Result<Self, Error> {
        if !Scenario::is_name(name) {
            return Err(Error::Name { name: name.into() });
        }
        // A leading `.` would appear in every path of a message.
        let root = root.strip_prefix(".").unwrap_or(root);
        let scenario = root.join("scenarios").join(format!("{name}.xml"));
        let folder = root.join("sumo_nets").join(name);
        if let Some(path) = [&scenario, &folder].into_iter().find(|path| path.exists()) {
            return Err(Error::Exists { path: path.clone() });
        }
        let net = root
            .join("scenarios")
            .join("..")
            .join("sumo_nets")
            .join(name)
            .join(format!("{name}.net.xml"));
        Ok(Self { scenario, folder, net, name: name.into() })
    }

    /// Creates the folders and runs `make`. If `make` fails, the scenario file and the net's folder
    /// are removed.
    pub(super) fn fill<T>(&self, make: impl FnOnce() -> Result<T, Error>) -> Result<T, Error> {
        for folder in [self.scenario.parent(), Some(&self.folder)].into_iter().flatten() {
            fs::create_dir_all(folder)
                .map_err(|source| Error::Write { path: folder.into(), source })?;
        }
        make().inspect_err(|_| {
            // [`Layout::new`] has made sure that neither existed before.
            let _ = fs::remove_dir_all(&self.folder);
            let _ = fs::remove_file(&self.scenario);
        })
    }

    /// Returns the path of a file in the net's folder that has the scenario's name.
    pub(super) fn file(&self, ending: &str) -> PathBuf {
        self.folder.join(format!("{}.{ending}", self.name))
    }

    /// Writes netconvert's configuration from inputs, as `(option, file name)`, and further
    /// options.
    pub(super) fn configure(
        &self,
        inputs: &[(&str, String)],
        options: &[(&str, &str)],
    ) -> Result<(), Error> {
        let mut text = String::from(
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n\
             <!-- How SUMO's netconvert makes the net of its sources; `iwol scenario build` runs it. -->\n\
             <configuration>\n    <input>\n",
        );
        for (option, file) in inputs {
            let _ = writeln!(text, "        <{option} value=\"{}\"/>", escape(file));
        }
        let _ = writeln!(
            text,
            "    </input>\n    <output>\n        <output-file value=\"{}.net.xml\"/>",
            self.name
        );
        let _ = writeln!(text, "        <precision value=\"3\"/>\n    </output>\n    <processing>");
        for (option, value) in options {
            let _ = writeln!(text, "        <{option} value=\"{value}\"/>");
        }
        let _ = writeln!(
            text,
            "    </processing>\n    <report>\n        <xml-validation value=\"never\"/>\n    </report>"
        );
        text.push_str("</configuration>\n");
        Ok(write_atomic(&self.file("netccfg"), text.as_bytes())?)
    }

    /// Writes the scenario with comments, its schema, and the files that `sumo -c` reads.
    pub(super) fn write(&self, scenario: &Scenario) -> Result<(), Error> {
        write_atomic(&self.scenario.with_file_name("scenario.xsd"), SCHEMA.as_bytes())?;
        write_atomic(&self.scenario, commented(&scenario.to_xml()).as_bytes())?;
        // Reading the file back applies the checks of every scenario to the new one.
        let scenario = Scenario::load(&self.scenario)?;
        write_atomic(&self.file("sumocfg"), self.configuration(&scenario).as_bytes())?;
        scenario.nets.iter().try_for_each(|net| show_traffic(&scenario, net))
    }

    /// Returns the configuration for `sumo -c`: the net, the vehicles and, if they exist,
    /// additional files.
    fn configuration(&self, scenario: &Scenario) -> String {
        let name = &self.name;
        let additional = if self.file("add.xml").exists() {
            format!("        <additional-files value=\"{name}.add.xml\"/>\n")
        } else {
            String::new()
        };
        format!(
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<!-- sumo-gui -c {name}.sumocfg shows the net with SUMO's own drivers. -->\n\
             <configuration>\n    <input>\n        <net-file value=\"{name}.net.xml\"/>\n        <route-files value=\"{name}.rou.xml\"/>\n{additional}    </input>\n\
             \x20   <time>\n        <step-length value=\"{}\"/>\n    </time>\n    <report>\n        <xml-validation value=\"never\"/>\n    </report>\n</configuration>\n",
            scenario.control.interval
        )
    }

    /// Returns a scenario on the net of `site`, with the usual settings.
    pub(super) fn scenario(&self, site: Site) -> Scenario {
        let Site { description, routes, paths, rows, agents, speed, steers } = site;
        let longest = paths.iter().map(LanePath::length).fold(0.0, f64::max);
        // An agent should observe all vehicles that its path may conflict with. Vehicles that begin
        // on the same lane, one behind the other, do not count.
        let meets = |one: &LanePath| {
            paths.iter().filter(|other| one.lanes[0] != other.lanes[0] && meet(one, other)).count()
        };
        let streams = paths.iter().map(meets).max().unwrap_or(0).clamp(1, STREAMS);
        let spawn = |Row { routes, first, count }| SpawnRow {
            routes: Arc::from(routes),
            first,
            spacing: SPACING,
            count,
        };
        let spawns: Vec<SpawnRow> = rows.into_iter().map(spawn).collect();
        let longest_row = spawns.iter().map(|row| row.count).max().unwrap_or(1);
        let places: u32 = spawns.iter().map(|row| row.count).sum();
        let interval = 0.1;
        let pace = if steers == Steers::No { speed } else { speed.min(CURVES) };
        let horizon = (PATIENCE * longest / (pace * interval) / 100.0).ceil() * 100.0;
        let scenario = Scenario {
            name: self.name.clone(),
            path: self.scenario.clone(),
            description,
            agents: AgentRange {
                min: agents.min(places).min(2),
                max: places,
                default: agents.min(places),
            },
            nets: vec![Net { file: self.net.clone(), spawns }],
            routes,
            vehicle: Vehicle { length: 4.515, width: 1.852, max_speed: speed },
            jitter: Jitter { longitudinal: 1.0, lateral: 0.25 },
            control: Control {
                interval,
                accel: 2.909,
                drag: 0.364,
                brake: vec![(0.3, 8.2), (0.5, 10.2), (1.0, 14.7)],
                steering: None,
                initial_throttle: Control::INITIAL_THROTTLE,
            },
            observation: Observation {
                groups: ObservationGroups::Conflict,
                detection_range: DETECTION,
                neighbours: 4,
                neighbour_order: NeighbourOrder::default(),
                intention: Intention::Hidden,
                signal_distance: Observation::SIGNAL_DISTANCE,
                conflict_streams: streams,
                stream_vehicles: longest_row.min(3) as usize,
                encounters: 0,
                foresight: 0.0,
                priority_distance: 0.0,
                borders: 0.0,
                lidar: Lidar::default(),
            },
            reward: Reward {
                progress: 1.0,
                speed: 0.1,
                arrive: 10.0,
                out_of_road: -10.0,
                crash: -10.0,
                cooperation: 0.06,
                share_range: f64::INFINITY,
            },
            termination: Termination {
                horizon: horizon.clamp(500.0, 1e6) as u32,
                wreck_time: 2.5,
                border: Border::Line,
                broken_lines: Vec::new(),
            },
            communication: Communication { range: RADIO },
            traffic: Traffic::default(),
        };
        match steers {
            Steers::No => scenario,
            Steers::Road => on_road(scenario),
            Steers::Lot => on_lot(scenario),
        }
    }
}

/// Returns the scenario for vehicles that steer, as in `scenarios/intersection_turns.xml`. The kerb
/// as border leaves room for the outer wheels in narrow curves.
fn on_road(scenario: Scenario) -> Scenario {
    Scenario {
        // A vehicle that steers has a task even without other vehicles.
        agents: AgentRange { min: 1, ..scenario.agents },
        control: Control { steering: Some(Steering::default()), ..scenario.control },
        observation: Observation {
            groups: ObservationGroups::Nearest,
            conflict_streams: 0,
            stream_vehicles: 0,
            encounters: 6,
            foresight: 4.0,
            ..scenario.observation
        },
        termination: Termination { border: Border::Kerb, ..scenario.termination },
        ..scenario
    }
}

/// Returns the scenario for vehicles that steer and can reverse, as in `scenarios/parking_lot.xml`.
fn on_lot(scenario: Scenario) -> Scenario {
    let scenario = on_road(scenario);
    let (accel, steering) = (scenario.control.accel, scenario.control.steering);
    let steering = steering.map(|steering| Steering { reverse: true, ..steering });
    Scenario {
        control: Control { brake: vec![(1.0, accel)], steering, ..scenario.control },
        observation: Observation { foresight: 0.0, ..scenario.observation },
        reward: Reward { arrive: 100.0, cooperation: 0.17, ..scenario.reward },
        ..scenario
    }
}

/// Whether and how vehicles steer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Steers {
    /// Vehicles do not steer but follow their lanes.
    No,
    /// Vehicles steer and drive forwards only.
    Road,
    /// Vehicles steer and can reverse.
    Lot,
}

/// The parts of a scenario that differ between sites.
pub(super) struct Site {
    pub(super) description: String,
    pub(super) routes: Vec<Route>,
    /// Paths of the routes, in the order of the routes.
    pub(super) paths: Vec<LanePath>,
    pub(super) rows: Vec<Row>,
    pub(super) agents: u32,
    /// Top speed \[m/s\].
    pub(super) speed: f64,
    pub(super) steers: Steers,
}

/// A row of spawn places on a lane.
pub(super) struct Row {
    /// Indices of the routes that begin on the lane.
    pub(super) routes: Vec<usize>,
    /// Position of the first place \[m\].
    pub(super) first: f64,
    pub(super) count: u32,
}

/// Returns a scenario's XML with the schema's explanations as comments before each part.
fn commented(xml: &str) -> String {
    let mut text = String::new();
    for line in xml.lines() {
        let name = line.strip_prefix("    <").filter(|rest| rest.starts_with(char::is_alphabetic));
        let name = name.and_then(|rest| rest.split(|c: char| !c.is_alphanumeric()).next());
        if let Some(lines) = name.and_then(schema::comment) {
            let _ =
                writeln!(text, "\n    <!-- {} -->", lines.join("\n         ").replace("--", "-"));
        }
        text.push_str(line);
        text.push('\n');
    }
    text
}

/// Writes the vehicles that SUMO shows without this program, if there is a `.sumocfg` beside the
/// net.
pub(super) fn show_traffic(scenario: &Scenario, net: &Net) -> Result<(), Error> {
    let config = netconvert::beside(&net.file, "sumocfg");
    if !config.exists() {
        return Ok(());
    }
    Ok(write_atomic(&netconvert::beside(&net.file, "rou.xml"), traffic(scenario, net).as_bytes())?)
}

/// Returns a route file for SUMO without this program: one vehicle at each spawn place, on one of
/// the place's routes.
fn traffic(scenario: &Scenario, net: &Net) -> String {
    let (v, c) = (scenario.vehicle, &scenario.control);
    let mut text = String::from(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<!-- The places and routes of the scenario, for SUMO alone: `iwol` does not read this file. -->\n<routes>\n",
    );
    let decel = c.brake.last().map_or(c.accel, |point| point.1).min(4.5);
    let _ = writeln!(
        text,
        "    <vType id=\"agent\" length=\"{}\" width=\"{}\" maxSpeed=\"{}\" accel=\"{}\" decel=\"{decel}\" minGap=\"1\"/>",
        v.length, v.width, v.max_speed, c.accel
    );
    for route in &scenario.routes {
        let _ = writeln!(
            text,
            "    <route id=\"{}\" edges=\"{}\"/>",
            escape(&route.id),
            escape(&route.edges.join(" "))
        );
    }
    for (number, place) in net.places().enumerate() {
        let route = &scenario.routes[place.routes[number % place.routes.len()]];
        let lane = route.lane.map_or_else(|| "best".to_owned(), |lane| lane.to_string());
        // SUMO's positions are positions of the front bumper.
        let front = place.pos + v.length / 2.0;
        let _ = writeln!(
            text,
            "    <vehicle id=\"{number}\" type=\"agent\" route=\"{}\" depart=\"0\" departPos=\"{front}\" departLane=\"{lane}\"/>",
            escape(&route.id)
        );
    }
    text + "</routes>\n"
}

/// Returns whether two paths merge or cross.
pub(super) fn meet(one: &LanePath, other: &LanePath) -> bool {
    let side = |a: [f64; 2], b: [f64; 2], p: [f64; 2]| {
        (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])
    };
    let apart =
        |a: [f64; 2], b: [f64; 2], c: [f64; 2], d: [f64; 2]| side(a, b, c) * side(a, b, d) >= 0.0;
    let cross = |a: &[[f64; 2]], b: &[[f64; 2]]| {
        !apart(a[0], a[1], b[0], b[1]) && !apart(b[0], b[1], a[0], a[1])
    };
    one.lanes.iter().any(|lane| other.lanes.contains(lane))
        || one.points.windows(2).any(|a| other.points.windows(2).any(|b| cross(a, b)))
}
