//! Makes a scenario from a configuration of SUMO (`.sumocfg`): its net, its demand, and the time
//! that it simulates.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use roxmltree::Node;

use super::super::demand::{self, seconds};
use super::super::reader::{Reader, document, text};
use super::super::{
    AgentRange, Demand, DemandPlan, Error as ScenarioError, FileTime, Jitter, LaneChange,
    ObservationGroups, Scenario, Traffic,
};
use super::files::{Layout, Site, Steers};
use super::import::{SPEED, in_utf8};
use super::{Error, Imported};
use crate::record::write_atomic;
use crate::sumo::net::{CARS, Net, Path as LanePath, with_programs};
use crate::words::counted;

/// Options that are taken, with the other names that SUMO has for them.
const OPTIONS: [&[&str]; 6] = [
    &["net-file", "net", "n"],
    &["route-files", "routes", "r"],
    &["additional-files", "additional", "a"],
    &["begin", "b"],
    &["end", "e"],
    &["step-length"],
];
/// Parts of a configuration that do not change the traffic, and the one of them with the files that
/// SUMO writes.
const SILENT: [&str; 3] = [OUTPUT, "report", "gui_only"];
const OUTPUT: &str = "output";
/// Share of agents.
const PENETRATION: f64 = 0.2;
/// Longest step of the configuration that the scenario takes over, and the step otherwise \[s\]:
/// vehicles that cross must not pass through each other between two steps.
const LONGEST_STEP: f64 = 0.2;
const STEP: f64 = 0.1;
/// Duration of an episode \[s\], unless trips take longer.
const EPISODE: f64 = 300.0;
/// Ratio of the time that a vehicle is assumed to need for its route to that at the speed limits,
/// and the time that it waits besides \[s\].
const PATIENCE: f64 = 4.0;
const WAITING: f64 = 60.0;
/// Streams and vehicles of each that agents observe, in crossings of several lanes.
const STREAMS: usize = 6;
/// Elements of additional files that change no traffic, and programs of signals, which are taken.
const STILL: [&str; 17] = [
    "tlLogic",
    "e1Detector",
    "inductionLoop",
    "e2Detector",
    "laneAreaDetector",
    "e3Detector",
    "entryExitDetector",
    "instantInductionLoop",
    "edgeData",
    "laneData",
    "vTypeProbe",
    "timedEvent",
    "poi",
    "poly",
    "polygon",
    "location",
    "param",
];
/// Largest number of names in a note.
const NAMED: usize = 6;

/// What a configuration says.
struct Configuration {
    path: PathBuf,
    net: PathBuf,
    /// Route files and additional files in the order in which SUMO reads them.
    files: Vec<PathBuf>,
    begin: f64,
    end: Option<f64>,
    step: Option<f64>,
    /// Options that are not taken and may change the traffic.
    others: Vec<String>,
    /// Options for files that SUMO writes.
    outputs: Vec<String>,
}

/// Makes a scenario `name` of a configuration of SUMO, below the folder `root`. A share of the
/// cars of its demand are agents; `agents` is their largest number on the road at a time, by default
/// as many as the demand needs.
///
/// # Errors
/// [`Error`]; no file is left behind in this case.
pub fn import_configuration(
    root: &Path,
    name: &str,
    configuration: &Path,
    agents: Option<u32>,
) -> Result<Imported, Error> {
    let layout = Layout::new(root, name)?;
    layout.fill(|| {
        let configuration = Configuration::read(configuration)?;
        let mut notes = Vec::new();
        if !configuration.others.is_empty() {
            let others = configuration.others.join(", ");
            notes.push(format!("options without effect here: {others}"));
        }
        if !configuration.outputs.is_empty() {
            let outputs = list(&configuration.outputs);
            notes.push(format!("files that are not written: {outputs}; iwol evaluate --out and --record write results"));
        }
        let files = copies(&configuration.files, &layout, &mut notes)?;
        let scenario = draft(&configuration, &files, &layout, agents, &mut notes)?;
        layout.write_scenario(&scenario)?;
        let scenario = layout.scenario.clone();
        Ok(Imported { scenario, candidates: Vec::new(), warnings: Vec::new(), notes })
    })
}

