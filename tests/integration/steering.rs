//! Vehicles that steer, with the real SUMO: the scenarios with turns, and the lanes and positions
//! that SUMO derives from given poses.

use std::sync::Arc;

use rand::RngExt;

use iwol_sumo::driving::Policy;
use iwol_sumo::env::{Driver, Task, World};
use iwol_sumo::rng::Seed;
use iwol_sumo::sumo::domain::vehicle::{Addition, Placement};
use iwol_sumo::sumo::net::Net;
use iwol_sumo::sumo::process::{Options, Process};
use iwol_sumo::sumo::{Client, Command, Snapshot, VehicleState};

use crate::support::{self, task};

/// Scenarios with numbers of vehicles and of episodes.
const SCENARIOS: [(&str, u32, u64); 3] =
    [("intersection_turns", 8, 4), ("intersection_turns_small", 8, 4), ("parking_lot", 5, 10)];

/// A SUMO process of the test's own, on which the commands of a world are played.
struct Own {
    _process: Process,
    sumo: Client,
    task: Arc<Task>,
}

impl Own {
    fn start(task: &Arc<Task>) -> Self {
        let mut arguments = vec!["--net-file".into(), task.map.net_file().into()];
        // The options that the environments use.
        let options = "--step-length 0.1 --collision.action none --time-to-teleport -1";
        arguments.extend(options.split(' ').map(Into::into));
        let (process, mut sumo, _) =
            Process::start(&Options { arguments, ..Options::default() }).unwrap();
        for (route, geometry) in task.scenario.routes.iter().zip(&task.map.routes) {
            let edges: Vec<&str> = geometry.path.edges.iter().map(String::as_str).collect();
            sumo.route().add(&route.id, &edges).unwrap();
        }
        Self { _process: process, sumo, task: Arc::clone(task) }
    }

    fn play(&mut self, commands: &[Command]) -> Snapshot {
        let vehicle = |slot: u32| format!("v{slot}");
        for command in commands {
            match *command {
                Command::Add { slot, route, depart_pos, .. } => {
                    let (lane, pos) = (
                        self.task.map.routes[route as usize].first_lane.to_string(),
                        depart_pos.to_string(),
                    );
                    let route = &self.task.scenario.routes[route as usize].id;
                    let addition = Addition {
                        depart_lane: &lane,
                        depart_pos: &pos,
                        ..Addition::on_route(route)
                    };
                    self.sumo.vehicle().add(&vehicle(slot), &addition).unwrap();
                    self.sumo
                        .vehicle()
                        .set_length(&vehicle(slot), self.task.scenario.vehicle.length)
                        .unwrap();
                    self.sumo.vehicle().set_min_gap(&vehicle(slot), 0.0).unwrap();
                }
                Command::Remove { slot, .. } => {
                    self.sumo.vehicle().remove(&vehicle(slot), 3).unwrap();
                }
                Command::SetSpeed { slot, speed, .. } => {
                    self.sumo.vehicle().set_speed(&vehicle(slot), speed).unwrap();
                }
                Command::SpeedMode { slot, mode, .. } => {
                    self.sumo.vehicle().set_speed_mode(&vehicle(slot), mode).unwrap();
                }
                Command::LaneChangeMode { slot, mode, .. } => {
                    self.sumo.vehicle().set_lane_change_mode(&vehicle(slot), mode).unwrap();
                }
                Command::Depart { .. } => panic!("nobody is driven by SUMO here"),
                Command::StartPhase { .. } => panic!("no traffic lights here"),
                Command::ChangeLane { .. } => panic!("who steers changes lanes by steering"),
                Command::MoveTo { slot, x, y, heading, keep_route, .. } => {
                    let angle = (90.0 - heading.to_degrees()).rem_euclid(360.0);
                    let placement = Placement { angle, keep_route, ..Placement::default() };
                    self.sumo.vehicle().move_to_xy(&vehicle(slot), [x, y], &placement).unwrap();
                }
            }
        }
        self.sumo.simulation_step(0.0).unwrap();
        let there = self.sumo.vehicle().get_id_list().unwrap();
        let state = |slot: u32| {
            let on_lane = there.contains(&vehicle(slot))
                && !self.sumo.vehicle().get_lane_id(&vehicle(slot)).unwrap().is_empty();
            on_lane.then_some(VehicleState { distance: 0.0, speed: 0.0 })
        };
        let vehicles = (0..self.task.agents as u32).map(state).collect();
        Snapshot { time: 0.0, vehicles, ..Snapshot::default() }
    }
}

