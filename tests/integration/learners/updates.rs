//! What an update changes, and from which samples it learns.

use iwol_sumo::algo::settings::EncoderKind;
use iwol_sumo::algo::{self, ActMode, Algorithm, CommunicationScope, Observation};
use iwol_sumo::env::{ActionDimension, EnvSpec};
use iwol_sumo::rng::Seed;
use iwol_sumo::rollout::Rollout;
use tch::{Device, Kind, Tensor};

use super::{
    PACE, STILL, bits, build, complete, each, loud, noise, nothing, observation, random_rollout,
    reported, rollout_of, rollout_with, small, spec,
};

/// Every method learns with the discount of its settings.
#[test]
fn the_discount_of_the_settings_counts() {
    for name in algo::NAMES {
        let after = |gamma: f64| {
            let mut settings = small(EncoderKind::Mlp);
            settings.ppo.gamma = gamma;
            let mut learner = loud(name, &spec(4), &settings);
            let rollout = random_rollout(&*learner, 4, 3);
            learner.update(&rollout, &PACE, Seed::new(4)).expect("finite");
            bits(&*learner)
        };
        let low = after(0.9);
        assert!(low == after(0.9), "{name}: the same discount, the same bits");
        assert!(low != after(0.99), "{name}: the discount changes nothing");
    }
}

/// Agents learn from the advantages of others with the weight that the environment gives them, but
/// for methods whose agents learn from the return of their team.
#[test]
fn the_advantages_of_others_count() {
    for name in algo::NAMES {
        let after = |cooperation: f64| {
            let mut learner = loud(name, &spec(4), &small(EncoderKind::Mlp));
            let rollout = Rollout { cooperation, ..random_rollout(&*learner, 4, 3) };
            learner.update(&rollout, &PACE, Seed::new(4)).expect("finite");
            bits(&*learner)
        };
        let team = algo::capabilities(name).expect("known").team;
        assert_eq!(after(0.0) == after(0.5), team, "{name}");
    }
}

/// Messages are targets of Im-IWoL's interaction decoder, whose loss does not change them.
#[test]
fn messages_do_not_learn_to_be_predicted() {
    for name in ["im-iwol", "maddpg-iwol"] {
        let after = |weight: f64| {
            let mut settings = small(EncoderKind::Mlp);
            (settings.iwol.lambda_interaction, settings.maddpg.updates) = (weight, 1);
            let mut learner = loud(name, &spec(4), &settings);
            let rollout = random_rollout(&*learner, 4, 3);
            learner.update(&rollout, &PACE, Seed::new(4)).expect("finite");
            let part = |group: &'static str| {
                bits(&*learner)
                    .into_iter()
                    .filter(|(n, _)| n.starts_with(group))
                    .collect::<Vec<_>>()
            };
            (part("critic/"), part("actor/"))
        };
        let (critic, actor) = after(0.0);
        let (same, other) = after(5.0);
        assert!(!critic.is_empty() && critic == same, "{name}: the messages' networks");
        assert!(actor != other, "{name}: the policy's networks learn from it");
    }
}

#[test]
fn updates_are_deterministic_and_move_every_network() {
    each(|name, encoder| {
        let run = |seed: u64| {
            let mut settings = small(encoder);
            // CommFormer's graph is trained in the fifth pass.
            settings.ppo.epochs = 5;
            let mut learner = loud(name, &spec(4), &settings);
            let first = bits(&*learner);
            let rollout = random_rollout(&*learner, 4, 3);
            learner.update(&rollout, &PACE, Seed::new(seed)).expect("finite");
            let last = bits(&*learner);
            (first, last)
        };
        let (first, last) = run(4);
        assert_eq!(last, run(4).1, "{name} {encoder:?}: same seed, same bits");
        assert_ne!(last, run(5).1, "{name} {encoder:?}: the seed matters");
        let trained = |name: &str| {
            (name.ends_with("weight") || name.starts_with("graph/")) && !name.contains("adam")
        };
        for (before, after) in first.iter().zip(&last).filter(|(b, _)| trained(&b.0)) {
            assert_ne!(before.1, after.1, "{name} {encoder:?}: {} was not trained", before.0);
        }
    });
}

