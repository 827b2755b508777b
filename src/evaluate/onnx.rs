//! Policies from ONNX files in an evaluation, whoever trained them.
//!
//! Inputs and output are those of the models that `iwol export --onnx` writes (`algo/onnx.rs`):
//! `observation [batch, agents, O]`, if the model has it `comm [batch, agents, agents]`, and
//! `action [batch, agents, A]`, or `logits [batch, agents, K]` where actions are discrete.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use rten::{Dimension, Model, NodeId, RunOptions, ThreadPool, ValueView};
use serde_json::Value;

use super::{Actor, Controller, WORLDS};
use crate::algo::onnx;
use crate::env::{self, ActionSpace, EnvSpec, Frame, Worlds, names_differ};
use crate::replay::RecordedDiagnostics;
use crate::rng::Seed;

/// An ONNX file cannot be used as a policy.
#[derive(Debug, thiserror::Error)]
#[error("{}: {what}", file.display())]
pub struct OnnxError {
    /// The file.
    file: PathBuf,
    /// What is wrong with it.
    what: String,
}

/// A policy from an ONNX file.
pub struct OnnxPolicy {
    model: Model,
    observation: NodeId,
    comm: Option<NodeId>,
    /// The node of the actions or of the logits.
    action: NodeId,
    /// Whether actions are discrete.
    discrete: bool,
    /// Number of worlds of one run of the model: what the file says, or else [`WORLDS`].
    batch: usize,
    /// N, O, and A or K.
    sizes: [usize; 3],
    options: RunOptions,
}

impl OnnxPolicy {
    /// Reads a file, for use in an environment.
    ///
    /// # Errors
    /// [`OnnxError`] if the file is no ONNX model, has other inputs and outputs, is for another
    /// number of agents, or observes something else than the environment's agents do. If the file has
    /// the metadata of `iwol export --onnx`, the names and scales of the observation's numbers and
    /// the time between decisions, `interval` \[s\], are compared.
    pub fn load(file: &Path, spec: &EnvSpec, interval: Option<f64>) -> Result<Self, OnnxError> {
        Self::read(file, spec, interval).map_err(|what| OnnxError { file: file.to_owned(), what })
    }

    fn read(file: &Path, spec: &EnvSpec, interval: Option<f64>) -> Result<Self, String> {
        // The library recognises the format of a file by the ending of its name.
        if file.extension().is_none_or(|end| end != "onnx") {
            return Err("must have a name that ends in .onnx; rename it".to_owned());
        }
        std::fs::File::open(file).map_err(|error| format!("cannot be read: {error}"))?;
        let model = Model::load_file(file).map_err(|error| format!("is no ONNX model: {error}"))?;
        let sizes @ [n, o, a] = [spec.agents, spec.observation.len(), spec.actions.encoded()];
        let named = |nodes: &[NodeId], name: &str| {
            let of = |node: &&NodeId| model.node_info(**node).and_then(|node| node.name());
            nodes.iter().find(|node| of(node) == Some(name)).copied()
        };
        let names = |nodes: &[NodeId]| {
            let names = nodes.iter().filter_map(|&node| model.node_info(node)?.name());
            names.collect::<Vec<_>>().join(", ")
        };
        let (inputs, outputs) = (model.input_ids(), model.output_ids());
        let (observation, comm) = (named(inputs, "observation"), named(inputs, "comm"));
        let expected = format!(
            "observation [batch, {n}, {o}], and comm [batch, {n}, {n}] for policies with messages"
        );
        let observation =
            observation
                .filter(|_| inputs.len() == 1 + usize::from(comm.is_some()))
                .ok_or_else(|| format!("has the inputs {}; allowed: {expected}", names(inputs)))?;
        let output = onnx::output(&spec.actions);
        let action = named(outputs, output).ok_or_else(|| {
            format!("has the outputs {}, but none called {output}", names(outputs))
        })?;
        let mut batch = WORLDS;
        let parts = [Some(("observation", observation, o)), comm.map(|comm| ("comm", comm, n))];
        for (name, node, width) in parts.into_iter().flatten().chain([(output, action, a)]) {
            let Some(shape) = model.node_info(node).and_then(|node| node.shape()) else { continue };
            let [first, agents, numbers] = &shape[..] else {
                return Err(format!("{name} has {} dimensions instead of 3", shape.len()));
            };
            let differs = |found: &Dimension, wanted: usize| match found {
                Dimension::Fixed(size) if *size != wanted => Some(*size),
                _ => None,
            };
            if let Some(size) = differs(agents, n) {
                return Err(format!(
                    "is for {size} agents; the task has {n}: evaluate it with --agents {size}"
                ));
            }
            if let Some(size) = differs(numbers, width) {
                return Err(format!(
                    "{name} has {size} numbers per agent; the task and its settings define {width}"
                ));
            }
            if let Dimension::Fixed(size) = first {
                batch = (*size).max(1);
            }
        }
        if let Some(text) = model.metadata().get("policy") {
            let policy: Value = serde_json::from_str(text)
                .map_err(|error| format!("the metadata `policy` are no JSON: {error}"))?;
            compare_names(&policy, spec)?;
            compare_interval(&policy, interval)?;
        }
        // Networks are small: threads would wait for each other.
        let pool = Arc::new(ThreadPool::with_num_threads(1));
        let options = RunOptions::default().with_thread_pool(Some(pool));
        let discrete = matches!(spec.actions, ActionSpace::Discrete(_));
        let policy = Self { model, observation, comm, action, discrete, batch, sizes, options };
        policy.run(&vec![0.0; batch * n * o], &vec![0.0; batch * n * n])?;
        Ok(policy)
    }

