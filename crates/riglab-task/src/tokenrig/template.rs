//! A skeleton of known make where the model does not know how to write it.
//!
//! A model that learned from rigs of a make writes one after the token of its class, as the papers have it. One that saw few
//! of them loses its way on many bodies: what it writes is none. What it draws freely for the same mesh may be a body
//! nonetheless, in many of the draws. Which joints are the bones of a human is told by the tree and by places alone
//! ([`RigRequest::human`](super::RigRequest::human)); each joint of the template then stands at the geometric median of
//! where these draws have its bone. No paper has this; it needs no training.

use std::collections::BTreeMap;

use glam::DVec3;
use riglab_core::{Bounds, HumanBone, Humanoid, Joint, JointId, Similarity, Skeleton};
use riglab_metric::{Joints, refined, symmetrised};
use riglab_nn::generate::GenerateConfig;
use riglab_nn::params::Weights;
use riglab_random::stream;
use riglab_token::{Decoded, Template};

use super::{Condition, RigSample, Rigger};
use crate::assets::Up;
use crate::unirig_skeleton::agree::{Agreement, joints_in_the_mirror, partners};
use crate::unirig_skeleton::evaluate::joints;

/// The human bones of a skeleton with y up, in the box around its mesh; `None` for what is no body.
pub type FindHuman<'a> = dyn Fn(&Skeleton, Option<Bounds>) -> Option<Humanoid> + Sync + 'a;

/// Draws that have to be bodies for a template to be placed by them.
pub const BODIES: usize = 3;
/// The share of them that has to have a joint of a finger.
const FINGERS: f64 = 0.3;
/// Steps towards the median.
const STEPS: usize = 20;
/// The share of the bones that are found in a body which its joints have to be called as.
const CALLED: f64 = 0.8;

/// The share of draws that have to be bodies as the template has them for a model to know it. Of one that does not, joints
/// beside the template's are mostly limbs written twice.
const KNOWN: f64 = 0.9;

/// What became of a template that was asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Placed {
    /// The model wrote it: its named joints are the bones of a body that they are called as.
    Written {
        /// Joints beside the template's that were left out, as the model knows it too little.
        left_out: usize,
    },
    /// Its joints are where free draws have a body's bones.
    Voted {
        /// How many of the draws are bodies.
        bodies: usize,
        /// How many there are.
        draws: usize,
    },
    /// What the model wrote is no body, and free draws are none: it is as without the template.
    Without,
    /// What the model wrote is no body; free draws were not asked, as draws were not chosen by agreement.
    Lost,
}

/// How bodies are told.
#[derive(Clone, Copy)]
pub(super) struct Anatomy<'a> {
    pub human: &'a FindHuman<'a>,
    pub up: Up,
    /// Around the mesh in the cube, y up.
    pub bounds: Option<Bounds>,
    /// The x of the plane in whose mirror the mesh is its own image, where there is one.
    pub plane: Option<f64>,
}

