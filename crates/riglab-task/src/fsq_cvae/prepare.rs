//! An asset made ready for sampling.

use std::sync::OnceLock;

use riglab_core::{Asset, JointId, Mesh, Rig, Segment, Vec3};
use riglab_geom::{SurfacePoint, SurfaceSampler, farthest_points, nearest_squares};
use riglab_metric::ACTIVE;
use riglab_random::{Draw, Stream};

use super::prior::{Prior, Told};
use super::region::{Regions, Surface};

/// A normalised rig with what sampling needs.
pub struct Prepared {
    /// The asset's name.
    pub name: String,
    /// The rig in [-1, 1]³.
    pub rig: Rig,
    /// Normals at the vertices.
    pub normals: Vec<Vec3>,
    /// The joints that hold some vertex by more than the metric's threshold: what is encoded.
    pub bones: Vec<Bone>,
    /// Running sums of triangle areas.
    areas: Vec<f64>,
    regions: OnceLock<Regions>,
    prior: Option<Prior>,
}

/// A joint that moves something.
pub struct Bone {
    /// Which joint.
    pub joint: JointId,
    /// Its segments.
    pub segments: Vec<Segment>,
    /// Where it holds the mesh: its weights pass the threshold.
    pub held: Patch,
    /// Around it: the vertices it does not hold that lie nearest to those it holds, as many as those
    /// but at least [`SHELL`].
    pub shell: Patch,
    /// All its non-zero weights, by vertex.
    weights: Vec<(u32, f32)>,
}

/// Vertices and the triangles that have one of them.
pub struct Patch {
    /// By number.
    pub vertices: Vec<u32>,
    /// By number, with running sums of their areas.
    triangles: Vec<(u32, f32)>,
}

/// Vertices that a shell has at least, where the mesh has them.
pub const SHELL: usize = 128;
/// Vertices of a bone that nearness is measured to: spread over all it holds.
const LANDMARKS: usize = 64;

/// A point with what networks are told of it.
#[derive(Clone, Copy, Debug)]
pub struct Point {
    /// Position.
    pub position: Vec3,
    /// Unit normal.
    pub normal: Vec3,
    /// Where on the mesh.
    pub at: Place,
}

/// A place on a mesh.
#[derive(Clone, Copy, Debug)]
pub enum Place {
    /// At a vertex.
    Vertex(u32),
    /// On a triangle.
    Surface(SurfacePoint),
}

impl Prepared {
    /// Prepares an asset.
    pub fn new(asset: Asset) -> Self {
        let (rig, _) = asset.rig.normalized();
        Self::of(asset.name, rig, false)
    }

    /// Prepares a rig that lies in [-1, 1]³; `all`: joints that hold nothing are bones too.
    pub fn of(name: String, rig: Rig, all: bool) -> Self {
        let normals = rig.mesh().vertex_normals();
        let areas = SurfaceSampler::new(rig.mesh()).into_sums();
        let columns = rig.weights().columns(rig.skeleton().len());
        let segments = rig.skeleton().segments();
        let (positions, mut around) = (rig.mesh().positions(), Around::new(rig.mesh()));
        let area = |t: u32| length(rig.mesh().area_vector(t as usize));
        let mut patch = |vertices: Vec<u32>, of: &dyn Fn(u32) -> bool| {
            let mut sum = 0.0;
            let triangles = around.all(&vertices).into_iter().filter(|&t| of(t)).map(|t| {
                sum += area(t);
                (t, sum)
            });
            Patch { triangles: triangles.collect(), vertices }
        };
        // Whether a bone holds a vertex.
        let (mut holds, mut marks) = (vec![false; positions.len()], Marks::new(positions.len()));
        let bones = rig.skeleton().ids().zip(columns).zip(segments).filter_map(|((joint, weights), segments)| {
            let held: Vec<u32> = weights.iter().filter(|(_, w)| *w > ACTIVE).map(|(v, _)| *v).collect();
            if held.is_empty() && !all {
                return None;
            }
            held.iter().for_each(|&v| holds[v as usize] = true);
            let apart = |t: u32| !rig.mesh().triangles()[t as usize].iter().any(|&v| holds[v as usize]);
            let shell = patch(shell(positions, &held, &mut marks), &apart);
            held.iter().for_each(|&v| holds[v as usize] = false);
            let held = patch(held, &|_| true);
            Some(Bone { joint, segments, held, shell, weights })
        });
        Self { name, bones: bones.collect(), normals, areas, rig, regions: OnceLock::new(), prior: None }
    }

