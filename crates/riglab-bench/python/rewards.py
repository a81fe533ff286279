"""The four geometric rewards of SkinTokens for rigs of one mesh, by numpy and scipy, vectorised."""

import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from serve import serve


class Scorer:
    """A mesh made ready: its cells and edges, and the poses [p, j, 3] that rigs are tried in; `threads` look for joints."""

    def __init__(self, vertices, faces, cells, lattice, turns, config, threads=1):
        self.config, self.turns, self.corner, self.cell = config, turns, lattice[:3], lattice[3]
        low, high = vertices.min(0), vertices.max(0)
        self.threads = threads
        self.middle, self.scale = (low + high) / 2, 2 / (high - low).max()
        self.vertices = self.unit(vertices)
        edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
        lengths = np.linalg.norm(self.vertices[edges[:, 0]] - self.vertices[edges[:, 1]], axis=1)
        self.edges, self.lengths = edges[lengths > 1e-5], lengths[lengths > 1e-5]
        self.filled = np.zeros(cells.max(0) + 1, bool)
        self.filled[tuple(cells.T)] = True
        self.centers = self.corner + (cells + 0.5) * self.cell

    def unit(self, p):
        """In the cube of side 2."""
        return (p - self.middle) * self.scale

    def score(self, heads, parents, weights):
        """Coverage, containment, skinning and motion; the root's parent is -1."""
        return [
            float(self.coverage(heads)),
            float(self.containment(heads, parents)),
            float(self.skinning(weights)),
            float(self.motion(self.unit(heads), parents, weights)),
        ]

    def coverage(self, heads):
        d, _ = cKDTree(heads).query(self.centers, workers=self.threads)
        return np.exp(-self.config["alpha"] * d / self.cell).mean()

    def containment(self, heads, parents):
        steps = self.config["bone_steps"]
        parents = np.where(parents < 0, np.arange(len(heads)), parents)
        share = np.arange(steps + 1)[:, None, None] / steps
        points = (heads[parents] + share * (heads - heads[parents])).reshape(-1, 3)
        at = np.floor((points - self.corner) / self.cell).astype(int)
        inside = ((at >= 0) & (at < self.filled.shape)).all(1)
        inside[inside] = self.filled[tuple(at[inside].T)]
        return inside.mean()

    def skinning(self, weights):
        config = self.config
        unbound = (weights < config["beta"]).all(1).mean()
        crowded = ((weights > config["beta"]).sum(1) > 4).mean()
        return 1 - 0.5 * unbound ** config["unbound_exponent"] - 0.5 * crowded ** config["crowded_exponent"]

    def motion(self, heads, parents, weights):
        turns = self.turns[:, : len(heads)]
        turned = Rotation.from_rotvec(turns.reshape(-1, 3)).as_matrix().reshape(*turns.shape, 3)
        # By pose and joint, then by its parent's: [p, j, 3, 4].
        maps = np.concatenate([turned, heads[:, :, None] - turned @ heads[:, :, None]], 3)
        for j, parent in enumerate(parents):
            if parent >= 0:
                above = maps[:, parent]
                maps[:, j] = above[:, :, :3] @ maps[:, j]
                maps[:, j, :, 3] += above[:, :, 3]
        worst, total = [], weights.sum(1, keepdims=True) + 1e-8
        for own in maps:
            mixed = (weights @ own.reshape(len(heads), 12)).reshape(-1, 3, 4)
            posed = (np.einsum("vij,vj->vi", mixed[:, :, :3], self.vertices) + mixed[:, :, 3]) / total
            now = np.linalg.norm(posed[self.edges[:, 0]] - posed[self.edges[:, 1]], axis=1)
            worst.append(max(1.0, (now / (self.lengths + 1e-6)).max()))
        return 1 / (1 + self.config["stretch_scale"] * np.mean(worst))


class Side:
    def load(self, folder, joints, config, threads):
        """Arrays that riglab's side wrote; the number of rigs."""
        read = lambda name, kind, *shape: np.fromfile(f"{folder}/{name}", kind).reshape(*shape)
        self.parents = read("parents.i64", np.int64, -1)
        self.heads = read("heads.f64", np.float64, -1, joints, 3)
        self.weights = read("weights.f64", np.float64, -1, joints)
        self.mesh = {
            "vertices": read("vertices.f64", np.float64, -1, 3),
            "faces": read("faces.i64", np.int64, -1, 3),
            "cells": read("cells.i64", np.int64, -1, 3),
            "lattice": read("lattice.f64", np.float64, -1),
            "turns": read("turns.f64", np.float64, -1, joints, 3),
            "config": config,
        }
        self.threads, self.pool = threads, ThreadPoolExecutor(threads)
        return len(self.heads)

    def score(self, pooled):
        """Seconds, and the rewards by rig; `pooled`: rigs side by side, else threads within each."""
        start = time.perf_counter()
        scorer = Scorer(**self.mesh, threads=1 if pooled else self.threads)
        each = self.pool.map if pooled else map
        rewards = list(each(lambda heads: scorer.score(heads, self.parents, self.weights), self.heads))
        return {"seconds": time.perf_counter() - start, "rewards": rewards}


if __name__ == "__main__":
    side = Side()
    serve({name: getattr(side, name) for name in ("load", "score")})
