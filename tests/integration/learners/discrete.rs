//! Discrete actions: every method that can have them takes open choices only, and its updates see
//! the policy that acted.

use iwol_sumo::algo::settings::EncoderKind;
use iwol_sumo::algo::{self, ActMode, Algorithm, Observation, UpdateParameters};
use iwol_sumo::env::{ActionSpace, EnvSpec};
use iwol_sumo::rng::{self, Seed};
use iwol_sumo::rollout::Rollout;
use tch::{Device, Kind, Tensor};

use super::updates::{decide, nothing_moved};
use super::{PACE, each, loud, noise, nothing, random_rollout, small, spec};

const AGENTS: usize = 4;
const CHOICES: usize = 3;

fn choosing() -> EnvSpec {
    EnvSpec { actions: ActionSpace::Discrete(vec!["left", "stay", "right"]), ..spec(AGENTS) }
}

/// Applies `check` to a learner of each method and encoder; the methods that cannot choose refuse.
fn with_choices(mut check: impl FnMut(&str, EncoderKind, &mut dyn Algorithm)) {
    each(|name, encoder| {
        let spec = choosing();
        if algo::capabilities(name).expect("known").discrete {
            return check(name, encoder, &mut *loud(name, &spec, &small(encoder)));
        }
        let settings = small(encoder);
        let refused = algo::build(name, &spec, &settings, Seed::new(1), Device::Cpu).err();
        let text = refused.expect("refused").to_string();
        assert!(
            text.contains("is for continuous actions only") && text.contains("mappo"),
            "{text}"
        );
    });
}

/// Returns a rollout in which some choices are not open, and at least one is.
fn rollout(learner: &dyn Algorithm) -> Rollout {
    let mut rollout = random_rollout(learner, AGENTS, 3);
    rollout.sizes.choices = CHOICES;
    let mut rng = Seed::new(8).rng();
    let mut open = |_| {
        let mut open = [1.0, 1.0, 1.0];
        let closed = rng::below(&mut rng, 7);
        if closed < CHOICES {
            open[closed] = 0.0;
        }
        open
    };
    rollout.available = (0..rollout.active.len()).flat_map(&mut open).collect();
    rollout
}

#[test]
fn updates_see_the_policy_that_chose() {
    with_choices(|name, encoder, learner| {
        let mut rollout = rollout(learner);
        decide(learner, &mut rollout);
        for (at, choice) in rollout.action.iter().enumerate() {
            let open = &rollout.available[at * CHOICES..][..CHOICES];
            let is_open = open.get(*choice as usize).is_some_and(|open| *open > 0.5);
            assert!(is_open && choice.fract() == 0.0, "{name} {encoder:?}: {choice} of {open:?}");
        }
        for choice in 0..CHOICES {
            assert!(rollout.action.contains(&(choice as f32)), "{name}: nobody chooses {choice}");
        }
        nothing_moved(name, encoder, learner, &rollout);
        let losses = learner.update(&rollout, &PACE, Seed::new(4)).expect("finite");
        assert!(losses.iter().any(|(key, value)| *key == "loss/entropy" && *value > 0.0), "{name}");
        assert!(losses.iter().all(|(key, _)| *key != "ppo/std"), "{name}");
    });
}

/// A larger weight of the entropy bonus leaves the policy less certain of its choices.
#[test]
fn the_entropy_bonus_has_the_weight_of_the_update() {
    for name in ["mappo", "im-iwol", "mat"] {
        let entropy = |entropy_coefficient: f64| {
            let mut learner = loud(name, &choosing(), &small(EncoderKind::Mlp));
            let mut rollout = rollout(&*learner);
            decide(&*learner, &mut rollout);
            rollout.reward.fill(0.0);
            let parameters = UpdateParameters { entropy_coefficient, ..PACE };
            let mut last = 0.0;
            for update in 0..10 {
                let losses = learner.update(&rollout, &parameters, Seed::new(update));
                let losses = losses.expect("finite");
                last = losses.iter().find(|(key, _)| *key == "loss/entropy").expect("reported").1;
            }
            last
        };
        let (none, large) = (entropy(0.0), entropy(1.0));
        assert!(large > none + 0.01, "{name}: {none} {large}");
    }
}

/// The most likely choice is taken in evaluations, with messages through any channel as well.
#[test]
fn evaluations_take_the_most_likely_open_choice() {
    with_choices(|name, encoder, learner| {
        let agents = AGENTS as i64;
        let zeros = |shape: &[i64]| Tensor::zeros(shape, (Kind::Float, Device::Cpu));
        let available = Tensor::from_slice(&[0.0_f32, 1.0, 1.0]).expand([2, agents, 3], false);
        let input = Observation {
            observation: noise(1, &[2, agents, 4]),
            comm: zeros(&[2, agents, agents]) + 1.0,
            start: zeros(&[2, agents]),
            memory: zeros(&[2, agents, learner.memory() as i64]),
            disturbance: nothing(),
            available,
        };
        let best = learner.act(&input, &ActMode::Deterministic);
        assert_eq!(best.action.size(), [2, agents, 1], "{name} {encoder:?}");
        assert!(best.action.min().double_value(&[]) >= 1.0, "{name} {encoder:?}");
        // No other open choice is more likely.
        assert!(best.log_prob.min().double_value(&[]) >= 0.5_f64.ln() - 1e-6, "{name}");
    });
}
