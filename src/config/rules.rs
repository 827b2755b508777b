//! Rules that concern several settings. The range of each setting alone is declared with it.

use super::Config;
use crate::algo::{self, settings};

/// Largest number of samples per rollout, which keeps its observations within the machine's memory.
const MOST_SAMPLES: usize = 1 << 24;

impl Config {
    /// Returns the first rule that is broken, as its keys, the offending key first, and the allowed
    /// values; `None` if there is none.
    pub(super) fn broken_rule(&self) -> Option<(&'static [&'static str], &'static str)> {
        let (train, learner) = (&self.train, &self.learner);
        let algo::Settings { network, exploration, .. } = learner;
        let samples =
            train.envs.saturating_mul(train.rollout_steps).saturating_mul(self.agents as usize);
        let method = algo::capabilities(&self.algorithm).ok();
        let on_policy = method.is_none_or(|method| method.on_policy);
        let recurrent = network.encoder == settings::EncoderKind::Gru;
        let team = method.is_some_and(|method| method.team);
        let cooperation = self.scenario.value("reward", "cooperation");
        let cooperation = cooperation.and_then(toml::Value::as_float).unwrap_or(0.0);
        let (chunk, steps) = (network.chunk_length, train.rollout_steps);
        let rules: [(&'static [&'static str], bool, &'static str); _] = [
            (
                &["train.rollout_steps", "train.envs", "agents"],
                samples <= MOST_SAMPLES,
                "at most 2^24 samples per rollout (rollout_steps × envs × agents)",
            ),
            (
                &["network.chunk_length", "train.rollout_steps", "network.encoder"],
                !recurrent || (1..=steps).contains(&chunk) && steps.is_multiple_of(chunk),
                "1 to train.rollout_steps, and a divisor of it",
            ),
            (
                &["scenario.reward.cooperation", "algorithm"],
                !team || cooperation == 0.0,
                "0: this method learns from the return of the whole team",
            ),
            (
                &["network.encoder", "algorithm"],
                !recurrent || method.is_none_or(|method| method.recurrent),
                "mlp or attention: this method learns from single steps of a replay buffer, without memory",
            ),
            (
                &["train.overlap", "algorithm"],
                !train.overlap || on_policy,
                "false: this method learns from a replay buffer, whatever policy filled it",
            ),
            (
                &["exploration.mode", "algorithm"],
                exploration.mode == settings::NoiseMode::Schedule || on_policy,
                "schedule: this method does not learn the amount of noise",
            ),
        ];
        rules.into_iter().find(|rule| !rule.1).map(|(keys, _, allowed)| (keys, allowed))
    }
}
