//! Heat that flows over a surface, and is told in equilibrium.

use std::collections::HashMap;
use std::ops::Range;

use rayon::prelude::*;
use riglab_core::Mesh;

use crate::pieces::Groups;
use crate::system::System;

/// Sources nearer than this share of the mesh's longest edge heat no more than at it.
const NEAREST: f64 = 1e-4;
/// Bones whose heat is held at a time.
const AT_ONCE: usize = 32;
/// Bones that a vertex is given to at most.
pub const HOTTEST: usize = 8;

/// Heat that flows over a mesh's surface, and stays the longer where it came from the nearer that is to its source:
/// (L + M H) x = M H p gives the heat x in equilibrium of what heats, p, with L the cotangent Laplacian, M the vertices'
/// areas and H = 1 / d², d a distance of each vertex over which its heat spreads (Pinocchio, Baran and Popović 2007,
/// section 4: the distance from the nearest bone).
///
/// Vertices of one place are one, as heat must cross seams; each such place has a row. Heat leaves no part of the surface
/// that hangs together, so each is a system of its own.
pub struct SurfaceHeat {
    /// The row of each vertex.
    place: Vec<usize>,
    /// A vertex of each row.
    speakers: Vec<usize>,
    /// The rows of each part that heat does not leave, in order, together all rows; and of each L + M H.
    parts: Vec<(Range<usize>, System)>,
    /// M H.
    heat: Vec<f64>,
}

/// What one way to heat rows has in one part.
struct Way<'a> {
    /// Which of the ways it is.
    number: usize,
    heated: &'a [(usize, f64)],
}

