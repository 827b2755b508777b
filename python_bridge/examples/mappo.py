"""MAPPO in one file of PyTorch, on many worlds at a time.

It trains vehicles to cross the straight intersection, and is an independent check of the Rust learner, written from
the papers' formulas. Sizes of networks and batches, and coefficients, are those of the Rust learner, but the discount is
0.99 instead of 0.9925, and noise begins at 0.6 instead of 1.

    pip install "./python_bridge[sumo,torch]"   # in a clone of the repository
    python mappo.py --agents 8 --seed 0

Sources: PPO, Schulman et al. 2017 (clipped objective, GAE); MAPPO, Yu et al. 2022 (shared parameters, a value function of
privileged state, value normalisation).
"""

import argparse
import copy
import time

import numpy as np
import torch
from torch import nn

import iwol_sumo

ENVS, STEPS, EPOCHS, MINIBATCHES = 16, 128, 5, 8
GAMMA, LAMBDA, CLIP, ENTROPY, COOPERATION = 0.99, 0.95, 0.2, 0.0, 0.06
LEARNING_RATE, MAX_GRADIENT = 7e-4, 0.5
# Validations use the average of the policy's weights over about ten updates, which fluctuates less.
AVERAGE = 0.9
# Standard deviation of the exploration noise: constant for a share of the steps, then falling for another.
NOISE, LAST_NOISE, EXPLORE, ANNEAL = 0.6, 0.14, 0.36, 0.43


def network(inputs, outputs, hidden=128):
    return nn.Sequential(
        nn.LayerNorm(inputs),
        nn.Linear(inputs, hidden), nn.ReLU(), nn.LayerNorm(hidden),
        nn.Linear(hidden, hidden), nn.ReLU(), nn.LayerNorm(hidden),
        nn.Linear(hidden, outputs),
    )  # fmt: skip


