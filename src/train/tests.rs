//! Trainings whose ranks are threads of one process, and trainings that play and learn at the same
//! time.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use tch::{Kind, Tensor};
use toml::Value;

use super::{RunDir, Stage, Stops, Trainer, TrainingEnd};
use crate::algo::Stop;
use crate::checkpoint::Checkpoint;
use crate::config::{Config, Layers};
use crate::env::{
    self, Backdrop, EnvSpec, Environment, EpisodeRecord, Picture, Stream, WorldState, WorldView,
    Worlds,
};
use crate::ranks::threads::threads;
use crate::ranks::{Team, part_of};

fn environment() -> Box<dyn Environment> {
    env::NamedEnvironment::find("traffic_junction_easy").expect("it is there").environment()
}

fn config(method: &str, more: &[&str]) -> Config {
    let usual = ["train.envs=5", "train.rollout_steps=20", "ppo.minibatch=96", "ppo.shards=3"];
    let small = ["network.hidden=16", "ppo.epochs=2"];
    let steps = ["steps=600", "train.validate_every=250", "train.validation_episodes=7"];
    let sets =
        usual.iter().chain(&small).chain(&steps).chain(more).map(|set| (*set).to_owned()).collect();
    let flags = vec![("algorithm", Value::String(method.to_owned()))];
    let layers = Layers { sets, flags, ..Layers::default() };
    layers.for_environment(&*environment()).expect("settings")
}

/// 52 worlds of 5 cars have 260 decisions, which are divided into two parts, so that one of three
/// ranks has none.
const MANY: [&str; 2] = ["train.envs=52", "train.rollout_steps=8"];

type Content = (BTreeMap<String, Vec<f64>>, String);

/// Returns everything that a checkpoint contains of weights and worlds.
fn content(checkpoint: &Checkpoint) -> Content {
    let numbers = |tensor: &Tensor| {
        Vec::try_from(tensor.to_kind(Kind::Double).reshape([-1])).expect("numbers")
    };
    let named = checkpoint.learner.iter().map(|(name, tensor)| (name.clone(), numbers(tensor)));
    // A file has no order.
    let weights: BTreeMap<String, Vec<f64>> = named.collect();
    (weights, format!("{:?} {:?}", checkpoint.worlds, checkpoint.memory))
}

/// Trains in `size` threads, and returns what each has at the end, and the validations of the
/// first.
fn trained(size: usize, method: &str, more: &[&str]) -> (Vec<Content>, Vec<String>) {
    let found = Mutex::new(vec![None; size]);
    let lines = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for ranks in threads(size) {
            let (found, lines, settings) = (&found, &lines, config(method, more));
            scope.spawn(move || {
                let rank = ranks.rank();
                let team = Team::new(ranks, Arc::default());
                let trainer = Trainer::among(settings, environment(), None, &team);
                let mut trainer = trainer.expect("a trainer");
                let folder = tempfile::tempdir().expect("a folder");
                let dir = RunDir::new(folder.path());
                let end = trainer.run(&dir, &team.stop, &mut |_| {}).expect("it runs");
                assert_eq!(end, TrainingEnd::Finished);
                let stored = content(&Checkpoint::load(&dir.last()).expect("a checkpoint"));
                found.lock().expect("no thread panicked")[rank] = Some(stored);
                if rank == 0 {
                    let text = std::fs::read_to_string(dir.episodes()).expect("validations");
                    *lines.lock().expect("no thread panicked") =
                        text.lines().map(str::to_owned).collect();
                }
            });
        }
    });
    let found = found.into_inner().expect("no thread panicked");
    let all = found.into_iter().map(|one| one.expect("every rank ends")).collect();
    (all, lines.into_inner().expect("no thread panicked"))
}

/// Two and three ranks have the weights, worlds and validations of one process with as many shards,
/// to the bit: with messages, with memories, with divided decisions, and with sampled graphs.
#[test]
fn ranks_train_as_one_process_does() {
    let gru = ["network.encoder=gru", "network.chunk_length=4"];
    let gru = [&gru[..], &MANY].concat();
    for (method, more) in [("ex-iwol", &[][..]), ("mappo", &gru), ("commformer", &[])] {
        let (alone, validations) = trained(1, method, more);
        assert!(validations.len() >= 14, "{method}: {validations:?}");
        for size in [2, 3] {
            let (all, same) = trained(size, method, more);
            for (rank, one) in all.iter().enumerate() {
                assert!(*one == alone[0], "{method}: rank {rank} of {size} differs");
            }
            assert_eq!(same, validations, "{method}");
        }
    }
}

