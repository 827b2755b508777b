//! Training hears what an evaluation hears: losses, few bits, delays and false messages.

use iwol_sumo::algo::settings::EncoderKind;
use iwol_sumo::algo::{self, ActMode, Algorithm, Channel, ChannelNoise, Observation, Settings};
use iwol_sumo::rng::{self, Seed};
use tch::{Device, Kind, Tensor};

use super::updates::{decide, nothing_moved};
use super::{complete, each, loud, noise, nothing, random_rollout, small, spec};

const AGENTS: i64 = 4;

fn channels() -> [Channel; 5] {
    let whole = Channel::default();
    [
        Channel { bits: 3, ..whole },
        Channel { delay: 2, ..whole },
        Channel { bits: 4, delay: 1, ..whole },
        Channel { loss: 0.5, ..whole },
        Channel { loss: 0.5, delay: 1, ..whole },
    ]
}

/// Applies `check` to each method with messages, with one round and with two, and to each channel.
fn with_messages(encoders: &[EncoderKind], check: impl Fn(&str, &Settings)) {
    let talking = |name: &&&str| algo::capabilities(name).expect("known").messages;
    for name in algo::NAMES.iter().filter(talking) {
        for (encoder, rounds) in encoders.iter().flat_map(|kind| [(*kind, 1), (*kind, 2)]) {
            let mut settings = small(encoder);
            settings.iwol.rounds = rounds;
            check(name, &settings);
        }
    }
}

/// Actions without exploration noise are the same in training and in evaluation, where the same
/// messages are lost, also across the beginning of episodes and of single trajectories.
#[test]
fn training_hears_what_an_evaluation_hears() {
    with_messages(&[EncoderKind::Mlp, EncoderKind::Attention], |name, settings| {
        for channel in channels() {
            let settings = Settings { channel, ..settings.clone() };
            let learner = loud(name, &spec(AGENTS as usize), &settings);
            let zeros = |shape: &[i64]| Tensor::zeros(shape, (Kind::Float, Device::Cpu));
            let mut memory = zeros(&[2, AGENTS, learner.training_memory() as i64]);
            let past = channel.memory(learner.message_width()) as i64;
            let mut heard = zeros(&[2, AGENTS, past]);
            // The same weights in a training whose lost messages are only cut from the mask.
            let whole = Settings { channel: Channel::default(), ..settings.clone() };
            let masked = loud(name, &spec(AGENTS as usize), &whole);
            let (mut silence, mut passed_on) = (0.0, 0.0);
            for t in 0..8 {
                let start = zeros(&[2, AGENTS]);
                match t {
                    0 | 5 => drop(start.shallow_clone().fill_(1.0)),
                    // A new agent comes into the third slot.
                    3 => drop(start.select(1, 2).fill_(1.0)),
                    _ => {}
                }
                let lost = noise(90 + t, &[2, AGENTS, AGENTS]).sigmoid();
                let input = |memory: &Tensor| Observation {
                    observation: noise(70 + t, &[2, AGENTS, 4]),
                    comm: complete(2, AGENTS),
                    start: start.shallow_clone(),
                    memory: memory.shallow_clone(),
                    disturbance: nothing(),
                    available: nothing(),
                };
                let arrived = {
                    let own = Tensor::eye(AGENTS, (Kind::Bool, Device::Cpu));
                    lost.ge(channel.loss).logical_or(&own).to_kind(Kind::Float)
                };
                let explored = if learner.has_radio() {
                    Observation { disturbance: &arrived - 1.0, ..input(&memory) }
                } else {
                    Observation { comm: arrived.shallow_clone(), ..input(&memory) }
                };
                let cut = Observation { comm: arrived, ..input(&zeros(&[2, AGENTS, 0])) };
                let mode = |edges: f64| {
                    let (action, carried) = (zeros(&[2, AGENTS, 1]), nothing());
                    let graph = zeros(&[2, AGENTS, learner.graph_noise(AGENTS as usize) as i64]);
                    let graph = graph + edges;
                    ActMode::Sample { action, carried, graph, log_fresh: Vec::new() }
                };
                let trained = learner.act(&explored, &mode(0.0));
                let noise = ChannelNoise {
                    lost,
                    falsified: zeros(&[2, AGENTS, AGENTS]),
                    content: zeros(&[2, AGENTS, AGENTS, 1]),
                };
                let used = learner.act_through(&input(&heard), &channel, &noise);
                let plain = learner.act(&input(&zeros(&[2, AGENTS, 0])), &ActMode::Deterministic);
                let apart = |a: &Tensor, b: &Tensor| (a - b).abs().max().double_value(&[]);
                assert!(
                    apart(&trained.action, &used.action) < 1e-4,
                    "{name} {channel:?}, decision {t}"
                );
                silence += apart(&trained.action, &plain.action);
                // With all edges open, agents pass on what they hear.
                let [open, cut] = [(&learner, &explored), (&masked, &cut)]
                    .map(|(learner, input)| learner.act(input, &mode(1e4)).action);
                passed_on += apart(&open, &cut);
                (memory, heard) = (trained.memory, used.memory);
            }
            assert!(silence > 1e-3, "{name} {channel:?}: the channel changes something");
            if channel == (Channel { loss: 0.5, ..Channel::default() }) {
                // Over several rounds, a message that is only cut comes by a third agent.
                let rounds = if name == "magic" { 2 } else { settings.iwol.rounds };
                assert_eq!(learner.has_radio(), rounds > 1, "{name}");
                assert_eq!(passed_on > 1e-3, rounds > 1, "{name} {rounds}: {passed_on}");
            }
        }
    });
}