    /// With what geometry alone says of its bones' weights.
    #[must_use]
    pub fn with_prior(self) -> Self {
        Self { prior: Some(Prior::new(self.rig.mesh(), &self.segments())), ..self }
    }

    /// What geometry alone says, where it was asked.
    pub fn told(&self) -> Option<Told<'_>> {
        self.prior.as_ref().map(|prior| Told { prior, triangles: self.rig.mesh().triangles() })
    }

    /// What lies nearest to each bone.
    pub fn regions(&self) -> &Regions {
        self.regions.get_or_init(|| Regions::new(&Surface::new(self.rig.mesh()), &self.segments()))
    }

    /// The segments of each bone.
    pub fn segments(&self) -> Vec<Vec<Segment>> {
        self.bones.iter().map(|bone| bone.segments.clone()).collect()
    }

    /// About how many bytes it takes.
    pub fn bytes(&self) -> usize {
        let mesh = self.rig.mesh();
        let bones: usize = self.bones.iter().map(|b| b.held.bytes() + b.shell.bytes() + 8 * b.weights.len()).sum();
        24 * mesh.positions().len()
            + 20 * mesh.triangles().len()
            + 8 * self.rig.weights().nonzero()
            + bones
            + self.prior.as_ref().map_or(0, Prior::bytes)
    }

    /// A point at a vertex.
    pub fn vertex(&self, v: u32) -> Point {
        let (position, normal) = (self.rig.mesh().positions()[v as usize], self.normals[v as usize]);
        Point { position, normal, at: Place::Vertex(v) }
    }

    /// A point anywhere on the surface.
    pub fn surface(&self, random: &mut Stream) -> Point {
        let sampler = SurfaceSampler::with_sums(self.rig.mesh(), &self.areas);
        self.on(sampler.draw(random))
    }

    /// A point anywhere: a vertex with the given probability.
    pub fn anywhere(&self, vertex_share: f32, random: &mut Stream) -> Point {
        if random.chance(vertex_share) {
            return self.vertex(random.below(self.rig.mesh().positions().len()) as u32);
        }
        self.surface(random)
    }

    /// A point of a patch: one of its vertices with the given probability, else on its triangles.
    /// `None` where the patch is empty.
    pub fn within(&self, patch: &Patch, vertex_share: f32, random: &mut Stream) -> Option<Point> {
        let total = patch.triangles.last().map_or(0.0, |(_, sum)| *sum);
        if total <= 0.0 || random.chance(vertex_share) {
            let n = patch.vertices.len();
            return (n > 0).then(|| self.vertex(patch.vertices[random.below(n)]));
        }
        let at = random.unit() * total;
        let k = patch.triangles.partition_point(|(_, sum)| *sum <= at).min(patch.triangles.len() - 1);
        Some(self.on(SurfacePoint { triangle: patch.triangles[k].0, barycentric: riglab_geom::barycentric(random) }))
    }

    fn on(&self, p: SurfacePoint) -> Point {
        let sampler = SurfaceSampler::with_sums(self.rig.mesh(), &self.areas);
        Point { position: sampler.position(&p), normal: sampler.normal(&p), at: Place::Surface(p) }
    }

    /// A bone's weight at a point.
    pub fn weight(&self, bone: &Bone, point: &Point) -> f32 {
        match point.at {
            Place::Vertex(v) => bone.weight(v),
            Place::Surface(p) => {
                let corners = self.rig.mesh().triangles()[p.triangle as usize];
                corners.iter().zip(p.barycentric).map(|(&v, share)| share * bone.weight(v)).sum()
            }
        }
    }
}

impl Patch {
    fn bytes(&self) -> usize {
        4 * self.vertices.len() + 8 * self.triangles.len()
    }
}

impl Bone {
    /// Its weight at a vertex.
    pub fn weight(&self, vertex: u32) -> f32 {
        self.weights.binary_search_by_key(&vertex, |(v, _)| *v).map_or(0.0, |k| self.weights[k].1)
    }

