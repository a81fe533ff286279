//! What can be measured of a rig that says what it is.

use std::collections::{BTreeMap, BTreeSet};

use glam::DVec3;
use riglab_core::Rig;

use super::vocabulary::{Part, creature, pair, part, piece_of_leg, side};
use super::{Category, Limbs};
use crate::shape::{Point, surface};
use crate::words::words;

/// Measured traits. Shares are of joints that are named after anything, lengths of the mesh's height or
/// longest side, as said.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Traits {
    /// Joints.
    pub joints: usize,
    /// Joints that carry weight.
    pub skinned: usize,
    /// The file says which joints are human bones, all that VRM asks for.
    pub vrm: bool,
    /// Joints are named as VRoid (`J_Bip_C_Hips`) or MikuMikuDance (`センター`) names them.
    pub avatar_names: bool,
    /// Joints named after each part.
    pub heads: usize,
    /// Spine, chest, hips.
    pub spines: usize,
    /// Sides with an arm: 2 for a left and a right one.
    pub arms: usize,
    /// Sides with a hand.
    pub hands: usize,
    /// Joints named after fingers.
    pub fingers: usize,
    /// Legs by name: sides times pairs.
    pub legs: usize,
    /// Joints named after tails.
    pub tails: usize,
    /// Sides with a wing, or 1 for wings without side.
    pub wings: usize,
    /// Joints named after feathers and beaks.
    pub feathers: usize,
    /// Joints named after fins.
    pub fins: usize,
    /// Joints named after ears.
    pub ears: usize,
    /// Joints named after parts of insects.
    pub insect: usize,
    /// Joints named after parts of machines, as a share of all.
    pub machine: f64,
    /// Joints whose name means nothing known, as a share of all.
    pub nameless: f64,
    /// The creature that joints are named after, and on what share of them.
    pub named_after: Option<(Category, f64)>,
    /// Separate places where the mesh stands on the ground.
    pub feet: usize,
    /// Width, height, depth over the longest of them.
    pub size: [f64; 3],
    /// Share of the surface that joints named after tails move.
    pub tail_share: f64,
    /// Chains of two to five joints that hang on one joint or on its children, as fingers do on a palm: how
    /// many, and what share of the joints they are.
    pub fan: (usize, f64),
    /// Mean over the surface of the sum of squared weights: 1 where each point moves with one joint alone.
    pub rigidity: f64,
    /// Share of the joints that have a mirror image among the joints, by the plane x = middle.
    pub symmetry: f64,
    /// The longest chain of joints without branch, as a share of the joints.
    pub chain: f64,
    /// Longest way along joints from the root, over the mesh's longest side, mostly horizontal (1) or
    /// upright (-1).
    pub lying: f64,
    /// Pairs of limbs by the tree of joints.
    pub limbs: Limbs,
    /// Pairs of mirrored limbs that end on the ground, as joints say.
    pub limb_pairs_down: usize,
    /// Pairs of mirrored limbs that end above it.
    pub limb_pairs_up: usize,
}

impl Traits {
    /// Measures a rig.
    pub fn of(rig: &Rig) -> Self {
        let mut traits =
            Self { joints: rig.skeleton().len(), skinned: rig.skinned_joints(0.0).len(), ..Self::default() };
        traits.vrm = rig.humanoid().is_complete();
        traits.name_parts(rig);
        let points = surface(rig);
        traits.measure_mesh(rig, &points);
        traits.measure_tree(rig);
        traits
    }

