"""Arrays of rigs written as GLB: all of them by pygltflib with numpy, or the mesh alone by trimesh.

Arrays, names and trees are at hand before time counts. What the format asks for beside them, bounds of
positions among it, is made while it does.
"""

import json
import time
from pathlib import Path

import numpy as np
import pygltflib
import trimesh
from pygltflib import Accessor, Asset, Attributes, Buffer, BufferView, GLTF2, Mesh, Node, Primitive, Scene, Skin

from serve import serve

TYPES = {5121: "<u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
CODES = {np.dtype(name): code for code, name in TYPES.items()}
WIDTH = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}
NAMES = {width: name for name, width in WIDTH.items()}


class Rig:
    """What a GLB of one mesh and one skin holds."""

    def __init__(self, file):
        content = Path(file).read_bytes()
        length = int.from_bytes(content[12:16], "little")
        document, data = json.loads(content[20 : 20 + length]), content[28 + length :]

        def array(number):
            accessor = document["accessors"][number]
            start = document["bufferViews"][accessor["bufferView"]]["byteOffset"]
            dtype, width = np.dtype(TYPES[accessor["componentType"]]), WIDTH[accessor["type"]]
            return np.frombuffer(data, dtype, accessor["count"] * width, start).reshape(-1, width).copy()

        primitive, skin = document["meshes"][0]["primitives"][0], document["skins"][0]
        self.name = document["meshes"][0]["name"]
        self.attributes = {name: array(number) for name, number in primitive["attributes"].items()}
        self.indices = array(primitive["indices"])
        self.inverse_binds = array(skin["inverseBindMatrices"])
        # The joints come first, then what marks tails of springs and holds the mesh.
        place = {node: joint for joint, node in enumerate(skin["joints"])}
        nodes = [document["nodes"][node] for node in skin["joints"]]
        self.joints = [
            (n["name"], n["translation"], [place[c] for c in n.get("children", []) if c in place]) for n in nodes
        ]
        own = self.attributes
        self.mesh = trimesh.Trimesh(
            own["POSITION"], self.indices.reshape(-1, 3), vertex_normals=own["NORMAL"], process=False
        )


def by_pygltflib(rig):
    parts, views, accessors, length = [], [], [], 0

    def add(array, target=None, bounds=False):
        nonlocal length
        data = array.tobytes()
        views.append(BufferView(buffer=0, byteOffset=length, byteLength=len(data), target=target))
        pad = -len(data) % 4
        parts.extend((data, bytes(pad)))
        length += len(data) + pad
        accessor = Accessor(
            bufferView=len(views) - 1,
            componentType=CODES[array.dtype],
            count=len(array),
            type=NAMES[array.shape[1]],
        )
        if bounds:
            accessor.min, accessor.max = array.min(0).tolist(), array.max(0).tolist()
        accessors.append(accessor)
        return len(accessors) - 1

    attributes = Attributes()
    for name, array in rig.attributes.items():
        setattr(attributes, name, add(array, pygltflib.ARRAY_BUFFER, name == "POSITION"))
    indices = add(rig.indices, pygltflib.ELEMENT_ARRAY_BUFFER)
    binds = add(rig.inverse_binds)
    nodes = [Node(name=name, translation=at, children=below) for name, at, below in rig.joints]
    count = len(nodes)
    nodes.append(Node(name=rig.name, mesh=0, skin=0))
    document = GLTF2(
        asset=Asset(version="2.0"),
        scene=0,
        scenes=[Scene(nodes=[0, count])],
        nodes=nodes,
        meshes=[Mesh(name=rig.name, primitives=[Primitive(attributes=attributes, indices=indices)])],
        skins=[Skin(joints=list(range(count)), inverseBindMatrices=binds, skeleton=0)],
        accessors=accessors,
        bufferViews=views,
        buffers=[Buffer(byteLength=length)],
    )
    document.set_binary_blob(b"".join(parts))
    return b"".join(document.save_to_bytes())


def by_trimesh(rig):
    return rig.mesh.export(file_type="glb", include_normals=True)


WRITERS = {"pygltflib": by_pygltflib, "trimesh": by_trimesh}


class Side:
    def load(self, files):
        self.rigs = [Rig(file) for file in files]
        return len(self.rigs)

    def write(self, writer):
        """Seconds for all rigs."""
        one = WRITERS[writer]
        start = time.perf_counter()
        for rig in self.rigs:
            one(rig)
        return time.perf_counter() - start

    def store(self, writer, files):
        """What is written, as files."""
        for rig, file in zip(self.rigs, files, strict=True):
            Path(file).write_bytes(WRITERS[writer](rig))


side = Side()
serve({name: getattr(side, name) for name in ("load", "write", "store")})
