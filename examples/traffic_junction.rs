//! The paper's motivating example: cars at a junction that see nobody, so that whoever comes has to
//! be told. Trains a method, and evaluates it with whole messages, with messages of 8 and of 2 bits
//! per element (Type I), and with false ones (Type II).
//!
//! ```text
//! cargo run --release --example traffic_junction -- METHOD STEPS SEED FOLDER [KEY=VALUE…]
//! cargo run --release --example traffic_junction -- ex-iwol 2000000 0 runs/traffic_junction/ex-iwol/seed_0
//! ```
//!
//! The folder is a run folder; a run that was stopped goes on with the same command. `episode.html`
//! in it plays an episode.

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use iwol_sumo::algo::Channel;
use iwol_sumo::checkpoint::Checkpoint;
use iwol_sumo::config::{Document, Layers};
use iwol_sumo::env::{Environment, JunctionSize, TrafficJunction};
use iwol_sumo::evaluate::{EvaluationObserver, LearnedPolicy, Policy, evaluate};
use iwol_sumo::replay::{Recorder, Title};
use iwol_sumo::rng::Seed;
use iwol_sumo::train::{RunDir, Trainer};
use toml::Value;

/// Settings for short episodes and few features, the same for all methods.
const SETTINGS: [&str; 3] = ["train.envs=32", "train.rollout_steps=40", "ppo.minibatch=1024"];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let method = args.next().unwrap_or_else(|| "ex-iwol".to_owned());
    let steps: i64 = args.next().map_or(Ok(2_000_000), |steps| steps.parse())?;
    let seed: i64 = args.next().map_or(Ok(0), |seed| seed.parse())?;
    let usual = || format!("runs/traffic_junction/{method}/seed_{seed}");
    let dir = RunDir::new(args.next().map_or_else(|| PathBuf::from(usual()), PathBuf::from));
    let environment = || Box::new(TrafficJunction::environment(JunctionSize::Medium, [0.05, 0.2]));
    let mut layers = Layers {
        sets: SETTINGS.into_iter().map(str::to_owned).chain(args).collect(),
        flags: vec![
            ("algorithm", Value::String(method.clone())),
            ("steps", Value::Integer(steps)),
            ("seed", Value::Integer(seed)),
        ],
        ..Layers::default()
    };
    let mut trainer = if dir.last().exists() {
        layers.document = Document::read(&dir.config())?;
        let config = layers.without_scenario(environment().spec())?;
        Trainer::resume(config, environment(), &Checkpoint::load(&dir.last())?)?
    } else {
        Trainer::new(layers.without_scenario(environment().spec())?, environment())?
    };
    let stop = AtomicBool::new(false);
    trainer.run(&dir, &stop, &mut |report| {
        let percent = |share: Option<f64>| share.map_or(f64::NAN, |share| 100.0 * share);
        println!(
            "{:>8} steps  {:>5.0} steps/s  success {:.1} % (validation {:.1} %)",
            report.step,
            report.steps_per_second,
            percent(report.training_success),
            percent(report.validation_success)
        );
    })?;

    // Cars come as often as they can in training.
    let busy = TrafficJunction::environment(JunctionSize::Medium, [0.2, 0.2]);
    let bits = |bits| Channel { bits, ..Channel::default() };
    let falsified = Channel { falsified: 1.0, ..Channel::default() };
    let channels = [
        ("whole messages", Channel::default()),
        ("8 bits", bits(8)),
        ("2 bits", bits(2)),
        ("false messages", falsified),
    ];
    println!("{method}, seed {seed}: episodes without a collision, of 1000");
    for (number, (name, channel)) in channels.into_iter().enumerate() {
        let policy = LearnedPolicy { learner: trainer.learner(), channel };
        let mut recorder = Recorder::new(busy.spec(), 0);
        let observer = EvaluationObserver {
            stop: &stop,
            report: &mut |_| {},
            recorder: (number == 0).then_some(&mut recorder),
            beside: false,
        };
        let found = evaluate(&busy, &Policy::Learned(&policy), 1000, Seed::new(7), observer)?;
        let metrics = found.metrics().ok_or("no episode")?;
        let (low, high) = (100.0 * metrics.success.low, 100.0 * metrics.success.high);
        println!(
            "{name:<16} {:5.1} [{low:.1}, {high:.1}] %, {:.2} collisions and {:.1} cars per episode",
            100.0 * metrics.success.mean,
            metrics.own["collisions"].mean,
            metrics.own["cars"].mean
        );
        let title = Title { environment: busy.name(), policy: &method, seed: 7 };
        if let Some(recording) = recorder.finish(&busy.backdrop()?, &title, found.episodes.first())
        {
            std::fs::write(dir.path().join("episode.html"), recording.player())?;
            std::fs::write(dir.path().join("episode.svg"), recording.still(20))?;
        }
    }
    Ok(())
}
