//! Files of a scenario and their locations: `scenarios/<name>.xml` with its schema, and in
//! `sumo_nets/<name>/` the net with its sources and the files with which SUMO alone shows it.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::super::reference;
use super::super::{
    AgentRange, Border, Net, ObservationGroups, PlaceDeparture, Route, SCHEMA, Scenario, SpawnRow,
    Steering,
};
use super::Error;
use crate::markup::Writer;
use crate::record::write_atomic;
use crate::sumo::net::Path as LanePath;

/// Settings of a new scenario, to which the parts that depend on the site are added. The detection
/// range is longer than the braking distance from any speed that a template allows.
const DEFAULTS: &str = r#"
<scenario name="new">
    <description/>
    <agents min="1" max="1" default="1"/>
    <routes><route id="r" edges="e" arrivalPos="0"/></routes>
    <nets><net file="n"><spawn route="r" first="0" spacing="1" count="1"/></net></nets>
    <vehicle length="4.515" width="1.852" maxSpeed="1"/>
    <jitter longitudinal="1" lateral="0.25"/>
    <control mode="throttle" interval="0.1" accel="2.909" drag="0.364" brake="0.3:8.2 0.5:10.2 1:14.7"/>
    <observation groups="conflict" detectionRange="100" neighbours="4" intention="hidden" conflictStreams="1" streamVehicles="1"/>
    <reward progress="1" speed="0.1" arrive="10" outOfRoad="-10" crash="-10" cooperation="0.06"/>
    <termination horizon="500" wreckTime="2.5"/>
    <communication range="50"/>