#[test]
fn without_a_learning_rate_nothing_moves() {
    each(|name, encoder| {
        let mut learner = build(name, &spec(4), &small(encoder), 2);
        let on_policy = algo::capabilities(name).expect("known").on_policy;
        let weights = |learner: &dyn Algorithm| {
            bits(learner)
                .into_iter()
                .filter(|(n, _)| n.starts_with("actor/") || n.starts_with("critic/"))
                // The last layer of MADDPG's critic is rescaled with the statistics that normalise
                // values.
                .filter(|(n, _)| on_policy || !n.starts_with("critic/value."))
                .collect::<Vec<_>>()
        };
        let before = weights(&*learner);
        learner.update(&random_rollout(&*learner, 4, 3), &STILL, Seed::new(4)).expect("finite");
        assert_eq!(before, weights(&*learner), "{name} {encoder:?}");
    });
}

#[test]
fn the_dead_do_not_teach() {
    each(|name, encoder| {
        let run = |rubbish: f32| {
            let mut learner = build(name, &spec(4), &small(encoder), 2);
            let mut rollout = random_rollout(&*learner, 4, 3);
            let s = rollout.sizes;
            for at in 0..(s.steps + 1) * s.envs * s.agents {
                if rollout.active[at] > 0.0 {
                    continue;
                }
                rollout.observation[at * 4..(at + 1) * 4].fill(rubbish);
                rollout.state[at * 3..(at + 1) * 3].fill(rubbish);
                if at < s.steps * s.envs * s.agents {
                    rollout.action[at] = rubbish;
                    rollout.reward[at] = rubbish;
                    rollout.log_prob[at] = rubbish;
                }
            }
            let losses = learner.update(&rollout, &PACE, Seed::new(4)).expect("finite");
            (bits(&*learner), losses)
        };
        let (calm, losses) = run(0.0);
        let (loud, same) = run(7.0);
        assert_eq!(losses, same, "{name} {encoder:?}");
        // A recurrent critic's memory of an inactive slot is cleared before the critic reads it,
        // and inactive entries of the replay buffer are never read.
        let weights = |bits: Vec<(String, Vec<u64>)>| {
            bits.into_iter().filter(|b| !b.0.contains("_memory/")).collect::<Vec<_>>()
        };
        assert_eq!(weights(calm), weights(loud), "{name} {encoder:?}");
    });
}

/// Two shards on two threads give the same result as one, up to rounding.
#[test]
fn shards_share_one_set_of_weights() {
    each(|name, encoder| {
        let run = |shards: usize| {
            let mut settings = small(encoder);
            settings.ppo.shards = shards;
            settings.ppo.average = 0.5;
            // With a share below 1, the decoders of two shards would learn from other samples.
            settings.iwol.decoded = 1.0;
            let mut learner = loud(name, &spec(4), &settings);
            let rollout = random_rollout(&*learner, 4, 3);
            let losses = learner.update(&rollout, &PACE, Seed::new(4)).expect("finite");
            (learner.state(), losses)
        };
        same_but_for_rounding(&run(1), &run(2), &format!("{name} {encoder:?}"));
    });
}

/// State and losses of a learner after an update.
type Updated = (Vec<(String, Tensor)>, algo::Losses);