impl Configuration {
    fn read(path: &Path) -> Result<Self, Error> {
        let text = text(path).map_err(of_file)?;
        let document = document(&text, path)?;
        let reader = Reader::new(path, &document);
        let root = document.root_element();
        let options = root.descendants().filter(|node| node.is_element() && *node != root);
        let options: Vec<Node> = options.filter(|node| value_of(node).is_some()).collect();
        let option = |names: &[&str]| {
            let named = |node: &&Node| names.contains(&node.tag_name().name());
            options.iter().find(named).copied()
        };
        let folder = path.parent().unwrap_or(Path::new(""));
        let files = |names| -> Vec<PathBuf> {
            let value = option(names).and_then(|node| value_of(&node)).unwrap_or_default();
            let parts = value.split(',').map(str::trim).filter(|part| !part.is_empty());
            parts.map(|part| folder.join(part)).collect()
        };
        let time = |names, allowed: &str| match option(names) {
            None => Ok(None),
            Some(node) => {
                let value = value_of(&node).unwrap_or_default();
                // A negative end stands for none.
                let none = value.trim() == "-1";
                let found = seconds(value);
                if found.is_none() && !none {
                    return Err(reader.value(node, "value", allowed));
                }
                Ok(found)
            }
        };
        let clock = "seconds of at least 0, or h:m:s";
        let (begin, end) = (time(OPTIONS[3], clock)?.unwrap_or(0.0), time(OPTIONS[4], clock)?);
        if let (Some(node), true) = (option(OPTIONS[4]), end.is_some_and(|end| end <= begin)) {
            let allowed = format!("a time after the begin, {begin} s");
            return Err(reader.value(node, "value", allowed).into());
        }
        let taken = |name: &str| OPTIONS.iter().any(|names| names.contains(&name));
        let is_in = |node: &Node, parts: &[&str]| {
            node.parent().is_some_and(|parent| parts.contains(&parent.tag_name().name()))
        };
        let name = |node: &Node| node.tag_name().name().to_owned();
        let outputs = options.iter().filter(|node| is_in(node, &[OUTPUT])).map(name);
        let others = options.iter().filter(|node| !is_in(node, &SILENT)).map(name);
        let net = files(OPTIONS[0]).into_iter().next();
        let missing = || {
            let error = reader.missing(root, "element", OPTIONS[0][0]);
            error.hinted("--sumocfg takes a configuration of `sumo` or `sumo-gui`")
        };
        Ok(Self {
            path: path.to_owned(),
            net: net.ok_or_else(missing)?,
            files: [files(OPTIONS[2]), files(OPTIONS[1])].concat(),
            begin,
            end,
            step: time(OPTIONS[5], "seconds above 0")?.filter(|step| *step > 0.0),
            others: others.filter(|name| !taken(name)).collect(),
            outputs: outputs.collect(),
        })
    }
}

/// Returns the value of an option in one of the three forms that SUMO reads: `value="…"`, `v="…"`, or
/// the text of the element.
fn value_of<'a>(node: &Node<'a, '_>) -> Option<&'a str> {
    let text = || node.text().map(str::trim).filter(|text| !text.is_empty());
    node.attribute("value").or_else(|| node.attribute("v")).or_else(text)
}

/// Returns the error without the hint that it gives about files of scenarios.
fn of_file(error: ScenarioError) -> Error {
    match error {
        ScenarioError::Read { path, source } => Error::Read { path, source },
        error => error.into(),
    }
}

/// The copies of a configuration's files, and the programs of signals that were in them.
struct Copies {
    files: Vec<PathBuf>,
    /// The files with demand of which they are copies.
    originals: Vec<PathBuf>,
    /// Elements `<tlLogic>` with their ids.
    programs: Vec<(String, String)>,
}

/// Copies the files with demand into the folder of the net, without the programs of signals, which
/// become part of the net.
fn copies(files: &[PathBuf], layout: &Layout, notes: &mut Vec<String>) -> Result<Copies, Error> {
    let mut copies = Copies { files: Vec::new(), originals: Vec::new(), programs: Vec::new() };
    for (number, path) in files.iter().enumerate() {
        let text = demand::text(path).map_err(of_file)?;
        let document = document(&text, path)?;
        let elements = document.root_element().children().filter(Node::is_element);
        let programs = elements.clone().filter(|node| node.has_tag_name("tlLogic"));
        let (mut rest, mut end) = (String::new(), 0);
        for (node, id) in programs.filter_map(|node| Some((node, node.attribute("id")?))) {
            copies.programs.push((id.to_owned(), text[node.range()].to_owned()));
            rest += &text[end..node.range().start];
            end = node.range().end;
        }
        rest += &text[end..];
        let file = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let names = || elements.clone().map(|node| node.tag_name().name());
        if !names().any(demand::is_taken) {
            notes.extend(without_demand(&file, names(), end > 0));
            continue;
        }
        // The scenario lists files by spaces.
        let name = file.replace(char::is_whitespace, "_");
        // What is left of a file without its programs is not compressed.
        let name = match name.strip_suffix(".gz") {
            Some(plain) if end > 0 => plain,
            _ => &name,
        };
        let mut copy = layout.net.with_file_name(name);
        if copies.files.contains(&copy) {
            copy = layout.net.with_file_name(format!("{number}_{name}"));
        }
        if end == 0 {
            fs::copy(path, &copy).map_err(|source| Error::Read { path: path.clone(), source })?;
        } else {
            write_atomic(&copy, in_utf8(&rest).as_bytes())?;
        }
        copies.files.push(copy);
        copies.originals.push(path.clone());
    }
    Ok(copies)
}

