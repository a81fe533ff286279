//! From arrays to a [`Reading`]: what does not fit is refused, what can be repaired is, and told.

use riglab_core::SkinWeights;

use super::array_rig::{ArrayRig, SparseRows};
use super::doubts;
use super::fault::PeerFault;
use super::fields;
use crate::influences::Repairs;
use crate::names::Names;
use crate::{Binding, Fault, Part, ReadJoint, Reading, VertexSet, Warning, triangles};

/// How far a sum of weights may be from 1 without a word: rounding of f32. Texts of four decimals
/// are off by more, and that is told.
const SUM_SLACK: f64 = 1e-5;

/// The reading of an asset. All its vertices stay, in their order, used by a face or not.
pub(crate) fn reading(rig: &ArrayRig) -> Result<Reading, Fault> {
    fields::check(rig)?;
    if rig.joints.is_empty() && rig.vertices.is_empty() {
        return Err(PeerFault::NoAsset.into());
    }
    if rig.vertices.is_empty() {
        return Err(PeerFault::SkeletonOnly.into());
    }
    if rig.faces.is_empty() {
        return Err(PeerFault::PointsOnly(rig.vertices.len()).into());
    }
    let mut warnings = Vec::new();
    let (joints, number_of) = joints(rig, &mut warnings)?;
    let (weights, unweighted) = match &rig.weights {
        _ if joints.is_empty() => (None, Vec::new()),
        None => return Err(PeerFault::NoWeights.into()),
        Some(rows) => {
            let (weights, unweighted) = weights(rows, &number_of, &mut warnings)?;
            (Some(weights), unweighted)
        }
    };
    let mut faces = rig.faces.clone();
    let dropped = triangles::keep_proper(&mut faces, rig.vertices.len());
    if dropped != triangles::Dropped::default() {
        warnings.push(Warning::Degenerate { collapsed: dropped.collapsed, repeated: dropped.repeated });
    }
    let mut is_used = vec![false; rig.vertices.len()];
    rig.faces.iter().flatten().for_each(|&v| is_used[v as usize] = true);
    let used = (0..rig.vertices.len() as u32).filter(|&v| is_used[v as usize]).collect();
    let set = VertexSet {
        numbers: (0..rig.vertices.len() as u32).collect(),
        positions: rig.vertices.clone(),
        binding: if weights.is_some() { Binding::Skinned } else { Binding::Free },
        weights,
        unweighted,
        repairs: Repairs::default(),
        stored: rig.vertices.len(),
    };
    let part = Part { node: 0, primitive: 0, vertex_set: 0, used, triangles: faces, stored: rig.faces.len() };
    doubts::look(rig, &mut warnings);
    // A face over one vertex three times is no mesh.
    let parts = if part.triangles.is_empty() { Vec::new() } else { vec![part] };
    Ok(Reading { joints, vertex_sets: vec![set], parts, up: rig.up, warnings, ..Reading::default() })
}

/// The joints depth first, and where each one of the file went.
fn joints(rig: &ArrayRig, warnings: &mut Vec<Warning>) -> Result<(Vec<ReadJoint>, Vec<u16>), Fault> {
    let alone = [None];
    let parents = match rig.joints.len() {
        1 if rig.parents.is_empty() => &alone[..],
        _ => &rig.parents[..],
    };
    if parents.len() != rig.joints.len() {
        return Err(PeerFault::NoParents.into());
    }
    if parents.len() >= usize::from(u16::MAX) {
        return Err(riglab_core::RigError::TooManyJoints(parents.len()).into());
    }
    let order = fields::depth_first(parents, &rig.names)?;
    let mut number_of = vec![0u16; order.len()];
    for (number, &joint) in (0u16..).zip(&order) {
        number_of[joint] = number;
    }
    // Names are given in the order of the file, so that the first of equals keeps its own.
    let mut names = Names::default();
    let mut renamed: Option<(usize, usize, String, String)> = None;
    let mut given = Vec::with_capacity(order.len());
    for joint in 0..order.len() {
        let stored = rig.names.get(joint).map_or("", String::as_str);
        let name = names.unique(stored, || format!("joint_{joint}"));
        if !rig.names.is_empty() && name != stored {
            match &mut renamed {
                Some((count, ..)) => *count += 1,
                None => renamed = Some((1, joint, stored.to_owned(), name.clone())),
            }
        }
        given.push(name);
    }
    if let Some((joints, joint, from, to)) = renamed {
        warnings.push(Warning::Renamed { joints, first: (joint, from, to) });
    }
    let joint = |&joint: &usize| ReadJoint {
        name: std::mem::take(&mut given[joint]),
        node: joint,
        parent: parents[joint].map(|p| number_of[p].into()),
        head: rig.joints[joint],
        // One matrix of weights binds them all.
        skeleton: 0,
    };
    Ok((order.iter().map(joint).collect(), number_of))
}

