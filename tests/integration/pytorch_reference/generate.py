"""Computes the reference values of tests/integration/pytorch_reference.rs with PyTorch and writes them to golden.safetensors.

Run it as `python tests/integration/pytorch_reference/generate.py` where torch is installed (the committed file was made with 2.15.0 on a
CPU). Everything is made from torch.nn modules, torch.distributions, torch.optim and the formulas as they are published,
not from the Rust code. Sizes are the smallest that tell the axes of a case apart.

Names in the file: `<case>/<array>` for inputs, outputs and gradients, `<case>/param/<name>` for weights under the names
of the Rust layers.
"""

import functools
import json
import math
import pathlib
import struct

import torch
import torch.nn.functional as F
from torch import nn

torch.manual_seed(20240607)
torch.set_num_threads(1)
ARRAYS = {}


def put(case, **arrays):
    for name, value in arrays.items():
        key = f"{case}/{name}"
        assert key not in ARRAYS, key
        ARRAYS[key] = value.detach().clone().contiguous()


def put_params(case, modules):
    """`modules` maps the Rust path of a layer to a torch module or a tensor."""
    for path, module in modules.items():
        if isinstance(module, torch.Tensor):
            put(case, **{f"param/{path}": module})
        else:
            for name, value in module.named_parameters():
                put(case, **{f"param/{path}.{name}": value})


def shaken(module):
    """Gives weights that are zero or one by default (biases, norms) values that matter."""
    with torch.no_grad():
        for value in module.parameters():
            if value.dim() == 1:
                value.add_(0.3 * torch.randn_like(value))
    return module


def linear(inputs, outputs):
    return shaken(nn.Linear(inputs, outputs))


def norm(width):
    return shaken(nn.LayerNorm(width))


def weighted(out):
    """A scalar in which every element of `out` has another weight; golden.rs does the same."""
    flat = out.reshape(-1)
    return (flat * torch.sin(torch.arange(flat.numel(), dtype=torch.float32) * 0.37 + 0.5)).sum()


def grad(out, *inputs):
    return torch.autograd.grad(weighted(out), inputs)


def mlp_modules(inputs, hidden):
    return {
        "norm": norm(inputs),
        "layers.0.linear": linear(inputs, hidden),
        "layers.0.norm": norm(hidden),
        "layers.1.linear": linear(hidden, hidden),
        "layers.1.norm": norm(hidden),
    }


def mlp_forward(m, x):
    x = m["norm"](x)
    for i in range(2):
        x = m[f"layers.{i}.norm"](F.relu(m[f"layers.{i}.linear"](x)))
    return x


def mlp():
    m = mlp_modules(7, 8)
    x = (torch.randn(5, 7) * 3 + 1).requires_grad_()
    out = mlp_forward(m, x)
    gx, gw, gn = grad(out, x, m["layers.0.linear"].weight, m["norm"].weight)
    put_params("mlp", m)
    put("mlp", x=x, out=out, grad_x=gx, grad_weight=gw, grad_norm=gn)


def gru():
    cell = nn.GRUCell(5, 4)
    x = torch.randn(6, 3, 5, requires_grad=True)
    h0 = torch.randn(3, 4, requires_grad=True)
    mask = torch.ones(6, 3, 1)
    mask[0, 1] = mask[2, 0] = mask[4, 2] = mask[5, 2] = 0
    h, outs = h0, []
    for t in range(6):
        h = cell(x[t], h * mask[t])
        outs.append(h)
    out = torch.stack(outs)
    gx, gh, gw, gb = grad(out, x, h0, cell.weight_hh, cell.bias_hh)
    put_params("gru", dict(cell.named_parameters()))
    put("gru", x=x, h0=h0, mask=mask, out=out, grad_x=gx, grad_h0=gh, grad_weight_hh=gw, grad_bias_hh=gb)


def multihead(width, heads):
    return shaken(nn.MultiheadAttention(width, heads, batch_first=True))


def multihead_params(path, attention):
    return {
        f"{path}.qkv.weight": attention.in_proj_weight,
        f"{path}.qkv.bias": attention.in_proj_bias,
        f"{path}.out": attention.out_proj,
    }


def entity():
    # one ego token of 3, two of navigation of 2, three neighbours of 4 whose feature 1 is the presence flag
    embed = [linear(3, 8), linear(2, 8), linear(4, 8)]
    # without a flag, the tokens of navigation differ by their place; not drawn, so that the others' draws stay
    places = torch.linspace(-1, 1, 16).reshape(2, 8)
    embed_norm, attention, attention_norm = norm(8), multihead(8, 2), norm(8)
    out_layer, out_norm = linear(16, 6), norm(6)
    obs = torch.randn(4, 19)
    flags = torch.tensor([[1, 1, 1], [0, 1, 0], [0, 0, 0], [1, 0, 1]]).float()
    for j in range(3):
        obs[:, 7 + 4 * j + 1] = flags[:, j]
    obs.requires_grad_()
    tokens = torch.cat(
        [
            embed[0](obs[:, 0:3].reshape(4, 1, 3)),
            embed[1](obs[:, 3:7].reshape(4, 2, 2)) + places,
            embed[2](obs[:, 7:19].reshape(4, 3, 4)),
        ],
        dim=1,
    )
    present = torch.cat([torch.ones(4, 3), flags], dim=1)
    x = embed_norm(tokens)
    mixed, _ = attention(x, x, x, key_padding_mask=present < 0.5, need_weights=False)
    x = attention_norm(x + mixed)
    mean = (x * present.unsqueeze(-1)).sum(1) / present.sum(1, keepdim=True)
    out = out_norm(F.relu(out_layer(torch.cat([mean, x[:, 0]], dim=-1))))
    gobs, gqkv, gembed = grad(out, obs, attention.in_proj_weight, embed[2].weight)
    modules = {f"embed.{i}": layer for i, layer in enumerate(embed)}
    modules |= {"embed_norm": embed_norm, "attention_norm": attention_norm, "out": out_layer, "out_norm": out_norm}
    put_params("entity", modules | multihead_params("attention", attention) | {"embed.1.places": places})
    put("entity", obs=obs, out=out, grad_obs=gobs, grad_qkv=gqkv, grad_embed=gembed)


