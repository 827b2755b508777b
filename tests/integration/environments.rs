//! Environments of one's own: methods learn in them, runs go on bit for bit, and mistakes are named.

use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use iwol_sumo::algo;
use iwol_sumo::checkpoint::Checkpoint;
use iwol_sumo::config::{Config, Document, Layers};
use iwol_sumo::env::{
    ActionDimension, ActionSpace, Better, EnvSpec, Environment, Features, Figure, FigureStatus,
    Frame, MultiAgentEnv, OwnMetric, Picture, Simple, Stream, WorldPhase, Worlds,
};
use iwol_sumo::evaluate::{EvaluationObserver, Policy, evaluate};
use iwol_sumo::metrics::Metrics;
use iwol_sumo::replay::{Recorder, Recording, Title};
use iwol_sumo::rng::{self, Seed};
use iwol_sumo::train::{RunDir, Trainer};
use toml::Value;

use crate::support::{folder, iwol};

const AGENTS: usize = 3;

/// Agents on a line walk to the place that they see. An agent that stands there has arrived; the
/// third one comes in the third step.
struct Line {
    spec: EnvSpec,
    /// Place and goal.
    agents: [[f32; 2]; AGENTS],
    step: u32,
    arrived: usize,
    mistake: Mistake,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Mistake {
    None,
    NoNumber,
    Vanishing,
    Panic,
    OtherSize,
    NoFlag,
    NoEnd,
    NoShare,
    NegativeCount,
    EndsAtOnce,
    TwoEnds,
    ActsOn,
    Uninvited,
    TooEarly,
    /// An episode ends earlier in later worlds.
    Chance,
    /// Other places are drawn in later worlds.
    OtherPlaces,
    /// Everybody earns 1 in each step.
    PaysAll,
    /// Everybody hears everybody, who is not there as well.
    HearsAll,
    /// At the time limit, all slots are truncated.
    TruncatesAll,
}

/// Number of worlds that were made of an environment that depends on it.
static MADE: AtomicU32 = AtomicU32::new(0);

impl Line {
    fn new(mistake: Mistake) -> Self {
        let features = || Features::of("way", &[("left", "1", -1.0, 1.0), ("time", "1", 0.0, 1.0)]);
        if [Mistake::Chance, Mistake::OtherPlaces].contains(&mistake) {
            MADE.fetch_add(1, Ordering::Relaxed);
        }
        let spec = EnvSpec {
            agents: AGENTS,
            actions: vec![ActionDimension::named("speed")].into(),
            observation: features(),
            state: features(),
            most_heard: (mistake == Mistake::HearsAll).then_some(AGENTS - 1),
            metrics: vec![
                OwnMetric::count("steps", Better::Lower),
                OwnMetric::rate("share", Better::Higher),
            ],
        };
        Self { spec, agents: [[0.0; 2]; AGENTS], step: 0, arrived: 0, mistake }
    }

    fn observe(&self, frame: &mut Frame) {
        for (i, [place, goal]) in self.agents.into_iter().enumerate() {
            let seen = [goal - place, self.step as f32 / 30.0];
            frame.observation_of(i).copy_from_slice(&seen);
            frame.state_of(i).copy_from_slice(&seen);
        }
    }

    fn hear(frame: &mut Frame) {
        for i in 0..AGENTS {
            for j in 0..AGENTS {
                frame.comm[i * AGENTS + j] = frame.active[i] * frame.active[j];
            }
        }
    }
}

impl MultiAgentEnv for Line {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn reset(&mut self, seed: Seed, frame: &mut Frame) {
        let other = u64::from(MADE.load(Ordering::Relaxed));
        let seed = if self.mistake == Mistake::OtherPlaces { seed.index(other) } else { seed };
        rng::fill_uniform(&mut seed.rng(), self.agents.as_flattened_mut());
        (self.step, self.arrived) = (0, 0);
        frame.active.copy_from_slice(&[1.0, 1.0, 0.0]);
        Self::hear(frame);
        self.observe(frame);
        match self.mistake {
            Mistake::EndsAtOnce => frame.end(1),
            Mistake::HearsAll => frame.comm.fill(1.0),
            _ => {}
        }
    }

