"""Samples for UniRig's skeleton model as a Python user would make them: a corpus through h5py, the
augmentation of UniRig's public code in numpy, normals and 65,536 points by trimesh, tokens.

What `configs/augment/unirig_ar.toml` and `CloudConfig::unirig_ar_training` say, vectorised over vertices,
points and joints. Needs numpy, scipy, trimesh and h5py. Samples stay in the processes that make them:
nothing is charged for the way back.
"""

import os
import time
from multiprocessing import get_context

# Workers share the processors: each computes on one thread, as those of a DataLoader do.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"

import h5py
import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from serve import peak_memory_mb, serve

POINTS, VERTICES = 65_536, 4_096
KEEP, LEAST, HOLDS = 0.5, 0.25, 1e-5
POSE, ROTATE = np.radians(60.0), np.radians(90.0)
SIGMA, CLIP, NORMAL_SIGMA, NORMAL_CLIP = 0.005, 0.01, 0.02, 0.04

corpus = None


class Corpus:
    """A file and where its assets begin."""

    def __init__(self, path):
        self.file = h5py.File(path)
        self.kept = {}
        self.offsets = {k: self.file[f"{k}_offsets"][:] for k in ("vertex", "face", "joint", "weight")}

    def rig(self, index):
        """Vertices, faces, joints, parents and a table of weights; kept once it was read."""
        if index not in self.kept:
            self.kept[index] = self.read(index)
        return self.kept[index]

    def read(self, index):
        f, rows = self.file, {k: slice(*o[index : index + 2]) for k, o in self.offsets.items()}
        vertices, joints = f["vertices"][rows["vertex"]], f["joints"][rows["joint"]]
        weights = np.zeros((len(vertices), len(joints)), np.float32)
        row = np.repeat(np.arange(len(vertices)), f["influences"][rows["vertex"]])
        weights[row, f["weight_joints"][rows["weight"]]] = f["weights"][rows["weight"]]
        return vertices, f["faces"][rows["face"]].astype(np.int64), joints, f["parents"][rows["joint"]], weights


def part(vertices, faces, joints, parents, weights, random):
    """Random joints with their ancestors, and what they hold."""
    keep = random.random(len(joints)) < KEEP
    keep[0] = True
    for j in range(len(joints) - 1, 0, -1):
        keep[parents[j]] |= keep[j]
    if keep.sum() < LEAST * len(joints):
        return vertices, faces, joints, parents, weights
    held = (weights[:, keep] > HOLDS).any(1)
    whole = held[faces].all(1)
    if not whole.any():
        return vertices, faces, joints, parents, weights
    heir = np.arange(len(joints))
    for j in np.flatnonzero(~keep):
        heir[j] = heir[parents[j]]
    merged = np.zeros((int(held.sum()), len(joints)), np.float32)
    np.add.at(merged.T, heir, weights[held].T)
    number, vertex = np.cumsum(keep) - 1, np.cumsum(held) - 1
    parents = np.where(parents[keep] < 0, -1, number[heir[parents[keep]]])
    return vertices[held], vertex[faces[whole]], joints[keep], parents, merged[:, keep]


def pose(vertices, joints, parents, weights, random):
    """Every joint turned; the posed rig is at rest afterwards."""
    turns = Rotation.from_rotvec(random.uniform(-POSE, POSE, (len(joints), 3))).as_matrix()
    maps = np.zeros((len(joints), 3, 4))
    for j, (turn, head, parent) in enumerate(zip(turns, joints, parents)):
        shift = head - turn @ head
        if parent < 0:
            maps[j, :, :3], maps[j, :, 3] = turn, shift
        else:
            above = maps[parent]
            maps[j, :, :3], maps[j, :, 3] = above[:, :3] @ turn, above[:, :3] @ shift + above[:, 3]
    joints = np.einsum("jab,jb->ja", maps[:, :, :3], joints) + maps[:, :, 3]
    mixed = (weights @ maps.reshape(len(maps), 12).astype(np.float32)).reshape(-1, 3, 4)
    vertices = np.einsum("nab,nb->na", mixed[:, :, :3], vertices) + mixed[:, :, 3]
    return vertices, joints.astype(np.float32)


def linear(random):
    """Scale, then a quarter turn, then a rotation."""
    matrix = np.eye(3)
    if random.random() < 0.5:
        matrix = np.diag(random.uniform(0.33, 3.33, 3))
    if random.random() < 0.75:
        matrix = Rotation.from_euler("y", -90 * random.integers(1, 4), degrees=True).as_matrix() @ matrix
    if random.random() < 0.5:
        matrix = Rotation.from_rotvec(random.uniform(-ROTATE, ROTATE, 3)).as_matrix() @ matrix
    return matrix.astype(np.float32)


