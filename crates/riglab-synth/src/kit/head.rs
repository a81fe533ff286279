//! Heads of animals: a skull, a snout, a jaw, eyes.

use glam::Vec3;
use riglab_core::JointId;

use crate::body::{Body, Node, Side};
use crate::part::Ring;
use crate::piece::Loft;
use crate::turn::across;

/// A head with a snout; lengths in shares of its own.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Skull {
    pub length: f32,
    /// Half width of the skull.
    pub width: f32,
    /// Length of the snout and half width of its tip.
    pub snout: f32,
    pub tip: f32,
    /// Radius of the eyes; 0 for none.
    pub eye: f32,
    /// Whether the lower jaw has a joint.
    pub jaw: bool,
}

/// Where things can be put on a head.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Face {
    pub look: Vec3,
    /// To the creature's left.
    pub side: Vec3,
    pub up: Vec3,
    /// Middle of the skull and its half width.
    pub crown: Vec3,
    pub width: f32,
    /// End of the snout.
    pub tip: Vec3,
}

impl Skull {
    /// Adds the flesh of a head that looks along `look` to its joint.
    pub fn grow(self, body: &mut Body, head: JointId, look: Vec3) -> Face {
        let (h, at) = (self.length, body.at(head));
        let side = across(look, Vec3::X);
        let side = if side.x < 0.0 { -side } else { side };
        let up = look.cross(side);
        let w = self.width * h;
        let crown = at + look * (0.22 * h) + up * (0.08 * h);
        body.mass(head, crown, look, Vec3::new(w, 0.9 * w, 0.34 * h));
        let root = at + look * (0.32 * h) + up * (0.02 * h);
        let tip = root + look * (self.snout * h) - up * (0.05 * h);
        let r = self.tip * h;
        let upper = [Node::new(root, Ring::oval(0.80 * w, 0.66 * w)), Node::new(tip, Ring::oval(r, 0.62 * r))];
        body.flesh(&[head], &upper, side);
        let hinge = at + look * (0.20 * h) - up * (0.42 * w);
        let chin = tip - look * (0.06 * h) - up * (0.85 * r + 0.12 * w);
        let lower = [Node::new(hinge, Ring::oval(0.62 * w, 0.34 * w)), Node::new(chin, Ring::oval(0.85 * r, 0.38 * r))];
        let jaw = if self.jaw { body.joint(head, "jaw", hinge) } else { head };
        body.flesh(&[jaw], &lower, side);
        if self.eye > 0.0 {
            for of in Side::BOTH {
                let out = side * of.sign();
                body.ball(head, crown + out * (0.82 * w) + look * (0.12 * h) + up * (0.38 * w), self.eye * h);
            }
        }
        Face { look, side, up, crown, width: w, tip }
    }
}

impl Face {
    /// Upper and lower beak as cones, the lower with a joint if `jaw`.
    pub fn beak(&self, body: &mut Body, head: JointId, length: f32, radius: f32, hook: f32, jaw: bool) {
        let root = self.crown + self.look * (0.55 * self.width) - self.up * (0.15 * self.width);
        let curve = |t: f32| root + self.look * (length * t) - self.up * (hook * length * t * t);
        let ring = |t: f32, flat: f32| Ring::oval(radius * (1.0 - 0.92 * t * t), radius * flat * (1.0 - 0.92 * t * t));
        let upper = [0.0, 0.4, 0.75, 1.0].map(|t| (curve(t), ring(t, 0.9), head.0));
        body.loft(Loft::through(&upper, self.side));
        let below = -self.up * (0.75 * radius);
        let joint = if jaw { body.joint(head, "jaw", root + below) } else { head };
        let lower = [0.0, 0.4, 0.8].map(|t| (curve(t) + below * (1.0 - t), ring(t, 0.5), joint.0));
        body.loft(Loft::through(&lower, self.side));
    }
}
