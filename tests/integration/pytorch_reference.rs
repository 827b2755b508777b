//! Comparison of networks, losses, value normalisation and optimiser with values that PyTorch
//! computed.
//!
//! `pytorch_reference/generate.py` writes the inputs, weights, outputs and gradients of each case
//! to `pytorch_reference/golden.safetensors`; the tests load the same weights into the Rust layers.
//! Tolerances are a few rounding errors of `f32`: absolute and relative 2e-5 for outputs of
//! networks and for gradients, and tighter where stated.

use iwol_sumo::algo::settings::{EncoderKind, Settings};
use iwol_sumo::algo::{self, ActMode, Algorithm, Observation, UpdateParameters, ppo};
use iwol_sumo::env::{ActionDimension, EnvSpec, Feature, Features};
use iwol_sumo::nn::graph::{sample_best, with_self_loops};
use iwol_sumo::nn::{
    Adam, CommGraph, Decoded, Entity, Graph, GraphAttention, GraphTransformer, Gru, Init, Mixer,
    Mlp, Packing, Params, Path, Reach, RelationBlock, Scheduler, TokenGroup, TransformerDecoder,
    ValueNorm, categorical_entropy, categorical_log_probs, gaussian_entropy, gaussian_log_prob,
};
use iwol_sumo::rng::Seed;
use iwol_sumo::rollout::{Rollout, Sizes};
use tch::{Device, Kind, Tensor};

const TOLERANCE: f64 = 2e-5;

/// The arrays of one case.
struct Case {
    name: &'static str,
    arrays: Vec<(String, Tensor)>,
}

impl Case {
    fn new(name: &'static str) -> Self {
        let file = concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/tests/integration/pytorch_reference/golden.safetensors"
        );
        let all = Tensor::read_safetensors(file).expect("the committed arrays can be read");
        let own = |(key, array): (String, Tensor)| {
            key.strip_prefix(&format!("{name}/")).map(|k| (k.to_owned(), array))
        };
        let arrays: Vec<_> = all.into_iter().filter_map(own).collect();
        assert!(!arrays.is_empty(), "no arrays of the case {name}");
        Case { name, arrays }
    }

    fn get(&self, key: &str) -> Tensor {
        let found = self.arrays.iter().find(|(k, _)| k == key);
        found
            .unwrap_or_else(|| panic!("{}/{key} is not among the arrays", self.name))
            .1
            .shallow_clone()
    }

    /// Returns an input whose gradient is compared.
    fn input(&self, key: &str) -> Tensor {
        self.get(key).set_requires_grad(true)
    }

    /// Builds a network and loads the reference's weights into it.
    fn network<T>(&self, build: impl FnOnce(Path<'_>) -> T) -> (Params, T) {
        let mut params = Params::new(Device::Cpu);
        let network = build(params.root(&mut Seed::new(0).rng()));
        let weight = |(key, array): &(String, Tensor)| {
            key.strip_prefix("param/").map(|k| (k.to_owned(), array.shallow_clone()))
        };
        let weights: Vec<_> = self.arrays.iter().filter_map(weight).collect();
        params.copy_from(&weights).expect("the weights have our names and shapes");
        (params, network)
    }

    /// Builds a learner with the reference's weights, each of which the learner holds `times`
    /// times, and with statistics of its value normalisation that are not the initial ones.
    fn learner(
        &self,
        method: &str,
        spec: &EnvSpec,
        settings: &Settings,
        times: usize,
    ) -> Box<dyn Algorithm> {
        let mut learner =
            algo::build(method, spec, settings, Seed::new(1), Device::Cpu).expect("a learner");
        let (mut state, mut given) = (learner.state(), 0);
        for (name, tensor) in &mut state {
            let key = format!("param/{}", name.replace("_target/", "/"));
            if self.arrays.iter().any(|(k, _)| *k == key) {
                (*tensor, given) = (self.get(&key), given + 1);
            } else if name == "value_norm/statistics" {
                *tensor = Tensor::from_slice(&[0.3_f64, 2.0, 0.6]);
            }
        }
        let params = self.arrays.iter().filter(|(k, _)| k.starts_with("param/")).count();
        assert_eq!(given, times * params, "{method} has all weights");
        learner.load(&state).expect("its own state with other values");
        learner
    }

    fn check(&self, key: &str, found: &Tensor) {
        self.check_within(key, found, TOLERANCE);
    }

    fn check_within(&self, key: &str, found: &Tensor, tolerance: f64) {
        let expected = self.get(key);
        assert_eq!(found.size(), expected.size(), "{}/{key}", self.name);
        let worst = (found - &expected).abs().max().double_value(&[]);
        let close = found.allclose(&expected, tolerance, tolerance, false);
        assert!(close, "{}/{key} is off by {worst}: expected {expected}, found {found}", self.name);
    }

    /// Compares the gradients of a scalar that weights each element of `out` differently, as in the
    /// generator.
    fn check_gradients(&self, out: &Tensor, of: &[(&str, &Tensor)]) {
        let weights =
            (Tensor::arange(out.numel() as i64, (Kind::Float, Device::Cpu)) * 0.37 + 0.5).sin();
        let inputs: Vec<&Tensor> = of.iter().map(|(_, t)| *t).collect();
        let scalar = (out.reshape([-1]) * weights).sum(Kind::Float);
        let gradients = Tensor::run_backward(&[scalar], &inputs, true, false);
        for ((key, _), gradient) in of.iter().zip(&gradients) {
            self.check(key, gradient);
        }
    }
}