/// The heat of all rows of a part, by one way to heat some.
struct Solved {
    number: usize,
    rows: Range<usize>,
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
        let parts = order_by_parts(&mut place, &mut speakers, &mut edges, &mut area);
        edges.sort_unstable_by(|a, b| (a.0, a.1).cmp(&(b.0, b.1)).then(a.2.total_cmp(&b.2)));
        let least = (NEAREST * size).max(f64::MIN_POSITIVE.sqrt());
        let heat = area.into_iter().zip(&speakers).map(|(area, &v)| {
            let heat = area / distance[v].max(least).powi(2);
            // A vertex without area, or one whose numbers broke: it has the heat of its bone.
            if heat > 0.0 && heat.is_finite() { heat } else { 1.0 }
        });
        let heat: Vec<f64> = heat.collect();
        let mut edges = edges.into_iter().peekable();
        let system = |rows: Range<usize>| {
            let mut system = System::default();
            for row in rows.clone() {
                let mut columns: Vec<(u32, f64)> = Vec::new();
                while let Some((_, column, w)) = edges.next_if(|e| e.0 as usize == row) {
                    let column = column - rows.start as u32;
                    match columns.last_mut() {
                        Some(last) if last.0 == column => last.1 += w,
                        _ => columns.push((column, w)),
                    }
                }
                system.add(&columns, heat[row]);
            }
            (rows, system)
        };
        let parts = parts.into_iter().map(system).collect();
        Self { place, speakers, parts, heat }
    }

    /// The row of each vertex.
    pub fn rows(&self) -> &[usize] {
        &self.place
    }

    /// A vertex of each row, the first: of welded vertices it speaks for all.
    pub fn speakers(&self) -> &[usize] {
        &self.speakers
    }

    /// Heat of all rows for each of several ways to heat some, in the order of rows, a row once with its p. Each is solved
    /// as if it were alone, to the bit.
    pub fn solve(&self, heated: &[Vec<(usize, f64)>]) -> Vec<Vec<f64>> {
        let mut out = vec![vec![0.0; self.heat.len()]; heated.len()];
        for part in self.by_parts(heated) {
            out[part.number][part.rows].copy_from_slice(&part.heat);
        }
        out
    }

    /// See [`Self::solve`]: what is heated at all, part after part, in each the ways in their order.
    fn by_parts(&self, heated: &[Vec<(usize, f64)>]) -> Vec<Solved> {
        let mut ways: Vec<Vec<Way>> = Vec::new();
        ways.resize_with(self.parts.len(), Vec::new);
        for (number, own) in heated.iter().enumerate() {
            let mut rest = own.as_slice();
            while let Some(&(row, _)) = rest.first() {
                let part = self.parts.partition_point(|(rows, _)| rows.end <= row);
                let (here, beyond) = rest.split_at(rest.partition_point(|(row, _)| *row < self.parts[part].0.end));
                ways[part].push(Way { number, heated: here });
                rest = beyond;
            }
        }
        // Beside each other a number of the system is read once for all, and sums wait for none; but threads come first.
        let share = ways.iter().map(Vec::len).sum::<usize>() / rayon::current_num_threads();
        let solve = |part: &(Range<usize>, System), ways: &[Way]| -> Vec<Solved> {
            let (lanes, jobs) = match share.min(ways.len()) {
                0..4 => (1, ways.par_chunks(1)),
                4..8 => (4, ways.par_chunks(4)),
                _ => (8, ways.par_chunks(8)),
            };
            let some = |some: &[Way]| match lanes {
                1 => self.beside_each_other::<1>(part, some),
                4 => self.beside_each_other::<4>(part, some),
                _ => self.beside_each_other::<8>(part, some),
            };
            jobs.flat_map_iter(some).collect()
        };
        let heated = self.parts.par_iter().zip(&ways).filter(|(_, ways)| !ways.is_empty());
        heated.flat_map_iter(|(part, ways)| solve(part, ways)).collect()
    }

    fn beside_each_other<const LANES: usize>(
        &self,
        (rows, system): &(Range<usize>, System),
        ways: &[Way],
    ) -> Vec<Solved> {
        let mut right = vec![[0.0; LANES]; rows.len()];
        for (k, way) in ways.iter().enumerate().filter(|(_, way)| way.evenly(rows.len()).is_none()) {
            way.heated.iter().for_each(|&(row, share)| right[row - rows.start][k] = self.heat[row] * share);
        }
        let x = system.solve(right);
        let solved = |(k, way): (usize, &Way)| {
            let heat = match way.evenly(rows.len()) {
                // All heated alike is as hot everywhere.
                Some(share) => vec![share; rows.len()],
                None => x.iter().map(|x| x[k]).collect(),
            };
            Solved { number: way.number, rows: rows.clone(), heat }
        };
        ways.iter().enumerate().map(solved).collect()
    }

    /// Of each row the bones with most heat, the hottest first, with `u32::MAX` in places that none takes: each bone in
    /// turn heats the vertices that it is nearest to, and those that several are equally near to in part. `near`: of each
    /// vertex the nearest bones, numbers below `bones`.
    pub fn hottest(&self, near: &[Vec<u32>], bones: usize) -> Vec<[(f32, u32); HOTTEST]> {
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
            let solved = self.by_parts(&own);
            for part in solved.chunk_by(|a, b| a.rows == b.rows) {
                best[part[0].rows.clone()].par_iter_mut().enumerate().for_each(|(row, best)| {
                    for way in part {
                        let new = way.heat[row] as f32;
                        if new > best[HOTTEST - 1].0 {
                            let at = best.partition_point(|old| old.0 >= new);
                            best[at..].rotate_right(1);
                            best[at] = (new, some[way.number] as u32);
                        }
                    }
                });
            }
        }
        best
    }
}

impl Way<'_> {
    /// The share of all rows of a part of so many, where all have the same.
    fn evenly(&self, rows: usize) -> Option<f64> {
        let share = self.heated[0].1;
        (self.heated.len() == rows && self.heated.iter().all(|own| own.1 == share)).then_some(share)
    }
}

