//! The replay buffer: the last rollouts, from which steps are drawn at random.

use tch::{Device, Kind, Tensor, no_grad};

use crate::algo::Observation;
use crate::nn;
use crate::rng::{self, Rng};
use crate::rollout::{Rollout, Sizes};

/// A buffer of the last rollouts.
pub(super) struct ReplayBuffer {
    device: Device,
    /// Largest number of rollouts that are kept.
    capacity: i64,
    /// Number of rollouts stored so far, including those that were overwritten.
    stored: i64,
    sizes: Option<Sizes>,
    /// One tensor per array of [`NAMES`], `[capacity, (T + 1) · E, N, width]`.
    arrays: Vec<Tensor>,
}

/// Names of the arrays that are stored for each row.
const NAMES: [&str; 7] = ["observation", "state", "comm", "action", "reward", "active", "ended"];

/// Sampled transitions: `R` rows of all N agents, each over up to n steps.
pub(super) struct Transitions {
    /// View before the first step.
    pub(super) before: View,
    /// View after n steps, or earlier: where the rollout ended, where trajectories were truncated,
    /// or where the last agent's trajectory ended.
    pub(super) after: View,
    /// Actions of the first step as the environment took them, `[R, N, A]`.
    pub(super) action: Tensor,
    /// Discounted sum of the rewards of these steps, `[R, N]`.
    pub(super) reward: Tensor,
    /// 1 where an agent acted in the first step, `[R, N]`.
    pub(super) active: Tensor,
    /// Factor on the value of `after`; 0 where the agent's trajectory ended for good, `[R, N]`.
    pub(super) discount: Tensor,
}

/// The arrays that the critic reads at one step.
pub(super) struct View {
    /// Observations, `[R, N, O]`.
    pub(super) observation: Tensor,
    /// Privileged states, `[R, N, S]`.
    pub(super) state: Tensor,
    /// Physical masks, `[R, N, N]`.
    pub(super) comm: Tensor,
}

impl View {
    /// Returns the view of one decision, with the privileged `state`.
    pub(super) fn of(input: &Observation, state: &Tensor) -> Self {
        Self {
            observation: input.observation.shallow_clone(),
            state: state.shallow_clone(),
            comm: input.comm.shallow_clone(),
        }
    }
}

impl ReplayBuffer {
    /// Creates a buffer that keeps up to `capacity` rollouts.
    pub(super) fn new(capacity: usize, device: Device) -> Self {
        Self { device, capacity: capacity as i64, stored: 0, sizes: None, arrays: Vec::new() }
    }

    /// Stores a rollout, in place of the oldest one if the buffer is full.
    pub(super) fn add(&mut self, rollout: &Rollout) {
        let s = rollout.sizes;
        self.prepare(s);
        let (rows, n) = (((s.steps + 1) * s.envs) as i64, s.agents as i64);
        let rewards = rollout.rewards_with_penalties();
        let ended: Vec<f32> =
            (0..rewards.len()).map(|i| f32::from(u8::from(rollout.ends(i)))).collect();
        let arrays: [&[f32]; 7] = [
            &rollout.observation,
            &rollout.state,
            &rollout.comm,
            &rollout.action,
            &rewards,
            &rollout.active,
            &ended,
        ];
        for (to, from) in self.arrays.iter().zip(arrays) {
            let from = Tensor::from_slice(from).view([-1, n, to.size()[3]]).to_device(self.device);
            // Actions, rewards and ends have no closing row, in which no agent acts.
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
            Tensor::zeros(
                [self.capacity, rows, sizes.agents as i64, width as i64],
                (Kind::Float, self.device),
            )
        };
        (self.arrays, self.sizes, self.stored) = (widths.map(array).into(), Some(sizes), 0);
    }

