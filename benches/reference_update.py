"""One PPO update of IWoL or MAPPO in plain PyTorch: the same networks, losses and batch as `iwol bench update`.

Written the way a PyTorch user would (modules, torch.optim.Adam, clip_grad_norm_), from the paper's equations and the released
code's layout (DongsuLeeTech/IWoL, marlbenchmark/on-policy). One thing it does not do, as code in this style does not: leave agents
who are gone out of the message path. `iwol bench update --reference PYTHON` runs it in turn with the
Rust program and compares; PYTHON is one that has torch, e.g. of a virtual environment.

Prints the milliseconds of each update as a JSON list.
"""
import argparse
import json
import time

import torch
from torch import nn
from torch.nn import functional as F


def orthogonal(layer, gain):
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer


class Encoder(nn.Module):
    """MAPPO's MLPBase: LN, then two of linear, ReLU, LN."""

    def __init__(self, inputs, hidden):
        super().__init__()
        gain = 2**0.5
        self.layers = nn.Sequential(
            nn.LayerNorm(inputs),
            orthogonal(nn.Linear(inputs, hidden), gain), nn.ReLU(), nn.LayerNorm(hidden),
            orthogonal(nn.Linear(hidden, hidden), gain), nn.ReLU(), nn.LayerNorm(hidden),
        )

    def forward(self, x):
        return self.layers(x)


class Graph(nn.Module):
    """Additive attention on pairs, hard Gumbel-softmax with given noise, straight-through gradient."""

    def __init__(self, inputs, hidden, slope=0.2):
        super().__init__()
        self.base = Encoder(inputs, hidden)
        self.receiver = nn.Linear(hidden, 1, bias=False)
        self.sender = nn.Linear(hidden, 1, bias=False)
        self.slope = slope

    def forward(self, f, physical, noise):
        h = self.base(f)
        scores = F.leaky_relu(self.receiver(h) + self.sender(h).transpose(1, 2), self.slope) + noise
        soft = torch.sigmoid(scores)
        graph = ((scores > 0).float() + soft - soft.detach()) * physical
        eye = torch.eye(f.shape[1])
        return graph * (1 - eye) + eye