impl Anatomy<'_> {
    /// A draw with y up as it would be on the mesh as it is, should it be of the mirror.
    fn skeleton(&self, decoded: &Decoded, mirrored: bool) -> Option<Skeleton> {
        let all = if mirrored { joints_in_the_mirror(decoded) } else { joints(decoded) };
        let joint = |(k, (p, parent)): (usize, (&[f64; 3], &Option<usize>))| Joint {
            name: k.to_string(),
            parent: parent.and_then(|p| u16::try_from(p).ok()).map(JointId),
            head: self.up.back(p.map(|x| x as f32)),
        };
        Skeleton::new(all.positions.iter().zip(&all.parents).enumerate().map(joint).collect()).ok()
    }

    /// Its human bones, if it is a body.
    fn bones(&self, skeleton: &Skeleton) -> Option<Humanoid> {
        (self.human)(skeleton, self.bounds)
    }

    /// Whether a draw after the token of a template is one: a body whose bones are called what they are. In the mirror,
    /// left ones are called right.
    pub fn written(&self, template: &Template, decoded: &Decoded, mirrored: bool) -> bool {
        let Some(found) = self.skeleton(decoded, mirrored).and_then(|s| self.bones(&s)) else { return false };
        // What a body's arms and legs are tells enough; of spines and necks there are many kinds.
        let limbs: Vec<(HumanBone, JointId)> =
            found.iter().filter(|(b, _)| LIMBS.contains(&unsided(b.name()))).collect();
        let called = |(bone, joint): &&(HumanBone, JointId)| {
            let bone = if mirrored { bone.mirrored() } else { *bone };
            template.bone(&decoded.names[joint.index()]) == Some(bone.name())
        };
        !limbs.is_empty() && limbs.iter().filter(called).count() as f64 >= CALLED * limbs.len() as f64
    }

    /// How many draws are bodies, whatever their joints are called.
    pub fn bodies(&self, drawn: &[RigSample], agreement: &Agreement) -> usize {
        let of = |(drawn, mirrored): (&RigSample, bool)| self.skeleton(drawn.decoded.as_ref().ok()?, mirrored);
        drawn.iter().zip(agreement.draws_mirrored()).filter_map(of).filter(|s| self.bones(s).is_some()).count()
    }

    /// Whether a draw, of the mesh and no mirror image of it, is a body.
    pub fn is_body(&self, decoded: &Decoded) -> bool {
        self.skeleton(decoded, false).is_some_and(|skeleton| self.bones(&skeleton).is_some())
    }

    /// Of each draw after the token of a template whether it is [`written`](Self::written).
    pub fn written_ones(&self, template: &Template, drawn: &[RigSample], agreement: &Agreement) -> Vec<bool> {
        let written = |(drawn, mirrored): (&RigSample, bool)| {
            drawn.decoded.as_ref().is_ok_and(|decoded| self.written(template, decoded, mirrored))
        };
        drawn.iter().zip(agreement.draws_mirrored()).map(written).collect()
    }
}

/// Whether so many draws of all are bodies as a template has them that the model knows it.
pub(super) fn known(written: &[bool]) -> bool {
    written.iter().filter(|written| **written).count() as f64 >= KNOWN * written.len() as f64
}

/// The joints of a template alone; what hangs on others hangs on what these hang on. `None` where that is no tree, as other
/// joints hold several of it together.
pub(super) fn alone(skeleton: &Skeleton, template: &Template) -> Option<Skeleton> {
    let kept: Vec<JointId> = skeleton.ids().filter(|&joint| template.has(skeleton.name(joint))).collect();
    let place = |joint: JointId| kept.binary_search(&joint).ok().and_then(|at| u16::try_from(at).ok()).map(JointId);
    let joint = |&own: &JointId| Joint {
        name: skeleton.name(own).to_owned(),
        parent: std::iter::successors(skeleton.parent(own), |&above| skeleton.parent(above)).find_map(place),
        head: skeleton.head(own),
    };
    Skeleton::new(kept.iter().map(joint).collect()).ok()
}

/// Bones of arms and legs, without their sides.
const LIMBS: [&str; 6] = ["UpperArm", "LowerArm", "Hand", "UpperLeg", "LowerLeg", "Foot"];

