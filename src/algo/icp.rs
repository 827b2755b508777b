//! ICP: an implicit channel. What an agent does shows a symbol, and those who see it read the symbol a step later (Wang et al. 2025,
//! "Implicit communication protocol", arXiv 2411.01553, for discrete actions; as adapted to continuous control in IWoL's
//! appendix, "Comparison with ICP", which leaves most open; there is no public code).
//!
//! 1. each agent shows one of K symbols with every action, chosen from its embedding, with the gradient of the softmax
//! 2. one encoder and one decoder for all agents: the decoder tells from a symbol what its sender saw (its embedding) and did
//!    (its action), and both learn that from everyone's samples
//! 3. in the next step an agent reads, beside its observation, the mean of what the decoder tells of those within range
//! 4. three values: `icp-dec` has one for each agent, from its own observation, and its own return; `icp-sum` adds them up to
//!    one of the team, and `icp-monotonic` mixes them as QMIX does, told the privileged state; these two learn from the team's
//!    return, and their agents share its advantage
//!
//! It differs from the original on purpose: a continuous action has none to spare for scouting, so that the symbol rides on
//! it and moves nothing; the most likely symbol is shown always (original: Gumbel noise); a mean has a place for any number
//! of others (adaptation: a place for each). Proximal policy optimisation and the Gaussian head are those of all methods.

use std::marker::PhantomData;

use tch::{Kind, Tensor};

use super::batch::{Batch, Shard};
use super::core::{Loss, Networks};
use super::critic::Critic;
use super::decoder::Decoder;
use super::encoder::{Encoder, encode_rows, encode_shard};
use super::head::{GaussianHead, PolicyTerms, Ratio};
use super::parameters::{ACTOR, CRITIC, Places};
use super::{ActMode, Decision, Hears, Observation, Settings, ppo};
use crate::env::{EnvSpec, Feature, Features, Group};
use crate::nn::graph::sample_best;
use crate::nn::{Init, Linear, Mixer, ValueNorm};

/// How the agents' values make the one that is learned.
pub(super) trait Decomposition: Send + 'static {
    /// Name of the method.
    const NAME: &'static str;
    /// Whether the team has one value, and one return.
    const TEAM: bool;
    /// Whether that value is mixed, and not a sum.
    const MIXED: bool;
}

/// A value for each agent.
pub(super) struct Separate;
/// Their sum.
pub(super) struct Sum;
/// A function that rises with each of them.
pub(super) struct Monotonic;

impl Decomposition for Separate {
    const NAME: &'static str = "icp-dec";
    const TEAM: bool = false;
    const MIXED: bool = false;
}

impl Decomposition for Sum {
    const NAME: &'static str = "icp-sum";
    const TEAM: bool = true;
    const MIXED: bool = false;
}

impl Decomposition for Monotonic {
    const NAME: &'static str = "icp-monotonic";
    const TEAM: bool = true;
    const MIXED: bool = true;
}

/// Implicit channel with a decomposition of the value.
pub(super) struct Icp<D> {
    encoder: Encoder,
    head: GaussianHead,
    symbol: Linear,
    decoder: Decoder,
    critic: Critic,
    mixer: Option<Mixer>,
    /// Symbols K.
    symbols: i64,
    decomposition: PhantomData<D>,
}

impl<D: Decomposition> Icp<D> {
    /// Symbols `[.., K]` that embeddings `[.., H]` show: 0 or 1, with the gradient of the softmax.
    fn show(&self, f: &Tensor) -> Tensor {
        sample_best(&self.symbol.forward(f), 1, 1.0)
    }

    /// What agents read beside their observation, `[rows, N, H + A]`: `memory [rows, N, M]` ends with the symbols of the last
    /// step, forgotten where `keep [rows, N]` is 0, and `comm [rows, N, N]` says who is within range.
    fn heard(&self, memory: &Tensor, keep: &Tensor, comm: &Tensor) -> Tensor {
        let shown = memory.narrow(2, self.encoder.memory(), self.symbols) * keep.unsqueeze(-1);
        let others = comm - comm.diagonal(0, 1, 2).diag_embed(0, 1, 2);
        let count = others.sum_dim_intlist(-1, true, Kind::Float).clamp_min(1.0);
        let all = Tensor::eye(self.symbols, (Kind::Float, memory.device()));
        (others / count).matmul(&shown).matmul(&self.decoder.forward(&all).detach())
    }

    /// What one decision's encoder reads, and the encoder's own memory.
    fn read(&self, input: &Observation) -> (Tensor, Tensor) {
        let heard = self.heard(&input.memory, &input.keep(), &input.comm);
        (
            Tensor::cat(&[&input.observation, &heard], -1),
            input.memory.narrow(2, 0, self.encoder.memory()),
        )
    }

