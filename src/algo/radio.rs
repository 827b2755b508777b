//! The channel in training: what losses, rounding, delay and false messages do to the embeddings
//! that agents send, with gradients to their senders.
//!
//! A rollout keeps what the update needs to hear the same again: per pair of agents whether the
//! message was lost or which false message replaced it, and in the agents' memory the observations
//! of the steps for which messages are under way. The update embeds such an old observation with the
//! present weights.
//!
//! Here each receiver computes its message from what it heard, so that a lost message does not reach
//! it over a third agent. Where messages are at most lost and no agent passes on what it heard, this
//! is the same as to cut lost messages from the rollout's physical masks, which is faster: such
//! methods have no radio.

use rand::RngExt as _;
use tch::{Device, Kind, Tensor, no_grad};

use super::channel::{Channel, Heard};
use super::decision::{ActMode, Observation};
use super::encoder::Encoder;
use super::scene::{Messages, Scene};
use super::settings::Settings;
use crate::nn::Graph;
use crate::rng::{self, Rng, Seed};

/// Number of different false messages.
const FALSE_MESSAGES: usize = 4096;

/// A channel that changes or delays the messages of a training.
#[derive(Debug)]
pub struct Radio {
    channel: Channel,
    /// Standard normal contents of the false messages, `[FALSE_MESSAGES, H]`; without rows where no
    /// message is falsified.
    contents: Tensor,
    /// Number O of features of an observation.
    observation: i64,
}

impl Radio {
    /// Returns the radio of a training whose messages have `width` numbers and pass over `rounds`
    /// rounds, and whose observations have `observation` numbers; `None` where a mask does the same.
    pub(super) fn new(
        settings: &Settings,
        observation: usize,
        width: i64,
        rounds: usize,
        device: Device,
    ) -> Option<Self> {
        let channel = settings.channel;
        let passed_on = rounds > 1 && channel.loss > 0.0;
        let rows = if channel.falsified > 0.0 { FALSE_MESSAGES } else { 0 };
        let mut contents = vec![0.0; rows * width as usize];
        rng::fill_normal(&mut Seed::new(0).child("false messages").rng(), &mut contents);
        let contents = Tensor::from_slice(&contents).view([rows as i64, width]).to_device(device);
        let observation = observation as i64;
        let is_mask = channel.only_loses() && !passed_on;
        (!is_mask).then_some(Self { channel, contents, observation })
    }

    /// Returns how many numbers an agent remembers for the messages that are under way: its steps
    /// since its trajectory began, and its observations, the oldest first.
    pub(super) fn memory(&self) -> i64 {
        self.channel.memory(self.observation as usize) as i64
    }

