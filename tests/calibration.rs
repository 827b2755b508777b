//! Untrained policies on real SUMO against the rows measured on the simulator of the paper's tasks (crossing: 8 vehicles, parking: 5), and the
//! collision audit: our own boxes against SUMO's report.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use iwol_sumo::env::Task;
use iwol_sumo::evaluate::{Evaluation, Metrics, Onlooker, Policy, evaluate};
use iwol_sumo::rng::Seed;
use iwol_sumo::scenario::Scenario;
use iwol_sumo::sumo::Hosting;

fn play(policy: &Policy<'_>, agents: u32, episodes: u64) -> (Evaluation, Metrics) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/intersection.xml");
    play_on(&path, policy, agents, episodes)
}

fn play_on(path: &Path, policy: &Policy<'_>, agents: u32, episodes: u64) -> (Evaluation, Metrics) {
    let scenario = Scenario::load(path).expect("a scenario");
    let task = Arc::new(Task::new(&scenario, agents).expect("a task"));
    let seed = Seed::new(0).child("calibration");
    let evaluation = evaluate(
        &task,
        policy,
        episodes,
        seed,
        &Hosting::default(),
        Onlooker { stop: &AtomicBool::new(false), report: &mut |_| {}, recorder: None },
    )
    .expect("SUMO runs; else run scripts/bootstrap");
    assert_eq!(evaluation.episodes.len() as u64, episodes);
    let metrics = evaluation.metrics().expect("episodes");
    (evaluation, metrics)
}

fn within(what: &str, value: f64, expected: f64, share: f64) {
    assert!((value - expected).abs() <= share * expected, "{what}: {value}, expected {expected} ± {} %", 100.0 * share);
}

#[test]
fn full_throttle() {
    let (evaluation, metrics) = play(&Policy::Throttle(1.0), 8, 200);
    within("window reward", metrics.window_reward.mean, 391.8, 0.05);
    within("episode length", metrics.episode_length.mean, 57.8, 0.05);
    assert!((metrics.success.mean - 0.075).abs() <= 0.04, "success {}", metrics.success.mean);
    assert_eq!(metrics.out_of_road.mean, 0.0);
    // The audit. SUMO tests once per step and along lanes; our boxes are tested five times per step.
    let own: u32 = evaluation.episodes.iter().map(|e| e.own_collisions).sum();
    let sumo: u32 = evaluation.episodes.iter().map(|e| e.sumo_collisions).sum();
    within("colliding pairs by SUMO against ours", f64::from(sumo), f64::from(own), 0.2);
    assert!(evaluation.episodes.iter().all(|e| (e.crash > 0.0) == (e.own_collisions > 0)));
    let audit = metrics.audit;
    let differences: u32 = audit.differences().iter().map(|(_, pairs)| pairs).sum();
    let only_sumo = audit.sumo_ended + audit.sumo_touching + audit.sumo_bent + audit.sumo_other;
    assert_eq!((audit.agreed + differences, audit.agreed + only_sumo), (own + only_sumo, sumo));
    assert_eq!(audit.ours_unregulated, 0);
    assert!(f64::from(audit.ours_other + audit.sumo_other) < 0.02 * f64::from(own), "{audit:?}");
}

#[test]
fn the_audit_says_that_sumo_does_not_look_into_unregulated_junctions() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name);
    std::fs::create_dir_all(path("sumo_nets/intersection")).expect("a folder");
    std::fs::create_dir(path("scenarios")).expect("a folder");
    std::fs::copy(root.join("scenarios/intersection.xml"), path("scenarios/intersection.xml")).expect("a copy");
    for size in ["arm30", "arm42", "arm74", "arm106"] {
        let name = format!("sumo_nets/intersection/{size}.net.xml");
        let net = std::fs::read_to_string(root.join(&name)).expect("a net");
        assert!(net.contains("right_before_left"));
        std::fs::write(path(&name), net.replace("right_before_left", "unregulated")).expect("a net");
    }
    let (evaluation, metrics) = play_on(&path("scenarios/intersection.xml"), &Policy::Throttle(1.0), 8, 40);
    let own: u32 = evaluation.episodes.iter().map(|e| e.own_collisions).sum();
    // What is left are queues that run into each other on a lane.
    assert!(f64::from(metrics.audit.ours_unregulated) > 0.5 * f64::from(own), "{:?} of {own}", metrics.audit);
    assert_eq!(metrics.crash, play(&Policy::Throttle(1.0), 8, 40).1.crash, "ours does not depend on the type");
}

#[test]
fn standing_still() {
    let (_, metrics) = play(&Policy::Throttle(0.0), 8, 100);
    assert_eq!((metrics.reward.mean, metrics.window_reward.mean), (0.0, 0.0));
    assert_eq!((metrics.success.mean, metrics.safety.mean), (0.0, 1.0));
    assert_eq!(metrics.episode_length.mean, 1000.0);
    assert_eq!(metrics.sumo_collisions.mean, 0.0);
}

#[test]
fn gaussian_actions() {
    let (_, metrics) = play(&Policy::Gaussian, 8, 100);
    assert_eq!(metrics.success.mean, 0.0);
    assert!((10.0..=17.0).contains(&metrics.window_reward.mean), "window reward {}", metrics.window_reward.mean);
}

#[test]
fn sumos_own_driver_is_safe() {
    for agents in [4, 16, 48] {
        let (_, metrics) = play(&Policy::Sumo, agents, 10);
        assert_eq!(metrics.safety.mean, 1.0, "{agents} vehicles");
        // It is slow: with 48 vehicles a few are still on their way at the horizon.
        let least = if agents < 48 { 1.0 } else { 0.95 };
        assert!(metrics.success.mean >= least, "{agents} vehicles: {}", metrics.success.mean);
        assert_eq!(metrics.sumo_collisions.mean, 0.0, "{agents} vehicles");
    }
}

#[test]
fn sumos_own_driver_brings_every_episode_on_the_parking_lot_to_an_end() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/parking_lot.xml");
    let (evaluation, metrics) = play_on(&path, &Policy::Sumo, 5, 60);
    assert_eq!(evaluation.episodes.len(), 60);
    assert!(evaluation.episodes.iter().all(|episode| !episode.interrupted));
    assert!(metrics.success.mean > 0.3 && metrics.crash.mean > 0.0, "it is blind where a space is left");
}

#[test]
fn results_do_not_depend_on_how_the_work_is_shared() {
    // Episode i is the same whether 3 or 12 are asked for, though other worlds play it.
    let (few, _) = play(&Policy::Gaussian, 4, 3);
    let (many, _) = play(&Policy::Gaussian, 4, 20);
    assert_eq!(few.episodes[..], many.episodes[..3]);
}

#[test]
fn parking_at_a_constant_speed_and_at_full_throttle() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/parking_lot.xml");
    let (_, pursuit) = play_on(&path, &Policy::by_name("pursuit:4").expect("a policy"), 5, 1000);
    assert!((pursuit.success.mean - 0.29).abs() <= 0.06, "success {}", pursuit.success.mean);
    within("window reward", pursuit.window_reward.mean, 439.5, 0.08);
    assert_eq!(pursuit.out_of_road.mean, 0.0, "pure pursuit stays on the road");
    let (_, straight) = play_on(&path, &Policy::Throttle(1.0), 5, 400);
    assert_eq!(straight.success.mean, 0.0);
    assert!((straight.window_reward.mean + 8.2).abs() <= 3.0, "window reward {}", straight.window_reward.mean);
    within("episode length", straight.episode_length.mean, 51.6, 0.1);
}