    fn name_parts(&mut self, rig: &Rig) {
        let names = rig.skeleton().names();
        let vroid = names.iter().filter(|n| n.contains("J_Bip_") || n.contains("J_Sec_")).count();
        let mmd = ["センター", "上半身", "下半身"].iter().filter(|w| names.iter().any(|n| n == *w)).count();
        self.avatar_names = 2 * vroid >= names.len() || mmd >= 2;
        let mut sides: BTreeMap<&'static str, BTreeSet<i8>> = BTreeMap::new();
        let mut legs: BTreeSet<(String, i8)> = BTreeSet::new();
        let mut feet: BTreeSet<i8> = BTreeSet::new();
        let mut creatures: BTreeMap<Category, usize> = BTreeMap::new();
        let (mut machine, mut nameless, mut wings) = (0, 0, 0);
        for name in names {
            let words = words(name);
            let mut parts: Vec<Part> = words.iter().filter_map(|w| part(w)).collect();
            let side = side(&words);
            if parts.is_empty() && side.is_some() && piece_of_leg(&words) {
                parts.push(Part::Leg);
            }
            // `CATRig` is a tool.
            let tool = words.iter().any(|w| w == "rig");
            let own: BTreeSet<Category> = words.iter().filter(|_| !tool).filter_map(|w| creature(w)).collect();
            own.into_iter().for_each(|c| *creatures.entry(c).or_default() += 1);
            nameless += usize::from(parts.is_empty());
            // A joint counts once, as the last part that its name says: `leftHandIndex1` is a finger.
            let names = |part: Part| parts.contains(&part);
            // The last part that a name says, but: the end of a wing is no hand (`wing_hand_left`), a leg in
            // the middle no finger, and `LeftToeBase` no machine.
            let leg = names(Part::Leg) || names(Part::Foot);
            let part = if names(Part::Wing) {
                Some(Part::Wing)
            } else if names(Part::Finger) && !leg {
                Some(Part::Finger)
            } else {
                let last = |p: &&Part| **p != Part::Machine && (**p != Part::Finger || !leg);
                parts.iter().rev().find(last).or(parts.last()).copied()
            };
            let Some(part) = part else { continue };
            let is_end = words.last().is_some_and(|w| w == "end" || w == "nub");
            match part {
                Part::Head => self.heads += 1,
                Part::Spine => self.spines += 1,
                Part::Arm => sides.entry("arm").or_default().extend(side),
                Part::Hand => sides.entry("hand").or_default().extend(side),
                Part::Finger => self.fingers += 1,
                Part::Leg => legs.extend(side.map(|side| (pair(&words), side))),
                Part::Foot => feet.extend(side),
                Part::Tail => self.tails += usize::from(!is_end),
                Part::Feather => self.feathers += 1,
                Part::Wing => {
                    wings += 1;
                    sides.entry("wing").or_default().extend(side);
                }
                Part::Fin => self.fins += 1,
                Part::Ear => self.ears += 1,
                Part::Insect => self.insect += 1,
                Part::Machine => machine += 1,
            }
        }
        // Legs that are told apart by numbers alone, as spiders' may be, are counted where they begin.
        let numbered = if legs.iter().all(|(pair, _)| pair.is_empty()) { rooted_legs(rig) } else { 0 };
        self.legs = legs_of(legs).max(feet.len()).max(numbered);
        let n = names.len() as f64;
        let count = |what: &str| sides.get(what).map_or(0, BTreeSet::len);
        self.arms = count("arm");
        self.hands = count("hand");
        self.wings = count("wing").max(usize::from(wings > 0));
        self.machine = f64::from(machine) / n;
        self.nameless = nameless as f64 / n;
        let most = creatures.into_iter().max_by_key(|(_, n)| *n);
        self.named_after = most.map(|(category, joints)| (category, joints as f64 / n));
    }

