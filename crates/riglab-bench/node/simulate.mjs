// Spring bones by three-vrm's manager, without drawing.
//
// One JSON request a line, one reply a line, as python/serve.py does it. The scene is that of
// crates/riglab-simulate/tests/three/run.mjs, with shifts of the first joint as its frames.

import { createRequire } from "node:module";
import { createInterface } from "node:readline";

// Packages lie in a folder of their own, not beside this file.
const require = createRequire(process.env.RIGLAB_NODE_MODULES + "/");
const { Object3D, Vector3 } = require("three");
const vrm = require("@pixiv/three-vrm-springbone");

const point = (p) => new Vector3(...p);
let world, root, rest, manager, springs, scene;

function update() {
  // Bones that swing are not updated by themselves.
  world.traverse((object) => object.updateMatrix());
  world.updateWorldMatrix(false, true);
}

const handlers = {
  load({ scene: read }) {
    scene = read;
    world = new Object3D();
    const heads = scene.heads.map(point);
    const bones = [];
    heads.forEach((head, j) => {
      const parent = scene.parents[j];
      const bone = new Object3D();
      bone.position.copy(parent < 0 ? head : head.clone().sub(heads[parent]));
      (parent < 0 ? world : bones[parent]).add(bone);
      bones.push(bone);
    });
    const groups = scene.groups.map((group) => ({
      colliders: group.map(({ joint, from, to, radius }) => {
        const offset = point(from).sub(heads[joint]);
        const shape = to
          ? new vrm.VRMSpringBoneColliderShapeCapsule({ offset, tail: point(to).sub(heads[joint]), radius })
          : new vrm.VRMSpringBoneColliderShapeSphere({ offset, radius });
        const collider = new vrm.VRMSpringBoneCollider(shape);
        bones[joint].add(collider);
        return collider;
      }),
    }));
    manager = new vrm.VRMSpringBoneManager();
    springs = scene.springs.map((s) => {
      const at = point(s.tail);
      const under = (b, j) => scene.parents[j] === s.joint && heads[j].distanceTo(at) === 0;
      const child = bones.find(under) ?? new Object3D();
      if (!child.parent) {
        child.position.copy(at).sub(heads[s.joint]);
        bones[s.joint].add(child);
      }
      const settings = {
        stiffness: s.stiffness, dragForce: s.drag, gravityPower: s.power, gravityDir: point(s.direction), hitRadius: s.radius,
      };
      const joint = new vrm.VRMSpringBoneJoint(bones[s.joint], child, settings, s.groups.map((g) => groups[g]));
      manager.addJoint(joint);
      return joint;
    });
    root = bones[0];
    rest = root.position.clone();
    update();
    manager.setInitState();
    return springs.length;
  },
  play({ times }) {
    const shifts = scene.shifts.map(point);
    const start = performance.now();
    for (let i = 0; i < times; i++) {
      root.position.copy(rest);
      update();
      manager.reset();
      update();
      for (const shift of shifts) {
        root.position.copy(rest).add(shift);
        manager.update(scene.dt);
      }
    }
    const seconds = (performance.now() - start) / 1e3;
    update();
    return { seconds, tails: springs.flatMap(({ child }) => child.getWorldPosition(new Vector3()).toArray()) };
  },
};

for await (const line of createInterface({ input: process.stdin })) {
  const request = JSON.parse(line);
  let reply;
  try {
    reply = { ok: handlers[request.do](request) };
  } catch (e) {
    reply = { error: String(e).split("\n")[0] };
  }
  process.stdout.write(JSON.stringify(reply) + "\n");
}
