"""Distances from joints to vertices over a graph of cells and vertices, by scipy.

The graph is that of UniRig's public code (voxel skin), written anew: cells are joined across faces at three times
their length, each cell with the vertex nearest to it, vertices along the mesh's edges.
"""

import time

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from serve import serve

body = {}


def load(folder, cell):
    """Arrays that riglab's side wrote; the number of cells."""
    read = lambda name, kind: np.fromfile(f"{folder}/{name}", kind).reshape(-1, 3)
    body.update(vertices=read("vertices.f64", np.float64), faces=read("faces.i64", np.int64), cell=cell)
    body.update(cells=read("cells.f64", np.float64), joints=read("joints.f64", np.float64))
    return len(body["cells"])


def graph():
    vertices, faces, cells, cell = (body[k] for k in ("vertices", "faces", "cells", "cell"))
    n = len(vertices)
    edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    parts = [(edges[:, 0], edges[:, 1], np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1))]
    d, at = cKDTree(cells).query(cells, 7)
    one, k = np.nonzero((d > 0) & (d < cell * 1.001))
    parts.append((one + n, at[one, k] + n, 3 * d[one, k]))
    tree = cKDTree(vertices)
    d, at = tree.query(cells, 1)
    one = np.nonzero((d > 0) & (d < cell * 1.001))[0]
    parts.append((one + n, at[one], d[one]))
    d, at = tree.query(vertices, 3)
    one, k = np.nonzero((d > 0) & (d < 1.001e-5))
    parts.append((one, at[one, k], d[one, k]))
    rows, columns, lengths = (np.concatenate(p) for p in zip(*parts))
    nodes = np.concatenate([vertices, cells])
    return nodes, coo_matrix((lengths, (rows, columns)), (len(nodes), len(nodes))).tocsr()


def distances():
    """Seconds, and the mean distance of what is reached."""
    start = time.perf_counter()
    nodes, ways = graph()
    _, starts = cKDTree(nodes).query(body["joints"])
    found = dijkstra(ways, directed=False, indices=starts)[:, : len(body["vertices"])]
    seconds = time.perf_counter() - start
    return {"seconds": seconds, "mean": float(found[np.isfinite(found)].mean())}


if __name__ == "__main__":
    serve({"load": load, "distances": distances})
