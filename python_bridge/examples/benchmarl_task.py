"""A task of BenchMARL, here with its MAPPO.

    pip install ./python_bridge benchmarl   # in a clone of the repository
    python benchmarl_task.py 60000

BenchMARL does not mask vehicles that have arrived or crashed: they show zeros, act to no effect and earn nothing, and its
losses contain them. Compare its figures with each other, not with those of `iwol evaluate`.
"""

import sys
from collections.abc import Callable

import torch
from benchmarl.algorithms import MappoConfig
from benchmarl.environments.common import TaskClass
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from torchrl.data import Composite
from torchrl.envs import EnvBase
from torchrl.envs.libs.pettingzoo import PettingZooWrapper

import iwol_sumo


class DrivingTask(TaskClass):
    """A scenario of this package; its config has ``scenario`` and ``agents``."""

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: torch.device | str
    ) -> Callable[[], EnvBase]:
        def make() -> EnvBase:
            env = iwol_sumo.parallel_env(self.config["scenario"], agents=self.config["agents"])
            return PettingZooWrapper(env, done_on_any=False, seed=seed, device=device)

        return make

    def supports_continuous_actions(self) -> bool:
        return True

    def supports_discrete_actions(self) -> bool:
        return False

    def has_render(self, env: EnvBase) -> bool:
        return False

    def max_steps(self, env: EnvBase) -> int:
        return 1000

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        return env.group_map

    def observation_spec(self, env: EnvBase) -> Composite:
        return self._part(env, "observation")

    def info_spec(self, env: EnvBase) -> Composite | None:
        return self._part(env, "info")

    def _part(self, env: EnvBase, name: str) -> Composite:
        """Returns the specification of one part of what the groups show."""
        spec = env.observation_spec.clone()
        for group in self.group_map(env):
            for key in [key for key in spec[group].keys() if key != name]:
                del spec[group][key]
        return spec

    def action_spec(self, env: EnvBase) -> Composite:
        return env.full_action_spec

    def state_spec(self, env: EnvBase) -> Composite | None:
        # The critic reads all observations instead.
        return None

    def action_mask_spec(self, env: EnvBase) -> Composite | None:
        return None

    @staticmethod
    def env_name() -> str:
        return "iwol_sumo"


def main(frames: int = 6000) -> None:
    torch.set_num_threads(1)
    config = ExperimentConfig.get_from_yaml()
    config.max_n_frames = frames
    config.on_policy_collected_frames_per_batch = min(frames, 6000)
    config.on_policy_n_envs_per_worker = 1
    config.on_policy_n_minibatch_iters = 2
    config.evaluation = False
    config.loggers = []
    config.create_json = False
    Experiment(
        task=DrivingTask("intersection", {"scenario": "intersection", "agents": 8}),
        algorithm_config=MappoConfig.get_from_yaml(),
        model_config=MlpConfig.get_from_yaml(),
        critic_model_config=MlpConfig.get_from_yaml(),
        seed=0,
        config=config,
    ).run()


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
