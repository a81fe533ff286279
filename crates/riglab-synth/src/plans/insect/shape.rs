//! What insects there are.

use crate::dice::proportions;

proportions! {
    /// Lengths and radii in shares of the thorax unless said otherwise.
    Shape {
        /// Length of the thorax, in metres.
        size,
        width,
        height,
        head,
        abdomen,
        abdomen_width,
        /// Half width of the waist.
        waist,
        /// Height of the thorax above the ground.
        stand,
        /// Reach of a leg and its radius.
        reach,
        leg,
        /// Length of a wing and its width; 0 for none.
        wing,
        chord,
        antenna,
        /// Radius of the eyes in shares of the head.
        eye,
    }
}

pub(super) const ARCHETYPES: [Shape; 7] = [
    // A bee.
    Shape {
        size: 0.008,
        width: 0.42,
        height: 0.4,
        head: 0.3,
        abdomen: 1.3,
        abdomen_width: 0.46,
        waist: 0.14,
        stand: 0.75,
        reach: 0.85,
        leg: 0.05,
        wing: 1.5,
        chord: 0.55,
        antenna: 0.7,
        eye: 0.42,
    },
    // A beetle.
    Shape {
        size: 0.02,
        width: 0.5,
        height: 0.36,
        head: 0.28,
        abdomen: 1.5,
        abdomen_width: 0.58,
        waist: 0.4,
        stand: 0.5,
        reach: 0.95,
        leg: 0.055,
        wing: 0.0,
        chord: 0.0,
        antenna: 0.6,
        eye: 0.25,
    },
    // An ant.
    Shape {
        size: 0.005,
        width: 0.24,
        height: 0.26,
        head: 0.34,
        abdomen: 1.1,
        abdomen_width: 0.36,
        waist: 0.08,
        stand: 0.75,
        reach: 1.3,
        leg: 0.045,
        wing: 0.0,
        chord: 0.0,
        antenna: 1.1,
        eye: 0.26,
    },
    // A butterfly.
    Shape {
        size: 0.02,
        width: 0.2,
        height: 0.2,
        head: 0.18,
        abdomen: 1.4,
        abdomen_width: 0.15,
        waist: 0.09,
        stand: 0.7,
        reach: 0.8,
        leg: 0.028,
        wing: 2.4,
        chord: 2.0,
        antenna: 1.3,
        eye: 0.36,
    },
    // A dragonfly.
    Shape {
        size: 0.03,
        width: 0.26,
        height: 0.26,
        head: 0.28,
        abdomen: 2.9,
        abdomen_width: 0.12,
        waist: 0.09,
        stand: 0.6,
        reach: 0.7,
        leg: 0.032,
        wing: 2.5,
        chord: 0.48,
        antenna: 0.2,
        eye: 0.62,
    },
    // A wasp.
    Shape {
        size: 0.01,
        width: 0.34,
        height: 0.34,
        head: 0.32,
        abdomen: 1.6,
        abdomen_width: 0.36,
        waist: 0.05,
        stand: 0.9,
        reach: 1.1,
        leg: 0.042,
        wing: 1.7,
        chord: 0.5,
        antenna: 0.8,
        eye: 0.45,
    },
    // A round one, as in cartoons.
    Shape {
        size: 0.3,
        width: 0.62,
        height: 0.6,
        head: 0.6,
        abdomen: 1.0,
        abdomen_width: 0.66,
        waist: 0.4,
        stand: 0.85,
        reach: 0.6,
        leg: 0.085,
        wing: 1.0,
        chord: 0.6,
        antenna: 0.9,
        eye: 0.4,
    },
];
