"""Evaluation, and what happens to processes."""

import json
import os
import shutil
import signal
import subprocess
import sys
import textwrap
import time

import numpy as np
import pytest

import iwol_sumo


def run(code, **options):
    """Runs Python code in a process of its own."""
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True, timeout=120, **options
    )


def children(of):
    found = subprocess.run(["ps", "-o", "comm=", "--ppid", str(of)], capture_output=True, text=True).stdout.split()
    return [name for name in found if name.startswith("sumo")]


def test_a_function_is_evaluated_as_the_same_rule():
    def full_throttle(observation, comm, active, start):
        assert observation.shape[:2] == active.shape == start.shape and comm.shape == (*active.shape, active.shape[1])
        return np.ones((*active.shape, 1), np.float32)

    mine = iwol_sumo.evaluate(full_throttle, "intersection", 8, episodes=20, seed=3)
    rule = iwol_sumo.evaluate("throttle:1", "intersection", 8, episodes=20, seed=3)
    assert mine["metrics"] == rule["metrics"] and mine["records"] == rule["records"]
    assert len(mine["records"]) == 20 and mine["policy"] == "full_throttle"


@pytest.mark.skipif(shutil.which("iwol") is None, reason="the program iwol is not on PATH")
def test_the_numbers_are_those_of_the_program():
    arguments = ["--policy", "throttle:1", "--agents", "8", "--episodes", "20", "--seed", "3", "--json"]
    file = str(iwol_sumo.scenario_file("intersection"))
    out = subprocess.run(["iwol", "evaluate", "--scenario", file, *arguments], capture_output=True, text=True, check=True)
    wanted = json.loads(out.stdout)["metrics"]
    assert iwol_sumo.evaluate("throttle:1", "intersection", 8, episodes=20, seed=3)["metrics"] == wanted


def test_errors_of_a_policy_end_the_evaluation():
    def broken(*_):
        raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        iwol_sumo.evaluate(broken, "intersection", 8, episodes=2)
    with pytest.raises(iwol_sumo.Error, match=r"shape \[1\] instead of \[2, 8, 1\]"):
        iwol_sumo.evaluate(lambda *_: np.zeros(1, np.float32), "intersection", 8, episodes=2)
    with pytest.raises(iwol_sumo.Error, match="there is no policy `throtle:1`"):
        iwol_sumo.evaluate("throtle:1", "intersection", 8)
    for number in ({"episodes": 0}, {"episodes": 1.0}, {"seed": -1}):
        [name] = number
        with pytest.raises(iwol_sumo.Error, match=f"^{name} is .*; allowed: whole numbers from"):
            iwol_sumo.evaluate("throttle:1", "intersection", 8, **number)


def test_actions_of_a_policy_are_converted_and_checked():
    def records(policy):
        return iwol_sumo.evaluate(policy, "intersection", 8, episodes=2)["records"]

    wanted = records("throttle:1")
    assert records(lambda o, c, active, s: np.ones((*active.shape, 1))) == wanted
    assert records(lambda o, c, active, s: np.ones((*active.shape, 1)).tolist()) == wanted
    # Nobody acts in the other rows.
    assert records(lambda o, c, active, s: np.where(active, 1, np.nan)[..., None]) == wanted

    def lost(observation, comm, active, start):
        actions = np.ones((*active.shape, 1), np.float32)
        actions[1, 3] = np.nan
        return actions

    for policy, message in [
        (lost, "the policy returned NaN for vehicle_3 in world 1"),
        (lambda *_: np.ones(3), r"returned float64 of shape \[3\] instead of \[2, 8, 1\]"),
        (lambda *_: [1.0], r"returned list of shape \[1\] instead of"),
        (lambda *_: "full", "returned str instead of numbers"),
    ]:
        with pytest.raises(iwol_sumo.Error, match=message):
            records(policy)


def test_a_policy_for_another_task_is_refused():
    def policy(observation, comm, active, start):
        return np.ones((*active.shape, 1), np.float32)

    features = iwol_sumo.parallel_env("intersection", 8).features
    rows = [{"name": feature.name, "unit": feature.unit} for feature in features]
    same = {"observation": rows, "actions": [{"name": "throttle"}], "interval": 0.1}
    policy.description = same
    assert iwol_sumo.evaluate(policy, "intersection", 8, episodes=1)["episodes"] == 1
    speed, *rest = rows
    for change, message in [
        ({"observation": rest}, f"has {len(rest)} numbers of observation; .* {len(rows)}"),
        ({"observation": [{**speed, "name": "x"}, *rest]}, "number 0 of observation is 'x'; .*ego"),
        ({"observation": [{**speed, "unit": "9 m/s"}, *rest]}, "ego.speed', is in units of 9 m/s;"),
        ({"actions": [{"name": "brake"}]}, "number 0 of actions is 'brake'; .* 'throttle'"),
        ({"interval": 0.2}, "decides every 0.2 s; .* it is 0.1 s"),
    ]:
        policy.description = {**same, **change}
        with pytest.raises(iwol_sumo.Error, match=message):
            iwol_sumo.evaluate(policy, "intersection", 8, episodes=1)


