# Opens pairs of files, N.before.glb and N.after.glb, and says where Blender reads the second otherwise: bones and parents
# by name, heads, materials, and of each mesh the vertices, their places and weights.
# Run with a Python that has bpy: python compare_exports.py FOLDER
import glob
import sys

import bpy


def read(path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    try:
        bpy.ops.import_scene.gltf(filepath=path)
    except (Exception, SystemExit) as fault:
        return str(fault).strip().splitlines()[-1]
    objects = list(bpy.context.scene.objects)
    bones = {}
    for o in objects:
        if o.type == 'ARMATURE':
            for bone in o.data.bones:
                bones[o.name, bone.name] = (bone.parent and bone.parent.name, tuple(o.matrix_world @ bone.head_local))
    meshes = {}
    for o in objects:
        if o.type != 'MESH':
            continue
        names = {g.index: g.name for g in o.vertex_groups}
        vertices = [(tuple(o.matrix_world @ v.co), shares({names[g.group]: g.weight for g in v.groups if g.weight > 0}))
                    for v in o.data.vertices]
        meshes[o.name] = ([m and m.name for m in o.data.materials], len(o.data.polygons), vertices)
    points = [p for m in meshes.values() for p, _ in m[2]] or [(0, 0, 0), (1, 1, 1)]
    size = max(max(p[k] for p in points) - min(p[k] for p in points) for k in range(3))
    return bones, meshes, size


def shares(weights):
    # What a source has not normalised, Blender normalises as it bends the mesh.
    total = sum(weights.values())
    return {name: weight / total for name, weight in weights.items()}


def differences(before, after):
    found = []
    bones, meshes, size = before
    near = lambda a, b, most: all(abs(x - y) <= most for x, y in zip(a, b))
    if bones.keys() != after[0].keys():
        found.append(f'{len(after[0])} bones, not {len(bones)}, or other names')
    for name in bones.keys() & after[0].keys():
        (parent, head), (other, at) = bones[name], after[0][name]
        if parent != other or not near(head, at, 1e-5 * size):
            found.append(f'bone {name}')
    if meshes.keys() != after[1].keys():
        found.append(f'meshes {sorted(after[1])}, not {sorted(meshes)}')
    for name in meshes.keys() & after[1].keys():
        (materials, faces, vertices), (others, count, own) = meshes[name], after[1][name]
        if (materials, faces, len(vertices)) != (others, count, len(own)):
            found.append(f'{name}: materials, {count} faces or {len(own)} vertices')
            continue
        same = lambda a, b: all(abs(a.get(n, 0) - b.get(n, 0)) < 1e-3 for n in a.keys() | b.keys())
        wrong = sum(not (near(p, q, 1e-5 * size) and same(a, b)) for (p, a), (q, b) in zip(vertices, own))
        if wrong:
            found.append(f'{name}: {wrong} of {len(own)} vertices or their weights')
    return found


same = only_after = neither = failed = 0
for path in sorted(glob.glob(sys.argv[1] + '/*.before.glb')):
    before, after = read(path), read(path.replace('.before.', '.after.'))
    if isinstance(after, str):
        neither += isinstance(before, str)
        failed += not isinstance(before, str)
        print(f'{path}: {after}', file=sys.stderr)
    elif isinstance(before, str):
        only_after += 1
    else:
        found = differences(before, after)
        failed += bool(found)
        same += not found
        if found:
            print(f'{path}: ' + '; '.join(found[:5]), file=sys.stderr)
print(f'EXPORTS {same} the same, {only_after} open only after, {neither} in neither form, {failed} otherwise')
sys.exit(1 if failed or not same else 0)
