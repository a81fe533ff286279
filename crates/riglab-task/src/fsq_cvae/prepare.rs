//! An asset made ready for sampling.

use riglab_core::{Asset, JointId, Rig, Segment, Vec3};
use riglab_geom::{SurfacePoint, SurfaceSampler};
use riglab_metric::ACTIVE;
use riglab_random::{Draw, Stream};

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
}

/// A joint that moves something.
pub struct Bone {
    /// Which joint.
    pub joint: JointId,
    /// Its segments.
    pub segments: Vec<Segment>,
    /// The vertices it holds (above the threshold).
    pub vertices: Vec<u32>,
    /// Triangles with such a vertex, and running sums of their areas.
    triangles: Vec<(u32, f32)>,
    /// All its non-zero weights, by vertex.
    weights: Vec<(u32, f32)>,
}

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
        let normals = rig.mesh().vertex_normals();
        let areas = SurfaceSampler::new(rig.mesh()).into_sums();
        let columns = rig.weights().columns(rig.skeleton().len());
        let segments = rig.skeleton().segments();
        // Triangles around each vertex.
        let mut around = vec![Vec::new(); rig.mesh().positions().len()];
        for (t, corners) in rig.mesh().triangles().iter().enumerate() {
            for &v in corners {
                around[v as usize].push(t as u32);
            }
        }
        let area = |t: u32| length(rig.mesh().area_vector(t as usize));
        let bones = rig.skeleton().ids().zip(columns).zip(segments).filter_map(|((joint, weights), segments)| {
            let vertices: Vec<u32> = weights.iter().filter(|(_, w)| *w > ACTIVE).map(|(v, _)| *v).collect();
            if vertices.is_empty() {
                return None;
            }
            let mut triangles: Vec<u32> = vertices.iter().flat_map(|&v| around[v as usize].iter().copied()).collect();
            triangles.sort_unstable();
            triangles.dedup();
            let mut sum = 0.0;
            let triangles = triangles.into_iter().map(|t| {
                sum += area(t);
                (t, sum)
            });
            Some(Bone { joint, segments, vertices, triangles: triangles.collect(), weights })
        });
        Self { name: asset.name, bones: bones.collect(), normals, areas, rig }
    }

    /// About how many bytes it takes.
    pub fn bytes(&self) -> usize {
        let mesh = self.rig.mesh();
        let bones: usize =
            self.bones.iter().map(|b| 8 * (b.vertices.len() + b.triangles.len() + b.weights.len())).sum();
        24 * mesh.positions().len() + 20 * mesh.triangles().len() + 8 * self.rig.weights().nonzero() + bones
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

    /// A point where a bone holds the mesh: one of its vertices with the given probability, else on
    /// a triangle with such a vertex.
    pub fn held(&self, bone: &Bone, vertex_share: f32, random: &mut Stream) -> Point {
        let total = bone.triangles.last().map_or(0.0, |(_, sum)| *sum);
        if total <= 0.0 || random.chance(vertex_share) {
            return self.vertex(bone.vertices[random.below(bone.vertices.len())]);
        }
        let at = random.unit() * total;
        let k = bone.triangles.partition_point(|(_, sum)| *sum <= at).min(bone.triangles.len() - 1);
        self.on(SurfacePoint { triangle: bone.triangles[k].0, barycentric: riglab_geom::barycentric(random) })
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

fn length(v: Vec3) -> f32 {
    v.iter().map(|x| x * x).sum::<f32>().sqrt()
}
