//! Models that do not look along z.
//!
//! Rigs that a network learned from mostly look along z (or x as their makers left them); a model that stands otherwise it
//! knows by little, and what it draws for it is far from any body. Where the mesh would be its own mirror image if it were
//! turned about the vertical ([`symmetric_yaw`]), some skeletons are drawn of it as it stands, turned so, and turned half
//! round from there. What is drawn of a body that the network knows agrees; if that of a turned one does so far better than
//! that of the mesh as it stands, the turned one is what is looked at from then on, and what comes of it is turned back
//! (`eval.turn`, an extension). Of both turned ones that agree, the likelier is taken, but one that is
//! nearly half round only if it is likelier by far than the small turn: people turn models a little more often than back to
//! front.

use riglab_core::{Bounds, Mesh, Rig, RigError, Similarity, Skeleton, Vec3};
use riglab_geom::{SurfaceSampler, Yaw, mirror_plane, symmetric_yaw};
use riglab_metric::{Joints, disagreement};
use riglab_nn::params::Weights;
use riglab_random::stream;

use super::{RigSample, Rigger};
use crate::assets::Up;
use crate::unirig_skeleton::evaluate::joints;

/// Points that symmetry is told by.
const POINTS: usize = 1024;
/// Skeletons that are drawn of each way to stand.
const TRIES: usize = 16;
/// How far apart skeletons of a turned mesh may be on average, over those of the mesh as it stands.
const NEARER: f64 = 0.8;
/// Half round from a turn of so many degrees at most a model is taken to stand
const SMALL: i32 = 60;
/// only if what is drawn of it is likelier by so much than with the small turn, in nats a token. Of two models turned by 11 and
/// 20 degrees the wrong way round had up to .36 more.
const LIKELIER: f64 = 0.5;

/// How a mesh in the network's axes is turned before it is looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Facing {
    yaw: Yaw,
    up: Up,
}

impl Facing {
    /// The turn, of rigs as riglab has them, y up.
    pub fn yaw(self) -> Yaw {
        self.yaw
    }

    /// Whether all stays as it is.
    pub fn is_none(self) -> bool {
        self.yaw == Yaw::NONE
    }

    fn turn(self, p: Vec3) -> Vec3 {
        if self.is_none() { p } else { self.up.turn(self.yaw.apply(self.up.back(p))) }
    }

    /// A point that was turned, as it was.
    pub fn back(self, p: Vec3) -> Vec3 {
        Self { yaw: self.yaw.inverse(), ..self }.turn(p)
    }

    /// A mesh, turned.
    ///
    /// # Errors
    /// None for the points of a mesh.
    pub fn mesh(self, mesh: &Mesh) -> Result<Mesh, RigError> {
        mesh.with_positions(mesh.positions().iter().map(|&p| self.turn(p)).collect())
    }

    /// A skeleton, turned.
    ///
    /// # Errors
    /// None for the joints of a skeleton.
    pub fn skeleton(self, skeleton: &Skeleton) -> Result<Skeleton, RigError> {
        skeleton.with_heads(skeleton.heads().iter().map(|&p| self.turn(p)).collect())
    }

    /// A rig, turned and in the cube again, and the map into it; without its springs.
    ///
    /// # Errors
    /// None for a rig.
    pub fn rig(self, rig: &Rig) -> Result<(Rig, Similarity), RigError> {
        let turned = Rig::new(self.skeleton(rig.skeleton())?, self.mesh(rig.mesh())?, rig.weights().clone())?;
        Ok(turned.normalized())
    }
}

impl Rigger {
    /// How a mesh in the network's axes is to be turned; not at all unless `eval.turn` says so.
    ///
    /// # Errors
    /// As [`Self::draw_skeletons`].
    pub(crate) fn facing(&self, w: &Weights, mesh: &Mesh, key: u64) -> Result<Facing, String> {
        let (c, stays) = (&self.config, Facing { yaw: Yaw::NONE, up: self.config.data.up });
        if !c.eval.turn {
            return Ok(stays);
        }
        let points: Vec<Vec3> = self.surface(mesh, key).map(|p| stays.up.back(p)).collect();
        let Some(yaw) = symmetric_yaw(&points) else { return Ok(stays) };
        let ways = [Yaw::NONE, yaw, yaw.about()].map(|yaw| Facing { yaw, ..stays });
        let mut meshes = Vec::with_capacity(ways.len());
        for way in ways {
            let turned = way.mesh(mesh).map_err(|e| e.to_string())?;
            let bounds = Bounds::of(turned.positions().iter().copied()).ok_or("a mesh without vertices")?;
            let map = Similarity::into_cube(bounds);
            let in_cube = turned.with_positions(turned.positions().iter().map(|&p| map.apply(p)).collect());
            meshes.push(in_cube.map_err(|e| e.to_string())?);
        }
        let seen = self.condition(w, &meshes.iter().map(|mesh| (mesh, key)).collect::<Vec<_>>());
        let mut streams: Vec<_> =
            (0..(ways.len() * TRIES) as u64).map(|k| stream(c.eval.seed, "turned draws", &[key, k])).collect();
        let drawn = self.draw_skeletons(w, &seen, (&self.free(), &[TRIES]), &c.eval.generate, &mut streams)?;
        let told: Vec<Evidence> = drawn.chunks(TRIES).map(Evidence::of).collect();
        Ok(ways[chosen(&told, yaw.in_degrees().abs() <= SMALL)])
    }