/// A run of two ranks goes on from its checkpoint bit for bit, also where messages are under way.
#[test]
fn ranks_resume_bit_for_bit() {
    let run = |stops: &[u64]| {
        let folder = tempfile::tempdir().expect("a folder");
        let file = &folder.path().join("last.safetensors");
        for iterations in stops {
            std::thread::scope(|scope| {
                for ranks in threads(2) {
                    scope.spawn(move || {
                        let first = ranks.rank() == 0;
                        let team = Team::new(ranks, Arc::default());
                        let more = [&MANY[..], &["channel.delay=1"]].concat();
                        let settings = config("ex-iwol", &more);
                        let last = file.exists().then(|| Checkpoint::load(file).expect("loaded"));
                        let trainer = Trainer::among(settings, environment(), last.as_ref(), &team);
                        let mut trainer = trainer.expect("a trainer");
                        for _ in 0..*iterations {
                            trainer.iterate().expect("an iteration");
                        }
                        let end = trainer.checkpoint();
                        if first {
                            end.save(file).expect("saved");
                        }
                    });
                }
            });
        }
        content(&Checkpoint::load(file).expect("loaded"))
    };
    assert!(run(&[4]) == run(&[3, 1]));
}

/// Once one rank is asked to stop, all stop after the same number of steps.
#[test]
fn ranks_stop_together() {
    let ends = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for ranks in threads(2) {
            let ends = &ends;
            scope.spawn(move || {
                let asked = Arc::new(AtomicBool::new(false));
                let (rank, team) = (ranks.rank(), Team::new(ranks, Arc::clone(&asked)));
                let settings = config("mappo", &["steps=100000"]);
                let trainer = Trainer::among(settings, environment(), None, &team);
                let mut trainer = trainer.expect("a trainer");
                let folder = tempfile::tempdir().expect("a folder");
                let dir = RunDir::new(folder.path());
                let end = trainer.run(&dir, &team.stop, &mut |report| {
                    if rank == 1 && report.step >= 300 {
                        asked.store(true, Ordering::Relaxed);
                    }
                });
                assert_eq!(end.expect("it runs"), TrainingEnd::Interrupted);
                ends.lock().expect("no thread panicked").push(trainer.progress().step);
            });
        }
    });
    let ends = ends.into_inner().expect("no thread panicked");
    assert!(ends.len() == 2 && ends[0] == ends[1] && ends[0] < 1000, "{ends:?}");
}

/// A run that is resumed and stopped at once ends in all ranks, although only the first one, which
/// writes the run, has a best policy in its folder.
#[test]
fn ranks_end_together_where_only_the_first_has_a_best_policy() {
    let folder = tempfile::tempdir().expect("a folder");
    let dir = &RunDir::new(folder.path());
    for resumed in [false, true] {
        std::thread::scope(|scope| {
            for ranks in threads(2) {
                scope.spawn(move || {
                    let (first, team) = (ranks.rank() == 0, Team::new(ranks, Arc::default()));
                    let last = resumed.then(|| Checkpoint::load(&dir.last()).expect("loaded"));
                    let settings = config("mappo", &["steps=400"]);
                    let trainer = Trainer::among(settings, environment(), last.as_ref(), &team);
                    let mut trainer = trainer.expect("a trainer");
                    let aside = tempfile::tempdir().expect("a folder");
                    let aside = RunDir::new(aside.path());
                    team.stop.store(resumed, Ordering::Relaxed);
                    let dir = if first { dir } else { &aside };
                    trainer.run(dir, &team.stop, &mut |_| {}).expect("it ends");
                });
            }
        });
        assert!(dir.best().exists());
    }
}

