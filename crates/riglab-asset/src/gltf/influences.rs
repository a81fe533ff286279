//! JOINTS_n and WEIGHTS_n of the vertices of a set.

use super::accessor::{Accessors, WEIGHTS};
use super::primitives::SourceSet;
use super::skins::Skins;
use crate::Fault;
use crate::influences::{Repairs, Rows};

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

    let mut rows = Rows::with_capacity(source.numbers.len());
    for &v in &source.numbers {
        let vertex = v as usize;
        let mut unused_index = false;
        for (joints, weights, accessor) in &sets {
            for (&joint, &weight) in joints[vertex].iter().zip(&weights[vertex]) {
                if !weight.is_finite() {
                    return Err(Fault::NotFinite { accessor: *accessor, used: WEIGHTS.name, element: vertex });
                }
                let in_range = u16::try_from(joint).ok().filter(|j| usize::from(*j) < count);
                match in_range {
                    None if weight > 0.0 => {
                        return Err(Fault::JointIndex { place, vertex, joint: joint as usize, skin, count });
                    }
                    None => {
                        unused_index = true;
                        rows.push(0, f64::from(weight).min(0.0));
                    }
                    Some(slot) => rows.push(slot, weight.into()),
                }
            }
        }
        repairs.unused_index += usize::from(unused_index);
        let first = sets.first().map_or(0, |(joints, ..)| joints[vertex][0]);
        let slot = u16::try_from(first).ok().filter(|j| usize::from(*j) < count).unwrap_or(0);
        rows.end(slot, repairs);
    }
    Ok(rows)
}
