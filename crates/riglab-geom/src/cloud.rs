//! Many points of a surface at once: what networks see of a mesh.

use std::borrow::Cow;
use std::sync::OnceLock;

use glam::Vec3A;
use riglab_core::{Mesh, RigError, SkinWeights};
use riglab_random::{Draw, Stream};
use serde::{Deserialize, Serialize};

use crate::alias::Alias;
use crate::draws::{BLOCK, Picks, barycentric, draws};
use crate::normals_by_angle;
use crate::surface::SurfacePoint;

/// How many points, and where. The default is UniRig's number, spread evenly.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CloudConfig {
    /// Points in all.
    pub points: usize,
    /// So many of them are vertices, no two the same and as far as there are any; they come first.
    pub vertices: usize,
    /// How likely triangles are.
    pub by: By,
}

/// What triangles are weighted by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum By {
    /// Their area: points are spread evenly.
    #[default]
    Area,
    /// The square of it, as in UniRig's public code: large triangles get more than their share.
    SquaredArea,
}

impl Default for CloudConfig {
    fn default() -> Self {
        Self { points: 65_536, vertices: 0, by: By::Area }
    }
}

impl CloudConfig {
    /// SkinTokens: 54,000 points of the surface. The public code names a number of vertices, too, but
    /// does not pass it on.
    pub fn skintokens() -> Self {
        Self { points: 54_000, vertices: 0, by: By::Area }
    }

    /// UniRig's skeleton model where it is trained.
    pub fn unirig_ar_training() -> Self {
        Self { points: 65_536, vertices: 4_096, by: By::SquaredArea }
    }

    /// UniRig's skeleton model where it is used.
    pub fn unirig_ar() -> Self {
        Self { points: 65_536, vertices: 8_192, by: By::SquaredArea }
    }

    /// UniRig's skin model where it is used.
    pub fn unirig_skin() -> Self {
        Self { points: 32_768, vertices: 8_192, by: By::SquaredArea }
    }
}

/// Points with their normals.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cloud {
    /// Where they are.
    pub positions: Vec<[f32; 3]>,
    /// Unit normals: of the triangle, or of the vertex, weighted by angle.
    pub normals: Vec<[f32; 3]>,
    /// Where on the mesh.
    pub places: Vec<Place>,
}

/// A place on a mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Place {
    /// At a vertex.
    Vertex(u32),
    /// On a triangle.
    Surface(SurfacePoint),
}

/// Draws clouds of one mesh.
pub struct CloudSampler<'a> {
    mesh: &'a Mesh,
    config: CloudConfig,
    /// Computed when the first vertex is asked for.
    vertex_normals: OnceLock<Cow<'a, [[f32; 3]]>>,
    faces: Vec<Face>,
    alias: Alias,
}

/// What a point of a triangle needs: in one line of the cache, since triangles are picked all over the mesh.
#[derive(Clone, Copy)]
#[repr(align(64))]
struct Face {
    corner: Vec3A,
    along: Vec3A,
    across: Vec3A,
    normal: Vec3A,
}

impl<'a> CloudSampler<'a> {
    /// With the normals of the mesh.
    pub fn new(mesh: &'a Mesh, config: &CloudConfig) -> Self {
        Self::of(mesh, config, OnceLock::new(), None)
    }

    /// With other normals, one a vertex and one a triangle: such as carry noise.
    ///
    /// # Panics
    /// When their numbers are not those of the mesh.
    pub fn with_normals(
        mesh: &'a Mesh,
        config: &CloudConfig,
        vertex_normals: &'a [[f32; 3]],
        triangle_normals: &[[f32; 3]],
    ) -> Self {
        assert_eq!(vertex_normals.len(), mesh.positions().len(), "a normal a vertex");
        assert_eq!(triangle_normals.len(), mesh.triangles().len(), "a normal a triangle");
        Self::of(mesh, config, OnceLock::from(Cow::from(vertex_normals)), Some(triangle_normals))
    }

    fn of(
        mesh: &'a Mesh,
        config: &CloudConfig,
        vertex_normals: OnceLock<Cow<'a, [[f32; 3]]>>,
        triangle_normals: Option<&[[f32; 3]]>,
    ) -> Self {
        let count = mesh.triangles().len();
        let (mut weights, mut faces) = (Vec::with_capacity(count), Vec::with_capacity(count));
        faces.extend(mesh.triangles().iter().enumerate().map(|(t, corners)| {
            let [corner, b, c] = corners.map(|v| Vec3A::from(mesh.positions()[v as usize]));
            let (along, across) = (b - corner, c - corner);
            let area = along.cross(across);
            let length = area.length();
            weights.push(config.by.weight(length));
            let normal = match triangle_normals {
                Some(all) => all[t].into(),
                None => own_normal(area, length),
            };
            Face { corner, along, across, normal }
        }));
        Self { mesh, config: config.clone(), vertex_normals, faces, alias: Alias::new(&weights) }
    }

