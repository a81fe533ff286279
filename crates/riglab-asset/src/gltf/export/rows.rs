//! Rows of weights as JOINTS_n and WEIGHTS_n.

use riglab_core::SkinWeights;
use serde_json::{Value, json};

use super::draft::{ARRAY, Draft, Layout, U8, U16, VEC4};
use crate::Influences;

/// Influences of one pair of JOINTS_n and WEIGHTS_n.
const SET: usize = 4;

/// Rows on their way into a file, with at most so many influences each.
pub(super) struct Rows {
    most: usize,
    /// One row after another: a list for each would cost more than all else here.
    influences: Vec<(u16, f32)>,
    /// Where each row ends.
    ends: Vec<usize>,
    /// How many rows lost influences.
    pub(super) cut: usize,
    /// The largest share of a vertex that was lost.
    pub(super) lost: f32,
}

impl Rows {
    pub(super) fn new(influences: Influences) -> Self {
        Self { most: influences.most(), influences: Vec::new(), ends: Vec::new(), cut: 0, lost: 0.0 }
    }

    /// All rows of `weights`.
    pub(super) fn of(weights: &SkinWeights, influences: Influences) -> Self {
        let mut rows = Self::new(influences);
        for v in 0..weights.rows() {
            rows.push(weights.row(v).map(|(joint, weight)| (joint.0, weight)));
        }
        rows
    }

    /// Adds a row: the largest influences first, as many as allowed, their sum 1.
    pub(super) fn push(&mut self, row: impl IntoIterator<Item = (u16, f32)>) {
        let start = self.influences.len();
        self.influences.extend(row);
        let row = &mut self.influences[start..];
        if row.len() > self.most {
            sort(row);
            let lost: f32 = row[self.most..].iter().map(|(_, w)| w).sum();
            self.cut += 1;
            self.lost = self.lost.max(lost);
            self.influences.truncate(start + self.most);
        }
        normalise(&mut self.influences[start..]);
        self.ends.push(self.influences.len());
    }

    fn rows(&self) -> impl Iterator<Item = &[(u16, f32)]> {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        starts.zip(&self.ends).map(|(start, &end)| &self.influences[start..end])
    }

    /// Writes the rows as attributes of a primitive; joints are numbered up to `joints`.
    pub(super) fn write(&self, draft: &mut Draft, joints: usize) -> Vec<(String, Value)> {
        let most = self.rows().map(<[_]>::len).max().unwrap_or(0);
        let small = joints <= 256;
        let layout =
            Layout { component: if small { U8 } else { U16 }, shape: "VEC4", size: if small { SET } else { 2 * SET } };
        let mut attributes = Vec::new();
        for set in 0..most.div_ceil(SET).max(1) {
            let mut numbers = Vec::with_capacity(layout.size * self.ends.len());
            let mut shares = Vec::with_capacity(VEC4.size * self.ends.len());
            for row in self.rows() {
                let own = row.iter().copied().skip(set * SET);
                for (joint, share) in own.chain(std::iter::repeat((0, 0.0))).take(SET) {
                    match small {
                        true => numbers.push(joint as u8),
                        false => numbers.extend_from_slice(&joint.to_le_bytes()),
                    }
                    shares.extend_from_slice(&share.to_le_bytes());
                }
            }
            attributes.push((format!("JOINTS_{set}"), json!(draft.accessor(&numbers, layout, Some(ARRAY)))));
            attributes.push((format!("WEIGHTS_{set}"), json!(draft.accessor(&shares, VEC4, Some(ARRAY)))));
        }
        attributes
    }
}

fn sort(row: &mut [(u16, f32)]) {
    row.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
}

/// Makes the sum of a row 1, the largest first.
pub(super) fn normalise(row: &mut [(u16, f32)]) {
    sort(row);
    let sum: f64 = row.iter().map(|(_, w)| f64::from(*w)).sum();
    let Some((first, rest)) = row.split_first_mut() else { return };
    let mut others = 0.0;
    for (_, weight) in rest {
        *weight = (f64::from(*weight) / sum) as f32;
        others += f64::from(*weight);
    }
    // What is left is the largest, so that nothing is lost by rounding.
    first.1 = (1.0 - others) as f32;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_largest_stay_and_sum_to_1() {
        let mut rows = Rows::new(Influences::Four);
        rows.push(vec![(0, 0.1), (1, 0.3), (2, 0.2), (3, 0.05), (4, 0.35)]);
        rows.push(vec![(7, 1.0 / 3.0), (8, 1.0 / 3.0), (9, 1.0 / 3.0)]);
        assert_eq!(rows.rows().next().unwrap().iter().map(|(j, _)| *j).collect::<Vec<_>>(), [4, 1, 2, 0]);
        for row in rows.rows() {
            assert_eq!(row.iter().map(|(_, w)| f64::from(*w)).sum::<f64>() as f32, 1.0);
        }
        assert!((rows.influences[0].1 - 0.35 / 0.95).abs() < 1e-7);
        assert_eq!((rows.cut, rows.lost), (1, 0.05));
    }

    #[test]
    fn joints_take_a_byte_as_long_as_they_fit() {
        for (joints, component) in [(256, U8), (257, U16)] {
            let mut draft = Draft::new(json!({}));
            let mut rows = Rows::new(Influences::Eight);
            rows.push((0..9).map(|j| (j, 1.0 / 9.0)));
            let names: Vec<String> = rows.write(&mut draft, joints).into_iter().map(|(name, _)| name).collect();
            assert_eq!(names, ["JOINTS_0", "WEIGHTS_0", "JOINTS_1", "WEIGHTS_1"]);
            assert_eq!(draft.json["accessors"][0]["componentType"], component);
            assert_eq!(draft.json["accessors"][0]["count"], 1);
        }
    }
}
