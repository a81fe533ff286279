//! Points where one bone holds the mesh, and around.

use glam::DVec3;
use riglab_core::{Bounds, Mesh};
use riglab_random::Stream;
use serde::{Deserialize, Serialize};

use crate::alias::Alias;
use crate::cloud::{By, Cloud, CloudSampler, Place, some_of};
use crate::draws::{Picks, barycentric, draws};
use crate::surface::SurfacePoint;

/// How many points of a bone's part of the mesh, and how far around it. The defaults are those of
/// SkinTokens' public code, but for the number, which it leaves to its caller.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DenseConfig {
    /// Points in all.
    pub points: usize,
    /// So many of them are vertices, no two the same and as far as there are any; they come first.
    pub vertices: usize,
    /// How far around what the bone holds, at most, in the mesh's units.
    pub reach: f32,
    /// The same as a share of the diagonal of the box around what it holds; the smaller of both counts.
    pub reach_share: f32,
}

impl Default for DenseConfig {
    fn default() -> Self {
        Self { points: 1024, vertices: 0, reach: 0.1, reach_share: 0.1 }
    }
}

/// The triangles that a bone holds or that lie near: those with a vertex of some weight, and those with
/// a vertex nearer to a corner of such a one than the config's reach. All triangles for a bone that holds
/// nothing. `column` has the bone's non-zero weights by vertex, as
/// [`riglab_core::SkinWeights::columns`] gives them.
pub fn near_bone(mesh: &Mesh, column: &[(u32, f32)], config: &DenseConfig) -> Vec<bool> {
    let positions = mesh.positions();
    let mut near = vec![false; positions.len()];
    column.iter().for_each(|(v, _)| near[*v as usize] = true);
    let touched = |near: &[bool], t: &[u32; 3]| t.iter().any(|&v| near[v as usize]);
    let mut support: Vec<u32> = mesh.triangles().iter().filter(|t| touched(&near, t)).flatten().copied().collect();
    support.sort_unstable();
    support.dedup();
    let Some(bounds) = Bounds::of(support.iter().map(|&v| positions[v as usize])) else {
        return vec![true; mesh.triangles().len()];
    };
    let diagonal = (point(bounds.max) - point(bounds.min)).length();
    let reach = f64::from(config.reach).min(f64::from(config.reach_share) * diagonal);
    if reach > 0.0 {
        let (low, high) = (point(bounds.min) - reach, point(bounds.max) + reach);
        let mut sorted: Vec<DVec3> = support.iter().map(|&v| point(positions[v as usize])).collect();
        sorted.sort_unstable_by(|a, b| a.x.total_cmp(&b.x));
        support.iter().for_each(|&v| near[v as usize] = true);
        for (near, p) in near.iter_mut().zip(positions).filter(|(near, _)| !**near) {
            let p = point(*p);
            if p.cmplt(low).any() || p.cmpgt(high).any() {
                continue;
            }
            let from = sorted.partition_point(|q| q.x < p.x - reach);
            let mut within = sorted[from..].iter().take_while(|q| q.x <= p.x + reach);
            *near = within.any(|q| q.distance_squared(p) < reach * reach);
        }
    }
    mesh.triangles().iter().map(|t| touched(&near, t)).collect()
}

/// Draws clouds of one bone's part of a mesh.
pub struct DenseSampler<'a> {
    whole: &'a CloudSampler<'a>,
    config: DenseConfig,
    /// Vertices of the part, rising.
    vertices: Vec<u32>,
    /// Its triangles, rising; never empty.
    triangles: Vec<u32>,
    alias: Alias,
}

impl<'a> DenseSampler<'a> {
    /// Of the triangles that are marked, as by [`near_bone`]; of all where none is. The sampler of the
    /// whole mesh lends its normals.
    pub fn new(whole: &'a CloudSampler<'a>, marked: &[bool], config: &DenseConfig) -> Self {
        let mesh = whole.mesh();
        let mut triangles: Vec<u32> = (0..mesh.triangles().len() as u32).collect();
        if marked.contains(&true) {
            triangles.retain(|&t| marked[t as usize]);
        }
        let mut vertices: Vec<u32> = triangles.iter().flat_map(|&t| mesh.triangles()[t as usize]).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let weight = |&t: &u32| By::Area.weight(glam::Vec3A::from(mesh.area_vector(t as usize)).length());
        let alias = Alias::new(&triangles.iter().map(weight).collect::<Vec<_>>());
        Self { whole, config: config.clone(), vertices, triangles, alias }
    }