/// Returns a note about a file of which no element is taken but programs of signals (`programs`);
/// `None` if it has nothing else that matters. `names` are those of its elements.
fn without_demand<'a>(
    file: &str,
    names: impl Iterator<Item = &'a str>,
    programs: bool,
) -> Option<String> {
    let mut counts = BTreeMap::<&str, usize>::new();
    for name in names.filter(|name| !STILL.contains(name)) {
        *counts.entry(name).or_default() += 1;
    }
    let lost: Vec<String> = counts
        .iter()
        .map(|(name, count)| format!("<{name}> ({})", counted(*count, "time")))
        .collect();
    match () {
        () if !lost.is_empty() => {
            Some(format!("{file} has no effect here, with all that it has: {}", lost.join(", ")))
        }
        () if programs => None,
        () => Some(format!("{file} has no vehicles, types and routes")),
    }
}

/// Returns the scenario of a configuration, whose net it copies.
fn draft(
    configuration: &Configuration,
    copies: &Copies,
    layout: &Layout,
    agents: Option<u32>,
    notes: &mut Vec<String>,
) -> Result<Scenario, Error> {
    let text = Net::text(&configuration.net)?;
    let (text, unknown) = with_programs(&text, &configuration.net, &copies.programs)?;
    if !unknown.is_empty() {
        notes.push(format!("programs of signals that the net does not have: {}", list(&unknown)));
    }
    write_atomic(&layout.net, in_utf8(&text).as_bytes())?;
    let net = Net::parse(&text, &configuration.net)?;
    // Errors name the user's files: nothing of a failed import stays.
    let demand = Demand::load(&copies.originals)?;
    let begin = configuration.begin;
    let span = configuration.end.map_or(f64::INFINITY, |end| end - begin);
    let first = demand.plan(&net, begin, span.min(EPISODE))?;
    let speed = limit(&net, &first).min(SPEED);
    let alone = first.routes.iter().map(|laid| time(&net, &laid.path, speed));
    let longest = alone.fold(0.0, f64::max);
    // An agent counts if this much of the episode is left when it departs.
    let needed = PATIENCE * longest;
    let duration = (2.0 * needed).max(EPISODE).min(span);
    let plan = demand.plan(&net, begin, duration)?;
    if plan.wanted == 0 {
        let why = match demand.first_departure() {
            None => "its files have no vehicles, trips or flows; `iwol scenario import --net` takes a net alone".to_owned(),
            Some(first) => format!(
                "nobody departs from {begin} s to {:.0} s; the first departure is at {first} s: set <begin value=\"{first}\"/> in <time>",
                begin + duration
            ),
        };
        return Err(Error::NoDemand { path: configuration.path.clone(), why });
    }
    if plan.sources.is_empty() {
        let why = plan.warning().map_or_else(String::new, |(why, _)| why);
        return Err(Error::NoDemand { path: configuration.path.clone(), why });
    }
    if duration <= needed {
        notes.push(format!(
            "agents on the longest routes never count in results: the configuration ends after {duration:.0} s, and one counts if it departs more than {needed:.0} s before the end; raise horizon of <termination>"
        ));
    }
    // SUMO's clock has milliseconds.
    let given = configuration.step.map(|step| (1000.0 * step).round() / 1000.0);
    let step = given.filter(|step| (0.001..=LONGEST_STEP).contains(step)).unwrap_or(STEP);
    if configuration.step != Some(step) {
        let given = configuration.step.map_or("SUMO's 1 s".into(), |step| format!("{step} s"));
        notes.push(format!("steps of {step} s instead of {given}, for agents that brake"));
    }
    if duration < span {
        let whole = if span.is_finite() { format!(" of {span:.0} s") } else { String::new() };
        notes.push(format!(
            "episodes last {duration:.0} s{whole}; horizon of <termination> changes it"
        ));
    }
    let site = Site {
        has_signals: plan.routes.iter().any(|laid| !net.signals_on(&laid.path).is_empty()),
        description: "Cars of the demand of an imported configuration of SUMO.".into(),
        routes: Vec::new(),
        paths: Vec::new(),
        rows: Vec::new(),
        agents: 1,
        speed,
        steers: Steers::No,
    };
    let mut scenario = layout.scenario(site)?;
    let most = on_road(&net, &demand, &plan, duration);
    let needed = (1.5 * PENETRATION * f64::from(most)).ceil() as u32;
    let default = agents.unwrap_or(needed.clamp(2, 64));
    let (types, vehicles) = cars(&demand, &plan);
    scenario.agents =
        AgentRange { min: default.min(2), max: 4 * default, default, types, vehicles };
    scenario.traffic = Traffic {
        penetration: PENETRATION,
        files: copies.files.clone(),
        begin: FileTime(begin),
        capacity: most.clamp(16, 1000),
        ..Traffic::default()
    };
    scenario.jitter = Jitter::default();
    scenario.control.interval = step;
    scenario.control.lane_change = LaneChange::Route;
    scenario.termination.horizon = (duration / step).round().clamp(1.0, 1e6) as u32;
    scenario.observation.groups = ObservationGroups::Both;
    scenario.observation.conflict_streams = STREAMS;
    scenario.observation.stream_vehicles = 2;
    scenario.communication.range = scenario.observation.detection_range;
    let agents = counted(default as usize, "agent");
    notes.push(format!(
        "{:.0} % of the cars are agents, at most {agents} at a time; SUMO drives the others, at most {} at a time",
        100.0 * PENETRATION,
        scenario.traffic.capacity
    ));
    Ok(scenario)
}