def into_cube(vertices, joints, random):
    """Centred and scaled, joints included; then scaled and shifted at random."""
    low = np.minimum(vertices.min(0), joints.min(0))
    high = np.maximum(vertices.max(0), joints.max(0))
    scale, middle = 2 / max((high - low).max(), 1e-30), (low + high) / 2
    more = random.uniform(0.5, 1.0) if random.random() < 0.5 else 1.0
    shift = random.uniform(-0.1, 0.1, 3) if random.random() < 0.5 else np.zeros(3)
    move = lambda p: ((p - middle) * np.float32(scale * more) + shift).astype(np.float32)
    return move(vertices), move(joints)


def noisy(rows, sigma, clip, strength, random):
    noise = random.standard_normal(rows.shape, np.float32) * np.float32(sigma * strength)
    return rows + noise.clip(-clip * strength, clip * strength)


def unit(rows):
    return rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-30)


def sample(mesh, vertex_normals, face_normals, random):
    """Vertices without repetition, then points of faces drawn by the square of their area."""
    own = random.permutation(len(mesh.vertices))[:VERTICES]
    weight = np.square(mesh.area_faces)
    if not weight.sum() > 0:
        weight = np.ones(len(weight))
    points, at = trimesh.sample.sample_surface(mesh, POINTS - len(own), face_weight=weight, seed=random)
    points = np.concatenate([mesh.vertices[own], points])
    return np.float32(points), np.concatenate([vertex_normals[own], face_normals[at]])


def tokens(joints, parents):
    """The skeleton as UniRig's ids: depth first, siblings from low to high, a branch with its parent's place."""
    children = [[] for _ in joints]
    for j in range(1, len(joints)):
        children[parents[j]].append(j)
    for of in children:
        of.sort(key=lambda j: (joints[j][1], joints[j][2], joints[j][0]), reverse=True)
    order, open_ = [], [0]
    while open_:
        j = open_.pop()
        order.append(j)
        open_.extend(children[j])
    cells = np.clip(((joints + 1) / 2 * 256).astype(np.int64), 0, 255).tolist()
    ids, previous = [257, 263], -1
    for j in order:
        if parents[j] != previous:
            ids += [256, *cells[parents[j]]]
        ids += cells[j]
        previous = j
    return ids + [258]


def make(index, seed):
    """Points, normals and tokens of one sample."""
    random = np.random.default_rng(seed)
    vertices, faces, joints, parents, weights = corpus.rig(index)
    if random.random() < 0.5:
        vertices, faces, joints, parents, weights = part(vertices, faces, joints, parents, weights, random)
    if random.random() < 0.5:
        vertices, joints = pose(vertices, joints, parents, weights, random)
    matrix = linear(random)
    vertices, joints = into_cube(vertices @ matrix.T, joints @ matrix.T, random)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    vertex_normals, face_normals = np.float32(mesh.vertex_normals), np.float32(mesh.face_normals)
    if random.random() < 0.5:
        strength, of_normals = random.random(2)
        vertices = noisy(vertices, SIGMA, CLIP, strength, random)
        vertex_normals = unit(noisy(vertex_normals, NORMAL_SIGMA, NORMAL_CLIP, of_normals, random))
        face_normals = unit(noisy(face_normals, NORMAL_SIGMA, NORMAL_CLIP, of_normals, random))
        mesh = trimesh.Trimesh(vertices, faces, process=False)
    points, normals = sample(mesh, vertex_normals, face_normals, random)
    return points, normals, tokens(joints, parents)


def opened(path):
    """The corpus, with all assets read."""
    global corpus
    corpus = Corpus(path)
    for index in range(len(corpus.offsets["vertex"]) - 1):
        corpus.rig(index)


def begun(path, ready):
    """In a worker: its own view of the corpus, on one thread."""
    try:
        opened(path)
    except BaseException:
        ready.abort()
        raise
    ready.wait()


def one(task):
    points, normals, ids = make(*task)
    return [len(points), len(ids), bool(np.isfinite(points).all() and np.isfinite(normals).all())]


pool = None


def load(path, workers):
    """Starts the workers, and waits until each has read all assets: any of them may get any; how many there are."""
    global corpus, pool
    corpus, pool = Corpus(path), None
    if workers > 1:
        context = get_context("spawn")
        ready = context.Barrier(workers + 1)
        pool = context.Pool(workers, begun, (path, ready))
        ready.wait()
    else:
        opened(path)
    return len(corpus.offsets["vertex"]) - 1


def run(assets, seed):
    """Seconds for a sample of each asset, in their order."""
    tasks = [(int(index), [seed, k]) for k, index in enumerate(assets)]
    start = time.perf_counter()
    made = list(pool.imap(one, tasks) if pool else map(one, tasks))
    seconds = time.perf_counter() - start
    faults = [assets[k] for k, (points, _, finite) in enumerate(made) if points != POINTS or not finite]
    return {"seconds": seconds, "faults": faults, "tokens": sum(m[1] for m in made), "memory_mb": peak_memory_mb()}


if __name__ == "__main__":
    serve({"load": load, "run": run})
