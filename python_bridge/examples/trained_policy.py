"""Evaluates a trained policy in PyTorch.

    pip install "./python_bridge[sumo,torch]"   # in a clone of the repository
    python trained_policy.py policies/im-iwol-8
"""

import sys

import torch

import iwol_sumo
from iwol_sumo.policies import load_policy


def main(run: str, scenario: str = "intersection", agents: int = 8, episodes: int = 100) -> float:
    torch.set_num_threads(1)
    policy = load_policy(run)
    metrics = iwol_sumo.evaluate(policy, scenario, agents, episodes=episodes)["metrics"]
    success, crashes = metrics["success"], metrics["crash"]
    print(f"{policy.algorithm}, {agents} vehicles, {episodes} episodes of {scenario}")
    print(f"success {100 * success['mean']:.1f} % [{100 * success['low']:.1f}, {100 * success['high']:.1f}]")
    print(f"crashed {100 * crashes['mean']:.1f} % of the vehicles")
    return success["mean"]


if __name__ == "__main__":
    main(*sys.argv[1:3], *map(int, sys.argv[3:]))
