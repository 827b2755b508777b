"""A rollout with TorchRL's PettingZooWrapper.

    pip install ./python_bridge torchrl   # in a clone of the repository
    python torchrl_rollout.py
"""

import sys

import torch
from tensordict import TensorDictBase
from torchrl.envs.libs.pettingzoo import PettingZooWrapper

import iwol_sumo


def accelerate(data: TensorDictBase) -> TensorDictBase:
    """A policy: throttles between 0.3 and 1."""
    shape = data["vehicle", "mask"].shape
    return data.set(("vehicle", "action"), 0.3 + 0.7 * torch.rand(*shape, 1))


def main(steps: int = 500) -> torch.Tensor:
    torch.set_num_threads(1)
    # done_on_any is on by default, and would end the episode for everybody with the first vehicle that arrives. The mask
    # tells which vehicles still act: leave the samples of the others out of every loss.
    env = PettingZooWrapper(iwol_sumo.parallel_env("intersection", agents=8), done_on_any=False, use_mask=True)
    try:
        data = env.rollout(steps, accelerate, break_when_any_done=False)
    finally:
        env.close()
    reward, mask = data["next", "vehicle", "reward"].squeeze(-1), data["vehicle", "mask"]
    print(f"{mask.sum()} samples of vehicles that act, of {mask.numel()}; mean reward {reward[mask].mean():.3f}")
    return mask


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
