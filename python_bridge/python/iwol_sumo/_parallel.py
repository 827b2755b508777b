"""One world as a PettingZoo environment."""

from __future__ import annotations

import html
import json
import os
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils import EzPickle
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from . import _native
from ._arguments import drawn_seed, optional_seed, whole
from ._scenarios import load_task
from ._vec import Feature, Frame, box
from .errors import ArgumentError, Error


def _info(
    slot: int, comm: NDArray[np.float32], outcome: list[bool], interrupted: bool
) -> dict[str, Any]:
    """Returns an agent's info, which always has the same entries."""
    arrived, crashed, out_of_road = outcome
    return {
        "slot": slot,
        "comm": comm,
        "arrived": arrived,
        "crashed": crashed,
        "out_of_road": out_of_road,
        "interrupted": interrupted,
    }


class Observations(dict[str, NDArray[np.float32]]):
    """Observations of the agents that are live.

    TorchRL looks those of all possible agents up at a reset, and gets zeros for the others.
    """

    def __init__(self, observations: dict[str, NDArray[np.float32]], width: int) -> None:
        super().__init__(observations)
        self.width = width

    def __missing__(self, agent: str) -> NDArray[np.float32]:
        return np.zeros(self.width, np.float32)


class Infos(dict[str, dict[str, Any]]):
    """Infos of the agents that are live, as :class:`Observations` has their observations."""

    def __init__(self, infos: dict[str, dict[str, Any]], slots: int) -> None:
        super().__init__(infos)
        self.slots = slots

    def __missing__(self, agent: str) -> dict[str, Any]:
        return _info(-1, np.zeros(self.slots, np.float32), [False] * 3, False)