impl Rigger {
    /// A skeleton of a template for a mesh in the cube, in the network's axes, and how many draws are bodies; `None` where too
    /// few are. `seen`: the mesh in as many clouds as draws are shared out to.
    ///
    /// # Errors
    /// As [`Self::draw_skeletons`].
    pub(super) fn voted(
        &self,
        w: &Weights,
        seen: &Condition,
        (template, anatomy): (&Template, Anatomy<'_>),
        how: &GenerateConfig,
        (agreement, seed): (Agreement, u64),
    ) -> Result<Option<(Skeleton, usize)>, String> {
        let shares = agreement.shares();
        let mut streams: Vec<_> = (0..agreement.draws as u64).map(|k| stream(seed, "rig draws", &[k])).collect();
        let drawn = self.draw_skeletons(w, &seen.first(shares.len()), (&self.free(), &shares), how, &mut streams)?;
        let mut votes = Votes::default();
        for (drawn, mirrored) in drawn.iter().zip(agreement.draws_mirrored()) {
            let drawn = drawn.decoded.as_ref().ok().and_then(|decoded| anatomy.skeleton(decoded, mirrored));
            if let Some((skeleton, human)) = drawn.and_then(|s| anatomy.bones(&s).map(|human| (s, human))) {
                votes.add(&skeleton, &human);
            }
        }
        if votes.bodies < BODIES {
            return Ok(None);
        }
        let Some(joints) = votes.body(template, anatomy.bounds) else { return Ok(None) };
        let turn = |joint: Joint| Joint { head: anatomy.up.turn(joint.head), ..joint };
        let mut joints: Vec<Joint> = joints.into_iter().map(turn).collect();
        // The body alone, where there is no room for fingers.
        let (body, limits) = (template.parts[0].joints.len(), self.config.limits);
        let fits = |all: &[Joint]| all.len() <= limits.joints && self.length(all, Similarity::NONE) <= limits.tokens;
        if !fits(&joints) {
            joints.truncate(body);
        }
        if !fits(&joints) {
            return Ok(None);
        }
        let mut skeleton = Skeleton::new(joints).map_err(|e| e.to_string())?;
        if let Some(plane) = anatomy.plane {
            let partners = partners(skeleton.names(), Some(template.class));
            let both = symmetrised(&Joints::of(&skeleton), plane, &partners).positions;
            let heads = both.iter().map(|p| p.map(|x| x as f32)).collect();
            skeleton = skeleton.with_heads(heads).map_err(|e| e.to_string())?;
        }
        Ok(Some((skeleton, votes.bodies)))
    }
}

/// Where bodies have their bones, y up.
#[derive(Default)]
struct Votes {
    bodies: usize,
    places: BTreeMap<&'static str, Vec<DVec3>>,
}

/// Bones of the spine, of which not every body has all.
const SPINE: [&str; 3] = ["spine", "chest", "upperChest"];

impl Votes {
    fn add(&mut self, skeleton: &Skeleton, human: &Humanoid) {
        self.bodies += 1;
        // The last of the spine is where arms hang, however many there are.
        let spine: Vec<&str> = human.iter().map(|(bone, _)| bone.name()).filter(|b| SPINE.contains(b)).collect();
        for (bone, joint) in human.iter() {
            let bone = match bone.name() {
                own if spine.last() == Some(&own) => "upperChest",
                own => own,
            };
            let at = DVec3::from(skeleton.head(joint).map(f64::from));
            self.places.entry(bone).or_default().push(at);
        }
    }

