//! Which settings can be used to train, to evaluate a policy, and to start from a policy.

use toml::{Table, Value};

use super::origin::{Origin, Origins};
use super::presets::Preset;
use super::profiles::Profile;
use super::{Config, Layers, flatten, full_name};
use crate::algo::settings::{EncoderKind, NoiseMode};
use crate::algo::{self, Settings};
use crate::env::NamedEnvironment;
use crate::scenario::{self, Scenario};
use crate::sumo::Backend;

/// Returns why a `--set` has no effect in an evaluation, if its setting comes from elsewhere there.
pub fn no_matter_of_evaluation(set: &str) -> Option<String> {
    let (key, _) = set.split_once('=')?;
    let where_from = match key.trim() {
        "seed" => "--seed determines the episodes",
        "algorithm" => "the checkpoint determines the algorithm",
        "device" => "--device determines the device",
        "preset" | "profile" => "presets and profiles are for trainings",
        key if ["init_from", "steps"].contains(&key)
            || ["train.", "ppo.", "exploration."].iter().any(|group| key.starts_with(group)) =>
        {
            "nothing is trained"
        }
        _ => return None,
    };
    Some(format!("{set}: has no effect in an evaluation: {where_from}"))
}

/// Returns which of the settings of `--set` a training does not read, because of its algorithm or of
/// other settings, each with the reason.
pub fn unread(sets: &[String], config: &Config) -> Vec<String> {
    let algorithm = &config.algorithm;
    let Ok(method) = algo::capabilities(algorithm) else { return Vec::new() };
    let reason = |set: &String| {
        let key = set.split_once('=')?.0.trim();
        let group = key.split_once('.').map_or(key, |(group, _)| group);
        let why = match group {
            "channel" if !method.messages => "sends no messages through a channel",
            group if algo::Settings::OWN.contains(&group) && !method.settings.contains(&group) => {
                "does not read it"
            }
            _ if method.unread.contains(&full_name(key)) => "does not read it",
            _ => {
                let (_, why) = config.idle().find(|(idle, _)| *idle == key)?;
                return Some(format!("--set {set} has no effect: {why}"));
            }
        };
        Some(format!("--set {set} has no effect: {algorithm} {why}"))
    };
    sets.iter().filter_map(reason).collect()
}

/// Returns which of the settings of `--set` other values of the scenario make ineffective, each with
/// the reason.
pub fn without_effect(sets: &[String], scenario: Option<&Scenario>, agents: u32) -> Vec<String> {
    let Some(scenario) = scenario else { return Vec::new() };
    let is_mixed = scenario.traffic.is_mixed(agents);
    let reason = |set: &String| {
        let key = set.split_once('=').map_or("", |(key, _)| key.trim());
        let why = if is_mixed && key == "simulation.processes" {
            "mixed traffic has a SUMO for each world"
        } else {
            idle(set, scenario)?
        };
        Some(format!("--set {set} has no effect: {why}"))
    };
    sets.iter().filter_map(reason).collect()
}

/// Returns why a setting `key` or `key=value` has no effect in a scenario, if it has none.
pub fn idle(set: &str, scenario: &Scenario) -> Option<&'static str> {
    let key = set.split_once('=').map_or(set, |(key, _)| key).trim().strip_prefix("scenario.")?;
    // Every scenario file has this attribute, so that it is not reported there.
    let neighbours = ("observation", "neighbours", "groups is `conflict`");
    let more = (!scenario.observation.groups.nearest()).then_some(neighbours);
    let mut all = scenario::without_effect(scenario).chain(more);
    all.find_map(|(element, attribute, why)| {
        (key.split_once('.') == Some((element, attribute))).then_some(why)
    })
}

