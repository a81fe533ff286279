//! Wings: feathers on an arm, or a membrane between fingers.

use glam::Vec3;
use riglab_core::JointId;

use crate::body::{Body, Node, Side};
use crate::piece::{Control, Piece, Sheet};
use crate::turn::turned;

/// A wing; directions are those of the left one.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wing {
    pub root: Vec3,
    /// Where it points, and where its trailing edge lies from the leading one.
    pub out: Vec3,
    pub back: Vec3,
    pub span: f32,
    /// Width at the root.
    pub chord: f32,
    /// Radius of the arm at the root.
    pub thick: f32,
}

impl Wing {
    /// Points of shoulder, elbow, wrist and tip: the elbow behind, the wrist before the straight way.
    fn arm(&self) -> [Vec3; 4] {
        let at = |t: f32, back: f32| self.root + self.out * (self.span * t) + self.back * (self.chord * back);
        [at(0.0, 0.0), at(0.28, 0.16), at(0.58, -0.08), at(0.82, 0.06)]
    }

    /// A feathered wing of three joints below the shoulder blade's; with `feathers` above 0 as many
    /// joints more along the trailing edge.
    pub fn feathered(self, body: &mut Body, parent: JointId, side: Side, feathers: usize) -> JointId {
        let name = |part: &str| format!("{part}_{}", side.word().to_lowercase());
        let arm = self.arm();
        let radii = [1.0, 0.8, 0.6, 0.3].map(|r| r * self.thick);
        let nodes: Vec<Node> = (0..4).map(|k| Node::round(side.of(arm[k]), radii[k])).collect();
        let joints = body.chain(parent, ["wing_upper", "wing_fore", "wing_hand"].map(name), &nodes, Vec3::Y);
        let ribs = 7;
        // Each rib starts on the arm and is held by the joint whose bone it starts on.
        let on_arm = |t: f32| {
            let stops = [0.0, 0.34, 0.70, 1.0];
            let k = if t < 0.34 {
                0
            } else if t < 0.70 {
                1
            } else {
                2
            };
            let s = (t - stops[k]) / (stops[k + 1] - stops[k]);
            (arm[k] + (arm[k + 1] - arm[k]) * s, k)
        };
        let ribs: Vec<Vec<Control>> = (0..ribs)
            .map(|rib| {
                let t = rib as f32 / (ribs - 1) as f32;
                let (start, k) = on_arm(t);
                // Feathers turn outwards towards the tip.
                let lean = (self.back + self.out * (1.1 * t * t)).normalize();
                let length = self.chord * (1.0 - 0.35 * t + 0.45 * t * t) * (1.0 - 2.2 * (t - 0.75).max(0.0));
                let has_own = feathers > 0 && rib * feathers / 7 != (rib + 1) * feathers / 7;
                let mut own = joints[k];
                if has_own {
                    let at = start + lean * (0.3 * length);
                    own = body.joint(joints[k], name(&format!("feather_{}", rib + 1)), side.of(at));
                }
                [(-0.06, joints[k]), (0.5, own), (1.0, own)]
                    .map(|(s, joint)| Control { at: side.of(start + lean * (length * s)), joint: joint.0 })
                    .into()
            })
            .collect();
        body.pieces.push(Piece::Sheet(Sheet { ribs, thickness: 0.5 * self.thick, round: false }));
        joints[0]
    }

    /// A wing of skin between an arm and `fingers` fingers of two joints, tied to the flank at `flank`.
    pub fn membrane(
        self,
        body: &mut Body,
        parent: JointId,
        side: Side,
        fingers: usize,
        flank: Vec3,
        layers: bool,
    ) -> JointId {
        let name = |part: &str| format!("{part}_{}", side.word().to_lowercase());
        let [shoulder, elbow, wrist, _] = self.arm();
        let nodes = [
            Node::round(side.of(shoulder), self.thick),
            Node::round(side.of(elbow), 0.75 * self.thick),
            Node::round(side.of(wrist), 0.55 * self.thick),
        ];
        let arm = body.chain(parent, ["wing_upper", "wing_fore"].map(name), &nodes, Vec3::Y);
        let hand = body.joint(arm[1], name("wing_hand"), side.of(wrist));
        body.mass(hand, side.of(wrist), Vec3::Z, Vec3::splat(0.62 * self.thick));
        let normal = self.out.cross(self.back).normalize();
        // From the leading finger, nearly along the wing, to the last, nearly straight back.
        let mut ribs = Vec::new();
        for k in 0..fingers {
            let t = if fingers > 1 { k as f32 / (fingers - 1) as f32 } else { 0.0 };
            let along = turned(self.out, normal, 12.0 + 78.0 * t);
            let length = self.span * (0.50 - 0.12 * t) + self.chord * 0.45 * t;
            let tip = |s: f32| wrist + along * (length * s) - normal * (0.06 * length * s * s);
            let nodes = [0.04, 0.5, 1.0].map(|s| Node::round(side.of(tip(s)), self.thick * (0.42 - 0.34 * s)));
            let names = (1..=2).map(|j| name(&format!("wing_finger_{}_{j}", k + 1)));
            let joints = body.strand(hand, names, &nodes, Vec3::Y);
            // Within the flesh of the hand, but not all in one point: triangles there would have no area.
            let start = 0.5 * self.thick / length;
            ribs.push([(start, hand), (0.5, joints[0]), (1.0, joints[1])].map(|(s, joint)| (tip(s), joint)));
        }
        let last = ribs[fingers - 1];
        let middle = elbow + self.back * (0.75 * self.chord);
        let inner = [
            last,
            [(elbow, arm[1]), (0.5 * (elbow + middle), arm[0]), (middle, arm[0])],
            [(shoulder, parent), (0.5 * (shoulder + flank), parent), (flank, parent)],
        ];
        let thickness = if layers { 0.16 * self.thick } else { 0.0 };
        for ribs in [ribs, inner.into()] {
            if ribs.len() > 1 {
                let control = |(at, joint): (Vec3, JointId)| Control { at: side.of(at), joint: joint.0 };
                let ribs = ribs.iter().map(|rib| rib.iter().copied().map(control).collect()).collect();
                body.pieces.push(Piece::Sheet(Sheet { ribs, thickness, round: false }));
            }
        }
        arm[0]
    }
}

/// A fan of feathers behind a bird or a fin behind a snake: held by one joint or two.
pub(crate) fn fan(
    body: &mut Body,
    joints: [JointId; 2],
    root: Vec3,
    back: Vec3,
    length: f32,
    half_angle: f32,
    thick: f32,
) {
    let ribs = 5;
    let up = back.cross(Vec3::X).normalize_or(Vec3::Y);
    let ribs = (0..ribs).map(|k| {
        let t = 2.0 * k as f32 / (ribs - 1) as f32 - 1.0;
        let along = turned(back, up, half_angle * t);
        let from = root + Vec3::X * (-0.25 * thick * t);
        [(0.0, joints[0]), (0.5, joints[1]), (1.0 - 0.12 * t * t, joints[1])]
            .map(|(s, joint)| Control { at: from + along * (length * s), joint: joint.0 })
            .to_vec()
    });
    let ribs = ribs.collect();
    body.pieces.push(Piece::Sheet(Sheet { ribs, thickness: 0.3 * thick, round: false }));
}