def graph():
    batch, agents = 3, 4
    m = mlp_modules(6, 6)
    a_i, a_j = torch.randn(1, 6), torch.randn(1, 6)
    f = torch.randn(batch, agents, 6, requires_grad=True)
    physical = (torch.rand(batch, agents, agents) > 0.25).float()
    physical[1, 2, :] = physical[1, :, 2] = 0  # agent 2 of world 1 is dead
    gumbel = -torch.empty(batch, agents, agents, 2).exponential_().log()
    h = mlp_forward(m, f)
    e = F.leaky_relu((h @ a_i.T) + (h @ a_j.T).transpose(1, 2), negative_slope=0.2)
    logits = torch.stack([e, torch.zeros_like(e)], dim=-1)
    soft = (logits + gumbel).softmax(-1)
    hard = F.one_hot(soft.argmax(-1), 2).float()
    edge = (hard - soft.detach() + soft)[..., 0]
    eye = torch.eye(agents)
    g = edge * physical * (1 - eye) + eye
    (gf,) = grad(g, f)
    put("graph", scores=e, graph=g.round(), grad_f=gf)
    put_params("graph", {f"base.{k}": v for k, v in m.items()} | {"receiver": a_i, "sender": a_j})
    put("graph", f=f, physical=physical, noise=gumbel[..., 0] - gumbel[..., 1])


def graph_softmax(logits, graph, dim):
    """Weights in proportion to G exp(logit), over `dim`: 0 on closed edges, whose G has a gradient, as of at most e^9 times
    the strongest open edge."""
    top = logits.detach().masked_fill(graph.detach() < 0.5, -torch.inf).amax(dim, keepdim=True)
    weights = (logits - top).clamp(max=9).exp() * graph
    return weights / weights.sum(dim, keepdim=True)


def transformer():
    batch, agents, width, heads = 3, 5, 8, 2
    in_norm, input_layer, embed_norm = norm(width), linear(width, width), norm(width)
    rounds = [(multihead(width, heads), norm(width), linear(width, width), linear(width, width), norm(width)) for _ in "ab"]
    head, head_norm, out_layer = linear(width, width), norm(width), linear(width, width)
    modules = {"in_norm": in_norm, "input": input_layer, "embed_norm": embed_norm}
    for i, (attention, norm1, up, down, norm2) in enumerate(rounds):
        modules |= multihead_params(f"rounds.{i}.attention", attention)
        parts = {"attention_norm": norm1, "up": up, "down": down, "mlp_norm": norm2}
        modules |= {f"rounds.{i}.{name}": layer for name, layer in parts.items()}
    modules |= {"head": head, "head_norm": head_norm, "out": out_layer}

    f = torch.randn(batch, agents, width, requires_grad=True)
    g = ((torch.rand(batch, agents, agents) > 0.5).float()).maximum(torch.eye(agents)).requires_grad_()

    def explicit(attention, x):
        """Attention of one round, written out, with the graph's gradient."""
        q, k, v = F.linear(x, attention.in_proj_weight, attention.in_proj_bias).chunk(3, -1)
        q, k, v = (t.view(batch, agents, heads, -1).transpose(1, 2) for t in (q, k, v))
        logits = q @ k.transpose(-2, -1) / math.sqrt(width / heads)
        weights = graph_softmax(logits, g.unsqueeze(1), -1)
        return attention.out_proj((weights @ v).transpose(1, 2).reshape(batch, agents, width))

    def builtin(attention, x):
        """The same by torch's own module, which knows no gradient of the graph."""
        closed = (g.detach() < 0.5).repeat_interleave(heads, 0)
        return attention(x, x, x, attn_mask=closed, need_weights=False)[0]

    def run(attend):
        x = embed_norm(F.gelu(input_layer(in_norm(f))))
        for attention, norm1, up, down, norm2 in rounds:
            x = norm1(x + attend(attention, x))
            x = norm2(x + down(F.gelu(up(x))))
        return out_layer(head_norm(F.gelu(head(x))))

    put_params("transformer", modules)
    put("transformer", f=f, graph=g)
    out = run(explicit)
    torch.testing.assert_close(out, run(builtin))
    gf, gg, gw = grad(out, f, g, rounds[0][0].in_proj_weight)
    put("transformer", out=out, grad_f=gf, grad_graph=gg, grad_qkv=gw)


def split_heads(x, heads):
    return x.view(*x.shape[:-1], heads, -1).transpose(1, 2)


def attention_layers(width, related):
    """Query, key, value, output, and, where pairs have relations, the layer from a relation's embedding to both its vectors."""
    layers = {name: linear(width, width) for name in ("query", "key", "value", "out")}
    if related:
        layers["relations"] = linear(width, 2 * width)
    return layers


def attention_params(path, layers):
    """Under our names: keys and values are one layer."""
    fused = {
        part: torch.cat([getattr(layers["key"], part), getattr(layers["value"], part)]) for part in ("weight", "bias")
    }
    return {
        f"{path}.query": layers["query"],
        f"{path}.keys_values.weight": fused["weight"],
        f"{path}.keys_values.bias": fused["bias"],
        f"{path}.out": layers["out"],
    } | ({f"{path}.relations": layers["relations"]} if "relations" in layers else {})


def mat_attention(layers, heads, query, among, seen):
    """SelfAttention of ma_transformer.py, where `seen: [B, N, N]` stands for its causal mask."""
    q, k, v = (split_heads(layers[n](x), heads) for n, x in (("query", query), ("key", among), ("value", among)))
    att = q @ k.transpose(-2, -1) / math.sqrt(q.shape[-1])
    att = att.masked_fill(seen.unsqueeze(1) == 0, -torch.inf).softmax(-1)
    return layers["out"]((att @ v).transpose(1, 2).reshape(query.shape))