/// Returns the types of cars that the plan's vehicles have; if all of them are cars, `*` as the
/// vehicles instead.
fn cars(demand: &Demand, plan: &DemandPlan) -> (Vec<String>, Vec<String>) {
    let sources = plan.sources.iter().map(|planned| &demand.sources[planned.source]);
    let kinds = sources.flat_map(|source| &source.types).map(|entry| entry.0);
    let kinds: BTreeSet<usize> = kinds.filter(|&kind| !demand.types[kind].walks).collect();
    let is_car = |kind: &usize| demand.types[*kind].class == CARS;
    let named = |kind: &usize| !demand.types[*kind].id.contains(char::is_whitespace);
    let cars: Vec<usize> = kinds.iter().copied().filter(is_car).filter(named).collect();
    if cars.is_empty() || cars.len() == kinds.len() {
        return (Vec::new(), vec!["*".into()]);
    }
    (cars.into_iter().map(|kind| demand.types[kind].id.clone()).collect(), Vec::new())
}

/// Returns the time of a path at the speed limits, of a vehicle that is not faster than `most`
/// (m/s) \[s\].
fn time(net: &Net, path: &LanePath, most: f64) -> f64 {
    let stretch = |(lane, from, to): (usize, f64, f64)| {
        (to - from) / net.lanes[lane].speed.min(most).max(0.1)
    };
    path.lane_stretches().map(stretch).sum()
}

/// Returns the speed limit of most metres of the routes \[m/s\].
fn limit(net: &Net, plan: &DemandPlan) -> f64 {
    let mut metres = BTreeMap::<u64, f64>::new();
    for (lane, from, to) in plan.routes.iter().flat_map(|laid| laid.path.lane_stretches()) {
        *metres.entry(net.lanes[lane].speed.to_bits()).or_default() += to - from;
    }
    let most = metres.into_iter().max_by(|a, b| a.1.total_cmp(&b.1));
    most.map_or(SPEED, |(speed, _)| f64::from_bits(speed)).max(1.0)
}

/// Returns an estimate of the largest number of vehicles and persons on the road at a time.
fn on_road(net: &Net, demand: &Demand, plan: &DemandPlan, duration: f64) -> u32 {
    let mut changes: Vec<(f64, f64)> = Vec::new();
    for planned in &plan.sources {
        let ways = planned.departures.iter().filter_map(|&(way, weight)| Some((way?, weight)));
        let stay = |way: usize| {
            let departure = &plan.departures[way];
            let stops: f64 = departure.stops.iter().map(|stop| stop.duration).sum();
            PATIENCE * time(net, &plan.routes[departure.route].path, f64::INFINITY)
                + WAITING
                + stops
        };
        let (sum, weights) =
            ways.fold((0.0, 0.0), |(sum, all), (way, w)| (sum + w * stay(way), all + w));
        let stay = sum / weights.max(f64::MIN_POSITIVE);
        let types = &demand.sources[planned.source].types;
        let scale: f64 = types.iter().map(|&(kind, w)| w * demand.types[kind].scale).sum();
        let scale = scale / types.iter().map(|entry| entry.1).sum::<f64>().max(f64::MIN_POSITIVE);
        for time in planned.expected(duration) {
            changes.extend([(time, scale), (time + stay, -scale)]);
        }
    }
    changes.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (most, _) = changes
        .iter()
        .fold((0.0_f64, 0.0), |(most, now), change| (most.max(now + change.1), now + change.1));
    most.ceil() as u32
}

/// Returns the first names as a list for a sentence.
fn list(names: &[String]) -> String {
    let more = if names.len() > NAMED { ", …" } else { "" };
    names.iter().take(NAMED).cloned().collect::<Vec<_>>().join(", ") + more
}
