"""UniRig's skin stage with the light point encoder and its training step, as PyTorch's users write them.

Written from the network's definition in `crates/riglab-nn/src/skin_stage`, with the same names of parameters. Rigs of a
batch have other numbers of bones: the shapes are read together, the rest rig by rig, which does not compute what
padding would add.

Shapes: n points of a cloud, q points asked, t tokens of the shape, j bones, p numbers told of a pair, h heads.
"""

import math

import torch
import torch.nn.functional as F
from torch import nn

from unirig_skeleton import Attention, Perceiver, Trainer

HELD = 1e-6


def fourier(x, frequencies):
    """x, sines and cosines at frequencies that double from pi."""
    angle = (x.unsqueeze(-1) * frequencies).flatten(-2)
    return torch.cat([x, angle.sin(), angle.cos()], -1)


def doubling(n):
    return torch.tensor([math.pi * 2.0**k for k in range(n)])


def mapped(width, out):
    return [nn.Linear(width, out), nn.LayerNorm(out), nn.GELU()]


class PostBlock(nn.Module):
    def __init__(self, width, heads):
        super().__init__()
        self.heads = heads
        self.attention = nn.Module()
        self.attention.Wq, self.attention.Wkv = nn.Linear(width, width), nn.Linear(width, 2 * width)
        self.attention.out_proj = nn.Linear(width, width)
        self.norm1, self.norm2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.ffn = nn.Sequential(nn.Linear(width, 4 * width), nn.GELU(), nn.Linear(4 * width, width))

    def forward(self, x, y):
        a = self.attention
        b, t, d = x.shape
        q = a.Wq(x).view(b, t, self.heads, -1).transpose(1, 2)
        k, v = a.Wkv(y).view(b, y.shape[1], 2, self.heads, -1).permute(2, 0, 3, 1, 4)
        if Attention.fused:
            read = F.scaled_dot_product_attention(q, k, v)
        else:
            read = (q * q.shape[-1] ** -0.5 @ k.transpose(-2, -1)).softmax(-1) @ v
        x = self.norm1(x + a.out_proj(read.transpose(1, 2).reshape(b, t, d)))
        return self.norm2(x + self.ffn(x))


