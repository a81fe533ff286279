//! Weights by distances along edges of a graph, as UniRig's and SkinTokens' public code has them.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use glam::DVec3;
use rayon::prelude::*;
use riglab_core::{Mesh, Skeleton};

use crate::voxel::Voxels;

/// How distances become weights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kernel {
    /// (1 / ((1 - α) d + α d²))².
    Square {
        /// α.
        alpha: f64,
    },
    /// exp(-20 d / largest d).
    Exp,
}

/// The graph's form.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VoxelSkinConfig {
    /// Cells whose middles are nearer than this are joined, and cells with vertices; in edges of a cell.
    pub reach: f64,
    /// At most so many vertices a cell, the nearest.
    pub vertices_per_cell: usize,
    /// What a way between cells costs, in lengths; one between a cell and a vertex costs its length.
    pub cell_cost: f64,
    /// Vertices that are apart, but not as far as this, are joined; in units of the mesh.
    pub link: f64,
    /// Whether a joint with one child counts from all of its bone: from 11 points at equal steps, both ends among
    /// them.
    pub bones: bool,
    /// How distances become weights.
    pub kernel: Kernel,
}

impl VoxelSkinConfig {
    /// UniRig as released.
    pub fn unirig() -> Self {
        Self {
            reach: 1.001,
            vertices_per_cell: 1,
            cell_cost: 3.0,
            link: 1.001e-5,
            bones: false,
            kernel: Kernel::Square { alpha: 0.5 },
        }
    }

    /// SkinTokens' post-processing: cells are joined across edges and corners, too.
    pub fn skintokens() -> Self {
        Self { reach: 1.74, vertices_per_cell: 27, link: 1e-5, ..Self::unirig() }
    }
}

/// Distances and weights of vertices.
#[derive(Clone, Debug, PartialEq)]
pub struct VoxelSkin {
    /// J × N; infinite where there is no way.
    pub distances: Vec<f64>,
    /// N × J, rows of sum 1. A vertex that no joint reaches has the straight distances to the three nearest of
    /// the points that joints count from instead, what else has no way counts as far as the farthest.
    pub weights: Vec<f64>,
}

/// Distances from joints to vertices over edges of the mesh and between cells, and the weights they give.
///
/// The way from a joint to the node of the graph nearest to it, the last of equally near ones, costs nothing.
/// Mesh and skeleton are in the frame of the voxels; goldens have them in [-1, 1]³.
pub fn voxel_skin(mesh: &Mesh, skeleton: &Skeleton, voxels: &Voxels, config: &VoxelSkinConfig) -> VoxelSkin {
    let graph = Graph::new(mesh, voxels, config);
    let joints: Vec<_> = skeleton.ids().collect();
    let sources: Vec<Vec<DVec3>> = joints.iter().map(|j| sources(skeleton, *j, config.bones)).collect();
    let (rows, farthest): (Vec<Vec<f64>>, Vec<f64>) = sources.par_iter().map(|points| graph.nearest_of(points)).unzip();
    let farthest = farthest.into_iter().fold(0.0, f64::max);
    let weights = weights(&rows, &graph.nodes[..mesh.positions().len()], &sources, farthest, config.kernel);
    VoxelSkin { distances: rows.concat(), weights }
}

fn sources(skeleton: &Skeleton, joint: riglab_core::JointId, bones: bool) -> Vec<DVec3> {
    let point = |j| DVec3::from(skeleton.head(j).map(f64::from));
    let head = point(joint);
    let mut children = skeleton.ids().filter(|c| skeleton.parent(*c) == Some(joint));
    match (bones, children.next(), children.next()) {
        (true, Some(child), None) => {
            let along = point(child) - head;
            (0..=10).map(|k| head + along * (f64::from(k) / 10.0)).collect()
        }
        _ => vec![head],
    }
}

fn weights(
    rows: &[Vec<f64>],
    vertices: &[DVec3],
    sources: &[Vec<DVec3>],
    mut farthest: f64,
    kernel: Kernel,
) -> Vec<f64> {
    let joints = rows.len();
    let mut d: Vec<f64> = (0..vertices.len()).flat_map(|v| rows.iter().map(move |row| row[v])).collect();
    let points = || sources.iter().enumerate().flat_map(|(j, points)| points.iter().map(move |p| (j, p)));
    for (row, p) in d.chunks_exact_mut(joints).zip(vertices) {
        if row.iter().all(|d| d.is_infinite()) {
            let mut near: Vec<(f64, usize)> = points().map(|(j, point)| (point.distance(*p), j)).collect();
            near.sort_by(|a, b| a.0.total_cmp(&b.0));
            // No more points than joints, be it several of one bone.
            for (d, j) in near.into_iter().take(joints.min(3)) {
                row[j] = row[j].min(d);
                farthest = farthest.max(d);
            }
        }
    }
    let share = |d: f64| {
        let d = if d.is_finite() { d } else { farthest }.max(1e-6);
        match kernel {
            Kernel::Square { alpha } => (1.0 / ((1.0 - alpha) * d + alpha * d * d)).powi(2),
            Kernel::Exp => (-20.0 * d / farthest.max(1e-6)).exp(),
        }
    };
    d.iter_mut().for_each(|d| *d = share(*d));
    for row in d.chunks_exact_mut(joints) {
        let sum: f64 = row.iter().sum();
        row.iter_mut().for_each(|w| *w /= sum);
    }
    d
}

