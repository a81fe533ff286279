// Spring bones as three-vrm moves them: a scene on standard input, where tails are on standard output.
//
// `node run.mjs < scene.json`, with @pixiv/three-vrm-springbone and three in RIGLAB_NODE_MODULES. The scene:
//   parents  of each joint, -1 for the first        heads  positions at rest
//   springs  [{joint, tail, stiffness, drag, power, direction, radius, groups, center}]
//   groups   [[{joint, from, to?, radius}]], points at rest; `to` makes a capsule
//   dt       seconds of a frame
//   frames   [{shift, turns: [[joint, [x, y, z, w]], ...]}]; the first is the rest pose
// Answers {package, tails: by frame, by spring, x, y and z}.
//
// Joints have the scene's axes at rest. `update` of the manager takes a bone's length between the bone, which
// has moved, and its child as it was before; so lengths change with the motion, which VRM does not want. Here
// all nodes are brought up to date before each joint's `update` (`manager` as argument: as the manager does).

import { readFileSync } from "node:fs";
import { createRequire } from "node:module";

const require = createRequire(process.env.RIGLAB_NODE_MODULES + "/");
const { Object3D, Vector3 } = require("three");
const vrm = require("@pixiv/three-vrm-springbone");
const { version } = require("@pixiv/three-vrm-springbone/package.json");

const point = (p) => new Vector3(...p);
const scene = JSON.parse(readFileSync(0));
const heads = scene.heads.map(point);
const world = new Object3D();
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
const manager = new vrm.VRMSpringBoneManager();
const springs = scene.springs.map((s) => {
  const at = point(s.tail);
  const child = bones.find((b, j) => scene.parents[j] === s.joint && heads[j].distanceTo(at) === 0) ?? new Object3D();
  if (!child.parent) {
    child.position.copy(at).sub(heads[s.joint]);
    bones[s.joint].add(child);
  }
  const settings = {
    stiffness: s.stiffness, dragForce: s.drag, gravityPower: s.power, gravityDir: point(s.direction), hitRadius: s.radius,
  };
  const joint = new vrm.VRMSpringBoneJoint(bones[s.joint], child, settings, s.groups.map((g) => groups[g]));
  if (s.center >= 0) joint.center = bones[s.center];
  manager.addJoint(joint);
  return joint;
});
// Bones that swing are not updated by themselves.
const update = () => {
  for (const bone of bones) bone.updateMatrix();
  world.updateWorldMatrix(false, true);
};
update();
manager.setInitState();
const managed = process.argv[2] === "manager";
const tails = [];
const rest = bones[0].position.clone();
for (const frame of scene.frames) {
  bones[0].position.copy(rest).add(point(frame.shift));
  for (const [joint, turn] of frame.turns) bones[joint].quaternion.set(...turn);
  if (managed) {
    manager.update(scene.dt);
  } else {
    for (const joint of manager._sortedJoints) {
      update();
      joint.update(scene.dt);
    }
  }
  update();
  tails.push(springs.flatMap(({ child }) => child.getWorldPosition(new Vector3()).toArray()));
}
process.stdout.write(JSON.stringify({ package: `@pixiv/three-vrm-springbone@${version}`, tails }));
