//! Turns as vectors (axis times angle in radians), quaternions (w, x, y, z) and matrices, with gradients.

use tch::{Kind, Tensor};

use super::tiny;

/// Quaternions [.., 4] of vectors [.., 3].
pub fn quaternions_of_vectors(vectors: &Tensor) -> Tensor {
    let square = vectors.square().sum_dim_intlist(-1, true, None::<Kind>);
    // sin(a / 2) / a, which is 1/2 - a²/48 about 0; where that is used, the root is kept from 0.
    let small = square.le(1e-12);
    let angle = square.where_self(&small.logical_not(), &square.ones_like()).sqrt();
    let share = (&angle * 0.5).sin() / &angle;
    let share = share.where_self(&small.logical_not(), &(&square / -48.0 + 0.5));
    let real = (&angle * 0.5).cos().where_self(&small.logical_not(), &(&square / -8.0 + 1.0));
    Tensor::cat(&[real, vectors * share], -1)
}

/// Matrices [.., 3, 3] of quaternions [.., 4] of any length but 0.
pub fn rotations_of_quaternions(quaternions: &Tensor) -> Tensor {
    let [w, x, y, z] = [0, 1, 2, 3].map(|k| quaternions.select(-1, k));
    let two =
        quaternions.square().sum_dim_intlist(-1, false, None::<Kind>).clamp_min(tiny(quaternions.kind())).reciprocal()
            * 2.0;
    let p = |a: &Tensor, b: &Tensor| a * b * &two;
    let rest = |a: Tensor, b: Tensor| -(a + b) + 1.0;
    let rows = [
        rest(p(&y, &y), p(&z, &z)),
        p(&x, &y) - p(&z, &w),
        p(&x, &z) + p(&y, &w),
        p(&x, &y) + p(&z, &w),
        rest(p(&x, &x), p(&z, &z)),
        p(&y, &z) - p(&x, &w),
        p(&x, &z) - p(&y, &w),
        p(&y, &z) + p(&x, &w),
        rest(p(&x, &x), p(&y, &y)),
    ];
    Tensor::stack(&rows, -1).unflatten(-1, [3, 3])
}

/// Matrices [.., 3, 3] of vectors [.., 3].
pub fn rotations_of_vectors(vectors: &Tensor) -> Tensor {
    rotations_of_quaternions(&quaternions_of_vectors(vectors))
}

/// Quaternions [.., 4], w at least 0, of rotation matrices [.., 3, 3].
pub fn quaternions_of_rotations(rotations: &Tensor) -> Tensor {
    let m = |i: i64, k: i64| rotations.select(-2, i).select(-1, k);
    let [xx, yy, zz] = [m(0, 0), m(1, 1), m(2, 2)];
    // 4 q qᵀ: each row is the quaternion, up to its length and sign; the longest is the most exact.
    let square = |a: f64, b: f64, c: f64| &xx * a + &yy * b + &zz * c + 1.0;
    let (wx, wy, wz) = (m(2, 1) - m(1, 2), m(0, 2) - m(2, 0), m(1, 0) - m(0, 1));
    let (xy, xz, yz) = (m(1, 0) + m(0, 1), m(0, 2) + m(2, 0), m(2, 1) + m(1, 2));
    let squares = [square(1.0, 1.0, 1.0), square(1.0, -1.0, -1.0), square(-1.0, 1.0, -1.0), square(-1.0, -1.0, 1.0)];
    let rows = [
        Tensor::stack(&[&squares[0], &wx, &wy, &wz], -1),
        Tensor::stack(&[&wx, &squares[1], &xy, &xz], -1),
        Tensor::stack(&[&wy, &xy, &squares[2], &yz], -1),
        Tensor::stack(&[&wz, &xz, &yz, &squares[3]], -1),
    ];
    let best = Tensor::stack(&squares, -1).argmax(-1, true).unsqueeze(-1);
    let all = Tensor::stack(&rows, -2);
    let mut size = all.size();
    let last = size.len() - 2;
    size[last] = 1;
    let row = all.gather(-2, &best.expand(&size, false), false).squeeze_dim(-2);
    let unit = &row / row.square().sum_dim_intlist(-1, true, None::<Kind>).sqrt();
    let w = unit.narrow(-1, 0, 1);
    let sign = w.ge(0.0).to_kind(unit.kind()) * 2.0 - 1.0;
    unit * sign
}