    /// A cloud.
    pub fn draw(&self, random: &mut Stream) -> Cloud {
        let order = some_of(self.vertices.len(), self.config.vertices.min(self.config.points), random);
        let mut places = self.vertices(&order);
        draws(&self.alias, self.config.points - places.len(), random, |Picks { numbers, u, v }| {
            places.extend(numbers.iter().zip(u).zip(v).map(|((&k, &u), &v)| {
                let triangle = self.triangles[k as usize];
                Place::Surface(SurfacePoint { triangle, barycentric: barycentric([u, v]) })
            }));
        });
        self.whole.at(places)
    }

    /// The vertices of the part by their place among them.
    pub fn vertices(&self, order: &[u32]) -> Vec<Place> {
        order.iter().map(|&k| Place::Vertex(self.vertices[k as usize])).collect()
    }
}

fn point(p: [f32; 3]) -> DVec3 {
    DVec3::from_array(p.map(f64::from))
}

#[cfg(test)]
mod tests {
    use riglab_random::stream;

    use super::*;
    use crate::CloudConfig;

    /// A strip along x, a triangle a unit and vertices at x = 0, 1, 2, ...
    fn strip(n: u32) -> Mesh {
        let positions = (0..n + 2).map(|v| [v as f32, (v % 2) as f32, 0.0]).collect();
        Mesh::new(positions, (0..n).map(|t| [t, t + 1, t + 2]).collect()).unwrap()
    }

    #[test]
    fn what_is_held_and_what_is_near_is_marked() {
        let mesh = strip(20);
        let column = [(8, 0.5), (10, 1.0)];
        let marked = |reach, reach_share| {
            let config = DenseConfig { reach, reach_share, ..DenseConfig::default() };
            let marked = near_bone(&mesh, &column, &config);
            (0..20).filter(|t| marked[*t]).collect::<Vec<_>>()
        };
        assert_eq!(marked(0.0, 0.1), (6..11).collect::<Vec<_>>());
        // Its corners, 6 to 12, are in a box with a diagonal of 6.08, 5 and 13 are 1.41 away from them.
        assert_eq!(marked(9.0, 0.24), (3..14).collect::<Vec<_>>());
        assert_eq!(marked(1.42, 9.0), (3..14).collect::<Vec<_>>());
        // Nothing more is near, but all that has a corner of what is held.
        assert_eq!(marked(1.41, 9.0), (4..13).collect::<Vec<_>>());
        assert!(near_bone(&mesh, &[], &DenseConfig::default()).iter().all(|m| *m));
    }

    #[test]
    fn points_come_from_the_part_alone() {
        let mesh = strip(20);
        let mut marked = vec![false; 20];
        marked[3..6].fill(true);
        let config = DenseConfig { points: 200, vertices: 3, ..DenseConfig::default() };
        let whole = CloudSampler::new(&mesh, &CloudConfig::default());
        let cloud = DenseSampler::new(&whole, &marked, &config).draw(&mut stream(1, "test", &[]));
        assert_eq!(cloud.positions.len(), 200);
        assert!(cloud.positions.iter().all(|p| (3.0..=7.0).contains(&p[0])));
        assert!(cloud.places[..3].iter().all(|p| matches!(p, Place::Vertex(3..=7))));
        // A part without area.
        let flat = Mesh::new(vec![[0.0; 3], [1.0; 3]], vec![[0, 0, 0], [0, 1, 1]]).unwrap();
        let whole = CloudSampler::new(&flat, &CloudConfig::default());
        let cloud = DenseSampler::new(&whole, &[true, false], &config).draw(&mut stream(1, "test", &[]));
        assert!(cloud.positions.iter().all(|p| *p == [0.0; 3]));
    }
}
