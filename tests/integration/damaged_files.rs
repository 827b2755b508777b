//! Fuzz tests of damaged files: whatever a net or a scenario contains, its reader ends soon, uses
//! little memory, and returns a valid result or an error that names the file.
//!
//! `IWOL_FUZZ_CASES` sets the number of cases of each test, see [`cases`]. A long run, on one core:
//! `IWOL_FUZZ_CASES=10000000 cargo test --release --test integration damaged_files -- --test-threads=1`.

mod cases;
mod mutate;

use std::{fs, path::Path as FilePath, sync::Arc};

use allocation_counter::measure;
use iwol_sumo::{
    env::{Driver, Task, World},
    rng::{Rng, Seed, below},
    scenario::{
        Demand, Scenario, Severity,
        author::{Sizes, Template, create},
    },
    sumo::{
        Command, Snapshot, VehicleState,
        net::{Net, NetError, Path, tile},
    },
};

use crate::support::{folder, root, shipped};

/// A net with two lanes, a chain of internal lanes, lanes without a width, and a junction without
/// internal lanes.
const NET: &str = r#"<net>
    <location convBoundary="0,0,30,30"/>
    <edge id=":j_0" function="internal"><lane id=":j_0_0" index="0" speed="5" length="5" shape="10,0 15,0"/></edge>
    <edge id=":j_1" function="internal"><lane id=":j_1_0" index="0" speed="5" length="5" shape="15,0 20,10"/></edge>
    <edge id="west_in" from="w" to="j">
        <lane id="a_0" index="0" speed="10" length="10" shape="0,-3.2 10,-3.2"/>
        <lane id="a_1" index="1" speed="10" length="10" width="3.5" shape="0,0,1 10,0,1"/>
    </edge>
    <edge id="east_out" from="j" to="n"><lane id="c_0" index="0" speed="10" length="40" shape="20,10 20,30"/></edge>
    <edge id="north_in" from="n" to="x"><lane id="d_0" index="0" speed="10" length="5" shape="20,30 20,35"/></edge>
    <junction id="j" type="priority" x="15" y="0" shape="10,-5 20,-5 20,5"/>
    <connection from="west_in" to="east_out" fromLane="1" toLane="0" via=":j_0_0"/>
    <connection from=":j_0" to="east_out" fromLane="0" toLane="0" via=":j_1_0"/>
    <connection from=":j_1" to="east_out" fromLane="0" toLane="0"/>
    <connection from="east_out" to="north_in" fromLane="0" toLane="0"/>
    <connection from="north_in" to="west_in" fromLane="0" toLane="1"/>
</net>"#;

/// Heap that a reader may use: bytes per byte of its file, plus a constant \[bytes\].
const HEAP: (u64, u64) = (64, 1 << 20);

/// Longest error message, without the path \[bytes\].
const MESSAGE: usize = 3000;

/// Returns the contents of the XML files in a folder of the project, in the order of their names.
fn files(folder: &str) -> Vec<String> {
    let mut paths: Vec<_> =
        fs::read_dir(root().join(folder)).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| path.extension().is_some_and(|e| e == "xml"));
    paths.sort();
    paths.iter().map(|path| fs::read_to_string(path).unwrap()).collect()
}

/// Runs a reader and checks its memory use.
fn bounded<T>(bytes: usize, read: impl FnOnce() -> T) -> T {
    let mut result = None;
    let heap = measure(|| result = Some(read())).bytes_max;
    assert!(
        heap <= HEAP.0 * bytes as u64 + HEAP.1,
        "{heap} bytes of heap for a file of {bytes} bytes"
    );
    result.unwrap()
}

fn assert_short(error: &dyn std::error::Error, path: &FilePath) {
    let message = error.to_string();
    assert!(message.contains(&*path.to_string_lossy()), "names no file: {message}");
    assert!(message.len() <= MESSAGE, "a message of {} bytes", message.len());
    assert!(!message.chars().any(char::is_control), "{message:?}");
}

fn assert_finite(numbers: &[f64]) {
    assert!(numbers.iter().all(|number| number.is_finite()), "{numbers:?}");
}

/// Returns positions and offsets at which a path is evaluated.
fn extremes(path: &Path, rng: &mut Rng) -> Vec<f64> {
    let mut all = vec![
        0.0,
        -0.0,
        5e-324,
        1e-308,
        -1e-6,
        1e9,
        -1e9,
        path.length(),
        -path.length(),
        path.length() + 1.0,
    ];
    all.extend((0..4).map(|_| path.cumulative[below(rng, path.cumulative.len())]));
    all
}