def policy_of(actor):
    """Returns the trained policy for `iwol_sumo.evaluate`: the mean action."""

    def mappo(observation, comm, active, start):
        with torch.no_grad():
            return actor(torch.from_numpy(observation)).clamp(-1, 1).numpy()

    return mappo


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default="intersection")
    parser.add_argument("--agents", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--steps", type=int, default=280_000, help="steps of a world, over all worlds")
    parser.add_argument("--validate", type=int, default=40_000, help="steps between validations")
    options = parser.parse_args()
    # The networks are small: more threads would wait for each other.
    torch.set_num_threads(2)
    torch.manual_seed(options.seed)
    env = iwol_sumo.vec_env(options.scenario, ENVS, options.agents, seed=1000 + options.seed)
    n, o, s, a = env.agents, len(env.features), len(env.state_features), len(env.actions)
    actor, critic = network(o, a), network(s, 1)
    with torch.no_grad():
        # Untrained vehicles drive: brakes are stronger than engines.
        actor[-1].weight.mul_(0.01)
        actor[-1].bias.fill_(0.5)
    average = copy.deepcopy(actor)
    parameters = [*actor.parameters(), *critic.parameters()]
    optimiser = torch.optim.Adam(parameters, lr=LEARNING_RATE, eps=1e-5)
    scale = 10.0  # Size of returns, so that the critic learns numbers near 1.

    rollout = iwol_sumo.Frame(*(np.zeros((STEPS + 1, *x.shape), x.dtype) for x in env.reset()))
    row = lambda t: iwol_sumo.Frame(*(array[t] for array in rollout))
    for array, first in zip(rollout, env.reset()):
        array[0] = first
    actions = np.zeros((STEPS, ENVS, n, a), np.float32)
    steps, validated, solved, began = 0, 0, 0, time.time()
    while steps < options.steps:
        fraction = min(max(steps / options.steps - EXPLORE, 0) / ANNEAL, 1.0)
        noise = NOISE * (LAST_NOISE / NOISE) ** fraction
        rate = LEARNING_RATE * (1.0 - 0.98 * fraction)
        for group in optimiser.param_groups:
            group["lr"] = rate
        means = np.zeros_like(actions)
        for t in range(STEPS):
            with torch.no_grad():
                means[t] = actor(torch.from_numpy(rollout.observation[t])).numpy()
            actions[t] = means[t] + noise * torch.randn(means[t].shape).numpy()
            env.step(actions[t], out=row(t + 1))
        steps += STEPS * ENVS

        # A sample counts where the agent was active before the step; its flags are those of the step's result.
        with torch.no_grad():
            values = critic(torch.from_numpy(rollout.state)).squeeze(-1).numpy() * scale
        advantage, chain = np.zeros((STEPS, ENVS, n), np.float32), np.zeros((ENVS, n), np.float32)
        for t in reversed(range(STEPS)):
            ended = rollout.terminated[t + 1] | rollout.truncated[t + 1]
            # The horizon is a deadline: nothing comes after it.
            following = np.where(ended, 0.0, values[t + 1])
            chain = np.where(ended, 0.0, chain)
            chain = rollout.reward[t + 1] + GAMMA * following - values[t] + GAMMA * LAMBDA * chain
            chain = np.where(rollout.active[t], chain, 0.0).astype(np.float32)
            advantage[t] = chain
        returns = advantage + values[:-1]
        # Each agent also counts what its actions do to the others.
        others = advantage.sum(-1, keepdims=True) - advantage
        advantage = np.where(rollout.active[:-1], advantage + COOPERATION * others, 0.0)

        keep = torch.from_numpy(rollout.active[:-1].reshape(-1)).nonzero().squeeze(-1)
        flat = lambda array: torch.from_numpy(np.ascontiguousarray(array)).flatten(0, 2).float()[keep]
        observation, state, action = flat(rollout.observation[:-1]), flat(rollout.state[:-1]), flat(actions)
        old, target, gain = flat(means), flat(returns) / scale, flat(advantage)
        gain = (gain - gain.mean()) / (gain.std() + 1e-8)
        log_old = -((action - old) ** 2).sum(-1) / (2 * noise**2)
        for _ in range(EPOCHS):
            for part in torch.randperm(len(keep)).chunk(MINIBATCHES):
                mean = actor(observation[part])
                ratio = (-((action[part] - mean) ** 2).sum(-1) / (2 * noise**2) - log_old[part]).exp()
                clipped = ratio.clamp(1 - CLIP, 1 + CLIP)
                policy_loss = -torch.minimum(ratio * gain[part], clipped * gain[part]).mean()
                value_loss = nn.functional.huber_loss(critic(state[part]).squeeze(-1), target[part])
                # Actions are clipped at -1 and 1; means beyond are pulled back.
                bounds = (mean.abs() - 1).clamp(min=0).square().sum(-1).mean()
                optimiser.zero_grad()
                (policy_loss + value_loss + 0.1 * bounds).backward()
                nn.utils.clip_grad_norm_(parameters, MAX_GRADIENT)
                optimiser.step()
        with torch.no_grad():
            for mean, weight in zip(average.parameters(), actor.parameters()):
                mean.lerp_(weight, 1 - AVERAGE)
        for array in rollout:
            array[0] = array[-1]

        if steps - validated >= options.validate or steps >= options.steps:
            validated = steps
            metrics = iwol_sumo.evaluate(policy_of(average), options.scenario, n, episodes=32, seed=7)["metrics"]
            success = 100 * metrics["success"]["mean"]
            print(f"{steps:8d} steps  {time.time() - began:5.0f} s  success {success:5.1f} %", flush=True)
            solved = solved + 1 if success >= 99.5 else 0
            if solved == 4 and fraction == 1.0:
                break
    result = iwol_sumo.evaluate(policy_of(average), options.scenario, n, episodes=100, seed=11)["metrics"]
    mean, low, high = (100 * result["success"][key] for key in ("mean", "low", "high"))
    print(f"success on 100 unseen episodes: {mean:.1f} [{low:.1f}, {high:.1f}] %")
    env.close()


if __name__ == "__main__":
    main()
