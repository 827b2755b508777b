//! Whom a policy imitates at first ([`Train::imitate_steps`](crate::config::Train)): pure pursuit of its route, or a policy that was trained
//! before on the same scenario and may see more (kickstarting: Schmitt et al., 2018; learning by cheating: Chen et al., CoRL 2019).

use std::path::{Path, PathBuf};

use tch::{Device, Kind, Tensor};
use toml::Value;

use crate::algo::{self, ActMode, Algorithm, Observation};
use crate::checkpoint::{self, Checkpoint};
use crate::config::{self, Config, Document, Layers};
use crate::env::{self, Pursuit, Task, VecEnv};
use crate::fnv::Fnv;
use crate::rng::Seed;

use super::RunDir;

/// A name for the weights of the policy that a run imitates, which other weights do not have; none where it imitates none, or they
/// cannot be read.
pub fn fingerprint(config: &Config) -> Option<String> {
    let path = &config.train.teacher;
    let named = config.train.imitate_steps > 0 && !path.as_os_str().is_empty();
    let weights = named.then(|| std::fs::read(RunDir::checkpoint(path)).ok())??;
    let mut hash = Fnv::new();
    hash.bytes(&weights);
    Some(hash.to_string())
}

/// Who shows what to do.
pub(super) enum Teacher {
    /// Pure pursuit of the route.
    Pursuit(Pursuit),
    /// A trained policy, and the task as it sees it.
    Policy { learner: Box<dyn Algorithm>, task: Box<Task> },
}

impl Teacher {
    /// The one that a run's settings name.
    ///
    /// # Errors
    /// When there is no policy where they say, or it is not for this task.
    pub(super) fn new(config: &Config) -> Result<Self, Error> {
        let path = &config.train.teacher;
        if path.as_os_str().is_empty() {
            return Ok(Self::Pursuit(Pursuit {
                speed: config.train.imitate_speed,
                gives_way: config.train.imitate_yields,
            }));
        }
        let (learner, task) =
            load(path, config).map_err(|source| Error { path: path.clone(), source: Box::new(source) })?;
        Ok(Self::Policy { learner, task: Box::new(task) })
    }

    /// What it would do before the next step in the worlds of `env`: `actions: [E, N, A]`.
    pub(super) fn show(&self, env: &VecEnv, actions: &mut [f32]) {
        let spec = env.spec();
        let world = spec.agents * spec.actions.len();
        match self {
            Self::Pursuit(pursuit) => {
                env.worlds().zip(actions.chunks_mut(world)).for_each(|(world, acts)| world.pursue(*pursuit, acts));
            }
            Self::Policy { learner, task } => {
                let (e, n) = (env.len() as i64, spec.agents as i64);
                let width = task.spec.observation.len();
                let mut seen = vec![0.0; env.len() * spec.agents * width];
                let mut comm = vec![0.0; env.len() * spec.agents * spec.agents];
                let views = seen.chunks_mut(spec.agents * width).zip(comm.chunks_mut(spec.agents * spec.agents));
                env.worlds().zip(views).for_each(|(world, (seen, comm))| world.observe_as(task, seen, comm));
                let decision = learner.act(
                    &Observation {
                        observation: Tensor::from_slice(&seen).view([e, n, -1]),
                        comm: Tensor::from_slice(&comm).view([e, n, n]),
                        start: Tensor::zeros([e], (Kind::Float, Device::Cpu)),
                        memory: Tensor::zeros([e, n, 0], (Kind::Float, Device::Cpu)),
                    },
                    &ActMode::Deterministic,
                );
                // The environment clips actions; what lies beyond the bounds is not worth imitating.
                let shown = decision.action.clamp(-1.0, 1.0).reshape([-1]);
                shown.copy_data(actions, actions.len());
            }
        }
    }
}

/// The policy of a run folder or checkpoint, in the scenario and with the agents of `config`, and the task as it sees it.
fn load(path: &Path, config: &Config) -> Result<(Box<dyn Algorithm>, Task), Unfit> {
    let stored = Checkpoint::load(&RunDir::checkpoint(path))?;
    let layers = Layers {
        document: Document::of_run(format!("{} (stored settings)", path.display()), stored.config.clone()),
        sets: Vec::new(),
        flags: vec![
            ("scenario", Value::String(config.scenario.display().to_string())),
            ("agents", Value::Integer(config.agents.into())),
            ("env.penetration", Value::Float(config.env.penetration)),
        ],
    };
    let (mut taught, scenario) = Config::resolve(&layers).map_err(Box::new)?;
    let task = Task::new(&scenario, config.agents)?;
    // It learns nothing any more.
    taught.ppo.shards = 1;
    let mut learner = algo::build(&stored.algorithm, &task.spec, &taught.settings(), Seed::new(0), Device::Cpu)?;
    learner.load_weights(&stored.learner)?;
    if learner.memory() > 0 {
        return Err(Unfit::Memory);
    }
    Ok((learner, task))
}

