"""Policies of the program in PyTorch."""

import json
import subprocess
import sys
import textwrap
from pathlib import Path
from shutil import which

import numpy as np
import pytest

import iwol_sumo

torch = pytest.importorskip("torch")
from iwol_sumo.policies import load_policy  # noqa: E402

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


def test_a_policy_with_discrete_actions_gives_logits():
    policy = load_policy(POLICIES / "traffic-junction-ex-iwol")
    width = policy.weights["encoder/mlp/layers/0/linear/weight"].shape[1]
    observation = np.random.default_rng(0).uniform(0, 1, (3, 10, width)).astype(np.float32)
    logits = policy(observation, np.ones((3, 10, 10), np.float32))
    assert logits.shape == (3, 10, 2) and logits.std() > 0.1


def test_other_methods_and_files_are_refused(tmp_path):
    with pytest.raises(iwol_sumo.Error, match="cannot load the policy .*No such file"):
        load_policy(tmp_path)
    (tmp_path / "bad.safetensors").write_bytes(b"nonsense")
    with pytest.raises(iwol_sumo.Error, match="cannot load the policy"):
        load_policy(tmp_path / "bad.safetensors")
    whole = (POLICIES / "mappo-8/checkpoints/best.safetensors").read_bytes()
    (tmp_path / "cut.safetensors").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(iwol_sumo.Error, match="not complete"):
        load_policy(tmp_path / "cut.safetensors")
    begin = 8 + int.from_bytes(whole[:8], "little")
    header = json.loads(whole[8:begin])
    header["__metadata__"]["algorithm"] = "mat"
    text = json.dumps(header).encode()
    (tmp_path / "mat.safetensors").write_bytes(len(text).to_bytes(8, "little") + text + whole[begin:])
    with pytest.raises(iwol_sumo.Error, match="holds 'mat'"):
        load_policy(tmp_path / "mat.safetensors")


@pytest.mark.skipif(which("iwol") is None, reason="the program iwol is not on PATH")
@pytest.mark.parametrize("name", ["mappo-8", "im-iwol-8", "ex-iwol-8"])
def test_an_exported_folder_runs_without_the_package(name, tmp_path):
    folder = tmp_path / "policy"
    command = ["iwol", "export", POLICIES / name, "--pytorch", folder]
    subprocess.run(command, capture_output=True, check=True)
    assert len((folder / "policy.py").read_text().splitlines()) < 100
    code = f"""
        import sys, torch
        sys.path.insert(0, {str(folder)!r})
        from policy import Policy
        torch.manual_seed(0)
        observation, comm = torch.rand(3, 8, 67) * 2 - 1, torch.ones(3, 8, 8)
        print(Policy({str(folder)!r})(observation, comm).tolist())
        assert not any("iwol" in name for name in sys.modules)
    """
    out = subprocess.run([sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True, check=True)
    torch.manual_seed(0)
    observation, comm = torch.rand(3, 8, 67) * 2 - 1, torch.ones(3, 8, 8)
    found = torch.tensor(json.loads(out.stdout))
    for policy in (load_policy(POLICIES / name), load_policy(folder)):
        assert torch.equal(policy(observation, comm), found)
    description = json.loads((folder / "policy.json").read_text())
    with iwol_sumo.parallel_env("intersection", 8) as env:
        assert [row["name"] for row in description["observation"]] == [f.name for f in env.features]
    assert load_policy(folder).description == description
    for policy in (load_policy(folder), load_policy(POLICIES / name)):
        with pytest.raises(iwol_sumo.Error, match="has 67 numbers of observation"):
            iwol_sumo.evaluate(policy, "parking_lot", episodes=1)
    again = subprocess.run(command, capture_output=True, text=True)
    assert again.returncode == 2 and "already exists" in again.stderr


def test_a_policy_of_a_run_says_what_it_was_trained_with(tmp_path):
    policy = load_policy(POLICIES / "im-iwol-8")
    for overrides, message in (
        ({"observation.distanceScale": 20}, "distances in units of 50.0 m"),
        ({"control.interval": 0.11}, "decides every 0.1 s"),
        ({"observation.ownTurn": "true", "observation.heading": "false"}, "number 2 of observation is"),
    ):
        with pytest.raises(iwol_sumo.Error, match=message):
            iwol_sumo.evaluate(policy, "intersection", 8, episodes=1, overrides=overrides)
    # A run that was stopped before its first validation has only a last checkpoint.
    run = tmp_path / "checkpoints"
    run.mkdir()
    whole = (POLICIES / "ex-iwol-8/checkpoints/best.safetensors").read_bytes()
    (run / "last.safetensors").write_bytes(whole)
    assert load_policy(tmp_path).description == load_policy(POLICIES / "ex-iwol-8").description
    # A radio that loses messages is told.
    begin = 8 + int.from_bytes(whole[:8], "little")
    text = whole[8:begin].replace(b"\\nloss = 0.0", b"\\nloss = 0.5")
    (run / "last.safetensors").write_bytes(whole[:8] + text + whole[begin:])
    with pytest.warns(UserWarning, match="radio that is not perfect"):
        load_policy(tmp_path)


def test_vehicles_out_of_range_change_nothing():
    policy = load_policy(POLICIES / "ex-iwol-8")
    observation = torch.rand(1, 4, 67)
    comm = torch.tensor([[1, 1, 0, 0], [1, 1, 0, 0], [0, 0, 1, 1], [0, 0, 1, 1]]).float().unsqueeze(0)
    other = observation.clone()
    other[0, 2:] += 1
    a, b = policy(observation, comm), policy(other, comm)
    assert torch.equal(a[0, :2], b[0, :2]) and not torch.equal(a[0, 2:], b[0, 2:])
    assert np.array_equal(policy(observation.numpy(), comm.numpy()), a.detach().numpy())
