//! What any creature may have, whatever its plan: a bent rest pose, blocks for limbs, joints without
//! flesh.

use glam::Vec3;
use riglab_core::{Joint, JointId};

use crate::body::Body;
use crate::dice::Dice;
use crate::part::Ring;
use crate::piece::{Loft, Piece};

/// Share of a creature's size that joints are apart at least.
const APART: f32 = 0.004;

impl Body {
    /// The body as one creature of its plan among many.
    pub fn varied(self, dice: &mut Dice, triangles: u32) -> Self {
        // Machines stay straight and are put together from solids anyway.
        let bent = if dice.chance(0.35) && !self.rigid { dice.between(3.0, 14.0) } else { 0.0 };
        // Models of few triangles are mostly put together from simple solids.
        let blocks = dice.chance(match triangles {
            0..800 => 1.0,
            800..1_500 => 0.4,
            _ => 0.08,
        });
        let (ends, root) = (dice.chance(0.3), dice.chance(0.3));
        let square = if dice.chance(0.6) { 1.0 } else { 0.0 };
        let bevel = if dice.chance(0.5) { dice.between(0.1, 0.45) } else { 0.0 };
        let mut body = if bent > 0.0 { self.posed(bent, dice) } else { self };
        if blocks {
            body = body.in_blocks(bevel, square);
        }
        if ends {
            body.add_ends();
        }
        // Two joints in one place are hard to tell apart.
        body.rooted = (root || body.rooted) && body.at(Self::ROOT).length() > 0.05 * body.size();
        body
    }

    /// Each part as a box or barrel that follows its joint alone, as in games made of cubes.
    fn in_blocks(mut self, bevel: f32, square: f32) -> Self {
        for part in std::mem::take(&mut self.parts) {
            let ((side, axis), rings, caps) = (part.frame(), part.rings(), part.caps());
            // A box as large as the round part would look fatter.
            let slim = |ring: Ring| ring.scaled(0.88);
            let (a, b) = (part.a - axis * (0.6 * caps[0]), part.b + axis * (0.6 * caps[1]));
            let loft = Loft::tapered(part.joint, a, b, side, rings.map(slim), bevel);
            self.pieces.push(Piece::Loft(loft.squared(square)));
        }
        Self { rigid: true, ..self }
    }

    /// Gives each joint without children one at the tip of what it holds, as exporters that write
    /// bones' tails do; but none where flesh goes on from there, as from a twist joint to the forearm, or where another
    /// joint is: two joints in one place are hard to tell apart.
    fn add_ends(&mut self) {
        let mut is_leaf = vec![true; self.joints.len()];
        self.joints.iter().filter_map(|joint| joint.parent).for_each(|p| is_leaf[p.index()] = false);
        self.grown.iter().for_each(|&(_, from)| is_leaf[from.index()] = false);
        let size = self.size();
        for leaf in (0..is_leaf.len()).filter(|&j| is_leaf[j]).map(|j| JointId(j as u16)) {
            let Some(tip) = self.tip(leaf) else { continue };
            let away = |joint: &Joint| tip.distance(joint.head.into());
            if away(&self.joints[leaf.index()]) > 0.01 * size && self.joints.iter().all(|j| away(j) > APART * size) {
                let name = format!("{}_end", self.joints[leaf.index()].name);
                self.joint(leaf, name, tip);
            }
        }
    }

    /// The largest coordinate of a joint.
    fn size(&self) -> f32 {
        self.joints.iter().map(|joint| Vec3::from(joint.head).abs().max_element()).fold(0.0, f32::max)
    }
}