/// Checks that a path has its documented properties and returns finite numbers.
fn check_path(net: &Net, path: &Path, edges: &[String], rng: &mut Rng) {
    assert!(path.points.len() >= 2 && path.points.len() == path.cumulative.len());
    assert_eq!(path.widths.len() + 1, path.points.len());
    assert!(path.cumulative.windows(2).all(|pair| pair[0] < pair[1]), "positions do not ascend");
    assert_eq!(path.edges, edges);
    assert_eq!((path.edge_start.len(), path.edge_length.len()), (edges.len(), edges.len()));
    assert!(path.lanes.iter().all(|&lane| lane < net.lanes.len()));
    for list in [
        &path.cumulative,
        &path.widths,
        &path.edge_start,
        &path.edge_length,
        path.points.as_flattened(),
    ] {
        assert_finite(list);
    }
    let extremes = extremes(path, rng);
    for (i, &s) in extremes.iter().enumerate() {
        let (point, heading) = path.at(s);
        assert_finite(&[point[0], point[1], heading]);
        let beside = [point[0] + extremes[(i + 1) % extremes.len()], point[1] - s];
        for hint in [0, i, usize::MAX] {
            let (along, lateral, segment) = path.project(beside, hint);
            assert_finite(&[along, lateral]);
            assert!(segment < path.widths.len());
        }
        let (along, lateral, _) = path.nearest(beside);
        assert_finite(&[along, lateral]);
        assert_finite(&[
            path.arc(0, s).unwrap(),
            path.arc(edges.len() - 1, s).unwrap(),
            path.arc_of_distance(s),
        ]);
        let (front, heading, segment) = path.body(s, 4.5);
        assert_finite(&[front[0], front[1], heading]);
        assert!(segment < path.widths.len());
    }
    assert_eq!(path.arc(edges.len(), 0.0), None);
    // With arguments that are not finite, any answer is accepted.
    for s in [f64::NAN, f64::INFINITY, f64::MIN] {
        let _ = (
            path.at(s),
            path.body(s, 4.5),
            path.arc_of_distance(s),
            path.project([s, 0.0], 0),
            path.nearest([0.0, s]),
            path.arc(0, s),
        );
    }
}

#[test]
fn damaged_nets_are_read_or_refused() {
    let parts = files("sumo_nets/intersection");
    let mut nets = parts.clone();
    nets.retain(|text| text.contains("<net"));
    nets.resize(2 * nets.len(), NET.into());
    let routes = shipped("intersection").routes;
    let path = FilePath::new("x.net.xml");
    cases::run(3000, move |number| {
        let mut rng = Seed::new(number).rng();
        let text = &nets[below(&mut rng, nets.len())];
        let other = &parts[below(&mut rng, parts.len())];
        let bytes = mutate::damaged(&mut rng, text, other);
        let text = String::from_utf8_lossy(&bytes);
        let net = match bounded(text.len(), || Net::parse(&text, path)) {
            Ok(net) => net,
            Err(error) => return assert_short(&error, path),
        };
        let tiled = tile(&text, path, 2).unwrap();
        // Further out, the coordinates of the copies exceed the limit for nets.
        if net.extent().as_flattened().iter().all(|number| number.abs() < 1e8) {
            let copies = Net::parse(&tiled.text, path).unwrap();
            assert_eq!(
                (copies.lanes.len(), copies.edges.len()),
                (2 * net.lanes.len(), 2 * net.edges.len())
            );
            assert_eq!(copies.connections.len(), 2 * net.connections.len());
        }
        let some = |rng: &mut Rng| net.edges[below(rng, net.edges.len())].id.clone();
        let mut ways: Vec<Vec<String>> = routes.iter().map(|route| route.edges.clone()).collect();
        if !net.edges.is_empty() {
            ways.extend((0..3).map(|_| vec![some(&mut rng)]));
            ways.extend((0..3).map(|_| vec![some(&mut rng), some(&mut rng)]));
        }
        // This route follows connections as far as they lead.
        let mut way = vec!["west_in".to_owned()];
        for _ in 0..below(&mut rng, 8) {
            let last = way
                .last()
                .and_then(|id| net.edge_index(id))
                .map(|edge| net.edges[edge].lanes.clone());
            let onward: Vec<_> =
                last.into_iter().flatten().flat_map(|lane| net.connections_from(lane)).collect();
            if !onward.is_empty() {
                let to = onward[below(&mut rng, onward.len())].to;
                way.push(net.edges[net.lanes[to].edge].id.clone());
            }
        }
        ways.push(way);
        for edges in ways {
            match net.route_path(&edges) {
                Ok(path) => check_path(&net, &path, &edges, &mut rng),
                Err(error) => assert_short(&error, path),
            }
        }
    });
}

