//! Properties that every learner must have. The tests use no simulator.

mod communication;
mod discrete;
mod games;
mod lists;
mod radio;
mod states;
mod updates;

use iwol_sumo::algo::settings::EncoderKind;
use iwol_sumo::algo::{self, ActMode, Algorithm, Observation, Settings, UpdateParameters};
use iwol_sumo::env::{ActionDimension, EnvSpec, Feature, Features, Group};
use iwol_sumo::rng::{self, Seed};
use iwol_sumo::rollout::{Rollout, Sizes};
use tch::{Device, Kind, Tensor};

const PACE: UpdateParameters =
    UpdateParameters { learning_rate: 7e-4, log_std: -0.2, entropy_coefficient: 0.0 };
const STILL: UpdateParameters =
    UpdateParameters { learning_rate: 0.0, log_std: 0.0, entropy_coefficient: 0.0 };
const ENCODERS: [EncoderKind; 3] = [EncoderKind::Mlp, EncoderKind::Attention, EncoderKind::Gru];

fn features(count: usize) -> Features {
    let feature =
        |i: usize| Feature { name: format!("f{i}"), unit: "1".to_owned(), low: -1.0, high: 1.0 };
    let group = |offset, width, count| Group {
        name: format!("g{offset}"),
        offset,
        width,
        count,
        presence: None,
    };
    Features {
        list: (0..count).map(feature).collect(),
        groups: vec![group(0, 1, 1), group(1, count - 1, 1)],
        normalised: true,
    }
}

fn spec(agents: usize) -> EnvSpec {
    EnvSpec {
        agents,
        actions: vec![ActionDimension::named("throttle")].into(),
        observation: features(4),
        state: features(3),
        most_heard: None,
        metrics: Vec::new(),
    }
}

fn small(encoder: EncoderKind) -> Settings {
    let mut settings = Settings::default();
    settings.network.encoder = encoder;
    settings.network.hidden = 16;
    settings.iwol.rounds = 2;
    settings.iwol.message = 12;
    settings.iwol.latent = 4;
    // Every agent may listen to every other agent.
    settings.commformer.sparsity = 1.0;
    settings.maddpg.updates = 20;
    settings.magic.lambda_world = 0.05;
    settings.commformer.lambda_world = 0.05;
    settings.ppo.minibatch = 64;
    settings.ppo.epochs = 2;
    settings
}

fn noise(seed: u64, shape: &[i64]) -> Tensor {
    let mut values = vec![0.0; shape.iter().product::<i64>() as usize];
    rng::fill_normal(&mut Seed::new(seed).rng(), &mut values);
    Tensor::from_slice(&values).view(shape)
}

fn nothing() -> Tensor {
    Tensor::zeros([0], (Kind::Float, Device::Cpu))
}

/// Returns the physical mask of `envs` worlds in which all agents are in range of each other.
fn complete(envs: i64, agents: i64) -> Tensor {
    Tensor::ones([envs, agents, agents], (Kind::Float, Device::Cpu))
}

fn observation(learner: &dyn Algorithm, x: Tensor, comm: Tensor) -> Observation {
    let (e, n, _) = x.size3().expect("[E, N, O]");
    let memory = noise(5, &[e, n, learner.memory() as i64]);
    Observation {
        observation: x,
        comm,
        start: Tensor::zeros([e, n], (Kind::Float, Device::Cpu)),
        memory,
        disturbance: nothing(),
        available: nothing(),
    }
}

/// Returns the actions when every edge of the learned graph is open.
fn act(learner: &dyn Algorithm, x: &Tensor, comm: &Tensor) -> Vec<Vec<f32>> {
    let (e, n, _) = x.size3().expect("[E, N, O]");
    let zero = Tensor::zeros([e, n, 1], (Kind::Float, Device::Cpu));
    let open = Tensor::full(
        [e, n, learner.graph_noise(n as usize) as i64],
        1e4,
        (Kind::Float, Device::Cpu),
    );
    let input = observation(learner, x.copy(), comm.copy());
    let (action, graph, carried, log_fresh) = (zero, open, nothing(), Vec::new());
    let decision = learner.act(&input, &ActMode::Sample { action, carried, graph, log_fresh });
    Vec::try_from(decision.action.view([n, 1])).expect("actions")
}

/// Builds a learner of these settings with initial weights from `seed`.
fn build(name: &str, spec: &EnvSpec, settings: &Settings, seed: u64) -> Box<dyn Algorithm> {
    algo::build(name, spec, settings, Seed::new(seed), Device::Cpu).expect("a learner")
}

