//! Normals of triangles and vertices.

use glam::Vec3;
use multiversion::multiversion;
use riglab_core::Mesh;

/// Unit normals of the triangles, by the right-hand rule; +y for those without area.
pub fn triangle_normals(mesh: &Mesh) -> Vec<[f32; 3]> {
    (0..mesh.triangles().len()).map(|t| unit(mesh.area_vector(t).into()).into()).collect()
}

/// Unit normals at the vertices: the mean of the triangles around each, weighted by their angle there,
/// so that it does not matter how a flat side is cut into triangles. This is what trimesh gives, and so
/// what the public code of UniRig and SkinTokens learns from; [`Mesh::vertex_normals`] weights by area.
/// A vertex without triangles of some area gets +y.
pub fn normals_by_angle(mesh: &Mesh) -> Vec<[f32; 3]> {
    let mut sums = vec![Vec3::ZERO; mesh.positions().len()];
    let mut block = Block::default();
    for triangles in mesh.triangles().chunks(BLOCK) {
        for (k, corners) in triangles.iter().enumerate() {
            let [a, b, c] = corners.map(|v| Vec3::from(mesh.positions()[v as usize]));
            for (lane, side) in block.sides.iter_mut().zip([b - a, c - a, c - b]) {
                (lane[0][k], lane[1][k], lane[2][k]) = (side.x, side.y, side.z);
            }
        }
        turn(&mut block);
        for (k, corners) in triangles.iter().enumerate() {
            let [x, y, z] = &block.normals;
            let normal = Vec3::new(x[k], y[k], z[k]);
            if !block.sound(k) {
                continue;
            }
            for (corner, angles) in corners.iter().zip(&block.angles) {
                sums[*corner as usize] += normal * angles[k];
            }
        }
    }
    sums.into_iter().map(|n| unit(n).into()).collect()
}

/// Triangles of a block.
const BLOCK: usize = 64;

/// A number of each triangle.
type Lane = [f32; BLOCK];

/// Triangles side by side, so that several are computed at once: this is most of the time that normals
/// take. The numbers are those of one after another.
struct Block {
    /// From the first corner to the second, from it to the third, from the second to the third: each in x, y and z.
    sides: [[Lane; 3]; 3],
    normals: [Lane; 3],
    angles: [Lane; 3],
    /// What normals were divided by.
    by: Lane,
}

impl Default for Block {
    fn default() -> Self {
        let zero = [[0.0; BLOCK]; 3];
        Self { sides: [zero; 3], normals: zero, angles: zero, by: [0.0; BLOCK] }
    }
}

impl Block {
    /// Whether a triangle has an area that can be divided by.
    fn sound(&self, k: usize) -> bool {
        self.by[k].is_finite() && self.by[k] > 0.0
    }
}

/// Normals and angles of the sides, by the widest instructions there are; the values are the same.
#[multiversion(targets("x86_64+avx2"))]
fn turn(block: &mut Block) {
    plain(block);
}

#[inline(always)]
fn plain(block: &mut Block) {
    let Block { sides, normals, angles, by } = block;
    let at = |side: &[Lane; 3], k: usize| Vec3::new(side[0][k], side[1][k], side[2][k]);
    for k in 0..BLOCK {
        let (ab, ac, bc) = (at(&sides[0], k), at(&sides[1], k), at(&sides[2], k));
        let area = ab.cross(ac);
        by[k] = area.length().recip();
        let normal = area * by[k];
        (normals[0][k], normals[1][k], normals[2][k]) = (normal.x, normal.y, normal.z);
        let (side, other, last) = (ab.length(), ac.length(), bc.length());
        let first = angle(ab.dot(ac) / (side * other));
        let second = angle(-ab.dot(bc) / (side * last));
        // The angles of a triangle make a half turn.
        let third = std::f32::consts::PI - first - second;
        (angles[0][k], angles[1][k], angles[2][k]) = (first, second, third);
    }
}