    /// The joints of a template; `None` where a bone that a body cannot do without was seen in none, and where what they come
    /// to stands as no human does.
    fn body(&self, template: &Template, mesh: Option<Bounds>) -> Option<Vec<Joint>> {
        let mut places: BTreeMap<&str, DVec3> = self.places.iter().map(|(b, all)| (*b, median(all))).collect();
        // One body's word is not enough for what others do without.
        places.retain(|bone, _| !WITHOUT.contains(&unsided(bone)) || self.places[bone].len() > 1);
        fill(&mut places, mesh)?;
        if !stands(&places) {
            return None;
        }
        let enough =
            |bone: &&str| self.places.get(bone).is_some_and(|all| all.len() as f64 >= FINGERS * self.bodies as f64);
        let mut out: Vec<Joint> = Vec::new();
        // Where each joint of the template is.
        let mut at: Vec<Option<usize>> = Vec::new();
        for (number, (name, parent, bone)) in template.joints().enumerate() {
            let body = number < template.parts[0].joints.len();
            let hangs = parent.and_then(|p| at[p]);
            let place = places.get(bone).filter(|_| body || (hangs.is_some() && enough(&bone)));
            at.push(place.is_some().then_some(out.len()));
            match place {
                Some(place) => out.push(Joint {
                    name: name.to_owned(),
                    parent: hangs.and_then(|p| u16::try_from(p).ok()).map(JointId),
                    head: place.to_array().map(|x| x as f32),
                }),
                None if body => return None,
                None => {}
            }
        }
        Some(out)
    }
}

/// Bones of the body that not every rig has, without their sides.
const WITHOUT: [&str; 7] = ["spine", "chest", "neck", "Shoulder", "Hand", "Foot", "Toes"];

fn unsided(bone: &str) -> &str {
    bone.strip_prefix("left").or_else(|| bone.strip_prefix("right")).unwrap_or(bone)
}

/// Finds places for the bones of [`WITHOUT`] that were seen in no body, between their neighbours and beyond them.
fn fill(places: &mut BTreeMap<&str, DVec3>, mesh: Option<Bounds>) -> Option<()> {
    let between = |places: &mut BTreeMap<&str, DVec3>, bone, from: &str, to: &str, share: f64| {
        let place = places.get(from)?.lerp(*places.get(to)?, share);
        places.entry(bone).or_insert(place);
        Some(())
    };
    between(places, "spine", "hips", "upperChest", 1.0 / 3.0)?;
    between(places, "chest", "spine", "upperChest", 0.5)?;
    between(places, "neck", "upperChest", "head", 0.6)?;
    // Where it looks: up is y.
    let ahead = (*places.get("leftUpperLeg")? - *places.get("rightUpperLeg")?).cross(DVec3::Y).normalize_or_zero();
    for [shoulder, arm, elbow, hand, thigh, shin, foot, toes] in [
        [
            "leftShoulder",
            "leftUpperArm",
            "leftLowerArm",
            "leftHand",
            "leftUpperLeg",
            "leftLowerLeg",
            "leftFoot",
            "leftToes",
        ],
        [
            "rightShoulder",
            "rightUpperArm",
            "rightLowerArm",
            "rightHand",
            "rightUpperLeg",
            "rightLowerLeg",
            "rightFoot",
            "rightToes",
        ],
    ] {
        between(places, shoulder, "upperChest", arm, 0.3)?;
        between(places, hand, arm, elbow, 1.9)?;
        between(places, foot, thigh, shin, 1.9)?;
        let (ankle, knee) = (places[foot], places[shin]);
        let floor = mesh.map_or(ankle.y, |b| f64::from(b.min[1])).min(ankle.y);
        let ball = ankle + 0.3 * ankle.distance(knee) * ahead;
        places.entry(toes).or_insert(DVec3::new(ball.x, floor + 0.3 * (ankle.y - floor), ball.z));
    }
    Some(())
}

/// Whether bones stand as those of a human: one above the other from the hips to the head, without one step that is most of
/// the way, and hips where legs begin. Four-legged bodies have hind legs for arms now and then.
fn stands(places: &BTreeMap<&str, DVec3>) -> bool {
    let spine = ["hips", "spine", "chest", "upperChest", "neck", "head"].map(|bone| places[bone]);
    let steps: Vec<f64> = spine.windows(2).map(|two| two[0].distance(two[1])).collect();
    let (longest, whole) = (steps.iter().copied().fold(0.0, f64::max), steps.iter().sum::<f64>());
    let [hips, .., chest, _, head] = spine;
    let upright = |from: DVec3, to: DVec3| (to - from).y > (to - from).x.hypot((to - from).z);
    let legs = 0.5 * (places["leftUpperLeg"] + places["rightUpperLeg"]);
    let leg = |side: [&str; 3]| places[side[0]].distance(places[side[1]]) + places[side[1]].distance(places[side[2]]);
    let leg =
        leg(["leftUpperLeg", "leftLowerLeg", "leftFoot"]).max(leg(["rightUpperLeg", "rightLowerLeg", "rightFoot"]));
    upright(hips, chest) && upright(hips, head) && longest < 0.6 * whole && hips.distance(legs) < 0.5 * leg
}

/// The geometric median of some places, by Weiszfeld's steps from their mean.
fn median(all: &[DVec3]) -> DVec3 {
    let mean = all.iter().sum::<DVec3>() / all.len().max(1) as f64;
    let alone = |place: DVec3| Joints { positions: vec![place.to_array()], parents: vec![None] };
    let voters: Vec<Joints> = all.iter().copied().map(alone).collect();
    DVec3::from(refined(&alone(mean), &voters, STEPS).positions[0])
}

#[cfg(test)]
mod tests {
    use riglab_nn::tokenrig::Head;
    use riglab_token::Limits;

