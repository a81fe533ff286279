//! Whether joints are wherever the body is.

use multiversion::multiversion;
use riglab_geom::voxel::Voxels;

use crate::exp::exp;

/// Volumetric joint coverage (SkinTokens 3.4.1):
///
/// ```text
/// R_vj = 1/|V| Σ_v exp(-α min_j ‖v - J_j‖)
/// ```
///
/// over the middles v of the occupied cells, distances in edges of a cell: with α = 0.05 a joint reaches some
/// twenty cells, a tenth of the mesh's longest side at the paper's 196 cells; in units of the mesh in [-1, 1]³ all
/// values would be above 0.84 and tell nothing. 0 without a cell or without a joint.
pub fn coverage(voxels: &Voxels, heads: &[[f64; 3]], alpha: f64) -> f64 {
    Coverage::new(voxels).of(heads, alpha)
}

/// Cells of a block's side.
const SIDE: usize = 8;
/// Cells that are counted at a time.
const LANES: usize = 8;

/// Cells prepared for many skeletons.
///
/// By blocks: joints that are farther from all of a block than the one nearest to its middle are no cell's nearest.
pub struct Coverage {
    scale: [f64; 4],
    blocks: Vec<Block>,
    /// x, y and z of cells, in edges of a cell; each block's are filled up to whole lanes by its last cell.
    cells: [Vec<f64>; 3],
    count: usize,
}

struct Block {
    from: usize,
    cells: usize,
    middle: [f64; 3],
    /// Half its sides.
    half: [f64; 3],
}

impl Coverage {
    /// Prepares the occupied cells.
    pub fn new(voxels: &Voxels) -> Self {
        let lattice = voxels.lattice();
        let size = lattice.size.map(|n| n.div_ceil(SIDE));
        let mut by_block: Vec<Vec<[f64; 3]>> = vec![Vec::new(); size.iter().product()];
        for [x, y, z] in voxels.places() {
            let block = (x / SIDE * size[1] + y / SIDE) * size[2] + z / SIDE;
            by_block[block].push([x, y, z].map(|x| x as f64 + 0.5));
        }
        let mut out = Self {
            scale: [lattice.origin[0], lattice.origin[1], lattice.origin[2], lattice.cell],
            blocks: Vec::new(),
            cells: [const { Vec::new() }; 3],
            count: voxels.count(),
        };
        for cells in by_block {
            let Some(last) = cells.last().copied() else { continue };
            let pick = |f: fn(f64, f64) -> f64| {
                std::array::from_fn(|k| cells.iter().map(|c| c[k]).reduce(f).unwrap_or(last[k]))
            };
            let (low, high): ([f64; 3], [f64; 3]) = (pick(f64::min), pick(f64::max));
            let middle = std::array::from_fn(|k| 0.5 * (low[k] + high[k]));
            let half = std::array::from_fn(|k| 0.5 * (high[k] - low[k]));
            out.blocks.push(Block { from: out.cells[0].len(), cells: cells.len(), middle, half });
            let filled = cells.len().next_multiple_of(LANES) - cells.len();
            for cell in cells.into_iter().chain(std::iter::repeat_n(last, filled)) {
                (0..3).for_each(|k| out.cells[k].push(cell[k]));
            }
        }
        out
    }

    /// How many bytes it takes.
    pub(crate) fn bytes(&self) -> usize {
        size_of_val(&*self.blocks) + self.cells.iter().map(|axis| size_of_val(&**axis)).sum::<usize>()
    }

