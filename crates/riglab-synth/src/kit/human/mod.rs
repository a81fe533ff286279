//! Human figures: spine, head, arms and legs in the proportions of a [`Shape`], for every plan that
//! stands on two legs.

mod arm;
mod head;
mod leg;
mod names;
mod wear;

use glam::Vec3;
use riglab_core::JointId;

pub(crate) use names::Names;

use crate::body::{Body, Node, Side};
use crate::dice::{Dice, proportions};
use crate::part::Ring;

proportions! {
    /// A human figure: lengths and half widths in shares of the body height unless said otherwise.
    Shape {
        /// Body height in metres.
        height,
        /// Head height.
        head,
        /// Head width and depth in shares of its height.
        head_width,
        head_depth,
        neck,
        neck_radius,
        /// Height of the crotch.
        crotch,
        /// From the middle to the shoulder joint.
        shoulders,
        chest_depth,
        waist,
        waist_depth,
        hips,
        /// From the middle to the hip joint.
        hip_joint,
        belly,
        upper_arm,
        forearm,
        hand,
        /// Radii: at the shoulder, elbow, wrist.
        arm_radius,
        elbow,
        wrist,
        thigh,
        knee,
        calf,
        ankle,
        foot,
    }
}

/// How the rest pose holds its limbs, in degrees.
pub(crate) struct Stance {
    /// Arms below the horizontal: 0 is a T-pose, 45 an A-pose.
    pub arms_down: f32,
    /// Arms before the body's plane.
    pub arms_forward: f32,
    pub elbow: f32,
    /// Legs outwards from the vertical.
    pub legs_apart: f32,
    pub knee: f32,
    pub toes_out: f32,
}

impl Stance {
    pub fn draw(dice: &mut Dice) -> Self {
        let arms_down = match dice.below(3) {
            0 => dice.between(0.0, 6.0),
            1 => dice.between(35.0, 52.0),
            _ => dice.between(0.0, 62.0),
        };
        Self {
            arms_down,
            arms_forward: dice.between(-4.0, 8.0),
            elbow: dice.between(0.0, 16.0),
            legs_apart: dice.between(1.5, 11.0),
            knee: dice.between(0.0, 8.0),
            toes_out: dice.between(0.0, 16.0),
        }
    }
}

/// How many bones of the hand the skin can show.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Hand {
    /// One joint.
    Mitten,
    /// Thumb and three fingers of three joints each.
    Three,
    /// Thumb and four fingers of three joints each.
    Four,
}

/// A human figure in the making.
pub(crate) struct Figure {
    pub shape: Shape,
    pub stance: Stance,
    pub hand: Hand,
    /// By how much the left limbs are longer and the right ones shorter.
    pub lopsided: f32,
    /// Whether upper and lower arms and thighs have a second joint that takes half of their twist.
    pub twists: bool,
    /// Joints from hips to chest, the hips not counted: 1 to 3.
    pub spine: usize,
    /// Whether shoulders and toes have joints of their own.
    pub clavicles: bool,
    pub toes: bool,
    pub names: Names,
    /// Added to names and to how far below the usual place arms grow: for a second pair.
    pub suffix: String,
    pub lower: f32,
    /// Whether joints are noted as human bones.
    pub mapped: bool,
    pub body: Body,
}

impl Figure {
    /// A figure that is only its hips.
    pub fn new(shape: Shape, names: Names, dice: &mut Dice) -> Self {
        let lopsided = if dice.chance(0.3) { dice.between(0.0, 0.05) } else { 0.0 };
        let stance = Stance::draw(dice);
        let body = Body::new(&names.of("hips"), Vec3::ZERO);
        Self {
            shape,
            stance,
            hand: Hand::Mitten,
            lopsided,
            twists: false,
            spine: 3,
            clavicles: true,
            toes: true,
            names,
            suffix: String::new(),
            lower: 0.0,
            mapped: false,
            body,
        }
    }

    /// Adds the joint of a human bone.
    pub fn bone(&mut self, parent: JointId, bone: &str, at: Vec3) -> JointId {
        let joint = self.body.joint(parent, self.names.of(bone) + &self.suffix, at);
        self.note(bone, joint);
        joint
    }

    /// Notes which human bone a joint is.
    fn note(&mut self, bone: &str, joint: JointId) {
        if self.mapped {
            self.body.human.extend(bone.parse().ok().map(|bone| (bone, joint)));
        }
    }

    pub fn limb(&self, length: f32, side: Side) -> f32 {
        length * (1.0 + side.sign() * self.lopsided)
    }

    pub fn hips_y(&self) -> f32 {
        self.shape.crotch + 0.045
    }

    pub fn neck_y(&self) -> f32 {
        1.0 - self.shape.head - self.shape.neck
    }

    /// Hips to chest; gives the chest.
    pub fn torso(&mut self) -> JointId {
        let s = self.shape;
        let (low, high) = (self.hips_y(), self.neck_y());
        let y = |t: f32| low + (high - low) * t;
        // The spine curves: the belly before it, the chest behind.
        let at = |t: f32, z: f32| Vec3::new(0.0, y(t), z);
        let ring = |side: f32, up: f32| Ring::oval(side, up);
        let ribs = 0.82 * s.shoulders;
        let all = [
            Node::new(at(0.0, 0.0), ring(s.hips, 0.72 * s.hips)),
            Node::new(at(0.20, 0.004), ring(0.5 * (s.waist + s.hips), s.waist_depth + 0.1 * s.belly * s.waist)),
            Node::new(at(0.42, 0.003), ring(s.waist, s.waist_depth + 0.12 * s.belly * s.waist)),
            Node::new(at(0.66, -0.003), ring(ribs, s.chest_depth)),
            Node::new(at(0.90, -0.008), ring(0.72 * ribs, 0.62 * s.chest_depth)),
        ];
        self.body.joints[0].head = all[0].at.into();
        self.note("hips", Body::ROOT);
        // With fewer joints the parts between two of them follow the lower.
        let heads: &[(usize, &str)] = match self.spine {
            1 => &[(1, "spine")],
            2 => &[(1, "spine"), (3, "chest")],
            _ => &[(1, "spine"), (2, "chest"), (3, "upperChest")],
        };
        let mut chain = vec![Body::ROOT; 4];
        for &(at, bone) in heads {
            let joint = self.bone(chain[at - 1], bone, all[at].at);
            chain[at..].fill(joint);
        }
        self.body.flesh(&chain, &all, Vec3::X);
        if s.belly > 0.05 {
            let r = Vec3::new(s.waist * 0.95, (high - low) * 0.24, s.waist_depth * 0.9);
            let center = at(0.26, 0.35 * s.belly * s.waist_depth + 0.01);
            self.body.mass(chain[1], center, Vec3::Z, r);
        }
        chain[3]
    }
}