    fn measure_mesh(&mut self, rig: &Rig, points: &[Point]) {
        let (low, high) =
            points.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), p| (l.min(p.at), h.max(p.at)));
        let size = high - low;
        let longest = size.max_element();
        if !(longest > 0.0 && longest.is_finite()) {
            return;
        }
        self.size = (size / longest).to_array();
        self.feet = feet(points, low, size, longest);
        let weights = rig.weights();
        let of_vertex = |v: u32| weights.row(v as usize).map(|(_, w)| f64::from(w * w)).sum::<f64>();
        let triangles = rig.mesh().triangles();
        let tails: Vec<bool> =
            rig.skeleton().names().iter().map(|n| words(n).iter().any(|w| part(w) == Some(Part::Tail))).collect();
        let of_tails = |v: u32| {
            weights.row(v as usize).map(|(j, w)| if tails[j.index()] { f64::from(w) } else { 0.0 }).sum::<f64>()
        };
        if tails.contains(&true) {
            self.tail_share = points
                .iter()
                .map(|p| {
                    p.area
                        * triangles[p.triangle as usize].iter().zip(p.of).map(|(&v, of)| of * of_tails(v)).sum::<f64>()
                })
                .sum();
        }
        self.rigidity = points
            .iter()
            .map(|p| {
                p.area * triangles[p.triangle as usize].iter().zip(p.of).map(|(&v, of)| of * of_vertex(v)).sum::<f64>()
            })
            .sum();
    }

    fn measure_tree(&mut self, rig: &Rig) {
        let skeleton = rig.skeleton();
        let heads: Vec<DVec3> = skeleton.heads().iter().map(|h| DVec3::from(h.map(f64::from))).collect();
        let (low, high) = heads.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), p| (l.min(*p), h.max(*p)));
        let size = (high - low).max_element();
        if !(size > 0.0 && size.is_finite()) {
            return;
        }
        let mesh = riglab_core::Bounds::of(rig.mesh().positions().iter().copied());
        let (ground, top) = mesh.map_or((low.y, high.y), |b| (f64::from(b.min[1]), f64::from(b.max[1])));
        let center = mesh.map_or(0.5 * (low + high), |b| DVec3::from(b.center().map(f64::from)));
        let tolerance = 0.03 * size;
        let along_x = Mirror::of(&heads, center.x, tolerance);
        // A model that looks along x has its left and right along z: it is turned to look along z.
        let turned: Vec<DVec3> = heads.iter().map(|h| DVec3::new(h.z, h.y, h.x)).collect();
        let along_z = Mirror::of(&turned, center.z, tolerance);
        let (heads, mirror, middle) = if along_z.share > along_x.share + 0.3 {
            self.size.swap(0, 2);
            (turned, along_z, center.z)
        } else {
            (heads, along_x, center.x)
        };
        self.symmetry = mirror.share;
        self.limbs = Limbs::of(skeleton, &heads, ground, top);
        let children = skeleton.children();
        let height = (top - ground).max(f64::MIN_POSITIVE);
        // The ends of chains on one side that have a mirror image.
        let mut ends: Vec<DVec3> = Vec::new();
        for &j in &mirror.paired {
            let near = |e: &DVec3| e.distance(heads[j]) < 0.08 * size;
            if children[j].is_empty() && heads[j].x > middle && !ends.iter().any(near) {
                ends.push(heads[j]);
            }
        }
        let down = |p: &&DVec3| (p.y - ground) / height < 0.2;
        self.limb_pairs_down = ends.iter().filter(down).count();
        self.limb_pairs_up = ends.len() - self.limb_pairs_down;
        // The longest chain without branch.
        let mut run = vec![1usize; heads.len()];
        let mut longest = 1;
        for joint in skeleton.ids().skip(1) {
            let parent = skeleton.parent(joint).map(|p| p.index());
            if let Some(parent) = parent.filter(|&p| children[p].len() == 1) {
                run[joint.index()] = run[parent] + 1;
                longest = longest.max(run[joint.index()]);
            }
        }
        self.chain = longest as f64 / heads.len() as f64;
        self.fan = fan(&children);
        // Bones near the middle plane: the spine, tail and neck.
        let (mut flat, mut upright) = (0.0, 0.0);
        for joint in skeleton.ids().skip(1) {
            let Some(parent) = skeleton.parent(joint) else { continue };
            let (a, b) = (heads[parent.index()], heads[joint.index()]);
            if (a.x - middle).abs() < tolerance && (b.x - middle).abs() < tolerance {
                flat += (b - a).z.abs();
                upright += (b - a).y.abs();
            }
        }
        self.lying = if flat + upright > 0.0 { (flat - upright) / (flat + upright) } else { 0.0 };
    }
}

/// Which joints have a mirror image among the joints.
struct Mirror {
    paired: Vec<usize>,
    /// Share of those beside the middle; 1 without any.
    share: f64,
}

impl Mirror {
    fn of(heads: &[DVec3], middle: f64, tolerance: f64) -> Self {
        let partner = |j: usize| {
            let to = DVec3::new(2.0 * middle - heads[j].x, heads[j].y, heads[j].z);
            (0..heads.len()).any(|i| i != j && heads[i].distance(to) < tolerance)
        };
        let aside: Vec<usize> = (0..heads.len()).filter(|&j| (heads[j].x - middle).abs() > tolerance).collect();
        // Of very many joints a part says enough; comparing all with all takes long.
        let sample = &aside[..aside.len().min(600)];
        let paired: Vec<usize> = sample.iter().copied().filter(|&j| partner(j)).collect();
        let share = if sample.is_empty() { 1.0 } else { paired.len() as f64 / sample.len() as f64 };
        Self { paired, share }
    }
}

