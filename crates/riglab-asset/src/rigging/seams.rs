//! Vertices in one place: what a file splits where normals, texture coordinates or materials change.

use riglab_core::{SkinWeights, Vec3};

/// For each vertex the first one in the same place, which may be itself.
///
/// Equal bit for bit, but that 0 and -0 are one: a seam is made by copying, and near vertices may be two lips.
pub fn twins(positions: &[Vec3]) -> Vec<u32> {
    let key = |v: u32| positions[v as usize].map(|x| (x + 0.0).to_bits());
    let mut order: Vec<u32> = (0..positions.len() as u32).collect();
    order.sort_unstable_by_key(|&v| (key(v), v));
    let mut first = vec![0; positions.len()];
    let mut current = 0;
    for (at, &v) in order.iter().enumerate() {
        if at == 0 || key(v) != key(current) {
            current = v;
        }
        first[v as usize] = current;
    }
    first
}

/// The same weights, but that vertices in one place have the mean of theirs, so that no seam opens when the
/// skeleton moves. Rows of vertices that are alone stay bit for bit; so do all where `twins` is of another mesh.
pub fn agreed(weights: &SkinWeights, twins: &[u32]) -> SkinWeights {
    if weights.rows() != twins.len() {
        return weights.clone();
    }
    let mut members: Vec<(u32, u32)> = twins.iter().zip(0u32..).map(|(&first, v)| (first, v)).collect();
    members.sort_unstable();
    let mut rows: Vec<Option<Vec<(u16, f32)>>> = vec![None; twins.len()];
    for group in members.chunk_by(|a, b| a.0 == b.0).filter(|group| group.len() > 1) {
        let own = |v: u32| weights.row(v as usize).map(|(joint, weight)| (joint.0, weight));
        if group.iter().all(|&(_, v)| own(v).eq(own(group[0].1))) {
            continue;
        }
        let mut all: Vec<(u16, f32)> = group.iter().flat_map(|&(_, v)| own(v)).collect();
        // Stable, so that sums are made in one order.
        all.sort_by_key(|(joint, _)| *joint);
        let total: f64 = all.iter().map(|(_, w)| f64::from(*w)).sum();
        let mean = all.chunk_by(|a, b| a.0 == b.0).map(|same| {
            let sum: f64 = same.iter().map(|(_, w)| f64::from(*w)).sum();
            (same[0].0, (sum / total) as f32)
        });
        let mean: Vec<(u16, f32)> = mean.collect();
        group.iter().for_each(|&(_, v)| rows[v as usize] = Some(mean.clone()));
    }
    let (mut offsets, mut joints, mut values) = (vec![0u32], Vec::new(), Vec::new());
    for (v, row) in rows.into_iter().enumerate() {
        let row = row.unwrap_or_else(|| weights.row(v).map(|(joint, weight)| (joint.0, weight)).collect());
        joints.extend(row.iter().map(|(joint, _)| *joint));
        values.extend(row.iter().map(|(_, weight)| *weight));
        offsets.push(joints.len() as u32);
    }
    SkinWeights::new(offsets, joints, values).unwrap_or_else(|_| weights.clone())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn copies_find_their_first_and_agree() {
        let at = [[0.0, 1.0, 0.0], [2.0, 0.0, 0.0], [-0.0, 1.0, 0.0], [2.0, 0.0, 1e-20]];
        let twins = twins(&at);
        assert_eq!(twins, [0, 1, 0, 3]);
        let rows = [vec![(0, 1.0)], vec![(1, 1.0)], vec![(0, 0.5), (2, 0.5)], vec![(2, 1.0)]];
        let agreed = agreed(&SkinWeights::normalized(rows).unwrap(), &twins);
        let row = |v| agreed.row(v).map(|(j, w)| (j.0, w)).collect::<Vec<_>>();
        assert_eq!([row(0), row(1), row(3)], [vec![(0, 0.75), (2, 0.25)], vec![(1, 1.0)], vec![(2, 1.0)]]);
        assert_eq!(row(0), row(2));
    }

    #[test]
    fn no_vertices_have_no_twins() {
        assert!(twins(&[]).is_empty());
    }
}