/// An iteration that is given up anywhere leaves no trace: the run goes on from its checkpoint as
/// if nobody had stopped it. This holds for one process and for two, in turn and overlapped, and
/// with memories of policy and critic.
#[test]
fn iterations_that_are_given_up_leave_no_trace() {
    const ITERATIONS: u64 = 3;
    let gru = ["network.encoder=gru", "network.chunk_length=5"];
    let short = ["train.rollout_steps=10"];
    for (method, size, more) in [
        ("ex-iwol", 1, &short[..]),
        ("mappo", 1, &[&gru[..], &short].concat()),
        ("mappo", 1, &OVERLAP),
        ("ex-iwol", 2, &short),
    ] {
        // Stops in a rollout or in an update once it has been asked `at` times after the first
        // iteration; returns what the run comes to, and whether it was stopped.
        let run = |in_update: bool, at: usize| {
            let ends = Mutex::new(Vec::new());
            std::thread::scope(|scope| {
                for ranks in threads(size) {
                    let ends = &ends;
                    scope.spawn(move || {
                        let team = Team::new(ranks, Arc::default());
                        let new = |last: Option<&Checkpoint>| {
                            let trainer =
                                Trainer::among(config(method, more), environment(), last, &team);
                            trainer.expect("a trainer")
                        };
                        let mut trainer = new(None);
                        trainer.iterate().expect("an iteration");
                        let asked = AtomicUsize::new(0);
                        let stop = || asked.fetch_add(1, Ordering::Relaxed) >= at;
                        let (stop, never): (Stop<'_>, Stop<'_>) = (&stop, &|| false);
                        let (rollout, update) =
                            if in_update { (never, stop) } else { (stop, never) };
                        let mut stopped = false;
                        while trainer.progress().iteration < ITERATIONS {
                            let begin = trainer.ahead.is_none().then(|| trainer.collector.mark());
                            match trainer.iterate_until(Stops { rollout, update }) {
                                Ok(_) => {}
                                Err(super::Error::Stopped) => {
                                    let begin = begin.map(|begin| trainer.checkpoint_at(begin));
                                    let last = begin.unwrap_or_else(|| trainer.checkpoint());
                                    trainer = new(Some(&last));
                                    stopped = true;
                                    break;
                                }
                                Err(error) => panic!("{error}"),
                            }
                        }
                        while trainer.progress().iteration < ITERATIONS {
                            trainer.iterate().expect("an iteration");
                        }
                        let end = (content(&trainer.checkpoint()), stopped);
                        ends.lock().expect("no thread panicked").push(end);
                    });
                }
            });
            ends.into_inner().expect("no thread panicked")
        };
        let whole = &run(true, usize::MAX)[0];
        assert!(!whole.1);
        for in_update in [false, true] {
            for at in [0, 1, 3, 7] {
                for (end, stopped) in run(in_update, at) {
                    assert!(stopped, "{method}, {size}: {in_update} {at} is too late");
                    assert!(end == whole.0, "{method}, {size}: stopped at {in_update} {at}");
                }
            }
        }
    }
}

/// A run with fewer worlds or shards than ranks is refused, with the setting.
#[test]
fn ranks_have_something_to_do() {
    for key in ["train.envs", "ppo.shards"] {
        let team = Team::new(threads(2).remove(0), Arc::default());
        let settings = config("mappo", &[&format!("{key}=1")]);
        let error = Trainer::among(settings, environment(), None, &team).err().expect("refused");
        assert!(error.to_string().starts_with(&format!("{key} is 1")), "{error}");
    }
}

#[test]
fn work_is_divided_without_gaps() {
    for (size, count) in [(1, 5), (2, 5), (3, 5), (4, 2), (5, 5)] {
        let all: Vec<usize> = (0..size).flat_map(|rank| part_of(rank, size, count)).collect();
        assert_eq!(all, (0..count).collect::<Vec<_>>());
    }
}

/// Each validation plays other episodes. The weights are the same, because nothing is learned.
#[test]
fn validations_differ_in_their_episodes() {
    let still = ["ppo.learning_rate=0", "ppo.learning_rate_follows_noise=false"];
    let (_, lines) = trained(1, "mappo", &still);
    let outcome = |line: &String| {
        let mut line: serde_json::Map<String, serde_json::Value> =
            serde_json::from_str(line).expect("JSON");
        line.retain(|key, _| key != "step");
        serde_json::to_string(&line).expect("JSON")
    };
    let outcomes: Vec<_> = lines.iter().map(outcome).collect();
    let [first, second] = [&outcomes[..7], &outcomes[7..14]];
    assert_ne!(first, second);
}

