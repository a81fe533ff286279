//! Other rest poses: joints turned before there is a surface, so that skin is whole in every pose.

use glam::Vec3;

use crate::body::Body;
use crate::dice::Dice;
use crate::turn::{direction, turned};

impl Body {
    /// Turns what a joint holds, and all below it, about a line through the joint.
    pub fn turn(&mut self, joint: usize, axis: Vec3, degrees: f32) {
        let mut moves = vec![false; self.joints.len()];
        moves[joint] = true;
        for k in joint + 1..moves.len() {
            moves[k] = self.joints[k].parent.is_some_and(|p| moves[p.index()]);
        }
        let center = Vec3::from(self.joints[joint].head);
        let moved = |j: u16| moves[usize::from(j)];
        for (below, _) in self.joints.iter_mut().zip(&moves).skip(joint + 1).filter(|(_, moves)| **moves) {
            below.head = (center + turned(Vec3::from(below.head) - center, axis, degrees)).into();
        }
        self.parts.iter_mut().filter(|part| moved(part.joint)).for_each(|part| part.turn(center, axis, degrees));
        self.pieces.iter_mut().for_each(|piece| piece.turn(&moved, center, axis, degrees));
        self.bumpers.iter_mut().for_each(|bumper| bumper.turn(&moved, center, axis, degrees));
    }

    /// Turns every joint but the root by up to `degrees` in a direction of its own.
    pub fn posed(mut self, degrees: f32, dice: &mut Dice) -> Self {
        for joint in 1..self.joints.len() {
            let axis = direction(dice.between(0.0, 360.0), dice.between(-60.0, 60.0));
            let by = degrees * dice.bell();
            self.turn(joint, axis, by);
        }
        self
    }
}
