"""Many worlds of one scenario in lock-step, as NumPy arrays."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from . import _native
from ._arguments import drawn_seed, optional_seed, whole
from ._scenarios import load_task
from .errors import ArgumentError, Error

try:
    from gymnasium.vector import AutoresetMode

    NEXT_STEP: Any = AutoresetMode.NEXT_STEP
except ImportError:  # gymnasium 1.0
    NEXT_STEP = "NextStep"


class Feature(NamedTuple):
    """A number of an observation or a privileged state."""

    name: str
    """Name, such as ``"neighbour_0.forward"``."""
    unit: str
    """What one unit of the number means, such as ``"22.2 m/s"``."""
    low: float
    """Smallest value."""
    high: float
    """Largest value."""


class Frame(NamedTuple):
    """What E worlds of N vehicle slots show after a step. Slots without an agent show zeros.

    A slot is *active* if its agent acts in the coming step; the actions of all others are ignored. A sample of a
    trajectory counts where ``active`` was set **before** the step.
    """

    observation: NDArray[np.float32]
    """``[E, N, O]``, each number within the bounds of :attr:`VecEnv.features`."""
    state: NDArray[np.float32]
    """``[E, N, S]``: privileged state as seen from each agent, for critics."""
    comm: NDArray[np.float32]
    """``[E, N, N]``: 1 where two agents are within radio range, receiver first; the diagonal is 1 for agents on the road."""
    reward: NDArray[np.float32]
    """``[E, N]``: each agent's own reward of the last step."""
    active: NDArray[np.bool_]
    """``[E, N]``: whether the slot's agent acts in the coming step."""
    terminated: NDArray[np.bool_]
    """``[E, N]``: whether the last step ended the agent's trajectory by arrival or failure."""
    truncated: NDArray[np.bool_]
    """``[E, N]``: whether the last step truncated the agent's trajectory, at the horizon or because SUMO broke off.
    At the horizon, `iwol train` adds nothing for the time that would follow, except in scenarios whose agents come from
    route files. If SUMO broke off, the value of this frame's observation stands for what would have followed."""
    start: NDArray[np.bool_]
    """``[E, N]``: whether a new trajectory starts in the slot with this frame, so that memories are cleared."""
    interrupted: NDArray[np.bool_]
    """``[E]``: whether SUMO broke off, so that the episode does not count."""
    outcome: NDArray[np.bool_]
    """``[E, N, 3]``: whether the slot's agent arrived, crashed, went off-road; kept until the slot has another agent."""

    @classmethod
    def empty(cls, num_envs: int, agents: int, observation: int, state: int) -> Frame:
        """Returns arrays for a step of `num_envs` worlds, such as :meth:`VecEnv.step` fills."""
        shape = (num_envs, agents)
        return cls(
            observation=np.zeros((*shape, observation), np.float32),
            state=np.zeros((*shape, state), np.float32),
            comm=np.zeros((*shape, agents), np.float32),
            reward=np.zeros(shape, np.float32),
            active=np.zeros(shape, np.bool_),
            terminated=np.zeros(shape, np.bool_),
            truncated=np.zeros(shape, np.bool_),
            start=np.zeros(shape, np.bool_),
            interrupted=np.zeros(num_envs, np.bool_),
            outcome=np.zeros((*shape, 3), np.bool_),
        )


def box(features: list[Feature]) -> Box:
    """Returns the space of vectors of these numbers. Absent agents show zeros, so zero is always within it."""
    low = np.array([min(feature.low, 0.0) for feature in features], np.float32)
    high = np.array([max(feature.high, 0.0) for feature in features], np.float32)
    return Box(low, high, dtype=np.float32)


