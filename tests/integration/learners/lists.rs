//! Graphs over lists of neighbours are graphs of all pairs in which the other pairs are cut.

use iwol_sumo::algo::{ActMode, Algorithm};
use iwol_sumo::env::EnvSpec;
use tch::{Kind, Tensor};

use super::*;

const AGENTS: usize = 20;
const WORLDS: i64 = 3;

/// Returns a mask in which the agents stand on a ring and hear the agents on both sides, except
/// those who are absent and a few others.
fn ring() -> Tensor {
    let agents = AGENTS as i64;
    let mask = Tensor::eye(agents, (Kind::Float, Device::Cpu)).repeat([WORLDS, 1, 1]);
    for world in 0..WORLDS {
        for i in 0..agents {
            for j in [(i + 1) % agents, (i + agents - 1) % agents] {
                let heard = f64::from(u8::from((world + 3 * i + j) % 7 > 0));
                let _ = mask.get(world).get(i).get(j).fill_(heard);
            }
        }
        let absent = 4 * world;
        let _ = mask.get(world).get(absent).fill_(0.0);
        let _ = mask.get(world).select(1, absent).fill_(0.0);
    }
    mask
}

/// Returns a learner whose graphs are lists, and one with the same weights whose graphs have all
/// pairs. All edges that are possible are open.
fn both(name: &str) -> [Box<dyn Algorithm>; 2] {
    let mut settings = small(EncoderKind::Mlp);
    settings.iwol.graph_bias = 1e3;
    (settings.ppo.epochs, settings.ppo.minibatch, settings.ppo.shards) = (1, 4096, 1);
    [Some(2), None].map(|most_heard| loud(name, &EnvSpec { most_heard, ..spec(AGENTS) }, &settings))
}

#[test]
fn decisions_and_graphs_are_those_of_all_pairs() {
    let [listed, full] = both("ex-iwol");
    assert_eq!((listed.graph_noise(AGENTS), full.graph_noise(AGENTS)), (2, AGENTS));
    let input = |x: Tensor| observation(&*full, x, ring());
    let x = noise(1, &[WORLDS, AGENTS as i64, 4]);
    let act = |learner: &dyn Algorithm, x: &Tensor| {
        learner.act(&input(x.copy()), &ActMode::Deterministic).action
    };
    let [of_lists, of_all] = [&listed, &full].map(|learner| act(&**learner, &x));
    let apart = (&of_lists - &of_all).abs().max().double_value(&[]);
    assert!(apart < 1e-5, "{apart}");
    let state = noise(2, &[WORLDS, AGENTS as i64, 3]);
    let graph =
        |learner: &dyn Algorithm| learner.inspect(&input(x.copy()), &state).graph.expect("a graph");
    assert!(graph(&*listed).equal(&graph(&*full)), "the graphs are the same");

    // What an agent does changes nothing, to the bit, for those who do not hear it in two rounds.
    let other = x.copy();
    let _ = other.select(1, 10).fill_(50.0);
    let changed = act(&*listed, &other).ne_tensor(&of_lists).squeeze_dim(-1);
    let far = Tensor::from_slice(&[0_i64, 1, 2, 3, 4, 5, 6, 7, 13, 14, 15, 16, 17, 18, 19]);
    assert!(!bool::try_from(changed.index_select(1, &far).any()).expect("a flag"));
    assert!(bool::try_from(changed.select(1, 9).any()).expect("a flag"), "neighbours hear it");
}

/// An update finds the policy that acted where graphs are sampled over lists of neighbours, some
/// agents are absent, and some are there without acting, as in the row after the horizon.
#[test]
fn an_update_sees_the_policy_that_acted_over_lists() {
    let settings = small(EncoderKind::Mlp);
    let spec = EnvSpec { most_heard: Some(2), ..spec(AGENTS) };
    let mut learner = loud("ex-iwol", &spec, &settings);
    let mut rollout = rollout_with(&*learner, AGENTS, 3, true);
    let s = rollout.sizes;
    let mut idle = 0;
    for t in 1..s.steps {
        for e in 0..s.envs {
            let (row, before) = (rollout.cell(t, e, 1), rollout.cell(t - 1, e, 1));
            let mut there: Vec<bool> =
                rollout.active[row.clone()].iter().map(|active| *active > 0.0).collect();
            for (there, at) in there.iter_mut().zip(before) {
                if !*there && rollout.active[at] > 0.0 {
                    (rollout.terminated[at], rollout.truncated[at]) = (0.0, 1.0);
                    *there = true;
                    idle += 1;
                }
            }
            let pairs = rollout.cell(t, e, AGENTS);
            for (k, link) in rollout.comm[pairs].iter_mut().enumerate() {
                let (i, j) = (k / AGENTS, k % AGENTS);
                let heard = there[i] && there[j] && i.abs_diff(j) <= 1;
                *link = f32::from(u8::from(heard));
            }
        }
    }
    assert!(idle > 20, "{idle}");
    for (k, link) in rollout.comm.iter_mut().enumerate() {
        *link *= f32::from(u8::from((k / AGENTS % AGENTS).abs_diff(k % AGENTS) <= 1));
    }
    updates::decide(&*learner, &mut rollout);
    updates::nothing_moved("ex-iwol", EncoderKind::Mlp, &mut *learner, &rollout);
}

#[test]
fn losses_and_gradients_are_those_of_all_pairs() {
    for name in ["ex-iwol", "im-iwol"] {
        let learners = both(name);
        let random = random_rollout(&*learners[0], AGENTS, 3);
        let losses = learners.map(|mut learner| {
            let mut rollout = random.clone();
            for (k, link) in rollout.comm.iter_mut().enumerate() {
                let apart = (k / AGENTS % AGENTS).abs_diff(k % AGENTS);
                *link *= f32::from(u8::from(apart <= 1));
            }
            // The two have noise of different sizes; these edges are open in spite of any.
            rollout.sizes.graph_noise = learner.graph_noise(AGENTS);
            let count = rollout.active.len() * rollout.sizes.graph_noise;
            rollout.graph_noise = vec![0.0; count];
            learner.update(&rollout, &STILL, Seed::new(4)).expect("finite")
        });
        for ((what, of_lists), (_, of_all)) in losses[0].iter().zip(&losses[1]) {
            let scale = of_all.abs().max(1e-3);
            assert!((of_lists - of_all).abs() < 1e-4 * scale, "{name}: {what}: {losses:?}");
        }
        assert!(reported(&losses[0], "graph/open_edges") > 0.5, "{name}: some are heard");
    }
}