    use super::*;
    use crate::tokenrig::RigRequest;
    use crate::tokenrig::testing::{tetrahedron, untrained};

    /// Where the bones of a body are, y up, left at +x.
    fn bones(without: &[&str]) -> Vec<(&'static str, [f32; 3])> {
        let body = [
            ("hips", [0.0, 0.0, 0.0]),
            ("spine", [0.0, 0.1, 0.0]),
            ("chest", [0.0, 0.2, 0.0]),
            ("upperChest", [0.0, 0.3, 0.0]),
            ("neck", [0.0, 0.45, 0.0]),
            ("head", [0.0, 0.55, 0.0]),
            ("leftShoulder", [0.05, 0.4, 0.0]),
            ("leftUpperArm", [0.15, 0.4, 0.0]),
            ("leftLowerArm", [0.4, 0.4, 0.0]),
            ("leftHand", [0.65, 0.4, 0.0]),
            ("leftUpperLeg", [0.1, -0.05, 0.0]),
            ("leftLowerLeg", [0.1, -0.45, 0.0]),
            ("leftFoot", [0.1, -0.85, 0.0]),
            ("leftToes", [0.1, -0.9, 0.1]),
        ];
        let other = |(bone, [x, y, z]): (&'static str, [f32; 3])| {
            let bone: HumanBone = bone.parse().unwrap();
            (bone.mirrored() != bone).then(|| (bone.mirrored().name(), [-x, y, z]))
        };
        let all = body.into_iter().chain(body.into_iter().filter_map(other));
        all.filter(|(bone, _)| !without.contains(&unsided(bone))).collect()
    }

    /// A skeleton of these joints, each on the first, and which bones they are.
    fn skeleton(bones: &[(&str, [f32; 3])]) -> (Skeleton, Humanoid) {
        let joint = |(k, (name, head)): (usize, &(&str, [f32; 3]))| Joint {
            name: (*name).to_owned(),
            parent: (k > 0).then_some(JointId(0)),
            head: *head,
        };
        let mut human = Humanoid::default();
        for (k, (bone, _)) in bones.iter().enumerate() {
            human.insert(bone.parse().unwrap(), JointId(k as u16));
        }
        (Skeleton::new(bones.iter().enumerate().map(joint).collect()).unwrap(), human)
    }

