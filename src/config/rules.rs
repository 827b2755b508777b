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
        let algo::Settings { network, ppo, exploration, iwol, transformer, .. } = learner;
        let samples = train
            .envs
            .saturating_mul(train.rollout_steps)
            .saturating_mul(train.batch_growth)
            .saturating_mul(self.agents as usize);
        let commformer = self.algorithm == "commformer";
        let method = algo::capabilities(&self.algorithm).ok();
        let on_policy = method.is_none_or(|method| method.on_policy);
        let recurrent = network.encoder == settings::EncoderKind::Gru;
        let divides = |part: i64, whole: i64| whole % part == 0;
        let rules: [(&'static [&'static str], bool, &'static str); _] = [
            (
                &["train.rollout_steps", "train.batch_growth", "train.envs", "agents"],
                samples <= MOST_SAMPLES,
                "at most 2^24 samples per rollout (rollout_steps × batch_growth × envs × agents)",
            ),
            (
                &["train.batch_growth", "algorithm"],
                train.batch_growth == 1 || on_policy,
                "1 with MADDPG, which learns from a replay buffer",
            ),
            (
                &["network.token_heads", "network.token_width"],
                divides(network.token_heads, network.token_width),
                "a divisor of network.token_width",
            ),
            (
                &["network.chunk_length", "train.rollout_steps", "network.encoder"],
                !recurrent || (1..=train.rollout_steps).contains(&network.chunk_length),
                "1 to train.rollout_steps",
            ),
            (
                &["iwol.heads", "iwol.message"],
                divides(iwol.heads, iwol.message),
                "a divisor of iwol.message",
            ),
            (
                &["transformer.heads", "network.hidden", "algorithm"],
                !(commformer || self.algorithm == "mat")
                    || divides(transformer.heads, network.hidden),
                "a divisor of network.hidden",
            ),
            (
                &["commformer.graph_every", "ppo.epochs", "algorithm"],
                (2..=ppo.epochs.max(2)).contains(&learner.commformer.graph_every) || !commformer,
                "2 to ppo.epochs: of this number of passes over a rollout, one trains the graph",
            ),
            (
                &["ppo.target_kl", "algorithm"],
                ppo.target_kl == 0.0 || !commformer,
                "0 with CommFormer, whose last pass over a rollout trains the graph",
            ),
            (
                &["network.encoder", "algorithm"],
                !recurrent || method.is_none_or(|method| method.recurrent),
                "mlp or attention: this method learns from single steps of a replay buffer, without memory",
            ),
            (
                &["exploration.mode", "algorithm"],
                exploration.mode == settings::NoiseMode::Schedule || on_policy,
                "schedule: this method does not learn the amount of noise",
            ),
            (
                &["network.extra_layers"],
                network.hidden.saturating_mul(network.extra_layers as i64 + 1) <= 1 << 16,
                "fewer or narrower layers",
            ),
        ];
        rules.into_iter().find(|rule| !rule.1).map(|(keys, _, allowed)| (keys, allowed))
    }
}
