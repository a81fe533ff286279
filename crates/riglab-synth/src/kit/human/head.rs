//! Neck, skull and face.

use glam::Vec3;
use riglab_core::JointId;

use super::Figure;
use crate::body::{Node, Side};
use crate::dice::Dice;
use crate::turn::direction;

impl Figure {
    /// Neck and head; gives the head.
    pub fn head(&mut self, chest: JointId, dice: &mut Dice) -> JointId {
        let s = self.shape;
        let h = s.head;
        let base = Vec3::new(0.0, self.neck_y(), -0.008);
        let skull = Vec3::new(0.0, 1.0 - s.head + 0.12 * h, -0.002);
        let r = s.neck_radius;
        let neck = self.bone(chest, "neck", base);
        let low = base - Vec3::Y * (0.5 * r);
        let nodes = [Node::round(low, 1.25 * r), Node::round(skull, r)];
        self.body.flesh(&[neck], &nodes, Vec3::X);
        let head = self.bone(neck, "head", skull);
        let (w, d) = (0.5 * s.head_width * h, 0.5 * s.head_depth * h);
        // Skull, face with jaw, nose, ears.
        let crown = skull + Vec3::new(0.0, 0.44 * h, 0.02 * h);
        self.body.mass(head, crown, Vec3::Z, Vec3::new(w, 0.44 * h, d));
        let jaw = skull + Vec3::new(0.0, 0.16 * h, 0.24 * d);
        let jaw_size = dice.between(0.62, 0.82);
        self.body.mass(head, jaw, Vec3::Z, Vec3::new(jaw_size * w, 0.26 * h, 0.72 * d));
        let nose = dice.between(0.06, 0.10) * h;
        let tip = skull + Vec3::new(0.0, 0.30 * h, 0.99 * d);
        self.body.mass(head, tip, direction(0.0, -30.0), Vec3::new(0.7 * nose, 0.9 * nose, 1.3 * nose));
        let ear = dice.between(0.10, 0.15) * h;
        for side in Side::BOTH {
            let at = skull + side.of(Vec3::new(0.98 * w, 0.38 * h, -0.08 * h));
            let lean = side.of(Vec3::new(0.8, 0.0, -0.6));
            self.body.mass(head, at, lean, Vec3::new(0.5 * ear, 1.2 * ear, 0.8 * ear));
        }
        if dice.chance(0.6) {
            let radius = dice.between(0.055, 0.075) * h;
            for side in Side::BOTH {
                let center = skull + side.of(Vec3::new(0.42 * w, 0.44 * h, 0.84 * d));
                self.body.ball(head, center, radius);
            }
        }
        head
    }
}