/// Gives rows new numbers so that those which heat flows between are beside each other, otherwise as they were; says the
/// rows of each such part.
fn order_by_parts(
    place: &mut [usize],
    speakers: &mut Vec<usize>,
    edges: &mut [(u32, u32, f64)],
    area: &mut Vec<f64>,
) -> Vec<Range<usize>> {
    let mut groups = Groups::new(speakers.len());
    edges.iter().for_each(|&(a, b, _)| _ = groups.join(a, b));
    let roots: Vec<u32> = (0..speakers.len() as u32).map(|row| groups.root(row)).collect();
    let mut order: Vec<usize> = (0..speakers.len()).collect();
    order.sort_by_key(|&row| roots[row]);
    let mut parts = Vec::new();
    for part in order.chunk_by(|&a, &b| roots[a] == roots[b]) {
        let start = parts.last().map_or(0, |rows: &Range<usize>| rows.end);
        parts.push(start..start + part.len());
    }
    if parts.len() > 1 {
        let mut number = vec![0; order.len()];
        order.iter().enumerate().for_each(|(new, &old)| number[old] = new);
        place.iter_mut().for_each(|row| *row = number[*row]);
        edges.iter_mut().for_each(|e| (e.0, e.1) = (number[e.0 as usize] as u32, number[e.1 as usize] as u32));
        *speakers = order.iter().map(|&old| speakers[old]).collect();
        *area = order.iter().map(|&old| area[old]).collect();
    }
    parts
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

    fn wide(mesh: &Mesh, v: u32) -> [f64; 3] {
        mesh.positions()[v as usize].map(f64::from)
    }

    #[test]
    fn the_system_is_solved() {
        let mesh = tube(20, false);
        let distance: Vec<f64> = (0..mesh.positions().len()).map(|v| 1.0 + 0.01 * v as f64).collect();
        let surface = SurfaceHeat::new(&mesh, &distance);
        let heated: Vec<(usize, f64)> = (0..50).map(|row| (row, 1.0)).collect();
        let all: Vec<(usize, f64)> = (0..mesh.positions().len()).map(|row| (row, 1.0)).collect();
        let [x, even] = surface.solve(&[heated, all]).try_into().unwrap();
        // What a vertex has and its neighbours have not flows to them, and what heats it makes up for that.
        let mut back: Vec<f64> = surface.heat.iter().zip(&x).map(|(heat, x)| heat * x).collect();
        for t in mesh.triangles() {
            for k in 0..3 {
                let [i, j, o] = [0, 1, 2].map(|m| t[(k + m) % 3]);
                let [a, b] = [i, j].map(|v| minus(wide(&mesh, v), wide(&mesh, o)));
                let w = 0.5 * (dot(a, b) / length(cross(a, b))).max(0.0);
                let [i, j] = [i, j].map(|v| surface.rows()[v as usize]);
                back[i] += w * (x[i] - x[j]);
                back[j] += w * (x[j] - x[i]);
            }
        }
        for (row, b) in back.iter().enumerate() {
            let want = if row < 50 { surface.heat[row] } else { 0.0 };
            assert!((b - want).abs() < 1e-9 * surface.heat[row].max(1.0), "row {row}: {b}, expected {want}");
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
        let alone: Vec<Vec<f64>> =
            heated.iter().map(|own| surface.solve(std::slice::from_ref(own)).remove(0)).collect();
        let [part] = &surface.parts[..] else { panic!("a tube hangs together") };
        let ways: Vec<Way> =
            (0..11).filter(|&k| !heated[k].is_empty()).map(|k| Way { number: k, heated: &heated[k] }).collect();
        let beside = |lanes: usize| {
            let mut out = vec![vec![0.0; n]; heated.len()];
            for ways in ways.chunks(lanes) {
                let solved = match lanes {
                    4 => surface.beside_each_other::<4>(part, ways),
                    _ => surface.beside_each_other::<8>(part, ways),
                };
                solved.into_iter().for_each(|own| out[own.number] = own.heat);
            }
            out
        };
        for together in [beside(4), beside(8), surface.solve(&heated)] {
            assert_eq!(together.len(), heated.len());
            for (bone, (alone, own)) in alone.iter().zip(&together).enumerate() {
                assert!(alone.iter().zip(own).all(|(a, b)| a.to_bits() == b.to_bits()), "bone {bone}");
                assert!(bone == 5 || own.iter().all(|x| x.is_finite()));
            }
        }
    }

    #[test]
    fn parts_that_heat_cannot_leave_are_solved_as_if_each_were_a_mesh() {
        // A tube and one four times as large, whose rings take turns in the list of vertices, with lone vertices between them.
        let one = tube(6, false);
        let n = one.positions().len();
        let at = |tube: usize, v: usize| tube * 8 + v / 8 * 17 + v % 8;
        let mut positions = vec![[9.0; 3]; at(1, n - 1) + 1];
        for (v, p) in one.positions().iter().enumerate() {
            (positions[at(0, v)], positions[at(1, v)]) = (*p, p.map(|x| 4.0 * x));
        }
        (0..6).for_each(|r| positions[at(1, 8 * r + 7) + 1] = [99.0 + r as f32; 3]);
        let of = |tube: usize| one.triangles().iter().map(move |t| t.map(|v| at(tube, v as usize) as u32));
        let two = Mesh::new(positions, of(0).chain(of(1)).collect()).unwrap();
        let distance = |v: usize| 0.2 + 0.01 * v as f64;
        let alone = SurfaceHeat::new(&one, &(0..n).map(distance).collect::<Vec<_>>());
        let mut apart = vec![1.0; two.positions().len()];
        (0..n).for_each(|v| (apart[at(0, v)], apart[at(1, v)]) = (distance(v), 4.0 * distance(v)));
        let both = SurfaceHeat::new(&two, &apart);
        assert_eq!(both.parts.len(), 8, "two tubes and six lone vertices");
        for (row, &v) in both.speakers().iter().enumerate() {
            assert_eq!(both.rows()[v], row);
        }
        // The first ring of the one, the last two of the other, all of the first tube in half, and of both but one vertex.
        let rings = |rows: Range<usize>, share: f64| rows.map(|v| (v, share)).collect::<Vec<_>>();
        let own = [rings(0..8, 1.0), rings(n - 16..n, 1.0), rings(0..n, 0.5), rings(0..n - 1, 1.0)];
        let mut heated: Vec<Vec<(usize, f64)>> = vec![Vec::new(); 4];
        for (bone, tubes) in [(0, 0..1), (1, 1..2), (2, 0..1), (3, 0..2)] {
            for tube in tubes {
                heated[bone].extend(own[bone].iter().map(|&(v, share)| (both.rows()[at(tube, v)], share)));
            }
            heated[bone].sort_by_key(|(row, _)| *row);
        }
        let (alone, both_solved) = (alone.solve(&own), both.solve(&heated));
        for (bone, tubes) in [(0, [true, false]), (1, [false, true]), (2, [true, false]), (3, [true, true])] {
            for (tube, has) in tubes.into_iter().enumerate() {
                for (v, alone) in alone[bone].iter().enumerate() {
                    let want = if has { *alone } else { 0.0 };
                    assert_eq!(
                        both_solved[bone][both.rows()[at(tube, v)]].to_bits(),
                        want.to_bits(),
                        "{bone} {tube} {v}"
                    );
                }
            }
        }
        assert!(alone[2].iter().all(|x| *x == 0.5), "heated evenly");
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
        let found = surface.hottest(&near, 4);
        let row = |y: f32| &found[surface.rows()[mesh.positions().iter().position(|p| p[1] == y).unwrap()]];
        assert_eq!([row(1.0)[0].1, row(5.5)[0].1, row(9.5)[0].1], [0, 1, 2]);
        assert!((row(3.0)[0].0 - row(3.0)[1].0).abs() < 1e-3, "{:?}", row(3.0));
        for row in &found {
            assert!((row.iter().map(|(w, _)| w).sum::<f32>() - 1.0).abs() < 1e-4, "{row:?}");
            assert!(row.windows(2).all(|w| w[0].0 >= w[1].0) && row[3].1 == u32::MAX);
        }
    }
}
