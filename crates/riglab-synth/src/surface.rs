//! From polygons between cells to a closed manifold mesh on the zero set.
//!
//! Where two sheets of skin pass through one cell (between two fingers, at the crotch) a vertex per
//! cell would pinch them together. Here polygons are joined side to side first, and each closed fan
//! of polygons around a cell becomes a vertex of its own. Every side is then shared by exactly two
//! polygons, by construction.

use std::collections::HashSet;

use glam::Vec3;

use crate::cells::Cells;
use crate::field::{Field, Scratch};
use crate::net::Polygon;

/// A mesh of the skin: closed and manifold, triangles counterclockwise from outside.
#[derive(Clone, Debug, Default)]
pub(crate) struct Surface {
    pub positions: Vec<Vec3>,
    pub triangles: Vec<[u32; 3]>,
    /// The parts that matter near each vertex.
    pub near: Vec<Vec<u16>>,
}

/// How often vertices are spread along the surface and put back onto it.
const SPREADS: usize = 4;

/// Components of fewer vertices are dropped.
const CRUMB: usize = 16;

impl Surface {
    /// The surface of a field whose cells made these polygons.
    pub fn new(field: &Field, cells: &Cells, polygons: &[Polygon]) -> Self {
        let mut fans = Fans::new(polygons);
        let mut surface = fans.vertices(cells, polygons);
        let faces = fans.faces(polygons, &mut surface);
        surface.spread(field, &faces);
        surface.triangulate(&faces);
        surface.without_crumbs()
    }

    /// Evens out vertices along the surface and puts them onto it.
    fn spread(&mut self, field: &Field, faces: &[Vec<u32>]) {
        let n = self.positions.len();
        let mut scratch = Scratch::new();
        let mut normals = vec![Vec3::Y; n];
        for round in 0..=SPREADS {
            for (normal, (p, near)) in normals.iter_mut().zip(self.positions.iter_mut().zip(&self.near)) {
                *normal = project(field, p, near, &mut scratch);
            }
            if round == SPREADS {
                break;
            }
            let mut sums = vec![(Vec3::ZERO, 0.0f32); n];
            for face in faces {
                for (k, &v) in face.iter().enumerate() {
                    let after = face[(k + 1) % face.len()];
                    // Each edge is met from both its faces, once in each direction.
                    let (sum, count) = &mut sums[v as usize];
                    *sum += self.positions[after as usize];
                    *count += 1.0;
                }
            }
            for v in 0..n {
                let shift = sums[v].0 / sums[v].1 - self.positions[v];
                self.positions[v] += 0.6 * (shift - normals[v] * normals[v].dot(shift));
            }
        }
    }

    fn triangulate(&mut self, faces: &[Vec<u32>]) {
        let mut edges: HashSet<(u32, u32)> = HashSet::new();
        for face in faces {
            for (k, &v) in face.iter().enumerate() {
                edges.insert(ordered(v, face[(k + 1) % face.len()]));
            }
        }
        for face in faces {
            match face[..] {
                [a, b, c] => self.triangles.push([a, b, c]),
                [a, b, c, d] => {
                    let free = [ordered(a, c), ordered(b, d)].map(|diagonal| !edges.contains(&diagonal));
                    let length =
                        |v: u32, w: u32| self.positions[v as usize].distance_squared(self.positions[w as usize]);
                    let first = length(a, c) <= length(b, d);
                    // A diagonal that is an edge elsewhere would be shared by four triangles.
                    match free {
                        [true, other] if first || !other => {
                            edges.insert(ordered(a, c));
                            self.triangles.extend([[a, b, c], [a, c, d]]);
                        }
                        [_, true] => {
                            edges.insert(ordered(b, d));
                            self.triangles.extend([[a, b, d], [b, c, d]]);
                        }
                        _ => self.fan(face),
                    }
                }
                _ => self.fan(face),
            }
        }
    }

