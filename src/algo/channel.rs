//! The channel between agents, which can lose, round, delay, falsify and shuffle messages. This
//! file has the channel of an evaluation; training needs gradients, for which see
//! [`radio`](super::radio).
//!
//! Agents send their embedding f. Each agent computes the rest (its graph and its messages) from
//! the embeddings that arrived at it, with its own embedding intact. With several rounds it does so
//! for all rounds, because agents send only once per decision.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use smart_default::SmartDefault;
use tch::{Device, Kind, Tensor};

use super::decision::Observation;
use super::encoder::{Encoder, EncoderKind, encode_rows};

/// Disturbances of messages between agents, in training and in evaluation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema, SmartDefault)]
#[serde(deny_unknown_fields)]
#[schemars(default)]
pub struct Channel {
    /// Bits per element. Elements are rounded to 2^bits − 1 evenly spaced levels between ±
    /// the largest magnitude in the message, which is sent along; at 32 they are sent unchanged.
    #[default = 32]
    #[schemars(range(min = 2, max = 32))]
    pub bits: u32,
    /// Probability that a message is lost, independent for each receiver and step. A receiver does
    /// not learn over a third agent what was in a message that it lost.
    #[schemars(range(min = 0, max = 1))]
    pub loss: f64,
    /// Delay of messages in steps. No message arrives in an agent's first `delay` steps. Training
    /// with a delay needs an encoder without memory (`network.encoder`).
    #[schemars(range(max = 100))]
    pub delay: u32,
    /// Probability that a message is replaced by normal noise of the same mean and standard
    /// deviation, independent for each receiver and step.
    #[schemars(range(min = 0, max = 1))]
    pub falsified: f64,
    /// Whether agents hear, in the place of each message, one from an agent of another episode: the
    /// messages are as many and look alike, but say nothing about this episode. They come from the
    /// episodes that are played at the same time, on which results then depend; a message is lost
    /// while no other episode has an agent on the road. For evaluation only.
    pub shuffled: bool,
}

impl Channel {
    /// Whether messages arrive as they were sent.
    pub fn is_perfect(&self) -> bool {
        *self == Self::default()
    }

    /// Whether messages that arrive are unchanged and in time, so that the channel at most loses
    /// messages.
    pub(super) fn only_loses(&self) -> bool {
        *self == Self { loss: self.loss, ..Self::default() }
    }

    /// Returns why a policy with this encoder cannot be trained with this channel, if it cannot.
    pub fn cannot_train(&self, encoder: EncoderKind) -> Option<&'static str> {
        if self.shuffled {
            return Some(
                "channel.shuffled is a test of what messages say, for evaluation only: omit it",
            );
        }
        let remembers = self.delay > 0 && encoder == EncoderKind::Gru;
        remembers.then_some(
            "channel.delay in training needs an encoder without memory: set network.encoder to \"mlp\" or \"attention\", or set \
             channel.delay in the evaluation only",
        )
    }

    /// Returns the bits of a message of `width` numbers; 0 for methods without messages.
    pub fn message_bits(&self, width: usize) -> f64 {
        let scale = if self.bits < 32 && width > 0 { 32.0 } else { 0.0 };
        f64::from(self.bits) * width as f64 + scale
    }

    /// Returns how many numbers an agent remembers for messages of this width.
    pub fn memory(&self, width: usize) -> usize {
        if self.delay == 0 { 0 } else { 1 + self.delay as usize * width }
    }
}

/// Randomness of a channel at one decision of E environments with N agents whose messages have
/// width H.
#[derive(Debug)]
pub struct ChannelNoise {
    /// Uniform in 0..1, `[E, N, N]`; a message is lost where the number is below [`Channel::loss`].
    pub lost: Tensor,
    /// Uniform in 0..1, `[E, N, N]`; a message is replaced where the number is below
    /// [`Channel::falsified`].
    pub falsified: Tensor,
    /// Standard normal, `[E, N, N, H]`; needed only where messages are falsified.
    pub content: Tensor,
}

impl ChannelNoise {
    pub(super) fn to(&self, device: Device) -> Self {
        Self {
            lost: self.lost.to_device(device),
            falsified: self.falsified.to_device(device),
            content: self.content.to_device(device),
        }
    }
}