def test_ctrl_c_ends_a_run_without_leaving_sumo():
    code = """
        import numpy as np, iwol_sumo
        env = iwol_sumo.vec_env("intersection", 4, 8)
        env.reset(seed=0)
        print("ready", flush=True)
        while True:
            env.step(np.zeros((4, 8, 1), np.float32))
    """
    # Jobs that a shell runs in the background ignore Ctrl-C, and so would their children.
    heed = lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)  # noqa: E731
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=heed
    )
    assert process.stdout.readline() == "ready\n"
    assert children(process.pid)
    process.send_signal(signal.SIGINT)
    _, text = process.communicate(timeout=30)
    assert process.returncode != 0 and "KeyboardInterrupt" in text


@pytest.mark.parametrize("end", ["sys.exit(3)", "os._exit(3)", "os.kill(os.getpid(), 9)", "raise ValueError"])
def test_no_sumo_outlives_the_interpreter(end):
    code = f"""
        import os, sys, subprocess, iwol_sumo
        env = iwol_sumo.vec_env("intersection", 2, 8)
        env.reset(seed=0)
        listed = subprocess.run(["ps", "-o", "pid=,comm=", "--ppid", str(os.getpid())], capture_output=True, text=True)
        print([line.split()[0] for line in listed.stdout.splitlines() if "sumo" in line], flush=True)
        {end}
    """
    out = run(code)
    started = json.loads(out.stdout.replace("'", '"'))
    assert started and "panicked" not in out.stderr
    for _ in range(50):
        if not any(os.path.exists(f"/proc/{pid}") for pid in started):
            return
        time.sleep(0.1)
    pytest.fail(f"SUMO is left: {started}")


def test_forked_processes_are_refused_and_spawned_ones_work():
    code = """
        import multiprocessing, sys, iwol_sumo

        def work(_):
            with iwol_sumo.parallel_env("intersection", 8) as env:
                return len(env.reset(seed=0)[0])

        if __name__ == "__main__":
            print(work(0))
            with multiprocessing.get_context("fork").Pool(1) as pool:
                try:
                    pool.map(work, [0])
                except iwol_sumo.Error as error:
                    print(error)
            print(len(iwol_sumo.scenarios()) > 3)
    """
    out = run(code)
    assert out.stdout.splitlines()[0] == "8" and "spawn" in out.stdout, out
    assert "after one was made or used" in out.stdout, out


def test_a_forked_process_leaves_sumo_to_its_parent():
    code = """
        import gc, os, numpy as np, iwol_sumo
        env = iwol_sumo.vec_env("intersection", 1, 8)
        env.reset(seed=0)
        child = os.fork()
        if child == 0:
            del env
            gc.collect()
            os._exit(0)
        os.waitpid(child, 0)
        print(env.step(np.ones((1, 8, 1), np.float32)).interrupted)
    """
    assert run(code).stdout == "[False]\n"


def test_all_environments_are_closed_at_the_end():
    code = """
        import iwol_sumo

        def close(env):
            print("closed")
            raise iwol_sumo.Error("in use")

        iwol_sumo.VecEnv.close = close
        envs = [iwol_sumo.vec_env("intersection", 1, 8) for _ in range(2)]
        silence = iwol_sumo._native.silence
        iwol_sumo._native.silence = lambda: print("silent", silence())
    """
    out = run(code)
    assert out.stdout == "closed\nclosed\nsilent None\n" and not out.stderr, out


def test_a_missing_sumo_is_named(tmp_path):
    code = """
        import sys
        sys.modules["sumo"] = None
        import iwol_sumo
        try:
            iwol_sumo.parallel_env("intersection").reset()
        except iwol_sumo.SumoError as error:
            print(error)
    """
    nothing = {"PATH": str(tmp_path), "HOME": str(tmp_path)}
    out = run(code, env=nothing)
    assert "hint" in out.stdout and "SUMO" in out.stdout, out


def test_two_environments_live_in_one_process():
    with iwol_sumo.vec_env("intersection", 2, 8) as one, iwol_sumo.vec_env("parking_lot", 2) as two:
        one.reset(seed=0)
        two.reset(seed=0)
        for _ in range(5):
            one.step(np.zeros((2, 8, 1), np.float32))
            two.step(np.zeros((2, two.agents, 2), np.float32))