const OVERLAP: [&str; 2] = ["train.overlap=true", "train.rollout_steps=10"];

/// A run that plays and learns at the same time goes on from its checkpoint bit for bit, also after
/// validations that change the schedule, and with memories.
#[test]
fn overlapped_trainings_resume_bit_for_bit() {
    let gru = ["network.encoder=gru", "network.chunk_length=5"];
    for (method, more) in [("ex-iwol", &[][..]), ("mappo", &gru)] {
        let run = |stops: &[u64]| {
            let folder = tempfile::tempdir().expect("a folder");
            let file = folder.path().join("last.safetensors");
            for iterations in stops {
                let settings = config(method, &[&OVERLAP[..], more].concat());
                let last = file.exists().then(|| Checkpoint::load(&file).expect("loaded"));
                let team = Team::alone();
                let trainer = Trainer::among(settings, environment(), last.as_ref(), &team);
                let mut trainer = trainer.expect("a trainer");
                for _ in 0..*iterations {
                    trainer.iterate().expect("an iteration");
                }
                trainer.checkpoint().save(&file).expect("saved");
            }
            content(&Checkpoint::load(&file).expect("loaded"))
        };
        assert!(run(&[5]) == run(&[1, 3, 1]), "{method}");
    }
}

/// The first update is that of a training in turn. The rollout played beside it is of the policy
/// before the update: that of a training that learns nothing.
#[test]
fn the_policy_that_plays_is_one_update_old() {
    let trainer = |more: &[&str]| {
        let settings = config("mappo", &[&["train.rollout_steps=10"], more].concat());
        Trainer::new(settings, environment()).expect("a trainer")
    };
    let weights = |trainer: &Trainer| content(&trainer.checkpoint()).0;
    let mut overlapped = trainer(&OVERLAP);
    let mut in_turn = trainer(&[]);
    let mut still = trainer(&["ppo.learning_rate=0", "ppo.learning_rate_follows_noise=false"]);
    for trainer in [&mut overlapped, &mut in_turn, &mut still] {
        trainer.iterate().expect("an iteration");
    }
    assert!(weights(&overlapped) == weights(&in_turn));
    assert!(weights(&overlapped) != weights(&still));
    for trainer in [&mut overlapped, &mut in_turn, &mut still] {
        trainer.iterate().expect("an iteration");
    }
    let played = |trainer: &Trainer| {
        let rollout = &trainer.rollout;
        (rollout.action.clone(), rollout.log_prob.clone(), rollout.reward.clone())
    };
    assert!(played(&overlapped) == played(&still));
    assert!(played(&overlapped) != played(&in_turn));
}

/// The environment of these tests, whose worlds fail once after some steps.
struct Failing {
    inner: Box<dyn Environment>,
    /// Steps of a training's worlds up to the failure.
    steps: usize,
}

struct FailingWorlds {
    inner: Box<dyn Worlds>,
    left: usize,
}

impl Environment for Failing {
    fn name(&self) -> &str {
        self.inner.name()
    }
    fn spec(&self) -> &EnvSpec {
        self.inner.spec()
    }
    fn start(&self, stream: &Stream) -> Result<Box<dyn Worlds>, env::Error> {
        let left = if stream.training { self.steps } else { usize::MAX };
        Ok(Box::new(FailingWorlds { inner: self.inner.start(stream)?, left }))
    }
    fn restore(&self, _: &Stream, _: &[WorldState]) -> Result<Box<dyn Worlds>, env::Error> {
        unreachable!("it starts once")
    }
    fn backdrop(&self) -> Result<Backdrop, env::Error> {
        self.inner.backdrop()
    }
}

