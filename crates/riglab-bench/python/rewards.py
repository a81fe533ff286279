"""The four geometric rewards of SkinTokens for a group of rigs of one mesh, by numpy and scipy, vectorised."""

import time

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from serve import serve

mesh = {}


def load(folder, joints, config):
    """Arrays that riglab's side wrote; the number of rigs."""
    read = lambda name, kind, *shape: np.fromfile(f"{folder}/{name}", kind).reshape(*shape)
    mesh.update(config=config, parents=read("parents.i64", np.int64, -1), lattice=read("lattice.f64", np.float64, -1))
    mesh.update(cells=read("cells.i64", np.int64, -1, 3), faces=read("faces.i64", np.int64, -1, 3))
    mesh.update(vertices=read("vertices.f64", np.float64, -1, 3), heads=read("heads.f64", np.float64, -1, joints, 3))
    mesh.update(turns=read("turns.f64", np.float64, -1, joints, 3))
    mesh.update(weights=read("weights.f64", np.float64, -1, joints))
    return len(mesh["heads"])


def coverage(centers, heads):
    d, _ = cKDTree(heads).query(centers)
    return np.exp(-mesh["config"]["alpha"] * d / mesh["lattice"][3]).mean()


def containment(filled, heads):
    steps = mesh["config"]["bone_steps"]
    parents = np.where(mesh["parents"] < 0, np.arange(len(heads)), mesh["parents"])
    share = np.arange(steps + 1)[:, None, None] / steps
    points = (heads[parents] + share * (heads - heads[parents])).reshape(-1, 3)
    at = np.floor((points - mesh["lattice"][:3]) / mesh["lattice"][3]).astype(int)
    inside = ((at >= 0) & (at < filled.shape)).all(1)
    inside[inside] = filled[tuple(at[inside].T)]
    return inside.mean()


def skinning(weights):
    config = mesh["config"]
    unbound = (weights < config["beta"]).all(1).mean()
    crowded = ((weights > config["beta"]).sum(1) > 4).mean()
    return 1 - 0.5 * unbound ** config["unbound_exponent"] - 0.5 * crowded ** config["crowded_exponent"]


def motion(vertices, edges, lengths, weights, heads, turns):
    worst = []
    for turn in turns:
        turned = Rotation.from_rotvec(turn).as_matrix()
        maps = np.zeros((len(heads), 3, 4))
        for j, parent in enumerate(mesh["parents"]):
            local = np.concatenate([turned[j], (heads[j] - turned[j] @ heads[j])[:, None]], 1)
            if parent >= 0:
                above = maps[parent]
                local = np.concatenate([above[:, :3] @ local[:, :3], above[:, :3] @ local[:, 3:] + above[:, 3:]], 1)
            maps[j] = local
        mixed = (weights @ maps.reshape(len(heads), 12)).reshape(-1, 3, 4)
        posed = np.einsum("vij,vj->vi", mixed[:, :, :3], vertices) + mixed[:, :, 3]
        posed /= weights.sum(1, keepdims=True) + 1e-8
        now = np.linalg.norm(posed[edges[:, 0]] - posed[edges[:, 1]], axis=1)
        worst.append(max(1.0, (now / (lengths + 1e-6)).max()))
    return 1 / (1 + mesh["config"]["stretch_scale"] * np.mean(worst))


def score():
    """Seconds, and the rewards by rig."""
    start = time.perf_counter()
    low, high = mesh["vertices"].min(0), mesh["vertices"].max(0)
    unit = lambda p: (p - (low + high) / 2) * 2 / (high - low).max()
    vertices = unit(mesh["vertices"])
    edges = np.unique(np.sort(mesh["faces"][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    lengths = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    edges, lengths = edges[lengths > 1e-5], lengths[lengths > 1e-5]
    filled = np.zeros(mesh["cells"].max(0) + 1, bool)
    filled[tuple(mesh["cells"].T)] = True
    centers = mesh["lattice"][:3] + (mesh["cells"] + 0.5) * mesh["lattice"][3]
    rewards = [
        [
            float(coverage(centers, heads)),
            float(containment(filled, heads)),
            float(skinning(mesh["weights"])),
            float(motion(vertices, edges, lengths, mesh["weights"], unit(heads), mesh["turns"])),
        ]
        for heads in mesh["heads"]
    ]
    return {"seconds": time.perf_counter() - start, "rewards": rewards}


serve({"load": load, "score": score})