class SkinModel(nn.Module):
    ROLES = {"attention": r"\.attn\.c_|\.attention\.|^[qk]mesh\.", "feed_forward": r"\.mlp\.c_|\.ffn\."}

    def __init__(self, c):
        super().__init__()
        if c["points"]["encoder"] != "light" or c["mask_power"] or not c["attributes"] or not c["pair_width"]:
            raise ValueError("the twin is written for configs/model/unirig_skin/small.toml")
        if c["bones"]["from_corner"]:
            raise ValueError("the twin counts positions from the middle of the cube")
        width, heads, bones, points = c["width"], c["heads"], c["bones"], c["points"]
        seen = {"joint": 1, "parent_and_joint": 2, "parent_joint_and_tail": 3}[bones["seen"]]
        self.heads = heads
        self.register_buffer("of_bones", doubling(bones["frequencies"]), persistent=False)
        self.register_buffer("of_points", doubling(points["frequencies"]), persistent=False)
        self.global_encoder = nn.Module()
        self.global_encoder.encoder = Perceiver(c["shape"])
        self.out_proj = nn.Sequential(*mapped(c["shape"]["width"], width))
        self.bone_encoder, e = nn.Module(), bones["embed"]
        told = seen * (3 + 6 * bones["frequencies"])
        layers = [*mapped(told, e), *mapped(e, 4 * e), *mapped(4 * e, width)]
        # Their names count from 1, and from a layer that has no weights.
        self.bone_encoder.bone_encoder = nn.Sequential(nn.Identity(), *layers)
        self.bone_encoder.attn = nn.ModuleList(PostBlock(width, heads) for _ in range(bones["layers"]))
        self.feat_map = nn.Sequential(*mapped(6 + 6 * points["frequencies"], width))
        self.mesh_bone_attn = nn.ModuleList(PostBlock(width, heads) for _ in range(points["layers"]))
        self.attributes = nn.Module()
        self.attributes.read = PostBlock(width, heads)
        self.attributes.net = nn.Module()
        self.attributes.net.hidden = nn.Sequential(*mapped(width, width))
        self.attributes.net.out = nn.Linear(width, 7)
        self.register_buffer("attribute_scale", torch.tensor(c["attribute_scale"]), persistent=False)
        self.qmesh, self.kmesh = nn.Linear(width, heads * width), nn.Linear(width, heads * width)
        self.attn_skin_norm, self.voxel_skin_norm = nn.LayerNorm(heads), nn.LayerNorm(heads)
        self.voxel_skin_embed = nn.Linear(c["pair"], heads)
        self.downscale = nn.Sequential(*mapped(2 * heads, heads))
        self.pair_past = nn.Module()
        self.pair_past.skip = nn.Linear(c["pair"], 1, bias=False)
        self.pair_past.net = nn.Sequential(*mapped(c["pair"], c["pair_width"]))
        deep, inner = [], heads + c["pair_width"]
        for _ in range(c["mlp_layers"]):
            deep, inner = deep + mapped(inner, c["mlp"]), c["mlp"]
        self.skinweight_pred = nn.Module()
        self.skinweight_pred.net = nn.Sequential(*deep, nn.Linear(inner, 1))

    def load(self, weights):
        self.load_state_dict(weights)

    def attend(self, fused):
        Attention.fused = fused

    def forward(self, batch):
        """For each rig, logits [q, j] and attributes [j, 7]."""
        cloud, picks = torch.cat([r["cloud"] for r in batch]), torch.cat([r["picks"] for r in batch])
        shapes = self.out_proj(self.global_encoder.encoder(cloud, picks))
        return [self.rig(rig, shapes[k : k + 1]) for k, rig in enumerate(batch)]

    def rig(self, rig, shape):
        b = rig["bones"]
        b = fourier(b.view(1, b.shape[1], -1, 3), self.of_bones).flatten(2)
        b = self.bone_encoder.bone_encoder(b)
        keys = torch.cat([b, shape], 1)
        for block in self.bone_encoder.attn:
            b = block(b, keys)
        context = torch.cat([b, shape], 1)
        asked = rig["cloud"][:, : rig["truth"].shape[0]]
        x = self.feat_map(torch.cat([fourier(asked[..., :3], self.of_points), asked[..., 3:]], -1))
        for block in self.mesh_bone_attn:
            x = block(x, context)
        attributes = self.attributes.net.out(self.attributes.net.hidden(self.attributes.read(b, x))) / self.attribute_scale
        apart = lambda y: y.view(1, y.shape[1], self.heads, -1).transpose(1, 2)
        q, k = apart(self.qmesh(x)), apart(self.kmesh(b))
        shares = (q * q.shape[-1] ** -0.5 @ k.transpose(-2, -1)).softmax(-1).permute(0, 2, 3, 1)
        pairs = rig["pairs"]
        told = self.voxel_skin_norm(self.voxel_skin_embed(pairs))
        y = self.downscale(torch.cat([self.attn_skin_norm(shares), told], -1))
        y = torch.cat([y, self.pair_past.net(pairs)], -1)
        logits = self.skinweight_pred.net(y) + self.pair_past.skip(pairs)
        return logits[0, ..., 0], attributes[0]


class SkinTrainer(Trainer):
    def loss(self, batch):
        c = self.config["loss"]
        if not c["bone_centric"] or any(v for k, v in c["released"].items() if k != "degrees") or c["physics"]["weight"]:
            raise ValueError("the twin is written for the divergence, bones counting alike, and attributes")
        skin, springs = [], []
        for rig, (logits, attributes) in zip(batch, self.net(batch)):
            truth, frozen = rig["truth"], rig.get("frozen")
            if frozen is None:
                shares = logits.log_softmax(-1)
                counted = torch.ones(truth.shape[1], dtype=torch.bool)
            else:
                rest = (1 - truth.masked_fill(~frozen, 0).sum(-1, keepdim=True)).clamp_min(1e-12)
                shares = logits.masked_fill(frozen, -math.inf).log_softmax(-1) + rest.log()
                shares = torch.where(frozen, truth.clamp_min(1e-12).log(), shares)
                counted = ~frozen
            each = (truth * truth.clamp_min(1e-12).log() - truth * shares).sum(-1)
            held = ((truth > HELD) & counted).float()
            count = held.sum(0)
            skin.append((held.T.mv(each) / count.clamp_min(1)).sum() / count.clamp_max(1).sum().clamp_min(1))
            if rig["swinging"].any():
                has = rig["swinging"].unsqueeze(-1).float()
                off = ((attributes - rig["swings"]) * torch.tensor(c["attribute_scale"])).square() * has
                springs.append(off.sum() / (has.sum() * 7))
        loss = c["skin"] * torch.stack(skin).mean()
        return loss + c["attributes"] * torch.stack(springs).mean() if springs else loss
