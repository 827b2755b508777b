//! Properties that every learner must have: the agents that can influence an action, determinism,
//! and learning itself. The tests use no simulator.

use iwol_sumo::algo::{
    self, ActMode, Algorithm, Channel, ChannelNoise, CommunicationScope, Observation, Settings,
    UpdateParameters,
    settings::{EncoderKind, GraphNoise},
};
use iwol_sumo::env::{ActionDimension, EnvSpec, Feature, Features, Group};
use iwol_sumo::rng::{self, Seed};
use iwol_sumo::rollout::{Rollout, Sizes};
use tch::{Device, Kind, Tensor};

const PACE: UpdateParameters =
    UpdateParameters { learning_rate: 7e-4, log_std: -0.2, gamma: 0.99, batch_growth: 1 };
const STILL: UpdateParameters =
    UpdateParameters { learning_rate: 0.0, log_std: 0.0, gamma: 0.99, batch_growth: 1 };
const ENCODERS: [EncoderKind; 3] = [EncoderKind::Mlp, EncoderKind::Attention, EncoderKind::Gru];

fn features(count: usize) -> Features {
    let feature =
        |i: usize| Feature { name: format!("f{i}"), unit: "1".to_owned(), low: -1.0, high: 1.0 };
    let group = |offset, width, count| Group {
        name: format!("g{offset}"),
        offset,
        width,
        count,
        presence: None,
    };
    Features {
        list: (0..count).map(feature).collect(),
        groups: vec![group(0, 1, 1), group(1, count - 1, 1)],
    }
}

fn spec(agents: usize) -> EnvSpec {
    EnvSpec {
        agents,
        actions: vec![ActionDimension::named("throttle")],
        observation: features(4),
        state: features(3),
    }
}

fn small(encoder: EncoderKind) -> Settings {
    let mut settings = Settings::default();
    settings.network.encoder = encoder;
    settings.network.hidden = 16;
    settings.network.token_width = 8;
    settings.iwol.rounds = 2;
    settings.iwol.message = 12;
    settings.iwol.latent = 4;
    // Every agent may listen to every other agent.
    settings.commformer.sparsity = 1.0;
    settings.commformer.graph_every = 2;
    settings.maddpg.updates = 20;
    settings.maddpg.target_rate = 0.02;
    settings.magic.lambda_world = 0.05;
    settings.commformer.lambda_world = 0.05;
    settings.ppo.minibatch = 64;
    settings.ppo.epochs = 2;
    settings
}

fn noise(seed: u64, shape: &[i64]) -> Tensor {
    let mut values = vec![0.0; shape.iter().product::<i64>() as usize];
    rng::fill_normal(&mut Seed::new(seed).rng(), &mut values);
    Tensor::from_slice(&values).view(shape)
}

fn nothing() -> Tensor {
    Tensor::zeros([0], (Kind::Float, Device::Cpu))
}

fn observation(learner: &dyn Algorithm, x: Tensor, comm: Tensor) -> Observation {
    let (e, n, _) = x.size3().expect("[E, N, O]");
    let memory = noise(5, &[e, n, learner.memory() as i64]);
    Observation {
        observation: x,
        comm,
        start: Tensor::zeros([e, n], (Kind::Float, Device::Cpu)),
        memory,
    }
}

/// Returns the actions when every edge of the learned graph is open.
fn act(learner: &dyn Algorithm, x: &Tensor, comm: &Tensor) -> Vec<Vec<f32>> {
    let (e, n, _) = x.size3().expect("[E, N, O]");
    let zero = Tensor::zeros([e, n, 1], (Kind::Float, Device::Cpu));
    let open = Tensor::full([e, n, n * learner.graphs() as i64], 1e4, (Kind::Float, Device::Cpu));
    let input = observation(learner, x.copy(), comm.copy());
    let (action, graph, carried, log_fresh) = (&zero, &open, &nothing(), 0.0);
    let decision = learner.act(&input, &ActMode::Sample { action, carried, graph, log_fresh });
    Vec::try_from(decision.action.view([n, 1])).expect("actions")
}

/// Builds a learner with disturbed weights. New weights in the message path are close to the
/// identity (gain 0.01), so that effects through that path would be lost in rounding.
fn loud(name: &str, spec: &EnvSpec, settings: &Settings) -> Box<dyn Algorithm> {
    let mut learner =
        algo::build(name, spec, settings, Seed::new(1), Device::Cpu).expect("a learner");
    let mut state = learner.state();
    for (i, (name, tensor)) in state.iter_mut().enumerate() {
        if name.starts_with("actor/") || name.starts_with("critic/") {
            *tensor = &*tensor + 0.3 * noise(100 + i as u64, &tensor.size());
        }
    }
    learner.load(&state).expect("its own state");
    learner
}

/// Returns a physical mask in which agents 0 and 1 are in range of each other, agents 2 and 3 as
/// well, no other pair is, and agent 4 is absent.
fn pairs() -> Tensor {
    let comm = Tensor::zeros([1, 5, 5], (Kind::Float, Device::Cpu));
    for (i, j) in [(0, 0), (1, 1), (2, 2), (3, 3), (0, 1), (1, 0), (2, 3), (3, 2)] {
        let _ = comm.get(0).get(i).get(j).fill_(1.0);
    }
    comm
}

