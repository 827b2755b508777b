"""Policies as ONNX models."""

import json
import subprocess
from pathlib import Path
from shutil import which

import numpy as np
import pytest

import iwol_sumo

pytest.importorskip("onnxruntime")
from iwol_sumo.onnx import OnnxPolicy  # noqa: E402

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.skipif(which("iwol") is None, reason="the program iwol is not on PATH")


def iwol(*arguments):
    return subprocess.run(["iwol", *map(str, arguments)], capture_output=True, text=True, cwd=ROOT)


@pytest.fixture(scope="module", params=["mappo-8", "im-iwol-8", "ex-iwol-8"])
def exported(request, tmp_path_factory):
    """A shipped policy and its model."""
    file = tmp_path_factory.mktemp("model") / "policy.onnx"
    out = iwol("export", ROOT / "policies" / request.param, "--onnx", file)
    assert out.returncode == 0, out.stderr
    return ROOT / "policies" / request.param, file


@pytest.fixture(scope="module", params=["maddpg", "maddpg-iwol"])
def exported_maddpg(request, tmp_path_factory):
    """A short run and its model."""
    folder = tmp_path_factory.mktemp("model")
    run, file = folder / "run", folder / "policy.onnx"
    small = ["train.envs=2", "train.rollout_steps=32", "network.hidden=8", "iwol.message=8", "iwol.latent=4"]
    more = ["ppo.minibatch=64", "train.validation_episodes=1", "scenario.termination.horizon=40"]
    settings = [part for setting in small + more for part in ("--set", setting)]
    scenario = iwol_sumo.scenario_file("intersection")
    method = ["--algorithm", request.param]
    out = iwol("train", "--scenario", scenario, "--agents", 4, *method, "--steps", 128, "--out", run, *settings)
    assert out.returncode == 0, out.stderr
    out = iwol("export", run, "--onnx", file)
    assert out.returncode == 0, out.stderr
    return run, file


def test_a_model_plays_the_same_episodes_as_the_program(exported):
    folder, file = exported
    out = iwol("evaluate", folder, "--episodes", 20, "--seed", 3, "--json")
    wanted = json.loads(out.stdout)["metrics"]
    found = iwol_sumo.evaluate(OnnxPolicy(file), "intersection", 8, episodes=20, seed=3)["metrics"]
    for metric in ("success", "reward", "episode_length"):
        assert found[metric]["mean"] == pytest.approx(wanted[metric]["mean"], rel=1e-4), metric


def test_a_model_says_what_its_numbers_mean(exported):
    _, file = exported
    policy = OnnxPolicy(file)
    with iwol_sumo.parallel_env("intersection", 8) as env:
        assert [row["name"] for row in policy.description["observation"]] == [f.name for f in env.features]
        assert [row["name"] for row in policy.description["actions"]] == env.actions
    assert policy.description["interval"] == 0.1


def decide_as_pytorch(folder, file):
    pytest.importorskip("torch")
    from iwol_sumo.policies import load_policy

    rng = np.random.default_rng(0)
    observation = rng.uniform(-1, 1, (1000, 8, 67)).astype(np.float32)
    near = rng.random((1000, 8, 8)) < 0.5
    comm = (near | near.transpose(0, 2, 1) | np.eye(8, dtype=bool)).astype(np.float32)
    difference = np.abs(OnnxPolicy(file)(observation, comm) - load_policy(folder)(observation, comm))
    # A score within rounding of the limit may open an edge in one and close it in the other.
    assert np.quantile(difference, 0.999) < 1e-5 and (difference > 1e-4).mean() < 1e-3


def test_a_model_decides_as_pytorch(exported):
    decide_as_pytorch(*exported)


def test_a_model_of_maddpg_decides_as_pytorch(exported_maddpg):
    decide_as_pytorch(*exported_maddpg)


def test_a_model_of_maddpg_plays_the_same_episodes_as_the_program(exported_maddpg):
    run, file = exported_maddpg
    out = iwol("evaluate", run, "--policy", f"onnx:{file}", "--episodes", 2, "--json")
    assert out.returncode == 0, out.stderr
    wanted, by_program = (result["metrics"]["reward"]["mean"] for result in json.loads(out.stdout))
    overrides = {"termination.horizon": 40}
    found = iwol_sumo.evaluate(OnnxPolicy(file), "intersection", 4, episodes=2, overrides=overrides)
    assert [found["metrics"]["reward"]["mean"], by_program] == pytest.approx([wanted] * 2, rel=1e-4)


def test_a_model_of_choices_decides_as_pytorch(tmp_path):
    pytest.importorskip("torch")
    from iwol_sumo.policies import load_policy

    folder, file = ROOT / "policies/traffic-junction-ex-iwol", tmp_path / "policy.onnx"
    out = iwol("export", folder, "--onnx", file)
    assert out.returncode == 0, out.stderr
    model = OnnxPolicy(file)
    assert model.description["environment"] == "traffic_junction"
    rng = np.random.default_rng(0)
    observation = rng.uniform(0, 1, (100, 20, len(model.description["observation"]))).astype(np.float32)
    comm = np.broadcast_to(np.eye(20, dtype=np.float32), (100, 20, 20)).copy()
    difference = np.abs(model(observation, comm) - load_policy(folder)(observation, comm))
    assert difference.shape[-1] == len(model.description["actions"]) and difference.max() < 1e-4


def test_errors_of_a_model_are_errors_of_the_package(exported, tmp_path):
    (tmp_path / "bad.onnx").write_text("nonsense")
    for name in ("none.onnx", "bad.onnx"):
        with pytest.raises(iwol_sumo.Error, match=f"cannot load the policy .*{name}"):
            OnnxPolicy(tmp_path / name)
    folder, file = exported
    policy = OnnxPolicy(file)
    with pytest.raises(iwol_sumo.Error, match="(?s)cannot be computed: .*Got: 3 Expected: 67"):
        policy(np.zeros((1, 8, 3), np.float32), np.ones((1, 8, 8), np.float32))
    if folder.name == "ex-iwol-8":
        with pytest.raises(iwol_sumo.Error, match="the policy also needs comm"):
            policy(np.zeros((1, 8, 67), np.float32))
    with pytest.raises(iwol_sumo.Error, match="has 67 numbers of observation"):
        iwol_sumo.evaluate(policy, "parking_lot", episodes=1)


def test_what_has_no_model_is_refused(tmp_path):
    file = tmp_path / "policy.onnx"
    assert iwol("export", ROOT / "policies/mappo-8", "--onnx", file).returncode == 0
    again = iwol("export", ROOT / "policies/mappo-8", "--onnx", file)
    assert again.returncode == 2 and "already exists" in again.stderr
