"""Policies that ``iwol train`` has trained, in PyTorch.

The methods are those of which a vehicle decides by itself or by one exchange of messages: MAPPO, Im-IWoL, Ex-IWoL, MADDPG
and MADDPG with IWoL, with the encoder ``mlp``.
"""

from __future__ import annotations

import json
import os
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
    """What ``policy.json`` says of method, task and numbers; empty without that file."""

    def __call__(self, observation: Any, comm: Any, *_: NDArray[np.bool_]) -> Any:
        if isinstance(observation, Tensor):
            return super().__call__(observation, comm)
        with torch.no_grad():
            return super().__call__(torch.from_numpy(observation), torch.from_numpy(comm)).numpy()


def load_policy(path: str | os.PathLike[str]) -> Policy:
    """Loads a policy that ``iwol train`` or ``iwol export`` has written.

    Args:
        path: run folder (its best checkpoint), exported folder, or checkpoint file.

    Raises:
        Error: if the file cannot be read, or its method or encoder is none of those that this module has.
    """
    try:
        policy = Policy(os.fspath(path)).eval()
        folder = Path(path) if os.path.isdir(path) else Path(path).parent
        file = folder / "policy.json"
        policy.description = json.loads(file.read_text()) if file.is_file() else {}
        return policy
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        raise Error(f"cannot load the policy {os.fspath(path)!r}: {error}") from error
