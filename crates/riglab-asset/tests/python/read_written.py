"""Reads what riglab wrote with the libraries the peers use, and compares it with expected.json."""

import json
import sys
from pathlib import Path

import h5py
import numpy as np
import torch

folder = Path(sys.argv[1])
expected = json.loads((folder / "expected.json").read_text())
vertices, faces, joints = (np.array(expected[k], "f4" if k != "faces" else "i8") for k in ("vertices", "faces", "joints"))
parents, names = np.array(expected["parents"]), expected["names"]
weights = np.zeros((len(vertices), len(joints)), "f4")
for v, row in enumerate(expected["weights"]):
    for joint, weight in row:
        weights[v, joint] = weight


def same(a, b, tolerance=0.0):
    a, b = np.asarray(a), np.asarray(b)
    assert a.shape == b.shape, (a.shape, b.shape)
    assert np.abs(a.astype("f8") - b.astype("f8")).max(initial=0) <= tolerance


def z_up(points):
    return np.stack([points[:, 0], -points[:, 2], points[:, 1]], 1)


def parents_of(bones, root):
    out = np.full(len(joints), -1)
    for parent, child in bones:
        out[child] = parent
    assert out[root] == -1
    return out


# Articulation-XL: one list of dictionaries, weights as a coordinate matrix.
rows = np.load(folder / "articulation-xl.npz", allow_pickle=True)
assert rows.files == ["arr_0"] and rows["arr_0"].shape == (1,)
row = rows["arr_0"][0]
same(row["vertices"], vertices), same(row["faces"], faces), same(row["joints"], joints)
same(parents_of(row["bones"], row["root_index"]), parents)
assert row["joint_names"] == names and isinstance(row["uuid"], str)
dense = np.zeros(row["skinning_weights_shape"])
np.add.at(dense, (row["skinning_weights_row"], row["skinning_weights_col"]), row["skinning_weights_value"])
same(dense, weights)
assert row["pc_w_norm"].shape == (8192, 6) and row["pc_w_norm"].dtype == np.float16
same(np.linalg.norm(row["normals"], axis=1), np.ones(len(vertices)), 1e-5)

# UniRig: thirteen members, as the fields of a dataclass.
raw = np.load(folder / "unirig.npz", allow_pickle=True)
keys = "vertices vertex_normals faces face_normals joints skin parents names matrix_local tails no_skin path cls"
assert set(raw.files) == set(keys.split())
same(raw["vertices"], z_up(vertices)), same(raw["joints"], z_up(joints)), same(raw["faces"], faces)
same(raw["skin"], weights)
assert raw["parents"].dtype == object and [-1 if p is None else p for p in raw["parents"]] == parents.tolist()
assert raw["names"].tolist() == names and raw["no_skin"] == None and raw["cls"].shape == ()  # noqa: E711
same(raw["matrix_local"][:, :3, 3], raw["joints"], 1e-6)
along = raw["tails"] - raw["joints"]
along /= np.linalg.norm(along, axis=1, keepdims=True)
same(raw["matrix_local"][:, :3, 1], along, 1e-5)

# SkinTokens: nothing pickled.
tokens = np.load(folder / "skintokens.npz")
same(tokens["vertices"], z_up(vertices)), same(tokens["matrix_local"][:, :3, 3], z_up(joints), 1e-6)
same(tokens["parents"], parents), same(tokens["skin"], weights)
assert tokens["joint_names"].tolist() == names and tokens["lengths"].shape == (len(joints),)

# Anymate: tensors alone.
(record,) = torch.load(folder / "anymate.pt", weights_only=True)
same(record["mesh_pc"][:, :3], vertices), same(record["mesh_face"], faces)
same(record["bones"][:, :3], joints)
assert record["pc"].shape == (8192, 6) and record["vox"].dtype == torch.int8 and record["vox"].max() < 64
assert record["joints"].shape == (record["joints_num"], 3) and len(record["conns"]) == record["joints_num"]
dense = np.zeros_like(weights)
for v, (index, weight) in enumerate(zip(record["mesh_skins_index"], record["mesh_skins_weight"])):
    dense[v, index[index >= 0].numpy().astype(int)] = weight[index >= 0].numpy()
same(dense, weights, 1e-3)

# Puppeteer's HDF5.
with h5py.File(folder / "puppeteer-h5.h5") as h5:
    assert h5.attrs["num_samples"] == 1 and h5.attrs["version"] in ("1.0", b"1.0")
    sample = h5["sample_0"]
    same(sample["vertices"][:], vertices), same(sample["faces"][:], faces), same(sample["joints"][:], joints)
    same(sample["skin"][:], weights), same(parents_of(sample["bones"][:], sample["root_index"][()]), parents)
    assert sample["root_index"].dtype == np.int32 and sample["vertices"].dtype == np.float64
    assert isinstance(sample["file_name"][()].decode(), str)
    assert sample["pc_w_norm"].shape == (8192, 6) and sample["pc_w_norm"].dtype == np.float16
    assert np.abs(sample["pc_w_norm"][:, :3]).max() <= 1.0
    assert sample["graph_dist"].shape == (len(joints), len(joints)) and sample["graph_dist"][0, 0] == 0
    assert sample["edges"].dtype == np.int64


# Texts, in the way RigNet's and Puppeteer's own readers go through them: line by line, in order.
def text(name):
    found, tree, skin, root = {}, {}, {}, None
    for line in (folder / name).read_text(encoding="utf-8").splitlines():
        word = line.split()
        if word[0] == "joints":
            found[word[1]] = [float(x) for x in word[2:5]]
        elif word[0] == "root":
            root = word[1]
            assert root in found
        elif word[0] == "hier":
            tree[word[2]] = word[1]
        elif word[0] == "skin":
            skin[int(word[1])] = {n: float(w) for n, w in zip(word[2::2], word[3::2])}
    same(np.array(list(found.values()), "f4"), joints)
    assert list(found) == names
    assert [-1 if n == root else names.index(tree[n]) for n in names] == parents.tolist()
    dense = np.array([[skin[v].get(n, 0.0) for n in names] for v in range(len(vertices))], "f4")
    same(dense, weights)


def obj(name):
    lines = [line.split() for line in (folder / name).read_text().splitlines()]
    same(np.array([[float(x) for x in w[1:4]] for w in lines if w[0] == "v"], "f4"), vertices)
    same(np.array([[int(c.split("//")[0]) - 1 for c in w[1:]] for w in lines if w[0] == "f"]), faces)


text("rignet_rig.txt"), text("puppeteer.txt")
obj("rignet.obj"), obj("puppeteer.obj"), obj("obj.obj")
