"""Scenarios that are made, checked and drawn, as ``iwol scenario`` does it.

>>> import iwol_sumo
>>> print(iwol_sumo.scenario.check("intersection").ok)
True

Files are written below the folder `root`: the scenario in ``scenarios``, its net in ``sumo_nets``. Errors are
:class:`~iwol_sumo.ScenarioError`, with the program's messages; no file is left behind then.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from . import _native
from ._arguments import whole
from ._scenarios import scenario_file
from .errors import ScenarioError

__all__ = [
    "Candidate",
    "Check",
    "Finding",
    "Imported",
    "check",
    "import_net",
    "import_osm",
    "import_sumocfg",
    "new",
    "show",
]


@dataclass(frozen=True)
class Finding:
    """An error or a warning of :func:`check`."""

    severity: str
    """``"error"`` or ``"warning"``."""
    kind: str
    """Name of the rule, such as ``"route"``."""
    file: Path
    """The file that the finding is about."""
    line: int | None
    """Line, from 1; None if the finding has no place in the file."""
    column: int | None
    """Column, from 1."""
    message: str
    """What is wrong."""
    hint: str | None
    """What to do about it."""

    def __str__(self) -> str:
        place = f":{self.line}:{self.column}" if self.line is not None else ""
        hint = f"\n  hint: {self.hint}" if self.hint else ""
        return f"{self.file}{place}: {self.severity}: {self.message}{hint}"


@dataclass(frozen=True)
class Check:
    """Result of :func:`check`."""

    findings: list[Finding]
    """Errors and warnings."""
    trial: dict[str, Any] | None
    """What the trial has shown: ``observation`` with the least and the largest value of each number, ``episodes``,
    ``steps_per_second``, …; None if there was no trial, or SUMO failed in it."""

    @property
    def errors(self) -> list[Finding]:
        """The errors among the findings."""
        return [finding for finding in self.findings if finding.severity == "error"]

    @property
    def ok(self) -> bool:
        """Whether there are no errors; warnings are allowed."""
        return not self.errors


class Candidate(NamedTuple):
    """A junction that an import could have taken."""

    junction: str
    """Id of the junction, or of one junction of a roundabout."""
    kind: str
    """SUMO's type of junction, or ``"roundabout"``."""
    arms: int
    """Number of roads that vehicles come from."""
    routes: int
    """Number of routes over the junction."""
    places: int
    """Number of spawn places."""


@dataclass(frozen=True)
class Imported:
    """Result of an import."""

    scenario: Path
    """The scenario file."""
    candidates: list[Candidate]
    """All possible junctions, the chosen one first. None from a configuration of SUMO, whose whole net is taken."""
    warnings: list[str]
    """Warnings of netconvert."""
    notes: list[str]
    """What the scenario does not have of its map, and what was assumed."""


def new(
    name: str,
    template: str,
    *,
    lanes: int | None = None,
    arm_length: float | None = None,
    agents: int = 8,
    speed: float = 13.889,
    steering: bool = False,
    root: str | os.PathLike[str] = ".",
) -> Path:
    """Writes a scenario from a template, builds its net, and returns the scenario file.

    Args:
        name: name of the scenario and of its files.
        template: ``"cross"``, ``"signals"``, ``"tee"``, ``"roundabout"``, ``"merge"``, ``"grid"``, ``"bottleneck"`` or ``"parking"``.
        lanes: lanes per direction; the fewest that the template allows without it.
        arm_length: least length of the lanes on which vehicles start [m]; what the agents need without it.
        agents: number of vehicles.
        speed: speed limit, and largest speed of vehicles [m/s].
        steering: whether vehicles steer instead of following their lanes. In a parking lot they always do.
        root: folder below which the files are written.

    Raises:
        ScenarioError: if a value is not allowed, or a file exists already.
        SumoError: if netconvert is missing.
    """
    sizes = (_optional("lanes", lanes), arm_length, _count("agents", agents), speed, steering)
    return Path(_native.new_scenario(root, name, template, sizes))


