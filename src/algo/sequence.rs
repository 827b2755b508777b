//! What the methods share that treat the agents of an environment as a sequence (MAT, CommFormer): what goes into the
//! transformer, the value that comes out of its encoder, and acting one after another.
//!
//! Who is gone is left out of the sequence: the next one reads the action of the last one who is there, and nobody attends to an
//! empty place, so that a crew with gaps decides as one without them.

use std::f64::consts::SQRT_2;

use tch::{Kind, Tensor};

use super::ActMode;
use super::encoder::Encoder;
use super::head::GaussianHead;
use super::scene::Scene;
use super::settings::Settings;
use crate::env::EnvSpec;
use crate::nn::{Decoded, Decoder, Init, LayerNorm, Linear, Path, Reach};

/// The observation encoder and the input layer of the transformer: normalisation, linear, GELU, normalisation.
pub(super) struct Input {
    encoder: Encoder,
    norm: LayerNorm,
    linear: Linear,
    out_norm: LayerNorm,
}

impl Input {
    pub(super) fn new(mut path: Path<'_>, spec: &EnvSpec, settings: &Settings) -> Self {
        let hidden = settings.network.hidden;
        Self {
            encoder: Encoder::new(path.sub("encoder"), &spec.observation, &settings.network),
            norm: LayerNorm::new(path.sub("input_norm"), hidden),
            linear: Linear::new(path.sub("input"), hidden, hidden, Init::Orthogonal(SQRT_2)),
            out_norm: LayerNorm::new(path.sub("embed_norm"), hidden),
        }
    }

    /// Memory per agent.
    pub(super) fn memory(&self) -> i64 {
        self.encoder.memory()
    }

    /// Everyone as the transformer takes them, `[L · C, N, H]`, and the memory after each step, `[L, C · N, M]`.
    pub(super) fn forward(&self, scene: &Scene) -> (Tensor, Option<Tensor>) {
        let (f, memory) = scene.embed(&self.encoder);
        (self.out_norm.forward(&self.linear.forward(&self.norm.forward(&f)).gelu("none")), memory)
    }
}

/// The value of an agent from what the transformer's encoder makes of everyone, and from the privileged state: linear, GELU,
/// normalisation, linear with gain 0.01.
pub(super) struct ValueHead {
    first: Linear,
    norm: LayerNorm,
    second: Linear,
}

impl ValueHead {
    pub(super) fn new(mut path: Path<'_>, spec: &EnvSpec, hidden: i64) -> Self {
        let inputs = hidden + spec.state.len() as i64;
        Self {
            first: Linear::new(path.sub("first"), inputs, hidden, Init::Orthogonal(SQRT_2)),
            norm: LayerNorm::new(path.sub("norm"), hidden),
            second: Linear::new(path.sub("second"), hidden, 1, Init::Orthogonal(0.01)),
        }
    }

    /// `representation: [.., H]` and `state: [.., S]` to values (normalised), `[..]`.
    pub(super) fn forward(&self, representation: &Tensor, state: &Tensor) -> Tensor {
        let x = self.first.forward(&Tensor::cat(&[representation, state], -1)).gelu("none");
        self.second.forward(&self.norm.forward(&x)).squeeze_dim(-1)
    }
}

/// Decodes agents in the order of their slots.
pub(super) struct Sequence {
    pub(super) decoder: Decoder,
    pub(super) head: GaussianHead,
    /// Action dimensions A.
    pub(super) actions: i64,
}

/// Who is there and reaches whom, of rows `[B]`.
pub(super) struct Order {
    /// `[B, N]`, true where an agent is there.
    present: Tensor,
    /// How many agents stand before each up to the last one there, itself not counted, `[B, N]`: 0 for the first.
    before: Tensor,
    /// 1 where an agent hears the one there before it, `[B, N]`.
    heard: Tensor,
    /// Among those up to oneself.
    reach: Reach,
}

impl Order {
    /// `present: [B, N]`; `graph: [B, N, N]` is who hears whom, and `reach` the same for attention.
    pub(super) fn new(present: &Tensor, graph: &Tensor, reach: &Reach) -> Self {
        let agents = present.size()[1];
        let present = present.gt(0.5);
        let numbers = Tensor::arange(agents, (Kind::Int64, present.device())) + 1;
        let last = (numbers * present.to_kind(Kind::Int64)).cummax(1).0;
        // The first place has nobody before it.
        let before = last.narrow(1, 0, agents - 1).constant_pad_nd([1, 0]);
        let heard = graph
            .detach()
            .constant_pad_nd([1, 0])
            .gather(2, &before.unsqueeze(-1), false)
            .squeeze_dim(-1);
        Self { present, before, heard: heard.gt(0.5).to_kind(Kind::Float), reach: reach.causal() }
    }
}

impl Sequence {
    /// What the head reads for actions that were taken, `[B, N, A]`: all agents at once, `[B, N, W]`.
    pub(super) fn of_actions(
        &self,
        representation: &Tensor,
        actions: &Tensor,
        order: &Order,
    ) -> Tensor {
        let width = actions.size()[2];
        let all = actions.constant_pad_nd([0, 0, 1, 0]);
        let previous =
            all.gather(1, &order.before.unsqueeze(-1).expand([-1, -1, width], false), false);
        let previous = previous * order.heard.unsqueeze(-1);
        self.decoder.forward(&previous, representation, &order.reach, &mut Decoded::default())
    }

    /// Actions and the log-probabilities of their dimensions, `[E, N, A]`, one agent after another in all environments at once.
    pub(super) fn act(
        &self,
        representation: &Tensor,
        order: &Order,
        mode: &ActMode<'_>,
    ) -> (Tensor, Tensor) {
        let (mut actions, mut log_probs, mut decoded) =
            (Vec::new(), Vec::new(), Decoded::default());
        let like = (Kind::Float, representation.device());
        let mut last = Tensor::zeros([representation.size()[0], 1, self.actions], like);
        for i in 0..representation.size()[1] {
            let of = |x: &Tensor| x.narrow(1, i, 1);
            let previous = &last * of(&order.heard).unsqueeze(-1);
            let read = self.decoder.forward(
                &previous,
                &of(representation),
                &order.reach.up_to(i),
                &mut decoded,
            );
            let (action, log_prob) = match mode {
                ActMode::Deterministic => self.head.sample(&read, &ActMode::Deterministic),
                ActMode::Sample { action, carried, graph, log_fresh } => {
                    let carried =
                        if carried.numel() > 0 { of(carried) } else { carried.shallow_clone() };
                    let (action, carried) = (&of(action), &carried);
                    self.head.sample(&read, &ActMode::Sample { action, carried, graph, log_fresh })
                }
            };
            last = action.where_self(&of(&order.present).unsqueeze(-1), &last);
            actions.push(action);
            log_probs.push(log_prob);
        }
        (Tensor::cat(&actions, 1), Tensor::cat(&log_probs, 1))
    }
}