/// Returns which options of the command line have no effect on the resolved settings, each with the
/// reason: a preset or profile whose settings are all given elsewhere, such as in the file of a run,
/// and a `--set` of what another option or a later `--set` says.
pub fn overruled(layers: &Layers, origins: &Origins) -> Vec<String> {
    let flags = layers.flags.iter().filter_map(|(key, value)| {
        let name = value.as_str()?;
        Some((format!("--{key} {name}"), *key, name, None))
    });
    let sets = layers.sets.iter().enumerate().filter_map(|(i, set)| {
        let (key, value) = set.split_once('=')?;
        let key = key.trim();
        let same = |own: &str| full_name(own.trim()) == full_name(key);
        let flag = layers.flags.iter().find(|(own, _)| same(own));
        let flag = flag.map(|(own, _)| format!("--{}", own.rsplit('.').next().unwrap_or(own)));
        let later = layers.sets[i + 1..].iter().rev();
        let last = later.filter_map(|set| set.split_once('=')).find(|(own, _)| same(own));
        // The same value given twice has its effect.
        let last = last.filter(|(_, other)| other.trim() != value.trim());
        let stronger = flag.or_else(|| last.map(|(own, other)| format!("--set {own}={other}")));
        Some((format!("--set {set}"), key, value.trim(), stronger))
    });
    let mut lines = Vec::new();
    for (option, key, name, stronger) in flags.chain(sets) {
        // An environment without SUMO has none of a preset's settings of scenarios.
        let is_given =
            |key: &str| origins.get(key).is_none_or(|origin| matches!(origin, Origin::Given(_)));
        let all_given = match key {
            "preset" => Preset::named(name)
                .is_some_and(|preset| flatten(&preset.table()).keys().all(|key| is_given(key))),
            "profile" => Profile::SETTINGS.iter().all(|key| is_given(key)),
            _ => false,
        };
        if let Some(stronger) = stronger {
            lines.push(format!("{option} has no effect: {stronger} is given, too"));
        } else if all_given {
            let file = &layers.document.name;
            lines.push(format!("{option} has no effect: {file} gives all of its settings"));
        }
    }
    lines
}

impl Config {
    /// Returns the settings that others make ineffective, each with the reason.
    fn idle(&self) -> impl Iterator<Item = (&'static str, &'static str)> {
        let Settings { network, exploration, ppo, .. } = &self.learner;
        let is_learned = exploration.mode == NoiseMode::Learned;
        let learned = "exploration.mode is learned";
        let is_libsumo = self.hosting().backend == Backend::Libsumo;
        [
            (
                "network.chunk_length",
                network.encoder != EncoderKind::Gru,
                "network.encoder is not gru",
            ),
            ("exploration.log_std_end", is_learned, learned),
            ("ppo.learning_rate_follows_noise", is_learned, learned),
            ("ppo.entropy_end", ppo.entropy_coefficient == 0.0, "ppo.entropy_coefficient is 0"),
            (
                "ppo.shards",
                self.device.is_cuda(),
                "a GPU works on one part of a minibatch at a time",
            ),
            ("simulation.processes", is_libsumo, "libsumo runs in this process"),
            ("simulation.timeout", is_libsumo, "libsumo runs in this process"),
        ]
        .into_iter()
        .filter_map(|(key, idle, why)| idle.then_some((key, why)))
    }

    /// Returns whether a training with these settings reads the setting `key`: whether neither its
    /// algorithm nor another setting makes it ineffective.
    pub fn reads(&self, key: &str) -> bool {
        let by_method = algo::capabilities(&self.algorithm);
        by_method.is_ok_and(|method| !method.unread.contains(&key))
            && self.idle().all(|(idle, _)| idle != key)
    }

    /// Returns the settings that the algorithm reads, as TOML: two trainings with the same ones are
    /// the same.
    pub fn read_settings(&self) -> String {
        let mut table: Table = toml::from_str(&self.to_toml()).expect("settings are TOML");
        super::remove_untold(&mut table, &self.algorithm);
        for (group, name) in self.idle().filter_map(|(key, _)| key.split_once('.')) {
            table.get_mut(group).and_then(Value::as_table_mut).map(|group| group.remove(name));
        }
        if algo::capabilities(&self.algorithm).is_ok_and(|method| !method.messages) {
            table.remove("channel");
        }
        table.to_string()
    }

    /// Returns why these settings cannot be used for training, if they cannot.
    pub fn cannot_be_trained(&self) -> Option<String> {
        if let Err(unfit) = algo::check_channel(&self.algorithm, &self.channel) {
            return Some(unfit.to_string());
        }
        let (fewest, agents) = (self.train.fewest_agents, self.agents);
        if fewest > agents {
            return Some(format!(
                "train.fewest_agents is {fewest}; allowed: 0 to {agents}, the number of agents"
            ));
        }
        if let Some(named) = NamedEnvironment::find(&self.environment) {
            let unfit = algo::check_actions(&self.algorithm, named.environment().spec()).err();
            if let Some(unfit) = unfit {
                return Some(unfit.to_string());
            }
        }
        self.channel.cannot_train(self.learner.network.encoder).map(str::to_owned)
    }

