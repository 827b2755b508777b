"""Policies that ``iwol export RUN --onnx FILE`` has written, by ONNX Runtime."""

from __future__ import annotations

import json
import os
from typing import Any

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from .errors import Error


class OnnxPolicy:
    """A policy from an ONNX file, for :func:`iwol_sumo.evaluate` or for a loop of your own."""

    def __init__(self, path: str | os.PathLike[str], threads: int = 1) -> None:
        """Loads the file; `threads` is the number of threads of a decision.

        Raises:
            Error: if the file cannot be read, or is no model.
        """
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        file, providers = os.fspath(path), ["CPUExecutionProvider"]
        # The exceptions of ONNX Runtime have no class in common.
        try:
            self._session = onnxruntime.InferenceSession(file, options, providers)
            metadata = self._session.get_modelmeta().custom_metadata_map
            description = json.loads(metadata.get("policy", "{}"))
        except Exception as error:
            raise Error(f"cannot load the policy {file!r}: {error}") from error
        self.description: dict[str, Any] = description
        """Method, task, and what each number of observations and actions means."""
        self._inputs = {entry.name for entry in self._session.get_inputs()}
        self._output = self._session.get_outputs()[0].name

    def __call__(
        self, observation: NDArray[np.float32], comm: NDArray[np.float32] | None = None, *_: Any
    ) -> NDArray[np.float32]:
        """Returns actions ``[B, N, A]`` in -1..1 from observations ``[B, N, O]``; logits ``[B, N, K]`` where actions are discrete.

        Policies with messages also need ``comm [B, N, N]``: 1 where two agents are within radio range, receiver first.

        Raises:
            Error: if an input is missing, or has another shape or type.
        """
        given = {"observation": observation, "comm": comm}
        inputs = {name: given.get(name) for name in self._inputs}
        missing = [name for name, array in inputs.items() if array is None]
        if missing:
            raise Error(f"the policy also needs {', '.join(missing)}")
        try:
            return self._session.run([self._output], inputs)[0]
        except Exception as error:
            raise Error(f"the policy cannot be computed: {error}") from error
