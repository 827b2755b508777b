"""Policies that ``iwol train`` has trained, in PyTorch.

The networks have the names of the checkpoint's tensors, so that loading is strict. The methods are those of which a
vehicle decides by itself or by one exchange of messages: MAPPO, Im-IWoL, Ex-IWoL, MADDPG and MADDPG with IWoL.
"""

from __future__ import annotations

import json
import math
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from .errors import Error

HEADS = 4
METHODS = ("mappo", "im-iwol", "ex-iwol", "maddpg", "maddpg-iwol")


class Layer(nn.Module):
    """Linear layer, ReLU, normalisation."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.linear, self.norm = nn.Linear(inputs, outputs), nn.LayerNorm(outputs)

    def forward(self, x: Tensor) -> Tensor:
        return self.norm(self.linear(x).relu())


class Mlp(nn.Module):
    """Perceptron on normalised inputs."""

    def __init__(self, inputs: int, hidden: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(inputs)
        self.layers = nn.ModuleList([Layer(inputs, hidden), Layer(hidden, hidden)])

    def forward(self, x: Tensor) -> Tensor:
        x = self.norm(x)
        for layer in self.layers:
            x = layer(x)
        return x


class Encoder(nn.Module):
    """From an observation ``[..., O]`` to an embedding ``[..., H]``."""

    def __init__(self, inputs: int, hidden: int) -> None:
        super().__init__()
        self.mlp = Mlp(inputs, hidden)

    def forward(self, x: Tensor) -> Tensor:
        return self.mlp(x)


class Head(nn.Module):
    """Mean action, and the logarithm of the standard deviation in training."""

    def __init__(self, inputs: int, actions: int) -> None:
        super().__init__()
        self.mean = nn.Linear(inputs, actions)
        self.log_std = nn.Parameter(torch.zeros(actions))


class CommGraph(nn.Module):
    """Who listens to whom: the most likely graph, cut by the physical mask."""

    def __init__(self, inputs: int, hidden: int, bias: float) -> None:
        super().__init__()
        self.base, self.bias = Mlp(inputs, hidden), bias
        self.receiver, self.sender = (nn.Parameter(torch.zeros(1, hidden)) for _ in range(2))

    def forward(self, f: Tensor, comm: Tensor) -> Tensor:
        base = self.base(f)
        sums = base @ self.receiver.T + (base @ self.sender.T).transpose(-1, -2)
        scores = nn.functional.leaky_relu(sums, 0.2) + self.bias
        eye = torch.eye(comm.shape[-1])
        return (scores > 0).float() * comm * (1 - eye) + eye


class Attention(nn.Module):
    """Self-attention with weights G_ij exp(logit_ij) over a graph G."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.qkv, self.out = nn.Linear(width, 3 * width), nn.Linear(width, width)

    def forward(self, x: Tensor, graph: Tensor) -> Tensor:
        *rows, agents, width = x.shape
        split = self.qkv(x).view(*rows, agents, 3, HEADS, width // HEADS)
        queries, keys, values = (part.transpose(-2, -3) for part in split.unbind(-3))
        logits = queries @ keys.transpose(-1, -2) / math.sqrt(width // HEADS)
        weights = logits.masked_fill(graph.unsqueeze(-3) < 0.5, -math.inf).softmax(-1)
        return self.out((weights @ values).transpose(-2, -3).reshape(*rows, agents, width))


class Block(nn.Module):
    """A round of attention."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.attention, self.attention_norm = Attention(width), nn.LayerNorm(width)
        self.up, self.down, self.mlp_norm = nn.Linear(width, width), nn.Linear(width, width), nn.LayerNorm(width)

    def forward(self, x: Tensor, graph: Tensor) -> Tensor:
        x = self.attention_norm(x + self.attention(x, graph))
        return self.mlp_norm(x + self.down(nn.functional.gelu(self.up(x))))


class Transformer(nn.Module):
    """Rounds of attention over the graph, from embeddings to messages."""

    def __init__(self, inputs: int, width: int, rounds: int) -> None:
        super().__init__()
        self.in_norm, self.input, self.embed_norm = nn.LayerNorm(inputs), nn.Linear(inputs, width), nn.LayerNorm(width)
        self.rounds = nn.ModuleList([Block(width) for _ in range(rounds)])
        self.head, self.head_norm, self.out = nn.Linear(width, width), nn.LayerNorm(width), nn.Linear(width, width)

    def forward(self, f: Tensor, graph: Tensor) -> Tensor:
        x = self.embed_norm(nn.functional.gelu(self.input(self.in_norm(f))))
        for block in self.rounds:
            x = block(x, graph)
        return self.out(self.head_norm(nn.functional.gelu(self.head(x))))


class Trunk(nn.Module):
    """Embeddings and messages."""

    def __init__(self, inputs: int, hidden: int, message: int, rounds: int, bias: float) -> None:
        super().__init__()
        self.encoder, self.graph = Encoder(inputs, hidden), CommGraph(hidden, message, bias)
        self.transformer = Transformer(hidden, message, rounds)

    def forward(self, x: Tensor, comm: Tensor) -> tuple[Tensor, Tensor]:
        f = self.encoder(x)
        return self.transformer(f, self.graph(f, comm)), f


class Policy(nn.Module):
    """A trained policy: from observations ``[..., N, O]`` to mean actions ``[..., N, A]`` in -1..1.

    Called with NumPy arrays, as :func:`iwol_sumo.evaluate` does, it returns a NumPy array.
    """

    algorithm: str
    """Name of the method."""

    def mean(self, observation: Tensor, comm: Tensor) -> Tensor:
        """Returns the mean actions before they are bounded."""
        raise NotImplementedError

    def forward(self, observation: Tensor, comm: Tensor) -> Tensor:
        mean = self.mean(observation, comm)
        return mean.tanh() if self.algorithm.startswith("maddpg") else mean.clamp(-1, 1)

    def __call__(self, observation: Any, comm: Any, *_: NDArray[np.bool_]) -> Any:
        if isinstance(observation, Tensor):
            return super().__call__(observation, comm)
        with torch.no_grad():
            return super().__call__(torch.from_numpy(observation), torch.from_numpy(comm)).numpy()


class Mappo(Policy):
    """The policy of MAPPO and MADDPG."""

    def __init__(self, inputs: int, hidden: int, actions: int) -> None:
        super().__init__()
        self.encoder, self.head = Encoder(inputs, hidden), Head(hidden, actions)

    def mean(self, observation: Tensor, comm: Tensor) -> Tensor:
        return self.head.mean(self.encoder(observation))


class ImIwol(Policy):
    """The policy of Im-IWoL and of MADDPG with IWoL, on its latent and embedding."""

    def __init__(self, inputs: int, hidden: int, latent: int, actions: int) -> None:
        super().__init__()
        self.encoder, self.head = Encoder(inputs, hidden), Head(latent + hidden, actions)
        self.latent = nn.ModuleList([nn.Linear(hidden, hidden // 2), nn.Linear(hidden // 2, latent)])

    def mean(self, observation: Tensor, comm: Tensor) -> Tensor:
        f = self.encoder(observation)
        z = self.latent[1](self.latent[0](f).relu())
        return self.head.mean(torch.cat([z, f], -1))


class ExIwol(Policy):
    """The policy of Ex-IWoL, on messages and embedding."""

    def __init__(self, inputs: int, hidden: int, message: int, rounds: int, bias: float, actions: int) -> None:
        super().__init__()
        self.trunk = Trunk(inputs, hidden, message, rounds, bias)
        self.head = Head(message + hidden, actions)

    def mean(self, observation: Tensor, comm: Tensor) -> Tensor:
        message, f = self.trunk(observation, comm)
        return self.head.mean(torch.cat([message, f], -1))


def read_checkpoint(path: str | os.PathLike[str]) -> tuple[dict[str, NDArray[Any]], dict[str, str]]:
    """Returns the tensors and the metadata of a checkpoint: a file, or the best one of a run folder.

    Raises:
        Error: if it cannot be read.
    """
    file = Path(path)
    file = file / "checkpoints" / "best.safetensors" if file.is_dir() else file
    try:
        data = file.read_bytes()
        size = int.from_bytes(data[:8], "little")
        header = json.loads(data[8 : 8 + size])
    except (OSError, ValueError) as error:
        raise Error(f"cannot read the checkpoint {str(file)!r}: {error}") from error
    metadata = header.pop("__metadata__", {})
    kinds = {"F32": np.float32, "F64": np.float64, "I64": np.int64}
    tensors = {}
    for name, entry in header.items():
        begin, end = entry["data_offsets"]
        values = np.frombuffer(data[8 + size + begin : 8 + size + end], kinds[entry["dtype"]])
        tensors[name] = values.reshape(entry["shape"])
    return tensors, metadata


def load_policy(path: str | os.PathLike[str]) -> Policy:
    """Loads a policy that ``iwol train`` or ``iwol export`` has written.

    Args:
        path: run folder (its best checkpoint), exported folder, or checkpoint file.

    Raises:
        Error: if the file cannot be read, or its method or encoder is none of those that this module has.
    """
    tensors, metadata = read_checkpoint(path)
    # A run's checkpoint has the averaged weights, which act in evaluations, beside those that are trained.
    average = any(name.startswith("learner/actor_average/") for name in tensors)
    prefix = "learner/actor_average/" if average else "learner/actor/"
    # Decoders that only training needs.
    left_out = ("world.", "interaction.")
    names = {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}
    state = {name: torch.tensor(value) for name, value in names.items() if not name.startswith(left_out)}
    algorithm = metadata.get("algorithm", "")
    trunk = "trunk." if algorithm == "ex-iwol" else ""
    first = state.get(f"{trunk}encoder.mlp.layers.0.linear.weight")
    if algorithm not in METHODS or first is None or any(".gru." in name for name in state):
        raise Error(
            f"{str(path)!r} holds {algorithm or 'no method'!r}; allowed: {', '.join(METHODS)}, with the encoder mlp"
        )
    hidden, inputs = first.shape
    actions = len(state["head.log_std"])
    policy: Policy
    if algorithm in ("mappo", "maddpg"):
        policy = Mappo(inputs, hidden, actions)
    elif algorithm in ("im-iwol", "maddpg-iwol"):
        policy = ImIwol(inputs, hidden, len(state["latent.1.bias"]), actions)
    else:
        rounds = {name.split(".")[3] for name in state if name.startswith("trunk.transformer.rounds.")}
        bias = re.search(r"^graph_bias = (\S+)", metadata.get("config", ""), re.M)
        message = len(state["trunk.transformer.out.bias"])
        policy = ExIwol(inputs, hidden, message, len(rounds), float(bias.group(1)) if bias else 0.0, actions)
    policy.load_state_dict(state)
    policy.algorithm = algorithm
    return policy.eval()