    /// The mesh.
    pub fn mesh(&self) -> &'a Mesh {
        self.mesh
    }

    /// A cloud.
    pub fn draw(&self, random: &mut Stream) -> Cloud {
        let n = self.config.points;
        let mut cloud =
            Cloud { positions: Vec::with_capacity(n), normals: Vec::with_capacity(n), places: Vec::with_capacity(n) };
        self.each(random, |position, normal, place| {
            cloud.positions.push(position);
            cloud.normals.push(normal);
            cloud.places.push(place);
        });
        cloud
    }

    /// Puts position and normal of the points of a cloud, at most `points`, behind an array of rows of six:
    /// what networks take. Memory that is only reserved there need not be set to zeros first.
    pub fn append(&self, points: usize, random: &mut Stream, out: &mut Vec<f32>) {
        let points = self.config.points.min(points);
        out.reserve(6 * points);
        self.rows(points, random, |some| out.extend_from_slice(some.as_flattened()));
    }

    /// The rows of `points` points in order, some at a time.
    fn rows(&self, points: usize, random: &mut Stream, mut take: impl FnMut(&[[f32; 6]])) {
        let vertices = some_of(self.mesh.positions().len(), self.config.vertices.min(points), random);
        let mut rows = [[0f32; 6]; BLOCK];
        for vertices in vertices.chunks(BLOCK) {
            let normals = self.vertex_normals();
            for (row, &v) in rows.iter_mut().zip(vertices) {
                let ([x, y, z], [a, b, c]) = (self.mesh.positions()[v as usize], normals[v as usize]);
                *row = [x, y, z, a, b, c];
            }
            take(&rows[..vertices.len()]);
        }
        draws(&self.alias, points - vertices.len(), random, |Picks { numbers, u, v }| {
            for (((row, &t), &u), &v) in rows.iter_mut().zip(numbers).zip(u).zip(v) {
                let ([x, y, z], [a, b, c]) = self.on(t, u, v);
                *row = [x, y, z, a, b, c];
            }
            take(&rows[..numbers.len()]);
        });
    }

    /// The points of a cloud one by one, with position, normal and place: for who has an array of their
    /// own to put them in.
    #[inline]
    pub fn each(&self, random: &mut Stream, mut take: impl FnMut([f32; 3], [f32; 3], Place)) {
        let points = self.config.points;
        let vertices = some_of(self.mesh.positions().len(), self.config.vertices.min(points), random);
        for &v in &vertices {
            take(self.mesh.positions()[v as usize], self.vertex_normals()[v as usize], Place::Vertex(v));
        }
        draws(&self.alias, points - vertices.len(), random, |Picks { numbers, u, v }| {
            for ((&triangle, &u), &v) in numbers.iter().zip(u).zip(v) {
                let (position, normal) = self.on(triangle, u, v);
                take(position, normal, Place::Surface(SurfacePoint { triangle, barycentric: barycentric([u, v]) }));
            }
        });
    }

    /// The cloud of given places.
    pub fn at(&self, places: Vec<Place>) -> Cloud {
        let point = |place: &Place| match place {
            Place::Vertex(v) => (self.mesh.positions()[*v as usize], self.vertex_normals()[*v as usize]),
            Place::Surface(SurfacePoint { triangle, barycentric: [_, u, v] }) => self.on(*triangle, *u, *v),
        };
        let (positions, normals) = places.iter().map(point).unzip();
        Cloud { positions, normals, places }
    }

    fn vertex_normals(&self) -> &[[f32; 3]] {
        self.vertex_normals.get_or_init(|| normals_by_angle(self.mesh).into())
    }

    #[inline]
    fn on(&self, triangle: u32, u: f32, v: f32) -> ([f32; 3], [f32; 3]) {
        let Face { corner, along, across, normal } = self.faces[triangle as usize];
        ((corner + along * u + across * v).into(), normal.into())
    }
}

/// The unit vector along one whose length is known; +y where that is 0 or too small or large to
/// divide by.
#[inline]
fn own_normal(area: Vec3A, length: f32) -> Vec3A {
    let by = 1.0 / length;
    if by.is_finite() && by > 0.0 { area * by } else { Vec3A::Y }
}

