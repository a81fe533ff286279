//! An asset made ready for sampling.

use std::sync::OnceLock;

use rayon::prelude::*;
use riglab_augment::Normals;
use riglab_core::{Asset, JointId, Mesh, Rig, Segment, SkinWeights, Vec3};
use riglab_geom::{Blocks, By, SurfacePoint, SurfaceSampler, farthest_points};
use riglab_metric::ACTIVE;
use riglab_random::{Draw, Stream};

use super::prior::{Prior, SurfacePrior};
use super::region::{Regions, Surface};

/// A normalised rig with what sampling needs.
pub struct Prepared {
    /// The asset's name.
    pub name: String,
    /// The rig in [-1, 1]³, or about there where augmentation has scaled and shifted it.
    pub rig: Rig,
    /// Normals at the vertices.
    pub normals: Vec<Vec3>,
    /// The joints that hold some vertex by more than [`threshold`]: what is encoded. Of every rig some.
    pub bones: Vec<Bone>,
    /// Normals of the triangles where they are not those of the geometry.
    faces: Option<Vec<Vec3>>,
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
    /// Where it holds the mesh: its weights pass [`threshold`].
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

/// What a joint's weight must pass somewhere for the joint to be a bone: the metric's threshold. Where that leaves none, as
/// where more than a hundred joints share every vertex alike, any weight at all.
pub fn threshold(weights: &SkinWeights) -> f32 {
    if weights.weights().iter().any(|w| *w > ACTIVE) { ACTIVE } else { 0.0 }
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
        let ground = Ground::new(rig.mesh());
        Self::with_ground(&ground, name, rig, all)
    }

    /// As [`Self::of`], with what is known of the mesh alone.
    pub fn with_ground(ground: &Ground, name: String, rig: Rig, all: bool) -> Self {
        let columns = rig.weights().columns(rig.skeleton().len());
        let threshold = threshold(rig.weights());
        let joints: Vec<_> = rig.skeleton().ids().zip(columns).zip(rig.skeleton().segments()).collect();
        let bones = joints.into_par_iter().map_init(
            || Search::new(rig.mesh(), ground),
            |search, ((joint, weights), segments)| {
                let held: Vec<u32> = weights.iter().filter(|(_, w)| *w > threshold).map(|(v, _)| *v).collect();
                if held.is_empty() && !all {
                    return None;
                }
                let (held, shell) = search.patches(held);
                Some(Bone { joint, segments, held, shell, weights })
            },
        );
        let bones = bones.flatten_iter().collect();
        let (normals, areas) = (ground.normals.clone(), ground.sums.clone());
        Self { name, bones, normals, faces: None, areas, rig, regions: OnceLock::new(), prior: None }
    }

    /// With normals of augmentation, in place of those of the geometry; one a vertex, and one a triangle.
    #[must_use]
    pub fn with_normals(self, normals: Normals) -> Self {
        Self { normals: normals.vertices, faces: Some(normals.triangles), ..self }
    }

    /// With what geometry alone says of its bones' weights.
    #[must_use]
    pub fn with_prior(self) -> Self {
        Self { prior: Some(Prior::new(self.rig.mesh(), &self.segments())), ..self }
    }

    /// What geometry alone says, where it was asked.
    pub fn told(&self) -> Option<SurfacePrior<'_>> {
        self.prior.as_ref().map(|prior| SurfacePrior { prior, triangles: self.rig.mesh().triangles() })
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
            + self.faces.as_ref().map_or(0, |faces| size_of_val(&faces[..]))
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

    /// So many points anywhere on the surface, in triangles as they are weighted.
    pub fn surface_by(&self, by: By, count: usize, random: &mut Stream) -> Vec<Point> {
        let mesh = self.rig.mesh();
        let sampler = match by {
            By::Area => SurfaceSampler::with_sums(mesh, &self.areas),
            By::SquaredArea => SurfaceSampler::by(mesh, by),
        };
        (0..count).map(|_| self.on(sampler.draw(random))).collect()
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
        let normal = self.faces.as_ref().map_or_else(|| sampler.normal(&p), |faces| faces[p.triangle as usize]);
        Point { position: sampler.position(&p), normal, at: Place::Surface(p) }
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

/// Of a mesh what is asked for each rig on it.
pub struct Ground {
    /// Normals at the vertices.
    normals: Vec<Vec3>,
    /// Areas of the triangles, and running sums of them as points are drawn by.
    areas: Vec<f32>,
    sums: Vec<f64>,
    around: Around,
    blocks: Blocks,
}

impl Ground {
    /// Of a mesh in [-1, 1]³.
    pub fn new(mesh: &Mesh) -> Self {
        Self {
            normals: mesh.vertex_normals(),
            areas: (0..mesh.triangles().len()).map(|t| length(mesh.area_vector(t))).collect(),
            sums: SurfaceSampler::new(mesh).into_sums(),
            around: Around::new(mesh),
            blocks: Blocks::new(mesh.positions()),
        }
    }
}

/// Finds what lies at bones, of one after another.
struct Search<'a> {
    mesh: &'a Mesh,
    ground: &'a Ground,
    /// Whether the bone holds a vertex; none between bones.
    holds: Vec<bool>,
    marks: Marks,
}

impl<'a> Search<'a> {
    fn new(mesh: &'a Mesh, ground: &'a Ground) -> Self {
        let (holds, marks) = (vec![false; mesh.positions().len()], Marks::new(mesh.triangles().len()));
        Self { mesh, ground, holds, marks }
    }

