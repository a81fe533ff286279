//! Posing, skinning and spring bones with gradients: UniRig's supervision through physics.
//!
//! The one idea: **everything is a map from rest to pose**, as in `riglab-simulate`, whose rule this is: [`Maps`]
//! has one for each joint, [`Tree::compose`] puts local ones together, [`Springs::run`] has some joints swing, and
//! [`skin`] takes points along. [`physics_loss`] compares two skins in motion.
//!
//! ```text
//! let springs = Springs::new(Tree::new(&parents), &heads_j3, &tails_j3, &swinging);
//! // A motion of T + 1 poses, at rest in the first: here turns of joints [T + 1, j, 3] as vectors.
//! let motion = springs.tree().compose(&Maps::about(&rotations_of_vectors(&turns_tj3), &heads_j3));
//! let in_motion = |weights_nj: &Tensor, rows_j7: &Tensor| skin(&points_n3, weights_nj, &springs.run(&motion, rows_j7, seconds));
//! let truth = tch::no_grad(|| in_motion(&weights, &rows));
//! let loss = physics_loss(&in_motion(&predicted_weights, &predicted_rows), &truth);
//! ```
//!
//! Shapes: t poses, j joints, n points, r joints of one depth. Any float kind and device.
//!
//! Holds: gradients are finite wherever the motion is, bones without length and zero weights included.
//! Differs from `riglab-simulate`: colliders and centers go with the motion (not with what swings), and
//! motions turn, shift and scale evenly, as lengths of bones assume.

mod maps;
mod rotations;
mod springs;
mod tree;

pub use maps::{Maps, skin};
pub use rotations::{quaternions_of_rotations, quaternions_of_vectors, rotations_of_quaternions, rotations_of_vectors};
pub use springs::{ATTRIBUTES, Obstacle, Springs};
pub use tree::Tree;

use tch::{Kind, Tensor};

/// UniRig's loss of physics: Σ_t ‖X_t - X̂_t‖², over the number of points, so that it does not grow with it.
///
/// `found` and `wanted` are places of points [t, n, 3].
pub fn physics_loss(found: &Tensor, wanted: &Tensor) -> Tensor {
    (found - wanted).square().sum(None::<Kind>) / found.size()[1].max(1) as f64
}

/// Vectors [.., 3] of length 1; `other` in place of those (nearly) without length. Gradients are finite.
fn unit_or(v: &Tensor, other: &Tensor) -> Tensor {
    let square = v.square().sum_dim_intlist(-1, true, None::<Kind>);
    let short = square.le(tiny(v.kind()));
    let safe = square.where_self(&short.logical_not(), &square.ones_like());
    (v / safe.sqrt()).where_self(&short.logical_not(), other)
}

/// A square that is as good as 0.
fn tiny(kind: Kind) -> f64 {
    if kind == Kind::Double { 1e-200 } else { 1e-30 }
}

fn dot(a: &Tensor, b: &Tensor) -> Tensor {
    (a * b).sum_dim_intlist(-1, true, None::<Kind>)
}

#[cfg(test)]
mod tests;
