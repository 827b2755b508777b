//! Untrained policies on real SUMO against the rows measured on the simulator of the paper's task (8 vehicles), and the
//! collision audit: our own boxes against SUMO's report.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use iwol_sumo::env::Task;
use iwol_sumo::evaluate::{Evaluation, Metrics, Policy, evaluate};
use iwol_sumo::rng::Seed;
use iwol_sumo::scenario::Scenario;
use iwol_sumo::sumo::Hosting;

fn play(policy: &Policy<'_>, agents: u32, episodes: u64) -> (Evaluation, Metrics) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/intersection.xml");
    let scenario = Scenario::load(&path).expect("the shipped scenario");
    let task = Arc::new(Task::new(&scenario, agents).expect("a task"));
    let seed = Seed::new(0).child("calibration");
    let evaluation = evaluate(&task, policy, episodes, seed, &Hosting::default(), &AtomicBool::new(false), &mut |_| {})
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
    within("colliding pairs by SUMO against ours", f64::from(sumo), f64::from(own), 0.5);
    assert!(evaluation.episodes.iter().all(|e| (e.crash > 0.0) == (e.own_collisions > 0)));
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
fn results_do_not_depend_on_how_the_work_is_shared() {
    // Episode i is the same whether 3 or 12 are asked for, though other worlds play it.
    let (few, _) = play(&Policy::Gaussian, 4, 3);
    let (many, _) = play(&Policy::Gaussian, 4, 20);
    assert_eq!(few.episodes[..], many.episodes[..3]);
}