    /// Returns why the policy of a run with these settings cannot be used with the settings
    /// `asked`, as far as this is known before training; `None` if it can.
    pub fn cannot_serve(&self, asked: &Self) -> Option<String> {
        let penetration = |config: &Self| config.scenario.value("traffic", "penetration").cloned();
        let as_many = if penetration(self) == penetration(asked) {
            algo::check_agents(&self.algorithm, self.agents.into(), asked.agents.into())
        } else {
            // The number of agents is known only once the scenario is set up.
            Ok(())
        };
        let unfit =
            as_many.and_then(|()| algo::check_channel(&self.algorithm, &asked.channel)).err();
        unfit.map(|unfit| unfit.to_string())
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn config(sets: &[&str]) -> Config {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/intersection.xml");
        let layers = Layers {
            sets: sets.iter().map(|set| (*set).to_owned()).collect(),
            flags: vec![("scenario", Value::String(file.display().to_string()))],
            ..Layers::default()
        };
        Config::resolve(&layers).expect("settings").0
    }

    #[test]
    fn settings_that_a_method_does_not_read_are_told() {
        let told = |algorithm: &str, set: &str| {
            unread(&[set.to_owned()], &config(&[&format!("algorithm={algorithm}")]))
        };
        assert_eq!(
            told("im-iwol", "channel.loss=1"),
            ["--set channel.loss=1 has no effect: im-iwol sends no messages through a channel"]
        );
        assert_eq!(
            told("mappo", "commformer.sparsity=0.9"),
            ["--set commformer.sparsity=0.9 has no effect: mappo does not read it"]
        );
        for (algorithm, set) in [
            ("ex-iwol", "iwol.latent=8"),
            ("magic", "iwol.rounds=2"),
            ("maddpg", "ppo.epochs=2"),
            ("maddpg-iwol", "ppo.shards=4"),
            ("maddpg-iwol", " iwol.decoded = 1"),
        ] {
            assert!(told(algorithm, set)[0].contains("does not read it"), "{algorithm} {set}");
        }
        for (algorithm, set) in [
            ("ex-iwol", "channel.loss=1"),
            ("magic", "iwol.decoded=1"),
            ("mappo", "network.hidden=64"),
            ("maddpg", "maddpg.n_step=3"),
            ("magic", "ppo.epochs=2"),
        ] {
            assert!(told(algorithm, set).is_empty(), "{algorithm} {set}");
        }
    }

    #[test]
    fn settings_that_others_make_ineffective_are_told() {
        let told = |others: &[&str], set: &str| unread(&[set.to_owned()], &config(others));
        assert_eq!(
            told(&["network.encoder=mlp"], "network.chunk_length=4"),
            ["--set network.chunk_length=4 has no effect: network.encoder is not gru"]
        );
        assert!(told(&["network.encoder=gru"], "network.chunk_length=4").is_empty());
        for (others, set) in [
            (["ppo.entropy_coefficient=0", "ppo.entropy_coefficient=0.01"], "ppo.entropy_end=0.5"),
            (
                ["exploration.mode=learned", "exploration.mode=schedule"],
                "exploration.log_std_end=-3",
            ),
            (
                ["exploration.mode=learned", "exploration.mode=schedule"],
                "ppo.learning_rate_follows_noise=false",
            ),
        ] {
            assert_eq!(others.map(|other| told(&[other], set).len()), [1, 0], "{set}");
        }
        let shards = |device| told(&[&format!("device={device}")], "ppo.shards=4").len();
        assert_eq!(["cuda:0", "cpu"].map(shards), [1, 0]);
        let processes = |backend| {
            told(&[&format!("simulation.backend={backend}")], "simulation.processes=4").len()
        };
        assert_eq!(["libsumo", "traci"].map(processes), [1, 0]);
        let [one, other] = ["network.chunk_length=4", "network.chunk_length=8"]
            .map(|set| config(&["network.encoder=mlp", set]).read_settings());
        assert_eq!(one, other, "the same training");
    }

    #[test]
    fn mixed_traffic_has_a_sumo_for_each_world() {
        let told = |penetration: f64| {
            let mut scenario = Scenario::load(&config(&[]).scenario.file).expect("a scenario");
            scenario.traffic.penetration = penetration;
            without_effect(&["simulation.processes=2".to_owned()], Some(&scenario), 8)
        };
        assert!(told(1.0).is_empty());
        assert_eq!(
            told(0.5),
            ["--set simulation.processes=2 has no effect: mixed traffic has a SUMO for each world"]
        );
    }

    #[test]
    fn settings_of_training_have_no_effect_in_an_evaluation() {
        for set in ["steps=5", "train.envs=4", "ppo.gamma=0.3", " exploration.mode = \"learned\""] {
            assert!(no_matter_of_evaluation(set).is_some(), "{set}");
        }
        for set in
            ["scenario.observation.detectionRange=20", "channel.loss=0.5", "simulation.audit=false"]
        {
            assert!(no_matter_of_evaluation(set).is_none(), "{set}");
        }
    }
}