impl Worlds for FailingWorlds {
    fn count(&self) -> usize {
        self.inner.count()
    }
    fn view(&self, e: usize) -> WorldView<'_> {
        self.inner.view(e)
    }
    fn step(&mut self, actions: &[f32]) -> Result<(), env::Error> {
        if self.left == 0 {
            return Err(env::Error::Long { net: "failing".to_owned(), metres: 1.0, limit: 0.0 });
        }
        self.left -= 1;
        self.inner.step(actions)
    }
    fn take_finished(&mut self) -> Vec<EpisodeRecord> {
        self.inner.take_finished()
    }
    fn states(&self) -> Vec<WorldState> {
        self.inner.states()
    }
    fn picture(&self, e: usize) -> Option<Picture> {
        self.inner.picture(e)
    }
}

/// After its worlds have failed, a run goes on as if they had not, whether it was playing beside an
/// update or in turn with it.
#[test]
fn a_failed_rollout_is_played_again() {
    for overlap in ["train.overlap=true", "train.overlap=false"] {
        let settings = || config("mappo", &[overlap, "train.rollout_steps=10"]);
        let run = |environment: Box<dyn Environment>, dir: &RunDir| {
            let last = dir.last().exists().then(|| Checkpoint::load(&dir.last()).expect("loaded"));
            let team = Team::alone();
            let trainer = Trainer::among(settings(), environment, last.as_ref(), &team);
            trainer.expect("a trainer").run(dir, &team.stop, &mut |_| {})
        };
        let [whole, broken] = [(); 2].map(|()| tempfile::tempdir().expect("a folder"));
        let [whole, broken] = [&whole, &broken].map(|folder| RunDir::new(folder.path()));
        run(environment(), &whole).expect("it runs");
        // In the first rollout, and in a later one.
        for steps in [7, 33] {
            let _ = std::fs::remove_file(broken.last());
            let failing = Failing { inner: environment(), steps };
            let error = run(Box::new(failing), &broken).expect_err("it fails");
            assert!(matches!(error, super::Error::Env(_)), "{error}");
            run(environment(), &broken).expect("it goes on");
            let [one, other] = [&whole, &broken]
                .map(|dir| content(&Checkpoint::load(&dir.last()).expect("a checkpoint")));
            assert!(one == other, "{overlap}, {steps}");
        }
    }
}

/// What cannot be overlapped is refused.
#[test]
fn overlaps_are_refused_where_they_cannot_be() {
    let team = Team::new(threads(2).remove(0), Arc::default());
    let settings = config("mappo", &OVERLAP);
    let error = Trainer::among(settings, environment(), None, &team).err().expect("refused");
    assert!(error.to_string().starts_with("train.overlap is true, but 2 processes"), "{error}");
    let navigation = env::NamedEnvironment::find("navigation").expect("there").environment();
    let sets = vec!["algorithm=maddpg".to_owned(), "train.overlap=true".to_owned()];
    let layers = Layers { sets, ..Layers::default() };
    let error = layers.for_environment(&*navigation).expect_err("refused").to_string();
    assert!(error.contains("train.overlap") && error.contains("replay buffer"), "{error}");
}

/// After an iteration, the activity is the update, with all of its gradient steps; the next one
/// begins to count anew.
#[test]
fn the_activity_counts_the_steps_of_each_stage() {
    let settings = config("mappo", &["ppo.epochs=3", "train.validate_every=100000"]);
    let samples = settings.train.envs * settings.train.rollout_steps * settings.agents as usize;
    let minibatches = samples.div_ceil(settings.learner.ppo.minibatch);
    let mut trainer = Trainer::new(settings, environment()).expect("a trainer");
    let activity = trainer.activity();
    assert!(activity.present().is_none());
    let folder = tempfile::tempdir().expect("a folder");
    let (dir, mut counts) = (RunDir::new(folder.path()), Vec::new());
    let never = AtomicBool::new(false);
    trainer
        .run(&dir, &never, &mut |_| {
            let present = activity.present().expect("an update has begun");
            assert_eq!(present.stage, Stage::Update);
            counts.push(present.count as usize);
        })
        .expect("it runs");
    assert!(counts.len() > 1 && counts.iter().all(|count| *count == 3 * minibatches), "{counts:?}");
    assert_eq!(activity.present().map(|present| present.stage), Some(Stage::Validation));
}
