//! Joints and weights of vertices, and the repair of weights.

use riglab_core::SkinWeights;

use super::accessor::{Accessors, WEIGHTS};
use super::primitives::SourceSet;
use super::skins::Skins;
use crate::{Fault, Warning};

/// How far a sum of weights may be from 1 without a word: bytes come to 2/255.
const SUM_SLACK: f64 = 0.01;

/// The influences on some vertices.
pub(super) struct Rows {
    /// Where each row starts; one more than rows.
    offsets: Vec<usize>,
    /// Slots of the skin with weights above 0, not normalised; at least one a row.
    pairs: Vec<(u16, f64)>,
    /// Rows without weight in the file. They have weight 1 on their first slot.
    unweighted: Vec<u32>,
}

/// What was mended, in vertices.
#[derive(Default)]
pub(super) struct Repairs {
    unweighted: usize,
    not_normalised: usize,
    /// Smallest and largest of their sums.
    sums: Option<(f64, f64)>,
    negative: usize,
    duplicate: usize,
    unused_index: usize,
}

impl Repairs {
    pub(super) fn warn(&self, warnings: &mut Vec<Warning>) {
        let Self { unweighted, not_normalised, sums, negative, duplicate, unused_index } = *self;
        let found = [
            (negative, Warning::NegativeWeights { vertices: negative }),
            (duplicate, Warning::DuplicateInfluences { vertices: duplicate }),
            (unused_index, Warning::UnusedJointIndex { vertices: unused_index }),
            (not_normalised, Warning::NotNormalised { vertices: not_normalised, sums: sums.unwrap_or_default() }),
            (unweighted, Warning::Unweighted { vertices: unweighted }),
        ];
        warnings.extend(found.into_iter().filter(|(vertices, _)| *vertices > 0).map(|(_, warning)| warning));
    }
}

/// Reads the influences on the used vertices of a set bound by `skin`.
pub(super) fn read(
    source: &SourceSet,
    skin: usize,
    accessors: &Accessors<'_>,
    skins: &Skins,
    repairs: &mut Repairs,
) -> Result<Rows, Fault> {
    let place = source.place;
    let count = skins.get(skin).map_or(0, |s| s.joints.len());
    let mut sets = Vec::new();
    for (set, &(joints, weights)) in source.influences().iter().enumerate() {
        let (joints, values) = (accessors.joints(joints)?, accessors.weights(weights)?);
        let wanted = source.positions.len();
        for (kind, found) in [("JOINTS", joints.len()), ("WEIGHTS", values.len())] {
            if found != wanted {
                return Err(Fault::AttributeCount { place, attribute: format!("{kind}_{set}"), found, wanted });
            }
        }
        sets.push((joints, values, weights));
    }

    let mut rows =
        Rows { offsets: vec![0], pairs: Vec::with_capacity(source.numbers.len() * 2), unweighted: Vec::new() };
    for &v in &source.numbers {
        let vertex = v as usize;
        let start = rows.pairs.len();
        let (mut negative, mut duplicate, mut unused_index) = (false, false, false);
        for (joints, weights, accessor) in &sets {
            for (&joint, &weight) in joints[vertex].iter().zip(&weights[vertex]) {
                if !weight.is_finite() {
                    return Err(Fault::NotFinite { accessor: *accessor, used: WEIGHTS.name, element: vertex });
                }
                let in_range = u16::try_from(joint).ok().filter(|j| usize::from(*j) < count);
                negative |= weight < 0.0;
                match in_range {
                    None if weight > 0.0 => {
                        return Err(Fault::JointIndex { place, vertex, joint: joint as usize, skin, count });
                    }
                    None => unused_index = true,
                    Some(slot) if weight > 0.0 => {
                        duplicate |= rows.pairs[start..].iter().any(|(j, _)| *j == slot);
                        rows.pairs.push((slot, weight.into()));
                    }
                    Some(_) => {}
                }
            }
        }
        repairs.negative += usize::from(negative);
        repairs.duplicate += usize::from(duplicate);
        repairs.unused_index += usize::from(unused_index);
        let sum: f64 = rows.pairs[start..].iter().map(|(_, w)| w).sum();
        if rows.pairs.len() == start {
            let first = sets.first().map_or(0, |(joints, ..)| joints[vertex][0]);
            let slot = u16::try_from(first).ok().filter(|j| usize::from(*j) < count).unwrap_or(0);
            rows.unweighted.push(rows.offsets.len() as u32 - 1);
            rows.pairs.push((slot, 1.0));
            repairs.unweighted += 1;
        } else if (sum - 1.0).abs() > SUM_SLACK {
            repairs.not_normalised += 1;
            let (low, high) = repairs.sums.unwrap_or((sum, sum));
            repairs.sums = Some((low.min(sum), high.max(sum)));
        }
        rows.offsets.push(rows.pairs.len());
    }
    Ok(rows)
}

impl Rows {
    /// Slots and weights of a row.
    pub(super) fn row(&self, row: usize) -> &[(u16, f64)] {
        &self.pairs[self.offsets[row]..self.offsets[row + 1]]
    }

    /// The rows by joint of the reading, normalised, and those without weight in the file.
    pub(super) fn into_weights(self, skin: usize, skins: &Skins) -> Result<(SkinWeights, Vec<u32>), Fault> {
        let joint = skins.get(skin).map_or(&[][..], |s| &s.numbers);
        let rows = (0..self.offsets.len() - 1)
            .map(|row| self.row(row).iter().map(|&(slot, weight)| (joint[usize::from(slot)], weight)));
        let weights = SkinWeights::normalized(rows)?;
        Ok((weights, self.unweighted))
    }
}
