"""PPO of Stable-Baselines3 with one policy for all vehicles, through SuperSuit.

    pip install ./python_bridge supersuit stable-baselines3   # in a clone of the repository
    python sb3.py 100000

Stable-Baselines3 knows no masks: vehicles that have arrived or crashed show zeros, and it learns from those zeros too.
mappo.py has masks, and is the better start for results.
"""

import sys

import supersuit
import torch
from stable_baselines3 import PPO

import iwol_sumo


def main(steps: int = 20_000) -> PPO:
    torch.set_num_threads(1)
    env = iwol_sumo.parallel_env("intersection", agents=8)
    # Agents that are gone stay in the dictionaries, with zeros: SuperSuit's vectors are of a fixed size.
    env = supersuit.black_death_v3(env)
    env = supersuit.pettingzoo_env_to_vec_env_v1(env)
    env = supersuit.concat_vec_envs_v1(env, 1, base_class="stable_baselines3")
    try:
        model = PPO("MlpPolicy", env, n_steps=128, batch_size=256, verbose=1)
        return model.learn(steps)
    finally:
        env.close()


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
