"""Names and files of scenarios."""

from __future__ import annotations

import difflib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from . import _native
from ._arguments import whole
from .errors import ScenarioError

FOLDER = Path(__file__).parent / "data" / "scenarios"


def scenarios() -> list[str]:
    """Returns the names of the scenarios that come with the package."""
    return sorted(file.stem for file in FOLDER.glob("*.xml"))


def scenario_file(scenario: str | os.PathLike[str]) -> Path:
    """Returns the file of a scenario: of a name from :func:`scenarios`, or the path itself.

    Raises:
        ScenarioError: if there is no such scenario.
    """
    file = Path(scenario)
    if file.is_file():
        return file
    names = scenarios()
    if str(scenario) in names:
        return FOLDER / f"{scenario}.xml"
    near = difflib.get_close_matches(str(scenario), names, n=1)
    meant = f"; did you mean {near[0]!r}?" if near else "."
    raise ScenarioError(
        f"there is no scenario {str(scenario)!r}{meant} Give the path of a scenario file, or one of: {', '.join(names)}"
    )


def text_of(value: Any) -> str | None:
    """Returns a value as it is written in a scenario file; None for None."""
    if isinstance(value, (bool, np.bool_)):
        return "true" if value else "false"
    return None if value is None else str(value)


def load_task(
    scenario: str | os.PathLike[str], agents: int | None, overrides: Mapping[str, Any] | None
) -> _native.NativeTask:
    """Prepares a scenario for a number of vehicles; see :func:`iwol_sumo.parallel_env`."""
    agents = None if agents is None else whole("agents", agents, 1, 2**32 - 1)
    pairs = [(name, text_of(value)) for name, value in (overrides or {}).items()]
    return _native.NativeTask(scenario_file(scenario), agents, pairs)


def settings(scenario: str | os.PathLike[str]) -> dict[str, tuple[str | None, str]]:
    """Returns what ``overrides`` may set in a scenario: present value and documentation by name.

    Names are paths in the scenario file, such as ``"observation.neighbours"``.
    """
    rows = _native.overridable(scenario_file(scenario))
    return {name: (value, text) for name, value, text in rows}