/// An observation changes at once only the actions that it may change: the agent's own, and those
/// of agents within range or of all present agents, depending on the method.
#[test]
fn observations_reach_whom_they_may_and_nobody_else() {
    each(|name, encoder| {
        let scope = algo::capabilities(name).expect("known").scope;
        let learner = loud(name, &spec(5), &small(encoder));
        let (x, comm) = (noise(1, &[1, 5, 4]), pairs());
        let before = act(&*learner, &x, &comm);
        for j in 0..5 {
            let changed = x.copy();
            let _ = changed.get(0).get(j).fill_(9.0);
            let after = act(&*learner, &changed, &comm);
            for i in 0..4 {
                let reached = match scope {
                    CommunicationScope::None | CommunicationScope::InRangeNextStep => false,
                    CommunicationScope::InRange => comm.double_value(&[0, i as i64, j]) > 0.0,
                    CommunicationScope::All => j != 4,
                };
                let own = i as i64 == j;
                assert_eq!(
                    before[i] != after[i],
                    reached || own,
                    "{name} {encoder:?}: {j} against {i}"
                );
            }
        }
        let alone = act(&*learner, &x, &Tensor::eye(5, (Kind::Float, Device::Cpu)).unsqueeze(0));
        assert_eq!(
            scope == CommunicationScope::None,
            before[..4] == alone[..4],
            "{name}: the range decides who hears whom"
        );
    });
}

/// An agent's action shows a symbol to the agents within range, who read it in the next step.
#[test]
fn symbols_are_seen_a_step_later_and_within_range() {
    each(|name, encoder| {
        if algo::capabilities(name).expect("known").scope != CommunicationScope::InRangeNextStep {
            return;
        }
        let learner = algo::build(name, &spec(5), &small(encoder), Seed::new(1), Device::Cpu)
            .expect("a learner");
        let decide = |x: Tensor, memory: Option<Tensor>| {
            let input = observation(&*learner, x, pairs());
            let memory = memory.unwrap_or_else(|| input.memory.zeros_like());
            learner.act(&Observation { memory, ..input }, &ActMode::Deterministic)
        };
        let second = |first: Tensor| -> Vec<f32> {
            let memory = decide(first, None).memory;
            Vec::try_from(decide(noise(1, &[1, 5, 4]), Some(memory)).action.view([5]))
                .expect("actions")
        };
        let before = second(noise(2, &[1, 5, 4]));
        let mut seen = 0;
        for (j, k) in (0..5).flat_map(|j| (0..20).map(move |k| (j, k))) {
            let changed = noise(2, &[1, 5, 4]);
            changed.get(0).get(j).copy_(&(noise(50 + k, &[4]) * 2.0));
            let after = second(changed);
            for i in (0..4).filter(|&i| i as i64 != j && before[i] != after[i]) {
                assert!(
                    pairs().double_value(&[0, i as i64, j]) > 0.0,
                    "{name} {encoder:?}: {j} against {i}"
                );
                seen += 1;
            }
        }
        // Many observations may have the same symbol, so that not every change is seen.
        assert!(seen > 0, "{name} {encoder:?}: {seen}");
    });
}

/// Returns a rollout of random numbers in which agents end and their slots start new trajectories
/// later.
fn random_rollout(learner: &dyn Algorithm, agents: usize, seed: u64) -> Rollout {
    rollout_with(learner, agents, seed, false)
}

/// Returns such a rollout in which, with `newcomers`, new agents come into slots that were empty for
/// a step.
fn rollout_with(learner: &dyn Algorithm, agents: usize, seed: u64, newcomers: bool) -> Rollout {
    let sizes = Sizes {
        steps: 16,
        envs: 3,
        agents,
        observation: 4,
        state: 3,
        actions: 1,
        memory: learner.memory(),
        graphs: learner.graphs(),
    };
    let mut rollout = Rollout::new(sizes);
    let mut rng = Seed::new(seed).rng();
    for array in [
        &mut rollout.observation,
        &mut rollout.state,
        &mut rollout.action,
        &mut rollout.log_prob,
        &mut rollout.reward,
        &mut rollout.memory,
        &mut rollout.graph_noise,
    ] {
        rng::fill_normal(&mut rng, array);
        for x in array.iter_mut() {
            *x *= 0.5;
        }
    }
    for e in 0..sizes.envs {
        for i in 0..agents {
            let mut alive = true;
            for t in 0..=sizes.steps {
                let at = (t * sizes.envs + e) * agents + i;
                // A new episode begins in the whole environment at step 8.
                let comes = newcomers
                    && t > 0
                    && !alive
                    && rollout.active[at - sizes.envs * agents] == 0.0
                    && rng::below(&mut rng, 3) == 0;
                if t == 8 || comes {
                    alive = true;
                    rollout.start[at] = 1.0;
                }
                rollout.active[at] = f32::from(u8::from(alive));
                if t < sizes.steps && alive && (rng::below(&mut rng, 6) == 0 || t == 7) {
                    rollout.terminated[at] = 1.0;
                    alive = false;
                }
            }
        }
        for t in 0..=sizes.steps {
            let active = rollout.active[rollout.cell(t, e, 1)].to_vec();
            let cell = rollout.cell(t, e, agents);
            for (k, link) in rollout.comm[cell].iter_mut().enumerate() {
                *link = active[k / agents] * active[k % agents];
            }
        }
    }
    rollout
}

