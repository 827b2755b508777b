"""The examples with other libraries run; those whose library is not installed are skipped, and say so."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

import iwol_sumo

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture
def example(monkeypatch):
    """Imports an example by name."""
    monkeypatch.syspath_prepend(EXAMPLES)
    yield importlib.import_module
    for file in EXAMPLES.glob("*.py"):
        sys.modules.pop(file.stem, None)


def test_supersuit_makes_vectors():
    supersuit = pytest.importorskip("supersuit")
    env = supersuit.black_death_v3(iwol_sumo.parallel_env("intersection", agents=8))
    env = supersuit.concat_vec_envs_v1(supersuit.pettingzoo_env_to_vec_env_v1(env), 2, base_class="gymnasium")
    observation, _ = env.reset(seed=0)
    for _ in range(30):
        observation, reward, terminated, truncated, _ = env.step(np.ones((16, 1), np.float32))
    assert observation.shape == (16, 67) and reward.shape == (16,)
    env.close()


def test_torchrl_plays_with_masks(example):
    pytest.importorskip("torchrl")
    mask = example("torchrl_rollout").main(150)
    # Some vehicles have ended, and the others have gone on.
    assert mask.shape == (150, 8) and 8 < mask.sum() < mask.numel()


def test_stable_baselines3_learns(example):
    pytest.importorskip("stable_baselines3")
    pytest.importorskip("supersuit")
    assert example("sb3").main(1024).num_timesteps >= 1024


def test_benchmarl_trains(example, tmp_path, monkeypatch):
    pytest.importorskip("benchmarl")
    monkeypatch.chdir(tmp_path)
    example("benchmarl_task").main(300)


def test_rllib_trains(example):
    pytest.importorskip("ray.rllib", exc_type=ImportError)
    assert example("rllib").main(1, 200)["training_iteration"] == 1