</scenario>"#;
/// Largest number of crossing or merging streams in the observation, which is the limit of the
/// scenario format.
const STREAMS: usize = 16;
/// Approximate speed at which vehicles that steer take narrow curves \[m/s\].
const CURVES: f64 = 5.0;
/// Time for which vehicles may have to wait for signals \[s\]: the cycle of netconvert's programs.
const CYCLE: f64 = 90.0;
/// Largest number of other agents that an agent can hear, and the number of agents from which on
/// that limit makes decisions and updates faster.
const HEARD: (usize, u32) = (8, 65);
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
        inputs: &[(&'static str, String)],
        options: &[(&'static str, &str)],
    ) -> Result<(), Error> {
        let mut xml = Writer::new();
        xml.comment(
            "How SUMO's netconvert makes the net from its sources; `iwol scenario build` runs it.",
        );
        xml.open("configuration").open("input");
        for &(option, ref file) in inputs {
            xml.open(option).attribute("value", file).close();
        }
        xml.close().open("output").open("output-file");
        xml.attribute("value", format!("{}.net.xml", self.name)).close();
        xml.open("precision").attribute("value", 3).close().close().open("processing");
        for &(option, value) in options {
            xml.open(option).attribute("value", value).close();
        }
        xml.close().open("report").open("xml-validation").attribute("value", "never");
        Ok(write_atomic(&self.file("netccfg"), xml.finish().as_bytes())?)
    }

    /// Writes the scenario with comments, its schema, and the files that `sumo -c` reads.
    pub(super) fn write(&self, scenario: &Scenario) -> Result<(), Error> {
        let scenario = self.write_scenario(scenario)?;
        write_atomic(&self.file("sumocfg"), self.configuration(&scenario).as_bytes())?;
        scenario.nets.iter().try_for_each(|net| show_traffic(&scenario, net))
    }

    /// Writes the scenario with comments and its schema; returns the scenario as it is read back,
    /// which applies the checks of every scenario to the new one.
    pub(super) fn write_scenario(&self, scenario: &Scenario) -> Result<Scenario, Error> {
        write_atomic(&self.scenario.with_file_name("scenario.xsd"), SCHEMA.as_bytes())?;
        write_atomic(&self.scenario, commented(&scenario.to_xml()).as_bytes())?;
        Ok(Scenario::load(&self.scenario)?)
    }

    /// Returns the configuration for `sumo -c`: the net, the vehicles and, if they exist,
    /// additional files.
    fn configuration(&self, scenario: &Scenario) -> String {
        let name = &self.name;
        let mut xml = Writer::new();
        xml.comment(&format!("sumo-gui -c {name}.sumocfg shows the net with SUMO's own drivers."));
        xml.open("configuration").open("input");
        xml.open("net-file").attribute("value", format!("{name}.net.xml")).close();
        xml.open("route-files").attribute("value", format!("{name}.rou.xml")).close();
        if self.file("add.xml").exists() {
            xml.open("additional-files").attribute("value", format!("{name}.add.xml")).close();
        }
        xml.close().open("time").open("step-length");
        xml.attribute("value", scenario.control.interval).close().close();
        xml.open("report").open("xml-validation").attribute("value", "never");
        xml.finish()
    }

    /// Returns a scenario on the net of `site`, with the usual settings.
    pub(super) fn scenario(&self, site: Site) -> Result<Scenario, Error> {
        let Site { description, routes, paths, rows, agents, speed, steers, has_signals } = site;
        let longest = paths.iter().map(LanePath::length).fold(0.0, f64::max);
        // An agent should observe all vehicles that its path may conflict with. Vehicles that begin
        // on the same lane, one behind the other, do not count.
        let meets = |one: &LanePath| {
            paths.iter().filter(|other| one.lanes[0] != other.lanes[0] && meet(one, other)).count()
        };
        let most = paths.iter().map(meets).max().unwrap_or(0);
        let streams = most.clamp(1, STREAMS);
        let spawn = |Row { routes, first, spacing, count }| SpawnRow {
            routes: Arc::from(routes),
            first,
            spacing,
            count,
            departure: PlaceDeparture::default(),
        };
        let spawns: Vec<SpawnRow> = rows.into_iter().map(spawn).collect();
        let longest_row = spawns.iter().map(|row| row.count).max().unwrap_or(1);
        let places: u32 = spawns.iter().map(|row| row.count).sum();
        let mut scenario = Scenario::parse(DEFAULTS, &self.scenario)?;
        let pace = if steers == Steers::No { speed } else { speed.min(CURVES) };
        let horizon =
            (PATIENCE * longest / (pace * scenario.control.interval) / 100.0).ceil() * 100.0;
        scenario.name.clone_from(&self.name);
        scenario.description = description;
        scenario.agents = AgentRange {
            min: agents.min(places).min(2),
            max: places,
            default: agents.min(places),
            ..AgentRange::default()
        };
        scenario.nets = vec![Net { file: self.net.clone(), spawns }];
        scenario.routes = routes;
        scenario.vehicle.max_speed = speed;
        scenario.communication.nearest = if places < HEARD.1 { 0 } else { HEARD.0 };
        if most > STREAMS {
            scenario.observation.groups = ObservationGroups::Both;
        }
        scenario.observation.conflict_streams = streams;
        scenario.observation.stream_vehicles = longest_row.min(3) as usize;
        if has_signals {
            // Agents discount what comes after a long wait: the penalty of a crash alone would not
            // keep them from passing red.
            scenario.reward.red_light = 10.0 * scenario.reward.crash;
        }
        let red = if has_signals { CYCLE / scenario.control.interval } else { 0.0 };
        scenario.termination.horizon = (horizon.max(500.0) + red).min(1e6) as u32;
        if steers != Steers::No {
            steer(&mut scenario);
        }
        if steers == Steers::Lot {
            reverse(&mut scenario);
        }
        Ok(scenario)
    }
}

/// Changes a scenario for vehicles that steer, as in `scenarios/intersection_turns.xml`. The kerb
/// as border leaves room for the outer wheels in narrow curves.
fn steer(scenario: &mut Scenario) {
    // A vehicle that steers has a task even without other vehicles.
    scenario.agents.min = 1;
    scenario.control.steering = Some(Steering::default());
    let observation = &mut scenario.observation;
    observation.groups = ObservationGroups::Nearest;
    (observation.conflict_streams, observation.stream_vehicles) = (0, 0);
    (observation.encounters, observation.foresight) = (6, 4.0);
    // Vehicles that steer have a high discount, at which blocking others costs the blocker little.
    scenario.reward.cooperation = 0.25;
    // Vehicles know on which of several lanes they are, and are paid for staying on it.
    (observation.borders, scenario.reward.lane_keeping) = (4.0, 1.0);
    scenario.termination.border = Border::Kerb;
}

/// Changes a scenario for vehicles that steer and can reverse, as in `scenarios/parking_lot.xml`.
fn reverse(scenario: &mut Scenario) {
    scenario.control.brake = vec![(1.0, scenario.control.accel)];
    scenario.control.steering = Some(Steering { reverse: true, ..Steering::default() });
    scenario.observation.borders = 0.0;
    (scenario.reward.arrive, scenario.reward.lane_keeping) = (100.0, 0.0);
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
    /// Whether signals rule routes.
    pub(super) has_signals: bool,
}

/// A row of spawn places on a lane.
pub(super) struct Row {
    /// Indices of the routes that begin on the lane.
    pub(super) routes: Vec<usize>,
    /// Position of the first place \[m\].
    pub(super) first: f64,
    /// Distance between places \[m\].
    pub(super) spacing: f64,
    pub(super) count: u32,
}

/// Returns a scenario's XML with the schema's explanations as comments before each part.
fn commented(xml: &str) -> String {
    let mut text = String::new();
    for line in xml.lines() {
        let name = line.strip_prefix("    <").filter(|rest| rest.starts_with(char::is_alphabetic));
        let name = name.and_then(|rest| rest.split(|c: char| !c.is_alphanumeric()).next());
        if let Some(comment) = name.and_then(reference::comment) {
            text += "\n    <!-- ";
            text += &comment.replace("--", "-");
            text += " -->\n";
        }
        text.push_str(line);
        text.push('\n');
    }
    text
}

/// Returns the path of a file that has a net's name and another ending.
pub(super) fn beside(net: &Path, ending: &str) -> PathBuf {
    let name = net.file_name().unwrap_or_default().to_string_lossy();
    net.with_file_name(format!("{}.{ending}", name.strip_suffix(".net.xml").unwrap_or(&name)))
}

/// Comment of the route files that this program writes.
const FOR_SUMO_ALONE: &str =
    "The places and routes of the scenario, for SUMO alone: `iwol` does not read this file.";

/// Writes the vehicles that SUMO shows without this program, if there is a `.sumocfg` beside the
/// net. A route file that this program has not written stays as it is.
pub(super) fn show_traffic(scenario: &Scenario, net: &Net) -> Result<(), Error> {
    let (config, routes) = (beside(&net.file, "sumocfg"), beside(&net.file, "rou.xml"));
    let is_foreign = || match fs::read(&routes) {
        Ok(bytes) => !String::from_utf8_lossy(&bytes).contains(FOR_SUMO_ALONE),
        Err(error) => error.kind() != std::io::ErrorKind::NotFound,
    };
    if !config.exists() || is_foreign() {
        return Ok(());
    }
    Ok(write_atomic(&routes, traffic(scenario, net).as_bytes())?)
}

/// Returns a route file for SUMO without this program: one vehicle at each spawn place, on one of
/// the place's routes.
fn traffic(scenario: &Scenario, net: &Net) -> String {
    let (v, c) = (scenario.vehicle, &scenario.control);
    let mut xml = Writer::new();
    xml.comment(FOR_SUMO_ALONE);
    xml.open("routes").open("vType").attribute("id", "agent").attribute("length", v.length);
    xml.attribute("width", v.width).attribute("maxSpeed", v.max_speed).attribute("accel", c.accel);
    let decel = c.brake.last().map_or(c.accel, |point| point.1).min(4.5);
    xml.attribute("decel", decel).attribute("minGap", 1).close();
    for route in &scenario.routes {
        xml.open("route").attribute("id", &route.id);
        xml.attribute("edges", route.edges.join(" ")).close();
    }
    for (number, place) in net.places().enumerate() {
        let route = &scenario.routes[place.routes[number % place.routes.len()]];
        let lane = route.lane.map_or_else(|| "best".to_owned(), |lane| lane.to_string());
        xml.open("vehicle").attribute("id", number).attribute("type", "agent");
        xml.attribute("route", &route.id).attribute("depart", 0);
        // SUMO's positions are positions of the front bumper.
        xml.attribute("departPos", place.pos + v.length / 2.0)
            .attribute("departLane", lane)
            .close();
    }
    xml.finish()
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
