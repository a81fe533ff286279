"""Near-duplicates by comparing all pairs of descriptions with numpy."""

import time

import numpy as np

from serve import serve

BLOCK = 512
state = {}


def load(path, columns):
    state["rows"] = np.fromfile(path, "<i4").reshape(-1, columns)
    return len(state["rows"])


def find(tolerance):
    """Pairs whose joints are about as many and whose numbers all differ by at most the tolerance."""
    rows = state["rows"]
    # A column in a row: what is compared lies together.
    columns = np.ascontiguousarray(rows[:, 1:].T)
    joints = rows[:, 0]
    start, pairs = time.perf_counter(), 0
    for begin in range(0, len(rows), BLOCK):
        end = min(begin + BLOCK, len(rows))
        # By the first number for all pairs of the block, by the others for those that are left.
        near = np.abs(columns[0, begin:end, None] - columns[0, None, :end]) <= tolerance
        a, b = np.nonzero(near)
        a += begin
        a, b = a[b < a], b[b < a]
        for column in columns[1:]:
            kept = np.abs(column[a] - column[b]) <= tolerance
            a, b = a[kept], b[kept]
        few, many = np.minimum(joints[a], joints[b]), np.maximum(joints[a], joints[b])
        pairs += int((many - few <= many // 50).sum())
    return {"seconds": time.perf_counter() - start, "pairs": pairs}


serve({"load": load, "find": find})