    /// All its non-zero weights, by vertex.
    pub fn weights(&self) -> &[(u32, f32)] {
        &self.weights
    }
}

/// The triangles around each vertex of a mesh, one vertex after another.
struct Around {
    ends: Vec<u32>,
    triangles: Vec<u32>,
    marks: Marks,
}

impl Around {
    fn new(mesh: &Mesh) -> Self {
        let mut ends = vec![0u32; mesh.positions().len()];
        mesh.triangles().iter().flatten().for_each(|&v| ends[v as usize] += 1);
        let mut all = 0;
        for end in &mut ends {
            all += *end;
            *end = all;
        }
        // From the last place of each vertex to its first.
        let mut triangles = vec![0; all as usize];
        let mut next = ends.clone();
        for (t, corners) in mesh.triangles().iter().enumerate().rev() {
            for &v in corners {
                next[v as usize] -= 1;
                triangles[next[v as usize] as usize] = t as u32;
            }
        }
        Self { ends, triangles, marks: Marks::new(mesh.triangles().len()) }
    }

    /// Those around some vertices, ascending.
    fn all(&mut self, vertices: &[u32]) -> Vec<u32> {
        for &v in vertices {
            let start = if v == 0 { 0 } else { self.ends[v as usize - 1] };
            let own = &self.triangles[start as usize..self.ends[v as usize] as usize];
            own.iter().for_each(|&t| self.marks.add(t));
        }
        self.marks.take()
    }
}

/// A set of small numbers, which sorts them.
struct Marks(Vec<u64>);

impl Marks {
    /// For numbers below `count`.
    fn new(count: usize) -> Self {
        Self(vec![0; count.div_ceil(64)])
    }

    fn add(&mut self, number: u32) {
        self.0[number as usize / 64] |= 1 << (number % 64);
    }

    /// All that were added, ascending; it is empty then.
    fn take(&mut self) -> Vec<u32> {
        let mut all = Vec::with_capacity(self.0.iter().map(|word| word.count_ones() as usize).sum());
        for (k, word) in (0u32..).zip(&mut self.0) {
            while *word != 0 {
                all.push(64 * k + word.trailing_zeros());
                *word &= *word - 1;
            }
        }
        all
    }
}

/// The vertices not in `held` (ascending) that lie nearest to it.
fn shell(positions: &[Vec3], held: &[u32], marks: &mut Marks) -> Vec<u32> {
    if held.is_empty() {
        return Vec::new();
    }
    let own: Vec<Vec3> = held.iter().map(|&v| positions[v as usize]).collect();
    let landmarks: Vec<Vec3> = farthest_points(&own, LANDMARKS.min(own.len()), 0).into_iter().map(|k| own[k]).collect();
    // Distances are positive numbers, whose bits are in their order: ones of equal distance by vertex.
    let mut others: Vec<u64> = Vec::with_capacity(positions.len() - held.len());
    let mut next = held.iter().copied().peekable();
    for (v, square) in (0..).zip(nearest_squares(positions, &landmarks)) {
        if next.next_if_eq(&v).is_none() {
            others.push(u64::from(square.to_bits()) << 32 | u64::from(v));
        }
    }
    let count = held.len().max(SHELL);
    if others.len() > count {
        others.select_nth_unstable(count - 1);
        others.truncate(count);
    }
    others.into_iter().for_each(|key| marks.add(key as u32));
    marks.take()
}

fn length(v: Vec3) -> f32 {
    v.iter().map(|x| x * x).sum::<f32>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shell_lies_around_what_is_held_and_never_in_it() {
        let line: Vec<Vec3> = (0..1000).map(|i| [i as f32, 0.0, 0.0]).collect();
        let held: Vec<u32> = (300..400).collect();
        let shell = |positions: &[Vec3], held: &[u32]| shell(positions, held, &mut Marks::new(1000));
        let found = shell(&line, &held);
        assert_eq!(found, (236..300).chain(400..464).collect::<Vec<u32>>());
        assert_eq!(shell(&line[..310], &held[..10]).len(), SHELL);
        assert!(shell(&line[300..400], &(0..100).collect::<Vec<u32>>()).is_empty());
    }
}
