"""Metrics of skeletons and skins under each peer's formulas, by numpy and scipy, vectorised where they are."""

import time

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from serve import serve

assets = []


def load(folder, counts):
    """Arrays that riglab's side wrote, an asset after another; how many."""
    read = lambda name, kind: np.fromfile(f"{folder}/{name}", kind)
    floats, wholes, at = read("floats.f64", np.float64), read("wholes.i64", np.int64), [0, 0]

    def take(of, kind, *shape):
        size = int(np.prod(shape))
        at[kind] += size
        return of[at[kind] - size : at[kind]].reshape(shape)

    for joints, true_joints, vertices, edges, poses in counts:
        asset = dict(a=take(floats, 0, joints, 3), b=take(floats, 0, true_joints, 3), tol=take(floats, 0, true_joints))
        asset.update(vertices=take(floats, 0, vertices, 3), turns=take(floats, 0, poses, true_joints, 3, 3))
        skins = [take(floats, 0, vertices, true_joints).astype(np.float32) for _ in range(2)]
        asset.update(truth=skins[0], predicted=skins[1])
        asset.update(pa=take(wholes, 1, joints), pb=take(wholes, 1, true_joints), edges=take(wholes, 1, edges, 2))
        assets.append(asset)
    return len(assets)


def chamfer(p, q):
    d = cdist(p, q)
    return (d.min(1).mean() + d.min(0).mean()) / 2


def by_length(joints, bones):
    points = []
    for parent, child in bones:
        steps = int(np.round(np.linalg.norm(joints[child] - joints[parent]) / 0.005))
        share = (np.arange(steps + 1) / max(steps, 1))[:, None]
        points.append(joints[parent] + share * (joints[child] - joints[parent]))
    return np.concatenate(points)


def by_count(joints, bones):
    share = (np.arange(100) / 100)[None, :, None]
    ends = joints[bones]
    return (ends[:, 1, None] + share * (ends[:, 0] - ends[:, 1])[:, None]).reshape(-1, 3)


def three(a, b, bones_a, bones_b, sample):
    sa, sb = sample(a, bones_a), sample(b, bones_b)
    j2b = (cdist(a, sb).min(1).mean() + cdist(b, sa).min(1).mean()) / 2
    return [chamfer(a, b), j2b, chamfer(sa, sb)]


def merged(joints, bones, root):
    near = cdist(joints, joints) < 0.0025
    name, taken = np.arange(len(joints)), np.zeros(len(joints), bool)
    for i in range(len(joints)):
        if taken[i]:
            continue
        group = np.flatnonzero(near[i] & ~taken & (np.arange(len(joints)) >= i))
        name[group] = root if root is not None and root in group else i
        taken[group] = True
    kept, seen = [], set()
    for bone in name[bones]:
        if bone[0] != bone[1] and tuple(bone) not in seen:
            seen.add(tuple(bone))
            kept.append(bone)
    used = sorted({j for bone in kept for j in bone} | ({int(name[root])} if root is not None else set()))
    place = {j: k for k, j in enumerate(used)}
    return joints[used], np.array([[place[p], place[c]] for p, c in kept])


def segments(points, joints, bones):
    start, along = joints[bones[:, 0]], joints[bones[:, 1]] - joints[bones[:, 0]]
    off = points[:, None] - start
    length = np.maximum((along**2).sum(1), 1e-300)
    t = np.clip((off * along).sum(2) / length, 0, 1)
    return np.linalg.norm(off - t[..., None] * along, axis=2).min(1).mean()


def bones_of(parents):
    return np.array([[p, c] for c, p in enumerate(parents) if p >= 0])


