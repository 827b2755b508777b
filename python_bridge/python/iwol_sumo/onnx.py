"""Policies that ``iwol export RUN --onnx FILE`` has written, by ONNX Runtime."""

from __future__ import annotations

import json
import os
from typing import Any

import numpy as np
import onnxruntime
from numpy.typing import NDArray


class OnnxPolicy:
    """A policy from an ONNX file, for :func:`iwol_sumo.evaluate` or for a loop of your own."""

    def __init__(self, path: str | os.PathLike[str], threads: int = 1) -> None:
        """Loads the file; `threads` is the number of threads of a decision."""
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        self._session = onnxruntime.InferenceSession(os.fspath(path), options, ["CPUExecutionProvider"])
        self._inputs = {entry.name for entry in self._session.get_inputs()}
        metadata = self._session.get_modelmeta().custom_metadata_map
        self.description: dict[str, Any] = json.loads(metadata.get("policy", "{}"))
        """Method, task, and what each number of observations and actions means."""
        self._output = self._session.get_outputs()[0].name

    def __call__(
        self, observation: NDArray[np.float32], comm: NDArray[np.float32] | None = None, *_: Any
    ) -> NDArray[np.float32]:
        """Returns actions ``[B, N, A]`` in -1..1 from observations ``[B, N, O]``; logits ``[B, N, K]`` where actions are discrete.

        Policies with messages also need ``comm [B, N, N]``: 1 where two agents are within radio range, receiver first.
        """
        given = {"observation": observation, "comm": comm}
        return self._session.run([self._output], {name: given[name] for name in self._inputs})[0]
