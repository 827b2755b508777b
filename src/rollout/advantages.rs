//! Advantages and returns, from which agents learn, and the sharing of advantages among agents.

use super::{Rollout, Sizes};

impl Rollout {
    /// Returns whether the return of entry `i` of an array `[T, E, N]` ends there, without a value
    /// of the next observation: the trajectory terminated, or was truncated at a horizon that is a
    /// deadline. A simulation that broke off does not end a return.
    pub fn ends(&self, i: usize) -> bool {
        let deadline = !self.bootstrap_horizon && self.interrupted[i / self.sizes.agents] == 0.0;
        self.terminated[i] > 0.0 || (self.truncated[i] > 0.0 && deadline)
    }

    /// Returns advantages and returns by generalised advantage estimation, `[T, E, N]`, from values
    /// `[T + 1, E, N]` in units of the reward.
    ///
    /// A trajectory that [`ends`](Self::ends) has no future. A trajectory that is truncated
    /// otherwise is bootstrapped with the value of its last observation. Both stop the recursion.
    /// Inactive entries are zero.
    pub fn advantages(&self, values: &[f32], gamma: f64, lambda: f64) -> (Vec<f32>, Vec<f32>) {
        let width = self.sizes.envs * self.sizes.agents;
        debug_assert_eq!(values.len(), (self.sizes.steps + 1) * width);
        let mut advantage = vec![0.0; self.sizes.steps * width];
        let mut returns = vec![0.0; self.sizes.steps * width];
        let mut chain = vec![0.0_f64; width];
        for t in (0..self.sizes.steps).rev() {
            for (k, chain) in chain.iter_mut().enumerate() {
                let i = t * width + k;
                if self.active[i] == 0.0 {
                    *chain = 0.0;
                    continue;
                }
                let ends = self.ends(i);
                if ends || self.truncated[i] > 0.0 {
                    *chain = 0.0;
                }
                let next = if ends { 0.0 } else { f64::from(values[i + width]) };
                let value = f64::from(values[i]);
                *chain = f64::from(self.reward[i]) + gamma * next - value + gamma * lambda * *chain;
                advantage[i] = *chain as f32;
                returns[i] = (*chain + value) as f32;
            }
        }
        (advantage, returns)
    }

    /// Adds to each active agent's advantage those of the other active agents of its world, with
    /// the weight [`Rollout::cooperation`]. `advantage: [T, E, N]` holds the advantages of the
    /// agents' own rewards.
    ///
    /// Advantages are linear in rewards and values, so the results are the advantages of the sum of
    /// own rewards with the same weights, and this sum goes on after an agent has left. Hence no
    /// agent gains by staying: the rewards of others count for the actions that changed them, not
    /// for presence. (Neighbourhood advantages: Peng et al., CoPO, NeurIPS 2021.)
    pub fn share_advantages(&self, advantage: &mut [f32]) {
        let n = self.sizes.agents;
        if self.cooperation == 0.0 {
            return;
        }
        let mut own = vec![0.0; n];
        for (row, advantage) in advantage.chunks_mut(n).enumerate() {
            own.copy_from_slice(advantage);
            let active = &self.active[row * n..(row + 1) * n];
            let sharing = |i: usize, j: usize| {
                self.sharing.get((row * n + i) * n + j).copied().unwrap_or(1.0)
            };
            for i in (0..n).filter(|&i| active[i] > 0.0) {
                let others: f64 = (0..n)
                    .filter(|&j| j != i && active[j] > 0.0)
                    .map(|j| f64::from(sharing(i, j) * own[j]))
                    .sum();
                advantage[i] += (self.cooperation * others) as f32;
            }
        }
    }

