//! Which way triangles should face, where files disagree.

use glam::DVec3;
use rayon::prelude::*;
use riglab_core::Mesh;

use crate::buckets::sorted_by_place;

/// For each triangle whether to turn it over, so that neighbours agree and each patch, taken as the skin
/// of a body, faces outwards.
///
/// Neighbours share an edge by its positions, which no third triangle has. A patch is what neighbours reach
/// from one to another; one without a volume, such as a flat sheet, keeps its first triangle's side.
pub(super) fn turned(mesh: &Mesh) -> Vec<bool> {
    let triangles = mesh.triangles();
    let ids = welded(mesh);
    let mut edges: Vec<(u64, u32)> = Vec::with_capacity(3 * triangles.len());
    for (t, corners) in triangles.iter().enumerate() {
        let corners = corners.map(|v| ids[v as usize]);
        if corners[0] == corners[1] || corners[1] == corners[2] || corners[2] == corners[0] {
            continue;
        }
        for k in 0..3 {
            let (a, b) = (corners[k], corners[(k + 1) % 3]);
            // The last bit says which way the triangle runs along the edge.
            let (low, high) = (a.min(b), a.max(b));
            edges.push((u64::from(low) << 32 | u64::from(high), (t as u32) << 1 | u32::from(a > b)));
        }
    }
    let edges = sorted_by_place(edges, mesh.positions().len(), |(edge, _)| (edge >> 32) as usize);
    let mut neighbours = vec![[(u32::MAX, false); 3]; triangles.len()];
    let mut join = |t: u32, other: u32, differs: bool| {
        if let Some(free) = neighbours[t as usize].iter_mut().find(|(n, _)| *n == u32::MAX) {
            *free = (other, differs);
        }
    };
    for pair in edges.chunk_by(|a, b| a.0 == b.0) {
        if let [(_, a), (_, b)] = *pair {
            let differs = a & 1 == b & 1;
            join(a >> 1, b >> 1, differs);
            join(b >> 1, a >> 1, differs);
        }
    }
    let mut turned = vec![false; triangles.len()];
    let mut seen = vec![false; triangles.len()];
    let mut patch: Vec<u32> = Vec::new();
    for first in 0..triangles.len() {
        if seen[first] {
            continue;
        }
        seen[first] = true;
        patch.clear();
        patch.push(first as u32);
        let mut next = 0;
        while let Some(&t) = patch.get(next) {
            next += 1;
            for (other, differs) in neighbours[t as usize] {
                if other != u32::MAX && !seen[other as usize] {
                    seen[other as usize] = true;
                    turned[other as usize] = turned[t as usize] ^ differs;
                    patch.push(other);
                }
            }
        }
        if volume(mesh, &patch, &turned) < 0.0 {
            patch.iter().for_each(|&t| turned[t as usize] ^= true);
        }
    }
    turned
}

/// Six times the volume between a patch and the middle of its surface.
fn volume(mesh: &Mesh, patch: &[u32], turned: &[bool]) -> f64 {
    let corners = |t: u32| mesh.corners(t as usize).map(|p| DVec3::from(p.map(f64::from)));
    let (mut sum, mut area) = (DVec3::ZERO, 0.0);
    for &t in patch {
        let [a, b, c] = corners(t);
        let here = (b - a).cross(c - a).length();
        sum += here * (a + b + c) / 3.0;
        area += here;
    }
    if !(area > 0.0 && area.is_finite()) {
        return 0.0;
    }
    let middle = sum / area;
    let part = |&t: &u32| {
        let [a, b, c] = corners(t).map(|p| p - middle);
        let part = a.dot(b.cross(c));
        if turned[t as usize] { -part } else { part }
    };
    patch.iter().map(part).sum()
}

/// A number for each vertex, equal where positions are.
fn welded(mesh: &Mesh) -> Vec<u32> {
    // -0 is 0.
    let key = |p: &[f32; 3]| p.map(|x| (x + 0.0).to_bits());
    let positions = mesh.positions();
    let mut order: Vec<u32> = (0..positions.len() as u32).collect();
    order.par_sort_unstable_by_key(|&v| (key(&positions[v as usize]), v));
    let mut ids = vec![0; positions.len()];
    let (mut id, mut last) = (0, None);
    for v in order {
        let now = Some(key(&positions[v as usize]));
        if last.is_some() && last != now {
            id += 1;
        }
        last = now;
        ids[v as usize] = id;
    }
    ids
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bodies::{cube, joined, turned_over};

    #[test]
    fn a_body_turned_inside_out_is_turned_back() {
        let [inside_out, sound] = [turned_over(&cube([5.0; 3], 1.0), |_| true), cube([0.0; 3], 1.0)];
        let both = joined(&[inside_out, sound]);
        let wanted: Vec<bool> = (0..24).map(|t| t < 12).collect();
        assert_eq!(turned(&both), wanted);
    }

    #[test]
    fn triangles_that_disagree_are_brought_into_line() {
        let some = |t: usize| t % 5 == 3;
        let mixed = turned_over(&cube([0.0; 3], 1.0), some);
        let wanted: Vec<bool> = (0..12).map(some).collect();
        assert_eq!(turned(&mixed), wanted);
    }
}
