//! Self-attention encoder of one agent's observation. The observation is cut into tokens, one for
//! each entity (ego vehicle, navigation, neighbours), so that the encoding treats neighbours alike
//! and ignores those that are absent.
//!
//! The paper names self-attention over the observation without saying what the tokens are; entities
//! are this program's choice.

use std::f64::consts::SQRT_2;

use tch::{Kind, Tensor};

use super::{Activation, Init, Layer, LayerNorm, Linear, Mask, Packing, Path, SelfAttention};

/// Position of the tokens of one kind in a flat observation: `count` consecutive tokens of `width`
/// features each.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TokenGroup {
    /// Index of the first feature of the first token.
    pub offset: i64,
    /// Number of features of a token.
    pub width: i64,
    /// Number of tokens.
    pub count: i64,
    /// Index within a token of the feature that flags the token as present (above 0.5); `None` for
    /// tokens that are always present. Tokens with a flag are interchangeable; those without differ
    /// by their place in the group.
    pub presence: Option<i64>,
}

/// What tells the tokens of one kind apart, and maps them to the width of all.
#[derive(Debug)]
struct Embedding {
    group: TokenGroup,
    linear: Linear,
    /// A vector for each place, `[count, width]`, where tokens differ by their place.
    places: Option<Tensor>,
}

impl Embedding {
    fn new(mut path: Path<'_>, group: TokenGroup, width: i64) -> Self {
        let has_places = group.count > 1 && group.presence.is_none();
        let init = Init::Orthogonal(SQRT_2);
        let places = has_places.then(|| path.create("places", &[group.count, width], init));
        Self { group, linear: Linear::new(path, group.width, width, init), places }
    }

    /// Returns the tokens of observations `[B, O]`, `[B, count, width]`, and which are present.
    fn forward(&self, observation: &Tensor) -> (Tensor, Tensor) {
        let (batch, group) = (observation.size()[0], &self.group);
        let features = observation.narrow(1, group.offset, group.width * group.count);
        let features = features.reshape([batch, group.count, group.width]);
        let present = match group.presence {
            Some(flag) => features.select(2, flag).gt(0.5),
            None => Tensor::ones([batch, group.count], (Kind::Bool, observation.device())),
        };
        let tokens = self.linear.forward(&features);
        (self.places.as_ref().map_or_else(|| tokens.shallow_clone(), |at| &tokens + at), present)
    }
}

/// The encoder. One linear layer per group maps tokens to width `d`, and tokens that differ by
/// their place, such as beams, each get a learned vector added; layer normalisation and one
/// post-norm self-attention layer without feed-forward part follow. The mean over the present
/// tokens and the ego token are concatenated and pass a linear layer, a rectifier and layer
/// normalisation.
#[derive(Debug)]
pub struct Entity {
    embeddings: Vec<Embedding>,
    embed_norm: LayerNorm,
    attention: SelfAttention,
    attention_norm: LayerNorm,
    out: Layer,
}

impl Entity {
    /// Creates an encoder of observations that consist of `groups`, with tokens of `width`
    /// features, `heads` attention heads and an output of `hidden` features. The first token of the
    /// first group is the ego vehicle, which counts as present whatever its flag is. Weights are
    /// orthogonal with gain 1 in the attention and √2 elsewhere.
    ///
    /// # Panics
    /// If there is no group, if a group is empty or its flag lies outside its tokens, or if the
    /// heads do not divide the token width.
    pub fn new(
        mut path: Path<'_>,
        groups: &[TokenGroup],
        width: i64,
        heads: i64,
        hidden: i64,
    ) -> Self {
        let valid = |g: &TokenGroup| {
            g.offset >= 0
                && g.width > 0
                && g.count > 0
                && g.presence.is_none_or(|p| (0..g.width).contains(&p))
        };
        assert!(
            !groups.is_empty() && groups.iter().all(valid),
            "token groups are not sound: {groups:?}"
        );
        let mut embed = path.sub("embed");
        let embedding =
            |(i, group): (usize, &TokenGroup)| Embedding::new(embed.sub(i), *group, width);
        Entity {
            embeddings: groups.iter().enumerate().map(embedding).collect(),
            embed_norm: LayerNorm::new(path.sub("embed_norm"), width),
            attention: SelfAttention::new(
                path.sub("attention"),
                width,
                heads,
                Init::Orthogonal(1.0),
            ),
            attention_norm: LayerNorm::new(path.sub("attention_norm"), width),
            out: Layer::new(&mut path, ["out", "out_norm"], 2 * width, hidden, Activation::Relu),
        }
    }

