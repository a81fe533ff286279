//! Signs that an asset's skeleton, mesh and weights do not belong together, as known faults of the
//! peers' converters leave them.

use riglab_core::{Bounds, Vec3};

use super::array_rig::ArrayRig;
use crate::Warning;

/// Share of the box's longest side by which joints may lie outside of it.
const MARGIN: f32 = 0.1;

/// How many vertices are looked at.
const SAMPLES: usize = 1000;

/// Steps at most, vertices by joints.
const STEPS: usize = 2_000_000;

/// How many times farther than the nearest bone the heaviest one may be, in the mean.
const FAR: f64 = 3.0;

/// Warns about joints far outside the mesh, and about weights on joints far from their vertices.
pub(super) fn look(rig: &ArrayRig, warnings: &mut Vec<Warning>) {
    let Some(bounds) = Bounds::of(rig.vertices.iter().copied()) else { return };
    let size = bounds.size();
    let slack = MARGIN * size.into_iter().fold(0.0, f32::max);
    let is_out = |p: &&Vec3| (0..3).any(|k| p[k] < bounds.min[k] - slack || p[k] > bounds.max[k] + slack);
    let outside = rig.joints.iter().filter(is_out).count();
    if outside > 0 {
        warnings.push(Warning::JointsOutside { outside, joints: rig.joints.len() });
    }
    if let Some(ratio) = distance_ratio(rig).filter(|ratio| *ratio > FAR) {
        warnings.push(Warning::FarWeights { ratio });
    }
}

/// Mean distance of vertices to their heaviest bone over that to their nearest. The converter of
/// UniRig takes weights from wrong vertices behind the first merged one.
fn distance_ratio(rig: &ArrayRig) -> Option<f64> {
    let rows = rig.weights.as_ref()?;
    if rig.joints.len() < 2 || rig.parents.len() != rig.joints.len() {
        return None;
    }
    // Bones go from a joint to each of its children; a leaf is a point.
    let mut bones: Vec<(usize, Vec3, Vec3)> = Vec::new();
    let mut has_child = vec![false; rig.joints.len()];
    for (joint, parent) in rig.parents.iter().enumerate() {
        if let Some(parent) = *parent {
            has_child[parent] = true;
            bones.push((parent, rig.joints[parent], rig.joints[joint]));
        }
    }
    let leaves = (0..rig.joints.len()).filter(|&j| !has_child[j]);
    bones.extend(leaves.map(|j| (j, rig.joints[j], rig.joints[j])));
    let samples = SAMPLES.min(STEPS / bones.len()).min(rows.rows());
    let (mut own, mut nearest) = (0.0, 0.0);
    for sample in 0..samples {
        let vertex = sample * rows.rows() / samples;
        let heaviest = rows.row(vertex).iter().max_by(|a, b| a.1.total_cmp(&b.1));
        let Some(&(joint, _)) = heaviest else { continue };
        let mut best = [f32::INFINITY; 2];
        for (of, from, to) in &bones {
            let d = to_segment(rig.vertices[vertex], *from, *to);
            best[0] = best[0].min(d);
            if *of == joint as usize {
                best[1] = best[1].min(d);
            }
        }
        nearest += f64::from(best[0]);
        own += f64::from(best[1]);
    }
    (nearest > 0.0 && own.is_finite()).then(|| own / nearest)
}

fn to_segment(p: Vec3, a: Vec3, b: Vec3) -> f32 {
    let [p, a, b] = [p, a, b].map(glam::Vec3::from);
    let (along, length) = (b - a, (b - a).length_squared());
    let t = if length > 0.0 { ((p - a).dot(along) / length).clamp(0.0, 1.0) } else { 0.0 };
    p.distance(a + t * along)
}

#[cfg(test)]
mod tests {
    use super::super::array_rig::SparseRows;
    use super::*;

    #[test]
    fn misplaced_joints_and_shuffled_weights_are_told() {
        let joints: Vec<Vec3> = (0..4).map(|k| [0.0, k as f32, 0.0]).collect();
        let vertices: Vec<Vec3> = (0..40).map(|k| [0.1, k as f32 * 0.1 - 0.05, 0.0]).collect();
        let near: Vec<_> = (0..40u32).map(|v| (v, v / 10, 1.0)).collect();
        let far: Vec<_> = (0..40u32).map(|v| (v, 3 - v / 10, 1.0)).collect();
        let mut rig = ArrayRig {
            joints,
            vertices,
            parents: vec![None, Some(0), Some(1), Some(2)],
            weights: Some(SparseRows::from_triples(40, &near)),
            ..ArrayRig::default()
        };
        let warnings = |rig: &ArrayRig| {
            let mut out = Vec::new();
            look(rig, &mut out);
            out
        };
        assert_eq!(warnings(&rig), []);
        rig.weights = Some(SparseRows::from_triples(40, &far));
        assert!(matches!(warnings(&rig)[..], [Warning::FarWeights { ratio }] if ratio > 5.0));
        rig.joints.iter_mut().for_each(|j| j[0] += 9.0);
        assert_eq!(warnings(&rig)[0], Warning::JointsOutside { outside: 4, joints: 4 });
    }
}
