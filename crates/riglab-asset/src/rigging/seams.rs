//! Vertices in one place: what a file splits where normals, texture coordinates or materials change, or into objects.

use std::collections::HashMap;

use riglab_core::{Bounds, Mesh, SkinWeights, Vec3};

use super::pieces::root;

/// What rounding may move a vertex by, as a share of the diagonal of the mesh's box: the transforms of the nodes that
/// hold two halves of a body, or a sine of 2π. Measured: up to 2e-7.
const ROUNDING: f32 = 1e-6;

/// How far the borders of two objects that are one surface may be apart, as a share of that diagonal: each object is
/// compressed in a box of its own. Measured for 14 bits a coordinate: up to 1.4e-5. On a person it is a fifth of a millimetre.
const BORDER: f32 = 1e-4;

/// And neither is more than this share of the shortest edge at either vertex: a box may be that of a wide floor, or of a stray
/// vertex far away.
const OF_EDGE: f32 = 0.02;

/// Places that are looked at in a cell of the grid. More are as near only where a box says nothing of the model.
const CROWD: usize = 32;

/// For each vertex the first one in the same place, which may be itself.
///
/// Equal bit for bit, but that 0 and -0 are one: a seam is made by copying, and near vertices may be two lips.
pub fn twins(positions: &[Vec3]) -> Vec<u32> {
    let key = |v: u32| positions[v as usize].map(|x| (x + 0.0).to_bits());
    let mut order: Vec<u32> = (0..positions.len() as u32).collect();
    order.sort_unstable_by_key(|&v| (key(v), v));
    let mut first = vec![0; positions.len()];
    let mut current = 0;
    for (at, &v) in order.iter().enumerate() {
        if at == 0 || key(v) != key(current) {
            current = v;
        }
        first[v as usize] = current;
    }
    first
}

/// As [`twins`], but that vertices count as in one place, too, if rounding may have put them apart, or if they are on open
/// borders of two of the sets that the mesh was put together from (`sets` says of which each vertex is) and nearly touch.
///
/// Within a surface, and between borders of one set, what is apart stays so: it may be two lips.
pub(super) fn welded(mesh: &Mesh, sets: &[u32]) -> Vec<u32> {
    let positions = mesh.positions();
    let exact = twins(positions);
    let diagonal = Bounds::of(positions.iter().copied()).map_or(0.0, |bounds| glam::Vec3::from(bounds.size()).length());
    if !(diagonal > 0.0 && diagonal.is_finite()) {
        return exact;
    }
    let places: Vec<u32> = (0u32..).zip(&exact).filter(|(v, first)| v == *first).map(|(v, _)| v).collect();
    let edges = shortest_edges(mesh, &exact);
    let apart = |a: u32, b: u32| {
        let between = |v: u32| glam::Vec3::from(positions[v as usize]);
        let apart = between(a).distance(between(b));
        (apart <= OF_EDGE * edges[a as usize].min(edges[b as usize])).then_some(apart)
    };
    let mut groups = exact;
    join(&mut groups, positions, &places, ROUNDING * diagonal, apart);
    if sets.len() == positions.len() && sets.iter().any(|set| *set != sets[0]) {
        let border = border(mesh, &mut groups);
        let of_two = |a: u32, b: u32| (sets[a as usize] != sets[b as usize]).then(|| apart(a, b)).flatten();
        join(&mut groups, positions, &border, BORDER * diagonal, of_two);
    }
    (0..positions.len() as u32).map(|v| root(&mut groups, v)).collect()
}

/// The shortest edge that is one at each place, by the first vertex there; infinite where there is none.
fn shortest_edges(mesh: &Mesh, first: &[u32]) -> Vec<f32> {
    let mut shortest = vec![f32::INFINITY; first.len()];
    for &[a, b, c] in mesh.triangles() {
        for (a, b) in [(a, b), (b, c), (c, a)] {
            let (from, to) = (glam::Vec3::from(mesh.positions()[a as usize]), mesh.positions()[b as usize].into());
            let length = from.distance(to);
            for v in [a, b].into_iter().filter(|_| length > 0.0) {
                let least = &mut shortest[first[v as usize] as usize];
                *least = least.min(length);
            }
        }
    }
    shortest
}

