//! An asset made ready: points with their distances from bones, and the bones.

use riglab_core::{Segment, Swing, Vec3};
use riglab_geom::geodesic::GeodesicSolver;
use riglab_geom::voxel::SolidConfig;
use riglab_nn::skin_stage::{ATTRIBUTES, Seen};
use riglab_random::{Draw, Stream};

use crate::fsq_cvae::{Point, Prepared};

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
    pub fn new(rig: Prepared, points: Vec<Point>, resolution: usize) -> Self {
        let seats = seats(&rig);
        let config = SolidConfig { resolution, ..SolidConfig::DEFAULT };
        let bones: Vec<&[Segment]> = rig.bones.iter().map(|b| b.segments.as_slice()).collect();
        let positions: Vec<Vec3> = points.iter().map(|p| p.position).collect();
        let by_bone = GeodesicSolver::new(rig.rig.mesh(), &config).distances(&bones, &positions);
        let (n, b) = (points.len(), bones.len());
        let distances = (0..n * b).map(|k| by_bone[(k % b) * n + k / b]).collect();
        Self { seats, points, distances, rig }
    }

    /// Of a rig and a pool of `count` of its points: vertices, no two the same, up to the share, and points of the
    /// surface.
    pub fn pooled(rig: Prepared, count: usize, vertex_share: f32, resolution: usize, random: &mut Stream) -> Self {
        let points = pool(&rig, count, vertex_share, random);
        Self::new(rig, points, resolution)
    }

    /// Distances of a point.
    pub fn row(&self, point: usize) -> &[f32] {
        let b = self.rig.bones.len();
        &self.distances[point * b..(point + 1) * b]
    }

    /// About how many bytes it takes.
    pub fn bytes(&self) -> usize {
        self.rig.bytes() + 4 * self.distances.len() + size_of::<Point>() * self.points.len()
    }
}

/// Points of a rig, in random order.
pub fn pool(rig: &Prepared, count: usize, vertex_share: f32, random: &mut Stream) -> Vec<Point> {
    let mut vertices: Vec<u32> = (0..rig.rig.mesh().positions().len() as u32).collect();
    random.shuffled(&mut vertices);
    vertices.truncate((count as f32 * vertex_share) as usize);
    let mut points: Vec<Point> = vertices.iter().map(|&v| rig.vertex(v)).collect();
    points.resize_with(count, || rig.surface(random));
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
    pub fn seen(&self, seen: Seen, map: impl Fn(Vec3) -> Vec3, out: &mut Vec<f32>) {
        let all: &[Vec3] = match seen {
            Seen::Joint => &[self.head],
            Seen::ParentAndJoint => &[self.parent, self.head],
            Seen::ParentJointAndTail => &[self.parent, self.head, self.tail],
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