fn features(count: usize) -> Features {
    let feature =
        |i: usize| Feature { name: format!("f{i}"), unit: "1".to_owned(), low: -1.0, high: 1.0 };
    Features { list: (0..count).map(feature).collect(), groups: Vec::new(), normalised: true }
}

/// Returns settings of the smallest networks.
fn small() -> Settings {
    let mut settings = Settings::default();
    (settings.network.encoder, settings.network.hidden) = (EncoderKind::Mlp, 6);
    (settings.iwol.latent, settings.iwol.message) = (3, 4);
    settings.icp.symbols = 3;
    settings
}

fn parameter(params: &Params, name: &str) -> Tensor {
    params.named().iter().find(|(n, _)| n == name).expect("the parameter exists").1.shallow_clone()
}

#[test]
fn mlp() {
    let case = Case::new("mlp");
    let (params, mlp) = case.network(|path| Mlp::new(path, 7, 8));
    let x = case.input("x");
    let out = mlp.forward(&x);
    case.check("out", &out);
    let (weight, norm) =
        (parameter(&params, "layers.0.linear.weight"), parameter(&params, "norm.weight"));
    case.check_gradients(&out, &[("grad_x", &x), ("grad_weight", &weight), ("grad_norm", &norm)]);
}

#[test]
fn gru_with_resets() {
    let case = Case::new("gru");
    let (params, gru) = case.network(|path| Gru::new(path, 5, 4));
    let (x, h0, mask) = (case.input("x"), case.input("h0"), case.get("mask"));
    let out = gru.sequence(&x, &h0, &mask);
    case.check("out", &out);
    let (weight, bias) = (parameter(&params, "weight_hh"), parameter(&params, "bias_hh"));
    let of =
        [("grad_x", &x), ("grad_h0", &h0), ("grad_weight_hh", &weight), ("grad_bias_hh", &bias)];
    case.check_gradients(&out, &of);
}

#[test]
fn entity_encoder_with_absent_tokens() {
    let case = Case::new("entity");
    let groups = [
        TokenGroup { offset: 0, width: 3, count: 1, presence: None },
        TokenGroup { offset: 3, width: 2, count: 2, presence: None },
        TokenGroup { offset: 7, width: 4, count: 3, presence: Some(1) },
    ];
    let (params, entity) = case.network(|path| Entity::new(path, &groups, 8, 2, 6));
    let obs = case.input("obs");
    let out = entity.forward(&obs);
    case.check("out", &out);
    let (qkv, embed) =
        (parameter(&params, "attention.qkv.weight"), parameter(&params, "embed.2.weight"));
    case.check_gradients(&out, &[("grad_obs", &obs), ("grad_qkv", &qkv), ("grad_embed", &embed)]);
}

/// Returns features `[B, N, H]`, all of whose agents are present, as rows of a packing.
fn all_places(f: &Tensor) -> (Tensor, Packing) {
    let size = f.size();
    (f.flatten(0, 1), Packing::full(size[0], size[1]))
}

#[test]
fn graph_is_a_straight_through_gumbel_softmax() {
    let case = Case::new("graph");
    let (_, graph) = case.network(|path| CommGraph::new(path, 6, 6, 0.0));
    let f = case.input("f");
    let (flat, packing) = all_places(&f);
    case.check("scores", &graph.scores(&flat, &packing));
    let g = graph.forward(&flat, &packing, &case.get("physical"), Some(&case.get("noise")));
    case.check_within("graph", &g, 0.0);
    case.check_gradients(&g, &[("grad_f", &f)]);
}