/// Checks that two updates have made the same weights and losses, up to rounding. Adam's moments are
/// left out: their second moments are too small to compare.
fn same_but_for_rounding(one: &Updated, other: &Updated, what: &str) {
    for ((name, a), (_, b)) in one.0.iter().zip(&other.0).filter(|(a, _)| !a.0.contains("adam")) {
        let distance = (a - b).abs().max().double_value(&[]);
        assert!(distance < 2e-4, "{what}: {name} {distance}");
    }
    for ((name, a), (_, b)) in one.1.iter().zip(&other.1) {
        assert!((a - b).abs() < 1e-3 * (1.0 + a.abs()), "{what}: {name} {a} {b}");
    }
}

/// A minibatch that is too large for one pass of the networks has the gradient of its parts.
#[test]
fn large_minibatches_are_taken_in_parts() {
    for (name, encoder) in [
        ("mappo", EncoderKind::Mlp),
        ("im-iwol", EncoderKind::Gru),
        ("ex-iwol", EncoderKind::Mlp),
        ("magic", EncoderKind::Mlp),
    ] {
        let run = |shards: usize| {
            let mut settings = small(encoder);
            settings.ppo.shards = shards;
            settings.ppo.minibatch = 1_000_000;
            settings.iwol.decoded = 1.0;
            let mut learner = loud(name, &spec(20), &settings);
            let rollout = rollout_of(&*learner, 60, 20, 3, false);
            let losses = learner.update(&rollout, &PACE, Seed::new(4)).expect("finite");
            (learner.state(), losses)
        };
        // 19,200 samples in three passes of one copy of the networks, and in one pass of each of three.
        same_but_for_rounding(&run(1), &run(3), &format!("{name} {encoder:?}"));
    }
}

/// Two shards choose the same actions as one, but for rounding, also where messages are under way.
#[test]
fn shards_decide_as_one_does() {
    // So many that decisions are divided.
    const WORLDS: usize = 8;
    const AGENTS: usize = 33;
    each(|name, encoder| {
        let decided = |shards: usize| {
            let mut settings = small(encoder);
            settings.ppo.shards = shards;
            settings.channel.delay = u32::from(encoder == EncoderKind::Mlp);
            let learner = loud(name, &spec(AGENTS), &settings);
            let mut rollout = rollout_of(&*learner, WORLDS, AGENTS, 3, false);
            rollout.carried = vec![0.5; rollout.action.len()];
            rollout.log_fresh = vec![-0.5; rollout.sizes.steps];
            rollout.sizes.steps = 2;
            decide(&*learner, &mut rollout);
            [rollout.action, rollout.log_prob, rollout.memory]
        };
        let one = decided(1);
        assert!(one[0].iter().any(|action| *action != 0.0));
        for (a, b) in one.iter().zip(decided(2)) {
            let close = a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-3 * (1.0 + a.abs()));
            assert!(close && a.len() == b.len(), "{name} {encoder:?}");
        }
    });
}

/// An update without learning finds exactly the log-probabilities that the actions had when they
/// were chosen, with each environment's noise, graph and memory.
#[test]
fn an_update_sees_the_policy_that_acted() {
    each(|name, encoder| {
        if !algo::capabilities(name).expect("known").on_policy {
            return;
        }
        let mut learner = loud(name, &spec(4), &small(encoder));
        let mut rollout = rollout_with(&*learner, 4, 3, true);
        decide(&*learner, &mut rollout);
        nothing_moved(name, encoder, &mut *learner, &rollout);
        // Log-probabilities of correlated noise are conditional on the noise of the step before.
        rollout.carried =
            Vec::try_from(noise(71, &[rollout.action.len() as i64])).expect("numbers");
        rollout.log_fresh =
            (0..rollout.sizes.steps).map(|t| if t == 0 { 0.0 } else { -0.5 }).collect();
        decide(&*learner, &mut rollout);
        nothing_moved(name, encoder, &mut *learner, &rollout);
        let changed = Rollout { carried: Vec::new(), log_fresh: Vec::new(), ..rollout };
        let losses = learner.update(&changed, &STILL, Seed::new(4)).expect("finite");
        let kl = reported(&losses, "ppo/approx_kl");
        assert!(
            kl > 1e-3,
            "{name} {encoder:?}: scored as independent, it would be another policy: {kl}"
        );
    });
}

