//! Procedural rigged creatures: training data without files, and ground truth for tests.
//!
//! A [`Plan`] describes a body as joints, limbs with elliptical cross-sections and pieces apart
//! (eyes, fins, clothes, parts of machines). The one idea: **one function gives surface and
//! weights.** The limbs' distances, joined with fillets to the limbs they grow from, are the implicit
//! function whose zero set is meshed; the same distances, added up along the tree, say how far a
//! joint's weights reach. So weights follow limbs and never jump the air between two of them.
//!
//! The mesh is a dual contour of an octree whose cells follow the thickness of parts, closed and
//! manifold also where two sheets of skin pass through one cell; surface nets on a regular grid, as
//! libraries have them, would need millions of cells to show a finger.
//!
//! A creature of a plan is then varied as any may be: bent into another rest pose, put together from
//! blocks, given the joints without flesh that exporters write. Avatars have VRM's map of bones; hair,
//! cloth, tails and ears are on spring bones.
//! `cargo run --release -p riglab-synth --example creatures -- FOLDER` draws creatures of each plan,
//! writes their files and prints what they are like.
//!
//! Holds: the same seed, index and options give the same bytes on every machine (no platform
//! sines); any index can be made alone; at most four influences a vertex; every joint holds some,
//! but for those that some of the creatures have as exporters add them: `root` on the ground
//! and an `.._end` at the tip of each last bone. No two joints but lobes of a fin share a place.
//! Not promised: that skin is whole. Smaller cells mend gaps in limbs that are thin for their cells, to
//! a point; parts that are meant to be apart (eyes, clothes, toes) are apart.
//! Leaves out: files, textures, how well creatures stand in for real rigs.

mod assemble;
mod body;
mod cells;
mod dice;
mod field;
mod kit;
mod net;
mod part;
mod piece;
mod plan;
mod plans;
mod pose;
mod skin;
mod springs;
mod surface;
mod turn;
mod variant;

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
    /// Triangles of a creature, 500 to 50,000, drawn evenly by order of magnitude: a wish. Thin
    /// parts (fingers, tails, ears) need cells of their own size: of 280 of the mixture (seed 1) a fifth have more than 6,000
    /// where 4,000 are wished for, at most 2.1 times as many; of 500 to 2,000 a quarter have more than 2,000, at most 3.7 times
    /// as many; of 500 half more than 750, at most 4.6 times. Below 800 creatures are put together from solids.
    pub triangles: RangeInclusive<u32>,
}

impl Default for Options {
    fn default() -> Self {
        Self { plans: Plan::MIXTURE.to_vec(), triangles: 1_000..=14_000 }
    }
}

/// The plan of a creature.
fn plan_of(index: u64, options: &Options) -> Plan {
    options.plans[(index % options.plans.len() as u64) as usize]
}

/// What creature number `index` of a seed is called, told without making it.
pub fn name(seed: u64, index: u64, options: &Options) -> String {
    format!("{}-{seed}-{index:06}", plan_of(index, options).name())
}

/// Where it is from and what it is, told without making it.
pub fn provenance(seed: u64, index: u64, options: &Options) -> Provenance {
    Provenance {
        source: format!("riglab synth seed {seed} index {index}"),
        licence: "CC0-1.0".into(),
        category: plan_of(index, options).category().into(),
        ..Provenance::default()
    }
}

/// Creature number `index` of a seed.
pub fn creature(seed: u64, index: u64, options: &Options) -> Asset {
    let plan = plan_of(index, options);
    let mut dice = Dice::new(riglab_random::stream(seed, "creature", &[index]));
    let (least, most) = (*options.triangles.start() as f32, *options.triangles.end() as f32);
    let target = (least * pow(most / least, dice.between(0.0, 1.0))) as u32;
    let finish = Finish {
        target,
        accepted: options.triangles.clone(),
        adaption: dice.between(0.4, 0.8),
        softness: dice.between(0.35, 0.9),
    };
    let body = plan.body(&mut dice, target).varied(&mut dice, target);
    Asset {
        name: name(seed, index, options),
        rig: rig(&body, assemble(&body, &finish)),
        clips: vec![],
        provenance: provenance(seed, index, options),
    }
}