    /// Triangles around a new vertex in a face's middle.
    fn fan(&mut self, face: &[u32]) {
        let middle = self.positions.len() as u32;
        let sum: Vec3 = face.iter().map(|&v| self.positions[v as usize]).sum();
        self.positions.push(sum / face.len() as f32);
        self.near.push(self.near[face[0] as usize].clone());
        for (k, &v) in face.iter().enumerate() {
            self.triangles.push([v, face[(k + 1) % face.len()], middle]);
        }
    }

    /// Drops components that are crumbs: where a part gets thinner than a cell its tip can come off.
    fn without_crumbs(self) -> Self {
        let component = components(self.positions.len(), &self.triangles);
        let mut sizes = vec![0usize; self.positions.len()];
        for &root in &component {
            sizes[root as usize] += 1;
        }
        let largest = sizes.iter().copied().max().unwrap_or(0);
        let keep = |v: usize| sizes[component[v] as usize] >= CRUMB.min(largest);
        let mut moved = vec![u32::MAX; self.positions.len()];
        let mut out = Self::default();
        for (v, moved) in moved.iter_mut().enumerate() {
            if keep(v) {
                *moved = out.positions.len() as u32;
                out.positions.push(self.positions[v]);
                out.near.push(self.near[v].clone());
            }
        }
        let kept = self.triangles.iter().filter(|t| keep(t[0] as usize));
        out.triangles = kept.map(|t| t.map(|v| moved[v as usize])).collect();
        out
    }
}

/// Walks a point onto the zero set; gives the normal there.
fn project(field: &Field, p: &mut Vec3, near: &[u16], scratch: &mut Scratch) -> Vec3 {
    let mut normal = Vec3::Y;
    for _ in 0..3 {
        let here = field.sample(*p, near, scratch);
        normal = here.gradient;
        if here.d.abs() < 1e-6 {
            break;
        }
        *p -= here.gradient * here.d;
    }
    normal
}

/// For each vertex the smallest vertex it is connected to.
pub(crate) fn components(vertices: usize, triangles: &[[u32; 3]]) -> Vec<u32> {
    let mut sets = Sets::new(vertices);
    for t in triangles {
        sets.join(t[0], t[1]);
        sets.join(t[0], t[2]);
    }
    (0..vertices as u32).map(|v| sets.root(v)).collect()
}

fn ordered(a: u32, b: u32) -> (u32, u32) {
    (a.min(b), a.max(b))
}

/// Which polygon corners are one vertex.
struct Fans {
    /// Corner `4 * polygon + k`, in sets that are one vertex each.
    sets: Sets,
    /// The vertex of each set's root.
    vertex: Vec<u32>,
    /// Pairs of sides, each given by its first corner.
    pairs: Vec<[u32; 2]>,
}

impl Fans {
    fn new(polygons: &[Polygon]) -> Self {
        let mut sides: Vec<(CellPair, bool, u32)> = Vec::with_capacity(4 * polygons.len());
        for (q, polygon) in polygons.iter().enumerate() {
            for k in 0..polygon.sides() {
                let (a, b) = (polygon.cells[k], polygon.cells[(k + 1) % polygon.sides()]);
                sides.push(((a.min(b), a.max(b)), a < b, (4 * q + k) as u32));
            }
        }
        sides.sort_unstable();
        let mut fans = Self { sets: Sets::new(4 * polygons.len()), vertex: Vec::new(), pairs: Vec::new() };
        for same in sides.chunk_by(|a, b| a.0 == b.0) {
            // One half of the sides runs each way, since outwards is on the left of each.
            let (against, along): (Vec<_>, Vec<_>) = same.iter().map(|s| (s.1, s.2)).partition(|s| !s.0);
            assert_eq!(along.len(), against.len(), "the surface has no border");
            let mut against: Vec<u32> = against.into_iter().map(|s| s.1).collect();
            for (_, side) in along {
                // Of several, the one around the same inside corner: sheets stay apart.
                let inside = |s: u32| polygons[s as usize / 4].inside;
                let k = against.iter().position(|&s| inside(s) == inside(side)).unwrap_or(0);
                fans.pair(polygons, side, against.remove(k));
            }
        }
        fans
    }