/// Returns a rollout of a learner in which messages are lost and falsified.
fn rollout(learner: &dyn Algorithm, channel: &Channel) -> iwol_sumo::rollout::Rollout {
    let mut rollout = random_rollout(learner, AGENTS as usize, 3);
    if learner.has_radio() {
        let mut rng = Seed::new(9).rng();
        let mut number = || match rng::below(&mut rng, 4) {
            0 if channel.loss > 0.0 => -1.0,
            1 | 2 if channel.falsified > 0.0 => 1.0 + rng::below(&mut rng, 4096) as f32,
            _ => 0.0,
        };
        rollout.disturbance = rollout.comm.iter().map(|_| number()).collect();
    }
    rollout
}

/// An update finds the policy that acted, whatever the channel did to its messages.
#[test]
fn updates_hear_what_acting_heard() {
    let falsified = Channel { falsified: 0.5, loss: 0.5, ..Channel::default() };
    with_messages(&[EncoderKind::Mlp, EncoderKind::Gru], |name, settings| {
        for channel in channels().into_iter().chain([falsified]) {
            let encoder = settings.network.encoder;
            let settings = Settings { channel, ..settings.clone() };
            if channel.delay > 0 && encoder == EncoderKind::Gru {
                let refused =
                    algo::build(name, &spec(4), &settings, Seed::new(1), Device::Cpu).err();
                let refused = refused.expect("no memory of the past").to_string();
                assert!(refused.contains("set network.encoder to"), "{refused}");
                continue;
            }
            let mut learner = loud(name, &spec(AGENTS as usize), &settings);
            let mut rollout = rollout(&*learner, &channel);
            decide(&*learner, &mut rollout);
            nothing_moved(name, encoder, &mut *learner, &rollout);
            if channel.falsified > 0.0 {
                let other = iwol_sumo::rollout::Rollout { disturbance: Vec::new(), ..rollout };
                let losses = learner.update(&other, &super::STILL, Seed::new(4)).expect("finite");
                let kl = losses.iter().find(|(name, _)| *name == "ppo/approx_kl").expect("kl").1;
                assert!(kl > 1e-4, "{name}: false messages matter ({kl})");
            }
        }
    });
}

/// Methods without messages act and learn the same with any channel in training.
#[test]
fn channels_do_not_touch_methods_without_messages() {
    each(|name, encoder| {
        if algo::capabilities(name).expect("known").messages || encoder == EncoderKind::Gru {
            return;
        }
        let channel = Channel { bits: 3, delay: 2, ..Channel::default() };
        let act = |settings: &Settings| {
            let learner = loud(name, &spec(4), settings);
            assert_eq!(learner.training_memory(), learner.memory(), "{name}");
            super::act(&*learner, &noise(1, &[1, 4, 4]), &complete(1, 4))
        };
        let settings = small(encoder);
        assert_eq!(act(&settings), act(&Settings { channel, ..settings.clone() }), "{name}");
    });
}