    /// Draws `count` transitions, with replacement, each over up to `following` steps with discount
    /// `gamma`.
    pub(super) fn draw(
        &self,
        count: usize,
        following: usize,
        gamma: f64,
        rng: &mut Rng,
    ) -> Transitions {
        let s = self.sizes.expect("something is stored");
        let (steps, rows, kept) =
            (s.steps * s.envs, (s.steps + 1) * s.envs, self.stored.min(self.capacity) as usize);
        let drawn: Vec<[i64; 2]> = (0..count)
            .map(|_| (rng::below(rng, kept) * rows, rng::below(rng, steps)))
            .map(|(rollout, row)| [(rollout + row) as i64, (s.steps - row / s.envs) as i64])
            .collect();
        let part = |k: usize| {
            let values: Vec<i64> = drawn.iter().map(|pair| pair[k]).collect();
            Tensor::from_slice(&values).to_device(self.device)
        };
        let (before, left) = (part(0), part(1));
        let take =
            |array: usize, rows: &Tensor| self.arrays[array].flatten(0, 1).index_select(0, rows);
        let view = |rows: &Tensor| View {
            observation: take(0, rows),
            state: take(1, rows),
            comm: take(2, rows),
        };
        let one = |array: usize, rows: &Tensor| take(array, rows).squeeze_dim(-1);
        let active = one(5, &before);
        let mut after = before.copy();
        let (mut going, mut discount, mut reward) =
            (active.copy(), active.copy(), active.zeros_like());
        for step in 0..following.min(s.steps) as i64 {
            let rows = &before + (left.clamp_max(step + 1) - 1) * s.envs as i64;
            let acts = &going * one(5, &rows) * left.gt(step).unsqueeze(-1);
            // An agent whose trajectory goes on but who does not act was truncated. The transitions
            // of all agents end at that row.
            let acts = &acts * (&going - &acts).amax([-1], true).le(0.0);
            reward += &discount * &acts * one(4, &rows);
            after += acts.amax([-1], false).gt(0.0).to_kind(Kind::Int64) * s.envs as i64;
            let lasts = 1.0 - one(6, &rows);
            discount *= 1.0 - &acts * (1.0 - gamma * &lasts);
            going = acts * lasts;
        }
        let (after, action) = (view(&after), take(3, &before).clamp(-1.0, 1.0));
        Transitions { before: view(&before), after, action, reward, active, discount }
    }

    /// Returns the state for a checkpoint.
    pub(super) fn state(&self) -> Vec<(String, Tensor)> {
        let Some(s) = self.sizes else {
            return Vec::new();
        };
        let kept = self.stored.min(self.capacity);
        let sizes =
            [s.steps, s.envs, s.agents, s.observation, s.state, s.actions, s.memory, s.graph_noise]
                .map(|x| x as i64);
        let counts: Vec<i64> = [self.stored].into_iter().chain(sizes).collect();
        let arrays = NAMES
            .iter()
            .zip(&self.arrays)
            .map(|(name, array)| ((*name).to_owned(), array.narrow(0, 0, kept)));
        arrays.chain([("counts".to_owned(), Tensor::from_slice(&counts))]).collect()
    }

    /// Loads a state that [`ReplayBuffer::state`] returned. If it holds more rollouts than have room, the
    /// newest are kept.
    ///
    /// # Errors
    /// [`nn::Error`] when the state has another shape.
    pub(super) fn load(&mut self, state: &[(String, Tensor)]) -> Result<(), nn::Error> {
        let Some((_, counts)) = state.iter().find(|(name, _)| name == "counts") else {
            (self.sizes, self.stored) = (None, 0);
            return Ok(());
        };
        let counts = Vec::<i64>::try_from(counts).unwrap_or_default();
        let [stored, ref sizes @ ..] = counts[..] else {
            return Err(nn::Error::Missing { name: "replay_memory/counts".to_owned() });
        };
        let &[steps, envs, agents, observation, width, actions, memory, graph_noise] = sizes else {
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
            // The method is for continuous actions.
            choices: 0,
            memory: size(memory),
            graph_noise: size(graph_noise),
        });
        // The state holds all rollouts stored before, or as many as had room. In a full buffer the
        // number stored tells which one is the oldest.
        let rows = |array: &Tensor| array.size().first().copied().unwrap_or(0);
        let had =
            state.iter().find(|(name, _)| name == NAMES[0]).map_or(0, |(_, array)| rows(array));
        let full = had < stored;
        let same = if full { had == self.capacity } else { had <= self.capacity };
        let kept = had.min(self.capacity);
        let newest = |array: &Tensor| {
            if same || rows(array) != had {
                return array.shallow_clone();
            }
            let oldest = if full { stored % had } else { 0 };
            array.roll([-oldest], [0]).narrow(0, had - kept, kept)
        };
        let given: Vec<_> = state
            .iter()
            .filter(|(name, _)| name != "counts")
            .map(|(n, t)| (n.clone(), newest(t)))
            .collect();
        let own: Vec<(String, Tensor)> = NAMES
            .iter()
            .zip(&self.arrays)
            .map(|(name, array)| ((*name).to_owned(), array.narrow(0, 0, kept)))
            .collect();
        nn::copy_named(&own, &given)?;
        self.stored = if same { stored } else { kept };
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::rng::Seed;

    const STEPS: usize = 12;
    const ENVS: usize = 2;
    const AGENTS: usize = 3;