/// A teacher that cannot teach.
#[derive(Debug, thiserror::Error)]
#[error("`train.teacher`: the policy in `{}` cannot be imitated here", path.display())]
pub struct Error {
    /// What was named.
    pub path: PathBuf,
    /// Why not.
    source: Box<Unfit>,
}

#[derive(Debug, thiserror::Error)]
enum Unfit {
    #[error(transparent)]
    Checkpoint(#[from] checkpoint::Error),
    #[error(transparent)]
    Config(#[from] Box<config::Error>),
    #[error(transparent)]
    Task(#[from] env::Error),
    #[error(transparent)]
    Algorithm(#[from] algo::Error),
    #[error(
        "it has a memory, which would be lost when training is resumed; choose one of another method than ICP, without `network.encoder = \"gru\"`"
    )]
    Memory,
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::checkpoint::Progress;
    use crate::env::{Driver, VecOptions};
    use crate::scenario::Scenario;
    use crate::sumo::Hosting;

    fn resolve(sets: &[&str]) -> (Config, Scenario) {
        let scenario = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/intersection.xml");
        let flags = vec![("scenario", Value::String(scenario.display().to_string()))];
        let sets = sets.iter().map(|set| (*set).to_owned()).collect();
        Config::resolve(&Layers { sets, flags, ..Layers::default() }).expect("a valid configuration")
    }

    fn taught_by(path: &Path) -> (Config, Scenario) {
        let (mut config, scenario) = resolve(&["env.observation=nearest"]);
        (config.train.teacher, config.train.imitate_steps) = (path.to_owned(), 1);
        (config, scenario)
    }

    /// Saves a policy with new weights.
    fn save((config, scenario): &(Config, Scenario), path: &Path) {
        let task = Task::new(scenario, config.agents).expect("a task");
        let learner = algo::build(&config.algorithm, &task.spec, &config.settings(), Seed::new(0), Device::Cpu);
        let checkpoint = Checkpoint {
            progress: Progress::default(),
            config: config.to_toml(),
            algorithm: config.algorithm.clone(),
            learner: learner.expect("a learner").state(),
            worlds: Vec::new(),
            memory: Vec::new(),
        };
        checkpoint.save(path).expect("saved");
    }

    /// What the policy in `path` shows in thirty steps of two worlds, where agents see what `sets`
    /// say.
    fn shown(path: &Path, sets: &[&str]) -> Vec<f32> {
        let (mut config, scenario) = resolve(sets);
        (config.train.teacher, config.train.imitate_steps) = (path.to_owned(), 1);
        let task = Arc::new(Task::new(&scenario, config.agents).expect("a task"));
        let teacher = Teacher::new(&config).expect("a policy");
        let options = VecOptions {
            worlds: 2,
            driver: Driver::Agents,
            seed: Seed::new(3),
            episodes: 0..2,
            replay: 0.0,
            hosting: Hosting { processes: 1, ..Hosting::default() }.beside(),
        };
        let mut env = VecEnv::new(&task, &options).expect("SUMO runs");
        let mut actions = vec![0.0; env.len() * task.agents * task.spec.actions.len()];
        let mut all = Vec::new();
        for _ in 0..30 {
            teacher.show(&env, &mut actions);
            env.step(&actions).expect("SUMO answers");
            all.extend_from_slice(&actions);
        }
        all
    }

    /// A policy shows the same whatever its students see: it sees what it saw in training.
    #[test]
    fn a_teacher_sees_more_than_its_students() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("teacher.safetensors");
        save(&resolve(&[]), &path);
        let actions = shown(&path, &["env.observation=nearest"]);
        assert_eq!(actions, shown(&path, &[]));
        assert!(actions.iter().any(|action| *action != actions[0]), "it does not look");
    }

    #[test]
    fn who_cannot_teach_is_refused_with_the_reason() {
        let folder = tempfile::tempdir().expect("a folder");
        let why = |path: &Path| {
            let error = Teacher::new(&taught_by(path).0).err().expect("must be refused");
            let source = std::error::Error::source(&error).expect("a reason");
            (error.to_string(), source.to_string())
        };
        let nowhere = folder.path().join("nowhere");
        let (what, _) = why(&nowhere);
        assert!(what.contains("train.teacher") && what.contains("nowhere"), "{what}");

        let forgetful = folder.path().join("gru.safetensors");
        save(&resolve(&["network.encoder=gru"]), &forgetful);
        let (_, reason) = why(&forgetful);
        assert!(reason.contains("memory"), "{reason}");
    }
}