    /// Returns the actions `[batch, N, A]` or the logits `[batch, N, K]` for
    /// `observation [batch, N, O]` and `comm [batch, N, N]`.
    fn run(&self, observation: &[f32], comm: &[f32]) -> Result<Vec<f32>, String> {
        let (batch, [n, o, a]) = (self.batch, self.sizes);
        let view = |width: usize, data| {
            ValueView::from_shape([batch, n, width], data).map_err(|error| error.to_string())
        };
        let mut inputs = vec![(self.observation, view(o, observation)?.into())];
        if let Some(node) = self.comm {
            inputs.push((node, view(n, comm)?.into()));
        }
        let outputs = self.model.run_n(inputs, [self.action], Some(self.options.clone()));
        let [action] = outputs.map_err(|error| format!("cannot be computed: {error}"))?;
        let wanted = [batch, n, a];
        match action.into_shape_vec::<f32, 3>() {
            Ok((shape, actions)) if shape == wanted => Ok(actions),
            Ok((shape, _)) => Err(format!("action has the shape {shape:?} instead of {wanted:?}")),
            Err(error) => Err(format!("action is no array {wanted:?} of float32: {error}")),
        }
    }
}

/// Compares the names of the numbers of observations and actions with those of an environment, and
/// the scales of observations. `policy` is the JSON that `iwol export --onnx` writes.
fn compare_names(policy: &Value, spec: &EnvSpec) -> Result<(), String> {
    let features = &spec.observation.list;
    let observation = features.iter().map(|feature| feature.name.as_str()).collect();
    let actions = match &spec.actions {
        ActionSpace::Continuous(_) => spec.actions.names(),
        ActionSpace::Discrete(choices) => choices.clone(),
    };
    for (part, ours) in [("observation", observation), ("actions", actions)] {
        let Some(rows) = policy[part].as_array() else { continue };
        let theirs: Vec<&str> = rows.iter().filter_map(|row| row["name"].as_str()).collect();
        if let Some(difference) = names_differ(part, &theirs, &ours) {
            return Err(difference);
        }
    }
    let rows = policy["observation"].as_array().into_iter().flatten();
    for (at, (row, feature)) in rows.zip(features).enumerate() {
        let [theirs, ours] = [row["unit"].as_str().and_then(scale), scale(&feature.unit)];
        if let (Some(theirs), Some(ours)) = (theirs, ours)
            && theirs != ours
        {
            return Err(format!(
                "number {at} of observation, `{}`, is in units of {theirs}; by the task and its settings it is in units of {ours}",
                feature.name
            ));
        }
    }
    Ok(())
}

/// Returns the scale with which a unit begins, such as `50 m`, if it does.
fn scale(unit: &str) -> Option<&str> {
    let scale = unit.split([',', ':']).next()?;
    scale.starts_with(|c: char| c.is_ascii_digit()).then_some(scale)
}

