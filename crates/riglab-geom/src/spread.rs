//! Heat that flows over a surface, and weights that spread with it.

use std::collections::HashMap;

use rayon::prelude::*;
use riglab_core::Mesh;

/// Sources nearer than this share of the mesh's longest edge heat no more than at it.
const NEAREST: f64 = 1e-4;
/// Where the search for weights that spread ends: the share of the first residual that is left.
const RESIDUAL: f64 = 1e-5;
/// And where any search ends.
const ROUNDS: usize = 1_000;
/// Bones whose heat is held at a time.
const AT_ONCE: usize = 32;
/// Bones that a vertex is given to at most.
pub const HOTTEST: usize = 8;

/// Heat that flows over a mesh's surface, and stays the longer where it came from the nearer that is to its source:
/// (L + M H) x = M H p gives the heat x in equilibrium of what heats, p, with L the cotangent Laplacian, M the vertices'
/// areas and H = 1 / d², d a distance of each vertex over which its heat spreads (Pinocchio, Baran and Popović 2007,
/// section 4: the distance from the nearest bone).
///
/// Vertices of one place are one, as heat must cross seams; each such place has a row.
pub struct SurfaceHeat {
    /// The row of each vertex.
    place: Vec<usize>,
    /// A vertex of each row.
    speakers: Vec<usize>,
    offsets: Vec<usize>,
    /// Columns beside the diagonal, with what they take away.
    entries: Vec<(u32, f64)>,
    diagonal: Vec<f64>,
    /// M H.
    heat: Vec<f64>,
}

impl SurfaceHeat {
    /// Of a mesh and each vertex's distance; whatever either is like, the system has a solution.
    ///
    /// # Panics
    /// When there is not a distance a vertex.
    pub fn new(mesh: &Mesh, distance: &[f64]) -> Self {
        assert_eq!(mesh.positions().len(), distance.len(), "a distance a vertex");
        let mut rows: HashMap<[u32; 3], usize> = HashMap::new();
        let (mut place, mut speakers) = (Vec::with_capacity(distance.len()), Vec::new());
        for (v, p) in mesh.positions().iter().enumerate() {
            // -0 and 0 are one place.
            let row = *rows.entry(p.map(|x| (x + 0.0).to_bits())).or_insert_with(|| {
                speakers.push(v);
                speakers.len() - 1
            });
            place.push(row);
        }
        let wide = |row: usize| mesh.positions()[speakers[row]].map(f64::from);
        let (mut edges, mut area): (Vec<(u32, u32, f64)>, Vec<f64>) = (Vec::new(), vec![0.0; speakers.len()]);
        let mut size = 0.0f64;
        for t in mesh.triangles() {
            let t = t.map(|v| place[v as usize]);
            let [a, b, c] = t.map(wide);
            let double = length(cross(minus(b, a), minus(c, a)));
            size = size.max(length(minus(b, a))).max(length(minus(c, a)));
            if !(double > 0.0 && double.is_finite()) {
                continue;
            }
            for k in 0..3 {
                let (i, j, o) = (t[k], t[(k + 1) % 3], [a, b, c][(k + 2) % 3]);
                let cotangent = dot(minus(wide(i), o), minus(wide(j), o)) / double;
                // A flat angle would draw heat from the cold to the hot.
                let w = 0.5 * cotangent.max(0.0);
                if w > 0.0 && w.is_finite() {
                    edges.extend([(i as u32, j as u32, w), (j as u32, i as u32, w)]);
                }
                area[i] += double / 6.0;
            }
        }
        edges.sort_unstable_by(|a, b| (a.0, a.1).cmp(&(b.0, b.1)).then(a.2.total_cmp(&b.2)));
        let mut out = Self {
            offsets: vec![0],
            entries: Vec::with_capacity(edges.len()),
            diagonal: vec![0.0; speakers.len()],
            heat: Vec::with_capacity(speakers.len()),
            place,
            speakers,
        };
        let mut edges = edges.into_iter().peekable();
        for (row, area) in area.into_iter().enumerate() {
            let start = out.entries.len();
            while let Some((_, column, w)) = edges.next_if(|e| e.0 as usize == row) {
                match out.entries[start..].last_mut() {
                    Some(last) if last.0 == column => last.1 += w,
                    _ => out.entries.push((column, w)),
                }
            }
            out.offsets.push(out.entries.len());
            let least = (NEAREST * size).max(f64::MIN_POSITIVE.sqrt());
            let heat = area / distance[out.speakers[row]].max(least).powi(2);
            let flow: f64 = out.entries[start..].iter().map(|(_, w)| w).sum();
            // A vertex without area, or one whose numbers broke: it has the heat of its bone.
            let heat = if heat > 0.0 && heat.is_finite() { heat } else { 1.0 };
            out.heat.push(heat);
            out.diagonal[row] = flow + heat;
        }
        out
    }