    fn votes(all: &[Vec<(&'static str, [f32; 3])>]) -> Votes {
        let mut votes = Votes::default();
        for (skeleton, human) in all.iter().map(|bones| skeleton(bones)) {
            votes.add(&skeleton, &human);
        }
        votes
    }

    fn head(joints: &[Joint], name: &str) -> [f32; 3] {
        joints.iter().find(|joint| joint.name == name).unwrap_or_else(|| panic!("{name}")).head
    }

    fn near(a: [f32; 3], b: [f32; 3]) -> bool {
        DVec3::from(a.map(f64::from)).distance(DVec3::from(b.map(f64::from))) < 0.02
    }

    #[test]
    fn joints_stand_at_the_median_of_what_bodies_say() {
        // One of five is far off.
        let mut all = vec![bones(&[]); 5];
        all[2].iter_mut().for_each(|(_, head)| head[1] += 0.5);
        for template in &Template::ALL {
            let joints = votes(&all).body(template, None).unwrap();
            let named = |bone: &str| joints.iter().find(|j| template.bone(&j.name) == Some(bone)).unwrap();
            assert_eq!(joints.len(), 22);
            for (bone, place) in bones(&[]) {
                assert!(near(named(bone).head, place), "{bone}: {:?}", named(bone).head);
            }
            let parent = |bone: &str| &joints[named(bone).parent.unwrap().index()].name;
            assert_eq!(template.bone(parent("leftUpperArm")), Some("leftShoulder"));
            assert_eq!(template.bone(parent("rightUpperLeg")), Some("hips"));
        }
    }

    #[test]
    fn bones_that_no_body_has_stand_between_and_beyond_their_neighbours() {
        let mixamo = Template::of("mixamo").unwrap();
        let all = vec![bones(&["spine", "chest", "neck", "Shoulder", "Hand", "Foot", "Toes"]); 3];
        let floor = Bounds { min: [-0.7, -0.95, -0.2], max: [0.7, 0.8, 0.2] };
        let joints = votes(&all).body(mixamo, Some(floor)).unwrap();
        assert_eq!(joints.len(), 22);
        for (name, place) in [
            ("mixamorig:Spine", [0.0, 0.1, 0.0]),
            ("mixamorig:Spine1", [0.0, 0.2, 0.0]),
            ("mixamorig:Neck", [0.0, 0.45, 0.0]),
            ("mixamorig:RightShoulder", [-0.045, 0.33, 0.0]),
            ("mixamorig:LeftHand", [0.625, 0.4, 0.0]),
            ("mixamorig:RightFoot", [-0.1, -0.81, 0.0]),
        ] {
            assert!(near(head(&joints, name), place), "{name}: {:?}", head(&joints, name));
        }
        let toes = head(&joints, "mixamorig:LeftToeBase");
        assert!(toes[2] > 0.05 && (-0.95..-0.81).contains(&toes[1]), "{toes:?}");
        // A spine of one joint is where arms hang.
        assert!(near(head(&joints, "mixamorig:Spine2"), [0.0, 0.3, 0.0]));
        // What one body alone has counts no more than none; without legs there is no body.
        let mut one = all.clone();
        one[0].push(("leftHand", [5.0, 0.0, 0.0]));
        assert!(near(head(&votes(&one).body(mixamo, None).unwrap(), "mixamorig:LeftHand"), [0.625, 0.4, 0.0]));
        assert!(votes(&[bones(&["LowerLeg"]), bones(&["LowerLeg"])]).body(mixamo, None).is_none());
    }

    #[test]
    fn fingers_come_along_where_enough_bodies_have_them() {
        let mixamo = Template::of("mixamo").unwrap();
        let finger = [("leftIndexProximal", [0.7, 0.4, 0.0]), ("leftIndexIntermediate", [0.72, 0.4, 0.0])];
        let mut all = vec![bones(&[]); 5];
        all[0].extend(finger);
        assert_eq!(votes(&all).body(mixamo, None).unwrap().len(), 22, "one of five");
        all[1].extend(finger);
        let joints = votes(&all).body(mixamo, None).unwrap();
        assert_eq!(joints.len(), 24);
        let last = joints.last().unwrap();
        assert_eq!((last.name.as_str(), last.parent), ("mixamorig:LeftHandIndex2", Some(JointId(22))));
    }

    /// Draws as bodies: bones are taken by their heights.
    fn by_height(skeleton: &Skeleton, _: Option<Bounds>) -> Option<Humanoid> {
        let mut joints: Vec<JointId> = skeleton.ids().collect();
        joints.sort_by(|&a, &b| skeleton.head(b)[1].total_cmp(&skeleton.head(a)[1]));
        let bones = ["head", "upperChest", "leftUpperArm", "rightUpperArm", "leftLowerArm", "rightLowerArm", "hips"];
        let legs = ["leftUpperLeg", "rightUpperLeg", "leftLowerLeg", "rightLowerLeg"];
        let mut human = Humanoid::default();
        let bones: Vec<&str> = bones.into_iter().chain(legs).collect();
        let step = joints.len() / bones.len();
        for (k, bone) in bones.iter().enumerate() {
            human.insert(bone.parse().unwrap(), *joints.get(step * k)?);
        }
        (step > 0).then_some(human)
    }

    #[test]
    fn a_model_that_loses_its_way_has_the_joints_where_its_draws_see_a_body() {
        let (mesh, mut rigger) = (tetrahedron(), untrained(Head::Levels, true));
        rigger.config.limits = Limits { joints: 24, tokens: 200 };
        rigger.config.eval.consensus = 6;
        let make = |rigger: &Rigger, human: Option<&FindHuman<'_>>| {
            rigger.make(&mesh, &RigRequest { class: Some("mixamo"), human, ..RigRequest::default() }).unwrap()
        };
        rigger.config.data.up = Up::Z;
        let made = make(&rigger, Some(&by_height));
        let Some(Placed::Voted { bodies, draws: 6 }) = made.placed else { panic!("{:?}", made.placed) };
        assert!((BODIES..=6).contains(&bodies));
        let names: Vec<&str> = Template::of("mixamo").unwrap().joints().map(|(name, ..)| name).take(22).collect();
        assert_eq!(made.skeleton.names(), names);
        assert_eq!(made.weights.rows(), mesh.positions().len());
        assert_eq!(made.skeleton, make(&rigger, Some(&by_height)).skeleton, "the same each time");
        rigger.config.data.up = Up::Y;
        // Where nothing is a body it is as without the template; where nothing tells, what the model writes.
        let nobody: &FindHuman<'_> = &|_: &Skeleton, _: Option<Bounds>| None;
        let none = make(&rigger, Some(nobody));
        let free = rigger.make(&mesh, &RigRequest::default()).unwrap();
        assert_eq!((none.placed, make(&rigger, None).placed), (Some(Placed::Without), None));
        assert_eq!((&none.skeleton, &none.weights), (&free.skeleton, &free.weights));
        let one = RigRequest { class: Some("mixamo"), human: Some(nobody), samples: Some(1), ..RigRequest::default() };
        assert_eq!(rigger.make(&mesh, &one).unwrap().placed, Some(Placed::Lost), "free draws are not asked");
        // No room for the joints of the template.
        rigger.config.limits = Limits { joints: 21, tokens: 400 };
        let told = rigger.make(&mesh, &RigRequest { class: Some("mixamo"), ..RigRequest::default() }).unwrap_err();
        assert!(told.contains("`mixamo` are more than this model writes (21 joints"), "{told}");
    }

    #[test]
    fn a_template_without_what_stood_beside_it_is_still_one_of_the_draws() {
        let (mesh, mut rigger) = (tetrahedron(), untrained(Head::Levels, true));
        rigger.config.limits = Limits { joints: 26, tokens: 200 };
        rigger.config.eval.consensus = 6;
        let template = Template::of("mixamo").unwrap();
        // The template's body comes first; draws with more than it are bodies.
        let human: &FindHuman<'_> = &|skeleton, _| {
            let mut human = Humanoid::default();
            for (joint, (.., bone)) in skeleton.ids().zip(template.joints().take(22)) {
                human.insert(bone.parse().ok()?, joint);
            }
            (skeleton.len() > 22).then_some(human)
        };
        let wish = RigRequest { class: Some("mixamo"), human: Some(human), ..RigRequest::default() };
        let made = rigger.make(&mesh, &wish).unwrap();
        let Some(Placed::Written { left_out }) = made.placed else { panic!("{:?}", made.placed) };
        assert!(left_out > 0 && made.skeleton.names().iter().all(|name| template.has(name)), "{left_out}");
        assert_eq!((made.draws.len(), made.human), (6, true));
        assert!(made.sample < 6 && made.apart.is_some());
    }

