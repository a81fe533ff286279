//! Many points of a surface at once: what networks see of a mesh.

use std::borrow::Cow;
use std::sync::OnceLock;

use glam::Vec3A;
use riglab_core::{Mesh, RigError, SkinWeights};
use riglab_random::{Draw, Stream};
use serde::{Deserialize, Serialize};

use crate::alias::Alias;
use crate::normals_by_angle;
use crate::surface::{SurfacePoint, folded};

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

    /// UniRig's skin model where it is trained.
    pub fn unirig_skin_training() -> Self {
        Self { points: 16_384, vertices: 8_192, by: By::SquaredArea }
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
        let mut weights = Vec::with_capacity(mesh.triangles().len());
        let face = |t| {
            let [corner, b, c] = mesh.corners(t).map(Vec3A::from);
            let (along, across) = (b - corner, c - corner);
            let area = along.cross(across);
            weights.push(config.by.weight(area));
            let own = || area.try_normalize().unwrap_or(Vec3A::Y);
            let normal = triangle_normals.map_or_else(own, |all| all[t].into());
            Face { corner, along, across, normal }
        };
        let faces = (0..mesh.triangles().len()).map(face).collect();
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

    /// Position and normal of the points of a cloud, a row each: what networks take. Rows beyond the
    /// config's points stay as they are, points beyond the rows are not drawn.
    pub fn fill(&self, random: &mut Stream, rows: &mut [[f32; 6]]) {
        let points = self.config.points.min(rows.len());
        let mut rows = rows.iter_mut();
        self.some(points, random, |[x, y, z], [a, b, c], _| {
            if let Some(row) = rows.next() {
                *row = [x, y, z, a, b, c];
            }
        });
    }

    /// The points of a cloud one by one, with position, normal and place: for who has an array of their
    /// own to put them in.
    #[inline]
    pub fn each(&self, random: &mut Stream, take: impl FnMut([f32; 3], [f32; 3], Place)) {
        self.some(self.config.points, random, take);
    }

    #[inline]
    fn some(&self, points: usize, random: &mut Stream, mut take: impl FnMut([f32; 3], [f32; 3], Place)) {
        let vertices = some_of(self.mesh.positions().len(), self.config.vertices.min(points), random);
        for &v in &vertices {
            take(self.mesh.positions()[v as usize], self.vertex_normals()[v as usize], Place::Vertex(v));
        }
        draws(points - vertices.len(), random, |bits, on_it| {
            let point = SurfacePoint { triangle: self.alias.pick(bits), barycentric: folded(on_it) };
            let (position, normal) = self.on(&point);
            take(position, normal, Place::Surface(point));
        });
    }

    /// The cloud of given places.
    pub fn at(&self, places: Vec<Place>) -> Cloud {
        let point = |place: &Place| match place {
            Place::Vertex(v) => (self.mesh.positions()[*v as usize], self.vertex_normals()[*v as usize]),
            Place::Surface(point) => self.on(point),
        };
        let (positions, normals) = places.iter().map(point).unzip();
        Cloud { positions, normals, places }
    }

    fn vertex_normals(&self) -> &[[f32; 3]] {
        self.vertex_normals.get_or_init(|| normals_by_angle(self.mesh).into())
    }

    #[inline]
    fn on(&self, point: &SurfacePoint) -> ([f32; 3], [f32; 3]) {
        let Face { corner, along, across, normal } = self.faces[point.triangle as usize];
        let [_, u, v] = point.barycentric;
        ((corner + along * u + across * v).into(), normal.into())
    }
}

/// Random numbers for points: 48 bits for the triangle, two of 24 in [0, 1) for the place on it. Taken
/// from the stream in blocks, which costs a third of taking them one by one.
#[inline]
pub(crate) fn draws(count: usize, random: &mut Stream, mut take: impl FnMut(u64, [f32; 2])) {
    const WORDS: usize = 3;
    let mut block = [0u8; 4 * WORDS * 128];
    let mut left = count;
    while left > 0 {
        let now = left.min(128);
        let bytes = &mut block[..4 * WORDS * now];
        random.bytes(bytes);
        for words in bytes.as_chunks::<4>().0.as_chunks::<WORDS>().0 {
            let [a, b, c] = words.map(u32::from_le_bytes);
            // The last bits of the numbers that need but 24.
            let bits = u64::from(a) << 16 | u64::from(b & 0xff) << 8 | u64::from(c & 0xff);
            let unit = |word: u32| (word >> 8) as f32 * (1.0 / 16_777_216.0);
            take(bits, [unit(b), unit(c)]);
        }
        left -= now;
    }
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
    /// What a triangle weighs, by its doubled area along its normal.
    pub(crate) fn weight(self, area: Vec3A) -> f64 {
        match self {
            Self::Area => f64::from(area.length()),
            Self::SquaredArea => f64::from(area.length()).powi(2),
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
        let mut rows = vec![[7.0; 6]; 101];
        CloudSampler::new(&mesh(), &config).fill(&mut stream(1, "test", &[]), &mut rows);
        let same =
            rows.iter().zip(cloud.positions.iter().zip(&cloud.normals)).all(|(r, (p, n))| r[..3] == *p && r[3..] == *n);
        assert!(same && rows[100] == [7.0; 6]);
    }
}