    fn times(&self, x: &[f64], out: &mut [f64]) {
        for (row, out) in out.iter_mut().enumerate() {
            let beside = &self.entries[self.offsets[row]..self.offsets[row + 1]];
            *out = self.diagonal[row] * x[row] - beside.iter().map(|(c, w)| w * x[*c as usize]).sum::<f64>();
        }
    }

    /// The row of each vertex.
    pub fn rows(&self) -> &[usize] {
        &self.place
    }

    /// A vertex of each row, the first: of welded vertices it speaks for all.
    pub fn speakers(&self) -> &[usize] {
        &self.speakers
    }

    /// Heat of all rows when some are heated, each row once with its p: conjugate gradients, the diagonal as
    /// preconditioner, until that share of the first residual is left. The matrix is symmetric and its diagonal outweighs
    /// the rest of every row.
    pub fn solve(&self, heated: &[(usize, f64)], residual: f64) -> Vec<f64> {
        let n = self.diagonal.len();
        let (mut x, mut r) = (vec![0.0; n], vec![0.0; n]);
        for &(row, share) in heated {
            r[row] = self.heat[row] * share;
        }
        let eased = |r: &[f64]| r.iter().zip(&self.diagonal).map(|(r, d)| r / d).collect::<Vec<f64>>();
        let sum = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let mut z = eased(&r);
        let (mut p, mut ap) = (z.clone(), vec![0.0; n]);
        let mut rz = sum(&r, &z);
        let enough = rz * residual * residual;
        for _ in 0..ROUNDS {
            if rz.is_nan() || rz <= enough {
                break;
            }
            self.times(&p, &mut ap);
            let step = rz / sum(&p, &ap);
            for k in 0..n {
                x[k] += step * p[k];
                r[k] -= step * ap[k];
            }
            z = eased(&r);
            let next = sum(&r, &z);
            let turn = next / rz;
            p.iter_mut().zip(&z).for_each(|(p, z)| *p = z + turn * *p);
            rz = next;
        }
        x
    }

    /// Of each row the bones with most heat, the hottest first, with `u32::MAX` in places that none takes: each bone in
    /// turn heats the vertices that it is nearest to, and those that several are equally near to in part. `near`: of each
    /// vertex the nearest bones, numbers below `bones`. `residual` as in [`Self::solve`].
    pub fn hottest(&self, near: &[Vec<u32>], bones: usize, residual: f64) -> Vec<[(f32, u32); HOTTEST]> {
        // Of welded vertices the first speaks for all.
        let mut held: Vec<Vec<(usize, f64)>> = vec![Vec::new(); bones];
        for (row, &v) in self.speakers.iter().enumerate() {
            let share = 1.0 / near[v].len() as f64;
            near[v].iter().for_each(|&bone| held[bone as usize].push((row, share)));
        }
        let mut best = vec![[(0.0, u32::MAX); HOTTEST]; self.speakers.len()];
        let heated: Vec<usize> = (0..bones).filter(|&bone| !held[bone].is_empty()).collect();
        for some in heated.chunks(AT_ONCE) {
            let solved: Vec<Vec<f64>> = some.par_iter().map(|&bone| self.solve(&held[bone], residual)).collect();
            best.par_iter_mut().enumerate().for_each(|(row, best)| {
                for (&bone, heat) in some.iter().zip(&solved) {
                    let new = heat[row] as f32;
                    if new > best[HOTTEST - 1].0 {
                        let at = best.partition_point(|old| old.0 >= new);
                        best[at..].rotate_right(1);
                        best[at] = (new, bone as u32);
                    }
                }
            });
        }
        best
    }
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|k| a[k] - b[k])
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|k| a[k] * b[k]).sum()
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn length(a: [f64; 3]) -> f64 {
    dot(a, a).sqrt()
}