/// Vertices, then cells, and the ways between them.
struct Graph {
    nodes: Vec<DVec3>,
    starts: Vec<u32>,
    ways: Vec<(u32, f64)>,
    vertices: usize,
}

impl Graph {
    fn new(mesh: &Mesh, voxels: &Voxels, config: &VoxelSkinConfig) -> Self {
        let lattice = voxels.lattice();
        let vertices: Vec<DVec3> = mesh.positions().iter().map(|p| DVec3::from(p.map(f64::from))).collect();
        let n = vertices.len();
        let cells: Vec<[usize; 3]> = voxels.places().collect();
        let mut given: Vec<(u32, u32, f64)> = Vec::new();
        let mut join = |a: usize, b: usize, length: f64| given.push((a as u32, b as u32, length));
        for t in mesh.triangles() {
            for k in 0..3 {
                let [a, b] = [t[k] as usize, t[(k + 1) % 3] as usize];
                join(a, b, vertices[a].distance(vertices[b]));
            }
        }
        // Each pair of cells once: those with a larger number.
        let steps = (0..27).map(|s: isize| [s / 9 - 1, s / 3 % 3 - 1, s % 3 - 1]);
        let length = |s: &[isize; 3]| (s.iter().map(|x| x * x).sum::<isize>() as f64).sqrt();
        let steps: Vec<_> = steps.filter(|s| *s > [0; 3] && length(s) < config.reach).collect();
        let number: std::collections::HashMap<usize, usize> =
            cells.iter().enumerate().map(|(c, place)| (lattice.index(*place), c)).collect();
        for (c, place) in cells.iter().enumerate() {
            for step in &steps {
                let other: [isize; 3] = std::array::from_fn(|k| place[k] as isize + step[k]);
                if voxels.is_occupied(other) {
                    let other = number[&lattice.index(other.map(|x| x as usize))];
                    join(n + c, n + other, config.cell_cost * length(step) * lattice.cell);
                }
            }
        }
        let centers: Vec<DVec3> = cells.iter().map(|c| lattice.center(*c).into()).collect();
        let reach = config.reach * lattice.cell;
        let near = Near::new(&vertices, reach.max(config.link));
        for (c, center) in centers.iter().enumerate() {
            for (d, v) in near.within(*center, reach, config.vertices_per_cell) {
                join(n + c, v, d);
            }
        }
        for (v, p) in vertices.iter().enumerate() {
            // The first of four is itself, or another one at the same place.
            let links = near.within(*p, config.link, 4).into_iter().skip(1);
            links.filter(|(d, _)| *d > 0.0).for_each(|(d, other)| join(v, other, d));
        }
        let mut nodes = vertices;
        nodes.extend(centers);
        let edges = both_ways(given);
        let starts = (0..=nodes.len()).map(|k| edges.partition_point(|e| (e.0 as usize) < k) as u32).collect();
        Self { nodes, starts, ways: edges.into_iter().map(|(_, b, d)| (b, d)).collect(), vertices: n }
    }

    fn nearest(&self, p: DVec3) -> usize {
        let best = self.nodes.iter().enumerate().fold((f64::INFINITY, 0), |best, (k, q)| {
            let d = q.distance(p);
            if d <= best.0 + 1e-9 { (d.min(best.0), k) } else { best }
        });
        best.1
    }

    /// From the nearest of some points to each vertex, and the farthest that any of them is from a vertex that
    /// it reaches: points are searched from one by one for that.
    fn nearest_of(&self, points: &[DVec3]) -> (Vec<f64>, f64) {
        let mut best = vec![f64::INFINITY; self.vertices];
        let mut farthest = 0.0;
        for point in points {
            for (best, d) in best.iter_mut().zip(self.search(self.nearest(*point))) {
                *best = best.min(d);
                farthest = if d.is_finite() { d.max(farthest) } else { farthest };
            }
        }
        (best, farthest)
    }

