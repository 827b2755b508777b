"""Speed of the environments from Python, beside a loop of Rust over the same worlds.

    python python_bridge/benchmarks/speed.py

Both loops step the same SUMO processes, in turns of 100 steps, so that a busy machine slows both, and both write each
step's results to arrays, as training does. "own time" is the
processor time of the calling thread, which includes the binding and what it computes for the worlds, and hardly depends on
other programs.
"""

from __future__ import annotations

import time

import numpy as np

import iwol_sumo

TURN = 100


def batched(num_envs: int, agents: int, turns: int) -> None:
    """Compares steps of a vec_env with Rust's loop."""
    rng = np.random.default_rng(0)
    with iwol_sumo.vec_env("intersection", num_envs, agents, copy=False) as env:
        env.reset(seed=0)
        actions = rng.uniform(-1, 1, (TURN, num_envs, agents, len(env.actions))).astype(np.float32)

        def python() -> None:
            for action in actions:
                env.step(action)

        def rust() -> None:
            env._env.repeat(actions, env._frame)

        python()
        rust()
        wall: dict[str, list[float]] = {"python": [], "rust": []}
        own: dict[str, list[float]] = {"python": [], "rust": []}
        for _ in range(turns):
            for name, loop in (("python", python), ("rust", rust)):
                begin, begin_own = time.perf_counter(), time.thread_time()
                loop()
                own[name].append((time.thread_time() - begin_own) / TURN * 1e6)
                wall[name].append((time.perf_counter() - begin) / TURN * 1e6)
    median = {name: float(np.median(times)) for name, times in wall.items()}
    median_own = {name: float(np.median(times)) for name, times in own.items()}
    print(
        f"{num_envs:>3} x {agents:<3} python {median['python']:8.1f} us/step, rust {median['rust']:8.1f} us/step, "
        f"speed {median['rust'] / median['python']:6.1%}; own time {median_own['python']:6.1f} and "
        f"{median_own['rust']:6.1f}, binding {median_own['python'] - median_own['rust']:5.1f} us/step"
    )


def dictionaries(agents: int, steps: int) -> None:
    """Measures a parallel_env with new actions for each agent, and the part of Python in it."""
    rng = np.random.default_rng(0)
    with iwol_sumo.parallel_env("intersection", agents) as env:
        env.reset(seed=0)
        table = rng.uniform(-1, 1, (steps, agents, len(env.actions))).astype(np.float32)
        count, native, wall, own = 0, 0.0, 0.0, 0.0
        inner = env._env.step

        class Timed:
            """The native environment, with a clock."""

            def __getattr__(self, name: str) -> object:
                return getattr(timed, name)

            def step(self, *arguments: object) -> object:
                nonlocal native
                begin = time.perf_counter()
                result = inner(*arguments)
                native += time.perf_counter() - begin
                return result

        timed, env._env = env._env, Timed()
        for row in table:
            if not env.agents:
                env.reset()
            actions = {name: row[int(name[8:])] for name in env.agents}
            begin, begin_own = time.perf_counter(), time.thread_time()
            env.step(actions)
            own += time.thread_time() - begin_own
            wall += time.perf_counter() - begin
            count += 1
    print(
        f"parallel_env, {agents} agents: {count / wall:8.0f} steps/s; a step {1e6 * wall / count:6.1f} us, of which SUMO and Rust "
        f"{1e6 * native / count:6.1f}, dictionaries {1e6 * (wall - native) / count:5.1f} us; own time {1e6 * own / count:6.1f}"
    )


def pictures(agents: int, steps: int) -> None:
    """Measures pictures of steps as arrays."""
    with iwol_sumo.parallel_env("intersection", agents, render_mode="rgb_array") as env:
        env.reset(seed=0)
        wall = 0.0
        for _ in range(steps):
            if not env.agents:
                env.reset()
            env.step({name: np.zeros(len(env.actions), np.float32) for name in env.agents})
            begin = time.perf_counter()
            picture = env.render()
            wall += time.perf_counter() - begin
    assert isinstance(picture, np.ndarray)
    print(f"rgb_array {picture.shape[0]} x {picture.shape[1]}: {1e3 * wall / steps:.2f} ms a picture")


if __name__ == "__main__":
    print(f"iwol_sumo {iwol_sumo.__version__}, medians of turns of {TURN} steps")
    for num_envs, agents, turns in [(16, 8, 60), (1, 8, 100), (16, 48, 15)]:
        batched(num_envs, agents, turns)
    dictionaries(8, 3000)
    pictures(8, 100)