    /// What a bone holds, ascending, and what lies around that.
    fn patches(&mut self, held: Vec<u32>) -> (Patch, Patch) {
        let shell = shell(self.mesh.positions(), &self.ground.blocks, &held);
        held.iter().for_each(|&v| self.holds[v as usize] = true);
        let shell = self.patch(shell, true);
        held.iter().for_each(|&v| self.holds[v as usize] = false);
        (self.patch(held, false), shell)
    }

    /// Vertices with the triangles around them; `apart`: of those, the ones without a vertex that the bone holds.
    fn patch(&mut self, vertices: Vec<u32>, apart: bool) -> Patch {
        let (mesh, ground, holds) = (self.mesh, self.ground, &self.holds);
        let mut sum = 0.0;
        let all = ground.around.all(&vertices, &mut self.marks).into_iter();
        let triangles =
            all.filter(|&t| !apart || !mesh.triangles()[t as usize].iter().any(|&v| holds[v as usize])).map(|t| {
                sum += ground.areas[t as usize];
                (t, sum)
            });
        Patch { triangles: triangles.collect(), vertices }
    }
}

/// The triangles around each vertex of a mesh, one vertex after another.
struct Around {
    ends: Vec<u32>,
    triangles: Vec<u32>,
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
        Self { ends, triangles }
    }

    /// Those around some vertices, ascending.
    fn all(&self, vertices: &[u32], marks: &mut Marks) -> Vec<u32> {
        for &v in vertices {
            let start = if v == 0 { 0 } else { self.ends[v as usize - 1] };
            let own = &self.triangles[start as usize..self.ends[v as usize] as usize];
            own.iter().for_each(|&t| marks.add(t));
        }
        marks.take()
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

/// The vertices not in `held` that lie nearest to it.
fn shell(positions: &[Vec3], blocks: &Blocks, held: &[u32]) -> Vec<u32> {
    let own: Vec<Vec3> = held.iter().map(|&v| positions[v as usize]).collect();
    let landmarks = match own.len().min(LANDMARKS) {
        0 => return Vec::new(),
        count => farthest_points(&own, count, 0).into_iter().map(|k| own[k]).collect::<Vec<_>>(),
    };
    blocks.nearest(&landmarks, held, held.len().max(SHELL))
}

fn length(v: Vec3) -> f32 {
    v.iter().map(|x| x * x).sum::<f32>().sqrt()
}

#[cfg(test)]
mod tests {
    use riglab_core::{Joint, Skeleton};

    use super::*;

    #[test]
    fn a_rig_whose_joints_hold_little_has_bones() {
        let rig = |joints: usize| {
            let mesh = Mesh::new(vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], vec![[0, 1, 2]]).unwrap();
            let joint = |j: usize| Joint {
                name: format!("j{j}"),
                head: [j as f32 / 200.0, 0.0, 0.0],
                parent: j.checked_sub(1).map(|p| JointId(p as u16)),
            };
            let skeleton = Skeleton::new((0..joints).map(joint).collect()).unwrap();
            // All alike, but one that holds nothing.
            let row: Vec<_> = (1..joints).map(|j| (j as u16, 1.0)).collect();
            Rig::new(skeleton, mesh, SkinWeights::normalized(vec![row; 3]).unwrap()).unwrap()
        };
        for joints in [2, 90, 150] {
            let rig = rig(joints);
            assert_eq!(threshold(rig.weights()), if joints > 100 { 0.0 } else { ACTIVE });
            assert_eq!(Prepared::of(String::new(), rig.clone(), false).bones.len(), joints - 1);
            assert_eq!(Prepared::of(String::new(), rig, true).bones.len(), joints);
        }
    }

    #[test]
    fn a_shell_lies_around_what_is_held_and_never_in_it() {
        let line: Vec<Vec3> = (0..1000).map(|i| [i as f32, 0.0, 0.0]).collect();
        let held: Vec<u32> = (300..400).collect();
        let shell = |positions: &[Vec3], held: &[u32]| shell(positions, &Blocks::new(positions), held);
        let found = shell(&line, &held);
        assert_eq!(found, (236..300).chain(400..464).collect::<Vec<u32>>());
        assert_eq!(shell(&line[..310], &held[..10]).len(), SHELL);
        assert!(shell(&line[300..400], &(0..100).collect::<Vec<u32>>()).is_empty());
    }
}
