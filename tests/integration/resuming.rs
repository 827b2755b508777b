//! Reproducibility with the real simulator: the same seed gives the same bits, and stopping,
//! resuming and validating change nothing.

use std::sync::atomic::AtomicBool;

use iwol_sumo::algo;
use iwol_sumo::checkpoint::{Checkpoint, Progress};
use iwol_sumo::config::{Config, Document, Layers};
use iwol_sumo::driving;
use iwol_sumo::scenario::Scenario;
use iwol_sumo::train::{RunDir, Trainer, TrainingEnd};
use tch::{Kind, Tensor};

use crate::support::{INTERSECTION, folder, in_parallel, root};

// Uses TraCI, because several trainers exist at once, and a process can have libsumo only once.
fn config(algorithm: &str, encoder: &str, steps: u64) -> (Config, Scenario) {
    // Messages that are under way outlast a rollout.
    let channel = if encoder == "attention" {
        "[channel]\nbits = 8\nloss = 0.1\ndelay = 2\nfalsified = 0.2\n"
    } else {
        ""
    };
    let text = format!(
        "scenario.file = '{}'\nscenario.termination.horizon = 60\nalgorithm = {algorithm:?}\nagents = 4\nseed = 5\nsteps = {steps}\n\
         [train]\nenvs = 3\nrollout_steps = 40\nfewest_agents = 2\nrepeat_failed = 0.5\nvalidate_every = 200\nvalidation_episodes = 1\n\
         [simulation]\nbackend = 'traci'\n\
         [network]\nencoder = {encoder:?}\nhidden = 16\n\
         [iwol]\nrounds = 1\nlatent = 4\n\
         [ppo]\nminibatch = 128\nepochs = 2\n{channel}",
        root().join(INTERSECTION).display()
    );
    let document = Document { name: "test".to_owned(), text, generated: false };
    Config::resolve(&Layers { document, ..Layers::default() }).expect("a valid configuration")
}

/// Returns the settings of four iterations, of which the noise falls in the first two.
fn four(algorithm: &str, encoder: &str) -> (Config, Scenario) {
    let (mut config, scenario) = config(algorithm, encoder, 480);
    config.learner.exploration.explore_steps = 240;
    (config, scenario)
}

fn trainer(algorithm: &str, encoder: &str) -> Trainer {
    let (config, scenario) = four(algorithm, encoder);
    driving::trainer(config, &scenario).expect("SUMO runs")
}

/// Returns everything that determines the further course of a run, as bits.
fn bits(checkpoint: &Checkpoint) -> Vec<(String, Vec<u64>)> {
    let value =
        |t: &Tensor| Vec::<f64>::try_from(t.to_kind(Kind::Double).reshape([-1])).expect("numbers");
    let mut all: Vec<(String, Vec<u64>)> = checkpoint
        .learner
        .iter()
        .map(|(name, t)| (name.clone(), value(t).iter().map(|v| v.to_bits()).collect()))
        .collect();
    for world in &checkpoint.worlds {
        let p = &world.position;
        let order = [world.episode, p.next, p.fresh, p.episode_index, u64::from(p.replaying)];
        let order = order.into_iter().chain(p.failed.iter().copied());
        all.push((
            "world".to_owned(),
            world.actions.iter().map(|a| u64::from(a.to_bits())).chain(order).collect(),
        ));
    }
    all.push((
        "memory".to_owned(),
        checkpoint.memory.iter().map(|a| u64::from(a.to_bits())).collect(),
    ));
    all.sort();
    all
}

/// Returns all methods with the encoder `mlp`, and some with `gru`, or with `attention` and a
/// disturbed channel.
fn runs() -> Vec<(&'static str, &'static str)> {
    let recurrent = ["im-iwol", "mat"].map(|name| (name, "gru"));
    let attentive = ["im-iwol", "ex-iwol", "magic"].map(|name| (name, "attention"));
    [&algo::NAMES.map(|name| (name, "mlp"))[..], &recurrent, &attentive].concat()
}