/// Weights V × J spread over the surface: each bone's are what heats, each vertex keeps its own the more the smaller its
/// distance is. Smooths what was told vertex by vertex, welds seams, and holds parts that hang together, together. Rows
/// that summed to 1 still do; a row that nothing reaches stays as it was.
///
/// # Panics
/// When lengths do not fit.
pub fn spread_weights(mesh: &Mesh, weights: &[f32], distance: &[f64]) -> Vec<f32> {
    let vertices = mesh.positions().len();
    let bones = weights.len() / vertices.max(1);
    assert_eq!(weights.len(), vertices * bones, "a row of weights a vertex");
    let surface = SurfaceHeat::new(mesh, distance);
    let mut count = vec![0.0f64; surface.speakers.len()];
    surface.place.iter().for_each(|row| count[*row] += 1.0);
    let mut out = vec![0.0f32; weights.len()];
    for first in (0..bones).step_by(AT_ONCE) {
        let some = (first..bones.min(first + AT_ONCE)).into_par_iter();
        let solved: Vec<Vec<f64>> = some
            .map(|bone| {
                let mut own = vec![0.0; count.len()];
                for (v, &row) in surface.place.iter().enumerate() {
                    own[row] += f64::from(weights[v * bones + bone]) / count[row];
                }
                let held: Vec<(usize, f64)> = own.into_iter().enumerate().filter(|(_, w)| *w > 0.0).collect();
                if held.is_empty() { vec![0.0; count.len()] } else { surface.solve(&held, RESIDUAL) }
            })
            .collect();
        out.par_chunks_exact_mut(bones).zip(&surface.place).for_each(|(row, &place)| {
            row[first..].iter_mut().zip(&solved).for_each(|(w, heat)| *w = heat[place].max(0.0) as f32);
        });
    }
    out.par_chunks_exact_mut(bones.max(1)).zip(weights.par_chunks_exact(bones.max(1))).for_each(|(row, before)| {
        let sum: f32 = row.iter().sum();
        if sum > 0.0 && sum.is_finite() {
            row.iter_mut().for_each(|w| *w /= sum);
        } else {
            row.copy_from_slice(before);
        }
    });
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A tube along y with rings of eight vertices, each ring once or, split, each quad with corners of its own.
    fn tube(rings: u32, split: bool) -> Mesh {
        let corner = |r: u32, k: u32| {
            let (sin, cos) = libm::sincosf(std::f32::consts::TAU * (k % 8) as f32 / 8.0);
            [cos, r as f32 * 0.5, sin]
        };
        let (mut positions, mut triangles) = (Vec::new(), Vec::new());
        if !split {
            positions.extend((0..=rings).flat_map(|r| (0..8).map(move |k| corner(r, k))));
        }
        for r in 0..rings {
            for k in 0..8 {
                let own = positions.len() as u32;
                let quad = if split {
                    positions.extend([corner(r, k), corner(r, k + 1), corner(r + 1, k), corner(r + 1, k + 1)]);
                    [own, own + 1, own + 2, own + 3]
                } else {
                    [8 * r + k, 8 * r + (k + 1) % 8, 8 * r + 8 + k, 8 * r + 8 + (k + 1) % 8]
                };
                triangles.extend([[quad[0], quad[2], quad[1]], [quad[1], quad[2], quad[3]]]);
            }
        }
        Mesh::new(positions, triangles).unwrap()
    }

    #[test]
    fn the_system_is_solved() {
        let mesh = tube(20, false);
        let distance: Vec<f64> = (0..mesh.positions().len()).map(|v| 1.0 + 0.01 * v as f64).collect();
        let surface = SurfaceHeat::new(&mesh, &distance);
        let heated: Vec<(usize, f64)> = (0..50).map(|row| (row, 1.0)).collect();
        let x = surface.solve(&heated, 1e-6);
        let mut back = vec![0.0; x.len()];
        surface.times(&x, &mut back);
        for (row, b) in back.iter().enumerate() {
            let want = if row < 50 { surface.heat[row] } else { 0.0 };
            assert!((b - want).abs() < 1e-5 * surface.heat[row].max(1.0), "row {row}: {b}, expected {want}");
        }
        // All heated: the same everywhere.
        let all: Vec<(usize, f64)> = (0..x.len()).map(|row| (row, 1.0)).collect();
        assert!(surface.solve(&all, 1e-6).iter().all(|x| (x - 1.0).abs() < 1e-5));
    }

    #[test]
    fn the_hottest_bones_of_each_row_come_first() {
        // Three bones beside each other along a tube; the middle ring is as near to the first as to the second.
        let mesh = tube(20, false);
        let of = |p: &[f32; 3]| match p[1] {
            y if y < 3.0 => vec![0],
            3.0 => vec![0, 1],
            y if y < 8.0 => vec![1],
            _ => vec![2],
        };
        let near: Vec<Vec<u32>> = mesh.positions().iter().map(of).collect();
        let surface = SurfaceHeat::new(&mesh, &vec![0.7; near.len()]);
        let found = surface.hottest(&near, 4, 1e-6);
        let row = |y: f32| &found[surface.rows()[mesh.positions().iter().position(|p| p[1] == y).unwrap()]];
        assert_eq!([row(1.0)[0].1, row(5.5)[0].1, row(9.5)[0].1], [0, 1, 2]);
        assert!((row(3.0)[0].0 - row(3.0)[1].0).abs() < 1e-3, "{:?}", row(3.0));
        for row in &found {
            assert!((row.iter().map(|(w, _)| w).sum::<f32>() - 1.0).abs() < 1e-4, "{row:?}");
            assert!(row.windows(2).all(|w| w[0].0 >= w[1].0) && row[3].1 == u32::MAX);
        }
    }

    #[test]
    fn weights_spread_as_far_as_they_are_told() {
        // A step in the middle of a tube of 21 rings, half a unit apart.
        let mesh = tube(20, false);
        let vertices = mesh.positions().len();
        let step: Vec<f32> =
            mesh.positions().iter().flat_map(|p| if p[1] < 5.1 { [1.0, 0.0] } else { [0.0, 1.0] }).collect();
        let at = |spread: &[f32], y: f32| {
            let v = mesh.positions().iter().position(|p| p[1] == y).unwrap();
            spread[2 * v]
        };
        let near = spread_weights(&mesh, &step, &vec![1e-3; vertices]);
        assert!(near.iter().zip(&step).all(|(a, b)| (a - b).abs() < 1e-3), "nowhere");
        let some = spread_weights(&mesh, &step, &vec![1.0; vertices]);
        assert!(some.chunks_exact(2).all(|row| (row[0] + row[1] - 1.0).abs() < 1e-5));
        // A screened step falls as exp(-x / d) on either side: 1/(2e) of it is left a unit away from the middle.
        let far: Vec<f32> = [2.0, 4.0, 5.0, 5.5, 6.0, 7.5].map(|y| at(&some, y)).to_vec();
        assert!(far.windows(2).all(|w| w[0] > w[1]) && far[0] > 0.95 && far[5] < 0.08, "{far:?}");
        assert!((at(&some, 6.5) - 0.5 * (-1.25f32).exp()).abs() < 0.03, "{}", at(&some, 6.5));
    }

    #[test]
    fn spread_weights_weld_seams_and_rows_that_nothing_reaches_stay() {
        // Corners of one place differ before; a vertex of no triangle keeps what it has.
        let split = tube(4, true);
        let mesh = Mesh::new([split.positions(), &[[50.0; 3]]].concat(), split.triangles().to_vec()).unwrap();
        let told = |v: usize| [[0.9, 0.1], [0.5, 0.5], [0.2, 0.8]][v % 3];
        let weights: Vec<f32> = (0..mesh.positions().len()).flat_map(told).collect();
        let spread = spread_weights(&mesh, &weights, &vec![0.2; mesh.positions().len()]);
        let last = weights.len() - 2;
        assert!((spread[last] - weights[last]).abs() < 1e-5);
        for (a, p) in mesh.positions().iter().enumerate() {
            let b = mesh.positions().iter().position(|q| q == p).unwrap();
            assert_eq!(spread[2 * a..2 * a + 2], spread[2 * b..2 * b + 2], "{p:?}");
        }
        let none = spread_weights(&mesh, &vec![0.0; weights.len()], &vec![0.2; mesh.positions().len()]);
        assert!(none.iter().all(|w| *w == 0.0), "nothing is made up");
        let odd = spread_weights(&mesh, &weights, &vec![f64::INFINITY; mesh.positions().len()]);
        assert!(odd.iter().all(|w| w.is_finite()));
    }
}
