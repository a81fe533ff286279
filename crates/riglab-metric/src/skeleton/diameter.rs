//! Local shape diameter: how thick a body is at its joints.

use rayon::prelude::*;

use super::Joints;

/// Rays a bone.
const RAYS: usize = 18;
/// Hits nearer than this are the joint's own surface.
const NEAREST: f64 = 1e-6;

/// The mean distance from each joint to the surface across its bones: 18 rays in the plane perpendicular to every
/// bone that touches the joint, the first hit of each, the mean over all rays that hit; NaN where none does. Half
/// of it is RigNet's tolerance for joints. RigNet ships tolerances and not what makes them: the recipe is
/// riglab's.
///
/// The first ray is d × e, d the bone's direction from the parent and e the axis with the least |d|, the others
/// follow by 20 degrees. Only triangles that reach across the plane of a bone's rays are tried.
pub fn local_shape_diameters(positions: &[[f64; 3]], triangles: &[[u32; 3]], joints: &Joints) -> Vec<f64> {
    let corner = |v: u32| positions.get(v as usize).copied();
    let triangles: Vec<[[f64; 3]; 3]> =
        triangles.iter().filter_map(|t| Some([corner(t[0])?, corner(t[1])?, corner(t[2])?])).collect();
    let bones: Vec<(usize, usize)> =
        joints.parents.iter().enumerate().filter_map(|(child, parent)| Some(((*parent)?, child))).collect();
    let of = |joint: usize| {
        let (mut sum, mut hits) = (0.0, 0u32);
        for &(parent, child) in bones.iter().filter(|(p, c)| *p == joint || *c == joint) {
            let Some(d) = unit(minus(joints.positions[child], joints.positions[parent])) else { continue };
            let across = across(joints.positions[joint], d, &triangles);
            for ray in rays(d) {
                if let Some(t) = first_hit(joints.positions[joint], ray, &across) {
                    sum += t;
                    hits += 1;
                }
            }
        }
        sum / f64::from(hits)
    };
    (0..joints.positions.len()).into_par_iter().map(of).collect()
}

/// Directions around `d`, all perpendicular to it.
fn rays(d: [f64; 3]) -> impl Iterator<Item = [f64; 3]> {
    let axis = (1..3).fold(0, |least, k| if d[k].abs() < d[least].abs() { k } else { least });
    let e = std::array::from_fn(|k| f64::from(u8::from(k == axis)));
    // Never of length 0: the axis is far from d.
    let u = unit(cross(d, e)).unwrap_or(e);
    let v = cross(d, u);
    (0..RAYS).map(move |k| {
        let (sin, cos) = libm::sincos(std::f64::consts::TAU * k as f64 / RAYS as f64);
        std::array::from_fn(|i| cos * u[i] + sin * v[i])
    })
}

/// The triangles that the plane through `from` with normal `d` meets, and those that nearly touch it.
fn across(from: [f64; 3], d: [f64; 3], triangles: &[[[f64; 3]; 3]]) -> Vec<[[f64; 3]; 3]> {
    let met = |t: &&[[f64; 3]; 3]| {
        let side = t.map(|corner| dot(minus(corner, from), d));
        let slack = 1e-9 * side.iter().fold(1.0, |most: f64, s| most.max(s.abs()));
        side.iter().any(|s| *s <= slack) && side.iter().any(|s| *s >= -slack)
    };
    triangles.iter().filter(met).copied().collect()
}

/// Möller and Trumbore's test against every triangle, from both sides.
fn first_hit(from: [f64; 3], ray: [f64; 3], triangles: &[[[f64; 3]; 3]]) -> Option<f64> {
    let hit = |[a, b, c]: &[[f64; 3]; 3]| {
        let (e, f, s) = (minus(*b, *a), minus(*c, *a), minus(from, *a));
        let p = cross(ray, f);
        let det = dot(e, p);
        let (u, q) = (dot(s, p) / det, cross(s, e));
        let (v, t) = (dot(ray, q) / det, dot(f, q) / det);
        (det != 0.0 && u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > NEAREST).then_some(t)
    };
    triangles.iter().filter_map(hit).min_by(f64::total_cmp)
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|k| a[k] - b[k])
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|k| a[k] * b[k]).sum()
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn unit(a: [f64; 3]) -> Option<[f64; 3]> {
    let length = dot(a, a).sqrt();
    (length > 0.0 && length.is_finite()).then(|| a.map(|x| x / length))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_walls_of_a_square_tube() {
        // Four walls one unit from the y axis, open at the ends.
        let corner = |k: usize, y: f64| [[1.0, y, 1.0], [-1.0, y, 1.0], [-1.0, y, -1.0], [1.0, y, -1.0]][k % 4];
        let positions: Vec<[f64; 3]> = (0..4).flat_map(|k| [corner(k, -5.0), corner(k, 5.0)]).collect();
        let wall = |k: u32| {
            let (a, b) = (2 * k, 2 * ((k + 1) % 4));
            [[a, a + 1, b], [a + 1, b + 1, b]]
        };
        let triangles: Vec<[u32; 3]> = (0..4).flat_map(wall).collect();
        let joints = Joints {
            positions: vec![[0.0; 3], [0.0, 1.0, 0.0], [0.0, 9.0, 0.0]],
            parents: vec![None, Some(0), Some(1)],
        };
        let found = local_shape_diameters(&positions, &triangles, &joints);
        // Between the inner radius and that of the corners; the last joint is outside.
        assert!(found[..2].iter().all(|d| (1.05..1.25).contains(d)), "{found:?}");
        assert!((found[0] - found[1]).abs() < 1e-12 && found[2].is_nan());
        let single = Joints { positions: vec![[0.0; 3]], parents: vec![None] };
        assert!(local_shape_diameters(&positions, &[[0, 1, 99]], &single)[0].is_nan());
    }
}