    /// Returns each agent's own reward plus, with the weight [`Rollout::cooperation`], the
    /// penalties of the other agents of its world, `[T, E, N]`. Methods that sample single steps
    /// from a replay buffer learn from these rewards.
    ///
    /// A penalty is a negative reward of a step that terminates a trajectory. The presence of other
    /// agents never adds to an agent's reward, so no agent gains by staying.
    pub fn rewards_with_penalties(&self) -> Vec<f32> {
        let n = self.sizes.agents;
        let mut rewards = self.reward.clone();
        if self.cooperation == 0.0 {
            return rewards;
        }
        let penalty =
            |k: usize| if self.terminated[k] > 0.0 { self.reward[k].min(0.0) } else { 0.0 };
        for (k, reward) in rewards.iter_mut().enumerate() {
            let (row, i) = (k / n, k % n);
            let sharing = |j: usize| self.sharing.get(k * n + j).copied().unwrap_or(1.0);
            let others: f32 =
                (0..n).filter(|&j| j != i).map(|j| sharing(j) * penalty(row * n + j)).sum();
            *reward += self.cooperation as f32 * others;
        }
        rewards
    }

    /// Returns a rollout in which the agents of each world are one agent. It gets the sum of their
    /// rewards, acts while any of them acts, and ends with the last one, unless another agent acts
    /// in the next step: it terminates, or is truncated if an agent is truncated in that step. The
    /// result has no observations, actions or memory.
    #[must_use]
    pub fn team(&self) -> Self {
        let mut team = Self::new(Sizes {
            agents: 1,
            observation: 0,
            state: 0,
            actions: 0,
            memory: 0,
            graph_noise: 0,
            ..self.sizes
        });
        team.interrupted.clone_from(&self.interrupted);
        team.bootstrap_horizon = self.bootstrap_horizon;
        let rows = self.sizes.steps * self.sizes.envs;
        let width = self.sizes.agents;
        for (row, active) in self.active.chunks(width).enumerate() {
            let members = || {
                (0..self.sizes.agents)
                    .filter(|&i| active[i] > 0.0)
                    .map(|i| row * self.sizes.agents + i)
            };
            let any = members().next().is_some();
            team.active[row] = f32::from(u8::from(any));
            if row < rows && any {
                team.reward[row] = members().map(|i| self.reward[i]).sum();
                let next = &self.active[(row + self.sizes.envs) * width..][..width];
                let over = next.iter().all(|active| *active == 0.0)
                    && members().all(|i| self.terminated[i] > 0.0 || self.truncated[i] > 0.0);
                let cut = members().any(|i| self.truncated[i] > 0.0);
                team.terminated[row] = f32::from(u8::from(over && !cut));
                team.truncated[row] = f32::from(u8::from(over && cut));
            }
        }
        team
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn random_rollout(steps: usize, width: usize, events: &[u8], rewards: &[f32]) -> Rollout {
        let mut rollout = Rollout::new(Sizes {
            steps,
            envs: 1,
            agents: width,
            observation: 1,
            state: 1,
            actions: 1,
            choices: 0,
            memory: 0,
            graph_noise: 0,
        });
        // Each slot plays one trajectory after another and is inactive between them.
        for k in 0..width {
            let mut alive = true;
            for t in 0..=steps {
                let i = t * width + k;
                let event = events[i % events.len()];
                if !alive && event == 3 {
                    alive = true;
                }
                rollout.active[i] = f32::from(u8::from(alive));
                if t < steps {
                    // Rewards of inactive entries are arbitrary on purpose: they must not matter.
                    rollout.reward[i] = rewards[i % rewards.len()];
                    if alive && event == 1 {
                        rollout.terminated[i] = 1.0;
                        alive = false;
                    } else if alive && event == 2 {
                        rollout.truncated[i] = 1.0;
                        alive = false;
                    }
                }
            }
        }
        rollout
    }

    #[test]
    fn a_team_earns_together_and_ends_with_its_last() {
        let mut rollout = random_rollout(3, 2, &[0], &[0.0]);
        // The first agent terminates at once; the second is truncated in the last step.
        rollout.reward.copy_from_slice(&[1.0, 2.0, 9.0, 3.0, 9.0, 4.0]);
        (rollout.terminated[0], rollout.truncated[5]) = (1.0, 1.0);
        // Nobody is active in the row after an episode's end.
        for row in [2, 4, 6, 7] {
            rollout.active[row] = 0.0;
        }
        let team = rollout.team();
        assert_eq!(team.sizes.agents, 1);
        let active = [1.0, 1.0, 1.0, 0.0];
        assert_eq!((&team.reward[..], &team.active[..]), (&[3.0, 3.0, 4.0][..], &active[..]));
        assert_eq!(
            (&team.terminated[..], &team.truncated[..]),
            (&[0.0; 3][..], &[0.0, 0.0, 1.0][..])
        );
    }

    /// The team goes on where a new agent acts in the step after the last one's end.
    #[test]
    fn a_team_goes_on_with_a_newcomer() {
        let mut rollout = random_rollout(2, 2, &[0], &[0.0]);
        // The first agent acts in the first step alone, the second one from the second step on.
        rollout.active.copy_from_slice(&[1.0, 0.0, 0.0, 1.0, 0.0, 1.0]);
        rollout.reward.copy_from_slice(&[1.0, 0.0, 0.0, 5.0]);
        rollout.terminated[0] = 1.0;
        let team = rollout.team();
        assert_eq!((&team.active[..], &team.terminated[..]), (&[1.0; 3][..], &[0.0; 2][..]));
        let (_, returns) = team.advantages(&[0.0; 3], 1.0, 1.0);
        assert_eq!(returns, [6.0, 5.0]);
    }

    /// Returns are bootstrapped at the end of the rollout and where the simulation broke off, but
    /// at the horizon only if `bootstrap_horizon` is set.
    #[test]
    fn the_horizon_is_a_deadline() {
        let sizes = Sizes {
            steps: 4,
            envs: 1,
            agents: 1,
            observation: 0,
            state: 0,
            actions: 1,
            choices: 0,
            memory: 0,
            graph_noise: 0,
        };
        let standing = |truncated: f32, interrupted: f32, bootstrap_horizon: bool| {
            let mut rollout = Rollout { bootstrap_horizon, ..Rollout::new(sizes) };
            rollout.active.fill(1.0);
            (rollout.truncated[3], rollout.interrupted[3]) = (truncated, interrupted);
            rollout.advantages(&[5.0; 5], 0.9, 1.0).1
        };
        let goes_on = [0, 1, 2, 3].map(|t| 5.0 * 0.9_f32.powi(4 - t));
        let close = |found: Vec<f32>, expected: [f32; 4]| {
            found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-5)
        };
        assert!(close(standing(0.0, 0.0, false), goes_on), "far from the horizon");
        assert!(close(standing(1.0, 0.0, false), [0.0; 4]), "at the horizon");
        assert!(close(standing(1.0, 1.0, false), goes_on), "where the simulation broke off");
        assert!(close(standing(1.0, 0.0, true), goes_on), "where the setting says so");
    }