/// The embeddings that receivers know after the exchange.
pub(super) struct Heard {
    /// Embeddings, `[E, N, N, H]`; row `i` holds what agent `i` knows of every agent, itself
    /// included.
    pub(super) embedding: Tensor,
    /// 1 where the embedding arrived, else 0, `[E, N, N]`.
    pub(super) arrived: Tensor,
}

impl Heard {
    /// Returns what arrives of the embeddings `sent [E, N, H]` by agents whose own are
    /// `f [E, N, H]`. Nothing arrives of a sender that is `silent [E, N]`, nor where `arrived
    /// [E, N, N]` is 0. `replaced` says which messages are false, `[E, N, N]`, and has standard
    /// normal contents for them, `[E, N, N, H]`, which take the mean and the spread of the true
    /// message. Agents always know their own embedding.
    pub(super) fn of(
        f: &Tensor,
        sent: &Tensor,
        silent: &Tensor,
        arrived: &Tensor,
        replaced: Option<&(Tensor, Tensor)>,
    ) -> Self {
        let (envs, agents, width) = f.size3().expect("embeddings are [E, N, H]");
        let everyone = |x: &Tensor| x.unsqueeze(1).expand([envs, agents, agents, width], false);
        let mut arriving = everyone(sent);
        if let Some((replaced, content)) = replaced {
            let sent = sent.detach();
            let mean = sent.mean_dim(-1, true, Kind::Float);
            let spread = (&sent - &mean).square().mean_dim(-1, true, Kind::Float).sqrt();
            let of_senders = content * spread.unsqueeze(1) + mean.unsqueeze(1);
            arriving = of_senders.where_self(&replaced.unsqueeze(-1), &arriving);
        }
        let own = Tensor::eye(agents, (Kind::Bool, f.device()));
        let embedding = everyone(f).where_self(&own.unsqueeze(-1), &arriving);
        let missing = silent.unsqueeze(1).logical_and(&own.logical_not());
        Self { embedding, arrived: arrived.masked_fill(&missing, 0.0) }
    }
}

/// Makes one decision in which embeddings pass through a channel. `read` computes each receiver's
/// message on its own, `[E · N, D]`, from the embeddings known there, `[E · N, N, H]`, and 1 where
/// an embedding arrived, `[E · N, 1, N]`. Returns the messages `[E, N, D]`, the embeddings
/// `[E, N, H]`, and the memory of encoder and channel.
pub(super) fn exchange(
    encoder: &Encoder,
    input: &Observation,
    channel: &Channel,
    noise: &ChannelNoise,
    read: impl Fn(&Tensor, &Tensor) -> Tensor,
) -> (Tensor, Tensor, Tensor) {
    let (envs, agents, _) = input.observation.size3().expect("observations are [E, N, O]");
    let (own, total) = (encoder.memory(), input.memory.size()[2]);
    let memory = input.memory.narrow(2, 0, own);
    let (f, after) = encode_rows(encoder, &input.observation, &memory, &input.keep(), 1);
    let past = input.memory.narrow(2, own, total - own);
    let present = input.comm.diagonal(0, 1, 2);
    let (Heard { embedding, arrived }, past) =
        channel.send(&f, &input.keep(), &present, &past, noise);
    // An agent that the receiver did not hear cannot reach it over a third agent either.
    let made = read(&embedding.flatten(0, 1), &arrived.reshape([envs * agents, 1, agents]));
    let made = made.view([envs, agents, -1]);
    let memory = after.map_or(memory, |after| after.view([envs, agents, own]));
    (made, f, Tensor::cat(&[&memory, &past], -1))
}

/// Repeats what is known of all pairs, `[E, N, K]`, for each receiver, `[E · N, N, K]`.
pub(super) fn of_everyone(pairs: &Tensor) -> Tensor {
    let (envs, agents, width) = pairs.size3().expect("pairs are [E, N, K]");
    let each = pairs.unsqueeze(1).expand([-1, agents, -1, -1], false);
    each.reshape([envs * agents, agents, width])
}