    /// The x of the plane in whose mirror a mesh as it is looked at is its own image; `None` where there is none, and unless
    /// `eval.symmetric` says so.
    pub(super) fn mirror_plane(&self, mesh: &Mesh, key: u64) -> Option<f64> {
        let points = || mirror_plane(&self.surface(mesh, key).collect::<Vec<_>>());
        self.config.eval.symmetric.then(points).flatten()
    }

    /// Points of a surface that tell its symmetry.
    fn surface(&self, mesh: &Mesh, key: u64) -> impl Iterator<Item = Vec3> {
        let mut random = stream(self.config.eval.seed, "symmetry", &[key]);
        let sampler = SurfaceSampler::new(mesh);
        (0..POINTS).map(move |_| sampler.position(&sampler.draw(&mut random)))
    }
}

/// What draws tell of a way to stand.
struct Evidence {
    /// How far they are apart, on average.
    apart: f64,
    /// How likely a token of theirs is, in nats, on average over draws.
    likely: f64,
}

impl Evidence {
    /// Of the draws that are skeletons; nothing good where fewer than two are.
    fn of(drawn: &[RigSample]) -> Self {
        let skeletons: Vec<Joints> = drawn.iter().filter_map(|d| Some(joints(d.decoded.as_ref().ok()?))).collect();
        let whole = drawn.iter().filter(|d| d.decoded.is_ok());
        let sum: f64 = whole.map(|d| d.likelihood.0 / d.likelihood.1.max(1) as f64).sum();
        match skeletons.len() {
            0 | 1 => Self { apart: f64::INFINITY, likely: f64::NEG_INFINITY },
            count => Self { apart: disagreement(&skeletons), likely: sum / count as f64 },
        }
    }
}

