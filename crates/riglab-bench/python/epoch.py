"""An epoch of the twin: the corpus through h5py, sampling in numpy, a DataLoader, training steps.

Sampling is that of `crates/riglab-task/src/fsq_cvae/{prepare,batch}.rs`, vectorised over points and
bones. A rig is prepared once by each worker that meets it, and kept.
"""

import time

import h5py
import numpy as np
import torch
from torch.utils.data import DataLoader, Dataset

import fsq_cvae
from fsq_cvae import ACTIVE, Attention, Trainer
from serve import serve

NEAR_CANDIDATES, NEAR_TO = 6, 32


def unit(v):
    """Vectors [.., 3] at length 1; +y where they have none."""
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.where(length > 0, v / np.maximum(length, 1e-30), np.float32([0, 1, 0])).astype(np.float32)


def farthest(points, count, first):
    """Farthest points [b, count] of b clouds [b, n, 3] at once, beginning with `first` [b]."""
    rows = np.arange(len(points))
    picks = np.empty((len(points), count), np.int64)
    nearest, last = np.full(points.shape[:2], np.inf, np.float32), first
    for k in range(count):
        picks[:, k] = last
        delta = points - points[rows, last][:, None]
        np.minimum(nearest, np.einsum("bnk,bnk->bn", delta, delta), out=nearest)
        last = nearest.argmax(1)
    return picks


class Rig:
    """A normalised rig with what sampling needs."""

    def __init__(self, f, offsets, index):
        rows = {k: slice(*offsets[k][index : index + 2]) for k in offsets}
        vertices, joints = f["vertices"][rows["vertex"]], f["joints"][rows["joint"]]
        self.faces = f["faces"][rows["face"]].astype(np.int64)
        both = np.concatenate([vertices, joints])
        low, high = both.min(0), both.max(0)
        scale = 2 / max((high - low).max(), 1e-30)
        self.vertices = ((vertices - (low + high) / 2) * scale).astype(np.float32)
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        area = np.cross(b - a, c - a)
        self.face_normals, size = unit(area), np.linalg.norm(area, axis=1).astype(np.float64)
        if not size.sum() > 0:
            size = np.ones(len(size))
        self.areas = size.cumsum()
        corners = self.faces.ravel()
        sums = [np.bincount(corners, np.repeat(area[:, k], 3), len(vertices)) for k in range(3)]
        self.vertex_normals = unit(np.stack(sums, 1))
        # Weights as a table: joint by vertex, of the joints that hold something.
        influences = f["influences"][rows["vertex"]]
        table = np.zeros((len(joints), len(vertices)), np.float32)
        column = np.repeat(np.arange(len(vertices)), influences)
        table[f["weight_joints"][rows["weight"]], column] = f["weights"][rows["weight"]]
        held = table > ACTIVE
        self.weights, held = table[held.any(1)], held[held.any(1)]
        self.bones = []
        for of in held:
            faces = np.flatnonzero(of[self.faces].any(1))
            self.bones.append((np.flatnonzero(of), faces, size[faces].cumsum()))

    def on_faces(self, faces, random):
        """Uniform points on given faces: corners, their shares, normals."""
        u, v = random.random((2, len(faces)), np.float32)
        over = u + v > 1
        u, v = np.where(over, 1 - u, u), np.where(over, 1 - v, v)
        return self.faces[faces], np.stack([1 - u - v, u, v], 1), self.face_normals[faces]

    def at_vertices(self, vertices):
        shares = np.zeros((len(vertices), 3), np.float32)
        shares[:, 0] = 1
        return np.repeat(vertices[:, None], 3, 1), shares, self.vertex_normals[vertices]

    def surface(self, count, random):
        at = random.random(count) * self.areas[-1]
        faces = np.searchsorted(self.areas, at, "right").clip(max=len(self.areas) - 1)
        return self.on_faces(faces, random)

    def anywhere(self, count, share, random):
        n = random.binomial(count, share)
        parts = [self.at_vertices(random.integers(0, len(self.vertices), n))]
        if n < count:
            parts.append(self.surface(count - n, random))
        return join(*parts)

    def held(self, bone, count, share, random):
        vertices, faces, areas = self.bones[bone]
        n = random.binomial(count, share) if len(areas) and areas[-1] > 0 else count
        parts = [self.at_vertices(vertices[random.integers(0, len(vertices), n)])]
        if n < count:
            at = random.random(count - n) * areas[-1]
            which = np.searchsorted(areas, at, "right").clip(max=len(areas) - 1)
            parts.append(self.on_faces(faces[which], random))
        return join(*parts)

    def position(self, points):
        corners, shares, _ = points
        return np.einsum("nc,nck->nk", shares, self.vertices[corners])

    def weight(self, bone, points):
        corners, shares, _ = points
        return np.einsum("nc,nc->n", shares, self.weights[bone][corners])