/// Vertices, one a place, at the ends of edges that a single triangle has.
fn border(mesh: &Mesh, groups: &mut [u32]) -> Vec<u32> {
    let mut edges: Vec<[u32; 2]> = Vec::with_capacity(3 * mesh.triangles().len());
    for triangle in mesh.triangles() {
        let [a, b, c] = triangle.map(|v| root(groups, v));
        edges.extend([[a, b], [b, c], [c, a]].map(|[a, b]| [a.min(b), a.max(b)]));
    }
    edges.sort_unstable();
    let single = edges.chunk_by(|a, b| a == b).filter(|same| same.len() == 1).flat_map(|same| same[0]);
    let mut vertices: Vec<u32> = single.collect();
    vertices.sort_unstable();
    vertices.dedup();
    vertices
}

/// Joins each of `vertices` with the nearest one before it that lies within `reach`; `apart` says how far two are, and nothing
/// of two that stay apart.
fn join(groups: &mut [u32], positions: &[Vec3], vertices: &[u32], reach: f32, apart: impl Fn(u32, u32) -> Option<f32>) {
    // Wide, so that most vertices look into one cell.
    let (reach_wide, side) = (f64::from(reach), 8.0 * f64::from(reach));
    let cell = |p: [f64; 3]| p.map(|x| (x / side).floor() as i64);
    let mut cells: HashMap<[i64; 3], Vec<u32>> = HashMap::with_capacity(vertices.len());
    for &v in vertices {
        let at = positions[v as usize].map(f64::from);
        let [low, high] = [-reach_wide, reach_wide].map(|by| cell(at.map(|x| x + by)));
        let range = |k: usize| low[k]..=high[k];
        let near = range(0).flat_map(|x| range(1).flat_map(move |y| range(2).map(move |z| [x, y, z])));
        let others = near.filter_map(|cell| cells.get(&cell)).flatten();
        let within = others.filter_map(|&other| Some((apart(v, other).filter(|d| *d <= reach)?, other)));
        if let Some((_, other)) = within.min_by(|a, b| a.0.total_cmp(&b.0)) {
            let (a, b) = (root(groups, v), root(groups, other));
            groups[a.max(b) as usize] = a.min(b);
        }
        let own = cells.entry(cell(at)).or_default();
        if own.len() < CROWD {
            own.push(v);
        }
    }
}