/// Returns the receivers' own entries, `[E · N, D]`, from rows of agents with one row per receiver,
/// `[E · N, N, D]`.
pub(super) fn of_receivers(rows: &Tensor) -> Tensor {
    let (count, agents, width) = rows.size3().expect("rows are [E · N, N, D]");
    let own = rows.view([count / agents, agents, agents, width]).diagonal(0, 1, 2);
    own.transpose(1, 2).reshape([count, width])
}

impl Channel {
    /// Sends the embeddings `f [E, N, H]`. Returns what arrives, and the past of the next decision.
    /// `past [E, N, 1 + delay · H]` holds the steps since the episode began and the embeddings sent
    /// since; it is cleared where `keep [E, N]` is 0. `present [E, N]` is 1 where an agent is
    /// present.
    fn send(
        &self,
        f: &Tensor,
        keep: &Tensor,
        present: &Tensor,
        past: &Tensor,
        noise: &ChannelNoise,
    ) -> (Heard, Tensor) {
        let (mut sent, mut silent, past) = self.delayed(&self.rounded(f), keep, past);
        if self.shuffled {
            (sent, silent) = of_other_worlds(&sent, &silent, present);
        }
        let replaced = (self.falsified > 0.0)
            .then(|| (noise.falsified.lt(self.falsified), noise.content.shallow_clone()));
        (Heard::of(f, &sent, &silent, &self.arrived(noise), replaced.as_ref()), past)
    }

    /// Returns 1 where a message is not lost, else 0, `[E, N, N]`; an agent's own embedding is
    /// never lost.
    pub fn arrived(&self, noise: &ChannelNoise) -> Tensor {
        let own = Tensor::eye(noise.lost.size()[1], (Kind::Bool, noise.lost.device()));
        noise.lost.ge(self.loss).logical_or(&own).to_kind(Kind::Float)
    }

    /// Returns what is left of embeddings `[E, N, H]` in messages of as many bits.
    pub(super) fn rounded(&self, f: &Tensor) -> Tensor {
        if self.bits >= 32 {
            return f.shallow_clone();
        }
        let steps = f64::from(2_u32.pow(self.bits - 1) - 1).max(1.0);
        let scale = f.abs().amax([-1], true).clamp_min(1e-12);
        (f / &scale * steps).round() / steps * scale
    }

    /// Returns the embeddings sent `delay` decisions ago, whether nothing arrives of a sender yet
    /// (`[E, N]`), and the past of the next decision.
    fn delayed(&self, sent: &Tensor, keep: &Tensor, past: &Tensor) -> (Tensor, Tensor, Tensor) {
        let (envs, agents, width) = sent.size3().expect("messages are [E, N, H]");
        let delay = i64::from(self.delay);
        if delay == 0 {
            let none = Tensor::zeros([envs, agents], (Kind::Bool, sent.device()));
            return (sent.shallow_clone(), none, past.shallow_clone());
        }
        let past = past * keep.unsqueeze(-1);
        let age = past.narrow(2, 0, 1);
        let silent = age.squeeze_dim(-1).lt(delay as f64);
        // The oldest embedding comes first.
        let queue = Tensor::cat(&[&past.narrow(2, 1, delay * width), sent], -1);
        let next = Tensor::cat(&[&(age + 1.0), &queue.narrow(2, width, delay * width)], -1);
        (queue.narrow(2, 0, width).view([envs, agents, width]), silent, next)
    }
}

/// Returns in the place of what each agent sends, `[E, N, H]`, what an agent of another world sends,
/// and whether nothing arrives of it, `[E, N]`.
fn of_other_worlds(sent: &Tensor, silent: &Tensor, present: &Tensor) -> (Tensor, Tensor) {
    let (_, agents, width) = sent.size3().expect("messages are [E, N, H]");
    let present = Vec::<f32>::try_from(present.reshape([-1])).expect("presence is of floats");
    let present: Vec<bool> = present.iter().map(|present| *present > 0.0).collect();
    let others = others(&present, agents as usize);
    let index: Vec<i64> =
        others.iter().enumerate().map(|(own, other)| other.unwrap_or(own) as i64).collect();
    let index = Tensor::from_slice(&index).to_device(sent.device());
    let nobody: Vec<bool> = others.iter().map(Option::is_none).collect();
    let nobody = Tensor::from_slice(&nobody).to_device(sent.device());
    (
        sent.reshape([-1, width]).index_select(0, &index).view_as(sent),
        silent.reshape([-1]).index_select(0, &index).logical_or(&nobody).view_as(silent),
    )
}