/// Drives vehicles that follow their lanes exactly: each one is where its commands put it.
fn drive(task: Task, rng: &mut Rng) {
    let task = Arc::new(task);
    let mut world = World::new(Arc::clone(&task), Driver::Agents, Seed::new(1), 0, 1, 2);
    world.reset(0);
    let mut vehicles: Vec<Option<(f64, f64)>> = vec![None; task.agents + task.others];
    for _ in 0..8 {
        let actions: Vec<f32> =
            (0..task.agents).map(|_| [1.0, 0.0, -1.0, f32::NAN][below(rng, 4)]).collect();
        let mut commands = Vec::new();
        world.act(0, &actions, &mut commands);
        for command in commands {
            match command {
                Command::Add { slot, depart_pos, .. } => {
                    vehicles[slot as usize] = Some((depart_pos, 0.0));
                }
                Command::Remove { slot, .. } => vehicles[slot as usize] = None,
                Command::SetSpeed { slot, speed, .. } => {
                    assert_finite(&[speed]);
                    vehicles[slot as usize].as_mut().unwrap().1 = speed;
                }
                // A vehicle that departs waits to be inserted.
                Command::Depart { .. }
                | Command::SpeedMode { .. }
                | Command::LaneChangeMode { .. }
                | Command::ChangeLane { .. }
                | Command::MoveTo { .. }
                | Command::StartPhase { .. } => {}
            }
        }
        let mut snapshot = Snapshot::default();
        for vehicle in &mut vehicles {
            snapshot.vehicles.push(vehicle.as_mut().map(|(distance, speed)| {
                *distance += *speed * task.scenario.control.interval;
                VehicleState { distance: *distance, speed: *speed }
            }));
        }
        world.observe(0, &snapshot).unwrap();
        let frame = world.frame();
        for list in [&frame.observation, &frame.state, &frame.comm, &frame.reward] {
            assert!(
                list.iter().all(|number| number.is_finite()),
                "a frame with numbers that are none"
            );
        }
        assert!(
            frame
                .observation
                .iter()
                .chain(&frame.state)
                .all(|number| (-1.0..=1.0).contains(number))
        );
    }
}

#[test]
fn damaged_scenarios_are_read_or_refused() {
    let nets = root().join("sumo_nets");
    let texts = files("scenarios");
    let net = fs::read_to_string(nets.join("intersection/arm30.net.xml")).unwrap();
    let folder = folder();
    fs::create_dir_all(folder.path().join("intersection")).unwrap();
    for size in ["arm42", "arm74", "arm106"] {
        let name = format!("intersection/{size}.net.xml");
        fs::copy(nets.join(&name), folder.path().join(&name)).unwrap();
    }
    cases::run(1500, move |number| {
        let path = folder.path().join("task.xml");
        let mut rng = Seed::new(number).child("scenario").rng();
        let text = texts[below(&mut rng, texts.len())].replace("../sumo_nets/", "");
        let (text, net) = match below(&mut rng, 4) {
            0 => (text.into_bytes(), mutate::damaged(&mut rng, &net, NET)),
            _ => (mutate::damaged(&mut rng, &text, &net), net.clone().into_bytes()),
        };
        fs::write(&path, &text).unwrap();
        fs::write(folder.path().join("intersection/arm30.net.xml"), &net).unwrap();
        let read = std::str::from_utf8(&text)
            .map(|text| bounded(text.len(), || Scenario::parse(text, &path)));
        if let Ok(Ok(scenario)) = read {
            assert_eq!(Scenario::parse(&scenario.to_xml(), &path).unwrap(), scenario);
        }
        let scenario = match bounded(text.len() + 2 * net.len(), || Scenario::load(&path)) {
            Ok(scenario) => scenario,
            Err(error) => {
                use std::error::Error as _;
                assert_short(&error, &path);
                if let Some(source) =
                    error.source().and_then(|source| source.downcast_ref::<NetError>())
                {
                    assert_short(source, FilePath::new(".net.xml"));
                }
                return;
            }
        };
        for agents in [scenario.agents.min, scenario.agents.default] {
            let task = Task::new(&scenario, agents).unwrap();
            if agents <= 16 {
                drive(task, &mut rng);
            }
        }
    });
}

