//! How near many points are to some others.

use multiversion::multiversion;
use riglab_core::{Segment, Vec3};

/// Points that are worked on at once, so that the compiler takes several in an instruction.
pub const BLOCK: usize = 32;

/// A number of each point of a block.
pub type Lane = [f32; BLOCK];

/// A block's points, axis by axis.
pub(crate) type Axes = [Lane; 3];

/// Up to [`BLOCK`] points side by side; the last one fills what is left.
pub(crate) fn axes(points: &[Vec3]) -> Axes {
    let last = points[points.len() - 1];
    let mut axes = [0, 1, 2].map(|axis: usize| [last[axis]; BLOCK]);
    for (k, p) in points.iter().enumerate() {
        (0..3).for_each(|axis| axes[axis][k] = p[axis]);
    }
    axes
}

/// The squared distance of each of a block's points to the nearest of `others`; infinite without any. By the widest instructions
/// there are; the values are the same.
#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
pub(crate) fn nearest(axes: &Axes, others: &[Vec3]) -> Lane {
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

/// No more than the squared distance of anything in each of some boxes, from `low` to `high`, to the nearest of `others`.
#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
pub(crate) fn to_boxes(low: &Axes, high: &Axes, others: &[Vec3]) -> Lane {
    let mut least = [f32::INFINITY; BLOCK];
    for other in others {
        for k in 0..BLOCK {
            let [x, y, z] = [0, 1, 2].map(|axis| {
                let (below, above) = (low[axis][k] - other[axis], other[axis] - high[axis][k]);
                let outside = if below > above { below } else { above };
                if outside > 0.0 { outside } else { 0.0 }
            });
            let square = x * x + y * y + z * z;
            least[k] = if square < least[k] { square } else { least[k] };
        }
    }
    least
}

/// How far each of a block's points, [`BLOCK`] or fewer but not none, is from the nearest segment of each bone, as
/// [`Segment::nearest_of`] says: a row a bone, whose places behind the last point have what that has.
pub fn bone_distances(points: &[Vec3], bones: &[Vec<Segment>], rows: &mut Vec<Lane>) {
    let axes = axes(points);
    rows.clear();
    rows.extend(bones.iter().map(|bone| to_bone(&axes, bone)));
}

/// By the widest instructions there are; the values are the same.
#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
fn to_bone(axes: &Axes, bone: &[Segment]) -> Lane {
    let mut least = [f32::INFINITY; BLOCK];
    for Segment { a, b } in bone {
        let along = [0, 1, 2].map(|axis| b[axis] - a[axis]);
        let length2 = along[0] * along[0] + along[1] * along[1] + along[2] * along[2];
        for k in 0..BLOCK {
            let p = [0, 1, 2].map(|axis| axes[axis][k]);
            let [x, y, z] = [0, 1, 2].map(|axis| (p[axis] - a[axis]) * along[axis]);
            let t = (x + y + z) / length2;
            let t = if length2 > 0.0 { t.clamp(0.0, 1.0) } else { 0.0 };
            let [x, y, z] = [0, 1, 2].map(|axis| a[axis] + along[axis] * t - p[axis]);
            let square = x * x + y * y + z * z;
            least[k] = if square < least[k] { square } else { least[k] };
        }
    }
    least.iter_mut().for_each(|square| *square = square.sqrt());
    least
}

#[cfg(test)]
mod tests {
    use riglab_random::{Draw, stream};

    use super::*;

    #[test]
    fn bones_are_as_far_as_their_nearest_segment() {
        let random = &mut stream(1, "bones", &[]);
        let mut point = || [0; 3].map(|_: i32| -> f32 { random.normal() });
        let mut bones: Vec<Vec<Segment>> =
            (0..4).map(|n| (0..n).map(|_| Segment { a: point(), b: point() }).collect()).collect();
        let a = point();
        bones.push(vec![Segment { a, b: a }]);
        let points: Vec<Vec3> = (0..2 * BLOCK + 5).map(|_| point()).collect();
        let mut rows = Vec::new();
        for points in points.chunks(BLOCK) {
            bone_distances(points, &bones, &mut rows);
            for (k, p) in points.iter().enumerate() {
                let want: Vec<f32> = bones.iter().map(|bone| Segment::nearest_of(bone, *p).1).collect();
                assert_eq!(rows.iter().map(|row| row[k]).collect::<Vec<_>>(), want);
            }
            assert!(rows.iter().all(|row| row[points.len()..].iter().all(|d| *d == row[points.len() - 1])));
        }
    }

    #[test]
    fn each_is_as_near_as_its_nearest() {
        let random = &mut stream(1, "near", &[]);
        let mut points = |n: usize| (0..n).map(|_| [0; 3].map(|_: i32| random.normal())).collect::<Vec<Vec3>>();
        let (points, others) = (points(BLOCK - 3), points(5));
        let square = |p: &Vec3, q: &Vec3| (0..3).map(|k| (q[k] - p[k]).powi(2)).sum::<f32>();
        let want: Vec<f32> =
            points.iter().map(|p| others.iter().map(|q| square(p, q)).fold(f32::INFINITY, f32::min)).collect();
        let axes = axes(&points);
        assert_eq!(nearest(&axes, &others)[..points.len()], want);
        assert_eq!(nearest(&axes, &[])[0], f32::INFINITY);
        // A box of one point is as far as that.
        assert_eq!(to_boxes(&axes, &axes, &others), nearest(&axes, &others));
        let wide = axes.map(|lane| lane.map(|x| x + 0.5));
        let inside = [0, 1, 2].map(|axis| axes[axis][2] + 0.25);
        let found = to_boxes(&axes, &wide, &[inside]);
        assert!(found[2] == 0.0 && found.iter().zip(nearest(&axes, &[inside])).all(|(a, b)| *a <= b));
    }
}