def distances(x):
    a, b, bones_a, bones_b = x["a"], x["b"], bones_of(x["pa"]), bones_of(x["pb"])
    half = three(a / 2, b / 2, bones_a, bones_b, by_length)
    unirig = [d / 2 for d in three(a, b, bones_a, bones_b, by_count)]
    (ma, mba), (mb, mbb) = merged(a / 2, bones_a, None), merged(b / 2, bones_b, 0)
    magic = three(ma, mb, mba, mbb, by_length)
    anymate = three(a, b, bones_a, bones_b, by_length)
    sa, sb = by_length(a / 2, bones_a), by_length(b / 2, bones_b)
    exact = [half[0], (segments(a / 2, b / 2, bones_b) + segments(b / 2, a / 2, bones_a)) / 2]
    exact.append((segments(sa, b / 2, bones_b) + segments(sb, a / 2, bones_a)) / 2)
    return half + unirig + magic + anymate + exact


def matching(x):
    d = cdist(x["a"], x["b"])
    rows, columns = linear_sum_assignment(d)
    out = []
    for tolerance in (x["tol"], np.full(len(x["b"]), 0.1)):
        tp = (d[rows, columns] < tolerance[columns]).sum()
        p, g = d.shape
        out += [2 * tp / (p + g), tp / p, tp / g, tp / (p + g - tp)]
    return out + [(d.min(1) < 0.1).mean(), (d.min(0) < 0.1).mean()]


def post_order(parents):
    children = [[] for _ in parents]
    for child, parent in enumerate(parents):
        if parent >= 0:
            children[parent].append(child)
    leftmost, keyroots = [], []

    def visit(node, eldest):
        first = len(leftmost)
        for k, child in enumerate(children[node]):
            visit(child, k == 0)
        if not eldest or node == 0:
            keyroots.append(len(leftmost))
        leftmost.append(first)

    visit(0, True)
    return leftmost, keyroots


def tree_edit(x):
    """Zhang and Shasha's algorithm: rename 0, insert and delete 1."""
    (la, ka), (lb, kb) = post_order(x["pa"]), post_order(x["pb"])
    trees = [[0] * len(lb) for _ in la]
    for i in ka:
        for j in kb:
            n, m = i - la[i] + 2, j - lb[j] + 2
            forest = [[0] * m for _ in range(n)]
            for k in range(1, n):
                forest[k][0] = k
            forest[0] = list(range(m))
            for k in range(1, n):
                for l in range(1, m):
                    p, q = la[i] + k - 1, lb[j] + l - 1
                    either = 1 + min(forest[k - 1][l], forest[k][l - 1])
                    if la[p] == la[i] and lb[q] == lb[j]:
                        forest[k][l] = trees[p][q] = min(either, forest[k - 1][l - 1])
                    else:
                        forest[k][l] = min(either, forest[la[p] - la[i]][lb[q] - lb[j]] + trees[p][q])
    return [trees[-1][-1]]


def ratio(a, b, empty=np.nan):
    return a / b if b else empty


def skintokens(w, p):
    d = np.abs(w.astype(np.float64) - p)
    a, b = w > np.float32(0.01), p > np.float32(0.01)
    both, miss = (a & b).sum(), a & ~b
    bones, rows = a.any(0), a.any(1)
    cover = [ratio((bones & ~miss.any(0)).sum(), bones.sum()), ratio((rows & ~miss.any(1)).sum(), rows.sum())]
    ratios = [ratio(both, b.sum()), ratio(both, a.sum()), ratio(both, (a | b).sum())]
    return [d.mean(), d.var(), *ratios, *cover, (d < 0.01).mean()]


def unirig(w, p):
    w, p = w.astype(np.float64), p.astype(np.float64)
    d = np.abs(w - p)
    out = [d.mean(), (d * d).mean(), np.where(d < 1, 0.5 * d * d, d - 0.5).mean()]
    out.append(-(w * np.log(p + 1e-6) + (1 - w) * np.log(1 - p + 1e-6)).mean())
    for t in (0.1, 0.01, 0.001):
        a, b = w > t, p > t
        out.append((((a & b).sum(0) + 0.001) / ((a | b).sum(0) + 0.001)).mean())
    out += [(d < t).mean() for t in (0.001, 0.005, 0.01, 0.05)]
    zero = w < 1e-6
    mean = lambda mask: ((d * mask).sum(0) / np.maximum(mask.sum(0), 1)).mean()
    return out + [mean(zero), mean(~zero)]


