"""A policy that ``iwol train`` has trained, in PyTorch. ``iwol export --pytorch`` puts this file beside the weights.

policy = Policy(".")                # a folder of iwol export, a run folder, or a checkpoint file
action = policy(observation, comm)  # [..., N, O] and [..., N, N] (1: in range) to [..., N, A] in -1..1, or to logits [..., N, K]

policy.json says what the numbers of observations and actions mean. The weights have the names of the checkpoint's tensors.
"""

import json
import re
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional as F

METHODS = ("mappo", "im-iwol", "ex-iwol", "maddpg", "maddpg-iwol")
HEADS = 4
KINDS = {"F32": torch.float32, "F64": torch.float64, "I64": torch.int64}


def read(path: str | Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Returns the policy's tensors and the metadata of a safetensors checkpoint. Raises OSError or ValueError."""
    file = Path(path)
    if file.is_dir():
        names = ("policy.safetensors", "checkpoints/best.safetensors", "checkpoints/last.safetensors")
        file = next((file / name for name in names if (file / name).is_file()), file / names[1])
    data = bytearray(file.read_bytes())
    begin = 8 + int.from_bytes(data[:8], "little")
    header = json.loads(data[8:begin])
    metadata, tensors = header.pop("__metadata__", {}), {}
    if len(data) != begin + max(entry["data_offsets"][1] for entry in header.values()):
        raise ValueError("the file is not complete")
    for name, entry in ((name, entry) for name, entry in header.items() if name.startswith("learner/actor")):
        first, last = (begin + offset for offset in entry["data_offsets"])
        tensors[name] = torch.frombuffer(data[first:last], dtype=KINDS[entry["dtype"]]).reshape(entry["shape"])
    return tensors, metadata


class Policy(nn.Module):
    """From observations to mean actions, or to the logits of choices. Raises OSError or ValueError for what it cannot load."""

    def __init__(self, path: str | Path) -> None:
        super().__init__()
        tensors, self.metadata = read(path)
        # A run's checkpoint has the averaged weights, which act in evaluations, beside those that are trained.
        prefix = "learner/actor_average/" if any("/actor_average/" in name for name in tensors) else "learner/actor/"
        # Decoders of the world and of interactions serve training only.
        named = ((name[len(prefix) :].removeprefix("trunk."), t) for name, t in tensors.items() if name.startswith(prefix))
        weights = {name.replace(".", "/"): t for name, t in named if not name.startswith(("world.", "interaction."))}
        self.algorithm = self.metadata.get("algorithm", "no method")
        if self.algorithm not in METHODS or "encoder/mlp/layers/0/linear/weight" not in weights or any("gru" in name for name in weights):
            raise ValueError(f"it holds {self.algorithm!r}; allowed: {', '.join(METHODS)}, with the encoder mlp, without memory")
        self.weights = nn.ParameterDict({name: nn.Parameter(tensor.clone()) for name, tensor in weights.items()})
        self.graph_bias = float((re.search(r"^graph_bias = (\S+)", self.metadata.get("config", ""), re.M) or ("", 0))[1])
        self.rounds = len({name.split("/")[2] for name in weights if name.startswith("transformer/rounds/")})

    def forward(self, observation: Tensor, comm: Tensor) -> Tensor:
        x = f = self.mlp("encoder/mlp", observation)
        if self.algorithm in ("im-iwol", "maddpg-iwol"):
            x = torch.cat([self.linear("latent/1", self.linear("latent/0", f).relu()), f], -1)
        elif self.algorithm == "ex-iwol":
            x = torch.cat([self.message(f, self.edges(f, comm)), f], -1)
        if "head/logits/weight" in self.weights:
            return self.linear("head/logits", x)
        mean = self.linear("head/mean", x)
        return mean.tanh() if self.algorithm.startswith("maddpg") else mean.clamp(-1, 1)

    def linear(self, name: str, x: Tensor) -> Tensor:
        return F.linear(x, self.weights[f"{name}/weight"], self.weights[f"{name}/bias"])

    def norm(self, name: str, x: Tensor) -> Tensor:
        return F.layer_norm(x, x.shape[-1:], self.weights[f"{name}/weight"], self.weights[f"{name}/bias"])

    def mlp(self, name: str, x: Tensor) -> Tensor:
        x = self.norm(f"{name}/norm", x) if f"{name}/norm/weight" in self.weights else x
        for layer in (f"{name}/layers/0", f"{name}/layers/1"):
            x = self.norm(f"{layer}/norm", self.linear(f"{layer}/linear", x).relu())
        return x

    def edges(self, f: Tensor, comm: Tensor) -> Tensor:
        """Returns who listens to whom ``[..., N, N]``: the most likely graph, cut by the physical mask."""
        receivers, senders = (self.mlp("graph/base", f) @ self.weights[f"graph/{end}"].T for end in ("receiver", "sender"))
        scores = F.leaky_relu(receivers + senders.transpose(-1, -2), 0.2) + self.graph_bias
        return ((scores > 0) & (comm > 0.5)) | torch.eye(comm.shape[-1], dtype=torch.bool, device=comm.device)

    def message(self, f: Tensor, edges: Tensor) -> Tensor:
        """Returns the messages ``[..., N, D]`` after the rounds of attention over the graph."""
        x = self.norm("transformer/embed_norm", F.gelu(self.linear("transformer/input", self.norm("transformer/in_norm", f))))
        for name in (f"transformer/rounds/{number}" for number in range(self.rounds)):
            x = self.norm(f"{name}/attention_norm", x + self.attention(f"{name}/attention", x, edges))
            x = self.norm(f"{name}/mlp_norm", x + self.linear(f"{name}/down", F.gelu(self.linear(f"{name}/up", x))))
        return self.linear("transformer/out", self.norm("transformer/head_norm", F.gelu(self.linear("transformer/head", x))))

    def attention(self, name: str, x: Tensor, edges: Tensor) -> Tensor:
        qkv = self.linear(f"{name}/qkv", x).unflatten(-1, (3, HEADS, -1))
        queries, keys, values = (part.transpose(-2, -3) for part in qkv.unbind(-3))
        heard = F.scaled_dot_product_attention(queries, keys, values, edges.unsqueeze(-3))
        return self.linear(f"{name}/out", heard.transpose(-2, -3).flatten(-2))
