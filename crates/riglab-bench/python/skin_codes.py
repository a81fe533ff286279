"""Codes of TokenRig's bones to weights, as PyTorch's users write it: the decoder of the skin auto-encoder with the
extension `bone_geometry`, from its definition in `crates/riglab-nn`, with the same names of parameters.

Shapes: m bones of one rig, p points asked, k codes a bone, s shape tokens, l segments of bones.
"""

import numpy as np
import torch
from scipy.sparse import csr_array
from scipy.spatial import cKDTree
from torch import nn

from fsq_cvae import DecoderParts, Encoder, Fsq

# Vertices that tell one at which no weights were asked.
NEIGHBOURS = 8


class Decoder(DecoderParts):
    def __init__(self, c, channels):
        super().__init__(c, channels)
        width = c["decoder_width"]
        self.bone_token, self.bone_points = nn.Linear(7, width), nn.Linear(10, width)

    def place(self, features, cond):
        """What of points [1, p, c] all bones share."""
        x = self.proj_query(features)
        for block in self.shape_points:
            x = block(x, cond)
        return x

    def forward(self, x, tokens, cond, bones, beside):
        tokens = torch.cat([tokens, self.bone_token(bones).unsqueeze(1)], 1)
        for block in self.blocks[: self.layers]:
            tokens = block(tokens, cond)
        x = x + self.bone_points(beside)
        for block in self.blocks[self.layers :]:
            x = block(x, tokens)
        x = self.norm_out(x)
        dot = x @ self.dot(tokens.mean(1)).unsqueeze(-1)
        return (self.proj_out(x) + dot).squeeze(-1)


class SkinCodes(nn.Module):
    def __init__(self, c):
        super().__init__()
        x = c["extensions"]
        known = {"cross_condition": True, "dot_head": True, "frame": False, "bone_geometry": True}
        if c["embed"]["kind"] != "fourier" or any(x[k] != v for k, v in known.items()):
            raise ValueError("the twin is written for the auto-encoder of skintokens/fsq_cvae_for_tokenrig.toml")
        frequencies = [c["embed"]["base"] * 2**k for k in range(c["embed"]["frequencies"])]
        self.register_buffer("frequencies", torch.tensor(frequencies), persistent=False)
        point = 3 + 6 * len(frequencies) + 3
        self.cond_encoder = Encoder(c, point, 0)
        self.decoder = Decoder(c, point)
        self.cond_quant = nn.Linear(c["encoder_width"], c["latent"])
        self.post_quant = nn.Linear(c["latent"], c["decoder_width"])
        self.FSQ = Fsq(c)
        self.levels = torch.tensor(c["levels"])
        self.basis = torch.cumprod(torch.tensor([1, *c["levels"][:-1]]), 0)

    def load(self, weights):
        """Takes what decoding needs of the auto-encoder's weights."""
        missing, _ = self.load_state_dict(weights, strict=False)
        if missing:
            raise ValueError(f"missing {missing}")

    def features(self, cloud):
        x, normals = cloud.split(3, -1)
        angle = (x.unsqueeze(-1) * self.frequencies).flatten(-2)
        return torch.cat([x, angle.sin(), angle.cos(), normals], -1)

    def codes(self, ids):
        """Ids to codes in [-1, 1], an axis more."""
        half = self.levels // 2
        return ((ids.unsqueeze(-1) // self.basis) % self.levels - half) / half


class Skinner:
    """A mesh, its shape read once, ready for the weights of any codes."""

    def __init__(self, net, cloud, queries, points, vertices):
        """`points` [p, 6]: those of the vertices that are asked; the others are told by their neighbours."""
        self.net, self.points = net, points
        self.cond = net.post_quant(net.cond_quant(net.cond_encoder(net.features(cloud), queries)))
        self.placed = net.decoder.place(net.features(points.unsqueeze(0)), self.cond)
        self.shares = None
        if len(vertices) > len(points):
            near, which = cKDTree(points[:, :3].numpy()).query(vertices, NEIGHBOURS)
            near = 1 / (near + 1e-8)
            near /= near.sum(1, keepdims=True)
            starts = np.arange(0, near.size + 1, NEIGHBOURS)
            self.shares = csr_array((near.ravel(), which.ravel(), starts), (len(vertices), len(points)))

    def raw(self, heads, parents, ids):
        """Raw shares [v, m] of the vertices, from the codes [m, k] of bones."""
        net, (bones, beside) = self.net, geometry(self.points[:, :3], heads, parents)
        tokens = net.post_quant(net.FSQ.decode(net.codes(ids)))
        known = net.decoder(self.placed, tokens, self.cond, bones, beside).sigmoid().T.double().numpy()
        return known if self.shares is None else self.shares @ known


def geometry(points, heads, parents):
    """What the decoder is told of bones: heads, tails and lengths [m, 7]; how points lie to each [m, p, 10]."""
    m, above = len(heads), parents.clamp_min(0)
    leaves = torch.ones(m, dtype=torch.bool)
    leaves[parents[1:]] = False
    # A bone goes to each child; a leaf's goes on by half of its parent's.
    owner = torch.cat([parents[1:], leaves.nonzero().squeeze(1)])
    ends = torch.cat([heads[1:], (heads + 0.5 * (heads - heads[above]))[leaves]])
    starts = heads[owner]
    count = torch.bincount(owner, minlength=m).unsqueeze(1)
    tails = torch.zeros_like(heads).index_add_(0, owner, ends) / count
    bones = torch.cat([heads, tails, (tails - heads).norm(dim=1, keepdim=True)], 1)

    along, away = ends - starts, points.unsqueeze(1) - starts
    square = along.square().sum(1)
    t = ((away * along).sum(2) / square.clamp_min(1e-30)).clamp(0, 1).masked_fill(square == 0, 0)
    distance = (away - t.unsqueeze(2) * along).norm(dim=2)
    index = owner.expand_as(distance)
    least_of = torch.full((len(points), m), torch.inf).scatter_reduce_(1, index, distance, "amin")
    nearest = t.masked_fill(distance > least_of[:, owner], 0)
    t = torch.zeros_like(least_of).scatter_reduce_(1, index, nearest, "amax")

    own = least_of.clamp_min(1e-4)
    ratio = own.amin(1, keepdim=True) / own
    share = lambda power: ratio**power / (ratio**power).sum(1, keepdim=True)
    sharp = share(8)
    told = torch.stack([own, own.log(), sharp, share(2), sharp.clamp_min(1e-6).log() / 4, ratio], 2)
    beside = torch.cat([told, points.unsqueeze(1) - heads, t.unsqueeze(2)], 2)
    return bones, beside.transpose(0, 1)