/// Returns for each of the `agents` slots of each world the place of an agent in another world that is
/// present: in the same slot of the nearest world before it if there is one, or else in another slot.
fn others(present: &[bool], agents: usize) -> Vec<Option<usize>> {
    let worlds = present.len() / agents;
    let of = |own: usize| {
        let (world, slot) = (own / agents, own % agents);
        let before = (1..worlds).map(|back| (world + worlds - back) % worlds * agents);
        let here = |place: &usize| present[*place];
        let same = before.clone().map(|first| first + slot).find(here);
        same.or_else(|| before.flat_map(|first| first..first + agents).find(here))
    };
    (0..present.len()).map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const CPU: (Kind, Device) = (Kind::Float, Device::Cpu);
    const N: i64 = 3;
    const H: i64 = 2;

    fn send(
        channel: &Channel,
        f: &Tensor,
        keep: f64,
        past: &Tensor,
        noise: &ChannelNoise,
    ) -> (Heard, Tensor) {
        channel.send(f, &Tensor::full([1, N], keep, CPU), &Tensor::ones([1, N], CPU), past, noise)
    }

    fn noise(lost: f64, falsified: f64) -> ChannelNoise {
        ChannelNoise {
            lost: Tensor::full([1, N, N], lost, CPU),
            falsified: Tensor::full([1, N, N], falsified, CPU),
            content: Tensor::full([1, N, N, H], 9.0, CPU),
        }
    }

    fn numbers(x: &Tensor) -> Vec<f64> {
        Vec::try_from(x.reshape([-1]).to_kind(Kind::Double)).expect("numbers")
    }

    fn embeddings(first: f64) -> Tensor {
        (Tensor::arange(N * H, CPU) + first).view([1, N, H])
    }

    #[test]
    fn a_perfect_channel_changes_nothing() {
        let f = embeddings(1.0);
        let (heard, _) =
            send(&Channel::default(), &f, 0.0, &Tensor::zeros([1, N, 0], CPU), &noise(0.5, 0.5));
        for i in 0..N {
            assert_eq!(numbers(&heard.embedding.get(0).get(i)), numbers(&f));
        }
        assert_eq!(numbers(&heard.arrived), vec![1.0; 9]);
    }

    #[test]
    fn lost_messages_are_cut_but_never_ones_own() {
        let channel = Channel { loss: 0.3, ..Channel::default() };
        let nothing = Tensor::zeros([1, N, 0], CPU);
        let (heard, _) = send(&channel, &embeddings(0.0), 0.0, &nothing, &noise(0.29, 1.0));
        assert_eq!(numbers(&heard.arrived), [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
        let (heard, _) = send(&channel, &embeddings(0.0), 0.0, &nothing, &noise(0.31, 1.0));
        assert_eq!(numbers(&heard.arrived), vec![1.0; 9]);
    }

    #[test]
    fn false_messages_replace_all_but_ones_own() {
        let channel = Channel { falsified: 0.5, ..Channel::default() };
        let f = embeddings(0.0);
        let (heard, _) = send(&channel, &f, 0.0, &Tensor::zeros([1, N, 0], CPU), &noise(1.0, 0.4));
        for (i, j) in (0..N).flat_map(|i| (0..N).map(move |j| (i, j))) {
            let same = numbers(&heard.embedding.get(0).get(i).get(j)) == numbers(&f.get(0).get(j));
            assert_eq!(same, i == j, "{i} hears {j}");
        }
    }

    #[test]
    fn shuffled_messages_are_those_of_another_world() {
        let channel = Channel { shuffled: true, ..Channel::default() };
        let f = Tensor::cat(&[embeddings(0.0), embeddings(100.0)], 0);
        let none = Tensor::zeros([2, N, 0], CPU);
        let twice = |x: Tensor| Tensor::cat(&[&x, &x], 0);
        let ChannelNoise { lost, falsified, content } = noise(0.5, 0.5);
        let both = ChannelNoise {
            lost: twice(lost),
            falsified: twice(falsified),
            content: twice(content),
        };
        let present = Tensor::ones([2, N], CPU);
        let (heard, _) = channel.send(&f, &Tensor::zeros([2, N], CPU), &present, &none, &both);
        for (world, i, j) in
            (0..2).flat_map(|w| (0..N).flat_map(move |i| (0..N).map(move |j| (w, i, j))))
        {
            let from = if i == j { world } else { 1 - world };
            let found = numbers(&heard.embedding.get(world).get(i).get(j));
            assert_eq!(found, numbers(&f.get(from).get(j)), "{i} hears {j} in world {world}");
        }
    }

    #[test]
    fn shuffled_messages_come_from_agents_that_are_there() {
        // Three worlds of three slots: the second world has only its last agent, the third none.
        let present = [true, true, false, false, false, true, false, false, false];
        let others = others(&present, 3);
        let of_first = [Some(5), Some(5), Some(5)];
        assert_eq!(others[..3], of_first);
        assert_eq!(others[3..6], [Some(0), Some(1), Some(0)]);
        assert_eq!(others[6..], [Some(0), Some(1), Some(5)]);

        let (f, silent) = (
            Tensor::arange(9, CPU).view([3, 3, 1]),
            Tensor::from_slice(&[false, true, false, false, false, false, false, false, false]),
        );
        let there: Vec<f32> = present.iter().map(|present| f32::from(u8::from(*present))).collect();
        let (sent, silent) =
            of_other_worlds(&f, &silent.view([3, 3]), &Tensor::from_slice(&there).view([3, 3]));
        assert_eq!(numbers(&sent), [5.0, 5.0, 5.0, 0.0, 1.0, 0.0, 0.0, 1.0, 5.0]);
        let expected = [0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0];
        assert_eq!(numbers(&silent), expected, "a newcomer's delayed message is missing");
        // Alone, nobody is heard.
        let alone = Tensor::from_slice(&[1.0_f32, 1.0, 0.0]).view([1, 3]);
        let (_, silent) = of_other_worlds(
            &f.narrow(0, 0, 1),
            &Tensor::zeros([1, 3], (Kind::Bool, Device::Cpu)),
            &alone,
        );
        assert_eq!(numbers(&silent), [1.0; 3]);
    }

    #[test]
    fn bits_are_those_of_the_numbers_and_their_scale() {
        let bits =
            |bits: u32, width: usize| Channel { bits, ..Channel::default() }.message_bits(width);
        assert_eq!((bits(32, 10), bits(4, 10), bits(4, 0)), (320.0, 72.0, 0.0));
    }

    #[test]
    fn few_bits_leave_few_levels() {
        let f = Tensor::from_slice(&[-1.0_f32, -0.4, 0.0, 0.3, 0.6, 1.0]).view([1, 1, 6]);
        let levels = |bits: u32| numbers(&Channel { bits, ..Channel::default() }.rounded(&f));
        assert_eq!(levels(2), [-1.0, 0.0, 0.0, 0.0, 1.0, 1.0]);
        let worst = |bits: u32| {
            levels(bits).iter().zip(numbers(&f)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
        };
        assert!(worst(8) <= 0.5 / 127.0 + 1e-6 && worst(4) > worst(8) && worst(32) == 0.0);
    }

    #[test]
    fn delayed_messages_arrive_in_order_and_not_across_episodes() {
        let channel = Channel { delay: 2, ..Channel::default() };
        let mut past = Tensor::full([1, N, channel.memory(H as usize) as i64], 7.0, CPU);
        for t in 0..6 {
            // New episodes start at the first and at the fourth decision.
            let keep = if t == 0 || t == 3 { 0.0 } else { 1.0 };
            let (heard, next) =
                send(&channel, &embeddings(f64::from(t * 100)), keep, &past, &noise(1.0, 1.0));
            let arrived = t % 3 == 2;
            assert_eq!(numbers(&heard.arrived)[1], f64::from(u8::from(arrived)), "step {t}");
            if arrived {
                let of_second = numbers(&heard.embedding.get(0).get(0).get(1));
                assert_eq!(
                    of_second,
                    numbers(&embeddings(f64::from((t - 2) * 100)).get(0).get(1)),
                    "step {t}"
                );
            }
            past = next;
        }
    }
}