def join(*parts):
    return tuple(np.concatenate(column) for column in zip(*parts))


# The key of an item of which nothing is wanted but that all rigs are prepared.
PREPARE = "prepare"


class Rigs(Dataset):
    """One item is one rig's part of a batch, drawn anew each time."""

    def __init__(self, corpus, config):
        self.corpus, self.config, self.file, self.kept = corpus, config, None, {}
        with h5py.File(corpus) as f:
            splits = f["split"].asstr()[:]
            self.offsets = {k: f[f"{k}_offsets"][:] for k in ("vertex", "face", "joint", "weight")}
        joints = np.diff(self.offsets["joint"])
        wanted = np.isin(splits, config["data"]["train"]) & (joints <= config["data"]["max_joints"])
        self.assets = np.flatnonzero(wanted)

    def __len__(self):
        return len(self.assets)

    def rig(self, index):
        if index not in self.kept:
            if self.file is None:  # each worker opens the file for itself
                self.file = h5py.File(self.corpus)
            self.kept[index] = Rig(self.file, self.offsets, index)
        return self.kept[index]

    def __getitem__(self, key):
        if key == PREPARE:
            for index in self.assets:
                self.rig(index)
            return {}
        item, seed = key
        c, s = self.config["model"], self.config["sampling"]
        rig, random = self.rig(self.assets[item]), np.random.default_rng(seed)
        moved = self.map(random)
        cloud, positions = self.cloud(rig, rig.surface(s["shape_points"], random), moved, random)
        queries = farthest(positions[None], c["shape_tokens"], np.zeros(1, np.int64))
        count, share, e = s["bones"], s["vertex_share"], s["encoder"]
        bones = random.permutation(len(rig.bones))
        bones = np.resize(bones, count)  # over and over where there are too few
        skins, asked = [], []
        for bone in bones:
            points, active = self.mix(rig, bone, e, None, random)
            skins.append(points)
            asked.append(self.mix(rig, bone, s["decoder"], active, random)[0])
        skin, positions = self.cloud(rig, join(*skins), moved, random)
        weights = np.stack([rig.weight(b, p) for b, p in zip(bones, skins)])
        near, held = positions.reshape(count, -1, 3)[:, : e["active"]], weights[:, : e["active"]]
        total = np.maximum(held.sum(1), 1e-6)
        center = np.einsum("bn,bnk->bk", held, near) / total[:, None]
        first = np.square(near - center[:, None]).sum(-1).argmin(1)
        points, _ = self.cloud(rig, join(*asked), moved, random)
        arrays = {
            "shape": cloud[None],
            "shape_queries": queries,
            "skin": skin.reshape(count, -1, 6),
            "skin_weights": weights,
            "skin_queries": farthest(near, c["skin_tokens"], first),
            "points": points.reshape(count, -1, 6),
            "targets": np.stack([rig.weight(b, p) for b, p in zip(bones, asked)]),
        }
        return {k: torch.from_numpy(v) for k, v in arrays.items()}

    def mix(self, rig, bone, mix, anchors, random):
        """Points where the bone holds the mesh, near those, and anywhere; and the first of these."""
        share = self.config["sampling"]["vertex_share"]
        active = rig.held(bone, mix["active"], share, random)
        parts = [active]
        if mix["near"]:
            anchors = active if anchors is None else anchors
            candidates = rig.anywhere(mix["near"] * NEAR_CANDIDATES, share, random)
            free = rig.weight(bone, candidates) <= ACTIVE
            candidates = tuple(x[free] for x in candidates)
            if len(candidates[0]) > mix["near"]:
                p = rig.position(candidates)
                to = rig.position(tuple(x[random.permutation(len(x))[:NEAR_TO]] for x in anchors))
                d = np.square(p).sum(1)[:, None] - 2 * p @ to.T + np.square(to).sum(1)
                nearest = np.argpartition(d.min(1), mix["near"] - 1)[: mix["near"]]
                candidates = tuple(x[nearest] for x in candidates)
            parts.append(candidates)
            parts.append(rig.anywhere(mix["near"] - len(candidates[0]), share, random))
        parts.append(rig.anywhere(mix["uniform"], share, random))
        return join(*parts), active

    def map(self, random):
        """A turn, scale, stretch and mirroring: the maps of positions and of normals."""
        a = self.config["augment"]
        x, y, z = random.standard_normal(3) * [a["tilt"], a["yaw"], a["tilt"]]
        (cx, cy, cz), (sx, sy, sz) = np.cos([x, y, z]), np.sin([x, y, z])
        turn = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
        turn = turn @ np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        turn = turn @ np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
        axes = random.uniform(*a["scale"]) * (1 + random.uniform(-a["stretch"], a["stretch"], 3))
        if random.random() < a["mirror"]:
            axes[0] = -axes[0]
        m = turn * axes
        return m.astype(np.float32), np.linalg.inv(m).T.astype(np.float32)

    def cloud(self, rig, points, moved, random):
        """Moved points with normals [n, 6], and their positions."""
        m, normals = moved
        p = rig.position(points) @ m.T
        p += self.config["augment"]["noise"] * random.standard_normal(p.shape, np.float32)
        return np.concatenate([p, unit(points[2] @ normals.T)], 1), p