    #[test]
    fn what_stands_as_no_human_is_no_body() {
        let mixamo = Template::of("mixamo").unwrap();
        let of = |change: &dyn Fn(&str, &mut [f32; 3])| {
            let mut all = vec![bones(&[]); 3];
            all.iter_mut().flatten().for_each(|(bone, head)| change(bone, head));
            votes(&all).body(mixamo, None)
        };
        assert!(of(&|_, _| {}).is_some());
        // Lying, hips far from the legs, one step for a spine.
        assert!(of(&|_, [_, y, z]| (*y, *z) = (*z, *y)).is_none());
        assert!(
            of(&|bone, head| if bone == "hips" {
                head[2] = -0.7
            })
            .is_none()
        );
        let up = |bone: &str| ["upperChest", "neck", "head", "chest"].contains(&bone);
        assert!(
            of(&|bone, head| if up(bone) {
                head[1] += 2.0
            })
            .is_none()
        );
    }

    #[test]
    fn joints_beside_a_template_are_left_out() {
        let mixamo = Template::of("mixamo").unwrap();
        let joint = |name: &str, parent: Option<u16>| Joint {
            name: name.into(),
            parent: parent.map(JointId),
            head: [0.0, f32::from(parent.unwrap_or(0)), 0.0],
        };
        let all = [("mixamorig:Hips", None), ("bone_1", Some(0)), ("mixamorig:Spine", Some(1)), ("bone_3", Some(2))];
        let all = Skeleton::new(all.map(|(name, parent)| joint(name, parent)).to_vec()).unwrap();
        let own = alone(&all, mixamo).unwrap();
        assert_eq!(own.names(), ["mixamorig:Hips", "mixamorig:Spine"]);
        assert_eq!(own.parents(), [None, Some(JointId(0))]);
        assert_eq!(own.heads()[1], all.heads()[2]);
        let held = [("bone_0", None), ("mixamorig:Hips", Some(0)), ("mixamorig:LeftUpLeg", Some(0))];
        let held = Skeleton::new(held.map(|(name, parent)| joint(name, parent)).to_vec()).unwrap();
        assert_eq!(alone(&held, mixamo), None, "two roots");
        assert!(known(&[true; 10]) && !known(&[true, false]));
    }

    #[test]
    fn what_is_written_is_a_body_whose_bones_are_called_what_they_are() {
        let template = Template::of("mixamo").unwrap();
        let bones = bones(&[]);
        let human = skeleton(&bones).1;
        let find = move |_: &Skeleton, _: Option<Bounds>| Some(human.clone());
        let anatomy = Anatomy { human: &find, up: Up::Y, bounds: None, plane: None };
        let name = |bone: &str| template.joints().find(|(.., b)| *b == bone).unwrap().0.to_owned();
        let mut decoded = Decoded {
            joints: bones.iter().map(|(_, head)| *head).collect(),
            parents: (0..bones.len()).map(|k| (k > 0).then_some(0)).collect(),
            names: bones.iter().map(|(bone, _)| name(bone)).collect(),
            class: None,
            parts: Vec::new(),
        };
        assert!(anatomy.written(template, &decoded, false));
        assert!(!anatomy.written(template, &decoded, true), "sides are exchanged in the mirror");
        decoded.names.iter_mut().for_each(|name| *name = format!("bone_{}", name.len()));
        assert!(!anatomy.written(template, &decoded, false));
        let nobody = Anatomy { human: &|_, _| None, ..anatomy };
        assert!(!nobody.written(template, &decoded, false));
    }
}