    /// Returns a rollout in which the first of several agents arrives at step `arrival` for a
    /// reward, and the other agents drive on and get a reward at every step.
    fn arriving_at(
        arrival: usize,
        steps: usize,
        agents: usize,
        reward: f32,
        others: &[f32],
    ) -> Rollout {
        let sizes = Sizes {
            steps,
            envs: 1,
            agents,
            observation: 0,
            state: 0,
            actions: 1,
            choices: 0,
            memory: 0,
            graph_noise: 0,
        };
        let mut rollout = Rollout::new(sizes);
        for t in 0..steps {
            for i in 0..agents {
                let k = t * agents + i;
                rollout.active[k] = f32::from(u8::from(i > 0 || t <= arrival));
                rollout.reward[k] = if i > 0 { others[k % others.len()] } else { 0.0 };
            }
        }
        (rollout.reward[arrival * agents], rollout.terminated[arrival * agents]) = (reward, 1.0);
        rollout
    }

    proptest! {
        /// An agent that can arrive gains nothing by waiting, whatever rewards the others get and
        /// however much of them is shared.
        #[test]
        fn nobody_gains_by_waiting(
            steps in 2usize..30,
            agents in 2usize..9,
            reward in 0.0f32..10.0,
            others in proptest::collection::vec(-2.0f32..3.0, 40),
            cooperation in 0.0f64..1.0,
            gamma in 0.9f64..1.0,
        ) {
            let of = |arrival: usize| {
                Rollout { cooperation, ..arriving_at(arrival, steps, agents, reward, &others) }
            };
            // Without values and with λ = 1, advantages equal returns.
            let shared = |rollout: &Rollout| {
                let values = vec![0.0; (steps + 1) * agents];
                let (mut advantage, _) = rollout.advantages(&values, gamma, 1.0);
                rollout.share_advantages(&mut advantage);
                f64::from(advantage[0])
            };
            let (now, last) = (shared(&of(0)), shared(&of(steps - 1)));
            let gain = f64::from(reward) * (1.0 - gamma.powi(steps as i32 - 1));
            prop_assert!((now - last - gain).abs() < 1e-3 * (1.0 + now.abs()), "{now} {last} {gain}");
            // The same holds for the rewards of single steps, as long as the agent is present.
            let earned = |rollout: &Rollout| {
                let rewards = rollout.rewards_with_penalties();
                let there = (0..steps).filter(|t| rollout.active[t * agents] > 0.0);
                there.map(|t| gamma.powi(t as i32) * f64::from(rewards[t * agents])).sum::<f64>()
            };
            prop_assert!(earned(&of(0)) >= earned(&of(steps - 1)) - 1e-4);
        }

        /// The shared part is the weighted sum of the advantages of other agents that act and are
        /// in range.
        #[test]
        fn advantages_are_shared_by_the_definition(
            agents in 1usize..6,
            numbers in proptest::collection::vec(-3.0f32..3.0, 48),
            active in proptest::collection::vec(any::<bool>(), 48),
            near in proptest::collection::vec(any::<bool>(), 240),
            limited in any::<bool>(),
            cooperation in 0.0f64..1.0,
        ) {
            let sizes =
                Sizes { steps: 4, envs: 2, agents, observation: 0, state: 0, actions: 1, choices: 0, memory: 0, graph_noise: 0 };
            let (rows, flag) = (8, |b: bool| f32::from(u8::from(b)));
            let mut rollout = Rollout { cooperation, ..Rollout::new(sizes) };
            rollout.active[..rows * agents].iter_mut().zip(&active).for_each(|(to, from)| *to = flag(*from));
            if limited {
                rollout.sharing = near[..rows * agents * agents].iter().map(|&b| flag(b)).collect();
            }
            let own: Vec<f32> = (0..rows * agents).map(|k| numbers[k] * rollout.active[k]).collect();
            let mut shared = own.clone();
            rollout.share_advantages(&mut shared);
            for k in 0..rows * agents {
                let (row, i) = (k / agents, k % agents);
                let others = (0..agents).filter(|&j| j != i && (!limited || near[k * agents + j]));
                let sum: f32 = others.map(|j| own[row * agents + j]).sum();
                let expected = if active[k] { own[k] + cooperation as f32 * sum } else { 0.0 };
                prop_assert!((shared[k] - expected).abs() < 1e-4, "{k}: {} {expected}", shared[k]);
            }
        }

        /// The penalties of other agents in range are added with their weight: their negative
        /// rewards of steps that end their trajectories.
        #[test]
        fn penalties_are_added_by_the_definition(
            agents in 1usize..6,
            numbers in proptest::collection::vec(-3.0f32..3.0, 40),
            ends in proptest::collection::vec(any::<bool>(), 40),
            near in proptest::collection::vec(any::<bool>(), 200),
            limited in any::<bool>(),
            cooperation in 0.0f64..1.0,
        ) {
            let sizes =
                Sizes { steps: 4, envs: 2, agents, observation: 0, state: 0, actions: 1, choices: 0, memory: 0, graph_noise: 0 };
            let (count, flag) = (8 * agents, |b: bool| f32::from(u8::from(b)));
            let mut rollout = Rollout { cooperation, ..Rollout::new(sizes) };
            rollout.reward.copy_from_slice(&numbers[..count]);
            rollout.terminated.iter_mut().zip(&ends).for_each(|(to, from)| *to = flag(*from));
            if limited {
                rollout.sharing = near[..count * agents].iter().map(|&b| flag(b)).collect();
            }
            let found = rollout.rewards_with_penalties();
            for (k, found) in found.iter().enumerate() {
                let mut expected = numbers[k];
                for j in 0..agents {
                    let other = k / agents * agents + j;
                    let in_range = !limited || near[k * agents + j];
                    if other != k && in_range && ends[other] && numbers[other] < 0.0 {
                        expected += cooperation as f32 * numbers[other];
                    }
                }
                prop_assert!((found - expected).abs() < 1e-4, "{k}: {found} {expected}");
            }
        }

        /// GAE equals the exponentially weighted sum of n-step advantages, each computed from its
        /// definition.
        #[test]
        fn advantages_follow_the_definition(
            steps in 1usize..14,
            width in 1usize..4,
            events in proptest::collection::vec(0u8..5, 60),
            rewards in proptest::collection::vec(-3.0f32..3.0, 60),
            values in proptest::collection::vec(-3.0f32..3.0, 60),
            breaks in proptest::collection::vec(any::<bool>(), 14),
            bootstrap in any::<bool>(),
            gamma in 0.5f64..1.0,
            lambda in 0.0f64..1.0,
        ) {
            let interrupted: Vec<f32> = breaks[..steps].iter().map(|&b| f32::from(u8::from(b))).collect();
            let rollout = Rollout {
                interrupted: interrupted.clone(),
                bootstrap_horizon: bootstrap,
                ..random_rollout(steps, width, &events, &rewards)
            };
            let values: Vec<f32> = (0..(steps + 1) * width).map(|i| values[i % values.len()]).collect();
            let (advantage, returns) = rollout.advantages(&values, gamma, lambda);
            for k in 0..width {
                for t in 0..steps {
                    let at = |t: usize| t * width + k;
                    if rollout.active[at(t)] == 0.0 {
                        prop_assert_eq!(advantage[at(t)], 0.0);
                        prop_assert_eq!(returns[at(t)], 0.0);
                        continue;
                    }
                    // The n-step advantages up to the end of the trajectory or of the rollout.
                    let mut n_step = Vec::new();
                    let mut sum = 0.0;
                    for (n, u) in (t..steps).enumerate() {
                        let discount = gamma.powi(n as i32);
                        sum += discount * f64::from(rollout.reward[at(u)]);
                        let over = rollout.terminated[at(u)] > 0.0
                            || (rollout.truncated[at(u)] > 0.0 && !bootstrap && interrupted[u] == 0.0);
                        let next = if over { 0.0 } else { f64::from(values[at(u + 1)]) };
                        n_step.push(sum + discount * gamma * next - f64::from(values[at(t)]));
                        if over || rollout.truncated[at(u)] > 0.0 {
                            break;
                        }
                    }
                    let last = n_step.len() - 1;
                    let expected: f64 = n_step.iter().enumerate().map(|(n, a)| {
                        let weight = if n == last { 1.0 } else { 1.0 - lambda };
                        weight * lambda.powi(n as i32) * a
                    }).sum();
                    prop_assert!((f64::from(advantage[at(t)]) - expected).abs() < 1e-4, "{} {}", advantage[at(t)], expected);
                    prop_assert!((returns[at(t)] - advantage[at(t)] - values[at(t)]).abs() < 1e-4);
                }
            }
        }
    }
}