    fn pair(&mut self, polygons: &[Polygon], side: u32, other: u32) {
        let next = |s: u32| s / 4 * 4 + (s % 4 + 1) % polygons[s as usize / 4].sides() as u32;
        self.sets.join(side, next(other));
        self.sets.join(next(side), other);
        self.pairs.push([side, other]);
    }

    /// One vertex a fan, at the mean of the crossings of its polygons.
    fn vertices(&mut self, cells: &Cells, polygons: &[Polygon]) -> Surface {
        self.vertex = vec![u32::MAX; 4 * polygons.len()];
        let mut surface = Surface::default();
        let mut counts: Vec<f32> = Vec::new();
        for (q, polygon) in polygons.iter().enumerate() {
            for k in 0..polygon.sides() {
                let root = self.sets.root((4 * q + k) as u32) as usize;
                if self.vertex[root] == u32::MAX {
                    self.vertex[root] = surface.positions.len() as u32;
                    surface.positions.push(Vec3::ZERO);
                    surface.near.push(cells.near(polygon.cells[k]).to_vec());
                    counts.push(0.0);
                }
                let v = self.vertex[root] as usize;
                surface.positions[v] += polygon.crossing;
                counts[v] += 1.0;
            }
        }
        surface.positions.iter_mut().zip(&counts).for_each(|(p, n)| *p /= *n);
        surface
    }

    /// The polygons by vertex numbers. Two pairs of sides may still run between the same two
    /// vertices; all pairs but the first then get a vertex in their middle.
    fn faces(&mut self, polygons: &[Polygon], surface: &mut Surface) -> Vec<Vec<u32>> {
        let corner: Vec<u32> =
            (0..4 * polygons.len() as u32).map(|c| self.vertex[self.sets.root(c) as usize]).collect();
        let next = |s: u32| (s / 4 * 4 + (s % 4 + 1) % polygons[s as usize / 4].sides() as u32) as usize;
        let mut taken: HashSet<(u32, u32)> = HashSet::with_capacity(self.pairs.len());
        let mut middle: Vec<(u32, u32)> = Vec::new();
        for &[side, other] in &self.pairs {
            let (a, b) = (corner[side as usize], corner[next(side)]);
            if !taken.insert(ordered(a, b)) {
                let m = surface.positions.len() as u32;
                surface.positions.push(0.5 * (surface.positions[a as usize] + surface.positions[b as usize]));
                surface.near.push(surface.near[a as usize].clone());
                middle.extend([(side, m), (other, m)]);
            }
        }
        middle.sort_unstable();
        let mut middle = middle.into_iter().peekable();
        let mut faces = Vec::with_capacity(polygons.len());
        for (q, polygon) in polygons.iter().enumerate() {
            let mut face = Vec::with_capacity(polygon.sides());
            for side in (4 * q as u32..).take(polygon.sides()) {
                face.push(corner[side as usize]);
                while let Some((_, m)) = middle.next_if(|(s, _)| *s == side) {
                    face.push(m);
                }
            }
            faces.push(face);
        }
        faces
    }
}

type CellPair = (u32, u32);

/// Disjoint sets of numbers; the smallest of a set stands for it.
struct Sets(Vec<u32>);

impl Sets {
    fn new(n: usize) -> Self {
        Self((0..n as u32).collect())
    }

    fn root(&mut self, mut x: u32) -> u32 {
        while self.0[x as usize] != x {
            self.0[x as usize] = self.0[self.0[x as usize] as usize];
            x = self.0[x as usize];
        }
        x
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b) as usize] = a.min(b);
    }
}