/// Returns the distance of a point from a polyline \[m\].
fn beside(shape: &[[f64; 2]], p: [f64; 2]) -> f64 {
    let apart = |w: &[[f64; 2]]| {
        let (dx, dy) = (w[1][0] - w[0][0], w[1][1] - w[0][1]);
        let t = ((p[0] - w[0][0]) * dx + (p[1] - w[0][1]) * dy) / (dx * dx + dy * dy);
        let t = t.clamp(0.0, 1.0);
        (p[0] - w[0][0] - t * dx).hypot(p[1] - w[0][1] - t * dy)
    };
    shape.windows(2).map(apart).fold(f64::INFINITY, f64::min)
}

#[test]
fn sumo_has_every_vehicle_where_it_is() {
    for (name, agents, episodes) in SCENARIOS {
        let task = task(name, agents);
        let net = Net::load(task.map.net_file()).unwrap();
        let half = task.scenario.vehicle.length / 2.0;
        let mut own = Own::start(&task);
        let mut world = World::new(Arc::clone(&task), Driver::Agents, Seed::new(3), 0, 1, episodes);
        let feature = |name: &str| {
            task.spec.observation.list.iter().position(|f| f.name == name).expect("is seen")
        };
        let [lateral, heading] = ["ego.lateral", "steering.heading_error_cos"].map(feature);
        let (mut compared, mut on_junction, mut wrecks, mut told, mut around, mut led) =
            (0, 0, 0, 0, 0, 0);
        world.reset(0);
        let mut commands = Vec::new();
        while !world.is_idle() {
            let step = world.step_count();
            let actions: Vec<f32> = (0..task.agents)
                .flat_map(|i| world.pursuit(i, 6.0))
                .map(|action| action as f32)
                .collect();
            commands.clear();
            world.act(0, &actions, &mut commands);
            told +=
                commands.iter().filter(|command| matches!(command, Command::MoveTo { .. })).count();
            let snapshot = own.play(&commands);
            world.observe(0, &snapshot).expect("no vehicle vanishes");
            if !world.is_running() {
                continue;
            }
            let mut on_lanes: Vec<(String, f64, String)> = Vec::new();
            for (slot, agent) in
                world.agents().enumerate().filter(|(_, agent)| agent.driving || agent.wreck)
            {
                let at = format!("{name}, episode {}, step {step}, slot {slot}", world.episode());
                if agent.driving && task.map.routes[agent.route].avoided.is_some() {
                    // The vehicle cannot drive the U-turn of its route: the observation describes
                    // the path that the vehicle drives instead.
                    let seen = &world.frame().observation[slot * task.spec.observation.len()..];
                    let (lateral, heading) = (seen[lateral], seen[heading]);
                    assert!(
                        lateral.abs() < 0.6 && heading > 0.8,
                        "{at}: {lateral} aside, {heading} along"
                    );
                    around += 1;
                }
                let (sin, cos) = agent.pose.heading.sin_cos();
                let front = [agent.pose.x + half * cos, agent.pose.y + half * sin];
                let path = task.map.routes[agent.route].lanes();
                let (s, lateral, segment) = path.nearest(front);
                // SUMO may assign a vehicle beside its lane to another lane, and a vehicle that has
                // missed a turn may come back against the traffic.
                let off = lateral.abs() > path.widths[segment] / 2.0;
                if off || (agent.pose.heading - path.at(s).1).cos() < 0.5 {
                    continue;
                }
                let stretch = path.lane_stretches().find(|&(_, from, to)| (from..to).contains(&s));
                let (lane, from, to) = stretch.expect("every position lies on a lane");
                // Next to the border between two consecutive lanes, SUMO may choose either of them.
                if s - from < 0.1 || to - s < 0.1 {
                    continue;
                }
                let lane = &net.lanes[lane];
                let junction = lane.id.starts_with(':');
                let id = format!("v{slot}");
                let [x, y] = own.sumo.vehicle().get_position(&id).unwrap();
                let found = own.sumo.vehicle().get_lane_id(&id).unwrap();
                let apart = (x - front[0]).hypot(y - front[1]);
                // SUMO places a vehicle on the centre line of its lane.
                assert!(
                    apart < lateral.abs() + 0.1,
                    "{at}: SUMO at {x} {y}, {front:?} is {apart} away, {lateral} aside"
                );
                if junction && found != lane.id {
                    // Lanes over a junction overlap, and SUMO chooses the nearest one.
                    let other = net
                        .lanes
                        .iter()
                        .find(|other| other.id == found)
                        .expect("a lane of the net");
                    assert!(beside(&other.shape, front) < lateral.abs() + 0.1, "{at}: {found}");
                    continue;
                }
                assert_eq!(found, lane.id, "{at}, at {front:?}");
                let position = own.sumo.vehicle().get_lane_position(&id).unwrap();
                let ours = (s - from) * lane.length / (to - from);
                assert!(
                    (position - ours).abs() < 0.1,
                    "{at}, {}: SUMO {position}, ours {ours}",
                    lane.id
                );
                compared += 1;
                on_junction += usize::from(junction);
                wrecks += usize::from(agent.wreck);
                if !junction {
                    on_lanes.push((found, position, id));
                }
            }
            // The leader that SUMO's drivers would follow is the next vehicle ahead on the same
            // lane, at the end of the gap.
            on_lanes.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
            for pair in on_lanes.windows(2).filter(|pair| pair[0].0 == pair[1].0) {
                let gap = pair[1].1 - pair[0].1 - 2.0 * half;
                if gap > 0.0 {
                    let leader = own
                        .sumo
                        .vehicle()
                        .get_leader(&pair[0].2, 100.0)
                        .unwrap()
                        .expect("one is ahead");
                    assert_eq!(leader.id, pair[1].2, "{name}, step {step}: {pair:?}");
                    assert!(
                        (leader.gap - gap).abs() < 0.2,
                        "{name}: SUMO {}, ours {gap}",
                        leader.gap
                    );
                    led += 1;
                }
            }
        }
        // On the parking lot, no two vehicles are on one lane.
        assert!(led > 20 || name == "parking_lot", "{name}: {led} leaders");
        assert!(
            around > 100 || name != "intersection_turns",
            "{around} steps of vehicles that turn back"
        );
        let enough = compared > 500 && on_junction > 100 && wrecks > 20;
        assert!(
            enough,
            "{name}: {compared} places, {on_junction} of them on the junction, {wrecks} of wrecks"
        );
        assert!(
            10 * told < compared,
            "{name}: on its lane a vehicle's speed is enough; {told} moves, {compared} places"
        );
    }
}

