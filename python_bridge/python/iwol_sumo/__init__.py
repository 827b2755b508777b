"""Multi-vehicle coordination in SUMO: multi-agent environments, with the simulation loop in Rust.

>>> import iwol_sumo
>>> env = iwol_sumo.parallel_env("intersection", agents=8)
>>> observations, infos = env.reset(seed=0)

:func:`parallel_env` is one world by PettingZoo's conventions, :func:`vec_env` many worlds as NumPy arrays,
:func:`evaluate` measures a policy, :mod:`iwol_sumo.scenario` makes, checks and draws scenarios.
"""

from __future__ import annotations

import atexit
import contextlib
import importlib.util
import os
import weakref
from collections.abc import Mapping
from typing import Any

from . import _native, scenario
from ._evaluation import evaluate
from ._native import __version__
from ._parallel import VehicleEnv
from ._scenarios import scenario_file, scenarios, settings
from ._vec import Feature, FlatVecEnv, Frame, VecEnv
from .errors import ArgumentError, Error, ScenarioError, SumoError

__all__ = [
    "ArgumentError",
    "Error",
    "Feature",
    "FlatVecEnv",
    "Frame",
    "ScenarioError",
    "SumoError",
    "VecEnv",
    "VehicleEnv",
    "__version__",
    "env",
    "evaluate",
    "parallel_env",
    "scenario",
    "scenario_file",
    "scenarios",
    "settings",
    "vec_env",
]

# SUMO of the Python package `eclipse-sumo`, where SUMO_HOME and PATH name none.
_sumo = importlib.util.find_spec("sumo")
for _folder in (_sumo.submodule_search_locations or []) if _sumo else []:
    _native.also_look_in(os.path.dirname(_folder))

_open: weakref.WeakSet[Any] = weakref.WeakSet()


@atexit.register
def _close_all() -> None:
    try:
        for environment in list(_open):
            # One in which another thread is at work refuses; its SUMO ends with this process.
            with contextlib.suppress(Error):
                environment.close()
    finally:
        _native.silence()


def parallel_env(
    scenario: str | os.PathLike[str],
    agents: int | None = None,
    *,
    seed: int | None = None,
    render_mode: str | None = None,
    overrides: Mapping[str, Any] | None = None,
    timeout: float = 20.0,
    audit: bool = False,
) -> VehicleEnv:
    """Returns one world as a PettingZoo ``ParallelEnv``.

    Args:
        scenario: name of a scenario of the package (:func:`scenarios`), or path of a scenario file.
        agents: number of vehicles; the scenario's default without it.
        seed: stream of episodes until :meth:`VehicleEnv.reset` gets another; without it, one is drawn at the first reset.
        render_mode: ``"html"``, ``"svg"`` or ``"rgb_array"`` records episodes for :meth:`VehicleEnv.render`.
        overrides: other values of the scenario's settings, such as ``{"observation.neighbours": 2}``;
            :func:`settings` lists them. None leaves a setting as the scenario has it.
        timeout: longest wait for an answer of SUMO [s].
        audit: whether SUMO looks for collisions on junctions as well, for comparison with the environment's own test.

    Raises:
        ScenarioError: if the scenario cannot be used, or not with this number of agents.
    """
    environment = VehicleEnv(
        scenario,
        agents,
        seed=seed,
        render_mode=render_mode,
        overrides=overrides,
        timeout=timeout,
        audit=audit,
    )
    _open.add(environment)
    return environment


def env(scenario: str | os.PathLike[str], agents: int | None = None, **options: Any) -> Any:
    """Returns one world as a PettingZoo ``AECEnv``; the arguments are those of :func:`parallel_env`."""
    from pettingzoo.utils import parallel_to_aec

    return parallel_to_aec(parallel_env(scenario, agents, **options))


def vec_env(
    scenario: str | os.PathLike[str],
    num_envs: int = 16,
    agents: int | None = None,
    *,
    seed: int | None = None,
    copy: bool = True,
    overrides: Mapping[str, Any] | None = None,
    processes: int = 0,
    timeout: float = 20.0,
    audit: bool = False,
) -> VecEnv:
    """Returns many worlds in lock-step, with NumPy arrays for all of them.

    Args:
        scenario: name of a scenario of the package (:func:`scenarios`), or path of a scenario file.
        num_envs: number of worlds E.
        agents: number of vehicles N of each; the scenario's default without it.
        seed: stream of episodes until :meth:`VecEnv.reset` gets another; without it, one is drawn at the first reset.
        copy: whether each step returns new arrays; without it, the next step overwrites them, which saves time.
        overrides: as for :func:`parallel_env`.
        processes: number of SUMO processes, 0 for one per core. Results do not depend on it.
        timeout: as for :func:`parallel_env`.
        audit: as for :func:`parallel_env`.

    Raises:
        ScenarioError: if the scenario cannot be used, or not with this number of agents.
    """
    environment = VecEnv(
        scenario,
        num_envs,
        agents,
        seed=seed,
        copy=copy,
        overrides=overrides,
        processes=processes,
        timeout=timeout,
        audit=audit,
    )
    _open.add(environment)
    return environment