    fn step(&mut self, actions: &[f32], frame: &mut Frame) {
        self.step += 1;
        for (i, action) in actions.iter().enumerate() {
            if frame.active[i] == 0.0 {
                continue;
            }
            assert!(action.abs() <= 1.0, "actions are within their bounds");
            let [place, goal] = &mut self.agents[i];
            let before = (*goal - *place).abs();
            *place += 0.1 * action;
            let after = (*goal - *place).abs();
            frame.reward[i] = before - after;
            if after < 0.1 {
                frame.reward[i] += 1.0;
                self.arrived += 1;
                frame.end(i);
            } else if self.step == 30 {
                frame.truncate(i);
            }
        }
        if self.mistake == Mistake::TruncatesAll && self.step == 30 {
            let ended = frame.terminated.clone();
            (0..AGENTS).filter(|&i| ended[i] == 0.0).for_each(|i| frame.truncate(i));
        }
        if self.step == 3 {
            frame.begin_agent(2);
        }
        if self.mistake != Mistake::HearsAll {
            Self::hear(frame);
        }
        if self.mistake == Mistake::PaysAll {
            frame.reward.fill(1.0);
        }
        self.observe(frame);
        if self.step == 5 {
            match self.mistake {
                Mistake::NoNumber => frame.observation_of(1)[0] = f32::NAN,
                Mistake::Vanishing => frame.active.fill(0.0),
                Mistake::Panic => panic!("there is no sixth step"),
                Mistake::OtherSize => frame.observation.push(0.0),
                Mistake::NoFlag => frame.comm[1] = 0.5,
                Mistake::NoEnd => frame.terminated[0] = 0.5,
                Mistake::TwoEnds => {
                    frame.end(1);
                    frame.truncate(1);
                }
                Mistake::ActsOn => {
                    frame.end(1);
                    frame.active[1] = 1.0;
                }
                _ => {}
            }
        }
        if self.mistake == Mistake::Uninvited && self.step == 2 {
            frame.active[2] = 1.0;
            Self::hear(frame);
        }
        if self.mistake == Mistake::TooEarly && self.step == 4 {
            frame.end(2);
            frame.begin_agent(2);
        }
        if self.mistake == Mistake::Chance && self.step == 3 + MADE.load(Ordering::Relaxed) / 9 {
            (0..AGENTS)
                .filter(|&i| frame.active[i] > 0.0)
                .collect::<Vec<_>>()
                .into_iter()
                .for_each(|i| frame.end(i));
            Self::hear(frame);
        }
    }

    fn goes_on(&self) -> bool {
        self.step < 3
    }

    fn success(&self) -> f64 {
        self.arrived as f64 / AGENTS as f64
    }

    fn metrics(&self) -> Vec<f64> {
        match self.mistake {
            Mistake::NoShare => vec![1.0, 85.0],
            Mistake::NegativeCount => vec![-2.0, 0.5],
            _ => vec![f64::from(self.step), 0.5],
        }
    }