impl Cloud {
    /// The weights at its points: those of the corners by their shares.
    ///
    /// # Errors
    /// None for the weights of the mesh's rig; see [`SkinWeights::new`].
    pub fn weights(&self, mesh: &Mesh, weights: &SkinWeights) -> Result<SkinWeights, RigError> {
        let mut rows = Corners::new(mesh, weights);
        let mut offsets = Vec::with_capacity(self.places.len() + 1);
        let room = self.places.len() * (1 + 2 * weights.nonzero() / weights.rows());
        let (mut joints, mut values) = (Vec::with_capacity(room), Vec::with_capacity(room));
        offsets.push(0);
        for place in &self.places {
            match *place {
                Place::Vertex(v) => weights.row(v as usize).for_each(|(joint, w)| {
                    joints.push(joint.0);
                    values.push(w);
                }),
                Place::Surface(SurfacePoint { triangle, barycentric: [u, v, w] }) => {
                    for &(joint, [a, b, c]) in rows.of(triangle) {
                        let value = u * a + v * b + w * c;
                        // A corner of no share gives none.
                        if value > 0.0 {
                            joints.push(joint);
                            values.push(value);
                        }
                    }
                }
            }
            offsets.push(joints.len() as u32);
        }
        SkinWeights::new(offsets, joints, values)
    }
}

/// The weights of triangles' corners joint by joint, put together the first time each is asked for.
struct Corners<'a> {
    mesh: &'a Mesh,
    weights: &'a SkinWeights,
    /// Where each triangle's part begins and ends; `u32::MAX` before it is put together.
    spans: Vec<[u32; 2]>,
    rows: Vec<(u16, [f32; 3])>,
}

impl<'a> Corners<'a> {
    fn new(mesh: &'a Mesh, weights: &'a SkinWeights) -> Self {
        Self { mesh, weights, spans: vec![[u32::MAX; 2]; mesh.triangles().len()], rows: Vec::new() }
    }

    /// Joints of a triangle, rising, with their weights at its corners.
    fn of(&mut self, triangle: u32) -> &[(u16, [f32; 3])] {
        let [mut from, mut to] = self.spans[triangle as usize];
        if from == u32::MAX {
            from = self.rows.len() as u32;
            for (corner, &vertex) in self.mesh.triangles()[triangle as usize].iter().enumerate() {
                for (joint, w) in self.weights.row(vertex as usize) {
                    let own = &mut self.rows[from as usize..];
                    match own.iter_mut().find(|(j, _)| *j == joint.0) {
                        Some((_, at)) => at[corner] = w,
                        None => {
                            let mut at = [0.0; 3];
                            at[corner] = w;
                            self.rows.push((joint.0, at));
                        }
                    }
                }
            }
            self.rows[from as usize..].sort_unstable_by_key(|(joint, _)| *joint);
            to = self.rows.len() as u32;
            self.spans[triangle as usize] = [from, to];
        }
        &self.rows[from as usize..to as usize]
    }
}

impl By {
    /// What a triangle weighs, by its doubled area.
    #[inline]
    pub(crate) fn weight(self, area: f32) -> f64 {
        match self {
            Self::Area => f64::from(area),
            Self::SquaredArea => f64::from(area).powi(2),
        }
    }
}

/// `count` of the numbers below `n`, no two the same, all where there are no more; in random order.
pub(crate) fn some_of(n: usize, count: usize, random: &mut Stream) -> Vec<u32> {
    if count == 0 {
        return Vec::new();
    }
    let mut all: Vec<u32> = (0..n as u32).collect();
    let count = count.min(n);
    for k in 0..count {
        let other = k + random.below(n - k);
        all.swap(k, other);
    }
    all.truncate(count);
    all
}

#[cfg(test)]
mod tests {
    use riglab_core::JointId;
    use riglab_random::stream;

    use super::*;