class VehicleEnv(ParallelEnv, EzPickle):
    """One world of a scenario, in which each vehicle is an agent.

    Agents are called ``vehicle_0``, ``vehicle_1``, …. An agent that arrives, crashes or goes off-road is terminated; an
    agent that is on the road at the horizon is truncated. No agent comes back within an episode. Where agents come from
    route files, each vehicle that departs is an agent with a name of its own.

    The environment can be pickled and copied; a copy starts a SUMO of its own with its first :meth:`reset`, and draws a
    seed of its own unless the environment was made with one.
    """

    def __init__(
        self,
        scenario: str | os.PathLike[str],
        agents: int | None = None,
        *,
        seed: int | None = None,
        render_mode: str | None = None,
        overrides: Mapping[str, Any] | None = None,
        timeout: float = 20.0,
        audit: bool = False,
    ) -> None:
        """Prepares the world; see :func:`iwol_sumo.parallel_env`."""
        EzPickle.__init__(
            self,
            os.fspath(scenario),
            agents,
            seed=seed,
            render_mode=render_mode,
            overrides=overrides,
            timeout=timeout,
            audit=audit,
        )
        task = load_task(scenario, agents, overrides)
        self.metadata: dict[str, Any] = {
            "name": "iwol_sumo_v0",
            "render_modes": ["html", "rgb_array", "svg"],
            "is_parallelizable": True,
            "render_fps": round(1.0 / task.interval),
        }
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ArgumentError(f"render_mode {render_mode!r} is none of 'html', 'rgb_array', 'svg', None")
        self.render_mode = render_mode
        self._env = _native.NativeEnv(task, 1, 1, timeout, audit)
        self._first_seed = optional_seed(seed)
        self._seed: int | None = None
        self._episode = 0
        self._slots = task.agents
        self.features = [Feature(*row) for row in task.observation]
        """The numbers of an observation."""
        self.state_features = [Feature(*row) for row in task.state]
        """The numbers of one agent's row of :meth:`state`."""
        self.actions = list(task.actions)
        """Names of the numbers of an action, each in -1..1."""
        self.possible_agents = [f"vehicle_{i}" for i in range(task.most_agents)]
        self.agents: list[str] = []
        space, action = box(self.features), Box(-1.0, 1.0, (len(self.actions),), np.float32)
        self.observation_spaces = dict.fromkeys(self.possible_agents, space)
        self.action_spaces = dict.fromkeys(self.possible_agents, action)
        row = box(self.state_features)
        self.state_space = Box(
            np.tile(row.low, (self._slots, 1)), np.tile(row.high, (self._slots, 1)), dtype=np.float32
        )
        self.last_episode: dict[str, Any] | None = None
        """Record of the last episode that ended: success, safety, reward, …; the fields are those of ``iwol evaluate``."""
        self._frame = Frame.empty(1, self._slots, len(self.features), len(self.state_features))
        self._actions = np.zeros((1, self._slots, len(self.actions)), np.float32)
        # Name of the agent that has each slot, and number of agents so far.
        self._names: list[str | None] = [None] * self._slots
        self._known = 0
        # Slot and name of the agents that are live.
        self._live: list[tuple[int, str]] = []
        self._ended = False
        # Whether a step or a reset has begun and not ended, because of an error or Ctrl-C.
        self._broken = False
        self._closed = False

    @property
    def episode_seed(self) -> int | None:
        """Seed of the present stream of episodes; None before the first :meth:`reset`."""
        return self._seed

    def observation_space(self, agent: str) -> Box:
        """Returns the space of an agent's observations, always the same object."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Box:
        """Returns the space of an agent's actions, always the same object."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[np.float32]], dict[str, dict[str, Any]]]:
        """Starts an episode.

        Args:
            seed: stream of episodes, which starts with its first one; without it, the next episode of the present stream.
                The first reset without one draws a seed, unless the environment was made with one.
            options: ``{"episode": k}`` starts episode k of the stream. Other entries are ignored.

        Returns:
            Observations and infos of the agents that are live.
        """
        given = optional_seed(seed)
        stream, episode = (self._seed, self._episode + 1) if given is None else (given, 0)
        if stream is None:
            stream, episode = (drawn_seed() if self._first_seed is None else self._first_seed), 0
        episode = whole("episode", (options or {}).get("episode", episode), high=2**63 - 1)
        self._broken = True
        self._env.start(stream, episode, self.render_mode is not None, self._frame)
        self._seed, self._episode = stream, episode
        self._names, self._known, self._ended = [None] * self._slots, 0, False
        self._await_agents()
        self._broken = self._closed = False
        observations = {name: self._frame.observation[0, slot].copy() for slot, name in self._live}
        return Observations(observations, len(self.features)), Infos(self._infos(self._live), self._slots)

    def step(self, actions: Mapping[str, Any]) -> tuple[
        dict[str, NDArray[np.float32]],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Performs one decision of the agents that are live.

        Actions of agents that are gone are ignored. After the end of the episode the result is five empty dictionaries.

        Raises:
            Error: if a live agent has no action, its action has a wrong shape or is NaN, or a name is unknown.
            SumoError: if SUMO failed twice.
        """
        if self._seed is None or self._closed:
            raise Error("step() before reset(), or after close(): call reset() first")
        if self._broken:
            raise Error("a step was interrupted, or ended with an error, so that the episode cannot go on: call reset()")
        if not self.agents:
            return {}, {}, {}, {}, {}
        if not actions.keys() <= self.observation_spaces.keys():
            unknown = next(iter(actions.keys() - self.observation_spaces.keys()))
            raise ArgumentError(f"there is no agent {unknown!r}; agents are {self.possible_agents[0]} to {self.possible_agents[-1]}")
        before = self._live
        given, shape = self._actions[0], (len(self.actions),)
        for slot, name in before:
            if name not in actions:
                raise ArgumentError(f"{name} is live and has no action")
            action = actions[name]
            if not isinstance(action, np.ndarray):
                action = np.asarray(action, np.float32)
            if action.shape != shape:
                raise ArgumentError(f"the action of {name} has the shape {action.shape} instead of {shape}")
            given[slot] = action
        if np.isnan(given).any():
            name = next(name for slot, name in before if np.isnan(given[slot]).any())
            given.fill(0.0)
            raise ArgumentError(f"the action of {name} is NaN")
        self._broken = True
        self._decide()
        frame = self._frame
        # A copy of all rows at once is quicker than one for each agent.
        observation, infos = frame.observation[0].copy(), self._infos(before)
        reward, terminated, truncated = (
            array[0].tolist() for array in (frame.reward, frame.terminated, frame.truncated)
        )
        observations, rewards, terminations, truncations = {}, {}, {}, {}
        for slot, name in before:
            observations[name] = observation[slot]
            rewards[name] = reward[slot]
            terminations[name] = terminated[slot]
            truncations[name] = truncated[slot]
            if terminated[slot] or truncated[slot]:
                self._names[slot] = None
        new = self._await_agents()
        infos.update(self._infos(new))
        for slot, name in new:
            observations[name] = frame.observation[0, slot].copy()
            rewards[name], terminations[name], truncations[name] = 0.0, False, False
        self._broken = False
        return observations, rewards, terminations, truncations, infos

    def _decide(self) -> None:
        """Performs a step with the present actions."""
        if self._env.step(self._actions, self._frame):
            [(_, record)] = self._env.finished()
            self.last_episode = json.loads(record)
            self._ended = True

    def _await_agents(self) -> list[tuple[int, str]]:
        """Returns slot and name of the agents that have come to be on the road.

        Steps in which nobody is there to act, because agents of route files are still to come, are taken at once.
        """
        active = self._frame.active[0].tolist()
        while not (self._ended or any(active)):
            self._decide()
            active = self._frame.active[0].tolist()
        start = self._frame.start[0].tolist()
        new = []
        for slot, name in enumerate(self._names):
            if active[slot] and (start[slot] or name is None):
                self._names[slot] = name = self.possible_agents[self._known]
                self._known += 1
                new.append((slot, name))
        self._live = [(slot, name) for slot, name in enumerate(self._names) if name is not None]
        self.agents = [name for _, name in self._live]
        return new

    def _infos(self, agents: list[tuple[int, str]]) -> dict[str, dict[str, Any]]:
        """Returns the infos of agents, given by slot and name."""
        comm, outcome = self._frame.comm[0].copy(), self._frame.outcome[0].tolist()
        interrupted = bool(self._frame.interrupted[0])
        return {name: _info(slot, comm[slot], outcome[slot], interrupted) for slot, name in agents}

    def state(self) -> NDArray[np.float32]:
        """Returns the privileged state ``[N, S]``.

        Each slot has a row, zeros where nobody is; ``infos[agent]["slot"]`` is the row of an agent.
        """
        return self._frame.state[0].copy()

    def render(self) -> str | NDArray[np.uint8] | None:
        """Returns the episode so far, as `render_mode` says.

        ``"html"``: a page that plays it; ``"svg"``: a picture of the present step; ``"rgb_array"``: the same picture as
        pixels ``[H, W, 3]``, 900 wide, without the vehicles' numbers. None before the first reset.

        Raises:
            Error: without `render_mode`, and after :meth:`close`, with which the recording ends.
        """
        if self.render_mode is None:
            raise Error('nothing is recorded: make the environment with render_mode="html", "svg" or "rgb_array"')
        if self._closed:
            raise Error("the recording has ended with close(): call render() before it")
        if self.render_mode == "rgb_array":
            return self._env.pixels()
        return self._env.render(self.render_mode == "html")

    def _repr_html_(self) -> str:
        """Returns the present step's picture for notebooks, if the episode is recorded."""
        recorded = self.render_mode is not None and not self._closed
        picture = self._env.render(False) if recorded else None
        return picture or f"<pre>{html.escape(repr(self))}</pre>"

    def save_replay(self, path: str | os.PathLike[str]) -> None:
        """Writes the episode so far to a file that ``iwol replay`` turns into a player."""
        if self._closed:
            raise Error("the recording has ended with close(): call save_replay() before it")
        if not self._env.save_recording(os.fspath(path)):
            raise Error("nothing is recorded: make the environment with render_mode, and step it first")

    def close(self) -> None:
        """Ends SUMO. Nothing happens if it does not run."""
        self._env.close()
        self._closed = True
        self.agents = []

    def __enter__(self) -> VehicleEnv:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