#[test]
fn transformer_over_a_graph() {
    let case = Case::new("transformer");
    let (params, transformer) = case.network(|path| GraphTransformer::new(path, 8, 8, 2, 2));
    let (f, graph) = (case.input("f"), case.input("graph"));
    let (flat, packing) = all_places(&f);
    let out =
        packing.unpack(&transformer.forward(&flat, &packing, &Graph::Full(graph.shallow_clone())));
    case.check("out", &out);
    let qkv = parameter(&params, "rounds.0.attention.qkv.weight");
    case.check_gradients(&out, &[("grad_f", &f), ("grad_graph", &graph), ("grad_qkv", &qkv)]);
}

#[test]
fn decoder_of_mat() {
    let case = Case::new("decoder");
    let (params, decoder) = case.network(|path| TransformerDecoder::new(path, 2, 8, 1, 2, None));
    let (previous, rep) = (case.input("previous"), case.input("rep"));
    let reach = Reach::of(&case.get("seen")).causal();
    let out = decoder.forward(&previous, &rep, &reach, &mut Decoded::default());
    case.check("out", &out);
    let embed = parameter(&params, "embed.weight");
    case.check_gradients(
        &out,
        &[("grad_previous", &previous), ("grad_rep", &rep), ("grad_embed", &embed)],
    );
}

/// CommFormer's graph, encoder block and decoder together agree with the reference, including the
/// gradient of the graph's scores through all of them.
#[test]
fn commformer() {
    let case = Case::new("commformer");
    let (_, (edges, relations, block, decoder)) = case.network(|mut path| {
        let relations = path.create("relations", &[2, 8], Init::Zeros);
        let edges = path.create("edges", &[5, 5], Init::Zeros);
        let block = RelationBlock::new(path.sub("block"), 8, 2);
        let decoder = TransformerDecoder::new(path.sub("decoder"), 1, 8, 1, 2, Some(&relations));
        (edges, relations, block, decoder)
    });
    let x = case.input("x");
    let best = sample_best(&(edges.unsqueeze(0) + case.get("noise")), 2);
    case.check_within("best", &best, 1e-6);
    let links = best * case.get("physical");
    let graph = with_self_loops(&links);
    let reach = Reach::over(&graph, &links.gt(0.5).to_kind(Kind::Float));
    let known = block.forward(&x, &reach, &relations);
    case.check("block", &known);
    case.check_gradients(&known, &[("grad_block_edges", &edges)]);
    let out =
        decoder.forward(&case.get("previous"), &known, &reach.causal(), &mut Decoded::default());
    case.check("out", &out);
    case.check_gradients(
        &out,
        &[("grad_x", &x), ("grad_edges", &edges), ("grad_relations", &relations)],
    );
}

#[test]
fn magic() {
    let case = Case::new("magic");
    let (_, (scheduler, layers)) = case.network(|mut path| {
        let scheduler = Scheduler::new(path.sub("scheduler"), 16);
        let joined = GraphAttention::new(path.sub("joined"), 16, 2, 3, true);
        (
            scheduler,
            [("joined", joined), ("mean", GraphAttention::new(path.sub("mean"), 16, 2, 3, false))],
        )
    });
    let (f, graph) = (case.input("f"), case.input("graph"));
    let (flat, packing) = all_places(&f);
    let scores = scheduler.scores(&flat, &packing);
    case.check("scores", &scores);
    case.check_gradients(&scores, &[("grad_f_scores", &f)]);
    for (name, layer) in layers {
        let out = packing.unpack(&layer.forward(&flat, &packing, &graph));
        case.check(&format!("out_{name}"), &out);
        case.check_gradients(
            &out,
            &[(&format!("grad_f_{name}"), &f), (&format!("grad_graph_{name}"), &graph)],
        );
    }
}

#[test]
fn mixer_of_those_who_are_there() {
    let case = Case::new("mixer");
    let (_, mixer) = case.network(|path| Mixer::new(path, 5));
    let (values, state) = (case.input("values"), case.input("state"));
    let out = mixer.forward(&values, &state, &case.get("present"));
    case.check("out", &out);
    case.check_gradients(&out, &[("grad_values", &values), ("grad_state", &state)]);
}

fn dimensions(count: usize) -> Vec<ActionDimension> {
    vec![ActionDimension::named("action"); count]
}