/// The rows by joint of the reading, normalised, and the vertices without weight.
fn weights(
    rows: &SparseRows,
    number_of: &[u16],
    warnings: &mut Vec<Warning>,
) -> Result<(SkinWeights, Vec<u32>), Fault> {
    let (mut offsets, mut joints, mut shares) = (vec![0u32], Vec::new(), Vec::new());
    let mut unweighted = Vec::new();
    let (mut negative, mut duplicate, mut off) = (0, 0, 0);
    let mut sums: Option<(f64, f64)> = None;
    let mut row: Vec<(u16, f64)> = Vec::new();
    for vertex in 0..rows.rows() {
        let stored = rows.row(vertex);
        row.clear();
        row.extend(stored.iter().filter(|(_, w)| *w > 0.0).map(|&(j, w)| (number_of[j as usize], f64::from(w))));
        negative += usize::from(stored.iter().any(|(_, w)| *w < 0.0));
        row.sort_by_key(|(joint, _)| *joint);
        let before = row.len();
        row.dedup_by(|again, first| {
            let same = again.0 == first.0;
            first.1 += if same { again.1 } else { 0.0 };
            same
        });
        duplicate += usize::from(row.len() < before);
        let sum: f64 = row.iter().map(|(_, w)| w).sum();
        if row.is_empty() {
            unweighted.push(vertex as u32);
            row.push((0, 1.0));
        } else if (sum - 1.0).abs() > SUM_SLACK {
            off += 1;
            let (low, high) = sums.unwrap_or((sum, sum));
            sums = Some((low.min(sum), high.max(sum)));
        }
        let sum = if row.is_empty() || sum == 0.0 { 1.0 } else { sum };
        for &(joint, weight) in &row {
            let share = (weight / sum) as f32;
            // A share too small for f32 is no share.
            if share > 0.0 {
                joints.push(joint);
                shares.push(share);
            }
        }
        offsets.push(joints.len() as u32);
    }
    if unweighted.len() == rows.rows() {
        return Err(PeerFault::NoWeights.into());
    }
    let found = [
        (negative, Warning::NegativeWeights { vertices: negative }),
        (duplicate, Warning::DuplicateInfluences { vertices: duplicate }),
        (off, Warning::NotNormalised { vertices: off, sums: sums.unwrap_or_default() }),
        (unweighted.len(), Warning::Unweighted { vertices: unweighted.len() }),
    ];
    warnings.extend(found.into_iter().filter(|(vertices, _)| *vertices > 0).map(|(_, warning)| warning));
    Ok((SkinWeights::new(offsets, joints, shares)?, unweighted))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rig() -> ArrayRig {
        ArrayRig {
            names: vec!["tip".into(), "hips".into()],
            joints: vec![[0.0, 1.0, 0.0], [0.0; 3]],
            parents: vec![Some(1), None],
            vertices: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [9.0; 3]],
            faces: vec![[0, 1, 2]],
            weights: Some(SparseRows::from_triples(
                4,
                &[(0, 1, 1.0), (1, 0, 0.25), (1, 0, 0.25), (1, 1, 0.5), (3, 0, 2.0)],
            )),
            ..ArrayRig::default()
        }
    }

    #[test]
    fn parents_come_first_and_repairs_are_told() {
        let reading = reading(&rig()).unwrap();
        assert_eq!(reading.joints.iter().map(|j| (j.node, j.parent)).collect::<Vec<_>>(), [(1, None), (0, Some(0))]);
        let set = &reading.vertex_sets[0];
        assert_eq!(set.unweighted, [2]);
        let row = |v| set.weights.as_ref().unwrap().row(v).map(|(j, w)| (j.0, w)).collect::<Vec<_>>();
        assert_eq!((row(0), row(1), row(3)), (vec![(0, 1.0)], vec![(0, 0.5), (1, 0.5)], vec![(1, 1.0)]));
        let texts: Vec<_> = reading.warnings.iter().map(ToString::to_string).collect();
        assert!(texts.iter().any(|t| t.contains("duplicate joints in 1")), "{texts:?}");
        assert!(texts.iter().any(|t| t.contains("2.0000 up to 2.0000")), "{texts:?}");
        assert_eq!(reading.parts[0].used, [0, 1, 2]);
    }

    type Change<'a> = &'a dyn Fn(&mut ArrayRig);

    #[test]
    fn what_makes_no_rig_is_refused_in_words() {
        let with = |change: Change<'_>| {
            let mut rig = rig();
            change(&mut rig);
            reading(&rig).unwrap_err().to_string()
        };
        let cases: [(Change<'_>, &str); 8] = [
            (&|r| r.weights = None, "no weight on any vertex"),
            (&|r| r.weights = Some(SparseRows::from_triples(4, &[])), "no weight on any vertex"),
            (&|r| r.weights = Some(SparseRows::from_triples(3, &[])), "has 3 rows for 4 vertices"),
            (&|r| r.faces.clear(), "no faces between them"),
            (&|r| (r.vertices.clear(), r.faces.clear(), r.weights = None).2, "no mesh"),
            (&|r| r.parents.clear(), "whose parent"),
            (&|r| r.parents = vec![Some(1), Some(0)], "joint `tip` is not reachable"),
            (&|r| r.joints[1][0] = f32::NAN, "joint 1 is not finite"),
        ];
        for (change, wanted) in cases {
            let found = with(change);
            assert!(found.contains(wanted), "{found} / {wanted}");
        }
    }
}