class Block(nn.Module):
    def __init__(self, width, heads):
        super().__init__()
        self.heads = heads
        self.qkv = orthogonal(nn.Linear(width, 3 * width), 0.01)
        self.out = orthogonal(nn.Linear(width, width), 0.01)
        self.attention_norm = nn.LayerNorm(width)
        self.mlp = nn.Sequential(
            orthogonal(nn.Linear(width, width), 2**0.5), nn.GELU(), orthogonal(nn.Linear(width, width), 0.01)
        )
        self.mlp_norm = nn.LayerNorm(width)

    def forward(self, x, bias):
        b, n, w = x.shape
        q, k, v = self.qkv(x).view(b, n, 3, self.heads, w // self.heads).permute(2, 0, 3, 1, 4)
        weights = torch.softmax(q @ k.transpose(-2, -1) / (w // self.heads) ** 0.5 + bias, -1)
        x = self.attention_norm(x + self.out((weights @ v).transpose(1, 2).reshape(b, n, w)))
        return self.mlp_norm(x + self.mlp(x))


class Messages(nn.Module):
    """Encoder, learned graph, rounds of attention over it."""

    def __init__(self, inputs, hidden, width, rounds, heads):
        super().__init__()
        self.encoder = Encoder(inputs, hidden)
        self.graph = Graph(hidden, width)
        self.input = nn.Sequential(
            nn.LayerNorm(hidden), orthogonal(nn.Linear(hidden, width), 2**0.5), nn.GELU(), nn.LayerNorm(width)
        )
        self.blocks = nn.ModuleList(Block(width, heads) for _ in range(rounds))
        self.head = nn.Sequential(
            orthogonal(nn.Linear(width, width), 2**0.5), nn.GELU(), nn.LayerNorm(width),
            orthogonal(nn.Linear(width, width), 0.01),
        )

    def forward(self, obs, physical, noise):
        f = self.encoder(obs)
        graph = self.graph(f, physical, noise)
        bias = (graph - 1).masked_fill(graph <= 0.5, float("-inf")).unsqueeze(1)
        x = self.input(f)
        for block in self.blocks:
            x = block(x, bias)
        return self.head(x), f


def decoder(inputs, hidden, outputs):
    return nn.Sequential(
        orthogonal(nn.Linear(inputs, hidden), 1.0), nn.ReLU(),
        orthogonal(nn.Linear(hidden, hidden), 1.0), nn.ReLU(),
        orthogonal(nn.Linear(hidden, outputs), 0.01),
    )


class Actor(nn.Module):
    def __init__(self, a):
        super().__init__()
        self.algorithm = a.algorithm
        h, d = a.hidden, a.latent
        if a.algorithm == "ex-iwol":
            self.messages = Messages(a.observation, h, a.message, a.rounds, a.heads)
            self.world = decoder(a.message, h, a.state)
        else:
            self.encoder = Encoder(a.observation, h)
        if a.algorithm == "im-iwol":
            self.latent = nn.Sequential(nn.Linear(h, h // 2), nn.ReLU(), nn.Linear(h // 2, d))
            self.world, self.interaction = decoder(d, h, a.state), decoder(d, h, a.message)
        self.mean = orthogonal(nn.Linear({"mappo": h, "im-iwol": h + d, "ex-iwol": h + a.message}[a.algorithm], 1), 0.01)
        self.log_std = nn.Parameter(torch.zeros(1), requires_grad=False)


class Critic(nn.Module):
    def __init__(self, a):
        super().__init__()
        self.algorithm = a.algorithm
        if a.algorithm == "mappo":
            self.encoder = Encoder(a.observation + a.state, a.hidden)
            self.value = orthogonal(nn.Linear(a.hidden, 1), 1.0)
        else:
            self.messages = Messages(a.observation, a.hidden, a.message, a.rounds, a.heads)
            self.value = orthogonal(nn.Linear(a.hidden + a.message, 1), 1.0)

    def forward(self, obs, state, physical, noise, use=None):
        """Values of all agents, or for MAPPO of those in use alone."""
        if self.algorithm == "mappo":
            x = torch.cat([obs, state], -1)
            return self.value(self.encoder(x if use is None else x[use])).squeeze(-1), None
        m, f = self.messages(obs, physical, noise)
        return self.value(torch.cat([m, f], -1)).squeeze(-1), m


def huber(e, delta=10.0):
    return torch.where(e.abs() <= delta, e * e / 2, delta * (e.abs() - delta / 2))


def update(a, actor, critic, optimisers, data):
    rows = a.steps * a.envs
    with torch.no_grad():
        values = critic(data["obs"], data["state"], data["comm"], data["noise"])[0]
        v = values.view(a.steps + 1, a.envs, a.agents)
        active = data["active"].view(a.steps, a.envs, a.agents)
        reward, terminated = data["reward"].view_as(active), data["terminated"].view_as(active)
        advantage, chain = torch.zeros_like(active), torch.zeros_like(active[0])
        for t in reversed(range(a.steps)):
            going = 1 - terminated[t]
            chain = (reward[t] + 0.99 * v[t + 1] * going - v[t] + 0.99 * 0.95 * going * chain) * active[t]
            advantage[t] = chain
        returns = (advantage + v[:-1]).view(rows, a.agents)
        advantage = advantage.view(rows, a.agents)
        chosen = data["active"] > 0
        advantage = (advantage - advantage[chosen].mean()) / (advantage[chosen].std() + 1e-5)
    count = -(-rows * a.agents // a.minibatch)
    for _ in range(a.epochs):
        for index in torch.randperm(rows).chunk(count):
            use = data["active"][index] > 0
            obs, state = data["obs"][index], data["state"][index]
            comm = data["comm"][index]
            value, message = critic(obs, state, comm, data["noise"][index], use)
            value = value if message is None else value[use]
            old, target = values[index][use], returns[index][use]
            clipped = old + (value - old).clamp(-0.2, 0.2)
            value_loss = torch.max(huber(target - value), huber(target - clipped)).mean()

            truth = state[use]
            some = max(1, int(len(truth) * a.decoded))  # the rows are shuffled
            if a.algorithm == "ex-iwol":
                m, f = actor.messages(obs, comm, data["policy_noise"][index])
                features, extra = torch.cat([m[use], f[use]], -1), 0.05 * F.mse_loss(actor.world(m[use][:some]).tanh(), truth[:some])
            else:
                features, extra = actor.encoder(obs[use]), 0.0
            if a.algorithm == "im-iwol":
                z = actor.latent(features)
                extra = 0.05 * F.mse_loss(actor.world(z[:some]).tanh(), truth[:some])
                extra = extra + 0.05 * F.mse_loss(actor.interaction(z[:some]), message[use][:some].detach())
                features = torch.cat([z, features], -1)
            policy = torch.distributions.Normal(actor.mean(features), actor.log_std.exp())
            log_prob = policy.log_prob(data["action"][index][use]).sum(-1)
            ratio = (log_prob - data["log_prob"][index][use]).exp()
            adv = advantage[index][use]
            policy_loss = -torch.min(ratio * adv, ratio.clamp(0.8, 1.2) * adv).mean()
            for optimiser in optimisers:
                optimiser.zero_grad()
            (policy_loss + extra + value_loss).backward()
            for network, optimiser in zip((actor, critic), optimisers):
                nn.utils.clip_grad_norm_(network.parameters(), 10.0)
                optimiser.step()


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--algorithm", choices=["mappo", "im-iwol", "ex-iwol"], default="im-iwol")
    for name, default in dict(
        agents=8, envs=16, steps=128, observation=66, state=83, hidden=128, message=64, rounds=1, heads=4, latent=32, epochs=5,
        minibatch=2048, repeat=3, threads=2,
    ).items():
        p.add_argument(f"--{name}", type=int, default=default)
    p.add_argument("--decoded", type=float, default=0.25, help="share of the samples that teach the decoders")
    p.add_argument("--profile", action="store_true", help="print where the time goes instead")
    a = p.parse_args()
    torch.set_num_threads(a.threads)
    torch.manual_seed(0)
    closed, rows = (a.steps + 1) * a.envs, a.steps * a.envs
    # Three quarters of the agents are active, as in a rollout of a policy that has learned.
    present = (torch.rand(closed, a.agents) < 0.75).float()
    data = {
        "obs": torch.randn(closed, a.agents, a.observation).clamp(-1, 1) * present.unsqueeze(-1),
        "state": torch.randn(closed, a.agents, a.state).clamp(-1, 1),
        "comm": present.unsqueeze(1) * present.unsqueeze(2),
        "noise": torch.distributions.Uniform(1e-6, 1 - 1e-6).sample((closed, a.agents, a.agents)).logit(),
        "policy_noise": torch.distributions.Uniform(1e-6, 1 - 1e-6).sample((closed, a.agents, a.agents)).logit(),
        "active": present[:rows],
        "action": torch.randn(rows, a.agents, 1),
        "log_prob": torch.full((rows, a.agents), -1.4),
        "reward": torch.randn(rows, a.agents),
        "terminated": (torch.rand(rows, a.agents) < 0.01).float(),
    }
    actor, critic = Actor(a), Critic(a)
    optimisers = [torch.optim.Adam(n.parameters(), lr=7e-4, eps=1e-5) for n in (actor, critic)]
    update(a, actor, critic, optimisers, data)
    if a.profile:
        with torch.profiler.profile() as profile:
            update(a, actor, critic, optimisers, data)
        print(profile.key_averages().table(sort_by="self_cpu_time_total", row_limit=30, max_name_column_width=40))
        return
    times = []
    for _ in range(a.repeat):
        begin = time.perf_counter()
        update(a, actor, critic, optimisers, data)
        times.append(1e3 * (time.perf_counter() - begin))
    print(json.dumps(times))


if __name__ == "__main__":
    main()