/// The angle of a cosine: √(1 - x) times a polynomial, off by less than 1e-6 (Abramowitz and Stegun,
/// 4.4.46, and the rounding of f32). Sums and products alone: the same on every machine, and a third of
/// the time of `acosf`.
#[inline]
fn angle(cos: f32) -> f32 {
    const TERMS: [f32; 8] = [
        std::f32::consts::FRAC_PI_2,
        -0.214_598_8,
        0.088_978_99,
        -0.050_174_305,
        0.030_891_88,
        -0.017_088_126,
        0.006_670_09,
        -0.001_262_491_1,
    ];
    // What is no number, of sides too long or too short for their product, is a right angle.
    let x = if cos.is_nan() { 0.0 } else { cos.abs().min(1.0) };
    let sharp = (1.0 - x).sqrt() * TERMS.iter().rev().fold(0.0, |sum, term| sum * x + term);
    if cos < 0.0 { std::f32::consts::PI - sharp } else { sharp }
}

fn unit(v: Vec3) -> Vec3 {
    v.try_normalize().unwrap_or(Vec3::Y)
}

#[cfg(test)]
mod tests {
    use riglab_random::Draw;

    use super::*;

    #[test]
    fn a_side_counts_once_however_it_is_cut() {
        // The corner of a cube at the origin, one of its sides cut in two there.
        let p = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 0.0]];
        let mesh = Mesh::new(p, vec![[0, 1, 4], [0, 4, 2], [0, 2, 3], [0, 3, 1]]).unwrap();
        let third = 1.0 / 3f32.sqrt();
        assert!(normals_by_angle(&mesh)[0].iter().all(|x| (x - third).abs() < 1e-6));
        assert_eq!(triangle_normals(&mesh)[0], [0.0, 0.0, 1.0]);
    }

    #[test]
    fn angles_are_those_of_their_cosines() {
        for k in -1000..=1000 {
            let cos = k as f32 / 1000.0;
            let wanted = f64::from(cos).acos();
            assert!((f64::from(angle(cos)) - wanted).abs() < 1e-6, "{cos}");
        }
        assert!(angle(2.0) == 0.0 && (angle(f32::NAN) - std::f32::consts::FRAC_PI_2).abs() < 1e-6);
    }

    #[test]
    fn triangles_without_area_say_nothing() {
        let mesh = Mesh::new(vec![[1.0; 3]; 3], vec![[0, 1, 2], [0, 0, 0]]).unwrap();
        assert_eq!(normals_by_angle(&mesh), [[0.0, 1.0, 0.0]; 3]);
    }

    #[test]
    fn blocks_give_what_one_triangle_after_another_does() {
        let mut random = riglab_random::stream(1, "test", &[]);
        for count in [1, 63, 64, 65, 300] {
            let positions: Vec<[f32; 3]> = (0..40)
                .map(|k| std::array::from_fn(|_| if k == 0 { 1e30 } else { random.within(-1.0, 1.0) }))
                .collect();
            // Some of them have two corners in common.
            let triangles: Vec<[u32; 3]> =
                (0..count).map(|_| std::array::from_fn(|_| random.below(40) as u32)).collect();
            let mesh = Mesh::new(positions, triangles).unwrap();
            let mut sums = vec![Vec3::ZERO; 40];
            for (t, corners) in mesh.triangles().iter().enumerate() {
                let [a, b, c] = mesh.corners(t).map(Vec3::from);
                let (ab, ac, bc) = (b - a, c - a, c - b);
                let Some(normal) = ab.cross(ac).try_normalize() else { continue };
                let (side, other, last) = (ab.length(), ac.length(), bc.length());
                let first = angle(ab.dot(ac) / (side * other));
                let second = angle(-ab.dot(bc) / (side * last));
                for (corner, angle) in corners.iter().zip([first, second, std::f32::consts::PI - first - second]) {
                    sums[*corner as usize] += normal * angle;
                }
            }
            let wanted: Vec<[f32; 3]> = sums.into_iter().map(|n| unit(n).into()).collect();
            assert_eq!(normals_by_angle(&mesh), wanted);
            // Wide instructions and plain ones.
            let (mut wide, mut narrow) = (Block::default(), Block::default());
            for block in [&mut wide, &mut narrow] {
                let sides = block.sides.as_flattened_mut().as_flattened_mut();
                sides.iter_mut().zip(1..).for_each(|(x, k)| *x = (k as f32 * count as f32).sin());
            }
            turn(&mut wide);
            plain(&mut narrow);
            assert_eq!((wide.normals, wide.angles, wide.by), (narrow.normals, narrow.angles, narrow.by));
        }
    }
}