    /// Returns a rollout of episodes that end one agent after another or are truncated for all
    /// agents. Every observation is the number of its row.
    fn rollout(events: &[u8]) -> Rollout {
        let sizes = Sizes {
            steps: STEPS,
            envs: ENVS,
            agents: AGENTS,
            observation: 1,
            state: 1,
            actions: 1,
            choices: 0,
            memory: 0,
            graph_noise: 0,
        };
        let mut rollout = Rollout::new(sizes);
        for env in 0..ENVS {
            let mut there = [true; AGENTS];
            for t in 0..=STEPS {
                let row = t * ENVS + env;
                // After all agents have ended, there is one row in which no agent acts.
                let begins = !there.contains(&true)
                    && t > 0
                    && rollout.active[(row - ENVS) * AGENTS..][..AGENTS].iter().all(|a| *a == 0.0);
                there = if begins { [true; AGENTS] } else { there };
                let cut = events[row % events.len()] == 0;
                if t < STEPS {
                    rollout.interrupted[row] = f32::from(u8::from(cut && row.is_multiple_of(2)));
                }
                for (i, there) in there.iter_mut().enumerate() {
                    let k = row * AGENTS + i;
                    rollout.observation[k] = row as f32;
                    rollout.active[k] = f32::from(u8::from(*there));
                    if t < STEPS {
                        rollout.reward[k] = f32::from(events[(7 * k) % events.len()]) + i as f32;
                        let dies = events[k % events.len()] % 4 == 1;
                        rollout.terminated[k] = f32::from(u8::from(*there && dies && !cut));
                        rollout.truncated[k] = f32::from(u8::from(*there && cut));
                        *there &= !cut && !dies;
                    }
                }
            }
        }
        rollout
    }

    /// Returns the first reward of each rollout that is kept, sorted.
    fn kept(replay: &ReplayBuffer) -> Vec<f64> {
        let count = replay.stored.min(replay.capacity);
        let mut rewards =
            Vec::<f64>::try_from(replay.arrays[4].narrow(0, 0, count).amax([1, 2, 3], false))
                .unwrap();
        rewards.sort_by(f64::total_cmp);
        rewards
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        /// A buffer that is loaded with another capacity keeps the newest rollouts and overwrites
        /// the oldest first.
        #[test]
        fn the_newest_move_into_another_size(had in 0usize..9, before in 1usize..5, after in 1usize..7, more in 0usize..6) {
            let numbered = |k: usize| {
                let mut rollout = rollout(&[0; 72]);
                rollout.reward.fill(k as f32);
                rollout
            };
            let (mut one, mut other) = (ReplayBuffer::new(before, Device::Cpu), ReplayBuffer::new(after, Device::Cpu));
            (0..had).for_each(|k| one.add(&numbered(k)));
            other.load(&one.state()).unwrap();
            (had..had + more).for_each(|k| other.add(&numbered(k)));
            if had + more > 0 {
                let count = after.min(had.min(before).min(after) + more);
                let expected: Vec<f64> = (had + more - count..had + more).map(|k| k as f64).collect();
                prop_assert_eq!(kept(&other), expected);
            }
        }

        /// Rewards and discounts of drawn transitions are those of a walk from the step on, agent
        /// by agent.
        #[test]
        fn rewards_count_until_the_end_or_the_cut(events in prop::collection::vec(0u8..24, 72..100), n in 1usize..6, draw in 0u64..1000) {
            const GAMMA: f64 = 0.9;
            let rollout = rollout(&events);
            let mut replay = ReplayBuffer::new(2, Device::Cpu);
            replay.add(&rollout);
            let steps = replay.draw(40, n, GAMMA, &mut Seed::new(draw).rng());
            let numbers = |x: &Tensor| Vec::<f32>::try_from(x.flatten(0, -1)).expect("numbers");
            let (first, last) = (numbers(&steps.before.observation), numbers(&steps.after.observation));
            let (reward, discount, active) = (numbers(&steps.reward), numbers(&steps.discount), numbers(&steps.active));
            for (k, row) in first.iter().enumerate().map(|(k, row)| (k, *row as usize)) {
                let (mut at, mut sum, mut weight) = (row, 0.0, f64::from(rollout.active[row * AGENTS + k % AGENTS]));
                prop_assert_eq!(f64::from(active[k]), weight);
                for _ in 0..n {
                    let cell = at * AGENTS + k % AGENTS;
                    // The agent was truncated in the step before, or the rollout is over.
                    if weight == 0.0 || at >= STEPS * ENVS || rollout.active[cell] == 0.0 {
                        break;
                    }
                    sum += weight * f64::from(rollout.reward[cell]);
                    weight *= if rollout.ends(cell) { 0.0 } else { GAMMA };
                    at += ENVS;
                }
                prop_assert!((f64::from(reward[k]) - sum).abs() < 1e-4, "{} {}", reward[k], sum);
                prop_assert!((f64::from(discount[k]) - weight).abs() < 1e-6, "{} {}", discount[k], weight);
                if weight > 0.0 {
                    prop_assert_eq!(last[k] as usize, at, "the row whose value counts");
                }
            }
        }
    }
}
