//! `iwol config`, and the arguments that give settings.

#![cfg(feature = "learn")]

use std::path::PathBuf;

use anyhow::{Context as _, bail};
use toml::Value;

use crate::algo;
use crate::config::{self, Config, Document, Layers, PRESETS, PROFILES, Profile};
use crate::env::NamedEnvironment;

use crate::train::RunDir;

use super::Verdict;

/// Prints the settings that `iwol train` would use with the same arguments, as TOML, and where each
/// value comes from. Settings that the method does not read are left out.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    #[command(flatten)]
    settings: SettingsArgs,
    /// Print the JSON schema of files with settings, for editors.
    #[arg(long, exclusive = true)]
    schema: bool,
    /// Print the documentation of all settings, as Markdown.
    #[arg(long, exclusive = true)]
    reference: bool,
}

/// Arguments that give settings.
#[derive(Debug, clap::Args)]
pub(super) struct SettingsArgs {
    /// Scenario file, e.g. scenarios/intersection.xml.
    #[arg(long)]
    scenario: Option<PathBuf>,
    #[arg(long, value_name = "NAME", conflicts_with = "scenario", help = format!("Environment without SUMO, instead of a scenario: {}", NamedEnvironment::names().join(", ")))]
    environment: Option<String>,
    #[arg(long, value_name = "NAME", help = format!("Learning algorithm: {}", algo::names().join(", ")))]
    algorithm: Option<String>,
    /// Number of vehicles at spawn places, which are all agents unless
    /// scenario.traffic.penetration is below 1; where agents come from route files, the most agents
    /// on the road at a time [default: the scenario's].
    #[arg(long)]
    agents: Option<u32>,
    /// Seed of all random numbers [default: 0].
    #[arg(long)]
    seed: Option<u64>,
    /// Maximum number of environment steps of all worlds together, rounded up to whole rollouts.
    #[arg(long)]
    steps: Option<u64>,
    /// Start from the weights in a run folder or checkpoint of the same algorithm. The number of
    /// agents may differ, except with CommFormer.
    #[arg(long, value_name = "CHECKPOINT")]
    pub(super) init_from: Option<PathBuf>,
    /// Device on which the networks are computed [default: the one of the profile: cpu, or cuda where libtorch finds a GPU].
    #[arg(long, value_name = "cpu|cuda")]
    device: Option<String>,
    /// Interface to SUMO, on which results do not depend [default: auto].
    #[arg(long, value_name = "auto|traci|libsumo")]
    backend: Option<String>,
    #[arg(long, value_name = "NAME", help = format!("Preset, which replaces defaults: {}", PRESETS.map(|preset| preset.name).join(", ")))]
    preset: Option<String>,
    #[arg(long, value_name = "NAME", help = format!("Kind of machine, from which defaults of rollouts, updates and device follow: {}, or auto for this machine's [default: auto, unless a file names one]", PROFILES.each_ref().map(|profile| profile.name).join(", ")))]
    profile: Option<String>,
    /// TOML file with settings, e.g. the config.toml of a run folder.
    #[arg(long, value_name = "FILE")]
    pub(super) config: Option<PathBuf>,
    /// One setting, e.g. --set ppo.gamma=0.995. The option may be repeated.
    #[arg(long, value_name = "KEY=VALUE")]
    pub(super) set: Vec<String>,
}

impl SettingsArgs {
    /// Returns the layers of settings that the arguments give; `machine` is the profile of this
    /// machine.
    pub(super) fn layers(&self, machine: &'static Profile) -> anyhow::Result<Layers> {
        let document = self.config.as_deref().map(Document::read).transpose()?.unwrap_or_default();
        Ok(Layers {
            profile: Some(machine),
            document,
            sets: self.set.clone(),
            flags: self.flags(machine)?,
        })
    }

    fn flags(&self, machine: &Profile) -> anyhow::Result<Vec<(&'static str, Value)>> {
        let integer = |v: u64| {
            i64::try_from(v)
                .map(Value::Integer)
                .with_context(|| format!("{v} is too large: numbers must be below 2^63"))
        };
        let text = |text: &Option<String>| text.clone().map(Value::String);
        let path = |path: &Option<PathBuf>| text(&path.as_ref().map(|p| p.display().to_string()));
        let flags = [
            ("preset", text(&self.preset)),
            (
                "profile",
                text(&self.profile).map(|name| match name.as_str() {
                    Some("auto") => machine.name.into(),
                    _ => name,
                }),
            ),
            ("scenario", path(&self.scenario)),
            ("environment", text(&self.environment)),
            ("algorithm", text(&self.algorithm)),
            ("agents", self.agents.map(|agents| integer(agents.into())).transpose()?),
            ("seed", self.seed.map(integer).transpose()?),
            ("init_from", path(&self.init_from)),
            ("device", text(&self.device)),
            ("simulation.backend", text(&self.backend)),
            ("steps", self.steps.map(integer).transpose()?),
        ];
        Ok(flags.into_iter().filter_map(|(key, value)| Some((key, value?))).collect())
    }
}

pub(super) fn run(args: &Args) -> anyhow::Result<Verdict> {
    if args.schema {
        tell!("{:#}", Config::schema());
    } else if args.reference {
        super::print(format_args!("{}", Config::reference()));
    } else {
        let layers = args.settings.layers(Profile::of_this_machine())?;
        let resolution = layers.resolve()?;
        if let Some(why) = resolution.config.cannot_be_trained() {
            bail!(why);
        }
        let from = &resolution.config.init_from;
        if !from.as_os_str().is_empty() && !RunDir::checkpoint(from).exists() {
            bail!("init_from: there is no policy in `{}`", from.display());
        }
        for line in config::overruled(&layers, &resolution.origins) {
            say!("{line}");
        }
        super::print(format_args!("{}", resolution.explained()));
    }
    Ok(Verdict::Good)
}