class Order:
    """Batches of (item, seed) that go over all items once; the last is filled from the front."""

    def __init__(self, count, size, seed):
        self.random = np.random.default_rng(seed)
        self.count, self.size = count, size
        self.preparing = 0

    def __len__(self):
        return self.preparing or -(-self.count // self.size)

    def prepare(self, loader, workers):
        """Has each worker prepare what it has not met: a loader hands them batches by turns."""
        self.preparing = max(workers, 1)
        for _ in loader:
            pass
        self.preparing = 0

    def __iter__(self):
        if self.preparing:
            return iter([[PREPARE]] * self.preparing)
        order = np.resize(self.random.permutation(self.count), len(self) * self.size)
        seeds = self.random.integers(0, 2**63, len(order))
        keys = list(zip(order.tolist(), seeds.tolist()))
        return (keys[i : i + self.size] for i in range(0, len(keys), self.size))


def collate(items):
    return {k: torch.cat([item[k] for item in items]) for k in items[0]}


class Side:
    def open(self, file, threads, fused):
        """Weights to start from."""
        fsq_cvae.prepare(threads)
        tensors = fsq_cvae.read_tensors(file)
        self.weights = {k[2:]: v for k, v in tensors.items() if k.startswith("w/")}
        Attention.fused = fused

    def epochs(self, corpus, config, count):
        """Seconds and mean loss of each of some epochs of a run from its start.

        The first begins with opening the corpus; before a later one each worker has prepared all rigs,
        which is not timed: riglab's threads share theirs, workers have those alone that they met.
        """
        out, start = [], time.perf_counter()
        trainer = Trainer(config, self.weights, config["train"]["precision"])
        rigs = Rigs(corpus, config)
        order = Order(len(rigs), config["sampling"]["rigs"], config["train"]["seed"])
        workers = config["train"]["workers"]
        loader = DataLoader(rigs, batch_sampler=order, collate_fn=collate, num_workers=workers,
                            persistent_workers=workers > 0)  # fmt: skip
        prefix, tokens = config["sampling"]["prefix"], config["model"]["skin_tokens"]
        for number in range(count):
            if number > 0:
                order.prepare(loader, workers)
                start = time.perf_counter()
            losses = []
            for batch in loader:
                full = order.random.random() < prefix["full"]
                k = tokens if full else min(order.random.choice(prefix["lengths"]), tokens)
                losses.append(trainer.step(batch, int(k)))
            now = time.perf_counter()
            out.append({"seconds": now - start, "loss": float(np.mean(losses)), "steps": len(losses)})
        return out

    def batches(self, corpus, config):
        """Makes an epoch's batches in this process: milliseconds each once rigs are kept, and means
        to compare sampling (not of queries: numbers of points mean nothing)."""
        rigs = Rigs(corpus, config)
        order = Order(len(rigs), config["sampling"]["rigs"], 0)
        loader, means = DataLoader(rigs, batch_sampler=order, collate_fn=collate), {}
        for batch in loader:
            for k, v in batch.items():
                if v.is_floating_point():
                    means.setdefault(k, []).append(v.abs().mean().item())
        start = time.perf_counter()
        for _ in loader:
            pass
        milliseconds = 1e3 * (time.perf_counter() - start) / len(loader)
        return {"milliseconds": milliseconds, "means": {k: float(np.mean(v)) for k, v in means.items()}}


side = Side()
serve({name: getattr(side, name) for name in ("open", "epochs", "batches")})