/// Acts on a rollout's observations with its noise, and stores actions, log-probabilities and
/// memories.
pub(super) fn decide(learner: &dyn Algorithm, rollout: &mut Rollout) {
    let s = rollout.sizes;
    let (e, n) = (s.envs as i64, s.agents as i64);
    let mut memory = Tensor::zeros([e, n, s.memory as i64], (Kind::Float, Device::Cpu));
    for t in 0..s.steps {
        let part = |array: &[f32], width: usize| {
            Tensor::from_slice(&array[rollout.at(t, width)]).view([e, n, -1])
        };
        let input = Observation::at(rollout, t, &memory);
        let graph = if s.graph_noise > 0 {
            part(&rollout.graph_noise, s.graph_noise)
        } else {
            Tensor::zeros([0], (Kind::Float, Device::Cpu))
        };
        let eps = noise(50 + t as u64, &[e, n, s.actions as i64]);
        let correlated = !rollout.carried.is_empty();
        let carried = if correlated { part(&rollout.carried, s.actions) } else { nothing() };
        let fresh = rollout.log_fresh.get(t).map_or_else(Vec::new, |fresh| vec![*fresh]);
        let (action, graph, carried, log_fresh) = (eps, graph, carried, fresh);
        let decision = learner.act(&input, &ActMode::Sample { action, carried, graph, log_fresh });
        let numbers = |x: &Tensor| Vec::<f32>::try_from(x.reshape([-1])).expect("numbers");
        let (cell, cells) = (rollout.at(t, s.actions), rollout.at(t, s.memory));
        rollout.memory[cells].copy_from_slice(&numbers(&memory));
        rollout.action[cell.clone()].copy_from_slice(&numbers(&decision.action));
        rollout.log_prob[cell].copy_from_slice(&numbers(&decision.log_prob));
        memory = decision.memory;
    }
}

/// Checks that an update without a learning rate finds the policy unchanged.
pub(super) fn nothing_moved(
    name: &str,
    encoder: EncoderKind,
    learner: &mut dyn Algorithm,
    rollout: &Rollout,
) {
    let losses = learner.update(rollout, &STILL, Seed::new(4)).expect("finite");
    let kl = reported(&losses, "ppo/approx_kl");
    assert!(kl.abs() < 1e-5, "{name} {encoder:?}: {kl}");
    assert_eq!(reported(&losses, "ppo/clip_fraction"), 0.0, "{name} {encoder:?}");
}

/// Acting, diagnostics and updates work where no agent is present, as in worlds whose agents have
/// all arrived or crashed.
#[test]
fn where_nobody_is_left_nothing_breaks() {
    each(|name, encoder| {
        let mut learner = loud(name, &spec(4), &small(encoder));
        let nobody = Tensor::zeros([2, 4, 4], (Kind::Float, Device::Cpu));
        let input = observation(&*learner, noise(1, &[2, 4, 4]), nobody);
        let state = noise(2, &[2, 4, 3]);
        assert_eq!(
            learner.act(&input, &ActMode::Deterministic).action.size(),
            [2, 4, 1],
            "{name} {encoder:?}"
        );
        let seen = learner.inspect(&input, &state);
        assert!(seen.value.is_none_or(|value| value.size() == [2, 4]), "{name} {encoder:?}");
        assert!(
            learner
                .reconstruct(&input, &state)
                .iter()
                .all(|told| told.prediction.size() == told.target.size())
        );
        let mut rollout = random_rollout(&*learner, 4, 3);
        rollout.active.fill(0.0);
        rollout.comm.fill(0.0);
        let losses = learner.update(&rollout, &PACE, Seed::new(4)).expect("finite");
        assert!(
            losses.iter().all(|(_, value)| value.is_finite()),
            "{name} {encoder:?}: {losses:?}"
        );
    });
}

