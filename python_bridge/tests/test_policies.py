"""Policies of the program in PyTorch."""

import json
import subprocess
from pathlib import Path
from shutil import which

import numpy as np
import pytest

import iwol_sumo

torch = pytest.importorskip("torch")
from iwol_sumo.policies import load_policy, read_checkpoint  # noqa: E402

POLICIES = Path(__file__).parents[2] / "policies"


@pytest.mark.skipif(which("iwol") is None, reason="the program iwol is not on PATH")
@pytest.mark.parametrize("name", ["mappo-8", "im-iwol-8", "ex-iwol-8"])
def test_a_policy_plays_the_same_episodes_as_in_the_program(name):
    arguments = ["--episodes", "20", "--seed", "3", "--json"]
    out = subprocess.run(["iwol", "evaluate", POLICIES / name, *arguments], capture_output=True, text=True, cwd=POLICIES.parent, check=True)
    wanted = json.loads(out.stdout)["metrics"]
    found = iwol_sumo.evaluate(load_policy(POLICIES / name), "intersection", 8, episodes=20, seed=3)["metrics"]
    for metric in ("success", "reward", "episode_length"):
        assert found[metric]["mean"] == pytest.approx(wanted[metric]["mean"], rel=1e-4), metric


def test_other_methods_and_files_are_refused(tmp_path):
    with pytest.raises(iwol_sumo.Error, match="cannot read the checkpoint"):
        load_policy(tmp_path)
    (tmp_path / "bad.safetensors").write_bytes(b"nonsense")
    with pytest.raises(iwol_sumo.Error, match="cannot read the checkpoint"):
        load_policy(tmp_path / "bad.safetensors")
    tensors, metadata = read_checkpoint(POLICIES / "mappo-8")
    header = {"__metadata__": {**metadata, "algorithm": "mat"}}
    text = json.dumps(header).encode()
    (tmp_path / "mat.safetensors").write_bytes(len(text).to_bytes(8, "little") + text)
    with pytest.raises(iwol_sumo.Error, match="holds 'mat'"):
        load_policy(tmp_path / "mat.safetensors")


def test_vehicles_out_of_range_change_nothing():
    policy = load_policy(POLICIES / "ex-iwol-8")
    observation = torch.rand(1, 4, 67)
    comm = torch.tensor([[1, 1, 0, 0], [1, 1, 0, 0], [0, 0, 1, 1], [0, 0, 1, 1]]).float().unsqueeze(0)
    other = observation.clone()
    other[0, 2:] += 1
    a, b = policy(observation, comm), policy(other, comm)
    assert torch.equal(a[0, :2], b[0, :2]) and not torch.equal(a[0, 2:], b[0, 2:])
    assert np.array_equal(policy(observation.numpy(), comm.numpy()), a.detach().numpy())
