"""Policies that ``iwol train`` has trained, in PyTorch.

The methods are those of which a vehicle decides by itself or by one exchange of messages: MAPPO, Im-IWoL, Ex-IWoL, MADDPG
and MADDPG with IWoL, with the encoder ``mlp``.
"""

from __future__ import annotations

import json
import os
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from . import _policy
from .errors import Error


class Policy(_policy.Policy):
    """A trained policy, a ``torch.nn.Module``: from observations ``[..., N, O]`` to mean actions ``[..., N, A]`` in -1..1.

    Where actions are discrete, it returns logits ``[..., N, K]``.

    Called with NumPy arrays, as :func:`iwol_sumo.evaluate` does, it returns a NumPy array.
    """

    algorithm: str
    """Name of the method."""
    description: dict[str, Any]
    """What an exported folder's ``policy.json`` or a run's checkpoint says of the task and its numbers."""

    def __call__(self, observation: Any, comm: Any, *_: NDArray[np.bool_]) -> Any:
        if isinstance(observation, Tensor):
            return super().__call__(observation, comm)
        weight = next(self.parameters())
        with torch.no_grad():
            inputs = (torch.from_numpy(array).to(weight) for array in (observation, comm))
            return super().__call__(*inputs).cpu().numpy()


def load_policy(path: str | os.PathLike[str]) -> Policy:
    """Loads a policy that ``iwol train`` or ``iwol export`` has written.

    Args:
        path: run folder (its best checkpoint, or its last one where none is the best), exported folder, or checkpoint
            file.

    Raises:
        Error: if the file cannot be read, or its method or encoder is none of those that this module has.
    """
    try:
        policy = Policy(os.fspath(path)).eval()
        folder = Path(path) if os.path.isdir(path) else Path(path).parent
        file = folder / "policy.json"
        policy.description = json.loads(file.read_text()) if file.is_file() else described(policy.metadata)
        return policy
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        raise Error(f"cannot load the policy {os.fspath(path)!r}: {error}") from error


def described(metadata: dict[str, str]) -> dict[str, Any]:
    """Returns what a checkpoint says of its task, in the form of ``policy.json``, as far as it says it.

    Warns if the policy was trained with a radio that is not perfect: here, every message arrives.
    """
    config = metadata.get("config", "")

    def setting(group: str, name: str) -> str | None:
        part = re.search(rf"^\[{re.escape(group)}\]$(.*?)(?=^\[|\Z)", config, re.M | re.S)
        found = re.search(rf"^{name} = (\S+)", part[1], re.M) if part else None
        return found[1] if found else None

    disturbed = [name for name in ("loss", "delay", "falsified") if float(setting("channel", name) or 0)]
    if disturbed or int(setting("channel", "bits") or 32) < 32:
        warnings.warn(
            "the policy was trained with a radio that is not perfect ([channel]); here, every message arrives unchanged",
            stacklevel=3,
        )
    description: dict[str, Any] = {}
    if names := json.loads(metadata.get("features", "[]")):
        description["observation"] = [{"name": name} for name in names]
    if interval := setting("scenario.control", "interval"):
        description["interval"] = float(interval)
    if interval:
        # Checkpoints without this setting are from before it, when the unit was 50 m.
        description["distance_scale"] = float(setting("scenario.observation", "distanceScale") or 50)
    return description
