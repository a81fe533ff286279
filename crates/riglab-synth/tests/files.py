"""Opens the files of a folder in Blender; prints those that lose something. Run with Blender's Python (`pip
install bpy`): python files.py FOLDER"""

import json
import pathlib
import struct
import sys

import bpy

for path in sorted(pathlib.Path(sys.argv[1]).glob("*.glb")):
    data = path.read_bytes()
    document = json.loads(data[20 : 20 + struct.unpack("<I", data[12:16])[0]])
    joints = len(document["skins"][0]["joints"])
    place = document["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
    vertices = document["accessors"][place]["count"]
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=str(path))
    armatures = [o for o in bpy.data.objects if o.type == "ARMATURE"]
    meshes = [o for o in bpy.data.objects if o.type == "MESH" and o.vertex_groups]
    if len(armatures) != 1 or len(meshes) != 1:
        print(f"FAULT {path.name}: {len(armatures)} armatures and {len(meshes)} skinned meshes")
    elif len(armatures[0].data.bones) < joints or len(meshes[0].data.vertices) != vertices:
        print(f"FAULT {path.name}: {len(armatures[0].data.bones)} bones of {joints} joints")
print("OPENED")