/// Methods learn with 15, 16 and 17 agents; libtorch uses other code paths from 16 on.
#[test]
fn many_agents_learn_as_few_do() {
    each(|name, encoder| {
        for agents in [15, 16, 17] {
            let mut settings = small(encoder);
            (settings.ppo.shards, settings.ppo.epochs, settings.maddpg.updates) = (1, 1, 2);
            let mut learner = loud(name, &spec(agents), &settings);
            let rollout = random_rollout(&*learner, agents, 3);
            learner
                .update(&rollout, &PACE, Seed::new(4))
                .unwrap_or_else(|e| panic!("{name} {encoder:?}, {agents}: {e}"));
        }
    });
}

/// Methods learn with two action dimensions. Where one has become more and the other less likely by
/// as much, the ratio of the whole action is 1, and those of its dimensions are not.
#[test]
fn several_action_dimensions_are_learned_from() {
    for name in algo::NAMES {
        let spec = EnvSpec {
            actions: ["steer", "throttle"].map(ActionDimension::named).to_vec().into(),
            ..spec(3)
        };
        let mut settings = small(EncoderKind::Mlp);
        let on_policy = algo::capabilities(name).expect("known").on_policy;
        if on_policy {
            // All samples at once, so that the advantages have a mean of 0.
            (settings.ppo.minibatch, settings.ppo.epochs) = (1_000_000, 1);
        }
        let mut learner = build(name, &spec, &settings, 2);
        let input = observation(&*learner, noise(1, &[2, 3, 4]), complete(2, 3));
        let decision = learner.act(&input, &ActMode::Deterministic);
        assert_eq!(
            (decision.action.size(), decision.log_prob.size()),
            (vec![2, 3, 2], vec![2, 3, 2]),
            "{name}"
        );
        let mut rollout = random_rollout(&*learner, 3, 3);
        rollout = Rollout {
            action: [&rollout.action[..]; 2].concat(),
            log_prob: [&rollout.log_prob[..]; 2].concat(),
            ..rollout
        };
        rollout.sizes.actions = 2;
        if !on_policy {
            let losses = learner.update(&rollout, &PACE, Seed::new(4)).expect("finite");
            assert!(losses.iter().all(|(_, value)| value.is_finite()), "{name}");
            continue;
        }
        decide(&*learner, &mut rollout);
        for (k, log_prob) in rollout.log_prob.iter_mut().enumerate() {
            *log_prob += if k % 2 == 0 { -0.5 } else { 0.5 };
        }
        let losses = learner.update(&rollout, &STILL, Seed::new(4)).expect("finite");
        let policy = reported(&losses, "loss/policy");
        let by_dimension = ["mat", "commformer"].contains(&name);
        assert_eq!(policy.abs() > 0.05, by_dimension, "{name}: {policy}");
    }
}

/// The decoder of symbols learns of actions only within their bounds, because other agents see the
/// executed action.
#[test]
fn symbols_tell_of_actions_within_their_bounds() {
    each(|name, encoder| {
        if algo::capabilities(name).expect("known").scope != CommunicationScope::InRangeNextStep {
            return;
        }
        let told = |change: fn(f32) -> f32| {
            let mut learner = loud(name, &spec(4), &small(encoder));
            let mut rollout = random_rollout(&*learner, 4, 3);
            rollout.action.iter_mut().for_each(|action| *action = change(4.0 * *action));
            let losses = learner.update(&rollout, &STILL, Seed::new(4)).expect("finite");
            reported(&losses, "loss/message")
        };
        assert_eq!(
            told(|action| action),
            told(|action| action.clamp(-1.0, 1.0)),
            "{name} {encoder:?}"
        );
        assert_ne!(
            told(|action| action),
            told(|action| action.clamp(-0.9, 0.9)),
            "{name} {encoder:?}: it tells of actions"
        );
    });
}