/// One whole update of MADDPG agrees with the reference: targets, both losses, clipping, Adam and
/// the target networks. The third agent is absent before the step, the second one after it.
#[test]
fn maddpg() {
    let case = Case::new("maddpg");
    let spec = EnvSpec {
        agents: 3,
        actions: dimensions(1).into(),
        observation: features(4),
        state: features(3),
        most_heard: None,
        metrics: Vec::new(),
    };
    let mut settings = small();
    (settings.maddpg.updates, settings.ppo.average, settings.ppo.gamma) = (1, 0.0, 0.97);
    let mut learner = case.learner("maddpg", &spec, &settings, 2);

    // The buffer holds a single step, so that all transitions drawn are equal.
    let (steps, envs, agents) = (1, 1, 3);
    let sizes = Sizes {
        steps,
        envs,
        agents,
        observation: 4,
        state: 3,
        actions: 1,
        choices: 0,
        memory: 0,
        graph_noise: 0,
    };
    let numbers = |key: &str| Vec::<f32>::try_from(case.get(key).reshape([-1])).expect("numbers");
    let mut rollout = Rollout::new(sizes);
    (rollout.observation, rollout.state) = (numbers("observation"), numbers("state"));
    (rollout.action, rollout.reward, rollout.terminated) =
        (numbers("action"), numbers("reward"), numbers("ended"));
    rollout.active[..agents].copy_from_slice(&numbers("active"));
    for (place, there) in numbers("there").into_iter().enumerate() {
        rollout.comm[place * agents + place % agents] = there;
    }
    let parameters =
        UpdateParameters { learning_rate: 0.01, log_std: -1.0, entropy_coefficient: 0.0 };
    let losses = learner.update(&rollout, &parameters, Seed::new(2)).expect("finite");
    let names = ["loss/value", "loss/policy", "ppo/grad_norm_critic", "ppo/grad_norm_actor"];
    let found =
        names.map(|name| losses.iter().find(|(n, _)| *n == name).expect("reported").1 as f32);
    case.check("losses", &Tensor::from_slice(&found));
    let state = learner.state();
    for (key, _) in &case.arrays {
        let name = key.strip_prefix("after/").map(str::to_owned);
        let followed =
            || key.strip_prefix("following/").map(|name| name.replacen('/', "_target/", 1));
        if let Some(name) = name.or_else(followed) {
            let (_, found) =
                state.iter().find(|(n, _)| *n == name).unwrap_or_else(|| panic!("no {name}"));
            case.check(key, found);
        }
    }
    let (_, statistics) =
        state.iter().find(|(name, _)| name == "value_norm/statistics").expect("kept");
    case.check("statistics", statistics);
}

/// Actions and values of whole learners agree with the reference, with agents out of range, absent
/// agents, and one environment whose episode has just begun.
#[test]
fn decisions_and_values() {
    let of_icp = ["dec", "sum", "monotonic"]
        .map(|kind| ("icp", format!("icp-{kind}"), format!("value_{kind}")));
    let others =
        ["mappo", "mat_crew", "magic_crew", "commformer_crew", "im_iwol", "ex_iwol", "maddpg_iwol"];
    let others = others
        .map(|case| (case, case.trim_end_matches("_crew").replace('_', "-"), "value".to_owned()));
    for (name, method, value) in of_icp.into_iter().chain(others) {
        let mut case = Case::new(name);
        let actions = case.get("action").size()[2] as usize;
        let spec = EnvSpec {
            agents: 3,
            actions: dimensions(actions).into(),
            observation: features(4),
            state: features(3),
            most_heard: None,
            metrics: Vec::new(),
        };
        let mut settings = small();
        (settings.network.hidden, settings.iwol.message) = (16, 8);
        // Each agent listens to two of three agents.
        settings.commformer.sparsity = 0.7;
        if method != "icp-monotonic" {
            case.arrays.retain(|(key, _)| !key.starts_with("param/critic/mixer."));
        }
        let learner =
            case.learner(&method, &spec, &settings, if method == "maddpg-iwol" { 2 } else { 1 });
        let nothing = || Tensor::zeros([3, 3, 0], (Kind::Float, Device::Cpu));
        let remembers = learner.memory() > 0;
        let input = Observation {
            observation: case.get("observation"),
            comm: case.get("comm"),
            start: case.get("start").unsqueeze(-1).expand([3, 3], false),
            memory: if remembers { case.get("memory") } else { nothing() },
            disturbance: nothing(),
            available: nothing(),
        };
        let present = case.get("present");
        let check = |key: &str, found: &Tensor| {
            let there =
                if found.dim() == 3 { present.unsqueeze(-1) } else { present.shallow_clone() };
            let expected = case.get(key);
            assert_eq!(found.size(), expected.size(), "{method}: {key}");
            let difference = (found - expected) * there;
            let worst = difference.abs().max().double_value(&[]);
            assert!(worst < TOLERANCE, "{method}: {key} is off by {worst}");
        };
        let decision = learner.act(&input, &ActMode::Deterministic);
        check("action", &decision.action);
        if remembers {
            check("memory_after", &decision.memory);
        }
        check(
            &value,
            &learner
                .inspect(&input, &case.get("state"))
                .value
                .expect("without a memory of its own"),
        );
    }
}