/// The same weights, but that vertices in one place have the mean of theirs, so that no seam opens when the
/// skeleton moves. Rows of vertices that are alone stay bit for bit; so do all where `twins` is of another mesh.
pub fn agreed(weights: &SkinWeights, twins: &[u32]) -> SkinWeights {
    if weights.rows() != twins.len() {
        return weights.clone();
    }
    let mut members: Vec<(u32, u32)> = twins.iter().zip(0u32..).map(|(&first, v)| (first, v)).collect();
    members.sort_unstable();
    let mut rows: Vec<Option<Vec<(u16, f32)>>> = vec![None; twins.len()];
    for group in members.chunk_by(|a, b| a.0 == b.0).filter(|group| group.len() > 1) {
        let own = |v: u32| weights.row(v as usize).map(|(joint, weight)| (joint.0, weight));
        if group.iter().all(|&(_, v)| own(v).eq(own(group[0].1))) {
            continue;
        }
        let mut all: Vec<(u16, f32)> = group.iter().flat_map(|&(_, v)| own(v)).collect();
        // Stable, so that sums are made in one order.
        all.sort_by_key(|(joint, _)| *joint);
        let total: f64 = all.iter().map(|(_, w)| f64::from(*w)).sum();
        let mean = all.chunk_by(|a, b| a.0 == b.0).map(|same| {
            let sum: f64 = same.iter().map(|(_, w)| f64::from(*w)).sum();
            (same[0].0, (sum / total) as f32)
        });
        let mean: Vec<(u16, f32)> = mean.collect();
        group.iter().for_each(|&(_, v)| rows[v as usize] = Some(mean.clone()));
    }
    let (mut offsets, mut joints, mut values) = (vec![0u32], Vec::new(), Vec::new());
    for (v, row) in rows.into_iter().enumerate() {
        let row = row.unwrap_or_else(|| weights.row(v).map(|(joint, weight)| (joint.0, weight)).collect());
        joints.extend(row.iter().map(|(joint, _)| *joint));
        values.extend(row.iter().map(|(_, weight)| *weight));
        offsets.push(joints.len() as u32);
    }
    SkinWeights::new(offsets, joints, values).unwrap_or_else(|_| weights.clone())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn copies_find_their_first_and_agree() {
        let at = [[0.0, 1.0, 0.0], [2.0, 0.0, 0.0], [-0.0, 1.0, 0.0], [2.0, 0.0, 1e-20]];
        let twins = twins(&at);
        assert_eq!(twins, [0, 1, 0, 3]);
        let rows = [vec![(0, 1.0)], vec![(1, 1.0)], vec![(0, 0.5), (2, 0.5)], vec![(2, 1.0)]];
        let agreed = agreed(&SkinWeights::normalized(rows).unwrap(), &twins);
        let row = |v| agreed.row(v).map(|(j, w)| (j.0, w)).collect::<Vec<_>>();
        assert_eq!([row(0), row(1), row(3)], [vec![(0, 0.75), (2, 0.25)], vec![(1, 1.0)], vec![(2, 1.0)]]);
        assert_eq!(row(0), row(2));
    }

    #[test]
    fn no_vertices_have_no_twins() {
        assert!(twins(&[]).is_empty());
    }

    /// Two strips of two triangles, the second one's left border `apart` from the first one's right one, of a box as wide as
    /// 2 and 1 high.
    fn strips(apart: f32) -> Mesh {
        let left = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];
        let right = left.map(|[x, y, z]| [x + 1.0 + apart, y, z]);
        let triangles = vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]];
        Mesh::new([left, right].concat(), triangles).unwrap()
    }

    const APART: [u32; 8] = [0, 1, 2, 3, 4, 5, 6, 7];
    const TOGETHER: [u32; 8] = [0, 1, 2, 3, 1, 5, 6, 2];

    #[test]
    fn what_rounding_put_apart_is_one_place() {
        for (apart, wanted) in [(0.0, TOGETHER), (1e-6, TOGETHER), (1e-5, APART)] {
            assert_eq!(welded(&strips(apart), &[0; 8]), wanted, "{apart}");
            // Far from the origin, and seen in kilometres.
            let far = strips(apart).positions().iter().map(|p| p.map(|x| 1000.0 * x)).collect();
            assert_eq!(welded(&strips(apart).with_positions(far).unwrap(), &[0; 8]), wanted, "{apart}");
        }
    }

    #[test]
    fn a_stray_vertex_far_away_welds_nothing() {
        let mesh = strips(0.05);
        let wide = [mesh.positions(), &[[1e6, 0.0, 0.0], [1e6, 1.0, 0.0], [1e6, 0.0, 1.0]]].concat();
        let triangles = [mesh.triangles(), &[[8, 9, 10]]].concat();
        let wide = Mesh::new(wide, triangles).unwrap();
        let alone: Vec<u32> = (0..11).collect();
        assert_eq!(welded(&wide, &[0; 11]), twins(wide.positions()));
        assert_eq!(welded(&wide, &[0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 1])[8..], alone[8..]);
        // As many as a cell has room for, and more.
        let many: Vec<Vec3> = (0..9999u32).map(|k| [f32::from(k as u16) * 1e-4, (k % 3) as f32, 0.0]).collect();
        let triangles = (0..3333).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
        let wide = Mesh::new([&many[..], &[[1e7, 0.0, 0.0]]].concat(), triangles).unwrap();
        assert_eq!(welded(&wide, &[0; 10_000]).len(), 10_000);
    }

    #[test]
    fn borders_of_two_objects_that_nearly_touch_are_one_place() {
        let sets = [0, 0, 0, 0, 1, 1, 1, 1];
        for (apart, wanted) in [(1e-5, TOGETHER), (1e-4, TOGETHER), (1e-3, APART)] {
            assert_eq!(welded(&strips(apart), &sets), wanted, "{apart}");
        }
        // What is inside a surface is no border: the middle of a fan under a vertex of another object.
        let fan = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0]];
        let over = [[0.0, 0.0, 1e-5], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0]];
        let triangles = vec![[0, 1, 2], [0, 2, 3], [0, 3, 1], [4, 5, 6]];
        let mesh = Mesh::new([&fan[..], &over].concat(), triangles).unwrap();
        assert_eq!(welded(&mesh, &[0, 0, 0, 0, 1, 1, 1]), [0, 1, 2, 3, 4, 5, 6]);
    }
}
