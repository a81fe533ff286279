//! Procedural rigged creatures: training data without files, and ground truth for tests.
//!
//! A [`Plan`] describes a body as joints, limbs with elliptical cross-sections and pieces apart
//! (eyes, fins). The one idea: **one function gives surface and weights.** The limbs' distances,
//! joined with fillets to the limbs they grow from, are the implicit function whose zero set is
//! meshed; the same distances, added up along the tree, say how far a joint's weights reach. So
//! weights follow limbs and never jump the air between two of them.
//!
//! The mesh is a dual contour of an octree whose cells follow the thickness of parts, closed and
//! manifold also where two sheets of skin pass through one cell; surface nets on a regular grid, as
//! libraries have them, would need millions of cells to show a finger.
//!
//! Holds: the same seed, index and options give the same bytes on every machine (no platform
//! sines); any index can be made alone; at most four influences a vertex; every joint holds some.
//! Not held: in a few creatures of a hundred the tip of a thin limb is a component of its own.
//! Leaves out: files, textures, springs, how well creatures stand in for real rigs.

mod assemble;
mod body;
mod cells;
mod dice;
mod field;
mod net;
mod part;
mod piece;
mod plan;
mod plans;
mod skin;
mod surface;
mod turn;

use std::ops::{Range, RangeInclusive};

use rayon::prelude::*;
use riglab_core::{Asset, Provenance};

pub use plan::Plan;

use crate::assemble::{Finish, assemble, rig};
use crate::dice::Dice;
use crate::turn::pow;

/// What creatures to make.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Body plans; creature `i` has plan `i` modulo their number, so any run of indices is balanced.
    /// Must not be empty.
    pub plans: Vec<Plan>,
    /// Triangles of a creature, drawn evenly by order of magnitude. Mostly met to a tenth; thin parts
    /// (fingers, tails, ears) need cells of their own size, so the count may double for a wish of
    /// 2,000 and seldom be half as much again for one of 5,000.
    pub triangles: RangeInclusive<u32>,
}

impl Default for Options {
    fn default() -> Self {
        Self { plans: Plan::ALL.to_vec(), triangles: 2_000..=8_000 }
    }
}

/// Creature number `index` of a seed.
pub fn creature(seed: u64, index: u64, options: &Options) -> Asset {
    let plan = options.plans[(index % options.plans.len() as u64) as usize];
    let mut dice = Dice::new(riglab_random::stream(seed, "creature", &[index]));
    let (least, most) = (*options.triangles.start() as f32, *options.triangles.end() as f32);
    let target = (least * pow(most / least, dice.between(0.0, 1.0))) as u32;
    let finish = Finish {
        target,
        accepted: options.triangles.clone(),
        adaption: dice.between(0.4, 0.8),
        softness: dice.between(0.35, 0.9),
    };
    let body = plan.body(&mut dice, target);
    Asset {
        name: format!("{}-{seed}-{index:06}", plan.name()),
        rig: rig(&body, assemble(&body, &finish)),
        clips: vec![],
        provenance: Provenance {
            source: format!("riglab synth seed {seed} index {index}"),
            licence: "CC0-1.0".into(),
            category: plan.category().into(),
            ..Provenance::default()
        },
    }
}

