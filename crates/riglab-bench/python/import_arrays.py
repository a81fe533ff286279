"""Arrays of rigged files, by pygltflib with numpy and by trimesh."""

import io
import json
import time

import numpy as np
import pygltflib
import trimesh

from serve import peak_memory_mb, serve

TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


def array(document, data, number):
    """An accessor as rows of numbers; whole ones that are normalised as shares."""
    accessor = document.accessors[number]
    view = document.bufferViews[accessor.bufferView]
    dtype, width = np.dtype(TYPES[accessor.componentType]), WIDTH[accessor.type]
    start = (view.byteOffset or 0) + (accessor.byteOffset or 0)
    stride = view.byteStride or dtype.itemsize * width
    rows = np.ndarray((accessor.count, width), dtype, data, start, (stride, dtype.itemsize)).copy()
    if accessor.sparse is not None:
        raise ValueError("sparse accessors are not read")
    if accessor.normalized and dtype.kind in "iu":
        return np.maximum(rows / np.float32(np.iinfo(dtype).max), -1)
    return rows


def by_pygltflib(file):
    """Positions, triangles, joints, weights and inverse bind matrices, as the file has them."""
    document = pygltflib.GLTF2().load(file)
    data, total = document.binary_blob(), 0
    for mesh in document.meshes:
        for primitive in mesh.primitives:
            own = primitive.attributes
            parts = [own.POSITION, primitive.indices, own.JOINTS_0, own.WEIGHTS_0]
            total += sum(array(document, data, part).size for part in parts if part is not None)
    for skin in document.skins:
        if skin.inverseBindMatrices is not None:
            total += array(document, data, skin.inverseBindMatrices).size
    return total


def rows_of(document, data, number):
    """As `array`, of plain JSON."""
    accessor = document["accessors"][number]
    view = document["bufferViews"][accessor["bufferView"]]
    dtype, width = np.dtype(TYPES[accessor["componentType"]]), WIDTH[accessor["type"]]
    start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    stride = view.get("byteStride", dtype.itemsize * width)
    rows = np.ndarray((accessor["count"], width), dtype, data, start, (stride, dtype.itemsize)).copy()
    if "sparse" in accessor:
        raise ValueError("sparse accessors are not read")
    if accessor.get("normalized") and dtype.kind in "iu":
        return np.maximum(rows / np.float32(np.iinfo(dtype).max), -1)
    return rows


def by_trimesh(file):
    """Positions and triangles by trimesh; what it leaves out, joints, weights and bind matrices, by numpy."""
    with open(file, "rb") as f:
        content = f.read()
    scene = trimesh.load_scene(io.BytesIO(content), file_type="glb", process=False, skip_materials=True)
    total = sum(mesh.vertices.size + mesh.faces.size for mesh in scene.geometry.values())
    length = int.from_bytes(content[12:16], "little")
    document, data = json.loads(content[20 : 20 + length]), content[28 + length :]
    for mesh in document["meshes"]:
        for primitive in mesh["primitives"]:
            own = primitive["attributes"]
            total += sum(rows_of(document, data, own[key]).size for key in ("JOINTS_0", "WEIGHTS_0") if key in own)
    for skin in document.get("skins", []):
        if "inverseBindMatrices" in skin:
            total += rows_of(document, data, skin["inverseBindMatrices"]).size
    return total


READERS = {"pygltflib": by_pygltflib, "trimesh": by_trimesh}


def read(reader, files):
    """Seconds for all files, and those that were refused."""
    one, refused = READERS[reader], []
    start = time.perf_counter()
    for file in files:
        try:
            if one(file) == 0:
                refused.append(file)
        except Exception:
            refused.append(file)
    return {"seconds": time.perf_counter() - start, "refused": refused, "memory_mb": peak_memory_mb()}


serve({"read": read})