    /// The shortest ways from a node to each vertex.
    fn search(&self, from: usize) -> Vec<f64> {
        let mut best = vec![f64::INFINITY; self.nodes.len()];
        best[from] = 0.0;
        let mut queue = BinaryHeap::from([Reverse((0, from as u32))]);
        // Lengths are not negative: their bits are in their order.
        while let Some(Reverse((bits, node))) = queue.pop() {
            let d = f64::from_bits(bits);
            if d > best[node as usize] {
                continue;
            }
            let span = self.starts[node as usize] as usize..self.starts[node as usize + 1] as usize;
            for &(other, length) in &self.ways[span] {
                if d + length < best[other as usize] {
                    best[other as usize] = d + length;
                    queue.push(Reverse(((d + length).to_bits(), other)));
                }
            }
        }
        best.truncate(self.vertices);
        best
    }
}

/// Ways by where they start. The lengths of one that is given several times in the same direction add up, as
/// in the sparse matrix of the public code: an edge whose triangles wind against each other costs twice. A way
/// may be gone in either direction; the shorter one counts.
fn both_ways(mut given: Vec<(u32, u32, f64)>) -> Vec<(u32, u32, f64)> {
    let ends = |way: &(u32, u32, f64)| (way.0, way.1);
    given.sort_by_key(ends);
    given.dedup_by(|again, first| {
        let same = ends(again) == ends(first);
        first.2 += if same { again.2 } else { 0.0 };
        same
    });
    let back: Vec<_> = given.iter().map(|&(a, b, length)| (b, a, length)).collect();
    given.extend(back);
    given.sort_by_key(ends);
    given
}

/// Points in boxes as large as what is asked for.
struct Near<'a> {
    points: &'a [DVec3],
    edge: f64,
    boxes: std::collections::HashMap<[i64; 3], Vec<u32>>,
}

impl<'a> Near<'a> {
    fn new(points: &'a [DVec3], edge: f64) -> Self {
        let mut boxes: std::collections::HashMap<[i64; 3], Vec<u32>> = std::collections::HashMap::new();
        for (k, p) in points.iter().enumerate() {
            boxes.entry(Self::place(*p, edge)).or_default().push(k as u32);
        }
        Self { points, edge, boxes }
    }

    fn place(p: DVec3, edge: f64) -> [i64; 3] {
        (p / edge).floor().to_array().map(|x| x as i64)
    }

    /// Up to `count` points nearer than `reach`, the nearest first; `reach` is at most a box's edge.
    fn within(&self, p: DVec3, reach: f64, count: usize) -> Vec<(f64, usize)> {
        let at = Self::place(p, self.edge);
        let mut found = Vec::new();
        for step in 0..27 {
            let step = [step / 9 - 1, step / 3 % 3 - 1, step % 3 - 1];
            let place = std::array::from_fn(|k| at[k].saturating_add(step[k]));
            for &k in self.boxes.get(&place).into_iter().flatten() {
                let d = self.points[k as usize].distance(p);
                if d < reach {
                    found.push((d, k as usize));
                }
            }
        }
        found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        found.truncate(count);
        found
    }
}

#[cfg(test)]
mod tests {
    use riglab_core::{Joint, JointId};

    use super::*;
    use crate::bodies::{cube, joined};
    use crate::voxel::{Lattice, shell};

    #[test]
    fn what_no_joint_reaches_goes_by_straight_distance() {
        let mesh = joined(&[cube([-0.7, 0.0, 0.0], 0.2), cube([0.7, 0.0, 0.0], 0.2)]);
        let heads = [[-0.7, 0.0, 0.0], [-0.6, 0.0, 0.0], [-0.6, 0.1, 0.0], [-0.9, 0.1, 0.0]];
        let joints = heads.iter().enumerate().map(|(j, head)| Joint {
            name: format!("{j}"),
            parent: (j > 0).then_some(JointId(0)),
            head: *head,
        });
        let skeleton = Skeleton::new(joints.collect()).unwrap();
        let lattice = Lattice { origin: [-1.0; 3], cell: 0.1, size: [20; 3] };
        let skin = voxel_skin(&mesh, &skeleton, &shell(&mesh, &lattice), &VoxelSkinConfig::unirig());
        assert!(skin.distances[..8].iter().all(|d| d.is_finite()));
        assert!(skin.distances[8..16].iter().all(|d| d.is_infinite()));
        for row in skin.weights.chunks_exact(4) {
            assert!((row.iter().sum::<f64>() - 1.0).abs() < 1e-12 && row.iter().all(|w| w.is_finite()));
        }
        let far = &skin.weights[8 * 4..9 * 4];
        assert!(far[1] > far[0] && far[0] > far[3], "{far:?}");
        // The points nearest to it are on the bone from the third joint to the fourth.
        let along = [[-0.9, 0.0, 0.0], [-0.9, 0.1, 0.0], [-0.9, 0.0, 0.0], [-0.5, 0.0, 0.0]];
        let joints = along.iter().zip([None, Some(0), Some(0), Some(2)]).map(|(head, parent)| Joint {
            name: format!("{head:?} {parent:?}"),
            parent: parent.map(JointId),
            head: *head,
        });
        let skeleton = Skeleton::new(joints.collect()).unwrap();
        let config = VoxelSkinConfig { bones: true, ..VoxelSkinConfig::unirig() };
        let skin = voxel_skin(&mesh, &skeleton, &shell(&mesh, &lattice), &config);
        let far = &skin.weights[8 * 4..9 * 4];
        assert!(far[2] == far[3] && far[0] == far[1] && far[2] > far[0], "{far:?}");
    }