    fn picture(&self) -> Option<Picture> {
        let agent = |[place, _]: [f32; 2]| Figure {
            centre: [f64::from(place), 0.0],
            size: [0.5, 0.5],
            status: FigureStatus::Active,
            ..Figure::default()
        };
        Some(Picture { agents: self.agents.map(agent).to_vec(), ..Picture::default() })
    }
}

fn line(mistake: Mistake) -> Box<dyn Environment> {
    Box::new(Simple::new("line", move || Line::new(mistake)))
}

fn config(algorithm: &str, more: &[&str]) -> Config {
    let flags = vec![("algorithm", Value::String(algorithm.to_owned()))];
    let sets = ["train.envs=4", "train.rollout_steps=64", "ppo.minibatch=128", "ppo.epochs=5"];
    let sets = sets.iter().chain(more).map(ToString::to_string).collect();
    Layers { flags, sets, ..Layers::default() }
        .for_environment(&*line(Mistake::None))
        .expect("settings")
}

fn played(environment: &dyn Environment, policy: &Policy<'_>, episodes: u64) -> Metrics {
    let stop = AtomicBool::new(false);
    let observer =
        EvaluationObserver { stop: &stop, report: &mut |_| {}, recorder: None, beside: false };
    evaluate(environment, policy, episodes, Seed::new(3), observer)
        .expect("it runs")
        .metrics()
        .expect("episodes")
}

/// MAPPO learns the task in seconds, and the metrics of the environment are measured.
#[test]
fn methods_learn_in_an_environment_of_ones_own() {
    let blind = played(&*line(Mistake::None), &Policy::Gaussian, 50);
    assert!(blind.success.mean < 0.9 && blind.driving.is_none(), "{blind:?}");
    assert!(blind.own["steps"].estimate.mean > 5.0, "{:?}", blind.own);
    let mut trainer = Trainer::new(config("mappo", &[]), line(Mistake::None)).expect("a trainer");
    for _ in 0..40 {
        trainer.iterate().expect("an iteration");
    }
    let found = trainer.validate(&AtomicBool::new(false)).expect("it runs").metrics();
    let found = found.expect("episodes");
    assert!(found.success.mean > 0.97, "{:?}", found.success);
}

/// Every method takes its steps, and writes the files of a run without a scenario.
#[test]
fn all_methods_run_in_an_environment_of_ones_own() {
    for name in algo::NAMES {
        let folder = folder();
        let dir = RunDir::new(folder.path().join("run"));
        let settings = ["steps=512", "train.validation_episodes=2", "maddpg.updates=2"];
        let mut trainer = Trainer::new(config(name, &settings), line(Mistake::None)).expect(name);
        trainer.run(&dir, &AtomicBool::new(false), &mut |_| {}).expect(name);
        let text = std::fs::read_to_string(dir.metrics()).expect("metrics");
        assert!(text.contains("validation/success") && !text.contains("safety"), "{name}: {text}");
        assert!(!dir.scenario().exists(), "{name}");
        assert!(Path::new(&dir.last()).exists(), "{name}");
    }
}

/// A run that is stopped and goes on from its file has the same bits as one without a break.
#[test]
fn runs_go_on_bit_for_bit() {
    let weights = |trainer: &Trainer| -> Vec<Vec<f64>> {
        let numbers = |tensor: &tch::Tensor| {
            Vec::try_from(tensor.to_kind(tch::Kind::Double).reshape([-1])).expect("numbers")
        };
        trainer.checkpoint().learner.iter().map(|(_, tensor)| numbers(tensor)).collect()
    };
    let again = "train.repeat_failed=0.5";
    let mut whole = Trainer::new(config("ex-iwol", &[again]), line(Mistake::None)).expect("a run");
    for _ in 0..4 {
        whole.iterate().expect("an iteration");
    }
    let mut first = Trainer::new(config("ex-iwol", &[again]), line(Mistake::None)).expect("a run");
    for _ in 0..2 {
        first.iterate().expect("an iteration");
    }
    let folder = folder();
    let file = folder.path().join("last.safetensors");
    first.checkpoint().save(&file).expect("saved");
    let stored = Checkpoint::load(&file).expect("loaded");
    // The stored settings are settings again.
    let text = stored.config.clone();
    let document = Document { name: "stored".to_owned(), text, generated: true };
    let layers = Layers { document, ..Layers::default() };
    let settings = layers.for_environment(&*line(Mistake::None)).expect("settings");
    let mut second = Trainer::resume(settings, line(Mistake::None), &stored).expect("resumed");
    for _ in 0..2 {
        second.iterate().expect("an iteration");
    }
    assert_eq!(weights(&whole), weights(&second));
    assert_ne!(weights(&whole), weights(&first));
}

/// What happens in an episode depends on its number, and not on the worlds beside it.
#[test]
fn episodes_do_not_depend_on_the_number_of_worlds() {
    let rewards = |worlds: usize| {
        let stream = Stream {
            worlds,
            stride: worlds as u64,
            seed: Seed::new(1),
            episodes: 0..8,
            training: true,
            repeat_failed: 0.0,
            beside: false,
        };
        let environment = line(Mistake::None);
        let mut all: Box<dyn Worlds> = environment.start(&stream).expect("worlds");
        let mut found = Vec::new();
        while !all.is_finished() {
            let acts = |e: usize| {
                let view = all.view(e);
                (0..AGENTS).map(move |i| ((view.episode + i as u64) % 3) as f32 - 1.0)
            };
            let actions: Vec<f32> = (0..worlds).flat_map(acts).collect();
            all.step(&actions).expect("a step");
            found.extend(all.take_finished());
        }
        found.sort_by_key(|record| record.episode);
        found
    };
    let alone = rewards(1);
    assert_eq!(
        alone.iter().map(|record| record.episode).collect::<Vec<_>>(),
        [0, 1, 2, 3, 4, 5, 6, 7]
    );
    assert!(alone.iter().any(|record| record.reward != alone[0].reward));
    assert_eq!(alone, rewards(3));
    assert_eq!(alone, rewards(8));
}

/// Slots change hands: the agent that comes later begins a trajectory of its own, and ended ones
/// are marked once.
#[test]
fn frames_tell_who_comes_and_who_ends() {
    let stream = Stream {
        worlds: 1,
        stride: 1,
        seed: Seed::new(5),
        episodes: 0..1,
        training: true,
        repeat_failed: 0.0,
        beside: false,
    };
    let environment = line(Mistake::None);
    let mut world = environment.start(&stream).expect("a world");
    let (mut begun, mut ended) = ([0; AGENTS], [0; AGENTS]);
    let starts = &world.view(0).frame.start;
    begun.iter_mut().zip(starts).for_each(|(begun, start)| *begun += u32::from(*start > 0.0));
    assert_eq!(begun, [1, 1, 1], "an episode begins in all slots");
    while world.take_finished().is_empty() {
        let frame = world.view(0).frame;
        let acted: Vec<f32> = frame.active.clone();
        world.step(&[0.3, -0.3, 1.0]).expect("a step");
        let frame = world.view(0).frame;
        for i in 0..AGENTS {
            begun[i] += u32::from(frame.start[i] > 0.0);
            ended[i] += u32::from(frame.terminated[i] + frame.truncated[i] > 0.0);
            assert!(acted[i] > 0.0 || frame.reward[i] == 0.0, "who does not act earns nothing");
        }
    }
    assert_eq!((begun, ended), ([1, 1, 2], [1, 1, 1]));
}

/// An absent agent earns nothing, hears nobody and is not heard, whatever the environment writes.
#[test]
fn those_who_are_not_there_do_not_count() {
    let stream = Stream {
        worlds: 1,
        stride: 1,
        seed: Seed::new(5),
        episodes: 0..4,
        training: true,
        repeat_failed: 0.0,
        beside: false,
    };
    let (mut paid, mut heard) = (0.0, 0.0);
    for mistake in [Mistake::PaysAll, Mistake::HearsAll, Mistake::TruncatesAll] {
        let environment = line(mistake);
        let mut world = environment.start(&stream).expect("a world");
        while !world.is_finished() {
            let acted: Vec<f32> = world.view(0).frame.active.clone();
            world.step(&[0.3, -0.3, 1.0]).expect("a step");
            let view = world.view(0);
            if view.phase == WorldPhase::Idle {
                break;
            }
            let frame = view.frame;
            for (i, acted) in acted.iter().enumerate() {
                let there = |i: usize| frame.active[i] + frame.truncated[i] > 0.0;
                assert!(*acted > 0.0 || frame.reward[i] == 0.0, "{mistake:?}");
                assert!(*acted > 0.0 || frame.truncated[i] == 0.0, "{mistake:?}");
                paid += frame.reward[i];
                for j in 0..AGENTS {
                    let hears = frame.comm[i * AGENTS + j];
                    assert!(hears == 0.0 || there(i) && there(j), "{mistake:?}: {:?}", frame.comm);
                    assert!(i != j || !there(i) || hears == 1.0, "{mistake:?}: {:?}", frame.comm);
                    if mistake == Mistake::HearsAll {
                        assert!(hears == f32::from(u8::from(there(i) && there(j))));
                        heard += hears;
                    }
                }
            }
        }
    }
    assert!(paid > 20.0 && heard > 20.0, "{paid} {heard}");
}

/// An episode is recorded and played back as those of vehicles are.
#[test]
fn episodes_are_recorded_for_the_player() {
    let environment = line(Mistake::None);
    let mut recorder = Recorder::new(environment.spec(), 1);
    let stop = AtomicBool::new(false);
    let observer = EvaluationObserver {
        stop: &stop,
        report: &mut |_| {},
        recorder: Some(&mut recorder),
        beside: false,
    };
    let policy = Policy::Constant(vec![0.2]);
    let found = evaluate(&*environment, &policy, 3, Seed::new(3), observer).expect("it runs");
    let title = Title { environment: environment.name(), policy: "slow", seed: 3 };
    let backdrop = environment.backdrop().expect("a backdrop");
    let recording = recorder.finish(&backdrop, &title, Some(&found.episodes[1])).expect("played");
    let folder = folder();
    let file = folder.path().join("episode.json");
    recording.save(&file).expect("saved");
    let again = Recording::load(&file).expect("loaded");
    assert_eq!(again, recording);
    assert_eq!(again.steps, found.episodes[1].episode_length as usize + 1);
    assert_eq!(again.summary["steps"], f64::from(found.episodes[1].episode_length));
    assert!(again.player().contains("line") && again.still(0).contains("<svg"));
}

#[test]
fn mistakes_of_an_environment_are_named() {
    let fails = |mistake: Mistake| {
        let trainer = Trainer::new(config("mappo", &[]), line(mistake));
        let error = trainer.and_then(|mut trainer| trainer.iterate()).expect_err("refused");
        assert!(matches!(error, iwol_sumo::train::Error::Env(_)), "{error:?}");
        error.to_string()
    };
    let text = fails(Mistake::NoNumber);
    assert!(text.contains("step 5: agent 1: observation 0 is NaN"), "{text}");
    let text = fails(Mistake::Vanishing);
    assert!(text.contains("acts no more, but neither `end` nor `truncate` was called"), "{text}");
    let text = fails(Mistake::Panic);
    assert!(text.contains("the environment panicked: there is no sixth step"), "{text}");
    for (mistake, what) in [
        (Mistake::OtherSize, "`observation` has 7 numbers, not 6"),
        (Mistake::NoFlag, "a number in `comm` is 0.5, neither 0 nor 1"),
        (Mistake::NoEnd, "a number in `terminated` is 0.5, neither 0 nor 1"),
        (Mistake::NoShare, "the metric `share` is 85; allowed: a share from 0 to 1"),
        (Mistake::NegativeCount, "the metric `steps` is -2; allowed: a number from 0 on"),
        (Mistake::EndsAtOnce, "agent 1: ends in `reset`"),
        (Mistake::TwoEnds, "agent 1: both `end` and `truncate` were called"),
        (Mistake::ActsOn, "agent 1: acts on after its end"),
        (Mistake::Uninvited, "agent 2: acts, but `begin_agent` was not called"),
        (Mistake::TooEarly, "agent 2: begins in a slot that was in use until this step"),
    ] {
        let text = fails(mistake);
        assert!(text.contains(what), "{mistake:?}: {text}");
    }
    // A run cannot go on in an environment that does not repeat itself.
    let settings = || config("mappo", &["train.rollout_steps=66"]);
    MADE.store(180, Ordering::Relaxed);
    let mut trainer = Trainer::new(settings(), line(Mistake::Chance)).expect("a trainer");
    trainer.iterate().expect("an iteration");
    let stored = trainer.checkpoint();
    MADE.store(0, Ordering::Relaxed);
    let error = Trainer::resume(settings(), line(Mistake::Chance), &stored).err().expect("refused");
    assert!(error.to_string().contains("does not come back to where it was"), "{error}");
    // Nor does it in one that begins an episode elsewhere, although it lasts as long.
    let mut trainer =
        Trainer::new(config("mappo", &[]), line(Mistake::OtherPlaces)).expect("a trainer");
    trainer.iterate().expect("an iteration");
    let stored = trainer.checkpoint();
    let error = Trainer::resume(config("mappo", &[]), line(Mistake::OtherPlaces), &stored);
    let error = error.err().expect("refused").to_string();
    assert!(error.contains("does not come back to where it was"), "{error}");
    // Nor in an environment with another name.
    let other = Simple::new("other", || Line::new(Mistake::None));
    let layers = Layers {
        document: Document { name: "stored".to_owned(), text: stored.config, generated: true },
        ..Layers::default()
    };
    let error = layers.for_environment(&other).expect_err("refused").to_string();
    assert!(error.contains("the settings are for `line`, not for `other`"), "{error}");
    let few = Layers { sets: vec!["train.fewest_agents=2".to_owned()], ..Layers::default() };
    let error = few.for_environment(&*line(Mistake::None)).expect_err("refused");
    assert!(error.to_string().contains("allowed in scenarios only"), "{error}");
    let many = Layers { sets: vec!["agents=5".to_owned()], ..Layers::default() };
    let error = many.for_environment(&*line(Mistake::None)).expect_err("refused").to_string();
    assert!(error.contains("the environment has 3 agents"), "{error}");
}

/// Agents on five places in a row choose a direction; at the ends one of them is closed.
struct Row {
    spec: EnvSpec,
    agents: [[i32; 2]; AGENTS],
    step: u32,
    arrived: usize,
}

impl Row {
    fn new() -> Self {
        let features = || Features::of("way", &[("left", "4", -1.0, 1.0)]);
        let spec = EnvSpec {
            agents: AGENTS,
            actions: ActionSpace::Discrete(vec!["down", "stay", "up"]),
            observation: features(),
            state: features(),
            most_heard: None,
            metrics: Vec::new(),
        };
        Self { spec, agents: [[0; 2]; AGENTS], step: 0, arrived: 0 }
    }