/// Compares the time between decisions \[s\] that the policy learned with with that of the task.
fn compare_interval(policy: &Value, interval: Option<f64>) -> Result<(), String> {
    match (policy["interval"].as_f64(), interval) {
        (Some(learned), Some(interval)) if learned != interval => Err(format!(
            "decides every {learned} s; in the scenario, <control> has interval=\"{interval}\""
        )),
        _ => Ok(()),
    }
}

impl Controller for OnnxPolicy {
    fn actor<'a>(&'a self, _: &'a EnvSpec, _: Seed) -> Box<dyn Actor + 'a> {
        // Batches are whole, as of every learned policy.
        let worlds = WORLDS.next_multiple_of(self.batch);
        let [n, o, _] = self.sizes;
        let (observation, comm) = (vec![0.0; worlds * n * o], vec![0.0; worlds * n * n]);
        Box::new(OnnxActor { policy: self, observation, comm })
    }
}

/// A policy at work.
struct OnnxActor<'a> {
    policy: &'a OnnxPolicy,
    /// `[worlds, N, O]`
    observation: Vec<f32>,
    /// `[worlds, N, N]`
    comm: Vec<f32>,
}

impl Actor for OnnxActor<'_> {
    fn begin(&mut self) {
        self.observation.fill(0.0);
        self.comm.fill(0.0);
    }

    fn act(
        &mut self,
        worlds: &dyn Worlds,
        actions: &mut [f32],
        _: Option<usize>,
    ) -> Result<RecordedDiagnostics, env::Error> {
        let Self { policy, observation, comm } = self;
        let [n, o, a] = policy.sizes;
        for e in 0..worlds.count() {
            let frame = worlds.view(e).frame;
            observation[e * n * o..][..n * o].copy_from_slice(&frame.observation);
            comm[e * n * n..][..n * n].copy_from_slice(&frame.comm);
        }
        let mut rows = actions.chunks_mut(if policy.discrete { 1 } else { a });
        let frames = (0..worlds.count()).map(|e| worlds.view(e).frame);
        let mut agents = frames.flat_map(|frame| (0..n).map(move |i| (frame, i)));
        let batches = observation.chunks(policy.batch * n * o);
        let batches = batches.zip(comm.chunks(policy.batch * n * n));
        for (observation, comm) in batches.take(worlds.count().div_ceil(policy.batch)) {
            let computed = policy.run(observation, comm).map_err(env::Error::Policy)?;
            // Beyond the last world there are no agents.
            for (numbers, (frame, i)) in computed.chunks(a).zip(&mut agents) {
                let row = rows.next().expect("every agent of every world has an action");
                if frame.active[i] > 0.5 && numbers.iter().any(|value| value.is_nan()) {
                    return Err(env::Error::Policy(format!("the action of agent {i} is NaN")));
                }
                if policy.discrete {
                    row[0] = best_choice(numbers, frame, i) as f32;
                } else {
                    row.copy_from_slice(numbers);
                }
            }
        }
        Ok(RecordedDiagnostics::default())
    }
}

