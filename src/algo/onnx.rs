//! Policies as ONNX models, for use outside of this program. The graph computes the actions of
//! trained policies as they act in evaluations, without noise.
//!
//! - inputs: `observation [batch, agents, O]`; for methods that send messages also
//!   `comm [batch, agents, agents]`, 1 where two agents are within radio range, receiver first
//! - output: `action [batch, agents, A]`, within -1..=1; where actions are discrete,
//!   `logits [batch, agents, K]`, of whose choices the largest that is open counts

use std::collections::HashMap;

use tch::{Kind, Tensor};

use super::Settings;
use super::encoder::EncoderKind;
use super::networks::HEADS;
use crate::env::{ActionSpace, EnvSpec};
use crate::onnx::{Attribute, Dimension, Graph, Value};

/// Methods that have an ONNX model.
pub const METHODS: [&str; 5] = ["mappo", "im-iwol", "ex-iwol", "maddpg", "maddpg-iwol"];

/// Prefix of the tensors of a policy in a checkpoint.
pub const ACTOR: &str = "actor/";

/// Returns the graph of a policy, from the tensors of a checkpoint of deployed weights; `None` for
/// methods and encoders that have none.
pub fn graph(
    algorithm: &str,
    spec: &EnvSpec,
    settings: &Settings,
    tensors: &[(String, Tensor)],
) -> Option<Graph> {
    if settings.network.encoder != EncoderKind::Mlp {
        return None;
    }
    let named =
        tensors.iter().filter_map(|(name, tensor)| Some((name.strip_prefix(ACTOR)?, tensor)));
    let mut writer = Writer { graph: Graph::default(), tensors: named.collect() };
    let (any, agents) = (Dimension::Any("batch"), Dimension::Any("agents"));
    let width = Dimension::Fixed(spec.observation.len());
    let observation = writer.graph.input("observation", &[any, agents, width]);
    let read = match algorithm {
        "mappo" | "maddpg" => writer.mlp("encoder.mlp", &observation),
        "im-iwol" | "maddpg-iwol" => {
            let f = writer.mlp("encoder.mlp", &observation);
            let hidden = writer.linear("latent.0", &f);
            let hidden = writer.graph.apply("Relu", &[&hidden]);
            let z = writer.linear("latent.1", &hidden);
            writer.concat(&z, &f)
        }
        "ex-iwol" => {
            let comm = writer.graph.input("comm", &[any, agents, agents]);
            let f = writer.mlp("trunk.encoder.mlp", &observation);
            let edges = writer.edges(&f, &comm, settings.iwol.graph_bias);
            let message = writer.message(&f, &edges, &settings.iwol);
            writer.concat(&message, &f)
        }
        _ => return None,
    };
    let action = match &spec.actions {
        ActionSpace::Discrete(_) => writer.linear("head.logits", &read),
        ActionSpace::Continuous(_) => {
            let mean = writer.linear("head.mean", &read);
            if algorithm.starts_with("maddpg") {
                writer.graph.apply("Tanh", &[&mean])
            } else {
                let (low, high) = (writer.graph.number(-1.0), writer.graph.number(1.0));
                writer.graph.apply("Clip", &[&mean, &low, &high])
            }
        }
    };
    let width = Dimension::Fixed(spec.actions.encoded());
    writer.graph.output(output(&spec.actions), &action, &[any, agents, width]);
    Some(writer.graph)
}

/// Returns the name of a model's output.
pub fn output(actions: &ActionSpace) -> &'static str {
    match actions {
        ActionSpace::Continuous(_) => "action",
        ActionSpace::Discrete(_) => "logits",
    }
}

/// Writes the layers of the networks.
struct Writer<'a> {
    graph: Graph,
    tensors: HashMap<&'a str, &'a Tensor>,
}