    fn show(&self, frame: &mut Frame) {
        for (i, [place, goal]) in self.agents.into_iter().enumerate() {
            frame.observation_of(i)[0] = (goal - place) as f32 / 4.0;
            frame.state_of(i)[0] = (goal - place) as f32 / 4.0;
            frame.available_to(i).copy_from_slice(&[
                f32::from(u8::from(place > 0)),
                1.0,
                f32::from(u8::from(place < 4)),
            ]);
        }
    }
}

impl MultiAgentEnv for Row {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn reset(&mut self, seed: Seed, frame: &mut Frame) {
        let mut rng = seed.rng();
        self.agents = [[0; 2]; AGENTS].map(|_| [0, 1].map(|_| rng::below(&mut rng, 5) as i32));
        (self.step, self.arrived) = (0, 0);
        frame.active.fill(1.0);
        frame.comm.fill(1.0);
        self.show(frame);
    }

    fn step(&mut self, actions: &[f32], frame: &mut Frame) {
        self.step += 1;
        for i in (0..AGENTS).filter(|&i| frame.active[i] > 0.0).collect::<Vec<_>>() {
            assert!(frame.available_to(i)[actions[i] as usize] > 0.5, "the choice is open");
            self.agents[i][0] += actions[i] as i32 - 1;
            let [place, goal] = self.agents[i];
            frame.reward[i] = if place == goal { 1.0 } else { -0.1 };
            if place == goal {
                self.arrived += 1;
                frame.end(i);
            } else if self.step == 8 {
                frame.truncate(i);
            }
        }
        self.show(frame);
    }