#[test]
fn pursuit_follows_every_way_and_full_throttle_leaves_the_bends() {
    let play = |name: &str, agents: u32, policy: Policy<'static>| {
        let task = task(name, agents);
        support::play(&task, &policy, 24, Seed::new(5)).metrics().expect("episodes")
    };
    let by_name = |name| Policy::by_name(name).expect("a policy");
    let pursuit = play("intersection_turns_small", 4, by_name("pursuit:5"));
    assert_eq!(pursuit.driving().out_of_road.mean, 0.0, "pure pursuit stays on the road");
    assert!(pursuit.success.mean > 0.3 && pursuit.driving().crash.mean > 0.05, "{pursuit:?}");
    // The `fcfs` policy lets many vehicles pass one after the other: straight on, left, right and
    // back.
    for (name, agents) in [("intersection_turns_small", 8), ("intersection_turns", 16)] {
        let courteous = play(name, agents, by_name("fcfs:5"));
        assert!(
            courteous.success.mean > 0.98 && courteous.driving().crash.mean < 0.01,
            "{name}: {courteous:?}"
        );
        // In the junction, SUMO may assign a vehicle to the path of another route, above all in
        // U-turns, and then bends the vehicle's body along this path.
        let audit = courteous.driving().audit;
        assert_eq!(audit.sumo_other, 0, "{name}: {audit:?}");
        assert!(audit.sumo_bent > 0 || name != "intersection_turns", "{audit:?}");
    }
    let straight = play("intersection_turns_small", 4, Policy::Throttle(1.0));
    assert!(
        straight.driving().out_of_road.mean > 0.2,
        "who should turn and does not ends beside the road: {straight:?}"
    );
    assert!(straight.success.mean < 0.4, "{straight:?}");
}

