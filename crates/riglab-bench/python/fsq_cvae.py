"""The skin auto-encoder and its training step, as PyTorch's users write them.

Written from the network's definition in `crates/riglab-nn`, with the same names of parameters, for
the switches of `configs/model/fsq_cvae/small.toml`. Where PyTorch offers several ways, the fastest
measured is taken; the notes say what was compared.

Shapes: r rigs, m bones (m / r of each rig, rig by rig), n points of a cloud, p points asked,
t skin tokens, s shape tokens.
"""

import json
import math
import time

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

ACTIVE = 0.01


class Attention(nn.Module):
    """Rows of keys may be fewer than rows of queries: then consecutive rows of x share them."""

    # Fused scaled_dot_product_attention, or its formula: whichever `fastest_attention` found.
    fused = True

    def __init__(self, width, context, heads):
        super().__init__()
        self.heads = heads
        self.to_q = nn.Linear(width, width, bias=False)
        self.to_k = nn.Linear(context, width, bias=False)
        self.to_v = nn.Linear(context, width, bias=False)
        self.to_out = nn.ModuleList([nn.Linear(width, width)])

    def forward(self, x, y=None):
        (b, t, d), y = x.shape, x if y is None else y
        split = lambda x: x.view(y.shape[0], -1, self.heads, d // self.heads).transpose(1, 2)
        q, k, v = split(self.to_q(x)), split(self.to_k(y)), split(self.to_v(y))
        if Attention.fused:
            x = F.scaled_dot_product_attention(q, k, v)
        else:
            x = (q * q.shape[-1] ** -0.5 @ k.transpose(-2, -1)).softmax(-1) @ v
        return self.to_out[0](x.transpose(1, 2).reshape(b, t, d))


class Cross(Attention):
    def __init__(self, width, context, heads):
        super().__init__(width, context, heads)
        self.norm_cross = nn.LayerNorm(context)

    def forward(self, x, y):
        return super().forward(x, self.norm_cross(y))


class FeedForward(nn.Module):
    def __init__(self, width, ratio):
        super().__init__()
        inner = round(width * ratio)
        up = nn.Module()
        up.proj = nn.Linear(width, inner)
        self.net = nn.ModuleList([up, nn.Identity(), nn.Linear(inner, width)])

    def forward(self, x):
        return self.net[2](F.gelu(self.net[0].proj(x)))


class Block(nn.Module):
    def __init__(self, width, heads, ratio, own, other):
        super().__init__()
        if own:
            self.norm1, self.attn1 = nn.LayerNorm(width), Attention(width, width, heads)
        if other:
            self.norm2, self.attn2 = nn.LayerNorm(width), Cross(width, width, heads)
        self.norm3, self.ff = nn.LayerNorm(width), FeedForward(width, ratio)
        self.own, self.other = own, other

    def forward(self, x, y=None):
        if self.own:
            x = x + self.attn1(self.norm1(x))
        if self.other:
            x = x + self.attn2(self.norm2(x), y)
        return x + self.ff(self.norm3(x))


def picked(x, index):
    return x.gather(1, index.unsqueeze(-1).expand(-1, -1, x.shape[2]))


class Encoder(nn.Module):
    def __init__(self, c, channels, learned):
        super().__init__()
        width, block = c["encoder_width"], (c["encoder_width"], c["heads"], c["mlp_ratio"])
        self.proj_in = nn.Linear(channels, width)
        if learned:
            self.learned_queries = nn.Parameter(torch.empty(learned, width))
        self.learned = learned
        blocks = [Block(*block, own=False, other=True)]
        blocks += [Block(*block, own=True, other=False) for _ in range(c["encoder_layers"])]
        self.blocks = nn.ModuleList(blocks)
        self.norm_out = nn.LayerNorm(width)

    def forward(self, features, queries):
        x = self.proj_in(features)
        tokens = picked(x, queries)
        if self.learned:
            tokens = tokens + self.learned_queries[: tokens.shape[1]]
        for block in self.blocks:
            tokens = block(tokens, x)
        return self.norm_out(tokens)


class Frames(nn.Module):
    """Where bones are and how large, on the first three axes of their codes."""

    SLOTS, REACH, SPAN, FAR = 4, 1.5, 2.2, 8.0
    SMALL, LARGE = 0.004, 0.6
    PLACE = 3 + 3 * 2 * 6
    POINT, TOKEN = PLACE + 2, 2 * PLACE + 3

    def __init__(self, levels):
        super().__init__()
        table = lambda name, x: self.register_buffer(name, torch.tensor(x), persistent=False)
        table("levels", [float(l) for l in levels[:3]])
        table("halves", [float(l // 2) for l in levels[:3]])
        table("octaves_local", [math.pi / self.FAR * 2**k for k in range(6)])
        table("octaves_center", [math.pi / 2 * 2**k for k in range(6)])

    @torch.no_grad()
    def encode(self, positions, weights):
        w = weights.unsqueeze(-1)
        total = w.sum(1, keepdim=True).clamp_min(1e-6)
        center = (positions * w).sum(1, keepdim=True) / total
        size = (((positions - center).square() * w).sum(1, keepdim=True) / total).sqrt()
        rest = ((center + self.REACH) / (2 * self.REACH)).clamp(0, 1 - 1e-6) * self.levels
        digits = []
        for _ in range(3):
            digits.append(rest.floor())
            rest = (rest - digits[-1]) * self.levels
        size = size.clamp(self.SMALL, self.LARGE).log() - math.log(self.SMALL)
        size = (size / math.log(self.LARGE / self.SMALL) * (self.levels - 1)).round()
        return (torch.cat([digits[0], size, *digits[1:]], 1) - self.halves) / self.halves

    @torch.no_grad()
    def tell(self, positions, weights, places):
        frame = self.encode(positions, weights)
        center, size, _ = self.hear(frame)
        local = ((places[:, self.SLOTS :] - center) / size).clamp(-self.SPAN, self.SPAN)
        digits = ((local / self.SPAN + 1) / 2 * (self.levels - 1)).round()
        return torch.cat([frame[:, : places.shape[1]], (digits - self.halves) / self.halves], 1)

    @torch.no_grad()
    def hear(self, codes):
        digits = (codes[..., :3] * self.halves + self.halves).round()
        count = digits.shape[1]
        cell = 1 / self.levels
        share = digits[:, :1] * cell
        for k in range(2, min(count, self.SLOTS)):
            cell = cell / self.levels
            share = share + digits[:, k : k + 1] * cell
        share = share + cell / 2
        size = digits[:, 1:2] / (self.levels - 1) if count > 1 else torch.full_like(share, 0.5)
        places = (digits[:, self.SLOTS :] / (self.levels - 1) * 2 - 1) * self.SPAN
        size = self.SMALL * (size * math.log(self.LARGE / self.SMALL)).exp()
        return share * (2 * self.REACH) - self.REACH, size, places

    def place(self, local):
        local = local.clamp(-self.FAR, self.FAR)
        angle = (local.unsqueeze(-1) * self.octaves_local).flatten(-2)
        return torch.cat([angle.sin(), angle.cos(), local / 2], -1)

    def point(self, positions, frame):
        away = positions - frame[0]
        local = away / frame[1]
        far = local.square().sum(-1, keepdim=True).log1p() / 2
        return torch.cat([self.place(local), far, away.norm(dim=-1, keepdim=True)], -1)

    def token(self, frame, count):
        center, size, places = frame
        angle = (center.unsqueeze(-1) * self.octaves_center).flatten(-2)
        shared = torch.cat([angle.sin(), angle.cos(), center, size.log() / 2], -1)
        placed = F.pad(self.place(places), (0, 0, count - places.shape[1], 0))
        return torch.cat([shared.expand(-1, count, -1), placed], -1)


class DecoderParts(nn.Module):
    """What decoders have in common, whatever they are told of bones."""

    def __init__(self, c, channels):
        super().__init__()
        x, width = c["extensions"], c["decoder_width"]
        block = (width, c["heads"], c["mlp_ratio"])
        points = (width, c["heads"], x["point_mlp_ratio"])
        self.layers = c["decoder_layers"]
        blocks = [Block(*block, own=True, other=True) for _ in range(self.layers)]
        blocks += [Block(*points, own=False, other=True) for _ in range(x["point_layers"])]
        self.blocks = nn.ModuleList(blocks)
        self.shape_points = nn.ModuleList(
            Block(*block, own=False, other=True) for _ in range(x["shape_point_layers"])
        )
        self.proj_query = nn.Linear(channels, width)
        self.norm_out, self.proj_out = nn.LayerNorm(width), nn.Linear(width, 1)
        self.dot = nn.Linear(width, width)


class Decoder(DecoderParts):
    def __init__(self, c, channels):
        super().__init__(c, channels)
        width = c["decoder_width"]
        self.frame_tokens = nn.Linear(Frames.TOKEN, width)
        self.frame_points = nn.Linear(Frames.POINT, width)

    def forward(self, tokens, cond, features, told_tokens, told_points):
        tokens = tokens + self.frame_tokens(told_tokens)
        for block in self.blocks[: self.layers]:
            tokens = block(tokens, cond)
        x = self.proj_query(features)
        for block in self.shape_points:
            x = block(x, cond)
        x = x + self.frame_points(told_points)
        for block in self.blocks[self.layers :]:
            x = block(x, tokens)
        x = self.norm_out(x)
        dot = x @ self.dot(tokens.mean(1)).unsqueeze(-1)
        return (self.proj_out(x) + dot).squeeze(-1).float()


class Fsq(nn.Module):
    def __init__(self, c):
        super().__init__()
        levels, self.octaves = c["levels"], c["extensions"]["code_octaves"]
        self.project_in = nn.Linear(c["latent"], len(levels))
        self.project_out = nn.Linear(len(levels) * (1 + 2 * self.octaves), c["latent"])
        half = [(l - 1) * (1 + 1e-3) / 2 for l in levels]
        off = [0.5 if l % 2 == 0 else 0.0 for l in levels]
        table = lambda name, x: self.register_buffer(name, torch.tensor(x), persistent=False)
        table("reach", half)
        table("off", off)
        table("shift", [math.atanh(o / h) for o, h in zip(off, half)])
        table("levels", [float(l // 2) for l in levels])

    def project(self, latent):
        return self.project_in(latent).float()

    def encode(self, z):
        bound = (z + self.shift).tanh() * self.reach - self.off
        return (bound + (bound.round() - bound).detach()) / self.levels

    def decode(self, codes):
        features = [codes]
        for k in range(self.octaves):
            angle = codes * (math.pi * 2**k)
            features += [angle.sin(), angle.cos()]
        return self.project_out(torch.cat(features, -1))


class FsqCvae(nn.Module):
    def __init__(self, c):
        super().__init__()
        x = c["extensions"]
        known = {"cross_condition": True, "active_bit": True, "dot_head": True, "frame": True,
                 "bone_geometry": False}  # fmt: skip
        other = [k for k, v in known.items() if x[k] != v]
        if other or c["skin_queries"] != "active" or c["embed"]["kind"] != "fourier":
            raise ValueError(f"the twin is written for small.toml, whose {other or 'queries or encoding'} differ")
        frequencies = [c["embed"]["base"] * 2**k for k in range(c["embed"]["frequencies"])]
        self.register_buffer("frequencies", torch.tensor(frequencies), persistent=False)
        point = 3 + 6 * len(frequencies) + 3
        self.encoder = Encoder(c, point + 2 + Frames.POINT, c["skin_tokens"])
        self.cond_encoder = Encoder(c, point, 0)
        self.decoder = Decoder(c, point)
        self.cond_quant = nn.Linear(c["encoder_width"], c["latent"])
        self.quant = nn.Linear(c["encoder_width"], c["latent"])
        self.post_quant = nn.Linear(c["latent"], c["decoder_width"])
        self.FSQ = Fsq(c)
        self.frames = Frames(c["levels"])

    def features(self, cloud, *extra):
        x, normals = cloud.split(3, -1)
        angle = (x.unsqueeze(-1) * self.frequencies).flatten(-2)
        return torch.cat([x, angle.sin(), angle.cos(), normals, *extra], -1)

    def forward(self, b, prefix):
        """Logits [m, p] from the first `prefix` codes, and what was rounded of the learned axes."""
        cond = self.cond_quant(self.cond_encoder(self.features(b["shape"]), b["shape_queries"]))
        weights, queries = b["skin_weights"].unsqueeze(-1), b["skin_queries"][:, :prefix]
        positions = b["skin"][..., :3]
        told = self.frames.tell(positions, b["skin_weights"], picked(positions, queries))
        own = self.frames.hear(self.frames.encode(positions, b["skin_weights"]))
        skin = self.features(b["skin"], weights, (weights > ACTIVE).float(), self.frames.point(positions, own))
        latent = self.quant(self.encoder(skin, queries))
        unrounded = self.FSQ.project(latent)
        codes = torch.cat([told, self.FSQ.encode(unrounded)[..., 3:]], -1)
        z = self.post_quant(self.FSQ.decode(codes))
        heard = self.frames.hear(codes)
        seen = self.frames.token(heard, prefix), self.frames.point(b["points"][..., :3], heard)
        return self.decoder(z, self.post_quant(cond), self.features(b["points"]), *seen), unrounded[..., 3:]


def loss_of(logits, unrounded, targets, c):
    predicted = logits.sigmoid()
    both = 2 * (predicted * targets).sum(-1) + 1e-4
    every = predicted.square().sum(-1) + targets.square().sum(-1) + 1e-4
    loss = c["bce"] * F.binary_cross_entropy_with_logits(logits, targets)
    loss = loss + c["mse"] * F.mse_loss(predicted, targets)
    loss = loss + c["dice"] * (1 - both / every).mean()
    passes = (targets > ACTIVE).float()
    shift = math.log((1 - ACTIVE) / ACTIVE)
    loss = loss + c["support"] * F.binary_cross_entropy_with_logits(logits + shift, passes)
    variance, mean = torch.var_mean(unrounded.flatten(0, 1), 0, correction=0)
    variance = variance + 1e-6
    return loss + c["spread"] * ((mean.square() + variance - 1 - variance.log()) / 2).mean()


def fastest_kind(k, m, n):
    """What k products of [m, n] and its transpose take less time in."""
    seconds = {torch.bfloat16: [], torch.float32: []}
    for _ in range(8):
        for kind, times in seconds.items():
            x = torch.ones(k, m, n, dtype=kind)
            start = time.perf_counter()
            x @ x.mT
            times.append(time.perf_counter() - start)
    return min(seconds, key=lambda kind: min(seconds[kind]))


class Muon(torch.optim.Optimizer):
    """Matrices of one shape orthogonalised together, in what this processor multiplies faster.

    torch.optim.Muon does the same one matrix at a time, in bfloat16.
    """

    def __init__(self, params, lr, momentum, nesterov):
        super().__init__(params, {"lr": lr, "momentum": momentum, "nesterov": nesterov})
        self.stacks = {}
        for p in self.param_groups[0]["params"]:
            self.stacks.setdefault(p.shape, []).append(p)
        largest = max(self.stacks, key=lambda shape: len(self.stacks[shape]) * shape.numel())
        self.kind = fastest_kind(len(self.stacks[largest]), *largest)

    @torch.no_grad()
    def step(self):
        group = self.param_groups[0]
        for shape, params in self.stacks.items():
            g = torch.stack([torch.zeros_like(p) if p.grad is None else p.grad for p in params])
            state = self.state[params[0]]
            if not state:
                state["momentum"] = torch.zeros_like(g)
            buf = state["momentum"].mul_(group["momentum"]).add_(g)
            update = self.orthogonal(g.add_(buf, alpha=group["momentum"]) if group["nesterov"] else buf)
            alpha = -group["lr"] * 0.2 * math.sqrt(max(shape))
            torch._foreach_add_(params, list(update.float().unbind(0)), alpha=alpha)

    def orthogonal(self, g):
        x = g.to(self.kind)
        tall = x.shape[1] > x.shape[2]
        if tall:
            x = x.mT
        x = x / x.flatten(1).norm(dim=1).clamp_min(1e-7)[:, None, None]
        for _ in range(5):
            gram = x @ x.mT
            x = torch.baddbmm(x, torch.baddbmm(gram, gram, gram, beta=-4.7750, alpha=2.0315), x, beta=3.4445)
        return x.mT if tall else x


def factor(train, step):
    """The learning rate at a step, as a factor of the peak."""
    s, steps = train["schedule"], train["steps"]
    if step < s["warmup"]:
        return (step + 1) / s["warmup"]
    if s["kind"] == "constant":
        return 1.0
    done = min((step - s["warmup"]) / max(steps - s["warmup"] - 1, 1), 1.0)
    return s["end"] + (1 - s["end"]) * 0.5 * (1 + math.cos(math.pi * done))


class Trainer:
    """Network, optimizers, moving average and schedule of a config."""

    def __init__(self, config, weights, precision):
        self.config, self.train, optim = config, config["train"], config["train"]["optim"]
        self.net = FsqCvae(config["model"])
        self.net.load_state_dict(weights)
        roles = {"attention": (".to_q.", ".to_k.", ".to_v.", ".to_out."), "feed_forward": (".ff.",)}
        wanted = tuple(part for role in optim["muon"] for part in roles[role])
        is_muon = lambda name, p: p.dim() == 2 and any(part in name for part in wanted)
        named = list(self.net.named_parameters())
        self.params = [p for _, p in named]
        if optim["weight_decay"] or not optim["muon_bf16"] or optim["muon_scale"] != "match_adamw":
            raise ValueError("the twin is written for the optimizer of fsq_cvae_small.toml, which differs")
        self.muon = Muon([p for n, p in named if is_muon(n, p)], optim["muon_lr"], optim["muon_momentum"],
                         optim["muon_nesterov"])  # fmt: skip
        self.adamw = torch.optim.AdamW([p for n, p in named if not is_muon(n, p)], optim["adamw_lr"],
                                       tuple(optim["adamw_betas"]), optim["adamw_eps"], weight_decay=0.0,
                                       fused=True)  # fmt: skip
        rate = lambda step: factor(self.train, step)
        self.schedules = [torch.optim.lr_scheduler.LambdaLR(o, rate) for o in (self.muon, self.adamw)]
        self.average = [p.detach().clone() for p in self.params]
        self.bf16, self.forward, self.steps = precision == "bf16", self.net, 0

    def loss(self, batch, prefix):
        with torch.autocast("cpu", torch.bfloat16, enabled=self.bf16):
            logits, unrounded = self.forward(batch, prefix)
        return loss_of(logits, unrounded, batch["targets"], self.config["loss"])

    def step(self, batch, prefix):
        """One optimizer step; gives the loss."""
        loss = self.loss(batch, prefix)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.params, self.train["optim"]["clip"], foreach=True)
        for optimizer, schedule in zip((self.muon, self.adamw), self.schedules):
            optimizer.step()
            schedule.step()
            optimizer.zero_grad(set_to_none=True)
        decay = min(self.train["ema"], (1 + self.steps) / (10 + self.steps))
        torch._foreach_lerp_(self.average, [p.detach() for p in self.params], 1 - decay)
        self.steps += 1
        return loss.item()


def prepare(threads):
    """Settings of a process that trains."""
    torch.set_num_threads(threads)
    torch.set_num_interop_threads(1)
    torch.set_flush_denormal(True)


def read_tensors(path):
    """A safetensors file, as tensors by name."""
    with open(path, "rb") as f:
        header = json.loads(f.read(int.from_bytes(f.read(8), "little")))
        data = f.read()
    header.pop("__metadata__", None)
    kinds = {"F32": np.float32, "I64": np.int64}
    out = {}
    for name, t in header.items():
        start, end = t["data_offsets"]
        array = np.frombuffer(data[start:end], kinds[t["dtype"]]).reshape(t["shape"])
        out[name] = torch.from_numpy(array.copy())
    return out
