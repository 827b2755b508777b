"""Evaluation as ``iwol evaluate`` does it."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native
from ._arguments import whole
from ._scenarios import load_task
from .errors import Error

Policy = Callable[
    [NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], NDArray[np.bool_]], ArrayLike
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
            ``start [E, N]`` and returns actions ``[E, N, A]``. E is 16 or fewer worlds. If it has a
            ``description``, as policies of ``load_policy`` do, that must name the task's numbers.
        scenario: name or path, as for :func:`iwol_sumo.parallel_env`.
        agents: number of vehicles; the scenario's default without it.
        episodes: number of episodes.
        seed: seed of the episodes.
        overrides: other values of the scenario's settings, as for :func:`iwol_sumo.parallel_env`.

    Returns:
        The result: ``["metrics"]`` has the metrics, ``["records"]`` the record of each episode.

    Raises:
        Error: if the policy was made for other numbers than the task's, or returns actions of
            another shape or NaN.
    """
    episodes, seed = whole("episodes", episodes, 1), whole("seed", seed)
    task = load_task(scenario, agents, overrides)
    description = getattr(policy, "description", None)
    if isinstance(description, dict):
        check_description(description, task)
    name = policy if isinstance(policy, str) else getattr(policy, "__name__", type(policy).__name__)
    result, records = _native.evaluate(task, policy, name, episodes, seed)
    return {**json.loads(result), "records": json.loads(records)}


def check_description(description: Mapping[str, Any], task: _native.NativeTask) -> None:
    """Compares what a policy says about itself with a task, as ``iwol evaluate`` does.

    Raises:
        Error: with the first difference of names, scales, or the time between decisions.
    """
    by_task = "by the task and its settings it is"
    for part, ours in (
        ("observation", [(name, unit) for name, unit, *_ in task.observation]),
        ("actions", [(name, "") for name in task.actions]),
    ):
        theirs = description.get(part)
        if theirs is None:
            continue
        if len(theirs) != len(ours):
            defined = f"the task and its settings define {len(ours)}"
            raise Error(f"the policy has {len(theirs)} numbers of {part}; {defined}")
        for at, (row, (name, unit)) in enumerate(zip(theirs, ours)):
            if row["name"] != name:
                raise Error(f"number {at} of {part} is {row['name']!r}; {by_task} {name!r}")
            their_scale, our_scale = scale(row.get("unit", "")), scale(unit)
            if their_scale and our_scale and their_scale != our_scale:
                units = f"in units of {their_scale}; {by_task} in units of {our_scale}"
                raise Error(f"number {at} of {part}, {name!r}, is {units}")
    interval = description.get("interval", task.interval)
    if interval != task.interval:
        raise Error(f"the policy decides every {interval} s; {by_task} {task.interval} s")
    unit = description.get("distance_scale", task.distance_scale)
    if unit != task.distance_scale:
        raise Error(f"the policy observes distances in units of {unit} m; {by_task} {task.distance_scale} m")


def scale(unit: str) -> str | None:
    """Returns the scale with which a unit begins, such as ``50 m``, if it does."""
    text = re.split("[,:]", unit)[0]
    return text if text[:1].isdigit() else None