/// Vehicles that drive forwards and backwards, leave the net by its ends and come back over the
/// junction never vanish. Where SUMO has some of them on no lane, they drive on until their centre
/// is beyond the end of the road.
#[test]
fn who_drives_to_and_fro_is_never_lost() {
    let task = task("parking_lot", 5);
    let mut own = Own::start(&task);
    let mut world = World::new(Arc::clone(&task), Driver::Agents, Seed::new(4), 0, 1, 40);
    world.reset(0);
    let (mut commands, mut rng) = (Vec::new(), Seed::new(9).rng());
    let (mut turned, mut on_no_lane, mut came_back) = (0, 0, 0);
    let mut before: Vec<usize> = Vec::new();
    while !world.is_idle() {
        // Pursuit forwards for a while, backwards for a while, and forwards again. In every second
        // episode, all drive straight on, some of them into a space across the road, until SUMO has
        // one on no lane, and then backwards.
        let straight = world.episode() % 2 == 1;
        let turns_back = (world.step_count() / 25 + world.episode() as u32) % 3 == 1;
        let back = if straight { !before.is_empty() } else { turns_back };
        let mut actions = Vec::new();
        for slot in 0..task.agents {
            let ahead = if straight { 2.5 } else { 6.0 };
            let [steer, throttle] = world.pursuit(slot, if back { -4.0 } else { ahead });
            let noise = rng.random_range(-0.3..0.3);
            let steer = if straight { noise / 10.0 } else { steer + noise };
            actions.extend([steer as f32, throttle as f32]);
        }
        commands.clear();
        world.act(0, &actions, &mut commands);
        turned +=
            commands.iter().filter(|c| matches!(c, Command::MoveTo { keep_route: 2, .. })).count();
        let snapshot = own.play(&commands);
        world.observe(0, &snapshot).expect("no vehicle vanishes");
        let there = |slot: usize| snapshot.vehicles[slot].is_some();
        let agents = world.agents().enumerate().filter(|_| world.is_running());
        if world.step_count() == 0 {
            before.clear();
        }
        for (slot, _) in agents.filter(|(_, agent)| agent.driving) {
            let was_on_none = before.contains(&slot);
            if !there(slot) && !was_on_none {
                before.push(slot);
            }
            on_no_lane += usize::from(!there(slot));
            came_back += usize::from(there(slot) && was_on_none);
        }
    }
    assert!(
        turned > 100 && on_no_lane > 20 && came_back > 20,
        "{turned} moves over the junction or beside the road; SUMO had vehicles on no lane for \
         {on_no_lane} steps, and {came_back} steps after they came back"
    );
}