/// Builds a learner with disturbed weights. New weights in the message path are close to the
/// identity (gain 0.01), so that effects through that path would be lost in rounding.
fn loud(name: &str, spec: &EnvSpec, settings: &Settings) -> Box<dyn Algorithm> {
    let mut learner = build(name, spec, settings, 1);
    let mut state = learner.state();
    for (i, (name, tensor)) in state.iter_mut().enumerate() {
        if name.starts_with("actor/") || name.starts_with("critic/") {
            *tensor = &*tensor + 0.3 * noise(100 + i as u64, &tensor.size());
        }
    }
    learner.load(&state).expect("its own state");
    learner
}

/// Returns a physical mask in which agents 0 and 1 are in range of each other, agents 2 and 3 as
/// well, no other pair is, and agent 4 is absent.
fn pairs() -> Tensor {
    let comm = Tensor::zeros([1, 5, 5], (Kind::Float, Device::Cpu));
    for (i, j) in [(0, 0), (1, 1), (2, 2), (3, 3), (0, 1), (1, 0), (2, 3), (3, 2)] {
        let _ = comm.get(0).get(i).get(j).fill_(1.0);
    }
    comm
}

/// Returns a rollout of random numbers in which agents end and their slots start new trajectories
/// later.
fn random_rollout(learner: &dyn Algorithm, agents: usize, seed: u64) -> Rollout {
    rollout_with(learner, agents, seed, false)
}

/// Returns such a rollout in which, with `newcomers`, new agents come into slots that were empty for
/// a step.
fn rollout_with(learner: &dyn Algorithm, agents: usize, seed: u64, newcomers: bool) -> Rollout {
    rollout_of(learner, 3, agents, seed, newcomers)
}

/// Returns such a rollout of this number of worlds.
fn rollout_of(
    learner: &dyn Algorithm,
    envs: usize,
    agents: usize,
    seed: u64,
    newcomers: bool,
) -> Rollout {
    let sizes = Sizes {
        steps: 16,
        envs,
        agents,
        observation: 4,
        state: 3,
        actions: 1,
        choices: 0,
        memory: learner.training_memory(),
        graph_noise: learner.graph_noise(agents),
    };
    let mut rollout = Rollout::new(sizes);
    let mut rng = Seed::new(seed).rng();
    for array in [
        &mut rollout.observation,
        &mut rollout.state,
        &mut rollout.action,
        &mut rollout.log_prob,
        &mut rollout.reward,
        &mut rollout.memory,
        &mut rollout.graph_noise,
    ] {
        rng::fill_normal(&mut rng, array);
        for x in array.iter_mut() {
            *x *= 0.5;
        }
    }
    for e in 0..sizes.envs {
        for i in 0..agents {
            let mut alive = true;
            for t in 0..=sizes.steps {
                let at = (t * sizes.envs + e) * agents + i;
                // A new episode begins in the whole environment at step 8.
                let comes = newcomers
                    && t > 0
                    && !alive
                    && rollout.active[at - sizes.envs * agents] == 0.0
                    && rng::below(&mut rng, 3) == 0;
                if t == 8 || comes {
                    alive = true;
                    rollout.start[at] = 1.0;
                }
                rollout.active[at] = f32::from(u8::from(alive));
                if t < sizes.steps && alive && (rng::below(&mut rng, 6) == 0 || t == 7) {
                    rollout.terminated[at] = 1.0;
                    alive = false;
                }
            }
        }
        for t in 0..=sizes.steps {
            let active = rollout.active[rollout.cell(t, e, 1)].to_vec();
            let cell = rollout.cell(t, e, agents);
            for (k, link) in rollout.comm[cell].iter_mut().enumerate() {
                *link = active[k / agents] * active[k % agents];
            }
        }
    }
    rollout
}

fn bits(learner: &dyn Algorithm) -> Vec<(String, Vec<u64>)> {
    let value =
        |t: &Tensor| Vec::<f64>::try_from(t.to_kind(Kind::Double).reshape([-1])).expect("numbers");
    learner
        .state()
        .iter()
        .map(|(n, t)| (n.clone(), value(t).iter().map(|v| v.to_bits()).collect()))
        .collect()
}

/// Returns one diagnostic of an update.
fn reported(losses: &[(&'static str, f64)], what: &str) -> f64 {
    losses.iter().find(|(name, _)| *name == what).expect("is reported").1
}

fn each(mut check: impl FnMut(&str, EncoderKind)) {
    for name in algo::NAMES {
        let recurrent = algo::capabilities(name).expect("known").recurrent;
        for encoder in
            ENCODERS.into_iter().filter(|encoder| recurrent || *encoder != EncoderKind::Gru)
        {
            check(name, encoder);
        }
    }
}