    /// The learned value of rows from those of all agents, `[rows, N]` each; `comm [rows, N, N]` says who is there.
    fn decomposed(&self, values: Tensor, state: &Tensor, comm: &Tensor) -> Tensor {
        if !D::TEAM {
            return values;
        }
        let present = comm.diagonal(0, 1, 2);
        let team = match &self.mixer {
            Some(mixer) => mixer.forward(&values, state, &present),
            None => (&values * present).sum_dim_intlist(-1, false, Kind::Float),
        };
        team.unsqueeze(-1).expand_as(&values)
    }
}

impl<D: Decomposition> Networks for Icp<D> {
    const NAME: &'static str = D::NAME;
    const HEARS: Hears = Hears::InRangeLater;
    const SETTINGS: &'static [&'static str] = &["icp"];
    const TEAM: bool = D::TEAM;

    fn new(spec: &EnvSpec, settings: &Settings, places: &mut Places) -> Self {
        let (network, symbols, actions) =
            (&settings.network, settings.icp.symbols, spec.actions.len() as i64);
        let (hidden, told) = (network.hidden, network.hidden + actions);
        let heard = |i| Feature {
            name: format!("heard.{i}"),
            unit: "1".to_owned(),
            low: f32::MIN,
            high: f32::MAX,
        };
        let group = Group {
            name: "heard".to_owned(),
            offset: 0,
            width: told as usize,
            count: 1,
            presence: None,
        };
        let heard = Features { list: (0..told).map(heard).collect(), groups: vec![group] };
        let mixer = |places: &mut Places| {
            Mixer::new(places.of(CRITIC).sub("mixer"), spec.state.len() as i64)
        };
        Self {
            encoder: Encoder::new(
                places.of(ACTOR).sub("encoder"),
                &spec.observation.join(&heard),
                network,
            ),
            head: GaussianHead::new(
                places.of(ACTOR).sub("head"),
                hidden,
                &spec.actions,
                &settings.exploration,
            ),
            symbol: Linear::new(
                places.of(ACTOR).sub("symbol"),
                hidden,
                symbols,
                Init::Orthogonal(1.0),
            ),
            decoder: Decoder::new(places.of(ACTOR).sub("decoder"), symbols, hidden, told, false),
            critic: Critic::new(places.of(CRITIC), &spec.observation, network),
            mixer: D::MIXED.then(|| mixer(places)),
            symbols,
            decomposition: PhantomData,
        }
    }

    fn head(&self) -> &GaussianHead {
        &self.head
    }

    fn memory(&self) -> i64 {
        self.encoder.memory() + self.symbols
    }

    fn is_recurrent(&self) -> bool {
        self.encoder.memory() > 0
    }

    fn value_memory(&self) -> i64 {
        self.critic.memory()
    }

    fn act(&self, input: &Observation, mode: &ActMode<'_>) -> Decision {
        let (x, memory) = self.read(input);
        let (f, after) = encode_rows(&self.encoder, &x, &memory, &input.keep(), 1);
        let after = after.map_or_else(|| memory.shallow_clone(), |after| after.view_as(&memory));
        let (action, log_prob) = self.head.sample(&f, mode);
        Decision { action, log_prob, memory: Tensor::cat(&[&after, &self.show(&f)], -1) }
    }

    fn value(&self, input: &Observation, state: &Tensor) -> Option<Tensor> {
        let values = self.critic.value(&input.observation, input);
        values.map(|values| self.decomposed(values, state, &input.comm))
    }

    fn values(&self, batch: &Batch, length: i64, memory: &Tensor) -> (Tensor, Option<Tensor>) {
        let (values, after) = self.critic.values(&batch.observation, &batch.keep, length, memory);
        (self.decomposed(values, &batch.state, &batch.comm), after)
    }

    fn loss(&self, batch: &Batch, shard: &Shard, settings: &Settings, norm: &ValueNorm) -> Loss {
        let (comm, keep) = (shard.take(&batch.comm), shard.take(&batch.keep));
        let first = batch.value_memory.index_select(0, &shard.first);
        let (values, _) =
            self.critic.values(&shard.take(&batch.observation), &keep, shard.length, &first);
        let values = shard.pick(&self.decomposed(values, &shard.take(&batch.state), &comm));
        let value = ppo::value_terms(batch, shard, &values, norm, &settings.ppo);

        let heard = self.heard(&shard.take(&batch.memory), &keep, &comm);
        let x = Tensor::cat(&[shard.take(&batch.observation), heard], -1);
        let own = batch.memory.narrow(2, 0, self.encoder.memory());
        let f = encode_shard(&self.encoder, shard, &x, &own, &batch.keep);
        let policy = PolicyTerms::new(batch, shard, &self.head, &f, &settings.ppo, Ratio::Joint);
        // Others see what an action does, which ends at its bounds.
        let told = Tensor::cat(&[f.detach(), shard.active(&batch.action).clamp(-1.0, 1.0)], -1);
        let message = (self.decoder.forward(&self.show(&f)) - told).square().mean(Kind::Float);

        let mut report = vec![("loss/value", value.detach()), ("loss/message", message.detach())];
        report.extend(policy.report());
        Loss { total: &policy.loss + value + settings.icp.lambda_message * message, report }
    }
}
