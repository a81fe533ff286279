# Opens pairs of a GLB and a JSON of the rig that was attached to it, and says where Blender reads something else: bones
# and parents by name, heads, the weights of every vertex by its place, and whether bending each bone moves the mesh.
# Run with a Python that has bpy: python read_attached.py FOLDER
import glob
import json
import sys

import bpy
from mathutils import Matrix, Quaternion


def read(path, rig):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=path)
    scene = bpy.context.scene
    found = []
    armatures = [o for o in scene.objects if o.type == 'ARMATURE']
    if len(armatures) != 1:
        return [f'{len(armatures)} armatures']
    armature = armatures[0]
    size = max(max(j['head'][k] for j in rig['joints']) - min(j['head'][k] for j in rig['joints']) for k in range(3))
    size = max(size, rig['size'])
    # glTF (x, y, z) is Blender's (x, -z, y).
    to_gltf = lambda p: (p[0], p[2], -p[1])
    bones = armature.data.bones
    if len(bones) != len(rig['joints']):
        found.append(f'{len(bones)} bones, not {len(rig["joints"])}')
    for joint in rig['joints']:
        bone = bones.get(joint['name'])
        if bone is None:
            found.append(f'no bone {joint["name"]}')
            continue
        parent = bone.parent.name if bone.parent else None
        if parent != joint['parent']:
            found.append(f'{joint["name"]} hangs on {parent}')
        head = to_gltf(armature.matrix_world @ bone.head_local)
        off = max(abs(a - b) for a, b in zip(head, joint['head'])) / size
        if off > 1e-4:
            found.append(f'head of {joint["name"]} off by {off:.1e}')
    # Weights by place: vertices in one place have several rows.
    def key(p):
        return tuple(round(x / size * 2e3) for x in p)
    rows = {}
    for row in rig['vertices']:
        rows.setdefault(key(row['at']), []).append(dict(row['weights']))
    meshes = [o for o in scene.objects if o.type == 'MESH' and any(m.type == 'ARMATURE' for m in o.modifiers)]
    vertices = wrong = lost = 0
    for o in meshes:
        names = {g.index: g.name for g in o.vertex_groups}
        for v in o.data.vertices:
            vertices += 1
            p = to_gltf(o.matrix_world @ v.co)
            own = {names[g.group]: g.weight for g in v.groups if g.weight > 0}
            if not own:
                lost += 1
            near = [r for d in near_keys(key(p)) for r in rows.get(d, [])]
            same = lambda r: all(abs(r.get(n, 0) - own.get(n, 0)) < 2e-3 for n in set(r) | set(own))
            wrong += not any(same(r) for r in near)
    if lost:
        found.append(f'{lost} vertices without weight')
    if wrong:
        found.append(f'weights of {wrong} of {vertices} vertices')
    if not vertices:
        found.append('no bound vertices')
    # Each bone with weight, turned, moves the mesh.
    def points():
        depsgraph = bpy.context.evaluated_depsgraph_get()
        return [tuple(v.co) for o in meshes for v in o.evaluated_get(depsgraph).to_mesh().vertices]
    if armature.animation_data:
        armature.animation_data_clear()
    for bone in armature.pose.bones:
        bone.matrix_basis = Matrix()
    bpy.context.view_layer.update()
    rest = points()
    used = sorted({n for r in rig['vertices'] for n, w in r['weights'] if w > 0.3})
    for name in used[:: max(1, len(used) // 8)]:
        bone = armature.pose.bones.get(name)
        if bone is None:
            continue
        bone.rotation_mode = 'QUATERNION'
        bone.rotation_quaternion = Quaternion((0.9, 0.3, 0.2, 0.25)).normalized()
        bpy.context.view_layer.update()
        moved = points()
        if len(moved) != len(rest) or not any(abs(a - b) > 1e-6 * size for p, q in zip(rest, moved) for a, b in zip(p, q)):
            found.append(f'bending {name} moves nothing')
        if any(x != x for p in moved for x in p):
            found.append(f'bending {name} gives NaN')
        bone.rotation_quaternion = Quaternion()
    motions = [a.name for a in bpy.data.actions]
    if not any('riglab preview' in name for name in motions):
        found.append(f'no preview among {motions[:4]}')
    return found


def near_keys(k):
    return [(k[0] + a, k[1] + b, k[2] + c) for a in (-1, 0, 1) for b in (-1, 0, 1) for c in (-1, 0, 1)]


failed = count = 0
for path in sorted(glob.glob(sys.argv[1] + '/*.glb')):
    with open(path[:-4] + '.json') as f:
        rig = json.load(f)
    found = read(path, rig)
    count += 1
    failed += bool(found)
    if found:
        print(f'{rig["source"]}: ' + '; '.join(found[:5]), file=sys.stderr)
print(f'ATTACHED {count} files, {failed} read otherwise')
sys.exit(1 if failed or not count else 0)