    /// Maps observations `[B, O]` to embeddings `[B, H]`.
    pub fn forward(&self, observation: &Tensor) -> Tensor {
        let batch = observation.size()[0];
        let (tokens, present): (Vec<_>, Vec<_>) =
            self.embeddings.iter().map(|embedding| embedding.forward(observation)).unzip();
        let present = Tensor::cat(&present, 1);
        let _ = present.select(1, 0).fill_(1.0);
        let x = self.embed_norm.forward(&Tensor::cat(&tokens, 1));
        let (_, count, width) = x.size3().expect("tokens are [B, T, width]");
        let (packing, tokens) = (Packing::full(batch, count), x.flatten(0, 1));

        let hidden_keys = present.logical_not().unsqueeze(1).unsqueeze(1);
        let bias = Tensor::zeros(hidden_keys.size(), (Kind::Float, x.device()))
            .masked_fill(&hidden_keys, f64::NEG_INFINITY);
        let change = self.attention.forward(&tokens, &packing, Mask::Add(&bias));
        let x = self.attention_norm.forward(&(tokens + change)).view([batch, count, width]);

        let weight = present.to_kind(Kind::Float);
        let weight = &weight / weight.sum_dim_intlist(1, true, Kind::Float);
        let mean = weight.unsqueeze(1).bmm(&x).squeeze_dim(1);
        let pooled = Tensor::cat(&[mean, x.select(1, 0)], 1);
        self.out.forward(&pooled)
    }
}

#[cfg(test)]
mod tests {
    use tch::Device;

    use super::*;
    use crate::nn::Params;
    use crate::rng::Seed;

    /// Returns an encoder of the ego vehicle (3 features) and two neighbours (4 features, the first
    /// of which is the flag).
    fn encoder() -> Entity {
        let groups = [
            TokenGroup { offset: 0, width: 3, count: 1, presence: None },
            TokenGroup { offset: 3, width: 4, count: 2, presence: Some(0) },
        ];
        Entity::new(Params::new(Device::Cpu).root(&mut Seed::new(5).rng()), &groups, 8, 2, 6)
    }

    fn encode(observation: [f32; 11]) -> Vec<f32> {
        Vec::try_from(
            encoder().forward(&Tensor::from_slice(&observation).view([1, 11])).reshape([-1]),
        )
        .unwrap()
    }

    #[test]
    fn an_absent_token_changes_nothing() {
        let base = encode([0.1, -0.2, 0.3, 1.0, 0.5, 0.6, -0.7, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(base, encode([0.1, -0.2, 0.3, 1.0, 0.5, 0.6, -0.7, 0.0, 3.0, -9.0, 7.0]));
        assert_ne!(base, encode([0.1, -0.2, 0.3, 1.0, 0.5, 0.6, -0.7, 1.0, 3.0, -9.0, 7.0]));
    }

    /// Tokens without a flag, such as the beams of a lidar or the cells of a road, are told apart.
    #[test]
    fn tokens_without_a_flag_differ_by_their_place() {
        let groups = [
            TokenGroup { offset: 0, width: 1, count: 1, presence: None },
            TokenGroup { offset: 1, width: 1, count: 3, presence: None },
        ];
        let mut params = Params::new(Device::Cpu);
        let entity = Entity::new(params.root(&mut Seed::new(5).rng()), &groups, 8, 2, 6);
        let at = |cell: usize| {
            let mut observation = [0.0_f32; 4];
            observation[1 + cell] = 1.0;
            let found = entity.forward(&Tensor::from_slice(&observation).view([1, 4]));
            Vec::<f32>::try_from(found.reshape([-1])).expect("numbers")
        };
        let [a, b, c] = [0, 1, 2].map(at);
        let far = |a: &[f32], b: &[f32]| a.iter().zip(b).any(|(a, b)| (a - b).abs() > 0.01);
        assert!(far(&a, &b) && far(&b, &c) && far(&a, &c), "{a:?} {b:?} {c:?}");
    }

    #[test]
    fn neighbours_are_interchangeable_and_nobody_may_be_there() {
        let a = encode([0.1, -0.2, 0.3, 1.0, 0.5, 0.6, -0.7, 1.0, 0.2, 0.8, 0.9]);
        let b = encode([0.1, -0.2, 0.3, 1.0, 0.2, 0.8, 0.9, 1.0, 0.5, 0.6, -0.7]);
        assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-5), "{a:?} {b:?}");
        assert!(encode([0.0; 11]).iter().all(|v| v.is_finite()));
    }
}