    /// Areas 1/2 and 3/2.
    fn mesh() -> Mesh {
        let p =
            vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [3.0, 0.0, 1.0], [0.0, 1.0, 1.0]];
        Mesh::new(p, vec![[0, 1, 2], [3, 4, 5]]).unwrap()
    }

    fn on_second(cloud: &Cloud) -> usize {
        cloud.places.iter().filter(|p| matches!(p, Place::Surface(s) if s.triangle == 1)).count()
    }

    #[test]
    fn triangles_are_hit_by_their_area_or_its_square() {
        let mesh = mesh();
        for (by, wanted) in [(By::Area, 0.75), (By::SquaredArea, 0.9)] {
            let config = CloudConfig { points: 20_000, vertices: 0, by };
            let cloud = CloudSampler::new(&mesh, &config).draw(&mut stream(1, "test", &[]));
            let share = on_second(&cloud) as f64 / 20_000.0;
            assert!((share - wanted).abs() < 0.01, "{share}");
            for ([x, y, z], n) in cloud.positions.iter().zip(&cloud.normals) {
                let side = if *z == 0.0 { x + y } else { x / 3.0 + y };
                assert!(*x >= 0.0 && *y >= 0.0 && side < 1.00001 && *n == [0.0, 0.0, 1.0]);
            }
            // The middle of a triangle is the mean of its points.
            let x: f32 = cloud.positions.iter().filter(|p| p[2] == 1.0).map(|p| p[0]).sum();
            assert!((x / on_second(&cloud) as f32 - 1.0).abs() < 0.02);
        }
    }

    #[test]
    fn rows_are_those_of_the_cloud_however_they_are_taken() {
        let mesh = mesh();
        let config = CloudConfig { points: 300, vertices: 4, by: By::Area };
        let sampler = CloudSampler::new(&mesh, &config);
        let random = || stream(1, "test", &[]);
        let cloud = sampler.draw(&mut random());
        let row = |(&[x, y, z], &[a, b, c]): (&[f32; 3], &[f32; 3])| [x, y, z, a, b, c];
        let wanted: Vec<[f32; 6]> = cloud.positions.iter().zip(&cloud.normals).map(row).collect();
        for points in [0, 3, 150, 300, 1000] {
            let mut rows = vec![7.0];
            sampler.append(points, &mut random(), &mut rows);
            assert_eq!(rows[1..], *wanted[..points.min(300)].as_flattened());
        }
        assert_eq!(sampler.at(cloud.places.clone()), cloud);
    }

    #[test]
    fn vertices_come_first_each_once_and_as_far_as_there_are_any() {
        let mesh = mesh();
        let config = CloudConfig { points: 20, vertices: 10, by: By::Area };
        let cloud = CloudSampler::new(&mesh, &config).draw(&mut stream(1, "test", &[]));
        let mut vertices: Vec<u32> = cloud.places[..6]
            .iter()
            .map(|p| match p {
                Place::Vertex(v) => *v,
                Place::Surface(_) => panic!("a point of the surface among the vertices"),
            })
            .collect();
        vertices.sort_unstable();
        assert_eq!((vertices, cloud.positions.len()), ((0..6).collect(), 20));
        let few = CloudConfig { points: 2, ..config };
        assert_eq!(CloudSampler::new(&mesh, &few).draw(&mut stream(1, "test", &[])).positions.len(), 2);
    }

    #[test]
    fn weights_are_those_of_the_corners_by_their_shares() {
        let mesh = mesh();
        let weights = SkinWeights::normalized((0..6).map(|v| vec![(v as u16 % 2, 1.0), (5, 1.0)])).unwrap();
        let at = |barycentric| Place::Surface(SurfacePoint { triangle: 0, barycentric });
        let places = vec![at([0.5, 0.25, 0.25]), Place::Vertex(3), at([1.0, 0.0, 0.0])];
        let cloud = CloudSampler::new(&mesh, &CloudConfig::default()).at(places);
        let found = cloud.weights(&mesh, &weights).unwrap();
        let row = |p: usize| found.row(p).collect::<Vec<_>>();
        assert_eq!(row(0), [(JointId(0), 0.375), (JointId(1), 0.125), (JointId(5), 0.5)]);
        assert_eq!(row(1), [(JointId(1), 0.5), (JointId(5), 0.5)]);
        assert_eq!(row(2), [(JointId(0), 0.5), (JointId(5), 0.5)]);
    }

    #[test]
    fn same_seed_same_cloud_and_a_mesh_without_area_still_gives_one() {
        let flat = Mesh::new(vec![[1.0; 3]; 3], vec![[0, 1, 2], [0, 0, 0]]).unwrap();
        let config = CloudConfig { points: 100, vertices: 2, by: By::SquaredArea };
        let draw = |mesh: &Mesh, seed| CloudSampler::new(mesh, &config).draw(&mut stream(seed, "test", &[]));
        assert!(draw(&flat, 1).positions.iter().all(|p| (p[0] - 1.0).abs() < 1e-6));
        let cloud = draw(&mesh(), 1);
        assert_eq!(cloud, draw(&mesh(), 1));
        assert_ne!(cloud, draw(&mesh(), 2));
    }
}
