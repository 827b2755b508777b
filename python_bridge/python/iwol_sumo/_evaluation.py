"""Evaluation as ``iwol evaluate`` does it."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._scenarios import load_task

Policy = Callable[
    [NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], NDArray[np.bool_]], NDArray[np.float32]
]


def evaluate(
    policy: str | Policy,
    scenario: str | os.PathLike[str],
    agents: int | None = None,
    *,
    episodes: int = 100,
    seed: int = 0,
    overrides: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Plays episodes and returns the metrics with their 95 % intervals.

    The numbers are those of ``iwol evaluate --json``: the episodes of a seed are the same, and those in which SUMO dies are
    played again.

    Args:
        policy: a driver without training (``"sumo"``, ``"throttle:1"``, ``"pursuit:8"``, ``"fcfs:8"``, ``"gaussian"``,
            ``"uniform"``), or a function that gets ``observation [E, N, O]``, ``comm [E, N, N]``, ``active [E, N]`` and
            ``start [E, N]`` and returns actions ``[E, N, A]`` as float32. E is 16 or fewer worlds.
        scenario: name or path, as for :func:`iwol_sumo.parallel_env`.
        agents: number of vehicles; the scenario's default without it.
        episodes: number of episodes.
        seed: seed of the episodes.
        overrides: other values of the scenario's settings, as for :func:`iwol_sumo.parallel_env`.

    Returns:
        The result: ``["metrics"]`` has the metrics, ``["records"]`` the record of each episode.
    """
    task = load_task(scenario, agents, overrides)
    name = policy if isinstance(policy, str) else getattr(policy, "__name__", type(policy).__name__)
    result, records = _native.evaluate(task, policy, name, episodes, seed)
    return {**json.loads(result), "records": json.loads(records)}
