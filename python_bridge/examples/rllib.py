"""PPO of RLlib with one policy for all vehicles.

    pip install ./python_bridge "ray[rllib]" torch   # in a clone of the repository
    python rllib.py 10
"""

import sys

from gymnasium.spaces import Dict
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.rl_module import RLModuleSpec
from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
from ray.tune.registry import register_env

import iwol_sumo


class Vehicles(ParallelPettingZooEnv):
    """RLlib's wrapper knows the agents that are on the road at the reset only. Here others may come later."""

    def __init__(self, env: iwol_sumo.VehicleEnv) -> None:
        super().__init__(env)
        self.agents = self.possible_agents = list(env.possible_agents)
        self.observation_spaces, self.action_spaces = dict(env.observation_spaces), dict(env.action_spaces)
        self.observation_space, self.action_space = Dict(self.observation_spaces), Dict(self.action_spaces)


def main(iterations: int = 2, batch: int = 1000) -> dict:
    register_env("intersection", lambda _: Vehicles(iwol_sumo.parallel_env("intersection", agents=8)))
    config = (
        PPOConfig()
        .environment("intersection")
        .multi_agent(policies={"shared"}, policy_mapping_fn=lambda agent, *_, **__: "shared")
        .rl_module(rl_module_spec=RLModuleSpec())
        .env_runners(num_env_runners=0)
        .training(train_batch_size=batch, minibatch_size=128, num_epochs=2)
    )
    algorithm = config.build_algo()
    try:
        for _ in range(iterations):
            result = algorithm.train()
            print(result["env_runners"].get("episode_return_mean"))
    finally:
        algorithm.stop()
    return result


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