class VecEnv:
    """E worlds of one scenario in lock-step, each with N vehicle slots.

    Worlds reset themselves as Gymnasium's ``NEXT_STEP`` mode says: the step that ends an episode shows its last
    observations, and the next step ignores that world's actions and shows the first frame of its next episode, with
    rewards 0. World e plays the episodes e, e + E, e + 2E, … of the seed's stream. An episode depends on the seed and its
    number only, and is the one that ``iwol evaluate`` plays with that seed.

    SUMO starts with the first :meth:`reset` and ends with :meth:`close`.
    """

    def __init__(
        self,
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
    ) -> None:
        """Prepares the worlds; see :func:`iwol_sumo.vec_env`."""
        num_envs = whole("num_envs", num_envs, 1, 2**32 - 1)
        processes = whole("processes", processes)
        self._seed = optional_seed(seed)
        task = load_task(scenario, agents, overrides)
        self._env = _native.NativeEnv(task, num_envs, processes, timeout, audit)
        self._copy = copy
        self.num_envs = num_envs
        """Number of worlds E."""
        self.agents = task.agents
        """Number of vehicle slots N of each world."""
        self.scenario = task.name
        """Name of the scenario."""
        self.horizon = task.horizon
        """Steps after which an episode is truncated."""
        self.interval = task.interval
        """Seconds from one decision to the next."""
        self.features = [Feature(*row) for row in task.observation]
        """The O numbers of an observation."""
        self.state_features = [Feature(*row) for row in task.state]
        """The S numbers of a privileged state."""
        self.actions = list(task.actions)
        """Names of the A numbers of an action, each in -1..1."""
        self.single_observation_space = box(self.features)
        self.single_state_space = box(self.state_features)
        self.single_action_space = Box(-1.0, 1.0, (len(self.actions),), np.float32)
        self.metadata: dict[str, Any] = {"autoreset_mode": NEXT_STEP, "render_fps": round(1.0 / self.interval)}
        # None until somebody asks for the records of the last step.
        self._episodes: list[dict[str, Any]] | None = []
        self._frame = self._empty()
        # Number of the stream's first episode that no world has begun.
        self._begun = 0

    def _empty(self) -> Frame:
        return Frame.empty(self.num_envs, self.agents, len(self.features), len(self.state_features))

    def reset(self, seed: int | None = None, options: Mapping[str, Any] | None = None) -> Frame:
        """Starts new episodes in all worlds and returns their first frame.

        Args:
            seed: stream of episodes, from now on, from its first one; 0 to 2⁶⁴ − 1. Without it, the present stream goes
                on with episodes that no world has begun. The first reset without one draws a seed, unless the worlds
                were made with one.
            options: ``{"episode": k}`` lets world e start with episode k + e. Other entries are ignored.

        Raises:
            Error: if `options` has ``"reset_mask"``: worlds reset themselves, and only all of them together.
        """
        if "reset_mask" in (options or {}):
            raise ArgumentError("single worlds cannot be reset (reset_mask): they reset themselves in the step after an episode")
        given = optional_seed(seed)
        first = self._begun if given is None else 0
        episode = whole("episode", (options or {}).get("episode", first), high=2**63 - 1)
        stream = self._seed if given is None else given
        stream = drawn_seed() if stream is None else stream
        frame = self._empty() if self._copy else self._frame
        self._env.start(stream, episode, False, frame)
        self._seed, self._begun = stream, episode + self.num_envs
        self._episodes = []
        return frame

    @property
    def episode_seed(self) -> int | None:
        """Seed of the present stream of episodes; None before the first :meth:`reset` of worlds made without one."""
        return self._seed

    def step(self, actions: NDArray[np.float32], out: Frame | None = None) -> Frame:
        """Performs one decision in all worlds.

        Args:
            actions: ``[E, N, A]``, clipped to -1..1. Those of slots that are not active are ignored.
            out: arrays that receive the result, such as a row of your rollout: C-contiguous, with the types and shapes of
                :meth:`Frame.empty`. Without it, the result is in new arrays, or, if the environment was made with
                ``copy=False``, in arrays that the next step overwrites.

        Raises:
            Error: if the shape is wrong, or an action of an active slot is NaN.
            SumoError: if SUMO failed twice.
        """
        frame = out if out is not None else self._empty() if self._copy else self._frame
        ended = self._env.step(np.asarray(actions, np.float32), frame)
        self._episodes = None if ended else []
        if frame.start.any():
            self._begun = max(self._begun, *(number + 1 for number in self._env.episodes()))
        return frame

    @property
    def episodes(self) -> list[dict[str, Any]]:
        """Records of the episodes that the last step ended, each with the index of its world as ``"env"``."""
        if self._episodes is None:
            self._episodes = [{"env": env, **json.loads(record)} for env, record in self._env.finished()]
        return self._episodes

    def flatten(self) -> FlatVecEnv:
        """Returns these worlds as a Gymnasium ``VectorEnv`` of E·N independent copies, for PPO with shared parameters."""
        return FlatVecEnv(self)

    def close(self) -> None:
        """Ends SUMO. Nothing happens if it does not run."""
        _ = self.episodes
        self._env.close()

    def __enter__(self) -> VecEnv:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class FlatVecEnv(gymnasium.vector.VectorEnv):
    """The slots of a :class:`VecEnv` as E·N environments of one agent each, for PPO with shared parameters.

    Slot n of world e is environment e·N + n. ``infos["active"]`` tells which of them act: leave samples out of the loss
    where it was not set before the step. A slot whose agent has ended stays inactive until its world starts anew, for
    many steps: Gymnasium's wrappers, such as ``RecordEpisodeStatistics``, do not know this, and count those steps to the
    episode of the slot's next agent. ``infos["episodes"]`` has the records of the worlds' episodes.
    """

    def __init__(self, env: VecEnv) -> None:
        """Takes over the worlds."""
        self.env = env
        self.num_envs = env.num_envs * env.agents
        self.metadata = env.metadata
        self.single_observation_space = env.single_observation_space
        self.single_action_space = env.single_action_space
        self.observation_space = gymnasium.vector.utils.batch_space(env.single_observation_space, self.num_envs)
        self.action_space = gymnasium.vector.utils.batch_space(env.single_action_space, self.num_envs)

    def _infos(self, frame: Frame) -> dict[str, Any]:
        state = frame.state.reshape(self.num_envs, -1)
        return {"active": frame.active.reshape(-1), "state": state, "episodes": self.env.episodes}

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Starts new episodes; `seed` is one number for all worlds."""
        if isinstance(seed, list):
            raise Error("give one seed: worlds take different episodes of its stream")
        # Gymnasium closes an environment only once.
        self.closed = False
        frame = self.env.reset(seed, options)
        return frame.observation.reshape(self.num_envs, -1), self._infos(frame)

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[Any], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Performs one decision; `actions` is ``[E·N, A]``."""
        env, actions = self.env, np.asarray(actions)
        if actions.shape != (shape := (self.num_envs, len(env.actions))):
            raise ArgumentError(f"actions have the shape {actions.shape} instead of {shape}")
        frame = env.step(actions.reshape(env.num_envs, env.agents, -1))
        return (
            frame.observation.reshape(self.num_envs, -1),
            frame.reward.reshape(-1),
            frame.terminated.reshape(-1),
            frame.truncated.reshape(-1),
            self._infos(frame),
        )

    def close_extras(self, **_: Any) -> None:
        """Ends SUMO."""
        self.env.close()