    fn success(&self) -> f64 {
        self.arrived as f64 / AGENTS as f64
    }
}

/// Methods learn to choose, and never choose what is closed.
#[test]
fn methods_learn_discrete_actions() {
    let environment = || Box::new(Simple::new("row", Row::new));
    let blind = played(&*environment(), &Policy::Uniform, 50);
    assert!(blind.success.mean < 0.9, "{:?}", blind.success);
    for name in ["mappo", "ex-iwol"] {
        let flags = vec![("algorithm", Value::String(name.to_owned()))];
        let sets = ["train.envs=4", "train.rollout_steps=64", "ppo.minibatch=128"];
        let sets = sets.map(str::to_owned).to_vec();
        let layers = Layers { flags, sets, ..Layers::default() };
        let config = layers.for_environment(&*environment()).expect("settings");
        let ppo = &config.learner.ppo;
        assert!(ppo.entropy_coefficient == 0.01 && !ppo.learning_rate_follows_noise, "{ppo:?}");
        let mut trainer = Trainer::new(config, environment()).expect("a trainer");
        for _ in 0..40 {
            trainer.iterate().expect("an iteration");
        }
        let found = trainer.validate(&AtomicBool::new(false)).expect("it runs").metrics();
        let success = found.expect("episodes").success;
        assert!(success.mean > 0.97, "{name}: {success:?}");
    }
}

/// Built-in environments are trained, evaluated, resumed, recorded and swept by name.
#[test]
fn built_in_environments_are_used_by_name() {
    let folder = folder();
    let run = folder.path().join("run");
    let name = |path: &Path| path.to_str().expect("text").to_owned();
    let play = |arguments: &[&str]| {
        let output = iwol(arguments).current_dir(folder.path()).output().expect("it runs");
        let text =
            [output.stdout, output.stderr].map(|text| String::from_utf8(text).expect("text"));
        (output.status.success(), text.concat())
    };
    let train = ["train", "--environment", "traffic_junction_easy", "--algorithm", "magic"];
    // Options that have no effect there are refused.
    for (option, why) in [
        ("simulation.backend=libsumo", "the environment is without SUMO"),
        ("scenario.reward.crash=-5", "the environment is without SUMO"),
        ("exploration.correlation=0.5", "actions are discrete, and without noise"),
    ] {
        let (fine, text) = play(&[&train[..], &["--set", option]].concat());
        assert!(!fine && text.contains(option) && text.contains(why), "{text}");
    }
    let maddpg = ["train", "--environment", "traffic_junction_easy", "--algorithm", "maddpg"];
    let (fine, text) = play(&maddpg);
    assert!(!fine && text.contains("maddpg is for continuous actions only"), "{text}");
    let small = ["--set", "train.envs=2", "--set", "train.rollout_steps=20", "--out", &name(&run)];
    let few = ["--set", "train.validation_episodes=2", "--steps", "80"];
    let (fine, text) = play(&[&train[..], &small, &few].concat());
    assert!(fine && text.contains("magic on traffic_junction_easy with 5 agents"), "{text}");
    assert!(text.contains("2 worlds without SUMO"), "{text}");
    let (fine, text) = play(&["train", "--resume", "--out", &name(&run), "--steps", "160"]);
    assert!(fine && text.contains("finished after 160 steps"), "{text}");
    let record = folder.path().join("episode.json");
    let (fine, text) = play(&[
        "evaluate",
        &name(&run),
        "--episodes",
        "3",
        "--policy",
        "uniform",
        "--set",
        "channel.bits=2",
        "--record",
        &name(&record),
    ]);
    assert!(fine && text.contains("collisions") && text.contains("cars"), "{text}");
    assert!(!text.contains("safety"), "there are no vehicles of SUMO: {text}");
    let (fine, text) = play(&["replay", &name(&record), "--out", "episode.html"]);
    assert!(fine, "{text}");

    let sweep = folder.path().join("tiny.toml");
    let file = "title = \"Tiny\"\n[settings]\nenvironment = \"traffic_junction_easy\"\nsteps = 80\n\
                train = { envs = 2, rollout_steps = 20, validation_episodes = 2 }\n\
                [grid]\nalgorithm = [\"mappo\"]\nseed = [0]\n[[evaluate]]\nepisodes = 2\n";
    std::fs::write(&sweep, file).expect("written");
    let (fine, text) = play(&["sweep", &name(&sweep)]);
    assert!(fine, "{text}");
    let (fine, text) = play(&["report", &name(&sweep)]);
    assert!(fine, "{text}");

    for (arguments, why) in [
        (vec!["train", "--environment", "trafic_junction"], "did you mean `traffic_junction`?"),
        (vec!["train", "--environment", "traffic_junction", "--agents", "4"], "has 10 agents"),
        (
            vec!["train", "--environment", "traffic_junction", "--algorithm", "maddpg"],
            "is for continuous actions only",
        ),
        (
            vec!["evaluate", "--environment", "traffic_junction", "--policy", "sumo"],
            "choose uniform, or gaussian",
        ),
        (
            vec!["train", "--environment", "traffic_junction", "--set", "scenario=a.xml"],
            "give either a scenario or an environment",
        ),
    ] {
        let (fine, text) = play(&arguments);
        assert!(!fine && text.contains(why), "{arguments:?}: {text}");
    }
}