#[test]
fn training_is_reproducible_and_resumable_bit_for_bit() {
    let stop = AtomicBool::new(false);
    in_parallel(runs(), |(algorithm, encoder)| {
        // Four iterations in one go. Episodes of at most 60 steps end within rollouts of 40 steps.
        let mut whole = trainer(algorithm, encoder);
        for _ in 0..4 {
            whole.iterate().expect("an iteration");
        }
        // Two iterations, a validation and a checkpoint in a file, then two more in a trainer that
        // gets only the file.
        let mut first = trainer(algorithm, encoder);
        for _ in 0..2 {
            first.iterate().expect("an iteration");
        }
        first.validate(&stop).expect("a validation");
        let folder = folder();
        let file = folder.path().join("c.safetensors");
        first.checkpoint().save(&file).expect("saved");
        drop(first);
        let stored = Checkpoint::load(&file).expect("loaded");
        let position = |world: usize| &stored.worlds[world].position;
        assert!(
            (0..3).any(|e| !position(e).failed.is_empty()),
            "episodes that failed are remembered"
        );
        assert!(
            (0..3).any(|e| position(e).episode_index > position(e).fresh),
            "and at least one was played again"
        );
        let (config, scenario) = four(algorithm, encoder);
        // Episodes with other numbers of agents would not match the stored actions.
        let mut other = config.clone();
        other.train.fewest_agents = 3;
        let refused = driving::resume(other, &scenario, &stored).err().expect("refused");
        assert!(refused.to_string().contains("train.fewest_agents"), "{refused}");
        let mut second = driving::resume(config, &scenario, &stored).expect("resumed");
        for _ in 0..2 {
            second.iterate().expect("an iteration");
        }
        let (whole, parts) = (whole.checkpoint(), second.checkpoint());
        assert_eq!((whole.progress.step, whole.progress.iteration), (480, 4));
        assert_eq!((parts.progress.step, parts.progress.iteration), (480, 4));
        assert!(whole.worlds.iter().any(|w| w.episode >= 3), "episodes ended on the way");
        let (a, b) = (bits(&whole), bits(&parts));
        assert_eq!(a.len(), b.len());
        for (a, b) in a.iter().zip(&b) {
            assert_eq!(a, b, "{algorithm} {encoder}");
        }
    });
}

#[test]
fn a_stopped_run_goes_on_in_its_folder() {
    let folder = folder();
    let dir = RunDir::new(folder.path().join("run"));
    let (config, scenario) = config("im-iwol", "mlp", 360);
    let stop = AtomicBool::new(false);
    let mut trainer = driving::trainer(config.clone(), &scenario).expect("SUMO runs");
    // Training is asked to stop during the first iteration, as by Ctrl-C.
    let outcome =
        trainer.run(&dir, &stop, &mut |_| stop.store(true, std::sync::atomic::Ordering::Relaxed));
    assert_eq!(outcome.expect("a clean end"), TrainingEnd::Interrupted);
    drop(trainer);
    let stored = Checkpoint::load(&dir.last()).expect("a checkpoint");
    assert_eq!(stored.progress.step, 120);
    // A half-written line, as a full disk or a crash leaves it.
    let text = std::fs::read_to_string(dir.metrics()).expect("metrics");
    std::fs::write(dir.metrics(), format!("{text}{{\"step\":12")).expect("written");
    let stop = AtomicBool::new(false);
    let mut trainer = driving::resume(config, &scenario, &stored).expect("resumed");
    assert_eq!(trainer.run(&dir, &stop, &mut |_| {}).expect("trained"), TrainingEnd::Finished);
    let steps: Vec<u64> = std::fs::read_to_string(dir.metrics())
        .expect("metrics")
        .lines()
        .map(|line| {
            serde_json::from_str::<serde_json::Value>(line).expect("whole lines")["step"]
                .as_u64()
                .expect("a step")
        })
        .collect();
    // One line per iteration and one per validation.
    assert_eq!(steps, [120, 240, 240, 360, 360]);
    assert!(dir.best().exists());

    // A run of the same settings that was not stopped.
    let undisturbed = RunDir::new(folder.path().join("undisturbed"));
    let (config, scenario) = self::config("im-iwol", "mlp", 360);
    let mut trainer = driving::trainer(config, &scenario).expect("SUMO runs");
    assert_eq!(
        trainer.run(&undisturbed, &stop, &mut |_| {}).expect("trained"),
        TrainingEnd::Finished
    );
    for file in [RunDir::last, RunDir::best] {
        let (a, b) = (Checkpoint::load(&file(&dir)), Checkpoint::load(&file(&undisturbed)));
        let (a, b) = (a.expect("a checkpoint"), b.expect("a checkpoint"));
        assert_eq!(bits(&a), bits(&b));
        assert_eq!(
            Progress { seconds: 0.0, ..a.progress },
            Progress { seconds: 0.0, ..b.progress }
        );
    }

    // The process is killed after it recorded the last validation and before a checkpoint contains
    // it: the validation is repeated, and recorded once.
    let recorded = |file: std::path::PathBuf| -> Vec<(u64, bool)> {
        let text = std::fs::read_to_string(file).expect("lines");
        let line = |line| serde_json::from_str::<serde_json::Value>(line).expect("whole lines");
        let lines = text.lines().map(line);
        lines
            .map(|l| (l["step"].as_u64().expect("a step"), l["validation/success"].is_number()))
            .collect()
    };
    let before = (recorded(dir.metrics()), recorded(dir.episodes()));
    assert!(before.0.contains(&(360, true)) && before.1.contains(&(360, false)), "{before:?}");
    let mut stored = Checkpoint::load(&dir.last()).expect("a checkpoint");
    assert_eq!(stored.progress.validated, 360);
    stored.progress.validated = 240;
    let (config, scenario) = self::config("im-iwol", "mlp", 360);
    let mut trainer = driving::resume(config, &scenario, &stored).expect("resumed");
    assert_eq!(trainer.run(&dir, &stop, &mut |_| {}).expect("trained"), TrainingEnd::Finished);
    assert_eq!((recorded(dir.metrics()), recorded(dir.episodes())), before);
}