def import_osm(
    file: str | os.PathLike[str],
    name: str,
    *,
    junction: str | None = None,
    agents: int = 8,
    steering: bool = False,
    left_hand: bool = False,
    whole_net: bool = False,
    root: str | os.PathLike[str] = ".",
) -> Imported:
    """Makes a draft scenario of a junction or roundabout of an extract of OpenStreetMap.

    Args:
        file: the extract, as XML.
        name: name of the scenario and of its files.
        junction: id of the junction; the one with the most arms and spawn places without it.
        agents: default number of agents of the scenario, limited by its spawn places.
        steering: whether vehicles steer instead of following their lanes.
        left_hand: whether vehicles drive on the left; they also do if the map says so.
        whole_net: whether all of a large net is kept, and not only what is near the routes.
        root: folder below which the files are written.

    Raises:
        ScenarioError: if there is no such junction, the map cannot be used, or a file exists already.
        SumoError: if netconvert is missing.
    """
    choices = (junction, _count("agents", agents), steering, left_hand, whole_net)
    return _imported(_native.import_map(root, name, file, True, choices))


def import_net(
    file: str | os.PathLike[str],
    name: str,
    *,
    junction: str | None = None,
    agents: int = 8,
    steering: bool = False,
    whole_net: bool = False,
    root: str | os.PathLike[str] = ".",
) -> Imported:
    """Makes a draft scenario of a junction or roundabout of a SUMO net; the arguments are those of :func:`import_osm`."""
    choices = (junction, _count("agents", agents), steering, False, whole_net)
    return _imported(_native.import_map(root, name, file, False, choices))


def import_sumocfg(
    file: str | os.PathLike[str],
    name: str,
    *,
    agents: int | None = None,
    root: str | os.PathLike[str] = ".",
) -> Imported:
    """Makes a scenario of a configuration of SUMO, with its whole net and its demand.

    20 % of the cars are agents. `agents` is the number of slots for them; as many as the demand needs without it. Errors
    and `root` are as for :func:`import_osm`.
    """
    return _imported(_native.import_sumocfg(root, name, file, _optional("agents", agents)))


def _count(name: str, value: int) -> int:
    return whole(name, value, high=2**32 - 1, error=ScenarioError)


def _optional(name: str, value: int | None) -> int | None:
    return None if value is None else _count(name, value)


def _imported(parts: tuple[str | os.PathLike[str], list[tuple[str, str, int, int, int]], list[str], list[str]]) -> Imported:
    scenario, candidates, warnings, notes = parts
    return Imported(Path(scenario), [Candidate(*row) for row in candidates], warnings, notes)


def check(
    scenario: str | os.PathLike[str], agents: int | None = None, *, steps: int = 1000, seed: int = 0
) -> Check:
    """Reads a scenario and its nets, runs a trial of it in SUMO, and returns all errors and warnings.

    Args:
        scenario: name or path, as for :func:`iwol_sumo.parallel_env`.
        agents: number of vehicles of the trial; the scenario's default without it.
        steps: number of steps of the trial. With 0, there is none, and SUMO is not needed.
        seed: seed of the trial.

    Raises:
        ScenarioError: if there is no such file, a number is not allowed, or the trial cannot have this number of agents.
        SumoError: if SUMO is missing.
    """
    trial = (_optional("agents", agents), _count("steps", steps), whole("seed", seed, error=ScenarioError))
    report = json.loads(_native.check_scenario(scenario_file(scenario), *trial))
    findings = [
        Finding(
            severity=row["severity"],
            kind=row["kind"],
            file=Path(row["file"]),
            line=row.get("line"),
            column=row.get("column"),
            message=row["message"],
            hint=row["hint"],
        )
        for row in report["findings"]
    ]
    return Check(findings, report["trial"])


def show(scenario: str | os.PathLike[str], agents: int | None = None, *, format: str = "svg") -> str:
    """Draws the net, the spawn places, the routes, their conflict points, and the radio range of one vehicle.

    Args:
        scenario: name or path, as for :func:`iwol_sumo.parallel_env`.
        agents: number of vehicles, which determines the net; the scenario's default without it.
        format: ``"svg"``, or ``"html"`` for a page with a table of the routes.

    Raises:
        ScenarioError: if the scenario cannot be used, or the format is another one.
    """
    if format not in ("svg", "html"):
        raise ScenarioError(f"the format is {format!r}; allowed: 'svg', 'html'")
    return _native.show_scenario(scenario_file(scenario), _optional("agents", agents), format == "html")
