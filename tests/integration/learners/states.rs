//! What a learner keeps and hands over: averaged weights, states of checkpoints, and what its decoders
//! tell.

use iwol_sumo::algo::settings::EncoderKind;
use iwol_sumo::algo::{self};
use iwol_sumo::rng::Seed;
use tch::Tensor;

use super::{
    PACE, bits, build, complete, each, loud, noise, observation, random_rollout, small, spec,
};

#[test]
fn averaged_weights_follow_and_can_be_exchanged() {
    each(|name, encoder| {
        let mut settings = small(encoder);
        settings.ppo.average = 0.75;
        let mut learner = build(name, &spec(4), &settings, 2);
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
        let mut next = build(name, &spec(agents), &settings, 8);
        next.load_weights(&end).expect("weights fit");
        if !any_number {
            let mut more = build(name, &spec(9), &settings, 8);
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
        let mut trained = build(name, &spec(4), &small(encoder), 2);
        trained.update(&random_rollout(&*trained, 4, 3), &PACE, Seed::new(4)).expect("finite");
        let mut fresh = build(name, &spec(4), &small(encoder), 9);
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

/// The value functions of IWoL read the privileged state if, and only if, the settings say so.
#[test]
fn value_functions_of_iwol_are_privileged_on_request() {
    for name in ["im-iwol", "ex-iwol", "maddpg-iwol"] {
        for privileged in [false, true] {
            let mut settings = small(EncoderKind::Mlp);
            settings.iwol.privileged_value = privileged;
            let mut learner = loud(name, &spec(4), &settings);
            let input = observation(&*learner, noise(1, &[2, 4, 4]), complete(2, 4));
            let value = |seed| learner.inspect(&input, &noise(seed, &[2, 4, 3])).value;
            let [one, other] = [2, 3].map(|seed| value(seed).expect("a value without memory"));
            assert_eq!(one.equal(&other), !privileged, "{name} {privileged}");
            let rollout = random_rollout(&*learner, 4, 3);
            learner.update(&rollout, &PACE, Seed::new(4)).expect("finite");
        }
    }
}

/// World decoders can reach features of any magnitude that the environment declares.
#[test]
fn targets_of_world_decoders_lie_within_their_reach() {
    let mut spec = spec(4);
    (spec.state.list[1].low, spec.state.list[1].high) = (-0.5, 4.0);
    for name in ["im-iwol", "ex-iwol", "maddpg-iwol", "magic", "commformer"] {
        let learner = build(name, &spec, &small(EncoderKind::Mlp), 1);
        let input = observation(&*learner, noise(1, &[2, 4, 4]), complete(2, 4));
        let state = noise(2, &[2, 4, 3]);
        let told = learner.reconstruct(&input, &state);
        let world = told.iter().find(|told| told.name == "world").expect("a world decoder");
        let expected = &state / Tensor::from_slice(&[1.0_f32, 4.0, 1.0]);
        assert!(world.target.equal(&expected), "{name}");
    }
    // A feature without limits is not divided away.
    for limit in [f32::MAX, f32::INFINITY] {
        (spec.state.list[1].low, spec.state.list[1].high) = (-limit, limit);
        let learner = build("im-iwol", &spec, &small(EncoderKind::Mlp), 1);
        let input = observation(&*learner, noise(1, &[2, 4, 4]), complete(2, 4));
        let state = noise(2, &[2, 4, 3]);
        let told = learner.reconstruct(&input, &state);
        assert!(told.iter().any(|told| told.name == "world" && told.target.equal(&state)));
    }
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
            let learner = build(name, &spec(4), &settings, 1);
            let input = observation(&*learner, noise(1, &[2, 4, 4]), complete(2, 4));
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