    /// Returns the radio if messages pass through it in a decision: while a policy explores.
    pub(super) fn in_use<'a>(radio: Option<&'a Self>, mode: &ActMode) -> Option<&'a Self> {
        radio.filter(|_| matches!(mode, ActMode::Sample { .. }))
    }

    /// Returns the memory after a decision, `[E, N, M]`: what the `encoder` remembers, or the
    /// messages that are under way.
    pub(super) fn memory_after(
        radio: Option<&Self>,
        input: &Observation,
        encoder: Option<Tensor>,
    ) -> Tensor {
        match radio.filter(|radio| radio.channel.delay > 0) {
            Some(radio) => radio.after(input),
            None => input.memory_after(encoder),
        }
    }

    fn after(&self, input: &Observation) -> Tensor {
        let past = &input.memory * input.keep().unsqueeze(-1);
        let queue = past.narrow(2, 1, self.memory() - 1);
        let queue = Tensor::cat(&[&queue, &input.observation], -1);
        let rest = queue.narrow(2, self.observation, self.memory() - 1);
        Tensor::cat(&[&(past.narrow(2, 0, 1) + 1.0), &rest], -1)
    }

    /// Computes a message path whose messages pass through the radio. `read` maps the embeddings
    /// that each receiver knows, `[rows · N, N, H]`, and 1 where one arrived, `[rows · N, 1, N]`, to
    /// the receivers' messages `[rows · N, D]` and to their rows of the graph, `[rows · N, N]`.
    pub(super) fn exchange(
        &self,
        encoder: &Encoder,
        scene: &Scene,
        read: impl Fn(&Tensor, &Tensor) -> (Tensor, Tensor),
    ) -> Messages {
        let (rows, agents) = scene.size();
        let (f, memory) = scene.embed(encoder);
        let Heard { embedding, arrived } = self.hear(encoder, scene, &f);
        let arrived = arrived.reshape([rows * agents, 1, agents]);
        let (made, graph) = read(&embedding.flatten(0, 1), &arrived);
        let packing = scene.packing();
        Messages {
            message: packing.pack(&made.view([rows, agents, -1])),
            embedding: packing.pack(&f),
            graph: Graph::Full(graph.view([rows, agents, agents])),
            packing,
            memory,
        }
    }

    /// Returns what each agent of a scene hears of every agent, whose present embeddings are
    /// `f [rows, N, H]`.
    fn hear(&self, encoder: &Encoder, scene: &Scene, f: &Tensor) -> Heard {
        let (sent, silent) = self.sent(encoder, scene, f);
        // The gradient of rounding is that of its argument.
        let sent = no_grad(|| self.channel.rounded(&sent)) + (&sent - sent.detach());
        let numbers = scene.disturbance.as_ref();
        let arrived = numbers
            .map_or_else(|| scene.comm.ones_like(), |number| number.ge(0.0).to_kind(Kind::Float));
        let falsified = numbers.filter(|_| self.channel.falsified > 0.0).map(|number| {
            let (rows, agents, _) = number.size3().expect("numbers of messages are [rows, N, N]");
            let index = (number - 1.0).clamp_min(0.0).to_kind(Kind::Int64).reshape([-1]);
            let content = self.contents.index_select(0, &index);
            (number.gt(0.0), content.view([rows, agents, agents, -1]))
        });
        Heard::of(f, &sent, &silent, &arrived, falsified.as_ref())
    }

    /// Returns the embeddings that arrive, `[rows, N, H]`, and whether those of a sender do not
    /// arrive yet, `[rows, N]`.
    fn sent(&self, encoder: &Encoder, scene: &Scene, f: &Tensor) -> (Tensor, Tensor) {
        if self.channel.delay == 0 {
            return (f.shallow_clone(), scene.keep.zeros_like().to_kind(Kind::Bool));
        }
        let past = &scene.memory * scene.keep.unsqueeze(-1);
        let silent = past.select(2, 0).lt(f64::from(self.channel.delay));
        let oldest = past.narrow(2, 1, self.observation);
        let (embedding, _) = encoder.forward(&oldest, &scene.memory, &scene.keep);
        (embedding, silent)
    }
}

impl Channel {
    /// Draws what becomes of the messages that `agents` agents of each environment send each other,
    /// for training: -1 for one that is lost, the number of the false message, counted from 1, for
    /// one that is replaced, or 0, in `disturbance [E, N, N]`. Agents always hear themselves.
    pub(crate) fn disturb(&self, disturbance: &mut [f32], agents: usize, seed: &Seed) {
        let (mut lost, mut falsified) = (seed.child("lost").rng(), seed.child("false").rng());
        for (pair, number) in disturbance.iter_mut().enumerate() {
            let is_lost = self.loses(pair, agents, &mut lost);
            let is_false = f64::from(falsified.random::<f32>()) < self.falsified;
            let which = falsified.random_range(0..FALSE_MESSAGES) + 1;
            *number = match (is_lost, is_false) {
                (true, _) => -1.0,
                (false, true) => which as f32,
                (false, false) => 0.0,
            };
        }
    }

    /// Cuts the messages that are lost from physical masks `comm [E, N, N]`, for training without a
    /// radio.
    pub(crate) fn cut(&self, comm: &mut [f32], agents: usize, seed: &Seed) {
        let mut rng = seed.child("lost").rng();
        for (pair, edge) in comm.iter_mut().enumerate() {
            if self.loses(pair, agents, &mut rng) {
                *edge = 0.0;
            }
        }
    }