#[test]
fn gaussian() {
    let case = Case::new("gaussian");
    let (mean, log_std) = (case.input("mean"), case.input("log_std"));
    let log_prob = gaussian_log_prob(&mean, &log_std, &case.get("action"));
    let log_prob = log_prob.sum_dim_intlist(-1, false, Kind::Float);
    let entropy = gaussian_entropy(&log_std);
    case.check("log_prob", &log_prob);
    case.check("entropy", &entropy.expand([6], false));
    case.check_gradients(
        &(log_prob + entropy),
        &[("grad_mean", &mean), ("grad_log_std", &log_std)],
    );
}

/// Discrete actions of which some are not open.
#[test]
fn categorical() {
    let case = Case::new("categorical");
    let logits = case.input("logits");
    let log_probs = categorical_log_probs(&logits, &case.get("available"));
    let choice = case.get("choice").to_kind(Kind::Int64).unsqueeze(-1);
    let log_prob = log_probs.gather(-1, &choice, false).squeeze_dim(-1);
    let entropy = categorical_entropy(&log_probs);
    case.check("log_prob", &log_prob);
    case.check("entropy", &entropy);
    case.check_gradients(&(log_prob + entropy), &[("grad_logits", &logits)]);
}

/// Value normalisation agrees with the reference; its `f64` state agrees to 1e-12.
#[test]
fn value_norm() {
    let case = Case::new("value_norm");
    let (batches, states, probe) = (case.get("batches"), case.get("states"), case.get("probe"));
    let mut norm = ValueNorm::default();
    let (mut normalized, mut denormalized) = (Vec::new(), Vec::new());
    for i in 0..batches.size()[0] {
        norm.update(&batches.get(i));
        for (j, value) in norm.state().into_iter().enumerate() {
            let expected = states.double_value(&[i, j as i64]);
            assert!(
                (value - expected).abs() <= 1e-12 * expected.abs(),
                "state {j} after batch {i}: {value}, {expected}"
            );
        }
        normalized.push(norm.normalize(&probe));
        denormalized.push(norm.denormalize(&probe));
    }
    case.check("normalized", &Tensor::stack(&normalized, 0));
    case.check("denormalized", &Tensor::stack(&denormalized, 0));
}

/// Five clipped steps of Adam with a falling learning rate agree with the reference.
#[test]
fn adam_with_clipping() {
    let case = Case::new("adam");
    let (mut params, mlp) = case.network(|path| Mlp::new(path, 4, 12));
    let mut adam = Adam::new(&mut params);
    let (x, y, norms) = (case.get("x"), case.get("y"), case.get("norms"));
    // The reference's modules have the order of the Rust ones: input norm, then linear and norm of
    // each layer.
    let flat = |tensors: Vec<Tensor>| {
        Tensor::cat(&tensors.iter().map(|t| t.detach().reshape([-1])).collect::<Vec<_>>(), 0)
    };
    for step in 0..5 {
        (mlp.forward(&x) - &y).square().mean(Kind::Float).backward();
        let norm = adam.clip_grad_norm(1.2);
        assert!(
            (norm - norms.double_value(&[step])).abs() < 1e-5,
            "norm before clipping at step {step}: {norm}"
        );
        adam.step(0.02 / (step + 1) as f64);
        let weights = flat(params.named().iter().map(|(_, t)| t.shallow_clone()).collect());
        case.check(&format!("flat_{step}"), &weights);
    }
    let state = adam.state();
    for (suffix, key) in [(".m", "first"), (".v", "second")] {
        let moments = state
            .iter()
            .filter(|(name, _)| name.ends_with(suffix))
            .map(|(_, t)| t.shallow_clone())
            .collect();
        case.check_within(key, &flat(moments), 1e-6);
    }
}

#[test]
fn ppo_losses() {
    let case = Case::new("ppo");
    let active = case.get("active");
    let log_prob = case.input("log_prob");
    let (new, old) = (log_prob.unsqueeze(-1), case.get("old_log_prob").unsqueeze(-1));
    let policy = ppo::policy_loss(&new, &old, &case.get("advantage"), &active);
    case.check("policy_loss", &policy);
    case.check("grad_log_prob", &Tensor::run_backward(&[policy], &[&log_prob], false, false)[0]);

    let value = case.input("value");
    let loss = ppo::value_loss(&value, &case.get("old_value"), &case.get("target"), &active);
    case.check("value_loss", &loss);
    case.check("grad_value", &Tensor::run_backward(&[loss], &[&value], false, false)[0]);
}
