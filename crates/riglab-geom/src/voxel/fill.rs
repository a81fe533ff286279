//! Cells between others.

use super::lattice::Voxels;

/// Along how many axes a cell must lie between occupied ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Between {
    /// All three: what SkinTokens' public code does as a rule.
    All,
    /// Two of three: UniRig's, and SkinTokens' loose form.
    Two,
}

/// The occupied cells, and those that lie between the first and the last occupied one of their column
/// along enough axes.
///
/// Fills a closed surface and many an open one, but the space between two legs or under an arm as well.
pub fn fill(voxels: &Voxels, between: Between) -> Voxels {
    let lattice = *voxels.lattice();
    let [nx, ny, nz] = lattice.size;
    // First and last occupied cell of every column, by the axis it runs along.
    let none = (u32::MAX, 0u32);
    let mut spans = [vec![none; ny * nz], vec![none; nx * nz], vec![none; nx * ny]];
    let column = |[x, y, z]: [usize; 3]| [y * nz + z, x * nz + z, x * ny + y];
    for place in voxels.places() {
        for (axis, at) in column(place).into_iter().enumerate() {
            let (first, last) = &mut spans[axis][at];
            (*first, *last) = ((*first).min(place[axis] as u32), (*last).max(place[axis] as u32));
        }
    }
    let least = match between {
        Between::All => 3,
        Between::Two => 2,
    };
    let mut words = vec![0u64; voxels.words().len()];
    for x in 0..nx {
        for y in 0..ny {
            for z in 0..nz {
                let at = column([x, y, z]);
                let within = |axis: usize, k: usize| {
                    let (first, last) = spans[axis][at[axis]];
                    u8::from(first as usize <= k && k <= last as usize)
                };
                if within(0, x) + within(1, y) + within(2, z) >= least {
                    let index = lattice.index([x, y, z]);
                    words[index / 64] |= 1 << (index % 64);
                }
            }
        }
    }
    Voxels::from_words(lattice, words)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::voxel::Lattice;

    #[test]
    fn a_box_without_a_lid_is_full_by_two_axes_and_empty_by_three() {
        let lattice = Lattice { origin: [0.0; 3], cell: 1.0, size: [5; 3] };
        let wall = |p: &[usize; 3]| p[2] < 4 && (p[2] == 0 || matches!(p[0], 0 | 4) || matches!(p[1], 0 | 4));
        let walls: Vec<_> = (0..lattice.cells()).map(|i| lattice.place(i)).filter(wall).collect();
        let open = Voxels::new(lattice, walls);
        assert_eq!(fill(&open, Between::Two).count(), 5 * 5 * 4);
        assert_eq!(fill(&open, Between::All), open);
    }
}
