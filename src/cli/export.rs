//! `iwol export`

#![cfg(feature = "learn")]

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use serde_json::json;

use crate::algo::onnx;
use crate::checkpoint::Checkpoint;
use crate::config::{Document, Layers, TaskSource};
use crate::env::{ActionSpace, EnvSpec, Feature, Features, Task};
use crate::onnx::Graph;
use crate::provenance::Program;
use crate::record;
use crate::scenario::Scenario;
use crate::train::RunDir;

use super::Verdict;

/// The copy lacks the data that only `iwol train --resume` needs: the optimisers' moments and the
/// state of the worlds.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// Run folder, whose best checkpoint is copied, or checkpoint file.
    run: PathBuf,
    /// Folder to create.
    #[arg(short, long, value_name = "DIR", required_unless_present_any = ["onnx", "pytorch"])]
    out: Option<PathBuf>,
    /// Write the policy as an ONNX model, for use outside of this program.
    #[arg(long, value_name = "FILE")]
    onnx: Option<PathBuf>,
    /// Write the policy's weights into a new folder, with a Python file that runs them in PyTorch.
    #[arg(long, value_name = "DIR")]
    pytorch: Option<PathBuf>,
    /// Scenario file of the run, for --onnx and --pytorch [default: the path in the run's settings,
    /// relative to this folder].
    #[arg(long, value_name = "FILE")]
    scenario: Option<PathBuf>,
}

/// The file that runs exported weights in PyTorch. The Python package loads policies with it too.
const PYTORCH: &str = include_str!("../../python_bridge/python/iwol_sumo/_policy.py");

pub(super) fn run(args: &Args) -> anyhow::Result<Verdict> {
    let checkpoint = Checkpoint::load(&RunDir::checkpoint(&args.run))?.weights();
    if let Some(file) = &args.onnx {
        write_onnx(&checkpoint, args, file)?;
        tell!("{}", file.display());
    }
    if let Some(out) = &args.out {
        copy(&checkpoint, &args.run, out)?;
        tell!("{}", out.display());
    }
    if let Some(dir) = &args.pytorch {
        write_pytorch(checkpoint, args, dir)?;
        tell!("{}", dir.display());
    }
    Ok(Verdict::Good)
}

/// Writes the policy as an ONNX model. Its metadata say what the numbers of observations and actions
/// mean.
fn write_onnx(checkpoint: &Checkpoint, args: &Args, file: &Path) -> anyhow::Result<()> {
    if file.exists() {
        bail!("`{}` already exists; choose another --onnx", file.display());
    }
    let exported = Exported::new(checkpoint, args)?;
    let metadata = [("policy", exported.description.to_string())];
    record::write_atomic(file, &exported.graph.encode(&checkpoint.algorithm, &metadata))?;
    Ok(())
}

/// Writes a folder with the policy's weights, what its numbers mean, and the file that runs it in
/// PyTorch. Methods and encoders are those that have an ONNX model.
fn write_pytorch(mut checkpoint: Checkpoint, args: &Args, dir: &Path) -> anyhow::Result<()> {
    if dir.exists() {
        bail!("`{}` already exists; choose another --pytorch", dir.display());
    }
    let exported = Exported::new(&checkpoint, args)?;
    std::fs::create_dir_all(dir)
        .with_context(|| format!("cannot create the folder `{}`", dir.display()))?;
    checkpoint.learner.retain(|(name, _)| name.starts_with(onnx::ACTOR));
    checkpoint.save(&dir.join("policy.safetensors"))?;
    let description = serde_json::to_string_pretty(&exported.description)?;
    record::write_atomic(&dir.join("policy.json"), description.as_bytes())?;
    record::write_atomic(&dir.join("policy.py"), PYTORCH.as_bytes())?;
    Ok(())
}

/// A policy for use outside of this program.
struct Exported {
    graph: Graph,
    /// The method, the task, and what the numbers of observations and actions mean.
    description: serde_json::Value,
}

