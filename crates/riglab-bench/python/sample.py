"""Points of a surface with normals and skinning weights, by trimesh and by plain numpy.

Each cloud starts from bare arrays, as training does: a mesh that was augmented has no areas or normals
kept from the time before. Weights are a table of vertices and joints, as the public code of UniRig and
SkinTokens has them.
"""

import time

import numpy as np
import trimesh

from serve import serve

mesh = {}


def load(folder, joints):
    """Arrays that the other side wrote."""
    mesh["vertices"] = np.fromfile(f"{folder}/positions.f32", np.float32).reshape(-1, 3)
    mesh["faces"] = np.fromfile(f"{folder}/triangles.u32", np.uint32).reshape(-1, 3).astype(np.int64)
    mesh["weights"] = np.fromfile(f"{folder}/weights.f32", np.float32).reshape(-1, joints)
    return len(mesh["vertices"])


def mixed(values, faces, shares):
    """Rows of `values` at the corners of faces, mixed by their shares."""
    out = values[faces[:, 0]] * shares[:, :1]
    out += values[faces[:, 1]] * shares[:, 1:2]
    out += values[faces[:, 2]] * shares[:, 2:]
    return out


def by_trimesh(count, random):
    """Sampled by trimesh; shares of the corners found again from the points, as UniRig's public code does
    for what it samples later."""
    own = trimesh.Trimesh(mesh["vertices"], mesh["faces"], process=False)
    points, at = trimesh.sample.sample_surface(own, count, seed=random)
    shares = trimesh.triangles.points_to_barycentric(own.triangles[at], points)
    return points, own.face_normals[at], mixed(mesh["weights"], mesh["faces"][at], shares.astype(np.float32))


def by_numpy(count, random):
    """The same steps by hand, in single precision, with the shares that the points are made of."""
    vertices, faces = mesh["vertices"], mesh["faces"]
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    area = np.linalg.norm(across, axis=1)
    normals = across / np.maximum(area, 1e-30)[:, None]
    sums = np.cumsum(area, dtype=np.float64)
    at = np.searchsorted(sums, random.random(count) * sums[-1], "right").clip(max=len(faces) - 1)
    u, v = random.random((2, count), np.float32)
    over = u + v > 1
    u, v = np.where(over, 1 - u, u), np.where(over, 1 - v, v)
    shares, corners = np.stack([1 - u - v, u, v], 1), faces[at]
    return mixed(vertices, corners, shares), normals[at], mixed(mesh["weights"], corners, shares)


WAYS = {"trimesh": by_trimesh, "numpy": by_numpy}


def draw(way, points, times, seed):
    """Seconds for some clouds, and the means of the first: position, normal, weight of each joint."""
    one, means = WAYS[way], None
    start = time.perf_counter()
    for k in range(times):
        cloud = one(points, np.random.default_rng([seed, k]))
        if means is None:
            means = cloud
    seconds = time.perf_counter() - start
    return {"seconds": seconds, "means": [float(x) for part in means for x in part.mean(0)]}


serve({"load": load, "draw": draw})