/// Which way to stand: the first, as it stands, unless draws of others are nearer to each other by enough. The second is a
/// `small` turn or not, and the third half round from there.
fn chosen(told: &[Evidence], small: bool) -> usize {
    let likelier = |a: usize, b: usize, by: f64| told[b].likely > told[a].likely + by;
    // Whether the small turn agrees or not.
    let unlikely = |way: usize| small && way == 2 && !likelier(1, 2, LIKELIER);
    let nearer = |&way: &usize| told[way].apart < NEARER * told[0].apart && !unlikely(way);
    (1..told.len()).filter(nearer).reduce(|a, b| if likelier(a, b, 0.0) { b } else { a }).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use riglab_nn::tokenrig::Head;

    use super::*;
    use crate::tokenrig::RigRequest;
    use crate::tokenrig::testing::{tetrahedron, untrained};

    fn facing(degrees: i32, up: Up) -> Facing {
        Facing { yaw: Yaw::degrees(degrees), up }
    }

    #[test]
    fn turns_are_about_what_points_up_and_go_back() {
        for up in [Up::Y, Up::Z] {
            let p = up.turn([0.3, 0.2, -0.1]);
            assert_eq!(facing(90, up).turn(p), up.turn([-0.1, 0.2, -0.3]));
            assert_eq!(facing(90, up).back(facing(90, up).turn(p)), p);
            let back = facing(37, up).back(facing(37, up).turn(p));
            assert!(back.iter().zip(p).all(|(a, b)| (a - b).abs() < 1e-6), "{back:?}");
            assert_eq!(facing(0, up).turn(p), p);
        }
    }

    #[test]
    fn a_turned_rig_is_in_the_cube_and_comes_back_by_its_map() {
        let mesh = tetrahedron();
        let joint = |name: &str, parent: Option<u16>, head| riglab_core::Joint {
            name: name.into(),
            parent: parent.map(riglab_core::JointId),
            head,
        };
        let skeleton = Skeleton::new(vec![joint("a", None, [0.0; 3]), joint("b", Some(0), [0.4, 0.1, 0.2])]).unwrap();
        let weights = riglab_core::SkinWeights::normalized((0..mesh.positions().len()).map(|_| [(0, 1.0)])).unwrap();
        let rig = Rig::new(skeleton, mesh, weights).unwrap();
        let facing = facing(45, Up::Y);
        let (turned, map) = facing.rig(&rig).unwrap();
        let longest = turned.bounds().size().into_iter().fold(0.0f32, f32::max);
        assert!((longest - 2.0).abs() < 1e-5);
        let heads = turned.skeleton().heads().iter().zip(rig.skeleton().heads());
        for (there, &own) in heads {
            let back = facing.back(map.inverse().apply(*there));
            assert!(back.iter().zip(own).all(|(a, b)| (a - b).abs() < 1e-5), "{back:?} for {own:?}");
        }
    }

    #[test]
    fn a_mesh_that_is_its_own_image_has_a_plane_where_it_is_asked_for() {
        let corners: Vec<Vec3> = (0..8).map(|k| [k & 1, k >> 1 & 1, k >> 2].map(|far| far as f32 - 0.4)).collect();
        let sides = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];
        let triangles: Vec<[u32; 3]> = sides.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        let cube = Mesh::new(corners, triangles.clone()).unwrap();
        let (mut rigger, whole) = (untrained(Head::Levels, true), |p: f64| (p - 0.1).abs() < 0.02);
        assert_eq!(rigger.mirror_plane(&cube, 0), None, "nobody asks");
        rigger.config.eval.symmetric = true;
        assert!(rigger.mirror_plane(&cube, 0).is_some_and(whole));
        let cut = cube.with_positions(cube.positions().iter().map(|p| [p[0] + p[1], p[1], p[2]]).collect()).unwrap();
        assert_eq!(rigger.mirror_plane(&cut, 0), None);
    }

    #[test]
    fn a_turn_needs_draws_that_agree_far_better() {
        let of = |all: &[(f64, f64)]| {
            let told: Vec<Evidence> = all.iter().map(|&(apart, likely)| Evidence { apart, likely }).collect();
            chosen(&told, false)
        };
        assert_eq!(of(&[(0.3, -2.0), (0.25, -1.0), (0.29, -1.0)]), 0);
        assert_eq!(of(&[(0.3, -2.0), (0.13, -1.7), (0.14, -1.6)]), 2, "the likelier of two that agree");
        assert_eq!(of(&[(0.3, -2.0), (0.13, -1.7), (0.14, -1.7)]), 1, "the first of equals");
        assert_eq!(of(&[(0.3, -2.0), (0.13, -1.7), (0.31, -1.6)]), 1, "one that does not agree counts nothing");
        let none = (f64::INFINITY, f64::NEG_INFINITY);
        assert_eq!(of(&[none, none, none]), 0);
        assert_eq!(of(&[none, none, (0.4, -2.0)]), 2);
        assert_eq!(of(&[(0.4, -2.0), (f64::NAN, -1.0), none]), 0);
        // Half round from a small turn only if that is likelier by far, whether the small turn agrees or not.
        let of_small = |small: f64, half: f64| {
            chosen(&[(0.3, -2.0), (small, -1.7), (0.14, half)].map(|(apart, likely)| Evidence { apart, likely }), true)
        };
        assert_eq!([of_small(0.13, -1.3), of_small(0.13, -1.1)], [1, 2]);
        assert_eq!([of_small(0.29, -1.3), of_small(0.29, -1.1)], [0, 2]);
    }

    #[test]
    fn given_joints_stay_what_they_are_however_the_mesh_is_looked_at() {
        let (rigger, mesh) = (untrained(Head::Levels, true), tetrahedron());
        let turned = facing(37, Up::Y);
        let begun = Skeleton::new(vec![riglab_core::Joint {
            name: "own".into(),
            parent: None,
            head: [0.123_456_7, 0.2, -0.05],
        }]);
        let begun = begun.unwrap();
        for complete in [false, true] {
            let wish = RigRequest { skeleton: Some(&begun), complete, samples: Some(3), ..RigRequest::default() };
            let made = rigger.make_facing(&mesh, Some(begun.clone()), &wish, turned).unwrap();
            assert_eq!((made.yaw.in_degrees(), made.weights.rows()), (37, mesh.positions().len()));
            assert_eq!(made.skeleton.head(riglab_core::JointId(0)), begun.head(riglab_core::JointId(0)));
        }
        assert_eq!(rigger.make(&mesh, &RigRequest::default()).unwrap().yaw, Yaw::NONE, "not unless it is asked for");
    }
}