/// Chains like fingers, as many as hang on one joint, directly or by one joint between.
fn fan(children: &[Vec<riglab_core::JointId>]) -> (usize, f64) {
    // The length of the chain from a joint to its end; nothing where it branches.
    let mut length: Vec<Option<usize>> = vec![None; children.len()];
    for joint in (0..children.len()).rev() {
        length[joint] = match children[joint].as_slice() {
            [] => Some(1),
            [one] => length[one.index()].map(|l| l + 1),
            _ => None,
        };
    }
    let fingers =
        |joint: usize| children[joint].iter().filter_map(|c| length[c.index()]).filter(|l| (2..=5).contains(l));
    let most = (0..children.len()).map(|j| (fingers(j).count(), fingers(j).sum::<usize>())).max().unwrap_or((0, 0));
    (most.0, most.1 as f64 / children.len() as f64)
}

/// How many legs begin: joints named after legs, of one side, below a joint that is not, with a leg below
/// them. Those that begin in one place, as the controls of a leg do, are one.
fn rooted_legs(rig: &Rig) -> usize {
    let skeleton = rig.skeleton();
    let is_leg: Vec<bool> =
        skeleton.names().iter().map(|n| words(n).iter().any(|w| part(w) == Some(Part::Leg))).collect();
    let near = 0.03 * rig.bounds().diagonal();
    let children = skeleton.children();
    let mut begins: Vec<glam::Vec3> = Vec::new();
    for joint in skeleton.ids().filter(|j| is_leg[j.index()]) {
        let below_leg = skeleton.parent(joint).is_some_and(|p| is_leg[p.index()]);
        let at = glam::Vec3::from(skeleton.head(joint));
        let has_side = side(&words(skeleton.name(joint))).is_some();
        let goes_on = children[joint.index()].iter().any(|c| is_leg[c.index()]);
        if !below_leg && goes_on && has_side && begins.iter().all(|b| b.distance(at) > near) {
            begins.push(at);
        }
    }
    begins.len()
}

/// How many legs their pairs and sides come to.
fn legs_of(legs: BTreeSet<(String, i8)>) -> usize {
    let sides = legs.iter().map(|(_, side)| side).collect::<BTreeSet<_>>().len();
    // `MidLeg` between `UpperLeg` and `LowerLeg` is a part of a leg; beside `TopLeg` it is a pair.
    let named = |pair: &str| !pair.is_empty() && pair != "mid" && pair != "middle";
    let pairs: BTreeSet<&str> = legs.iter().map(|(pair, _)| pair.as_str()).filter(|p| named(p)).collect();
    match pairs.len() {
        0 => sides,
        // Beside `front_thigh.L` the plain `thigh.L` is the other pair.
        1 if legs.iter().any(|(pair, _)| pair.is_empty()) => 2 * sides,
        1 => sides,
        // Beside several, a leg without is a part of one: `FrontLeg.L`, `BackLeg.L`, `Leg.L`.
        _ => legs.iter().filter(|(pair, _)| !pair.is_empty()).count(),
    }
}

/// Separate places within the lowest twentieth of the height.
fn feet(points: &[Point], low: DVec3, size: DVec3, longest: f64) -> usize {
    let cell = 0.025 * longest;
    let limit = low.y + 0.05 * size.y;
    let cells: BTreeSet<(i64, i64)> = points
        .iter()
        .filter(|p| p.at.y <= limit)
        .map(|p| (((p.at.x - low.x) / cell) as i64, ((p.at.z - low.z) / cell) as i64))
        .collect();
    let mut left = cells;
    let mut found = 0;
    while let Some(first) = left.pop_first() {
        found += 1;
        let mut open = vec![first];
        while let Some((x, z)) = open.pop() {
            for dx in -1..=1 {
                for dz in -1..=1 {
                    if left.remove(&(x + dx, z + dz)) {
                        open.push((x + dx, z + dz));
                    }
                }
            }
        }
    }
    found
}