    /// Draws whether a message is lost between a pair of agents, counted along `[E, N, N]`.
    fn loses(&self, pair: usize, agents: usize, rng: &mut Rng) -> bool {
        let own = pair / agents % agents == pair % agents;
        let lost = f64::from(rng.random::<f32>()) < self.loss;
        lost && !own
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::Features;
    use crate::nn::Params;

    const N: i64 = 3;
    const H: i64 = 4;
    const CPU: (Kind, Device) = (Kind::Float, Device::Cpu);

    /// Rounding has the gradient of its argument, and nothing flows back over false messages.
    #[test]
    fn gradients_reach_senders_of_true_messages_only() {
        let channel = Channel { bits: 6, falsified: 0.5, ..Channel::default() };
        let mut settings = Settings { channel, ..Settings::default() };
        settings.network.hidden = H;
        let radio = Radio::new(&settings, 0, H, 1, Device::Cpu).expect("it changes messages");
        let (mut params, features) = (Params::new(Device::Cpu), Features::default());
        let encoder =
            Encoder::new(params.root(&mut Seed::new(1).rng()), &features, &settings.network);
        let disturbance = Tensor::zeros([1, N, N], CPU);
        // What the first agent hears from the third is false.
        let _ = disturbance.get(0).get(0).get(2).fill_(7.0);
        let scene = Scene {
            observation: Tensor::zeros([1, N, 0], CPU),
            memory: Tensor::zeros([1, N, 0], CPU),
            keep: Tensor::ones([1, N], CPU),
            comm: Tensor::ones([1, N, N], CPU),
            disturbance: Some(disturbance),
            noise: None,
            length: 1,
            pack: false,
        };
        let f = (Tensor::arange(N * H, CPU) * 0.3).view([1, N, H]).set_requires_grad(true);
        let heard = radio.hear(&encoder, &scene, &f).embedding;
        let by = |receiver: i64, sender: i64| heard.get(0).get(receiver).get(sender);
        assert!(by(0, 0).equal(&f.get(0).get(0)), "one's own embedding is intact");
        assert!(by(1, 2).equal(&channel.rounded(&f).get(0).get(2)), "others' are rounded");
        assert!(!by(0, 2).equal(&by(1, 2)), "this one is false");
        let gradient = |receiver: i64| {
            let sum = heard.get(0).get(receiver).sum(Kind::Float);
            let gradient = Tensor::run_backward(&[sum], &[&f], true, false).remove(0);
            Vec::<f32>::try_from(gradient.get(0).sum_dim_intlist(1, false, Kind::Float)).unwrap()
        };
        let width = H as f32;
        assert_eq!(gradient(0), [width, width, 0.0]);
        assert_eq!(gradient(1), [width, width, width]);
    }

    /// Where a value function reads messages without the radio, it hears none that is lost.
    #[test]
    fn lost_messages_are_cut_from_the_masks() {
        let numbers = [0.0, -1.0, 7.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0_f32];
        let mask = [1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0_f32];
        let of = |numbers: &[f32]| Tensor::from_slice(numbers).view([1, N, N]);
        let scene = |disturbance: Option<Tensor>| Scene {
            observation: Tensor::zeros([1, N, 0], CPU),
            memory: Tensor::zeros([1, N, 0], CPU),
            keep: Tensor::ones([1, N], CPU),
            comm: of(&mask),
            disturbance,
            noise: None,
            length: 1,
            pack: false,
        };
        let heard = [1.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0, 1.0];
        assert!(scene(Some(of(&numbers))).heard().equal(&of(&heard)));
        assert!(scene(None).heard().equal(&of(&mask)));
    }

    #[test]
    fn as_many_messages_are_lost_and_false_as_should_be() {
        let channel = Channel { loss: 0.3, falsified: 0.5, ..Channel::default() };
        let mut disturbance = vec![7.0; 9 * 2000];
        channel.disturb(&mut disturbance, 3, &Seed::new(4));
        let own = |pair: usize| pair / 3 % 3 == pair % 3;
        let share = |is: fn(f32) -> bool| {
            let others = (0..disturbance.len()).filter(|&pair| !own(pair));
            others.filter(|&pair| is(disturbance[pair])).count() as f64 / 12_000.0
        };
        assert!((share(|number| number == -1.0) - 0.3).abs() < 0.02);
        assert!((share(|number| number > 0.0) - 0.35).abs() < 0.02);
        assert!(disturbance.iter().all(|&number| number <= FALSE_MESSAGES as f32));
        assert!(
            (0..disturbance.len()).filter(|&pair| own(pair)).all(|pair| disturbance[pair] >= 0.0)
        );
        // Without a radio, the same messages are lost.
        let mut comm = vec![1.0; disturbance.len()];
        channel.cut(&mut comm, 3, &Seed::new(4));
        for (edge, number) in comm.iter().zip(&disturbance) {
            assert_eq!(*edge == 0.0, *number < 0.0);
        }
    }
}
