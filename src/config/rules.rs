//! Allowed values of settings.

use super::Config;
use crate::algo::{self, settings};
use crate::scenario::{Intention, Lidar, Observation};

impl Config {
    /// Returns the first rule that is broken, as its keys, the offending key first, and the allowed
    /// values; `None` if there is none.
    pub(super) fn out_of_range(&self) -> Option<(&'static [&'static str], &'static str)> {
        let (t, n, p, x, i, e) =
            (&self.train, &self.network, &self.ppo, &self.exploration, &self.iwol, &self.env);
        let (c, former) = (&self.channel, &self.commformer);
        let share = |v: f64| (0.0..=1.0).contains(&v);
        let finite_positive = |v: f64| v.is_finite() && v > 0.0;
        let finite_range = |v: f64| v.is_finite() && v >= 0.0;
        // The limit on samples keeps a rollout's observations within the machine's memory.
        let samples = t
            .envs
            .saturating_mul(t.rollout_steps)
            .saturating_mul(t.batch_growth)
            .saturating_mul(self.agents as usize);
        let sequential = ["mat", "commformer"].contains(&self.algorithm.as_str());
        let heads = self.transformer.heads;
        let able = algo::capabilities(&self.algorithm).ok();
        let recurrent = n.encoder == settings::EncoderKind::Gru;
        let rules: [(&'static [&'static str], bool, &'static str); _] = [
            (&["agents"], self.agents >= 1, "at least 1"),
            (&["seed"], i64::try_from(self.seed).is_ok(), "below 2^63"),
            (&["steps"], (1..=1 << 50).contains(&self.steps), "1 to 2^50"),
            (&["train.envs"], (1..=1024).contains(&t.envs), "1 to 1024"),
            (&["train.rollout_steps"], (1..=100_000).contains(&t.rollout_steps), "1 to 100000"),
            (
                &["train.rollout_steps", "train.batch_growth", "train.envs", "agents"],
                samples <= 1 << 24,
                "at most 2^24 samples per rollout (rollout_steps × batch_growth × envs × agents)",
            ),
            (&["train.batch_growth"], (1..=64).contains(&t.batch_growth), "1 to 64"),
            (
                &["train.batch_growth", "algorithm"],
                t.batch_growth == 1 || able.is_none_or(|able| able.on_policy),
                "1 with MADDPG, which learns from a replay buffer",
            ),
            (&["train.validate_every"], (1..=1 << 50).contains(&t.validate_every), "1 to 2^50"),
            (
                &["train.validation_episodes"],
                (1..=100_000).contains(&t.validation_episodes),
                "1 to 100000",
            ),
            (&["train.stop_success"], share(t.stop_success), "0 to 1"),
            (&["train.repeat_failed"], share(t.repeat_failed), "0 to 1"),
            (&["train.anneal_success"], share(t.anneal_success), "0 to 1"),
            (&["train.anneal_steps"], (1..=1 << 50).contains(&t.anneal_steps), "1 to 2^50"),
            (&["train.stop_validations"], (1..=1000).contains(&t.stop_validations), "1 to 1000"),
            (&["simulation.processes"], self.simulation.processes <= 1024, "0 to 1024"),
            (
                &["simulation.timeout"],
                (0.1..=86_400.0).contains(&self.simulation.timeout),
                "0.1 to 86400",
            ),
            (
                &["network.hidden"],
                (2..=4096).contains(&n.hidden) && n.hidden % 2 == 0,
                "an even number, 2 to 4096",
            ),
            (&["network.extra_layers"], n.extra_layers <= 16, "0 to 16"),
            (&["network.token_width"], (1..=1024).contains(&n.token_width), "1 to 1024"),
            (
                &["network.token_heads", "network.token_width"],
                n.token_heads >= 1 && n.token_width % n.token_heads == 0,
                "a divisor of network.token_width",
            ),
            (
                &["network.chunk_length", "train.rollout_steps", "network.encoder"],
                !recurrent || (1..=t.rollout_steps).contains(&n.chunk_length),
                "1 to train.rollout_steps",
            ),
            (&["ppo.learning_rate"], finite_range(p.learning_rate), "0 or more"),
            (&["ppo.learning_rate_end"], share(p.learning_rate_end), "0 to 1"),
            (&["ppo.epochs"], (1..=1000).contains(&p.epochs), "1 to 1000"),
            (&["ppo.target_kl"], finite_range(p.target_kl), "0 or more"),
            (&["ppo.shards"], (1..=64).contains(&p.shards), "1 to 64"),
            (&["ppo.average"], (0.0..1.0).contains(&p.average), "0 to below 1"),
            (&["ppo.minibatch"], p.minibatch >= 1, "at least 1"),
            (&["ppo.gamma"], share(p.gamma), "0 to 1"),
            (&["ppo.gamma_explored"], share(p.gamma_explored), "0 to 1"),
            (&["ppo.gae_lambda"], share(p.gae_lambda), "0 to 1"),
            (&["ppo.clip_range"], finite_positive(p.clip_range), "above 0"),
            (&["ppo.bounds"], p.bounds.is_finite() && p.bounds >= 0.0, "0 or more"),
            (&["ppo.huber_delta"], finite_positive(p.huber_delta), "above 0"),
            (&["ppo.entropy_coefficient"], p.entropy_coefficient.is_finite(), "a finite number"),
            (&["ppo.max_grad_norm"], finite_positive(p.max_grad_norm), "above 0"),
            (&["ppo.value_norm_beta"], (0.0..1.0).contains(&p.value_norm_beta), "0 to below 1"),
            (&["exploration.log_std_start"], (-20.0..=5.0).contains(&x.log_std_start), "-20 to 5"),
            (
                &["exploration.log_std_explore"],
                (-20.0..=5.0).contains(&x.log_std_explore),
                "-20 to 5",
            ),
            (&["exploration.log_std_end"], (-20.0..=5.0).contains(&x.log_std_end), "-20 to 5"),
            (&["exploration.correlation"], (0.0..1.0).contains(&x.correlation), "0 to below 1"),
            (&["exploration.explore_steps"], x.explore_steps <= 1 << 50, "0 to 2^50"),
            (&["iwol.latent"], (1..=4096).contains(&i.latent), "1 to 4096"),
            (&["iwol.rounds"], (1..=64).contains(&i.rounds), "1 to 64"),
            (&["iwol.message"], (1..=4096).contains(&i.message), "1 to 4096"),
            (
                &["iwol.heads", "iwol.message"],
                i.heads >= 1 && i.message % i.heads == 0,
                "a divisor of iwol.message",
            ),
            (&["iwol.temperature"], finite_positive(i.temperature), "above 0"),
            (&["iwol.slope"], i.slope.is_finite(), "a finite number"),
            (&["iwol.graph_bias"], i.graph_bias.is_finite(), "a finite number"),
            (&["iwol.decoded"], i.decoded > 0.0 && share(i.decoded), "above 0, to 1"),
            (&["iwol.lambda_world"], finite_range(i.lambda_world), "0 or more"),
            (&["iwol.lambda_interaction"], finite_range(i.lambda_interaction), "0 or more"),
            (&["transformer.blocks"], (1..=64).contains(&self.transformer.blocks), "1 to 64"),
            (
                &["transformer.heads", "network.hidden", "algorithm"],
                heads >= 1 && (!sequential || n.hidden % heads == 0),
                "a divisor of network.hidden",
            ),
            (&["magic.lambda_world"], finite_range(self.magic.lambda_world), "0 or more"),
            (
                &["commformer.sparsity"],
                former.sparsity > 0.0 && share(former.sparsity),
                "above 0, to 1",
            ),
            (
                &["commformer.graph_every", "ppo.epochs", "algorithm"],
                (2..=p.epochs.max(2)).contains(&former.graph_every)
                    || self.algorithm != "commformer",
                "2 to ppo.epochs: of this number of passes over a rollout, one trains the graph",
            ),
            (
                &["ppo.target_kl", "algorithm"],
                p.target_kl == 0.0 || self.algorithm != "commformer",
                "0 with CommFormer, whose last pass over a rollout trains the graph",
            ),
            (&["commformer.graph_rate"], finite_range(former.graph_rate), "0 or more"),
            (&["commformer.lambda_world"], finite_range(former.lambda_world), "0 or more"),
            (&["commformer.dropout"], (0.0..1.0).contains(&former.dropout), "0 to below 1"),
            (&["icp.symbols"], (2..=4096).contains(&self.icp.symbols), "2 to 4096"),
            (&["icp.lambda_message"], finite_range(self.icp.lambda_message), "0 or more"),
            (&["maddpg.replay"], (1..=10_000).contains(&self.maddpg.replay), "1 to 10000"),
            (&["maddpg.updates"], (1..=100_000).contains(&self.maddpg.updates), "1 to 100000"),
            (&["maddpg.n_step"], (1..=1000).contains(&self.maddpg.n_step), "1 to 1000"),
            (&["maddpg.action_penalty"], finite_positive(self.maddpg.action_penalty), "above 0"),
            (
                &["maddpg.target_rate"],
                self.maddpg.target_rate > 0.0 && share(self.maddpg.target_rate),
                "above 0, to 1",
            ),
            (
                &["network.encoder", "algorithm"],
                !recurrent || able.is_none_or(|able| able.recurrent),
                "mlp or attention: this method learns from single steps of a replay buffer, without memory",
            ),
            (
                &["exploration.mode", "algorithm"],
                x.mode == settings::NoiseMode::Schedule || able.is_none_or(|able| able.on_policy),
                "schedule: this method does not learn the amount of noise",
            ),
            (&["channel.bits"], (2..=32).contains(&c.bits), "2 to 32"),
            (&["channel.loss"], share(c.loss), "0 to 1"),
            (&["channel.delay"], c.delay <= 100, "0 to 100"),
            (&["channel.falsified"], share(c.falsified), "0 to 1"),
            (&["env.detection_range"], finite_range(e.detection_range), "0 or more"),
            (&["env.neighbours"], e.neighbours <= 16, "0 to 16"),
            (&["env.signal_distance"], (1.0..=200.0).contains(&e.signal_distance), "1 to 200"),
            (
                &["env.signal_distance", "env.intention"],
                e.intention == Intention::Signalled
                    || e.signal_distance == Observation::SIGNAL_DISTANCE,
                "30, the default, unless env.intention is signalled: otherwise no vehicle has an indicator",
            ),
            (&["env.conflict_streams"], e.conflict_streams <= 16, "0 to 16"),
            (&["env.stream_vehicles"], e.stream_vehicles <= 16, "0 to 16"),
            (&["env.encounters"], e.encounters <= 16, "0 to 16"),
            (&["env.borders"], (0.0..=20.0).contains(&e.borders), "0 to 20"),
            (&["env.foresight"], (0.0..=10.0).contains(&e.foresight), "0 to 10"),
            (&["env.priority_distance"], (0.0..=100.0).contains(&e.priority_distance), "0 to 100"),
            (&["env.lidar_beams"], e.lidar_beams <= Lidar::MOST, "0 to 360"),
            (&["env.lidar_range"], (1.0..=200.0).contains(&e.lidar_range), "1 to 200"),
            (&["env.communication_range"], finite_range(e.communication_range), "0 or more"),
            (&["env.cooperation"], share(e.cooperation), "0 to 1"),
            (&["env.share_range"], e.share_range >= 0.0, "0 or more, or inf"),
            (&["env.initial_throttle"], (-1.0..=1.0).contains(&e.initial_throttle), "-1 to 1"),
            (&["env.reward_progress"], e.reward_progress.is_finite(), "a finite number"),
            (&["env.reward_speed"], e.reward_speed.is_finite(), "a finite number"),
            (&["env.reward_arrive"], e.reward_arrive.is_finite(), "a finite number"),
            (&["env.reward_out_of_road"], e.reward_out_of_road.is_finite(), "a finite number"),
            (&["env.reward_crash"], e.reward_crash.is_finite(), "a finite number"),
            (&["env.horizon"], (1..=1_000_000).contains(&e.horizon), "1 to 1000000"),
            (&["env.wreck_time"], (0.0..=3600.0).contains(&e.wreck_time), "0 to 3600"),
            (&["env.penetration"], e.penetration > 0.0 && share(e.penetration), "above 0, to 1"),
            (
                &["network.extra_layers"],
                n.hidden.saturating_mul(n.extra_layers as i64 + 1) <= 1 << 16,
                "fewer or narrower layers",
            ),
        ];
        rules.into_iter().find(|rule| !rule.1).map(|(keys, _, allowed)| (keys, allowed))
    }
}