fn bits(learner: &dyn Algorithm) -> Vec<(String, Vec<u64>)> {
    let value =
        |t: &Tensor| Vec::<f64>::try_from(t.to_kind(Kind::Double).reshape([-1])).expect("numbers");
    learner
        .state()
        .iter()
        .map(|(n, t)| (n.clone(), value(t).iter().map(|v| v.to_bits()).collect()))
        .collect()
}

fn each(mut check: impl FnMut(&str, EncoderKind)) {
    for name in algo::NAMES {
        let recurrent = algo::capabilities(name).expect("known").recurrent;
        for encoder in
            ENCODERS.into_iter().filter(|encoder| recurrent || *encoder != EncoderKind::Gru)
        {
            check(name, encoder);
        }
    }
}

#[test]
fn updates_are_deterministic_and_move_every_network() {
    each(|name, encoder| {
        let run = |seed: u64| {
            let mut learner = loud(name, &spec(4), &small(encoder));
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
        let mut learner = algo::build(name, &spec(4), &small(encoder), Seed::new(2), Device::Cpu)
            .expect("a learner");
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

/// The first pass whose KL divergence exceeds `target_kl` is the last one: the result is that of an
/// update with this number of passes.
#[test]
fn a_policy_that_moves_too_far_ends_its_update() {
    const PASSES: usize = 4;
    for name in algo::NAMES.iter().filter(|name| algo::capabilities(name).expect("known").on_policy)
    {
        let update = |epochs: usize, target_kl: f64| {
            let mut settings = small(EncoderKind::Mlp);
            (settings.ppo.epochs, settings.ppo.target_kl) = (epochs, target_kl);
            let mut learner = loud(name, &spec(4), &settings);
            let rollout = random_rollout(&*learner, 4, 3);
            let losses = learner.update(&rollout, &PACE, Seed::new(4)).expect("finite");
            let of = |what: &str| {
                losses.iter().find(|(found, _)| *found == what).expect("is reported").1
            };
            (of("ppo/passes"), of("ppo/approx_kl"), bits(&*learner))
        };
        // By default all passes are made. The divergence of each one follows from the means over
        // all passes.
        let whole: Vec<_> = (1..=PASSES).map(|passes| update(passes, 0.0)).collect();
        let total =
            |passes: usize| if passes == 0 { 0.0 } else { passes as f64 * whole[passes - 1].1 };
        let moved: Vec<f64> = (1..=PASSES).map(|pass| total(pass) - total(pass - 1)).collect();
        let (least, most) = (
            moved.iter().copied().fold(f64::MAX, f64::min),
            moved.iter().copied().fold(0.0, f64::max),
        );
        assert!(least > 0.0 && most > 1.01 * least, "{name}: {moved:?}");
        for target in [0.99 * least, f64::midpoint(least, most), 1.01 * most] {
            let passes =
                moved.iter().position(|&moved| moved > target).map_or(PASSES, |last| last + 1);
            assert_eq!(whole[passes - 1].0, passes as f64, "{name}");
            assert_eq!(update(PASSES, target), whole[passes - 1], "{name}: {moved:?}, {target}");
        }
    }
}

#[test]
fn the_dead_do_not_teach() {
    each(|name, encoder| {
        let run = |rubbish: f32| {
            let mut learner =
                algo::build(name, &spec(4), &small(encoder), Seed::new(2), Device::Cpu)
                    .expect("a learner");
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
        let ((one, losses), (two, others)) = (run(1), run(2));
        for ((name_1, a), (_, b)) in one.iter().zip(&two).filter(|(a, _)| !a.0.contains("adam")) {
            let distance = (a - b).abs().max().double_value(&[]);
            assert!(distance < 2e-4, "{name} {encoder:?}: {name_1} {distance}");
        }
        for ((what, a), (_, b)) in losses.iter().zip(&others) {
            assert!((a - b).abs() < 1e-3 * (1.0 + a.abs()), "{name} {encoder:?}: {what} {a} {b}");
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
        nothing_moved(name, encoder, &mut *learner, &rollout, STILL);
        // Log-probabilities of correlated noise are conditional on the noise of the step before.
        rollout.carried =
            Vec::try_from(noise(71, &[rollout.action.len() as i64])).expect("numbers");
        rollout.log_fresh =
            (0..rollout.sizes.steps).map(|t| if t == 0 { 0.0 } else { -0.5 }).collect();
        decide(&*learner, &mut rollout);
        nothing_moved(name, encoder, &mut *learner, &rollout, STILL);
        let changed = Rollout { carried: Vec::new(), log_fresh: Vec::new(), ..rollout };
        let losses = learner.update(&changed, &STILL, Seed::new(4)).expect("finite");
        let kl = losses.iter().find(|loss| loss.0 == "ppo/approx_kl").expect("reported").1;
        assert!(
            kl > 1e-3,
            "{name} {encoder:?}: scored as independent, it would be another policy: {kl}"
        );
    });
}

/// Graphs that an update draws again have the noise scale of those that acted: with hardly any
/// noise, they are the same graphs.
#[test]
fn graphs_that_are_drawn_again_have_the_noise_of_those_that_acted() {
    each(|name, encoder| {
        let mut settings = small(encoder);
        settings.iwol.graph_noise = GraphNoise::Resampled;
        let mut learner = loud(name, &spec(4), &settings);
        if learner.graphs() == 0 {
            return;
        }
        let mut rollout = random_rollout(&*learner, 4, 3);
        rollout.graph_noise.fill(0.0);
        decide(&*learner, &mut rollout);
        nothing_moved(
            name,
            encoder,
            &mut *learner,
            &rollout,
            UpdateParameters { log_std: -8.0, ..STILL },
        );
    });
}

/// Acts on a rollout's observations with its noise, and stores actions, log-probabilities and
/// memories.
fn decide(learner: &dyn Algorithm, rollout: &mut Rollout) {
    let s = rollout.sizes;
    let (e, n) = (s.envs as i64, s.agents as i64);
    let mut memory = Tensor::zeros([e, n, s.memory as i64], (Kind::Float, Device::Cpu));
    for t in 0..s.steps {
        let part = |array: &[f32], width: usize| {
            Tensor::from_slice(&array[rollout.at(t, width)]).view([e, n, -1])
        };
        let input = Observation {
            observation: part(&rollout.observation, s.observation),
            comm: part(&rollout.comm, s.agents),
            start: part(&rollout.start, 1).squeeze_dim(-1),
            memory: memory.shallow_clone(),
        };
        let graph = if s.graphs > 0 {
            part(&rollout.graph_noise, s.agents * s.graphs)
        } else {
            Tensor::zeros([0], (Kind::Float, Device::Cpu))
        };
        let eps = noise(50 + t as u64, &[e, n, 1]);
        let correlated = !rollout.carried.is_empty();
        let carried = if correlated { part(&rollout.carried, 1) } else { nothing() };
        let fresh = rollout.log_fresh.get(t).map_or(0.0, |fresh| f64::from(*fresh));
        let (action, graph, carried, log_fresh) = (&eps, &graph, &carried, fresh);
        let decision = learner.act(&input, &ActMode::Sample { action, carried, graph, log_fresh });
        let numbers = |x: &Tensor| Vec::<f32>::try_from(x.reshape([-1])).expect("numbers");
        let (cell, cells) = (rollout.at(t, 1), rollout.at(t, s.memory));
        rollout.memory[cells].copy_from_slice(&numbers(&memory));
        rollout.action[cell.clone()].copy_from_slice(&numbers(&decision.action));
        rollout.log_prob[cell].copy_from_slice(&numbers(&decision.log_prob));
        memory = decision.memory;
    }
}

/// Checks that an update without a learning rate finds the policy unchanged.
fn nothing_moved(
    name: &str,
    encoder: EncoderKind,
    learner: &mut dyn Algorithm,
    rollout: &Rollout,
    parameters: UpdateParameters,
) {
    let losses = learner.update(rollout, &parameters, Seed::new(4)).expect("finite");
    let of = |what: &str| losses.iter().find(|l| l.0 == what).expect("reported").1;
    assert!(of("ppo/approx_kl").abs() < 1e-5, "{name} {encoder:?}: {}", of("ppo/approx_kl"));
    assert_eq!(of("ppo/clip_fraction"), 0.0, "{name} {encoder:?}");
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

/// Predictions of decoders that are not trained are not reported.
#[test]
fn only_decoders_that_learn_tell_something() {
    for name in algo::NAMES {
        let latent = algo::capabilities(name).expect("known").latent;
        for (world, interaction) in [(0.1, 0.1), (0.1, 0.0), (0.0, 0.1), (0.0, 0.0)] {
            let mut settings = small(EncoderKind::Mlp);
            (settings.iwol.lambda_world, settings.iwol.lambda_interaction) = (world, interaction);
            (settings.magic.lambda_world, settings.commformer.lambda_world) = (0.0, 0.0);
            let learner = algo::build(name, &spec(4), &settings, Seed::new(1), Device::Cpu)
                .expect("a learner");
            let input = observation(
                &*learner,
                noise(1, &[2, 4, 4]),
                Tensor::ones([2, 4, 4], (Kind::Float, Device::Cpu)),
            );
            let told: Vec<_> = learner
                .reconstruct(&input, &noise(2, &[2, 4, 3]))
                .iter()
                .map(|told| told.name)
                .collect();
            let learns =
                |what: &&str| if *what == "world" { world > 0.0 } else { interaction > 0.0 };
            assert_eq!(told, latent.iter().copied().filter(learns).collect::<Vec<_>>(), "{name}");
        }
    }
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
            losses.iter().find(|l| l.0 == "loss/message").expect("reported").1
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

/// A perfect channel changes nothing, a channel that loses every message leaves each agent with its
/// own observation, and local policies are not affected by any channel.
#[test]
fn channels_stand_between_agents_and_nowhere_else() {
    // Policies with one round of attention have a code path of their own.
    each(|name, encoder| {
        for rounds in [1, 2] {
            let mut settings = small(encoder);
            settings.iwol.rounds = rounds;
            let learner = loud(name, &spec(5), &settings);
            let (x, comm) =
                (noise(1, &[2, 5, 4]), Tensor::ones([2, 5, 5], (Kind::Float, Device::Cpu)));
            let chance = || Tensor::full([2, 5, 5], 0.5, (Kind::Float, Device::Cpu));
            let width = learner.message_width() as i64;
            assert_eq!(algo::capabilities(name).expect("known").messages, width > 0, "{name}");
            let through = |channel: &Channel| {
                let mut input = observation(&*learner, x.copy(), comm.copy());
                let past = Tensor::zeros(
                    [2, 5, channel.memory(width as usize) as i64],
                    (Kind::Float, Device::Cpu),
                );
                input.memory = Tensor::cat(&[&input.memory, &past], -1);
                let content = noise(9, &[2, 5, 5, width.max(1)]);
                let noise = ChannelNoise {
                    lost: noise(8, &[2, 5, 5]).sigmoid(),
                    falsified: chance(),
                    content,
                };
                learner.act_through(&input, channel, &noise).action
            };
            let plain = |comm: &Tensor| {
                let input = observation(&*learner, x.copy(), comm.copy());
                learner.act(&input, &ActMode::Deterministic).action
            };
            let apart = |a: &Tensor, b: &Tensor| (a - b).abs().max().double_value(&[]);
            let together = plain(&comm);
            assert!(apart(&through(&Channel::default()), &together) < 1e-4, "{name} {encoder:?}");
            let alone = Tensor::eye(5, (Kind::Float, Device::Cpu)).expand([2, 5, 5], false);
            let silence = through(&Channel { loss: 1.0, ..Channel::default() });
            let expected = if width > 0 { plain(&alone) } else { together.shallow_clone() };
            assert!(apart(&silence, &expected) < 1e-4, "{name} {encoder:?}");
            // Agents out of range stay out of range.
            let (pairs, bits) =
                (pairs().repeat([2, 1, 1]), Channel { bits: 31, ..Channel::default() });
            let reached = |comm: &Tensor| {
                let mut input = observation(&*learner, x.copy(), comm.copy());
                let past = Tensor::zeros(
                    [2, 5, bits.memory(width as usize) as i64],
                    (Kind::Float, Device::Cpu),
                );
                input.memory = Tensor::cat(&[&input.memory, &past], -1);
                let content = noise(9, &[2, 5, 5, width.max(1)]);
                let noise = ChannelNoise { lost: chance(), falsified: chance(), content };
                learner.act_through(&input, &bits, &noise).action
            };
            let those_there = |actions: &Tensor| actions.narrow(1, 0, 4);
            assert!(
                apart(&those_there(&reached(&pairs)), &those_there(&plain(&pairs))) < 1e-4,
                "{name} {encoder:?}"
            );
            // 31 bits are as good as 32, but make each receiver compute its own messages.
            let [some, each] =
                [32, 31].map(|bits| through(&Channel { loss: 0.6, bits, ..Channel::default() }));
            assert!(apart(&some, &each) < 1e-4, "{name} {encoder:?}");
            assert_eq!(apart(&some, &together) > 1e-4, width > 0, "{name} {encoder:?}");
            let bad = [
                Channel { bits: 2, ..Channel::default() },
                Channel { falsified: 1.0, ..Channel::default() },
                Channel { delay: 3, ..Channel::default() },
            ];
            for channel in bad {
                assert_eq!(
                    apart(&through(&channel), &together) > 1e-4,
                    width > 0,
                    "{name} {encoder:?} {channel:?}"
                );
            }
        }
    });
}

/// CommFormer's dropout, an option of the released code, changes updates but no decisions, and
/// depends only on the seed.
#[test]
fn dropout_changes_updates_and_no_decision() {
    let learner = |dropout: f64| {
        let mut settings = small(EncoderKind::Mlp);
        settings.commformer.dropout = dropout;
        loud("commformer", &spec(4), &settings)
    };
    let (x, comm) = (noise(1, &[1, 4, 4]), Tensor::ones([1, 4, 4], (Kind::Float, Device::Cpu)));
    assert_eq!(act(&*learner(0.0), &x, &comm), act(&*learner(0.3), &x, &comm));
    let updated = |dropout: f64, seed: u64| {
        let mut learner = learner(dropout);
        let rollout = random_rollout(&*learner, 4, 3);
        learner.update(&rollout, &PACE, Seed::new(seed)).expect("finite");
        act(&*learner, &x, &comm)
    };
    assert_eq!(updated(0.3, 1), updated(0.3, 1));
    assert_ne!(updated(0.3, 1), updated(0.0, 1));
}

#[test]
fn averaged_weights_follow_and_can_be_exchanged() {
    each(|name, encoder| {
        let mut settings = small(encoder);
        settings.ppo.average = 0.75;
        let mut learner =
            algo::build(name, &spec(4), &settings, Seed::new(2), Device::Cpu).expect("a learner");
        let of = |state: &[(String, Tensor)], prefix: &str| -> Vec<Tensor> {
            let named = state.iter().filter(|(n, _)| n.starts_with(prefix));
            named.map(|(_, t)| t.shallow_clone()).collect()
        };
        let start = learner.state();
        learner.update(&random_rollout(&*learner, 4, 3), &PACE, Seed::new(4)).expect("finite");
        let end = learner.state();
        let average = of(&end, "actor_average/");
        assert_eq!(average.len(), of(&start, "actor/").len());
        for ((first, last), average) in
            of(&start, "actor/").iter().zip(of(&end, "actor/")).zip(&average)
        {
            let expected = first * 0.75 + last * 0.25;
            assert!(
                (expected - average).abs().max().double_value(&[]) < 1e-6,
                "{name} {encoder:?}"
            );
        }
        learner.swap_average();
        let swapped = learner.state();
        assert!(
            of(&swapped, "actor/").iter().zip(&average).all(|(a, b)| a.equal(b)),
            "{name}: acts with the average"
        );
        learner.swap_average();
        let again = bits(&*learner);
        assert!(end.iter().map(|(n, _)| n).eq(again.iter().map(|(n, _)| n)));
        assert!(
            learner.state().iter().zip(&end).all(|(a, b)| a.1.equal(&b.1)),
            "{name}: nothing is lost"
        );

        // A new run takes over the averaged policy and the value function, but keeps its own noise.
        let any_number = algo::capabilities(name).expect("known").any_number;
        let agents = if any_number { 9 } else { 4 };
        let mut next = algo::build(name, &spec(agents), &settings, Seed::new(8), Device::Cpu)
            .expect("a learner");
        next.load_weights(&end).expect("weights fit");
        if !any_number {
            let mut more = algo::build(name, &spec(9), &settings, Seed::new(8), Device::Cpu)
                .expect("a learner");
            let refused =
                more.load_weights(&end).expect_err("of another number of agents").to_string();
            assert!(refused.contains("each of 4 agents and cannot be used with 9"), "{refused}");
        }
        let begun = next.state();
        for ((what, a), b) in begun.iter().filter(|(n, _)| n.starts_with("actor/")).zip(&average) {
            assert_eq!(a.equal(b), what != "actor/head.log_std", "{name}: {what}");
        }
        assert!(of(&begun, "critic/").iter().zip(of(&end, "critic/")).all(|(a, b)| a.equal(&b)));
    });
}

#[test]
fn a_state_is_taken_over_whole_or_not_at_all() {
    each(|name, encoder| {
        let mut trained = algo::build(name, &spec(4), &small(encoder), Seed::new(2), Device::Cpu)
            .expect("a learner");
        trained.update(&random_rollout(&*trained, 4, 3), &PACE, Seed::new(4)).expect("finite");
        let mut fresh = algo::build(name, &spec(4), &small(encoder), Seed::new(9), Device::Cpu)
            .expect("a learner");
        fresh.load(&trained.state()).expect("the same network");
        assert_eq!(bits(&*fresh), bits(&*trained), "{name} {encoder:?}");
        let next = random_rollout(&*trained, 4, 6);
        trained.update(&next, &PACE, Seed::new(7)).expect("finite");
        fresh.update(&next, &PACE, Seed::new(7)).expect("finite");
        assert_eq!(bits(&*fresh), bits(&*trained), "{name} {encoder:?}: the next update too");
        let mut state = trained.state();
        drop(state.remove(0));
        assert!(fresh.load(&state).is_err());
    });
}

/// Games of two agents that each see a number.
#[derive(Clone, Copy, PartialEq)]
enum Game {
    /// The best action is the other agent's number.
    Other,
    /// The best action is the number that the other agent had one step before.
    OtherBefore,
    /// Both agents see both numbers and share a reward: the sum of what they drive, minus a penalty
    /// for driving at the same time.
    Crossing,
}

impl Game {
    /// Returns the number of steps of an episode.
    fn steps(self) -> usize {
        if self == Self::OtherBefore { 2 } else { 1 }
    }

    /// Returns the rewards for `actions` of pairs of agents whose first features are `x` and were
    /// `before` one step earlier.
    fn rewards(self, x: &[f32], before: &[f32], actions: &[f32]) -> Vec<f32> {
        let off = |k: usize, aim: f32| -(actions[k] - aim).powi(2);
        let driven = |k: usize| actions[k].clamp(0.0, 1.0);
        let reward = |k: usize| match self {
            Self::Other => off(k, x[k ^ 1]),
            Self::OtherBefore if before.is_empty() => 0.0,
            Self::OtherBefore => off(k, before[k ^ 1]),
            Self::Crossing => driven(k) + driven(k ^ 1) - 4.0 * driven(k) * driven(k ^ 1),
        };
        (0..actions.len()).map(reward).collect()
    }
}

/// Trains a learner for `updates` updates and returns the mean reward of the last one.
fn play(name: &str, game: Game, updates: u64) -> f32 {
    let (e, n, o) = (32_usize, 2, 4);
    let mut settings = small(EncoderKind::Mlp);
    settings.exploration.log_std_start = -0.5;
    settings.ppo.minibatch = 256;
    // A second shard would double the number of operations, whose number takes the time here.
    settings.ppo.shards = 1;
    let mut learner =
        algo::build(name, &spec(n), &settings, Seed::new(1), Device::Cpu).expect("a learner");
    let sizes = Sizes {
        steps: 16,
        envs: e,
        agents: n,
        observation: o,
        state: 3,
        actions: 1,
        memory: learner.memory(),
        graphs: learner.graphs(),
    };
    let mut rollout = Rollout::new(sizes);
    rollout.active.fill(1.0);
    rollout.comm.fill(1.0);
    for t in (0..=sizes.steps).step_by(game.steps()) {
        let cell = rollout.at(t, 1);
        rollout.start[cell].fill(1.0);
    }
    for t in (game.steps() - 1..sizes.steps).step_by(game.steps()) {
        let cell = rollout.at(t, 1);
        rollout.terminated[cell].fill(1.0);
    }
    let shaped = |values: &[f32], width: usize| {
        Tensor::from_slice(values).view([e as i64, n as i64, width as i64])
    };
    let mut mean = 0.0;
    for update in 0..updates {
        let mut rng = Seed::new(2).index(update).rng();
        rollout.observation.iter_mut().for_each(|x| *x = rng::symmetric(&mut rng) as f32);
        for pair in rollout.observation.chunks_mut(n * o) {
            match game {
                Game::Crossing => (pair[1], pair[o + 1]) = (pair[o], pair[0]),
                // A symbol is about all that its sender saw, so that only the number is left to
                // encode.
                Game::OtherBefore => (0..n * o).filter(|i| i % o > 0).for_each(|i| pair[i] = 0.0),
                Game::Other => {}
            }
        }
        rng::fill_logistic(&mut rng, &mut rollout.graph_noise);
        let mut eps = vec![0.0; e * n];
        let (mut before, mut memory) = (Vec::new(), vec![0.0_f32; e * n * sizes.memory]);
        mean = 0.0;
        for t in 0..sizes.steps {
            let first = t % game.steps() == 0;
            if first {
                before.clear();
                memory.fill(0.0);
            }
            rng::fill_normal(&mut rng, &mut eps);
            let cell = rollout.at(t, sizes.memory);
            rollout.memory[cell].copy_from_slice(&memory);
            let x = &rollout.observation[rollout.at(t, o)];
            let input = Observation {
                observation: shaped(x, o),
                comm: Tensor::ones([e as i64, n as i64, n as i64], (Kind::Float, Device::Cpu)),
                start: shaped(&rollout.start[rollout.at(t, 1)], 1).squeeze_dim(-1),
                memory: shaped(&memory, sizes.memory),
            };
            let graph = if learner.graphs() > 0 {
                shaped(&rollout.graph_noise[rollout.at(t, n * sizes.graphs)], n * sizes.graphs)
            } else {
                Tensor::zeros([0], (Kind::Float, Device::Cpu))
            };
            let (action, carried, graph, log_fresh) = (&shaped(&eps, 1), &nothing(), &graph, 0.0);
            let decision =
                learner.act(&input, &ActMode::Sample { action, carried, graph, log_fresh });
            let numbers =
                |tensor: &Tensor| Vec::<f32>::try_from(tensor.reshape([-1])).expect("numbers");
            let (actions, log_probs) = (numbers(&decision.action), numbers(&decision.log_prob));
            let seen: Vec<f32> = x.iter().step_by(o).copied().collect();
            let rewards = game.rewards(&seen, &before, &actions);
            (before, memory) = (seen, numbers(&decision.memory));
            // The first step of an `OtherBefore` episode has no reward and does not count.
            let asked = sizes.steps / game.steps();
            mean += rewards.iter().sum::<f32>() / (e * n * asked) as f32;
            let cell = rollout.at(t, 1);
            rollout.action[cell.clone()].copy_from_slice(&actions);
            rollout.log_prob[cell.clone()].copy_from_slice(&log_probs);
            rollout.reward[cell].copy_from_slice(&rewards);
        }
        let share = (update + 1) as f64 / updates as f64;
        let parameters = UpdateParameters {
            learning_rate: 3e-3 * (1.0 - 0.9 * (2.5 * share - 1.5).max(0.0)),
            log_std: -0.5 - share,
            gamma: 0.99,
            batch_growth: 1,
        };
        learner.update(&rollout, &parameters, Seed::new(3).index(update)).expect("finite");
    }
    mean
}

/// Every method learns who goes first. The pair earns at most 1, when one agent drives and the
/// other waits; equal actions earn at most 0.25, at a quarter of the speed, so that the order must
/// follow from the numbers.
#[test]
fn every_algorithm_learns_who_goes_first() {
    for name in algo::NAMES {
        let reward = play(name, Game::Crossing, 60);
        assert!(reward > 0.6, "{name}: {reward}");
    }
}

/// Agents decide the same with an empty slot among them as without it, whatever the slot contains.
#[test]
fn an_empty_slot_changes_nothing() {
    each(|name, encoder| {
        if !algo::capabilities(name).expect("known").any_number {
            return;
        }
        let mut settings = small(encoder);
        settings.transformer.blocks = 2;
        let (five, four) = (loud(name, &spec(5), &settings), loud(name, &spec(4), &settings));
        let rest = Tensor::from_slice(&[0_i64, 1, 3, 4]);
        let without = |t: &Tensor| t.index_select(1, &rest);
        let comm = Tensor::ones([2, 5, 5], (Kind::Float, Device::Cpu));
        let _ = (comm.select(1, 2).fill_(0.0), comm.select(2, 2).fill_(0.0));
        let input = observation(&*five, noise(1, &[2, 5, 4]), comm);
        let small = Observation {
            observation: without(&input.observation),
            comm: without(&input.comm).index_select(2, &rest),
            start: without(&input.start),
            memory: without(&input.memory),
        };
        let gap = without(&five.act(&input, &ActMode::Deterministic).action);
        let none = four.act(&small, &ActMode::Deterministic).action;
        assert!((gap - none).abs().max().double_value(&[]) < 1e-4, "{name} {encoder:?}");
    });
}

/// An agent that takes over a slot remembers nothing of the agent before it, and the others keep
/// their memories.
#[test]
fn a_new_agent_in_a_slot_has_no_memory() {
    each(|name, encoder| {
        let learner = loud(name, &spec(4), &small(encoder));
        let comm = Tensor::ones([2, 4, 4], (Kind::Float, Device::Cpu));
        let old = observation(&*learner, noise(1, &[2, 4, 4]), comm.copy());
        let new = observation(&*learner, noise(1, &[2, 4, 4]), comm);
        let _ = new.start.select(1, 2).fill_(1.0);
        let cleared = old.memory.copy();
        let _ = cleared.select(1, 2).fill_(0.0);
        let expected = Observation { memory: cleared, ..old };
        let found = learner.act(&new, &ActMode::Deterministic);
        let expected = learner.act(&expected, &ActMode::Deterministic);
        for (found, expected) in
            [(&found.action, &expected.action), (&found.memory, &expected.memory)]
        {
            assert_eq!(found.size(), expected.size(), "{name} {encoder:?}");
            assert!(
                found.numel() == 0 || (found - expected).abs().max().double_value(&[]) < 1e-6,
                "{name} {encoder:?}"
            );
        }
    });
}

/// Methods learn with two action dimensions, where one ratio per dimension is another loss than one
/// ratio per action.
#[test]
fn several_action_dimensions_are_learned_from() {
    for name in algo::NAMES {
        let spec = EnvSpec {
            actions: ["steer", "throttle"].map(ActionDimension::named).to_vec(),
            ..spec(3)
        };
        let mut learner =
            algo::build(name, &spec, &small(EncoderKind::Mlp), Seed::new(2), Device::Cpu)
                .expect("a learner");
        let input = observation(
            &*learner,
            noise(1, &[2, 3, 4]),
            Tensor::ones([2, 3, 3], (Kind::Float, Device::Cpu)),
        );
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
        let losses = learner.update(&rollout, &PACE, Seed::new(4)).expect("finite");
        assert!(losses.iter().all(|(_, value)| value.is_finite()), "{name}");
    }
}

#[test]
fn messages_help_where_they_are_needed() {
    let scope = |name: &str| algo::capabilities(name).expect("known").scope;
    // MAPPO stands for all methods without communication; another test checks for each method that
    // no observation reaches an agent that it must not reach.
    let without = play("mappo", Game::Other, 60);
    assert!(without < -0.3, "what the other sees cannot be guessed: {without}");
    for name in algo::NAMES.into_iter().filter(|name| {
        !matches!(scope(name), CommunicationScope::None | CommunicationScope::InRangeNextStep)
    }) {
        // The bound is wide, because rounding differs between processors and a run then takes
        // another course.
        let with = play(name, Game::Other, 120);
        assert!(with > -0.25, "{name}: but it can be told: {with}");
    }
}

#[test]
fn symbols_help_where_they_are_needed() {
    let without = play("mappo", Game::OtherBefore, 60);
    assert!(without < -0.3, "what the other saw cannot be guessed: {without}");
    let scope = |name: &str| algo::capabilities(name).expect("known").scope;
    for name in
        algo::NAMES.into_iter().filter(|name| scope(name) == CommunicationScope::InRangeNextStep)
    {
        let with = play(name, Game::OtherBefore, 120);
        assert!(with > -0.2, "{name}: but a symbol can tell: {with}");
    }
}

/// A reward of 1 in every step without end has the value 1 / (1 - γ), however fast the statistics
/// that normalise values follow the values.
#[test]
fn values_do_not_feed_on_their_own_normalisation() {
    const GAMMA: f64 = 0.95;
    for name in ["maddpg", "maddpg-iwol"] {
        let mut settings = small(EncoderKind::Mlp);
        settings.ppo.average = 0.0;
        (settings.maddpg.updates, settings.maddpg.n_step, settings.maddpg.target_rate) =
            (100, 1, 0.1);
        let mut learner =
            algo::build(name, &spec(2), &settings, Seed::new(1), Device::Cpu).expect("a learner");
        let mut rollout = random_rollout(&*learner, 2, 3);
        rollout.reward.fill(1.0);
        rollout.active.fill(1.0);
        rollout.comm.fill(1.0);
        rollout.terminated.fill(0.0);
        let parameters =
            UpdateParameters { learning_rate: 3e-3, log_std: -1.0, gamma: GAMMA, batch_growth: 1 };
        let input = observation(
            &*learner,
            noise(4, &[1, 2, 4]),
            Tensor::ones([1, 2, 2], (Kind::Float, Device::Cpu)),
        );
        let state = noise(5, &[1, 2, 3]);
        let mut values = Vec::new();
        for round in 0..20 {
            learner.update(&rollout, &parameters, Seed::new(round)).expect("finite");
            values.push(
                learner.inspect(&input, &state).value.expect("a value").double_value(&[0, 0]),
            );
        }
        let truth = 1.0 / (1.0 - GAMMA);
        assert!(values.iter().all(|value| *value < 1.1 * truth), "{name}: {values:?}");
        assert!((values[19] - truth).abs() < 0.1 * truth, "{name}: {values:?}");
    }
}