/// The creatures of a range of indices, in order, made on all cores.
pub fn creatures(seed: u64, indices: Range<u64>, options: &Options) -> Vec<Asset> {
    indices.into_par_iter().map(|index| creature(seed, index, options)).collect()
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, HashMap};
    use std::sync::LazyLock;

    use super::*;

    /// Five creatures of each plan.
    fn some() -> &'static [Asset] {
        static SOME: LazyLock<Vec<Asset>> = LazyLock::new(|| {
            let of = |plan| creatures(3, 0..5, &Options { plans: vec![plan], triangles: 1_000..=8_000 });
            Plan::ALL.into_iter().flat_map(of).collect()
        });
        &SOME
    }

    /// Whether a joint is one that exporters add: the ground above the root, the ends of bones.
    fn bare(name: &str) -> bool {
        name == "root" || name.ends_with("_end")
    }

    #[test]
    fn every_plan_gives_rigs_whose_weights_are_smooth_and_few() {
        for asset in some() {
            let (rig, name) = (&asset.rig, &asset.name);
            let joints = rig.skeleton().len();
            assert!((2..=150).contains(&joints), "{name}: {joints} joints");
            let triangles = rig.mesh().triangles().len();
            assert!((700..=13_000).contains(&triangles), "{name}: {triangles} triangles");
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
            let most = moved[moved.len() * 95 / 100];
            // Where a sheet or a box is a few triangles large there is no room to be smooth.
            assert!(most < 0.6 || triangles < 2_500, "{name}: {most} moves along one edge in twenty");
        }
    }

    #[test]
    fn counts_of_triangles_follow_the_wish() {
        let all = &Plan::ALL[..];
        for (wish, plans) in [(500, all), (4_000, all), (50_000, &[Plan::Quadruped])] {
            for &plan in plans {
                let asked = Options { plans: vec![plan], triangles: wish..=wish };
                for asset in creatures(3, 0..2, &asked) {
                    let times = asset.rig.mesh().triangles().len() as f32 / wish as f32;
                    let most = if wish < 1_000 { 5.0 } else { 2.6 };
                    assert!((0.6..most).contains(&times), "{}: {times} times {wish} triangles", asset.name);
                }
            }
        }
        // Made of pieces alone, which are divided as far as it takes.
        for (plan, index) in [(Plan::Fixture, 4), (Plan::Prop, 9), (Plan::Machine, 0)] {
            let made = creature(2, index, &Options { plans: vec![plan], triangles: 50_000..=50_000 });
            let triangles = made.rig.mesh().triangles().len();
            assert!((45_000..55_000).contains(&triangles), "{}: {triangles} triangles", made.name);
        }
    }

    /// Small fixtures enough that each of the seven kinds of them comes up: by the joints that tell kinds apart.
    fn fixtures() -> Vec<Asset> {
        let all = creatures(3, 0..60, &Options { plans: vec![Plan::Fixture], triangles: 1_000..=1_500 });
        for told in ["item", "body_2", "lid", "moving", "hook", "neck", "moving_1"] {
            let has = |asset: &Asset| asset.rig.skeleton().names().iter().any(|name| name == told);
            assert!(all.iter().any(has), "no fixture has a joint `{told}`");
        }
        all
    }

    /// A biped whose twist joints would end in its knees and elbows, and a plant of which two branches would grow in one
    /// place.
    fn crowded() -> [Asset; 2] {
        let of = |plan, seed, index, triangles| creature(seed, index, &Options { plans: vec![plan], triangles });
        [of(Plan::Biped, 9, 133, 1_000..=14_000), of(Plan::Prop, 22, 32, 500..=900)]
    }

    #[test]
    fn every_joint_moves_something_and_stands_alone() {
        for asset in some().iter().chain(&fixtures()).chain(&crowded()) {
            let (rig, skeleton) = (&asset.rig, asset.rig.skeleton());
            let mut held = vec![0.0; skeleton.len()];
            (0..rig.weights().rows()).flat_map(|v| rig.weights().row(v)).for_each(|(j, w)| held[j.index()] += w);
            let least = 1e-3 * rig.bounds().diagonal();
            for joint in skeleton.ids() {
                let name = format!("{}: {}", asset.name, skeleton.name(joint));
                assert!(held[joint.index()] > 0.0 || bare(skeleton.name(joint)), "{name} holds nothing");
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
    fn left_and_right_are_where_they_belong() {
        for asset in some() {
            let skeleton = asset.rig.skeleton();
            for joint in skeleton.ids() {
                let name = skeleton.name(joint);
                let other = [("Left", "Right"), ("left", "right"), ("_L_", "_R_"), (".L", ".R"), ("_l", "_r")]
                    .iter()
                    .find_map(|(l, r)| name.contains(l).then(|| name.replace(l, r)));
                let Some(other) = other.and_then(|o| skeleton.ids().find(|&k| skeleton.name(k) == o)) else { continue };
                // A tail fin's lobes share their root.
                if other != joint && !name.contains("tail") {
                    let (left, right) = (skeleton.head(joint)[0], skeleton.head(other)[0]);
                    assert!(left > right, "{}: {name} at x = {left}, its twin at {right}", asset.name);
                }
            }
        }
    }

    #[test]
    fn joints_lie_in_the_body_or_close_to_it() {
        for asset in some() {
            let (rig, diagonal) = (&asset.rig, asset.rig.bounds().diagonal());
            // To the nearest of all vertices, and of those of which the joint holds a fifth: a joint in another's limb
            // is close to the body, but not to what it moves.
            let mut nearest = vec![[f32::INFINITY; 2]; rig.skeleton().len()];
            for (v, &p) in rig.mesh().positions().iter().enumerate() {
                let square = |head: [f32; 3]| (0..3).map(|k| (p[k] - head[k]).powi(2)).sum::<f32>();
                for (&head, [any, _]) in rig.skeleton().heads().iter().zip(&mut nearest) {
                    *any = any.min(square(head));
                }
                for (joint, _) in rig.weights().row(v).filter(|(_, w)| *w > 0.2) {
                    let own = &mut nearest[joint.index()][1];
                    *own = own.min(square(rig.skeleton().head(joint)));
                }
            }
            for joint in rig.skeleton().ids().filter(|&j| !bare(rig.skeleton().name(j))) {
                let [any, own] = nearest[joint.index()].map(|square| square.sqrt() / diagonal);
                let name = format!("{}: {}", asset.name, rig.skeleton().name(joint));
                assert!(any < 0.13, "{name} is {any} diagonals from the body");
                // A skirt of few triangles has none between its waist and its hem.
                assert!(own < 0.16, "{name} is {own} diagonals from what it holds");
            }
        }
    }

    #[test]
    fn outsides_are_outside() {
        // By components: one part that is inside out would not show in the sum.
        for asset in some() {
            let mesh = asset.rig.mesh();
            let roots = crate::surface::components(mesh.positions().len(), mesh.triangles());
            let mut parts: BTreeMap<u32, Vec<[u32; 3]>> = BTreeMap::new();
            mesh.triangles().iter().for_each(|t| parts.entry(roots[t[0] as usize]).or_default().push(*t));
            for (first, part) in parts {
                // Each edge of a closed surface is passed as often one way as the other.
                let mut edges: HashMap<(u32, u32), i32> = HashMap::new();
                let sides = part.iter().flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])]);
                sides.for_each(|(a, b)| *edges.entry((a.min(b), a.max(b))).or_default() += if a < b { 1 } else { -1 });
                if edges.values().any(|&n| n != 0) {
                    continue;
                }
                // About a point of its own, in f64: parts are small and far from the middle.
                let at = |v: u32| glam::DVec3::from(mesh.positions()[v as usize].map(f64::from));
                let about = at(first);
                let six: f64 = (part.iter().map(|t| t.map(|v| at(v) - about))).map(|[a, b, c]| a.dot(b.cross(c))).sum();
                let held = asset.rig.weights().row(first as usize).map(|(j, _)| asset.rig.skeleton().name(j));
                assert!(six > 0.0, "{}: inside out at {}", asset.name, held.collect::<Vec<_>>().join(", "));
            }
        }
    }

    #[test]
    fn every_triangle_has_an_area() {
        let winged = Options { plans: vec![Plan::Dragon, Plan::Monster], triangles: 2_500..=4_000 };
        for asset in some().iter().chain(&creatures(3, 0..24, &winged)) {
            let (mesh, diagonal) = (asset.rig.mesh(), f64::from(asset.rig.bounds().diagonal()));
            for t in mesh.triangles() {
                let [a, b, c] = t.map(|v| glam::DVec3::from(mesh.positions()[v as usize].map(f64::from)));
                let area = 0.5 * (b - a).cross(c - a).length();
                let held = asset.rig.weights().row(t[0] as usize).map(|(j, _)| asset.rig.skeleton().name(j));
                let of = || format!("{}: {area} at {}", asset.name, held.collect::<Vec<_>>().join(", "));
                assert!(area > LEAST_AREA * diagonal * diagonal, "{}", of());
            }
        }
    }

    /// In squares of a creature's diagonal. The slivers of the skin have a hundred times as much.
    const LEAST_AREA: f64 = 1e-11;

    #[test]
    fn avatars_have_springs_and_a_map_of_bones() {
        for asset in creatures(4, 0..6, &Options { plans: vec![Plan::Anime], ..Options::default() }) {
            assert!(asset.rig.humanoid().is_complete(), "{}", asset.name);
            assert!(asset.rig.springs().springs().len() >= 4 && !asset.rig.springs().colliders().is_empty());
            for (bone, joint) in asset.rig.humanoid().iter() {
                let name = asset.rig.skeleton().name(joint);
                assert!(name.starts_with("J_"), "{bone} is {name}");
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
            let mut hash = blake3::Hasher::new();
            for asset in creatures(1, 0..3, &Options { plans: vec![plan], triangles: 1_000..=5_000 }) {
                let rig = &asset.rig;
                let heads = rig.skeleton().heads().iter().flatten();
                let swings = rig.springs().springs().iter().flat_map(|s| &s.joints).map(|j| &j.swing.stiffness);
                for x in
                    rig.mesh().positions().iter().flatten().chain(rig.weights().weights()).chain(heads).chain(swings)
                {
                    hash.update(&x.to_le_bytes());
                }
                rig.mesh().triangles().iter().flatten().for_each(|v| {
                    hash.update(&v.to_le_bytes());
                });
                rig.skeleton().names().iter().for_each(|name| {
                    hash.update(name.as_bytes());
                });
            }
            format!("{} {}", plan.name(), &hash.finalize().to_hex()[..16])
        };
        let known = include_str!("../tests/digests.txt").lines().map(str::to_owned).collect::<Vec<_>>();
        assert_eq!(Plan::ALL.map(digest).to_vec(), known);
    }
}