def by_vertex(w, p, active):
    a, b = active(w), active(p)
    tp = (a & b).sum(1)
    l1 = np.abs(w.astype(np.float64) - p).sum(1).mean()
    return [(tp / np.maximum(b.sum(1), 1)).mean(), (tp / np.maximum(a.sum(1), 1)).mean(), l1]


def puppeteer(w, p, share, edges=None):
    w, p = w.astype(np.float64), p.astype(np.float64)
    p[p < 0.001] = 0
    if edges is not None:
        sums, counts = np.zeros_like(p), np.bincount(edges[:, 0], minlength=len(p))
        np.add.at(sums, edges[:, 0], p[edges[:, 1]])
        p = np.where(counts[:, None] > 0, sums / np.maximum(counts, 1)[:, None], p)
    p[p < share * p.max(1, keepdims=True)] = 0
    total = p.sum(1, keepdims=True)
    p = p / np.where(total > 0, total, 1)
    kept = np.abs(w.sum(1) - 1) < 0.01
    w, p = w[kept], p[kept]
    tp = ((w > 0) & (p > 0)).sum()
    return [ratio(tp, (p > 0).sum(), 0), ratio(tp, (w > 0).sum(), 0), np.abs(w - p).sum(1).mean(), kept.sum()]


def anymate(w, p):
    precision, recall, l1 = by_vertex(w, p, lambda x: x >= np.float32(0.05))
    w, p = w.astype(np.float64), p.astype(np.float64)
    norm = lambda x: np.maximum(np.linalg.norm(x, axis=1), 1e-8)
    cosine = lambda q: 1 - ((w * q).sum(1) / (norm(w) * norm(q))).mean()
    entropy = -(w * np.log(p + 1e-6)).sum(1).mean()
    return [precision, recall, l1 / w.shape[1], l1, cosine(p), cosine(np.maximum(p - 0.001, 0)), entropy]


def skins(x):
    w, p = x["truth"], x["predicted"]
    out = skintokens(w, p) + unirig(w, p) + by_vertex(w, p, lambda v: v > np.float32(1e-4))
    return out + puppeteer(w, p, 0.15) + puppeteer(w, p, 0.35) + puppeteer(w, p, 0.15, x["edges"]) + anymate(w, p)


def motion(x):
    heads, vertices = x["b"], x["vertices"]
    skins = [x[name].astype(np.float64) for name in ("truth", "predicted")]
    apart = []
    for turns in x["turns"]:
        maps = np.zeros((len(heads), 3, 4))
        for j, parent in enumerate(x["pb"]):
            local = np.concatenate([turns[j], (heads[j] - turns[j] @ heads[j])[:, None]], 1)
            if parent >= 0:
                above = maps[parent]
                local = np.concatenate([above[:, :3] @ local[:, :3], above[:, :3] @ local[:, 3:] + above[:, 3:]], 1)
            maps[j] = local
        posed = []
        for w in skins:
            mixed = (w @ maps.reshape(len(heads), 12)).reshape(-1, 3, 4) / (w.sum(1) + 1e-8)[:, None, None]
            posed.append(np.einsum("vij,vj->vi", mixed[:, :, :3], vertices) + mixed[:, :, 3])
        apart.append(np.linalg.norm(posed[0] - posed[1], axis=1))
    d = np.stack(apart)
    return [d.mean(), d.max(), d.max(1).mean(), (d * d).mean() / 3, np.sqrt((d * d).mean())]


PARTS = dict(distances=distances, matching=matching, trees=tree_edit, skins=skins, motion=motion)


def score():
    seconds, values = dict.fromkeys(PARTS, 0.0), []
    for x in assets:
        row = []
        for name, part in PARTS.items():
            start = time.perf_counter()
            row += [float(v) for v in part(x)]
            seconds[name] += time.perf_counter() - start
        values.append([None if np.isnan(v) else v for v in row])
    return dict(seconds=sum(seconds.values()), parts=seconds, values=values)


serve({"load": load, "score": score})