impl Writer<'_> {
    /// Adds a tensor of the checkpoint as a constant.
    fn tensor(&mut self, name: &str, transposed: bool) -> Value {
        let tensor = self.tensors[name];
        let tensor = if transposed { tensor.tr() } else { tensor.shallow_clone() };
        let data = Vec::<f32>::try_from(tensor.to_kind(Kind::Float).flatten(0, -1))
            .expect("a vector of single precision");
        self.graph.constant(&tensor.size(), &data)
    }

    fn linear(&mut self, name: &str, x: &Value) -> Value {
        let weight = self.tensor(&format!("{name}.weight"), true);
        let bias = self.tensor(&format!("{name}.bias"), false);
        let product = self.graph.apply("MatMul", &[x, &weight]);
        self.graph.apply("Add", &[&product, &bias])
    }

    fn has(&self, name: &str) -> bool {
        self.tensors.contains_key(&*format!("{name}.weight"))
    }

    fn norm(&mut self, name: &str, x: &Value) -> Value {
        let scale = self.tensor(&format!("{name}.weight"), false);
        let bias = self.tensor(&format!("{name}.bias"), false);
        let attributes = [("axis", Attribute::Int(-1)), ("epsilon", Attribute::Float(1e-5))];
        self.graph.apply_with("LayerNormalization", &[x, &scale, &bias], &attributes)
    }

    fn mlp(&mut self, name: &str, x: &Value) -> Value {
        let norm = format!("{name}.norm");
        let mut x = if self.has(&norm) { self.norm(&norm, x) } else { x.clone() };
        for layer in 0..2 {
            let linear = self.linear(&format!("{name}.layers.{layer}.linear"), &x);
            let positive = self.graph.apply("Relu", &[&linear]);
            x = self.norm(&format!("{name}.layers.{layer}.norm"), &positive);
        }
        x
    }

    fn concat(&mut self, a: &Value, b: &Value) -> Value {
        self.graph.apply_with("Concat", &[a, b], &[("axis", Attribute::Int(-1))])
    }

    /// Exact GELU: `x (1 + erf(x / √2)) / 2`.
    fn gelu(&mut self, x: &Value) -> Value {
        let (root, one, half) = (std::f32::consts::FRAC_1_SQRT_2, 1.0, 0.5);
        let [root, one, half] = [root, one, half].map(|value| self.graph.number(value));
        let scaled = self.graph.apply("Mul", &[x, &root]);
        let erf = self.graph.apply("Erf", &[&scaled]);
        let sum = self.graph.apply("Add", &[&erf, &one]);
        let product = self.graph.apply("Mul", &[x, &sum]);
        self.graph.apply("Mul", &[&product, &half])
    }

    /// Returns the most likely graph, true where an agent listens to another or itself.
    fn edges(&mut self, f: &Value, comm: &Value, bias: f64) -> Value {
        let base = self.mlp("trunk.graph.base", f);
        let [receivers, senders] = ["receiver", "sender"].map(|half| {
            let weight = self.tensor(&format!("trunk.graph.{half}"), true);
            self.graph.apply("MatMul", &[&base, &weight])
        });
        let swapped = [("perm", Attribute::Ints(&[0, 2, 1]))];
        let senders = self.graph.apply_with("Transpose", &[&senders], &swapped);
        let sum = self.graph.apply("Add", &[&receivers, &senders]);
        let slope = [("alpha", Attribute::Float(crate::nn::SLOPE))];
        let scores = self.graph.apply_with("LeakyRelu", &[&sum], &slope);
        let limit = self.graph.number(-bias as f32);
        let wanted = self.graph.apply("Greater", &[&scores, &limit]);
        let half = self.graph.number(0.5);
        let possible = self.graph.apply("Greater", &[comm, &half]);
        let heard = self.graph.apply("And", &[&wanted, &possible]);
        // Whether row and column are the same agent.
        let shape = self.graph.apply("Shape", &[comm]);
        let [first, last, step] = [0, 2, 1].map(|value| self.graph.integers(&[value]));
        let agents = self.graph.apply("Gather", &[&shape, &last]);
        let [first, agents, step] =
            [first, agents, step].map(|value| self.graph.apply("Squeeze", &[&value]));
        let index = self.graph.apply("Range", &[&first, &agents, &step]);
        let [front, back] = [0, 1].map(|axis| self.graph.integers(&[axis]));
        let row = self.graph.apply("Unsqueeze", &[&index, &front]);
        let column = self.graph.apply("Unsqueeze", &[&index, &back]);
        let own = self.graph.apply("Equal", &[&row, &column]);
        self.graph.apply("Or", &[&heard, &own])
    }

    /// Returns the messages after the rounds of attention over the graph.
    fn message(&mut self, f: &Value, edges: &Value, iwol: &super::iwol::Iwol) -> Value {
        const NAME: &str = "trunk.transformer";
        let x = self.norm(&format!("{NAME}.in_norm"), f);
        let x = self.linear(&format!("{NAME}.input"), &x);
        let x = self.gelu(&x);
        let mut x = self.norm(&format!("{NAME}.embed_norm"), &x);
        for round in 0..iwol.rounds {
            let name = format!("{NAME}.rounds.{round}");
            let attention = self.attention(&format!("{name}.attention"), &x, edges, iwol.message);
            let sum = self.graph.apply("Add", &[&x, &attention]);
            x = self.norm(&format!("{name}.attention_norm"), &sum);
            let up = self.linear(&format!("{name}.up"), &x);
            let up = self.gelu(&up);
            let down = self.linear(&format!("{name}.down"), &up);
            let sum = self.graph.apply("Add", &[&x, &down]);
            x = self.norm(&format!("{name}.mlp_norm"), &sum);
        }
        let x = self.linear(&format!("{NAME}.head"), &x);
        let x = self.gelu(&x);
        let x = self.norm(&format!("{NAME}.head_norm"), &x);
        self.linear(&format!("{NAME}.out"), &x)
    }

    fn attention(&mut self, name: &str, x: &Value, edges: &Value, width: i64) -> Value {
        let head = width / HEADS;
        let qkv = self.linear(&format!("{name}.qkv"), x);
        let last = [("axis", Attribute::Int(-1))];
        let parts: [Value; 3] = self.graph.apply_to("Split", &[&qkv], &last);
        // 0 keeps a dimension.
        let heads = self.graph.integers(&[0, 0, HEADS, head]);
        let orders = [[0, 2, 1, 3], [0, 2, 3, 1], [0, 2, 1, 3]];
        let mut split = parts.iter().zip(&orders).map(|(part, order)| {
            let part = self.graph.apply("Reshape", &[part, &heads]);
            self.graph.apply_with("Transpose", &[&part], &[("perm", Attribute::Ints(order))])
        });
        let mut next = || split.next().expect("three parts");
        let (queries, keys, values) = (next(), next(), next());
        let logits = self.graph.apply("MatMul", &[&queries, &keys]);
        let scale = self.graph.number(1.0 / (head as f32).sqrt());
        let logits = self.graph.apply("Mul", &[&logits, &scale]);
        let closed = self.graph.number(f32::NEG_INFINITY);
        let axis = self.graph.integers(&[1]);
        let edges = self.graph.apply("Unsqueeze", &[edges, &axis]);
        let logits = self.graph.apply("Where", &[&edges, &logits, &closed]);
        let weights = self.graph.apply_with("Softmax", &[&logits], &last);
        let mixed = self.graph.apply("MatMul", &[&weights, &values]);
        let back = [("perm", Attribute::Ints(&[0, 2, 1, 3]))];
        let mixed = self.graph.apply_with("Transpose", &[&mixed], &back);
        let joined = self.graph.integers(&[0, 0, width]);
        let mixed = self.graph.apply("Reshape", &[&mixed, &joined]);
        self.linear(&format!("{name}.out"), &mixed)
    }
}
