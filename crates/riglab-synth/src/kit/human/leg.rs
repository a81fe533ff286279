//! Legs and feet.

use glam::Vec3;
use riglab_core::JointId;

use super::Figure;
use crate::body::{Body, Node, Side};
use crate::part::Ring;
use crate::turn::{direction, turned};

impl Figure {
    /// Thigh, calf and foot; gives the foot.
    pub fn leg(&mut self, side: Side) -> JointId {
        let s = self.shape;
        let hip = Vec3::new(s.hip_joint, self.hips_y() - 0.012, 0.0);
        let ankle_y = 0.62 * s.ankle + 0.022;
        let reach = hip.y - ankle_y;
        // Down and apart, the knee before the line from hip to ankle.
        let apart = turned(-Vec3::Y, Vec3::Z, self.stance.legs_apart);
        let knee_share = 0.515;
        let length = self.limb(reach, side);
        let forward = crate::turn::sin_cos(self.stance.knee).0 * 0.25 * length;
        let knee = hip + apart * (knee_share * length) + Vec3::Z * (forward + 0.01 * length);
        let ankle = hip + apart * length - Vec3::Z * (0.02 * length);
        let (thigh, calf) = (s.thigh, s.calf);
        let nodes = [
            Node::round(side.of(hip), thigh).belly(0.04 * thigh),
            Node::round(side.of(knee), s.knee).belly(calf),
            Node::round(side.of(ankle), s.ankle),
        ];
        let shin = self.twisted(Body::ROOT, side, ["UpperLeg", "LowerLeg"], &nodes, Vec3::X, false);
        // The foot: ankle to ball, ball to toes, and the heel behind.
        let size = s.foot;
        let toes = direction(self.stance.toes_out, 0.0);
        let r = s.ankle;
        let sole = ankle.y - ankle_y;
        let ball = Vec3::new(ankle.x, sole + 0.115 * size, ankle.z) + toes * (0.46 * size);
        let tip = Vec3::new(ankle.x, sole + 0.095 * size, ankle.z) + toes * (0.66 * size);
        let nodes = [
            Node::round(side.of(ankle), 1.0 * r),
            Node::new(side.of(ball), Ring::oval(0.20 * size, 0.115 * size)),
            Node::new(side.of(tip), Ring::oval(0.17 * size, 0.095 * size)),
        ];
        let foot = self.bone(shin, &side.bone("Foot"), nodes[0].at);
        let toe = if self.toes { self.bone(foot, &side.bone("Toes"), nodes[1].at) } else { foot };
        self.body.flesh(&[foot, toe], &nodes, Vec3::X);
        let heel = Vec3::new(ankle.x, sole + 0.14 * size, ankle.z) - toes * (0.06 * size);
        self.body.mass(foot, side.of(heel), side.of(toes), Vec3::new(0.15 * size, 0.14 * size, 0.21 * size));
        foot
    }
}
