//! Who can influence whose action: by observations, symbols and messages, through channels, and past
//! empty slots.

use iwol_sumo::algo::{self, ActMode, Channel, ChannelNoise, CommunicationScope, Observation};
use tch::{Device, Kind, Tensor};

use super::{act, build, complete, each, loud, noise, nothing, observation, pairs, small, spec};

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
        let learner = build(name, &spec(5), &small(encoder), 1);
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

/// Agents that have just come have shown nothing, and do not dilute what others have shown.
#[test]
fn newcomers_show_no_symbol() {
    each(|name, encoder| {
        if algo::capabilities(name).expect("known").scope != CommunicationScope::InRangeNextStep {
            return;
        }
        let learner = loud(name, &spec(3), &small(encoder));
        let decide = |start: f64, comm: Tensor| -> Vec<f32> {
            let input = observation(&*learner, noise(1, &[1, 3, 4]), comm);
            let _ = input.start.get(0).get(2).fill_(start);
            let action = learner.act(&input, &ActMode::Deterministic).action;
            Vec::try_from(action.view([3])).expect("actions")
        };
        let apart = complete(1, 3);
        let _ = apart.get(0).narrow(0, 0, 2).select(1, 2).fill_(0.0);
        let (new, out_of_range) = (decide(1.0, complete(1, 3)), decide(1.0, apart));
        assert_eq!(new[..2], out_of_range[..2], "{name} {encoder:?}");
        assert_ne!(
            new[..2],
            decide(0.0, complete(1, 3))[..2],
            "{name} {encoder:?}: it counts later"
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
            let (x, comm) = (noise(1, &[2, 5, 4]), complete(2, 5));
            let width = learner.message_width() as i64;
            assert_eq!(algo::capabilities(name).expect("known").messages, width > 0, "{name}");
            let through = |channel: &Channel, comm: &Tensor| {
                let mut input = observation(&*learner, x.copy(), comm.copy());
                let past = Tensor::zeros(
                    [2, 5, channel.memory(width as usize) as i64],
                    (Kind::Float, Device::Cpu),
                );
                input.memory = Tensor::cat(&[&input.memory, &past], -1);
                let content = noise(9, &[2, 5, 5, width.max(1)]);
                let falsified = Tensor::full([2, 5, 5], 0.5, (Kind::Float, Device::Cpu));
                let noise =
                    ChannelNoise { lost: noise(8, &[2, 5, 5]).sigmoid(), falsified, content };
                learner.act_through(&input, channel, &noise).action
            };
            let plain = |comm: &Tensor| {
                let input = observation(&*learner, x.copy(), comm.copy());
                learner.act(&input, &ActMode::Deterministic).action
            };
            let apart = |a: &Tensor, b: &Tensor| (a - b).abs().max().double_value(&[]);
            let together = plain(&comm);
            assert!(
                apart(&through(&Channel::default(), &comm), &together) < 1e-4,
                "{name} {encoder:?}"
            );
            let alone = Tensor::eye(5, (Kind::Float, Device::Cpu)).expand([2, 5, 5], false);
            let silence = through(&Channel { loss: 1.0, ..Channel::default() }, &comm);
            let expected = if width > 0 { plain(&alone) } else { together.shallow_clone() };
            assert!(apart(&silence, &expected) < 1e-4, "{name} {encoder:?}");
            // Agents out of range stay out of range.
            let (pairs, bits) =
                (pairs().repeat([2, 1, 1]), Channel { bits: 31, ..Channel::default() });
            let those_there = |actions: &Tensor| actions.narrow(1, 0, 4);
            assert!(
                apart(&those_there(&through(&bits, &pairs)), &those_there(&plain(&pairs))) < 1e-4,
                "{name} {encoder:?}"
            );
            // 31 bits are as good as 32, but make each receiver compute its own messages.
            let [some, each] = [32, 31]
                .map(|bits| through(&Channel { loss: 0.6, bits, ..Channel::default() }, &comm));
            assert!(apart(&some, &each) < 1e-4, "{name} {encoder:?}");
            assert_eq!(apart(&some, &together) > 1e-4, width > 0, "{name} {encoder:?}");
            let bad = [
                Channel { bits: 2, ..Channel::default() },
                Channel { falsified: 1.0, ..Channel::default() },
                Channel { delay: 3, ..Channel::default() },
            ];
            for channel in bad {
                assert_eq!(
                    apart(&through(&channel, &comm), &together) > 1e-4,
                    width > 0,
                    "{name} {encoder:?} {channel:?}"
                );
            }
        }
    });
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
        let comm = complete(2, 5);
        let _ = (comm.select(1, 2).fill_(0.0), comm.select(2, 2).fill_(0.0));
        let input = observation(&*five, noise(1, &[2, 5, 4]), comm);
        let small = Observation {
            observation: without(&input.observation),
            comm: without(&input.comm).index_select(2, &rest),
            start: without(&input.start),
            memory: without(&input.memory),
            disturbance: nothing(),
            available: nothing(),
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
        let old = observation(&*learner, noise(1, &[2, 4, 4]), complete(2, 4));
        let new = observation(&*learner, noise(1, &[2, 4, 4]), complete(2, 4));
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
