//! How near many points are to some others.

use riglab_core::Vec3;

/// Points that are worked on at once, so that the compiler takes several in an instruction.
const BLOCK: usize = 32;

/// The squared distance of each of `points` to the nearest of `others`; infinite without any.
pub fn nearest_squares(points: &[Vec3], others: &[Vec3]) -> Vec<f32> {
    let mut out = vec![f32::INFINITY; points.len()];
    for (points, out) in points.chunks(BLOCK).zip(out.chunks_mut(BLOCK)) {
        let mut axes = [[0.0; BLOCK]; 3];
        for (k, p) in points.iter().enumerate() {
            (0..3).for_each(|axis| axes[axis][k] = p[axis]);
        }
        out.copy_from_slice(&nearest(&axes, others)[..points.len()]);
    }
    out
}

/// By the widest instructions there are; the values are the same.
fn nearest(axes: &[[f32; BLOCK]; 3], others: &[Vec3]) -> [f32; BLOCK] {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx512f") {
        #[target_feature(enable = "avx512f")]
        fn widest(axes: &[[f32; BLOCK]; 3], others: &[Vec3]) -> [f32; BLOCK] {
            plain(axes, others)
        }
        // SAFETY: the machine has them.
        return unsafe { widest(axes, others) };
    }
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") {
        #[target_feature(enable = "avx2")]
        fn wide(axes: &[[f32; BLOCK]; 3], others: &[Vec3]) -> [f32; BLOCK] {
            plain(axes, others)
        }
        // SAFETY: the machine has them.
        return unsafe { wide(axes, others) };
    }
    plain(axes, others)
}

#[inline(always)]
fn plain(axes: &[[f32; BLOCK]; 3], others: &[Vec3]) -> [f32; BLOCK] {
    let mut least = [f32::INFINITY; BLOCK];
    for other in others {
        for k in 0..BLOCK {
            let [x, y, z] = [0, 1, 2].map(|axis| other[axis] - axes[axis][k]);
            let square = x * x + y * y + z * z;
            // Not `min`, which asks about NaN.
            least[k] = if square < least[k] { square } else { least[k] };
        }
    }
    least
}

#[cfg(test)]
mod tests {
    use riglab_random::{Draw, stream};

    use super::*;

    #[test]
    fn each_is_as_near_as_its_nearest() {
        let random = &mut stream(1, "near", &[]);
        let mut points = |n: usize| (0..n).map(|_| [0; 3].map(|_: i32| random.normal())).collect::<Vec<Vec3>>();
        let (points, others) = (points(77), points(5));
        let square = |p: &Vec3, q: &Vec3| (0..3).map(|k| (q[k] - p[k]).powi(2)).sum::<f32>();
        let want: Vec<f32> =
            points.iter().map(|p| others.iter().map(|q| square(p, q)).fold(f32::INFINITY, f32::min)).collect();
        assert_eq!(nearest_squares(&points, &others), want);
        assert_eq!(nearest_squares(&points[..1], &[]), [f32::INFINITY]);
        assert!(nearest_squares(&[], &others).is_empty());
    }
}
