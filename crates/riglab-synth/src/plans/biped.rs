//! Bipeds: people, children, heroes, brutes and cartoon figures, with Mixamo's joint names.

use crate::body::{Body, Side};
use crate::dice::Dice;
use crate::kit::human::{Figure, Hand, Names, Shape};

pub(super) const ARCHETYPES: [Shape; 6] = [
    // A woman.
    Shape {
        height: 1.67,
        head: 0.135,
        head_width: 0.70,
        head_depth: 0.86,
        neck: 0.045,
        neck_radius: 0.027,
        crotch: 0.475,
        shoulders: 0.098,
        chest_depth: 0.062,
        waist: 0.066,
        waist_depth: 0.050,
        hips: 0.096,
        hip_joint: 0.052,
        belly: 0.0,
        upper_arm: 0.165,
        forearm: 0.142,
        hand: 0.105,
        arm_radius: 0.026,
        elbow: 0.020,
        wrist: 0.0135,
        thigh: 0.049,
        knee: 0.030,
        calf: 0.0085,
        ankle: 0.0195,
        foot: 0.140,
    },
    // A broad man.
    Shape {
        height: 1.82,
        head: 0.130,
        head_width: 0.72,
        head_depth: 0.88,
        neck: 0.040,
        neck_radius: 0.036,
        crotch: 0.465,
        shoulders: 0.120,
        chest_depth: 0.076,
        waist: 0.078,
        waist_depth: 0.060,
        hips: 0.090,
        hip_joint: 0.052,
        belly: 0.1,
        upper_arm: 0.170,
        forearm: 0.148,
        hand: 0.108,
        arm_radius: 0.035,
        elbow: 0.026,
        wrist: 0.0170,
        thigh: 0.050,
        knee: 0.033,
        calf: 0.0110,
        ankle: 0.0220,
        foot: 0.152,
    },
    // A child.
    Shape {
        height: 1.15,
        head: 0.190,
        head_width: 0.78,
        head_depth: 0.88,
        neck: 0.022,
        neck_radius: 0.033,
        crotch: 0.410,
        shoulders: 0.098,
        chest_depth: 0.070,
        waist: 0.076,
        waist_depth: 0.066,
        hips: 0.084,
        hip_joint: 0.052,
        belly: 0.35,
        upper_arm: 0.150,
        forearm: 0.130,
        hand: 0.105,
        arm_radius: 0.029,
        elbow: 0.025,
        wrist: 0.0190,
        thigh: 0.048,
        knee: 0.034,
        calf: 0.0070,
        ankle: 0.0240,
        foot: 0.150,
    },
    // A cartoon figure.
    Shape {
        height: 1.05,
        head: 0.330,
        head_width: 0.88,
        head_depth: 0.86,
        neck: 0.010,
        neck_radius: 0.036,
        crotch: 0.270,
        shoulders: 0.105,
        chest_depth: 0.080,
        waist: 0.098,
        waist_depth: 0.088,
        hips: 0.104,
        hip_joint: 0.058,
        belly: 0.5,
        upper_arm: 0.130,
        forearm: 0.115,
        hand: 0.120,
        arm_radius: 0.034,
        elbow: 0.031,
        wrist: 0.0290,
        thigh: 0.051,
        knee: 0.043,
        calf: 0.0040,
        ankle: 0.0380,
        foot: 0.170,
    },
    // A brute.
    Shape {
        height: 2.40,
        head: 0.112,
        head_width: 0.80,
        head_depth: 0.92,
        neck: 0.012,
        neck_radius: 0.048,
        crotch: 0.400,
        shoulders: 0.165,
        chest_depth: 0.112,
        waist: 0.112,
        waist_depth: 0.092,
        hips: 0.104,
        hip_joint: 0.066,
        belly: 0.6,
        upper_arm: 0.190,
        forearm: 0.175,
        hand: 0.135,
        arm_radius: 0.052,
        elbow: 0.040,
        wrist: 0.0310,
        thigh: 0.062,
        knee: 0.045,
        calf: 0.0140,
        ankle: 0.0320,
        foot: 0.165,
    },
    // A toy: all head.
    Shape {
        height: 0.90,
        head: 0.450,
        head_width: 0.95,
        head_depth: 0.90,
        neck: 0.004,
        neck_radius: 0.050,
        crotch: 0.170,
        shoulders: 0.115,
        chest_depth: 0.090,
        waist: 0.110,
        waist_depth: 0.095,
        hips: 0.112,
        hip_joint: 0.062,
        belly: 0.3,
        upper_arm: 0.110,
        forearm: 0.100,
        hand: 0.110,
        arm_radius: 0.042,
        elbow: 0.040,
        wrist: 0.0380,
        thigh: 0.058,
        knee: 0.052,
        calf: 0.0020,
        ankle: 0.0480,
        foot: 0.150,
    },
];

pub(crate) fn body(dice: &mut Dice, triangles: u32) -> Body {
    let shape = Shape::draw(&ARCHETYPES, 0.08, dice);
    let names = if dice.chance(0.75) { Names::Mixamo } else { Names::Blender };
    let mut figure = Figure::new(shape, names, dice);
    figure.hand = match dice.below(4) {
        0 => Hand::Mitten,
        _ if triangles < 2_500 => Hand::Mitten,
        1 => Hand::Three,
        _ => Hand::Four,
    };
    figure.twists = triangles >= 2_500 && dice.chance(0.3);
    if names == Names::Blender {
        // Skeletons made by hand are often simpler.
        figure.spine = dice.count(1, 3);
        (figure.clavicles, figure.toes) = (dice.chance(0.6), dice.chance(0.5));
        if dice.chance(0.4) {
            figure.hand = Hand::Mitten;
        }
    }
    let chest = figure.torso();
    let head = figure.head(chest, dice);
    let mut hands = Vec::new();
    for side in Side::BOTH {
        hands.push(figure.arm(chest, side));
        figure.leg(side);
    }
    figure.dress(chest, head, &hands, dice);
    figure.body.scaled(shape.height)
}
