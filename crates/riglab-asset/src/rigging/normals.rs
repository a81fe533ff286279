//! Normals where a file has none, or broken ones.

use glam::Vec3;

use super::seams::twins;

/// A unit normal for each vertex: its own scaled to unit length; where that is missing or makes no direction, the
/// mean of the triangles around its place, by area; +y where there are none.
pub(crate) fn complete(own: &[[f32; 3]], positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> Vec<[f32; 3]> {
    let unit = |n: &[f32; 3]| Vec3::from(*n).as_dvec3().try_normalize().map(|n| n.as_vec3().to_array());
    let given: Vec<Option<[f32; 3]>> = own.iter().map(unit).collect();
    if given.len() == positions.len() && given.iter().all(Option::is_some) {
        return given.into_iter().flatten().collect();
    }
    let first = twins(positions);
    let mut sums = vec![glam::DVec3::ZERO; positions.len()];
    for t in triangles {
        let [a, b, c] = t.map(|v| Vec3::from(positions[v as usize]).as_dvec3());
        let area = (b - a).cross(c - a);
        t.iter().for_each(|&v| sums[first[v as usize] as usize] += area);
    }
    let made = |v: usize| sums[first[v] as usize].try_normalize().unwrap_or(glam::DVec3::Y).as_vec3().to_array();
    (0..positions.len()).map(|v| given.get(v).copied().flatten().unwrap_or_else(|| made(v))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_normals_are_made_across_seams() {
        let at = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0; 3], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let own = [[0.0, 0.0, 2.0], [0.0; 3], [f32::NAN, 0.0, 0.0], [0.0; 3], [0.0; 3], [0.0; 3]];
        let made = complete(&own, &at, &[[0, 1, 2], [3, 4, 5]]);
        assert_eq!((made[0], made[1], made[5]), ([0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]));
        // Of the first triangle along z, of the second along x.
        assert_eq!((made[2], made[2][0]), (made[4], made[2][2]));
        assert_eq!(complete(&[], &[[1.0; 3]], &[]), [[0.0, 1.0, 0.0]]);
    }
}