impl Exported {
    fn new(checkpoint: &Checkpoint, args: &Args) -> anyhow::Result<Self> {
        let source = format!("{} (stored settings)", args.run.display());
        let document = Document::of_run(source, checkpoint.config.clone());
        let scenario = args.scenario.iter().map(|file| file.display().to_string());
        let flags = scenario.map(|file| ("scenario", toml::Value::String(file))).collect();
        let resolved = Layers { document, flags, ..Layers::default() }.resolve()?;
        let (config, place) = (resolved.config, resolved.place);
        if !config.channel.is_perfect() {
            say!(
                "the exported policy has no channel: unlike in the run, every message arrives, at once and unchanged"
            );
        }
        let (spec, task) = match &place {
            TaskSource::Scenario(scenario) => {
                let about = json!({
                    "scenario": scenario.name,
                    "interval": scenario.control.interval,
                    "communication_range": scenario.communication.range,
                });
                let spec = Task::new(scenario, config.agents)?.spec;
                if let Some(difference) = checkpoint.misplaced(&spec.observation) {
                    bail!(
                        "the policy observes other numbers than the scenario defines: {difference}"
                    );
                }
                (spec, about)
            }
            TaskSource::Environment(named) => {
                (named.environment().spec().clone(), json!({ "environment": named.name }))
            }
        };
        let algorithm = &checkpoint.algorithm;
        let graph = onnx::graph(algorithm, &spec, &config.learner, &checkpoint.learner);
        let graph = graph.with_context(|| {
            format!(
                "{algorithm} with the encoder of this run cannot be exported to ONNX or PyTorch; methods that can: {}, with network.encoder = \"mlp\"",
                onnx::METHODS.join(", ")
            )
        })?;
        let features = |features: &Features| {
            let row = |f: &Feature| json!({ "name": f.name, "unit": f.unit, "low": f.low, "high": f.high });
            features.list.iter().map(row).collect::<Vec<_>>()
        };
        let mut description = json!({
            "algorithm": algorithm,
            "observation": features(&spec.observation),
            "actions": actions(&spec),
            "program": Program::current(),
        });
        for (key, value) in task.as_object().into_iter().flatten() {
            description[key] = value.clone();
        }
        Ok(Self { graph, description })
    }
}

/// Describes the numbers of a continuous action, or the choices of a discrete one.
fn actions(spec: &EnvSpec) -> Vec<serde_json::Value> {
    match &spec.actions {
        ActionSpace::Continuous(_) => {
            let names = spec.actions.names().into_iter();
            names.map(|name| json!({ "name": name, "low": -1.0, "high": 1.0 })).collect()
        }
        ActionSpace::Discrete(choices) => {
            choices.iter().map(|name| json!({ "name": name })).collect()
        }
    }
}

/// Copies the policy into a folder.
fn copy(checkpoint: &Checkpoint, run: &Path, out: &Path) -> anyhow::Result<()> {
    let dir = RunDir::new(out);
    if dir.best().exists() || dir.last().exists() {
        bail!("`{}` already contains a checkpoint; choose another --out", out.display());
    }
    if dir.config().exists() {
        bail!("`{}` already exists; choose another --out", dir.config().display());
    }
    std::fs::create_dir_all(out.join("checkpoints"))
        .with_context(|| format!("cannot create the folder `{}`", out.display()))?;
    record::write_atomic(&dir.config(), checkpoint.config.as_bytes())?;
    // The record of what the policy was trained with is copied along with the policy.
    let meta = RunDir::of(run).map(|run| run.meta()).filter(|meta| meta.is_file());
    if let Some(meta) = meta {
        let bytes =
            std::fs::read(&meta).with_context(|| format!("cannot read `{}`", meta.display()))?;
        record::write_atomic(&dir.meta(), &bytes)?;
    }
    // So is the scenario, whose paths are relative to its folder.
    let scenario = RunDir::of(run).map(|run| run.scenario()).filter(|file| file.is_file());
    if let Some(file) = scenario {
        let text = Scenario::read(&file)?.to_xml_in(out).with_context(|| {
            format!("cannot find the net or the route files of `{}`", file.display())
        })?;
        record::write_atomic(&dir.scenario(), text.as_bytes())?;
    }
    checkpoint.save(&dir.best())?;
    Ok(())
}