/// Returns the choice with the largest of these logits among those that are open to agent `i`; the
/// first choice if none is.
fn best_choice(logits: &[f32], frame: &Frame, i: usize) -> usize {
    let available = &frame.available[i * logits.len()..][..logits.len()];
    let open = (0..logits.len()).filter(|choice| available[*choice] > 0.5);
    open.reduce(|best, next| if logits[next] > logits[best] { next } else { best }).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use tch::{Device, Tensor};

    use super::*;

    /// A policy that learned with other scales, or decided at other times, is not used in silence.
    #[test]
    fn names_scales_and_the_interval_are_compared() {
        let spec = spec_of_one_number("20 m, at most");
        let policy = |name: &str, unit: &str| {
            let row = serde_json::json!({ "name": name, "unit": unit });
            serde_json::json!({ "observation": [row] })
        };
        let number = "ego.distance";
        for same in ["20 m, at most", "20 m: in other words"] {
            assert_eq!(compare_names(&policy(number, same), &spec), Ok(()));
        }
        for (name, unit) in [(number, "50 m, at most"), ("ego.speed", "20 m, at most")] {
            let difference = compare_names(&policy(name, unit), &spec).expect_err("another number");
            assert!(difference.contains("by the task"), "{difference}");
        }
        assert_eq!(compare_interval(&serde_json::json!({ "interval": 0.1 }), Some(0.1)), Ok(()));
        assert_eq!(compare_interval(&serde_json::json!({}), Some(0.1)), Ok(()));
        assert!(compare_interval(&serde_json::json!({ "interval": 0.1 }), Some(0.05)).is_err());
    }

    fn spec_of_one_number(unit: &'static str) -> EnvSpec {
        EnvSpec {
            agents: 2,
            actions: ActionSpace::Discrete(vec!["wait", "go"]),
            observation: crate::env::Features::of("ego", &[("distance", unit, 0.0, 1.0)]),
            state: crate::env::Features::default(),
            most_heard: None,
            metrics: Vec::new(),
        }
    }
    use crate::algo::{self, ActMode, Observation, Settings, onnx};
    use crate::env::Task;
    use crate::rng;
    use crate::scenario::Scenario;

    #[test]
    fn models_decide_as_the_learners_that_they_were_made_from() {
        let scenario = Scenario::read(Path::new("scenarios/intersection.xml")).expect("a scenario");
        let task = Task::new(&scenario, 8).expect("a task");
        let (n, o) = (task.agents, task.spec.observation.len());
        let folder = tempfile::tempdir().expect("a folder");
        for method in onnx::METHODS {
            let settings = Settings::default();
            let learner = algo::build(method, &task.spec, &settings, Seed::new(0), Device::Cpu);
            let mut learner = learner.expect("a learner");
            // Untrained means are almost constant: weights of a trained policy's size.
            let mut source = Seed::new(1).rng();
            let mut normal = |size: &[i64]| {
                let mut values = vec![0.0_f32; size.iter().product::<i64>() as usize];
                rng::fill_normal(&mut source, &mut values);
                Tensor::from_slice(&values).view(size)
            };
            let mut state = learner.state();
            state.retain(|(name, _)| !name.starts_with("actor_average/"));
            let trained = state.into_iter().map(|(name, tensor)| {
                let moved = &tensor + normal(&tensor.size()) * 0.1;
                (name.clone(), if name.starts_with(onnx::ACTOR) { moved } else { tensor })
            });
            let trained: Vec<_> = trained.collect();
            learner.load_weights(&trained).expect("the same names and sizes");
            let state = learner.state();
            let graph = onnx::graph(method, &task.spec, &settings, &state).expect("a model");
            let file = folder.path().join(format!("{method}.onnx"));
            std::fs::write(&file, graph.encode(method, &[])).expect("written");
            let model =
                OnnxPolicy::load(&file, &task.spec, Some(0.1)).expect("a model for this task");
            let mut graphs = Seed::new(2).rng();
            let mut spread = 0.0_f64;
            for _ in 0..8 {
                let size = |width: usize| [WORLDS as i64, n as i64, width as i64];
                let observation = normal(&size(o)).clamp(-1.0, 1.0);
                let mut near = vec![0.0_f32; WORLDS * n * n];
                rng::fill_normal(&mut graphs, &mut near);
                let near = Tensor::from_slice(&near).view(size(n)).gt(0.0);
                let own = Tensor::eye(n as i64, (tch::Kind::Bool, Device::Cpu));
                let comm = near.logical_or(&near.transpose(1, 2)).logical_or(&own);
                let comm = comm.to_kind(tch::Kind::Float);
                let input = Observation {
                    observation: observation.shallow_clone(),
                    comm: comm.shallow_clone(),
                    start: Tensor::zeros(&size(0)[..2], (tch::Kind::Float, Device::Cpu)),
                    memory: Tensor::zeros(size(0), (tch::Kind::Float, Device::Cpu)),
                    disturbance: Tensor::zeros([0], (tch::Kind::Float, Device::Cpu)),
                    available: Tensor::zeros([0], (tch::Kind::Float, Device::Cpu)),
                };
                let wanted = learner.act(&input, &ActMode::Deterministic).action;
                let wanted = wanted.clamp(-1.0, 1.0);
                let flat = |x: &Tensor| Vec::<f32>::try_from(x.flatten(0, -1)).expect("numbers");
                let found = model.run(&flat(&observation), &flat(&comm)).expect("actions");
                let found = Tensor::from_slice(&found).view_as(&wanted);
                let difference = (found - &wanted).abs().max().double_value(&[]);
                assert!(difference < 1e-5, "{method}: {difference}");
                spread = spread.max(wanted.std(false).double_value(&[]));
            }
            assert!(spread > 0.1, "{method}: all actions are alike ({spread})");
        }
    }
}