/// The creatures of a range of indices, in order, made on all cores.
pub fn creatures(seed: u64, indices: Range<u64>, options: &Options) -> Vec<Asset> {
    indices.into_par_iter().map(|index| creature(seed, index, options)).collect()
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use super::*;

    fn some() -> Vec<Asset> {
        creatures(3, 0..18, &Options::default())
    }

    #[test]
    fn every_plan_gives_rigs_whose_weights_are_smooth_and_few() {
        for asset in some() {
            let (rig, name) = (&asset.rig, &asset.name);
            let joints = rig.skeleton().len();
            assert!((10..=60).contains(&joints), "{name}: {joints} joints");
            let triangles = rig.mesh().triangles().len();
            assert!((1_800..=8_800).contains(&triangles), "{name}: {triangles} triangles");
            let rows = rig.weights();
            assert!((0..rows.rows()).all(|v| (1..=4).contains(&rows.row(v).len())), "{name}");
            // Along an edge little weight moves from joint to joint.
            let mut moved = Vec::new();
            for t in rig.mesh().triangles() {
                let [a, b] = [t[0], t[1]].map(|v| rows.row(v as usize).collect::<Vec<_>>());
                let share =
                    |row: &[(riglab_core::JointId, f32)], j| row.iter().find(|(k, _)| *k == j).map_or(0.0, |p| p.1);
                moved.push(a.iter().map(|&(j, w)| (w - share(&b, j)).max(0.0)).sum::<f32>());
            }
            moved.sort_by(f32::total_cmp);
            let most = moved[moved.len() * 98 / 100];
            assert!(most < 0.6, "{name}: {most} moves along one edge in fifty");
        }
    }

    #[test]
    fn counts_of_triangles_follow_the_wish() {
        let asked = Options { triangles: 5_000..=5_000, ..Options::default() };
        for asset in creatures(3, 0..18, &asked) {
            let triangles = asset.rig.mesh().triangles().len();
            assert!((4_500..=7_500).contains(&triangles), "{}: {triangles} triangles", asset.name);
        }
    }

    #[test]
    fn every_joint_moves_something_and_stands_alone() {
        for asset in some() {
            let (rig, skeleton) = (&asset.rig, asset.rig.skeleton());
            let mut held = vec![0.0; skeleton.len()];
            (0..rig.weights().rows()).flat_map(|v| rig.weights().row(v)).for_each(|(j, w)| held[j.index()] += w);
            let least = 1e-3 * rig.bounds().diagonal();
            for joint in skeleton.ids() {
                let name = format!("{}: {}", asset.name, skeleton.name(joint));
                assert!(held[joint.index()] > 0.0, "{name} holds nothing");
                let head = skeleton.head(joint);
                let square = |p: [f32; 3]| (0..3).map(|k| (p[k] - head[k]).powi(2)).sum::<f32>();
                let near = |&other: &riglab_core::JointId| square(skeleton.head(other)) < least * least;
                // Lobes of a tail fin share their root.
                let same = skeleton.ids().filter(|&o| o != joint).find(near);
                let lobes = |o: riglab_core::JointId| [joint, o].iter().all(|&j| skeleton.name(j).starts_with("tail_"));
                assert!(same.is_none_or(lobes), "{name} lies on another joint");
            }
        }
    }

    #[test]
    fn surfaces_are_closed() {
        for asset in some() {
            let mut edges: HashMap<(u32, u32), i32> = HashMap::new();
            for t in asset.rig.mesh().triangles() {
                for k in 0..3 {
                    let (a, b) = (t[k], t[(k + 1) % 3]);
                    *edges.entry((a.min(b), a.max(b))).or_default() += if a < b { 1 } else { -1 };
                }
            }
            assert!(edges.values().all(|&n| n == 0), "{}: an edge with one side", asset.name);
        }
    }

    #[test]
    fn left_and_right_are_where_they_belong() {
        for asset in some() {
            let skeleton = asset.rig.skeleton();
            for joint in skeleton.ids() {
                let (name, x) = (skeleton.name(joint).to_lowercase(), skeleton.head(joint)[0]);
                // A tail fin's lobes share their root.
                if name.contains("left") && !name.contains("tail") {
                    assert!(x > 0.0, "{}: {name} at x = {x}", asset.name);
                }
                if name.contains("right") && !name.contains("tail") {
                    assert!(x < 0.0, "{}: {name} at x = {x}", asset.name);
                }
            }
        }
    }

    #[test]
    fn joints_lie_in_the_body_or_close_to_it() {
        for asset in some() {
            let (rig, diagonal) = (&asset.rig, asset.rig.bounds().diagonal());
            for joint in rig.skeleton().ids() {
                let head = rig.skeleton().head(joint);
                let square = |p: &[f32; 3]| (0..3).map(|k| (p[k] - head[k]).powi(2)).sum::<f32>();
                let nearest = rig.mesh().positions().iter().map(square).fold(f32::INFINITY, f32::min).sqrt();
                assert!(nearest < 0.2 * diagonal, "{}: {}", asset.name, rig.skeleton().name(joint));
            }
        }
    }

    #[test]
    fn a_creature_is_the_same_alone_and_among_others() {
        let all = creatures(5, 0..6, &Options::default());
        for (k, asset) in all.iter().enumerate() {
            assert_eq!(*asset, creature(5, k as u64, &Options::default()));
        }
        assert_ne!(all[0].rig, creature(6, 0, &Options::default()).rig);
    }

    #[test]
    fn bytes_do_not_drift() {
        // Whoever changes a plan on purpose changes these.
        let digest = |plan: Plan| {
            let asset = creature(1, 0, &Options { plans: vec![plan], ..Options::default() });
            let mut hash = blake3::Hasher::new();
            for x in asset.rig.mesh().positions().iter().flatten().chain(asset.rig.weights().weights()) {
                hash.update(&x.to_le_bytes());
            }
            asset.rig.mesh().triangles().iter().flatten().for_each(|v| {
                hash.update(&v.to_le_bytes());
            });
            hash.finalize().to_hex()[..16].to_string()
        };
        assert_eq!(Plan::ALL.map(digest), ["b44aad35b794d68e", "99c73767440fa803", "0e57c1821b7dc9d5"]);
    }
}
