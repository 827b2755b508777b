//! Replayed steps: the last rollouts, of which steps are drawn at random.

use tch::{Device, Kind, Tensor, no_grad};

use crate::nn;
use crate::rng::{self, Rng};
use crate::rollout::{Rollout, Sizes};

/// The last rollouts.
pub(super) struct Replay {
    device: Device,
    /// Most rollouts that are kept.
    capacity: i64,
    /// Rollouts so far.
    stored: i64,
    sizes: Option<Sizes>,
    /// Per array of [`NAMES`], `[capacity, (T + 1) · E, N, width]`.
    arrays: Vec<Tensor>,
}

/// What is kept of each row.
const NAMES: [&str; 7] = ["observation", "state", "comm", "action", "reward", "active", "ended"];

/// Steps that were drawn, `R` rows of all N agents.
pub(super) struct Transitions {
    /// Before the step.
    pub(super) before: View,
    /// After it.
    pub(super) after: View,
    /// `[R, N, A]`, as the environment took them.
    pub(super) action: Tensor,
    /// `[R, N]`
    pub(super) reward: Tensor,
    /// 1 where an agent acted, `[R, N]`.
    pub(super) active: Tensor,
    /// 1 where its trajectory ended for good, `[R, N]`.
    pub(super) ended: Tensor,
}

/// What is seen at a time.
pub(super) struct View {
    /// `[R, N, O]`
    pub(super) observation: Tensor,
    /// `[R, N, S]`
    pub(super) state: Tensor,
    /// `[R, N, N]`
    pub(super) comm: Tensor,
}

impl Replay {
    /// Keeps up to `capacity` rollouts.
    pub(super) fn new(capacity: usize, device: Device) -> Self {
        Self { device, capacity: capacity as i64, stored: 0, sizes: None, arrays: Vec::new() }
    }

    /// Takes a rollout in, in place of the oldest if there is no room.
    pub(super) fn add(&mut self, rollout: &Rollout) {
        let s = rollout.sizes;
        self.prepare(s);
        let (rows, n) = (((s.steps + 1) * s.envs) as i64, s.agents as i64);
        let arrays: [&[f32]; 7] = [
            &rollout.observation,
            &rollout.state,
            &rollout.comm,
            &rollout.action,
            &rollout.reward,
            &rollout.active,
            &rollout.terminated,
        ];
        for (to, from) in self.arrays.iter().zip(arrays) {
            let from = Tensor::from_slice(from).view([-1, n, to.size()[3]]).to_device(self.device);
            // The last row was not acted upon.
            let count = from.size()[0].min(rows);
            no_grad(|| to.get(self.stored % self.capacity).narrow(0, 0, count).copy_(&from));
        }
        self.stored += 1;
    }

    fn prepare(&mut self, sizes: Sizes) {
        if self.sizes == Some(sizes) {
            return;
        }
        let rows = ((sizes.steps + 1) * sizes.envs) as i64;
        let widths = [sizes.observation, sizes.state, sizes.agents, sizes.actions, 1, 1, 1];
        let array = |width: usize| {
            Tensor::zeros([self.capacity, rows, sizes.agents as i64, width as i64], (Kind::Float, self.device))
        };
        (self.arrays, self.sizes, self.stored) = (widths.map(array).into(), Some(sizes), 0);
    }

    /// Draws `count` steps, with replacement.
    pub(super) fn draw(&self, count: usize, rng: &mut Rng) -> Transitions {
        let s = self.sizes.expect("something is stored");
        let (steps, rows, kept) = (s.steps * s.envs, (s.steps + 1) * s.envs, self.stored.min(self.capacity) as usize);
        let row = |_| (rng::below(rng, kept) * rows + rng::below(rng, steps)) as i64;
        let before: Vec<i64> = (0..count).map(row).collect();
        let before = Tensor::from_slice(&before).to_device(self.device);
        let after = &before + s.envs as i64;
        let take = |array: usize, rows: &Tensor| self.arrays[array].flatten(0, 1).index_select(0, rows);
        let view = |rows: &Tensor| View { observation: take(0, rows), state: take(1, rows), comm: take(2, rows) };
        let one = |array: usize| take(array, &before).squeeze_dim(-1);
        Transitions {
            before: view(&before),
            after: view(&after),
            action: take(3, &before).clamp(-1.0, 1.0),
            reward: one(4),
            active: one(5),
            ended: one(6),
        }
    }

    /// For a checkpoint.
    pub(super) fn state(&self) -> Vec<(String, Tensor)> {
        let Some(s) = self.sizes else {
            return Vec::new();
        };
        let kept = self.stored.min(self.capacity);
        let sizes =
            [s.steps, s.envs, s.agents, s.observation, s.state, s.actions, s.memory, s.graphs].map(|x| x as i64);
        let counts: Vec<i64> = [self.stored].into_iter().chain(sizes).collect();
        let arrays = NAMES.iter().zip(&self.arrays).map(|(name, array)| ((*name).to_owned(), array.narrow(0, 0, kept)));
        arrays.chain([("counts".to_owned(), Tensor::from_slice(&counts))]).collect()
    }

    /// Takes over what [`Replay::state`] gave, of as many rollouts at most.
    ///
    /// # Errors
    /// [`nn::Error`] when it is of another shape.
    pub(super) fn load(&mut self, state: &[(String, Tensor)]) -> Result<(), nn::Error> {
        let Some((_, counts)) = state.iter().find(|(name, _)| name == "counts") else {
            (self.sizes, self.stored) = (None, 0);
            return Ok(());
        };
        let counts = Vec::<i64>::try_from(counts).unwrap_or_default();
        let [stored, ref sizes @ ..] = counts[..] else {
            return Err(nn::Error::Missing { name: "replay_memory/counts".to_owned() });
        };
        let &[steps, envs, agents, observation, width, actions, memory, graphs] = sizes else {
            return Err(nn::Error::Missing { name: "replay_memory/counts".to_owned() });
        };
        let size = |x: i64| x.max(0) as usize;
        self.prepare(Sizes {
            steps: size(steps),
            envs: size(envs),
            agents: size(agents),
            observation: size(observation),
            state: size(width),
            actions: size(actions),
            memory: size(memory),
            graphs: size(graphs),
        });
        let kept = stored.clamp(0, self.capacity);
        let own: Vec<(String, Tensor)> = NAMES
            .iter()
            .zip(&self.arrays)
            .map(|(name, array)| ((*name).to_owned(), array.narrow(0, 0, kept)))
            .collect();
        let given: Vec<_> =
            state.iter().filter(|(name, _)| name != "counts").map(|(n, t)| (n.clone(), t.shallow_clone())).collect();
        nn::copy_named(&own, &given)?;
        self.stored = stored;
        Ok(())
    }
}