/// Damaged route files, on damaged nets, with vehicles and pedestrians are read or refused with an
/// error.
#[test]
fn damaged_route_files_are_read_or_refused() {
    let nets = root().join("sumo_nets");
    let read = |name: &str| fs::read_to_string(nets.join(name)).unwrap();
    let trips = "<routes><trip id=\"t\" depart=\"0:0:01\" from=\"west_in\" to=\"east_out\" via=\"west_in\"/>\n\
                 <flow id=\"f\" end=\"9\" number=\"3\" from=\"south_in\" to=\"north_out\"/>\n\
                 <routeDistribution id=\"d\"><route edges=\"west_in east_out\" repeat=\"0\"><stop lane=\"west_in_0\" endPos=\"9\" duration=\"2\"/></route></routeDistribution>\n\
                 <vehicle id=\"v\" depart=\"1\" route=\"d\" departEdge=\"random\" departLane=\"0\" arrivalEdge=\"1\"/></routes>";
    let texts = [
        read("mixed_cross/humans.rou.xml"),
        read("pedestrians_cross/people.rou.xml"),
        trips.to_owned(),
    ];
    let net = read("pedestrians_cross/pedestrians_cross.net.xml");
    let folder = folder();
    let path = folder.path().join("people.rou.xml");
    cases::run(1500, move |number| {
        let mut rng = Seed::new(number).child("routes").rng();
        let text = &texts[below(&mut rng, texts.len())];
        let text = mutate::damaged(&mut rng, text, &texts[0]);
        let net = match below(&mut rng, 4) {
            0 => mutate::damaged(&mut rng, &net, NET),
            _ => net.clone().into_bytes(),
        };
        fs::write(&path, &text).unwrap();
        let demand = match bounded(text.len(), || Demand::load(&[&path])) {
            Ok(demand) => demand,
            Err(error) => return assert_short(&error, &path),
        };
        let Ok(net) = std::str::from_utf8(&net)
            .map_err(drop)
            .and_then(|net| Net::parse(net, &path).map_err(drop))
        else {
            return;
        };
        let routes = demand.sources.iter().flat_map(|source| &source.routes);
        assert!(routes.into_iter().all(|entry| entry.0 < demand.routes.len()));
        let plan = demand.plan(&net, 0.0, 100.0).expect("few routes");
        for laid in &plan.routes {
            assert!(laid.path.points.len() >= 2 && !laid.edges.is_empty());
            assert_finite(laid.path.points.as_flattened());
        }
        for departure in &plan.departures {
            assert_finite(&departure.walk.unwrap_or_default());
        }
        for out in &plan.left_out {
            assert_short(&out.error(), &path);
        }
    });
}

/// A check ends soon, and every error that it finds has a position in the file.
#[test]
fn damaged_scenarios_are_checked() {
    let folder = folder();
    let sizes = Sizes { lanes: None, arm_length: None, agents: 8, speed: 13.889, steering: false };
    let made = Template::ALL.map(|template| {
        let file = create(folder.path(), template.name(), template, &sizes).unwrap();
        let text = fs::read_to_string(&file).unwrap();
        (file, text)
    });
    cases::run(1000, move |number| {
        let mut rng = Seed::new(number).child("check").rng();
        let (file, text) = &made[below(&mut rng, made.len())];
        let damaged = mutate::damaged(&mut rng, text, NET);
        fs::write(file, &damaged).unwrap();
        let net =
            fs::metadata(Scenario::parse(text, file).unwrap().net_for(2).unwrap().file.clone())
                .unwrap()
                .len();
        let findings = bounded(damaged.len() + 2 * net as usize, || Scenario::check(file));
        let errors = findings.list.iter().filter(|finding| finding.severity == Severity::Error);
        for error in errors.clone() {
            let unreadable = error.message.contains("cannot read the scenario")
                || error.message.contains("larger than");
            assert!(error.at.is_some() || unreadable, "without a place: {error}");
            assert!(
                error.message.len() <= MESSAGE && !error.message.chars().any(char::is_control),
                "{error:?}"
            );
        }
        // A scenario can be loaded exactly if the check returns it.
        assert_eq!(findings.scenario.is_some(), Scenario::load(file).is_ok());
        assert!(findings.scenario.is_some() || errors.count() > 0);
    });
}
