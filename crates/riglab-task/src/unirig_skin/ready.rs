//! An asset made ready: points with their distances from bones, and the bones.

use riglab_core::{JointId, Segment, Swing, Vec3};
use riglab_geom::CloudConfig;
use riglab_geom::geodesic::GeodesicSolver;
use riglab_geom::voxel::SolidConfig;
use riglab_metric::heat_weights;
use riglab_nn::skin_stage::{ATTRIBUTES, BoneInput};
use riglab_random::{Draw, Stream};

use super::pairs::Around;
use crate::fsq_cvae::{Place, Point, Prepared};

/// A rig in the cube with some of its points.
pub struct Ready {
    /// The rig; its bones are the joints that hold something.
    pub rig: Prepared,
    /// One for each of its bones.
    pub seats: Vec<Seat>,
    /// Points.
    pub points: Vec<Point>,
    /// How far each bone is from each point along ways through the body, a row a point.
    pub distances: Vec<f32>,
    /// Each bone's share of the heat at each point, a row a point; empty where it was not asked for.
    pub heat: Vec<f32>,
}

/// What of the body is measured.
#[derive(Clone, Copy, Debug)]
pub struct Measured {
    /// Cells along its longest side.
    pub resolution: usize,
    /// Whether heat flows over its surface, too.
    pub heat: bool,
}

/// Where a bone sits.
#[derive(Clone, Copy, Debug)]
pub struct Seat {
    /// The joint above, or the joint itself.
    pub parent: Vec3,
    /// The joint.
    pub head: Vec3,
    /// Its tail.
    pub tail: Vec3,
    /// The nearest bone above that holds something.
    pub above: Option<usize>,
    /// How it swings, if it does.
    pub swing: Option<Swing>,
}

impl Ready {
    /// Of a rig and points of it.
    pub fn new(rig: Prepared, points: Vec<Point>, measured: Measured) -> Self {
        let seats = seats(&rig);
        let config = SolidConfig { resolution: measured.resolution, ..SolidConfig::DEFAULT };
        let bones: Vec<&[Segment]> = rig.bones.iter().map(|b| b.segments.as_slice()).collect();
        let positions: Vec<Vec3> = points.iter().map(|p| p.position).collect();
        let by_bone = GeodesicSolver::new(rig.rig.mesh(), &config).distances(&bones, &positions);
        let (n, b) = (points.len(), bones.len());
        let distances = (0..n * b).map(|k| by_bone[(k % b) * n + k / b]).collect();
        let heat = if measured.heat { heat(&rig, &points, &config) } else { Vec::new() };
        Self { seats, points, distances, heat, rig }
    }

    /// Of a rig and a [`pool`] of its points.
    pub fn pooled(rig: Prepared, cloud: &CloudConfig, measured: Measured, random: &mut Stream) -> Self {
        let points = pool(&rig, cloud, random);
        Self::new(rig, points, measured)
    }

    /// What bones know of a point.
    pub fn around(&self, point: usize) -> Around<'_> {
        let b = self.rig.bones.len();
        let row = |all: &'_ [f32]| point * b..((point + 1) * b).min(all.len());
        let heat = if self.heat.is_empty() { &[] } else { &self.heat[row(&self.heat)] };
        Around { distances: &self.distances[row(&self.distances)], heat }
    }

    /// About how many bytes it takes.
    pub fn bytes(&self) -> usize {
        self.rig.bytes() + 4 * (self.distances.len() + self.heat.len()) + size_of::<Point>() * self.points.len()
    }
}

/// Heat of a rig's bones at its points, a row a point: what [`heat_weights`] gives its vertices, and between them.
fn heat(rig: &Prepared, points: &[Point], config: &SolidConfig) -> Vec<f32> {
    let joints: Vec<JointId> = rig.bones.iter().map(|b| b.joint).collect();
    let (mesh, skeleton) = (rig.rig.mesh(), rig.rig.skeleton());
    let weights = heat_weights(mesh, skeleton, &joints, config);
    let mut bone_of = vec![0; skeleton.len()];
    joints.iter().enumerate().for_each(|(b, j)| bone_of[j.index()] = b);
    let mut out = vec![0.0; points.len() * joints.len()];
    for (point, row) in points.iter().zip(out.chunks_exact_mut(joints.len().max(1))) {
        let mut add = |v: u32, share: f32| {
            weights.row(v as usize).for_each(|(j, w)| row[bone_of[j.index()]] += share * w);
        };
        match point.at {
            Place::Vertex(v) => add(v, 1.0),
            Place::Surface(p) => {
                let corners = mesh.triangles()[p.triangle as usize];
                corners.into_iter().zip(p.barycentric).for_each(|(v, share)| add(v, share));
            }
        }
    }
    out
}

/// Points of a rig, in random order: vertices, no two the same, and points of the surface.
pub fn pool(rig: &Prepared, cloud: &CloudConfig, random: &mut Stream) -> Vec<Point> {
    let mut vertices: Vec<u32> = (0..rig.rig.mesh().positions().len() as u32).collect();
    random.shuffled(&mut vertices);
    vertices.truncate(cloud.vertices.min(cloud.points));
    let mut points: Vec<Point> = vertices.iter().map(|&v| rig.vertex(v)).collect();
    points.extend(rig.surface_by(cloud.by, cloud.points - points.len(), random));
    random.shuffled(&mut points);
    points
}

fn seats(rig: &Prepared) -> Vec<Seat> {
    let skeleton = rig.rig.skeleton();
    let (tails, swings) = (skeleton.tails(), rig.rig.springs().by_joint(skeleton.len()));
    let mut place = vec![None; skeleton.len()];
    rig.bones.iter().enumerate().for_each(|(b, bone)| place[bone.joint.index()] = Some(b));
    let seat = |joint: riglab_core::JointId| {
        let mut up = skeleton.parent(joint);
        while let Some(j) = up.filter(|j| place[j.index()].is_none()) {
            up = skeleton.parent(j);
        }
        let head = skeleton.head(joint);
        Seat {
            parent: skeleton.parent(joint).map_or(head, |p| skeleton.head(p)),
            head,
            tail: tails[joint.index()],
            above: up.and_then(|j| place[j.index()]),
            swing: swings[joint.index()].map(|s| s.swing),
        }
    };
    rig.bones.iter().map(|b| seat(b.joint)).collect()
}

impl Seat {
    /// Adds the points that the network sees of it, each under a map.
    pub fn seen(&self, seen: BoneInput, map: impl Fn(Vec3) -> Vec3, out: &mut Vec<f32>) {
        let all: &[Vec3] = match seen {
            BoneInput::Joint => &[self.head],
            BoneInput::ParentAndJoint => &[self.parent, self.head],
            BoneInput::ParentJointAndTail => &[self.parent, self.head, self.tail],
        };
        out.extend(all.iter().flat_map(|&p| map(p)));
    }
}

/// The largest stiffness, power of gravity and hit radius: what VRM's editors offer, and a quarter of the cube. Some
/// files have thousands, which act as these do, and would be all that a squared error sees.
const MOST: [f32; 3] = [4.0, 2.0, 0.5];

/// Attributes as a row: stiffness, drag, power of gravity, its direction, hit radius.
pub fn row(swing: &Swing) -> [f32; ATTRIBUTES] {
    let [x, y, z] = swing.gravity_direction;
    let [stiffness, power, radius] = [swing.stiffness, swing.gravity_power, swing.hit_radius];
    [stiffness.min(MOST[0]), swing.drag, power.min(MOST[1]), x, y, z, radius.min(MOST[2])]
}