    #[test]
    fn the_farthest_is_the_farthest_of_all_points_of_a_bone() {
        // A strip along x, a bone from one end to the other, and another half the way back.
        let places = (0..11).flat_map(|x| [[x as f32, 0.0, 0.0], [x as f32, 1e-3, 0.0]]);
        let triangles = (0..10).flat_map(|k| [[2 * k, 2 * k + 2, 2 * k + 1], [2 * k + 1, 2 * k + 2, 2 * k + 3]]);
        let mesh = Mesh::new(places.collect(), triangles.collect()).unwrap();
        let joint = |x: f32, parent: Option<u16>| Joint {
            name: format!("{x}"),
            parent: parent.map(JointId),
            head: [x, 0.0, 0.0],
        };
        let skeleton = Skeleton::new(vec![joint(0.0, None), joint(10.0, Some(0)), joint(5.0, Some(1))]).unwrap();
        let voxels = Voxels::new(Lattice { origin: [-1.0; 3], cell: 0.01, size: [2; 3] }, []);
        let config = VoxelSkinConfig { bones: true, kernel: Kernel::Exp, ..VoxelSkinConfig::skintokens() };
        let found = voxel_skin(&mesh, &skeleton, &voxels, &config).weights;
        // At x = 6 both bones are at hand and the leaf is 1 away: a tenth of what the first point is from the end.
        let (share, leaf) = ((-2.0f64).exp(), found[12 * 3 + 2]);
        assert!((leaf - share / (2.0 + share)).abs() < 1e-4, "{leaf}");
    }

    #[test]
    fn a_vertex_is_linked_to_three_near_ones() {
        // Triangles that have one corner each at these places along x, in too small a unit to be seen, and are
        // far from each other otherwise; the joint is at the first.
        let unit = 1e-6f32;
        let reached = |near: &[f32], config: VoxelSkinConfig| {
            let corners = near.iter().enumerate().flat_map(|(k, x)| {
                let y = 10.0 + k as f32;
                [[*x, 0.0, 0.0], [0.0, y, 1.0], [0.0, y, 2.0]]
            });
            let triangles = (0..near.len() as u32).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]);
            let mesh = Mesh::new(corners.collect(), triangles.collect()).unwrap();
            let skeleton = Skeleton::new(vec![Joint { name: "a".into(), parent: None, head: [0.0; 3] }]).unwrap();
            let voxels = Voxels::new(Lattice { origin: [-1.0; 3], cell: 0.01, size: [2; 3] }, []);
            let found = voxel_skin(&mesh, &skeleton, &voxels, &config).distances;
            (0..near.len()).map(|k| found[3 * k].is_finite()).collect::<Vec<_>>()
        };
        let released = [VoxelSkinConfig::unirig(), VoxelSkinConfig::skintokens()];
        // The fourth is the first one's third. Itself it is linked to the last two before that.
        let near = [0.0, 1.0, 2.0, -9.0, -11.0, -11.5].map(|x| x * unit);
        assert_eq!(released.map(|config| reached(&near, config)), [[true; 6]; 2]);
        let near = [0.0, 1.0, 2.0, 3.0, -9.0, -11.0, -11.5, -11.6].map(|x| x * unit);
        let first = [true, true, true, true, false, false, false, false];
        assert_eq!(released.map(|config| reached(&near, config)), [first; 2]);
        let limit = [0.0, 10.005 * unit];
        assert_eq!(released.map(|config| reached(&limit, config)), [[true, true], [true, false]]);
    }

    #[test]
    fn degenerate_input_gives_finite_rows() {
        let mesh = Mesh::new(vec![[0.0; 3]; 3], vec![[0, 1, 2]]).unwrap();
        let skeleton = Skeleton::new(vec![Joint { name: "a".into(), parent: None, head: [0.0; 3] }]).unwrap();
        let voxels = Voxels::new(Lattice::around(&mesh, 8), []);
        for config in [VoxelSkinConfig::unirig(), VoxelSkinConfig { kernel: Kernel::Exp, ..VoxelSkinConfig::unirig() }]
        {
            assert_eq!(voxel_skin(&mesh, &skeleton, &voxels, &config).weights, [1.0; 3]);
        }
    }
}