    /// [`coverage`] of joints.
    pub fn of(&self, heads: &[[f64; 3]], alpha: f64) -> f64 {
        if heads.is_empty() || self.count == 0 {
            return 0.0;
        }
        let [x, y, z, cell] = self.scale;
        let heads: Vec<[f64; 3]> =
            heads.iter().map(|p| [(p[0] - x) / cell, (p[1] - y) / cell, (p[2] - z) / cell]).collect();
        let axes = [0, 1, 2].map(|k| heads.iter().map(|p| p[k]).collect::<Vec<f64>>());
        let mut near: Vec<[f64; 3]> = Vec::with_capacity(heads.len());
        let mut distances = vec![0.0; heads.len()];
        let mut sum = 0.0;
        for block in &self.blocks {
            squares(&axes, block.middle, &mut distances);
            let (mut least, mut nearest) = (f64::INFINITY, heads[0]);
            for (d, p) in distances.iter().zip(&heads) {
                if *d < least {
                    (least, nearest) = (*d, *p);
                }
            }
            // How much a joint's square is above the nearest's changes evenly from the middle on.
            let gain = |p: &[f64; 3]| (0..3).map(|k| block.half[k] * (p[k] - nearest[k]).abs()).sum::<f64>();
            near.clear();
            // With room for rounding.
            let kept = heads.iter().zip(&distances).filter(|(p, d)| **d * (1.0 - 1e-9) <= least + 2.0 * gain(p) + 1e-6);
            near.extend(kept.map(|(p, _)| *p));
            let cells = self.cells.each_ref().map(|axis| &axis[block.from..]);
            sum += covered(cells, block.cells, &near, alpha);
        }
        sum / self.count as f64
    }
}

/// The squared distance of each joint, axis by axis, from a point. By the widest instructions there are; the values are
/// the same.
#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
fn squares(heads: &[Vec<f64>; 3], from: [f64; 3], out: &mut [f64]) {
    let [xs, ys, zs] = heads;
    for (((out, x), y), z) in out.iter_mut().zip(xs).zip(ys).zip(zs) {
        let (dx, dy, dz) = (x - from[0], y - from[1], z - from[2]);
        *out = dx * dx + dy * dy + dz * dz;
    }
}

/// The sum over a block's cells, of which so many count, of what the nearest of some joints is worth; by instructions as
/// [`squares`].
#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
fn covered(axes: [&[f64]; 3], count: usize, near: &[[f64; 3]], alpha: f64) -> f64 {
    let mut sum = 0.0;
    let lanes = axes.map(|axis| axis.as_chunks::<LANES>().0);
    for from in (0..count).step_by(LANES) {
        let [xs, ys, zs] = [&lanes[0][from / LANES], &lanes[1][from / LANES], &lanes[2][from / LANES]];
        let mut least = [f64::INFINITY; LANES];
        for [x, y, z] in near {
            for i in 0..LANES {
                let (dx, dy, dz) = (xs[i] - x, ys[i] - y, zs[i] - z);
                let d = dx * dx + dy * dy + dz * dz;
                least[i] = if d < least[i] { d } else { least[i] };
            }
        }
        let mut values = [0.0; LANES];
        for i in 0..LANES {
            values[i] = exp(-alpha * least[i].sqrt());
        }
        sum += values[..LANES.min(count - from)].iter().sum::<f64>();
    }
    sum
}

#[cfg(test)]
mod tests {
    use riglab_geom::voxel::Lattice;
    use riglab_random::{Draw, stream};

    use super::*;

    #[test]
    fn blocks_leave_no_nearest_joint_out() {
        let lattice = Lattice { origin: [-1.0, 0.5, 2.0], cell: 0.25, size: [23, 17, 40] };
        let mut random = stream(1, "test", &[]);
        let some = (0..lattice.cells()).filter(|_| random.unit() < 0.2).map(|i| lattice.place(i));
        let voxels = Voxels::new(lattice, some.collect::<Vec<_>>());
        let mut random = stream(2, "test", &[]);
        let heads: Vec<[f64; 3]> =
            (0..30).map(|_| [0, 1, 2].map(|k| lattice.origin[k] + 12.0 * f64::from(random.unit()) - 1.0)).collect();
        let plain = |place: [usize; 3]| {
            let v = lattice.center(place);
            let far = |p: &[f64; 3]| (0..3).map(|k| (p[k] - v[k]).powi(2)).sum::<f64>().sqrt() / lattice.cell;
            (-0.05 * heads.iter().map(far).fold(f64::INFINITY, f64::min)).exp()
        };
        let wanted = voxels.places().map(plain).sum::<f64>() / voxels.count() as f64;
        assert!((coverage(&voxels, &heads, 0.05) - wanted).abs() < 1e-12);
        assert_eq!(coverage(&Voxels::new(lattice, []), &heads, 0.05), 0.0);
        assert_eq!(coverage(&voxels, &[], 0.05), 0.0);
    }
}
