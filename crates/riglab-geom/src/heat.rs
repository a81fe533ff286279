//! Heat that flows over a surface, and is told in equilibrium.

use std::collections::HashMap;

use rayon::prelude::*;
use riglab_core::Mesh;

/// Sources nearer than this share of the mesh's longest edge heat no more than at it.
const NEAREST: f64 = 1e-4;
/// Where any search for the equilibrium ends.
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

    /// The row of each vertex.
    pub fn rows(&self) -> &[usize] {
        &self.place
    }

    /// A vertex of each row, the first: of welded vertices it speaks for all.
    pub fn speakers(&self) -> &[usize] {
        &self.speakers
    }

    /// Heat of all rows for each of several ways to heat some, a row once with its p: conjugate gradients, the diagonal as
    /// preconditioner, until that share of the first residual is left. The matrix is symmetric and its diagonal outweighs
    /// the rest of every row. Each is solved as if it were alone, to the bit.
    pub fn solve(&self, heated: &[Vec<(usize, f64)>], residual: f64) -> Vec<Vec<f64>> {
        // Beside each other an entry of the matrix is read once for all, and sums wait for none; but threads come first.
        match heated.len() / rayon::current_num_threads() {
            0..4 => self.solve_by::<1>(heated, residual),
            4..8 => self.solve_by::<4>(heated, residual),
            _ => self.solve_by::<8>(heated, residual),
        }
    }

    fn solve_by<const LANES: usize>(&self, heated: &[Vec<(usize, f64)>], residual: f64) -> Vec<Vec<f64>> {
        heated.par_chunks(LANES).flat_map_iter(|some| self.beside_each_other::<LANES>(some, residual)).collect()
    }

    /// The matrix times x, and x times that.
    fn times<const LANES: usize>(&self, x: &[[f64; LANES]], out: &mut [[f64; LANES]]) -> [f64; LANES] {
        let mut product = [0.0; LANES];
        for (row, out) in out.iter_mut().enumerate() {
            let mut beside = [0.0; LANES];
            for (column, w) in &self.entries[self.offsets[row]..self.offsets[row + 1]] {
                let x = &x[*column as usize];
                (0..LANES).for_each(|k| beside[k] += w * x[k]);
            }
            let (x, d) = (&x[row], self.diagonal[row]);
            *out = std::array::from_fn(|k| d * x[k] - beside[k]);
            (0..LANES).for_each(|k| product[k] += x[k] * out[k]);
        }
        product
    }

    fn beside_each_other<const LANES: usize>(&self, heated: &[Vec<(usize, f64)>], residual: f64) -> Vec<Vec<f64>> {
        let n = self.diagonal.len();
        let (mut x, mut r) = (vec![[0.0; LANES]; n], vec![[0.0; LANES]; n]);
        for (k, own) in heated.iter().enumerate() {
            own.iter().for_each(|&(row, share)| r[row][k] = self.heat[row] * share);
        }
        let mut rz = [0.0; LANES];
        let eased = |(r, d): (&[f64; LANES], &f64)| {
            let z = r.map(|r| r / d);
            (0..LANES).for_each(|k| rz[k] += r[k] * z[k]);
            z
        };
        let mut p: Vec<[f64; LANES]> = r.iter().zip(&self.diagonal).map(eased).collect();
        let mut ap = vec![[0.0; LANES]; n];
        let enough = rz.map(|rz| rz * residual * residual);
        let mut ended = [false; LANES];
        for _ in 0..ROUNDS {
            for k in 0..LANES {
                if !ended[k] && (rz[k].is_nan() || rz[k] <= enough[k]) {
                    // It stays as it is while others go on: nothing moves what has no direction.
                    ended[k] = true;
                    r.iter_mut().zip(&mut p).for_each(|(r, p)| (r[k], p[k]) = (0.0, 0.0));
                }
            }
            if ended == [true; LANES] {
                break;
            }
            let of_those = |a: [f64; LANES], b: [f64; LANES]| -> [f64; LANES] {
                std::array::from_fn(|k| if ended[k] { 0.0 } else { a[k] / b[k] })
            };
            let product = self.times(&p, &mut ap);
            let step = of_those(rz, product);
            let mut next = [0.0; LANES];
            let states = x.iter_mut().zip(&mut r).zip(p.iter().zip(&mut ap));
            for (((x, r), (p, ap)), d) in states.zip(&self.diagonal) {
                for k in 0..LANES {
                    x[k] += step[k] * p[k];
                    r[k] -= step[k] * ap[k];
                    // The product is of no more use, and r eased by the diagonal has its place.
                    ap[k] = r[k] / d;
                    next[k] += r[k] * ap[k];
                }
            }
            let turn = of_those(next, rz);
            for (p, z) in p.iter_mut().zip(&ap) {
                (0..LANES).for_each(|k| p[k] = z[k] + turn[k] * p[k]);
            }
            rz = next;
        }
        (0..heated.len()).map(|k| x.iter().map(|x| x[k]).collect()).collect()
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
            let own: Vec<Vec<(usize, f64)>> = some.iter().map(|&bone| std::mem::take(&mut held[bone])).collect();
            let solved = self.solve(&own, residual);
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

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A tube along y with rings of eight vertices, each ring once or, split, each quad with corners of its own.
    pub(crate) fn tube(rings: u32, split: bool) -> Mesh {
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
        let all: Vec<(usize, f64)> = (0..mesh.positions().len()).map(|row| (row, 1.0)).collect();
        let [x, even] = surface.solve(&[heated, all], 1e-6).try_into().unwrap();
        let mut back = vec![[0.0]; x.len()];
        surface.times(&x.iter().map(|x| [*x]).collect::<Vec<_>>(), &mut back);
        for (row, [b]) in back.iter().enumerate() {
            let want = if row < 50 { surface.heat[row] } else { 0.0 };
            assert!((b - want).abs() < 1e-5 * surface.heat[row].max(1.0), "row {row}: {b}, expected {want}");
        }
        // All heated: the same everywhere.
        assert!(even.iter().all(|x| (x - 1.0).abs() < 1e-5));
    }

    /// Some are done sooner than others, some have nothing to do, and one is broken.
    #[test]
    fn each_is_solved_as_if_it_were_alone() {
        let mesh = tube(20, false);
        let n = mesh.positions().len();
        let distance: Vec<f64> = (0..n).map(|v| 0.2 + 0.01 * v as f64).collect();
        let surface = SurfaceHeat::new(&mesh, &distance);
        let of = |bone: usize| match bone {
            3 | 10 => Vec::new(),
            5 => vec![(7, f64::NAN)],
            _ => (0..n).filter(|row| row % 11 >= bone).map(|row| (row, 1.0 / (1 + bone) as f64)).collect(),
        };
        let heated: Vec<Vec<(usize, f64)>> = (0..11).map(of).collect();
        let alone = surface.solve_by::<1>(&heated, 1e-3);
        let by_threads = surface.solve(&heated, 1e-3);
        for together in [surface.solve_by::<4>(&heated, 1e-3), surface.solve_by::<8>(&heated, 1e-3), by_threads] {
            assert_eq!(together.len(), heated.len());
            for (bone, (alone, own)) in alone.iter().zip(&together).enumerate() {
                assert!(alone.iter().zip(own).all(|(a, b)| a.to_bits() == b.to_bits()), "bone {bone}");
                assert!(bone == 5 || own.iter().all(|x| x.is_finite()));
            }
        }
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
}