def relation_attention(layers, heads, query, among, graph, kinds, table):
    """RelationMultiheadAttention of cformer.py: a vector for each pair. The graph is a factor on the weights before
    they are normalised, so that closed edges have a gradient (cformer.py: after the softmax over open edges)."""
    b, n, width = query.shape
    q, k, v = (layers[name](x).view(b, n, heads, -1) for name, x in (("query", query), ("key", among), ("value", among)))
    scale = (width // heads) ** -0.5
    embedded = table[kinds.long()]  # [B, N, N, W]
    ra, rb = layers["relations"](embedded).chunk(2, -1)
    ra, rb = ra.view(b, n, n, heads, -1), rb.view(b, n, n, heads, -1)
    score = torch.einsum("bijhd,bijhd->bijh", (q.unsqueeze(2) + ra) * scale, k.unsqueeze(1) + rb) * scale
    score = graph_softmax(score, graph.unsqueeze(-1), 2)
    return layers["out"](torch.einsum("bijh,bjhd->bihd", score, v).reshape(b, n, width))


def decoder_modules(actions, width, related):
    block = {f"blocks.0.{n}": norm(width) for n in ("own_norm", "cross_norm", "mlp_norm")}
    block |= {f"blocks.0.{n}": linear(width, width) for n in ("up", "down")}
    own, cross = attention_layers(width, related), attention_layers(width, related)
    ends = {"embed": linear(actions, width), "embed_norm": norm(width), "head": linear(width, width), "head_norm": norm(width)}
    return ends | block, own, cross


def decode(m, own, cross, attend, previous, rep):
    """Decoder and DecodeBlock of ma_transformer.py."""
    x = m["embed_norm"](F.gelu(m["embed"](previous)))
    x = m["blocks.0.own_norm"](x + attend(own, x, x))
    x = m["blocks.0.cross_norm"](rep + attend(cross, rep, x))
    x = m["blocks.0.mlp_norm"](x + m["blocks.0.down"](F.gelu(m["blocks.0.up"](x))))
    return m["head_norm"](F.gelu(m["head"](x)))


def decoder():
    batch, agents, width, heads = 3, 4, 8, 2
    m, own, cross = decoder_modules(2, width, False)
    previous = torch.randn(batch, agents, 2, requires_grad=True)
    rep = torch.randn(batch, agents, width, requires_grad=True)
    present = torch.ones(batch, agents)
    present[1, 2] = present[2, 0] = 0
    seen = present.unsqueeze(1).expand(batch, agents, agents).maximum(torch.eye(agents))
    causal = seen.tril()
    out = decode(m, own, cross, lambda layers, q, x: mat_attention(layers, heads, q, x, causal), previous, rep)
    gp, gr, ge = grad(out, previous, rep, m["embed"].weight)
    put_params("decoder", m | attention_params("blocks.0.own", own) | attention_params("blocks.0.cross", cross))
    put("decoder", previous=previous, rep=rep, seen=seen, out=out, grad_previous=gp, grad_rep=gr, grad_embed=ge)


def commformer():
    batch, agents, width, heads, links = 3, 5, 8, 2, 2
    edges = torch.randn(agents, agents, requires_grad=True)
    noise = torch.randn(batch, agents, agents)
    physical = (torch.rand(batch, agents, agents) > 0.2).float()
    table = torch.randn(2, width, requires_grad=True)
    x = torch.randn(batch, agents, width, requires_grad=True)
    previous = torch.randn(batch, agents, 1)

    scores = edges + noise
    soft = scores.softmax(-1)
    hard = torch.zeros_like(soft).scatter(-1, scores.topk(links, -1).indices, 1.0)
    best = hard - soft.detach() + soft
    eye = torch.eye(agents)
    linked = best * physical
    kinds = linked.detach().round()
    # exact zeros and ones, with the gradient of the soft sample
    exact = kinds + (linked - linked.detach())
    graph = exact * (1 - eye) + eye

    attention = attention_layers(width, True)
    parts = {"attention_norm": norm(width), "up": linear(width, width), "down": linear(width, width), "mlp_norm": norm(width)}
    y = parts["attention_norm"](x + relation_attention(attention, heads, x, x, graph, kinds, table))
    y = parts["mlp_norm"](y + parts["down"](F.relu(parts["up"](y))))
    m, own, cross = decoder_modules(1, width, True)
    causal = graph.tril()
    attend = lambda layers, q, among: relation_attention(layers, heads, q, among, causal, kinds, table)
    out = decode(m, own, cross, attend, previous, y)
    (gb,) = torch.autograd.grad(weighted(y), edges, retain_graph=True)
    gx, ge, gt = grad(out, x, edges, table)
    put_params("commformer", {f"block.{k}": v for k, v in (parts | attention_params("attention", attention)).items()})
    named = m | attention_params("blocks.0.own", own) | attention_params("blocks.0.cross", cross)
    put_params("commformer", {f"decoder.{k}": v for k, v in named.items()} | {"relations": table, "edges": edges})
    put("commformer", noise=noise, physical=physical, x=x, previous=previous, best=hard, block=y, out=out)
    put("commformer", grad_x=gx, grad_edges=ge, grad_relations=gt, grad_block_edges=gb)


def magic():
    batch, agents, width, heads = 3, 4, 16, 2
    first, second, third = linear(2 * width, width // 2), linear(width // 2, width // 8), linear(width // 8, 2)
    f = torch.randn(batch, agents, width, requires_grad=True)
    g = ((torch.rand(batch, agents, agents) > 0.5).float()).maximum(torch.eye(agents)).requires_grad_()
    pairs = torch.cat([f.unsqueeze(2).expand(-1, -1, agents, -1), f.unsqueeze(1).expand(-1, agents, -1, -1)], -1)
    logits = third(F.relu(second(F.relu(first(pairs)))))
    scores = logits[..., 1] - logits[..., 0]
    (gs,) = grad(scores, f)
    put_params("magic", {"scheduler.first": first, "scheduler.second": second, "scheduler.third": third})
    put("magic", f=f, graph=g, scores=scores, grad_f_scores=gs)
    for name, joined in (("joined", True), ("mean", False)):
        weight, a_i, a_j = torch.randn(heads * 3, width), torch.randn(heads, 3), torch.randn(heads, 3)
        bias = torch.randn(heads * 3 if joined else 3)
        h = (f @ weight.T).view(batch, agents, heads, 3)
        outs = []
        for k in range(heads):  # GraphAttention.forward of gnn_layers.py, a head at a time; closed edges have a gradient
            hk = h[:, :, k]
            e = F.leaky_relu((hk @ a_i[k]).unsqueeze(2) + (hk @ a_j[k]).unsqueeze(1), negative_slope=0.2)
            outs.append(graph_softmax(e, g, -1) @ hk)
        out = (torch.cat(outs, -1) if joined else torch.stack(outs).mean(0)) + bias
        gf, gg = grad(out, f, g)
        put_params("magic", {f"{name}.weight": weight, f"{name}.listener": a_i, f"{name}.speaker": a_j, f"{name}.bias": bias})
        put("magic", **{f"out_{name}": out, f"grad_f_{name}": gf, f"grad_graph_{name}": gg})


def mixer():
    batch, agents, features = 4, 3, 5
    m = {
        f"{name}.{i}": linear(*sizes[i])
        for name, sizes in (
            ("weights", ((features, 64), (64, 32))),
            ("out_weights", ((features, 64), (64, 32))),
            ("offset", ((features, 64), (64, 1))),
        )
        for i in (0, 1)
    } | {"shift": linear(features, 32)}
    values = torch.randn(batch, agents, requires_grad=True)
    state = torch.randn(batch, agents, features, requires_grad=True)
    present = torch.tensor([[1, 1, 1], [1, 0, 1], [0, 0, 1], [1, 1, 0]]).float()
    outs = []
    for b in range(batch):  # QMixer.forward of q_mixer.py, an environment at a time, of those who are there
        there = present[b] > 0
        q, s = values[b, there], state[b, there]
        hyper = lambda name: m[f"{name}.1"](F.relu(m[f"{name}.0"](s)))
        hidden = F.elu(q @ hyper("weights").abs() + m["shift"](s).mean(0))
        outs.append(hidden @ hyper("out_weights").mean(0).abs() + hyper("offset").mean())
    out = torch.stack(outs)
    gv, gs = grad(out, values, state)
    put_params("mixer", m)
    put("mixer", values=values, state=state, present=present, out=out, grad_values=gv, grad_state=gs)


def gaussian():
    mean, log_std = torch.randn(6, 3, requires_grad=True), torch.randn(3, requires_grad=True)
    action = torch.randn(6, 3)
    normal = torch.distributions.Normal(mean, log_std.exp())
    log_prob, entropy = normal.log_prob(action).sum(-1), normal.entropy().sum(-1)
    gm, gs = grad(log_prob + entropy, mean, log_std)
    put("gaussian", mean=mean, log_std=log_std, action=action, log_prob=log_prob, entropy=entropy, grad_mean=gm, grad_log_std=gs)


def value_norm():
    batches = torch.randn(4, 9) * torch.tensor([0.01, 5.0, 30.0, 2.0])[:, None] + torch.tensor([0.0, 3.0, -8.0, 1.0])[:, None]
    probe = torch.linspace(-20, 20, 11)
    beta, m, q, w = 0.99999, *(torch.zeros((), dtype=torch.float64) for _ in range(3))
    states, normal, back = [], [], []
    for x in batches.double():
        m = beta * m + (1 - beta) * x.mean()
        q = beta * q + (1 - beta) * x.square().mean()
        w = beta * w + (1 - beta)
        mu = m / w.clamp(min=1e-5)
        std = (q / w.clamp(min=1e-5) - mu**2).clamp(min=1e-2).sqrt()
        states.append(torch.stack([m, q, w]))
        normal.append(((probe - mu) / std).float())
        back.append((probe * std + mu).float())
    put("value_norm", batches=batches, probe=probe, states=torch.stack(states), normalized=torch.stack(normal), denormalized=torch.stack(back))


def adam():
    m = mlp_modules(4, 12)
    params = [p for module in m.values() for p in module.parameters()]
    put_params("adam", m)
    x, y = torch.randn(8, 4), torch.randn(8, 12)
    optimiser = torch.optim.Adam(params, lr=0.02, eps=1e-5, foreach=False)
    norms = []
    for step in range(5):
        optimiser.zero_grad()
        (mlp_forward(m, x) - y).square().mean().backward()
        # some steps exceed the bound, others do not
        norms.append(nn.utils.clip_grad_norm_(params, 1.2, foreach=False))
        for group in optimiser.param_groups:
            group["lr"] = 0.02 / (step + 1)
        optimiser.step()
        put("adam", **{f"flat_{step}": torch.cat([p.reshape(-1) for p in params])})
    assert max(norms) > 1.2 > min(norms), norms
    moments = [torch.cat([optimiser.state[p][key].reshape(-1) for p in params]) for key in ("exp_avg", "exp_avg_sq")]
    put("adam", x=x, y=y, norms=torch.stack(norms), first=moments[0], second=moments[1])


def ppo():
    n, clip, delta = 40, 0.2, 10.0
    active = (torch.rand(n) > 0.3).float()
    old = torch.randn(n)
    log_prob = (old + 0.4 * torch.randn(n)).requires_grad_()
    advantage = torch.randn(n)
    ratio = (log_prob - old).exp()
    surrogate = torch.minimum(ratio * advantage, ratio.clamp(1 - clip, 1 + clip) * advantage)
    policy = -(surrogate * active).sum() / active.sum()
    put("ppo", active=active, log_prob=log_prob, old_log_prob=old, advantage=advantage, policy_loss=policy)
    put("ppo", grad_log_prob=torch.autograd.grad(policy, log_prob)[0])

    old_value, target = torch.randn(n), torch.randn(n) * 12
    value = (old_value + 0.3 * torch.randn(n)).requires_grad_()
    clipped = old_value + (value - old_value).clamp(-clip, clip)
    huber = [F.huber_loss(v, target, reduction="none", delta=delta) for v in (value, clipped)]
    assert ((target - value).abs() > delta).any()
    loss = (torch.maximum(*huber) * active).sum() / active.sum()
    put("ppo", value=value, old_value=old_value, target=target, value_loss=loss)
    put("ppo", grad_value=torch.autograd.grad(loss, value)[0])


def maddpg():
    """One update on one step of three agents: the second one's last, the third is gone already."""
    agents, width, gamma, rate, tau, penalty, limit, beta = 3, 6, 0.97, 0.01, 0.005, 1e-3, 10.0, 0.99999
    actor, head = mlp_modules(4, width), linear(width, 1)
    eyes, attention = mlp_modules(4 + 3, width), attention_layers(width, False)
    parts = {"join": linear(width + 1, width), "join_norm": norm(width), "deep": linear(2 * width, width)}
    parts |= {"deep_norm": norm(width), "value": linear(width, 1)}
    observation, state = torch.randn(2, agents, 4), torch.randn(2, agents, 3)
    there = torch.tensor([[1.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    # the second one's is beyond what the environment takes
    sampled = torch.tensor([0.4, -1.7, 0.0]).unsqueeze(-1)
    action = sampled.clamp(-1, 1)
    reward, active, ended = torch.tensor([[1.5, -4.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    mean_before, square_before, weight_before = 0.3, 2.0, 0.6

    def unbounded(t):
        return head(mlp_forward(actor, observation[t]))

    def look(t):
        return mlp_forward(eyes, torch.cat([observation[t], state[t]], -1))

    def q(seen, own, done, present):
        """Of each agent's `own` action, where the others do what is `done`; the first key is nobody's."""
        mine, others = (parts["join_norm"](F.relu(parts["join"](torch.cat([seen, a], -1)))) for a in (own, done))
        keys = torch.cat([torch.zeros(1, width), others])
        reached = torch.cat([torch.ones(agents, 1), present * (1 - torch.eye(agents))], 1)
        scores = attention["query"](mine) @ attention["key"](keys).T / math.sqrt(width)
        weights = scores.masked_fill(reached == 0, -torch.inf).softmax(-1)
        told = attention["out"](weights @ attention["value"](keys))
        return parts["value"](parts["deep_norm"](F.relu(parts["deep"](torch.cat([mine, told], -1))))).squeeze(-1)

    def mean(values):
        return (values * active).sum() / active.sum()

    def moments(m, s, w):
        return m / w, (s / w - (m / w) ** 2) ** 0.5

    # fused as our layers are, so that norms and moments can be told apart by name
    def named():
        policy = {f"encoder.mlp.{k}": v for k, v in actor.items()} | {"head.mean": head}
        value = {f"encoder.mlp.{k}": v for k, v in eyes.items()} | parts | attention_params("others", attention)
        flat = {}
        for owner, modules in (("actor", policy), ("critic", value)):
            for path, module in modules.items():
                own = {"": module} if isinstance(module, torch.Tensor) else {f".{n}": p for n, p in module.named_parameters()}
                flat |= {f"{owner}/{path}{n}": p.detach().clone() for n, p in own.items()}
        return flat

    before = named()
    put("maddpg", **{f"param/{k}": v for k, v in before.items()})
    with torch.no_grad():
        centre, spread = moments(mean_before, square_before, weight_before)
        future = unbounded(1).tanh()
        target = reward + gamma * (1 - ended) * (q(look(1), future, future, there[1]) * spread + centre)
        seen_by_some = target[active > 0].double()
        update = lambda old, new: beta * old + (1 - beta) * new
        statistics = [
            update(mean_before, seen_by_some.mean().item()),
            update(square_before, seen_by_some.square().mean().item()),
            update(weight_before, 1.0),
        ]
        old_centre, old_spread = centre, spread
        centre, spread = moments(*statistics)
        target = (target - centre) / spread
        # PopArt: what values mean is kept as the statistics move, in both critics
        parts["value"].weight *= old_spread / spread
        parts["value"].bias.copy_((parts["value"].bias * old_spread + old_centre - centre) / spread)
    before = named()

    def step(modules, loss):
        parameters = [p for module in modules for p in module.parameters()]
        optimiser = torch.optim.Adam(parameters, lr=rate, eps=1e-5, foreach=False)
        optimiser.zero_grad()
        loss.backward(inputs=parameters)
        total = nn.utils.clip_grad_norm_(parameters, limit, foreach=False)
        optimiser.step()
        return total

    value_modules = [*eyes.values(), *parts.values(), *attention.values()]
    seen = look(0)
    value_loss = mean((q(seen, action, action, there[0]) - target).square())
    value_norm_of_gradient = step(value_modules, value_loss)
    # the policy is judged by the value's new weights, on what its old ones saw
    own = unbounded(0)
    policy_loss = -mean(q(seen.detach(), own.tanh(), action, there[0]))
    policy_norm_of_gradient = step([*actor.values(), head], policy_loss + penalty * mean(own.square().mean(-1)))
    assert max(value_norm_of_gradient, policy_norm_of_gradient) > limit
    after = named()
    put("maddpg", **{f"after/{k}": v for k, v in after.items()})
    put("maddpg", **{f"following/{k}": before[k] + tau * (after[k] - before[k]) for k in after})
    put("maddpg", observation=observation, state=state, there=there, action=sampled, reward=reward, active=active, ended=ended)
    losses = torch.stack([value_loss, policy_loss, value_norm_of_gradient, policy_norm_of_gradient])
    put("maddpg", losses=losses, statistics=torch.tensor(statistics, dtype=torch.float64))


def crew():
    """Three agents in three environments: some out of range, some gone, and one environment that has just begun."""
    present = torch.tensor([[1.0, 1, 1], [1, 0, 1], [1, 1, 0]])
    comm = torch.tensor([[[1.0, 1, 0], [1, 1, 1], [0, 1, 1]], [[1, 0, 1], [0, 0, 0], [1, 0, 1]], [[1, 1, 0], [1, 1, 0], [0, 0, 0]]])
    observation, state = torch.randn(3, 3, 4), torch.randn(3, 3, 3)
    return present, comm, observation, state, torch.tensor([0.0, 1.0, 0.0])


# running mean, mean square and weight of returns
STATISTICS = (0.3, 2.0, 0.6)


def in_units_of_reward(values):
    mean, square, weight = STATISTICS
    return values * math.sqrt(square / weight - (mean / weight) ** 2) + mean / weight


def of_a_crew(case, crew, actor, critic, **outputs):
    """A whole learner's weights, and what it answers; those who are gone do not count. No two agents answer alike."""
    present, comm, observation, state, start = crew
    for name in {"action", "value"} & outputs.keys():
        answers = outputs[name].reshape(9, -1)[present.reshape(-1) > 0][:, 0].sort().values
        if answers.diff().min() < 1e-3:
            raise Redraw
    put_params(case, {f"actor/{k}": v for k, v in actor.items()} | {f"critic/{k}": v for k, v in critic.items()})
    put(case, present=present, comm=comm, observation=observation, state=state, start=start)
    put(case, **outputs)


class Redraw(Exception):
    """Weights with which a case would say little."""


def redrawn(draw):
    """Draws until it says enough."""

    @functools.wraps(draw)
    def attempts(*arguments):
        for _ in range(10_000):
            try:
                return draw(*arguments)
            except Redraw:
                pass
        raise AssertionError(draw)

    return attempts


def under(path, modules):
    return {f"{path}.{name}": module for name, module in modules.items()}


@redrawn
def icp():
    """What is read of the symbols of the last step, and the three ways from agents' values to the one that is learned."""
    people = present, comm, observation, state, start = crew()
    hidden, actions, symbols, agents = 16, 2, 3, 3
    encoder, head, symbol = mlp_modules(4 + symbols, hidden), linear(hidden, actions), linear(hidden, symbols)
    tells = [linear(symbols, hidden), linear(hidden, hidden), linear(hidden, hidden + actions)]  # for training only
    eyes, value = mlp_modules(4, hidden), linear(hidden, 1)
    shown = F.one_hot(torch.tensor([[0, 2, 1], [1, 1, 0], [2, 0, 1]]), symbols).float()
    heard = torch.zeros(3, agents, symbols)
    for e in range(3):
        for i in range(agents):
            others = [j for j in range(agents) if j != i and comm[e, i, j] > 0]
            for j in others:
                # a symbol of before the start of an episode is forgotten: none is shown
                heard[e, i] += shown[e, j] * (1 - start[e]) / len(others)
    f = mlp_forward(encoder, torch.cat([observation, heard], -1))
    scores = symbol(f)
    best = scores.topk(2, -1).values
    if (best[..., 0] - best[..., 1]).min() < 1e-3:
        raise Redraw
    own = value(mlp_forward(eyes, observation)).squeeze(-1)
    m = {
        f"{name}.{i}": linear(*sizes[i])
        for name, sizes in (("weights", ((3, 64), (64, 32))), ("out_weights", ((3, 64), (64, 32))), ("offset", ((3, 64), (64, 1))))
        for i in (0, 1)
    } | {"shift": linear(3, 32)}
    mixed = torch.zeros(3)
    for e in range(3):
        there = present[e] > 0
        q, s = own[e, there], state[e, there]
        hyper = lambda name: m[f"{name}.1"](F.relu(m[f"{name}.0"](s)))
        hidden_values = F.elu(q @ hyper("weights").abs() + m["shift"](s).mean(0))
        mixed[e] = hidden_values @ hyper("out_weights").mean(0).abs() + hyper("offset").mean()
    actor = under("encoder.mlp", encoder) | {"head.mean": head, "symbol": symbol} | under("decoder", dict(zip("012", tells)))
    critic = under("encoder.mlp", eyes) | {"value": value} | under("mixer", m)
    of_a_crew(
        "icp", people, actor, critic, memory=shown, action=head(f), memory_after=F.one_hot(scores.argmax(-1), symbols).float(),
        value_dec=in_units_of_reward(own),
        value_sum=in_units_of_reward((own * present).sum(-1, keepdim=True).expand(3, agents)),
        value_monotonic=in_units_of_reward(mixed.unsqueeze(-1).expand(3, agents)),
    )


@redrawn
def magic_crew():
    """Both rounds of MAGIC, each over a graph of its own, of those who are there and within range."""
    people = present, comm, observation, state, start = crew()
    width, heads = 16, 4
    encoder, head = mlp_modules(4, width), linear(2 * width, 1)
    schedulers = [(linear(2 * width, width // 2), linear(width // 2, width // 8), linear(width // 8, 2)) for _ in "ab"]
    rounds = []
    for inputs, count, out, joined in ((width, heads, width // heads, True), (width, 1, width, False)):
        layer = torch.randn(count * out, inputs), torch.randn(count, out), torch.randn(count, out)
        rounds.append((*layer, torch.randn(count * out if joined else out), joined))
    f = mlp_forward(encoder, observation)
    edges, told = [0, 0], torch.zeros(3, 3, width)
    for e in range(3):
        there = present[e] > 0
        x = own = f[e, there]
        agents = len(x)
        allowed = comm[e][there][:, there]
        for k, ((first, second, third), (weight, a_i, a_j, bias, joined)) in enumerate(zip(schedulers, rounds)):
            pairs = torch.cat([own.unsqueeze(1).expand(-1, agents, -1), own.unsqueeze(0).expand(agents, -1, -1)], -1)
            logits = third(F.relu(second(F.relu(first(pairs)))))
            if (logits[..., 1] - logits[..., 0]).abs().min() < 1e-3:
                raise Redraw
            g = (logits.argmax(-1).float() * allowed).maximum(torch.eye(agents))
            edges[k] += int(g.sum()) - agents
            h = (x @ weight.T).view(agents, len(a_i), -1)
            outs = []
            for head_of in range(len(a_i)):
                hk = h[:, head_of]
                score = F.leaky_relu((hk @ a_i[head_of]).unsqueeze(1) + (hk @ a_j[head_of]).unsqueeze(0), negative_slope=0.2)
                att = score.masked_fill(g == 0, -torch.inf).softmax(-1)
                outs.append(att @ hk)
            x = (torch.cat(outs, -1) if joined else torch.stack(outs).mean(0)) + bias
            x = F.elu(x) if joined else x
        told[e, there] = x
    if not all(2 <= kept <= 6 for kept in edges):  # of 8: neither all nor none, in either round
        raise Redraw
    eyes, value = mlp_modules(4 + 3, width), linear(width, 1)
    actor = under("encoder.mlp", encoder) | {"head.mean": head}
    for i in (0, 1):
        actor |= under(f"scheduler.{i}", dict(zip(("first", "second", "third"), schedulers[i])))
        actor |= under(f"round.{i}", dict(zip(("weight", "listener", "speaker", "bias"), rounds[i])))
    critic = under("encoder.mlp", eyes) | {"value": value}
    own_value = value(mlp_forward(eyes, torch.cat([observation, state], -1))).squeeze(-1)
    of_a_crew(
        "magic_crew", people, actor, critic,
        action=head(torch.cat([f, told], -1)), value=in_units_of_reward(own_value),
    )


@redrawn
def mappo():
    """Each policy on its own, and the value of what each sees and of the privileged state."""
    people = present, comm, observation, state, start = crew()
    hidden = 16
    encoder, head = mlp_modules(4, hidden), linear(hidden, 2)
    eyes, value = mlp_modules(4 + 3, hidden), linear(hidden, 1)
    actor = under("encoder.mlp", encoder) | {"head.mean": head}
    critic = under("encoder.mlp", eyes) | {"value": value}
    own_value = value(mlp_forward(eyes, torch.cat([observation, state], -1))).squeeze(-1)
    of_a_crew("mappo", people, actor, critic, action=head(mlp_forward(encoder, observation)), value=in_units_of_reward(own_value))


def in_turn(m, own, cross, attend, head, representation, heard):
    """Actions of one environment's agents, one after another as transformer_act.py has it: what stands before each is the action
    of the one before it, zeros where that one is not heard."""
    agents, actions = len(heard), []
    for i in range(agents):
        before = [actions[k - 1] * heard[k] if k > 0 else torch.zeros(head.out_features) for k in range(i + 1)]
        read = decode(m, own, cross, attend, torch.stack(before).unsqueeze(0), representation[:, : i + 1])
        actions.append(head(read[0, i]))
    return torch.stack(actions)


def of_a_sequence(case, block, represent, related, says_enough, actions=2, hidden=16):
    """MAT or CommFormer: `represent` is one environment's encoder block, from its agents to what they know, who hears whom, and what
    attends in the decoder; those who are gone are not in the sequence at all."""
    people = present, comm, observation, state, start = crew()
    encoder = mlp_modules(4, hidden)
    names = {"input_norm": norm(hidden), "input": linear(hidden, hidden), "embed_norm": norm(hidden)}
    first, value_norm, second = linear(hidden + 3, hidden), norm(hidden), linear(hidden, 1)
    m, own, cross = decoder_modules(actions, hidden, related)
    head = linear(hidden, actions)
    action, value = torch.zeros(3, 3, actions), torch.zeros(3, 3)
    for e in range(3):
        there = present[e] > 0
        x = mlp_forward(encoder, observation[e, there])
        x = names["embed_norm"](F.gelu(names["input"](names["input_norm"](x)))).unsqueeze(0)
        representation, graph, attend = represent(x, comm[e][there][:, there], there)
        known = torch.cat([representation[0], state[e, there]], -1)
        value[e, there] = second(value_norm(F.gelu(first(known)))).squeeze(-1)
        heard = [float(k > 0 and graph[k, k - 1] > 0) for k in range(len(graph))]
        action[e, there] = in_turn(m, own, cross, attend, head, representation, heard)
    if not says_enough():
        raise Redraw
    actor = under("encoder.mlp", encoder) | names | under("blocks.0", block) | {"head.mean": head}
    actor |= under("value", {"first": first, "norm": value_norm, "second": second})
    decoder_params = m | attention_params("blocks.0.own", own) | attention_params("blocks.0.cross", cross)
    of_a_crew(case, people, actor | under("decoder", decoder_params), {}, action=action, value=in_units_of_reward(value))


@redrawn
def mat_crew():
    """The encoder is everyone's, in range or not; agents act one after another."""
    hidden, heads = 16, 4
    attention, layers = multihead(hidden, heads), [norm(hidden), linear(hidden, hidden), linear(hidden, hidden), norm(hidden)]

    def represent(x, comm, there):
        x = layers[0](x + attention(x, x, x, need_weights=False)[0])
        x = layers[3](x + layers[2](F.gelu(layers[1](x))))
        everyone = torch.ones_like(comm)
        seen = lambda q: everyone[: q.shape[1], : q.shape[1]].tril().unsqueeze(0)
        return x, everyone, lambda layers, q, among: mat_attention(layers, heads, q, among, seen(q))

    block = dict(zip(("attention_norm", "up", "down", "mlp_norm"), layers)) | multihead_params("attention", attention)
    of_a_sequence("mat_crew", block, represent, False, lambda: True)


@redrawn
def commformer_crew():
    """Each agent's two best links, as far as there are agents within range: in the encoder, in the decoder, and to the action before."""
    hidden, heads, links = 16, 4, 2
    edges, table = torch.randn(3, 3), torch.randn(2, hidden)
    chosen = torch.zeros(3, 3).scatter(-1, edges.topk(links, -1).indices, 1.0)
    attention = attention_layers(hidden, True)
    layers = [norm(hidden), linear(hidden, hidden), linear(hidden, hidden), norm(hidden)]
    heard, cut = [], []  # of the actions before one's own, and of the links

    def represent(x, comm, there):
        kinds = (chosen[there][:, there] * comm).unsqueeze(0)
        graph = kinds.maximum(torch.eye(len(comm)))
        heard.extend(graph[0].diagonal(-1).tolist())
        cut.append(float((chosen[there][:, there] - kinds[0]).sum()))
        x = layers[0](x + relation_attention(attention, heads, x, x, graph, kinds, table))
        x = layers[3](x + layers[2](F.relu(layers[1](x))))

        def attend(layers, q, among):
            n = q.shape[1]
            return relation_attention(layers, heads, q, among, graph[:, :n, :n].tril(), kinds[:, :n, :n], table)

        return x, graph[0], attend

    block = dict(zip(("attention_norm", "up", "down", "mlp_norm"), layers)) | attention_params("attention", attention)
    of_a_sequence("commformer_crew", block, represent, True, lambda: 0 < sum(heard) < len(heard) and sum(cut) > 0)
    put_params("commformer_crew", {"actor/relations": table, "graph/edges": edges})


@redrawn
def trunk(people, hidden, width):
    """IWoL's message path with one round of four heads: its modules, messages and embeddings, zeros for those who are gone."""
    present, comm, observation, state, start = people
    encoder, base = mlp_modules(4, hidden), mlp_modules(hidden, width)
    a_i, a_j = torch.randn(1, width), torch.randn(1, width)
    names = {"in_norm": norm(hidden), "input": linear(hidden, width), "embed_norm": norm(width)}
    attention, layers = multihead(width, 4), [norm(width), linear(width, width), linear(width, width), norm(width)]
    end = {"head": linear(width, width), "head_norm": norm(width), "out": linear(width, width)}
    f = mlp_forward(encoder, observation)
    message, edges = torch.zeros(3, 3, width), 0
    for e in range(3):
        there = present[e] > 0
        own = f[e, there]
        h = mlp_forward(base, own)
        score = F.leaky_relu(h @ a_i.T + (h @ a_j.T).T, negative_slope=0.2)
        if score.abs().min() < 1e-3:
            raise Redraw
        g = ((score > 0).float() * comm[e][there][:, there]).maximum(torch.eye(len(own)))
        edges += (g * (1 - torch.eye(len(g)))).sum()
        x = names["embed_norm"](F.gelu(names["input"](names["in_norm"](own))))
        x = layers[0](x + attention(x, x, x, attn_mask=g < 0.5, need_weights=False)[0])
        x = layers[3](x + layers[2](F.gelu(layers[1](x))))
        message[e, there] = end["out"](end["head_norm"](F.gelu(end["head"](x))))
    if not 2 <= edges <= 6:  # of 8: neither all nor none
        raise Redraw
    block = dict(zip(("attention_norm", "up", "down", "mlp_norm"), layers)) | multihead_params("attention", attention)
    modules = under("encoder.mlp", encoder) | under("graph.base", base) | {"graph.receiver": a_i, "graph.sender": a_j}
    modules |= under("transformer", names | end) | under("transformer.rounds.0", block)
    return under("trunk", modules), message, f * present.unsqueeze(-1)


@redrawn
def iwol_crew(case):
    """Im-IWoL or Ex-IWoL: the policy on latent or message, the value on a message path of its own."""
    hidden, width, latent = 16, 8, 3
    people = present, comm, observation, state, start = crew()
    (critic, message, f), value = trunk(people, hidden, width), linear(width + hidden, 1)
    values = value(torch.cat([message, f], -1)).squeeze(-1)
    if case == "im_iwol":
        encoder, z = mlp_modules(4, hidden), [linear(hidden, hidden // 2), linear(hidden // 2, latent)]
        head, own = linear(latent + hidden, 1), mlp_forward(encoder, observation)
        action = head(torch.cat([z[1](F.relu(z[0](own))), own], -1))
        actor = under("encoder.mlp", encoder) | under("latent", dict(zip("01", z)))
    else:
        (actor, told, own), head = trunk(people, hidden, width), linear(width + hidden, 1)
        action = head(torch.cat([told, own], -1))
    actor |= {"head.mean": head}
    critic |= {"value": value}
    of_a_crew(case, people, actor, critic, action=action, value=in_units_of_reward(values))


@redrawn
def maddpg_iwol():
    """MADDPG's critic on messages and embeddings: the value of what the policy, on its latent, does."""
    people = present, comm, observation, state, start = crew()
    hidden, width, latent, agents = 16, 8, 3, 3
    encoder, z = mlp_modules(4, hidden), [linear(hidden, hidden // 2), linear(hidden // 2, latent)]
    head, own = linear(latent + hidden, 1), mlp_forward(encoder, observation)
    action = head(torch.cat([z[1](F.relu(z[0](own))), own], -1)).tanh()
    critic, message, f = trunk(people, hidden, width)
    parts = {"join": linear(width + hidden + 1, hidden), "join_norm": norm(hidden), "deep": linear(2 * hidden, hidden)}
    parts |= {"deep_norm": norm(hidden), "value": linear(hidden, 1)}
    attention = attention_layers(hidden, False)
    mine = parts["join_norm"](F.relu(parts["join"](torch.cat([message, f, action], -1))))
    values = torch.zeros(3, agents)
    for e in range(3):
        for i in range(agents):
            # the first key is nobody's; whoever is there counts, in range or not
            others = [j for j in range(agents) if j != i and present[e, j] > 0]
            keys = torch.cat([torch.zeros(1, hidden), mine[e, others]])
            weights = (attention["query"](mine[e, i]) @ attention["key"](keys).T / math.sqrt(hidden)).softmax(-1)
            told = attention["out"](weights @ attention["value"](keys))
            values[e, i] = parts["value"](parts["deep_norm"](F.relu(parts["deep"](torch.cat([mine[e, i], told])))))
    actor = under("encoder.mlp", encoder) | under("latent", dict(zip("01", z))) | {"head.mean": head}
    critic |= parts | attention_params("others", attention)
    of_a_crew("maddpg_iwol", people, actor, critic, action=action, value=in_units_of_reward(values))


def categorical():
    logits = torch.randn(6, 4, requires_grad=True)
    available, choice = (torch.rand(6, 4) > 0.4).float(), torch.tensor([3, 1, 0, 2, 2, 1])
    available[torch.arange(6), choice] = 1
    chances = torch.distributions.Categorical(logits=logits.masked_fill(available < 0.5, -1e9))
    log_prob, entropy = chances.log_prob(choice), chances.entropy()
    put("categorical", logits=logits, available=available, choice=choice.float(), log_prob=log_prob, entropy=entropy,
        grad_logits=grad(log_prob + entropy, logits)[0])


def write(path):
    kinds = {torch.float32: "F32", torch.float64: "F64"}
    header, data = {}, b""
    for name, value in sorted(ARRAYS.items()):
        raw = value.numpy().tobytes()
        header[name] = {"dtype": kinds[value.dtype], "shape": list(value.shape), "data_offsets": [len(data), len(data) + len(raw)]}
        data += raw
    header["__metadata__"] = {"torch": torch.__version__.split("+")[0]}
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    path.write_bytes(struct.pack("<Q", len(text)) + text + data)
    print(f"{path}: {len(ARRAYS)} arrays, {8 + len(text) + len(data)} bytes")


cases = (mlp, gru, entity, graph, transformer, gaussian, value_norm, adam, ppo, decoder, commformer, magic, mixer, maddpg)
of_crews = (icp, magic_crew, lambda: iwol_crew("im_iwol"), lambda: iwol_crew("ex_iwol"), maddpg_iwol)
of_more_crews = (mappo, mat_crew, commformer_crew)  # last, so that the others' draws stay
for case in (*cases, *of_crews, *of_more_crews, categorical):
    case()
write(pathlib.Path(__file__).parent / "golden.safetensors")
