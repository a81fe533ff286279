//! One of several characters in a file.

use std::collections::HashSet;
use std::fmt;
use std::mem::discriminant;
use std::str::FromStr;

use riglab_core::{Clip, Humanoid, JointId, SkinWeights, Springs};

use crate::influences::Repairs;
use crate::reading::{Posed, Told};
use crate::{Binding, Body, Fault, Part, ReadJoint, Reading, VertexSet, Warning};

/// Which of the characters of a file is read. What belongs together is told by
/// [`crate::ReadJoint::skeleton`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Character {
    /// By its number in the order of the file, from 0.
    Number(usize),
    /// By the name of one of its roots.
    Root(String),
}

impl FromStr for Character {
    type Err = std::convert::Infallible;

    /// A number, or else a name.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Ok(text.parse().map_or_else(|_| Self::Root(text.into()), Self::Number))
    }
}

impl fmt::Display for Character {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(number) => write!(f, "{number}"),
            Self::Root(name) => write!(f, "`{name}`"),
        }
    }
}

impl Reading {
    /// The first root of each character, in the order of the file.
    pub fn characters(&self) -> Vec<&str> {
        let mut names = vec![""; self.skeletons()];
        for joint in self.joints.iter().rev().filter(|j| j.parent.is_none()) {
            names[joint.skeleton] = &joint.name;
        }
        names
    }

    /// Leaves one character: its joints, what is bound to them, and what moves them.
    pub(crate) fn keep(&mut self, wanted: &Character) -> Result<(), Fault> {
        *self = self.only(wanted)?;
        Ok(())
    }

    /// One character alone. What it takes of time and memory is its own, however many there are beside it, but for a number for
    /// each joint and mesh.
    pub(crate) fn only(&self, wanted: &Character) -> Result<Self, Fault> {
        let skeletons = self.skeletons();
        let skeleton = match wanted {
            Character::Number(number) => Some(*number),
            Character::Root(name) => {
                self.joints.iter().find(|j| j.parent.is_none() && j.name == *name).map(|j| j.skeleton)
            }
        };
        let Some(skeleton) = skeleton.filter(|s| *s < skeletons) else {
            let found = self.characters().into_iter().map(String::from).collect();
            return Err(Fault::NoSuchCharacter { wanted: wanted.to_string(), found });
        };
        // The new number of each joint that stays.
        let mut left = 0u16;
        let number: Vec<Option<u16>> = self
            .joints
            .iter()
            .map(|j| {
                (j.skeleton == skeleton).then(|| {
                    left += 1;
                    left - 1
                })
            })
            .collect();
        let stays = |joint: JointId| number[joint.index()].map(JointId);
        let parent = |joint: &ReadJoint| joint.parent.and_then(|p| number[p]).map(usize::from);
        let own = self.joints.iter().filter(|j| j.skeleton == skeleton);
        let joints = own.map(|j| ReadJoint { skeleton: 0, parent: parent(j), ..j.clone() }).collect();
        let (vertex_sets, parts) = self.sets_of(&number)?;
        let mut one = Self {
            joints,
            vertex_sets,
            parts,
            body: Body {
                vrm: self.body.vrm,
                humanoid: humanoid(&self.body.humanoid, stays),
                springs: springs(&self.body.springs, stays),
            },
            clips: self.clips.iter().map(|clip| of_joints(clip, &number)).collect::<Result<_, _>>()?,
            origin: self.origin,
            shown_off: self.shown_off,
            up: self.up,
            faces_back: self.faces_back,
            shaped: self.shaped.clone(),
            told: Told::default(),
            warnings: Vec::new(),
        };
        match skeletons {
            0 | 1 => (one.told, one.warnings) = (self.told.clone(), self.warnings.clone()),
            _ => one.warnings = self.warnings_of(&one, skeleton, &number),
        }
        Ok(one)
    }

    /// What warnings say of `one`, a skeleton of several; what is said of no part of it is said of none.
    fn warnings_of(&self, one: &Self, skeleton: usize, number: &[Option<u16>]) -> Vec<Warning> {
        let skins: Vec<_> = self.told.skins.iter().filter(|skin| skin.skeleton == skeleton).collect();
        let held = |joint: Option<u16>| joint.is_some_and(|joint| number[usize::from(joint)].is_some());
        let left_out: HashSet<usize> =
            self.told.left_out.iter().filter(|(_, joint)| held(*joint)).map(|(node, _)| *node).collect();
        let names: HashSet<&str> = one.joints.iter().map(|joint| joint.name.as_str()).collect();
        let mut repairs = Repairs::default();
        one.vertex_sets.iter().for_each(|set| repairs.add(&set.repairs));
        let mut mended = Vec::new();
        repairs.warn(&mut mended);
        let own = |warning: Warning| match warning {
            Warning::NegativeWeights { .. }
            | Warning::DuplicateInfluences { .. }
            | Warning::UnusedJointIndex { .. }
            | Warning::NotNormalised { .. }
            | Warning::Unweighted { .. } => {
                mended.iter().find(|own| discriminant(*own) == discriminant(&warning)).cloned()
            }
            Warning::Bent { skins: all } => {
                let numbers: HashSet<usize> = skins.iter().map(|skin| skin.number).collect();
                let own: Vec<usize> = all.into_iter().filter(|number| numbers.contains(number)).collect();
                (!own.is_empty()).then_some(Warning::Bent { skins: own })
            }
            Warning::Reshaped { skins: all, squashed, mirrored } => {
                let numbers: HashSet<usize> = skins.iter().map(|skin| skin.number).collect();
                let own: Vec<usize> = all.into_iter().filter(|number| numbers.contains(number)).collect();
                (!own.is_empty()).then_some(Warning::Reshaped { skins: own, squashed, mirrored })
            }
            Warning::RestIsNotBind { .. } => {
                Posed::warning(skins.iter().filter_map(|skin| Some((skin.number, skin.posed?))))
            }
            Warning::RigidParts { nodes, joints } => {
                let own = nodes.into_iter().zip(joints).filter(|(_, joint)| names.contains(joint.as_str()));
                let (nodes, joints): (Vec<_>, Vec<_>) = own.unzip();
                (!nodes.is_empty()).then_some(Warning::RigidParts { nodes, joints })
            }
            // A node that is no joint may be above any.
            Warning::ZeroScale { mut nodes } => {
                let others = self.joints.iter().filter(|joint| joint.skeleton != skeleton);
                let others: HashSet<usize> = others.map(|joint| joint.node).collect();
                nodes.retain(|node| !others.contains(&node.number));
                (!nodes.is_empty()).then_some(Warning::ZeroScale { nodes })
            }
            Warning::LeftOut { mut nodes } => {
                nodes.retain(|node| left_out.contains(&node.number));
                (!nodes.is_empty()).then_some(Warning::LeftOut { nodes })
            }
            other => Some(other),
        };
        self.warnings.iter().cloned().filter_map(own).collect()
    }

    /// The vertices that hang on joints which stay, and the parts over them.
    fn sets_of(&self, number: &[Option<u16>]) -> Result<(Vec<VertexSet>, Vec<Part>), Fault> {
        let mut kept = Vec::new();
        let mut place = Vec::with_capacity(self.vertex_sets.len());
        for set in &self.vertex_sets {
            // A skin binds to one skeleton, so any weight tells.
            let first = set.weights.as_ref().and_then(|w| w.joints().first().copied());
            let own = first.is_some_and(|joint| number[usize::from(joint)].is_some());
            let weights = set.weights.as_ref().filter(|_| own && set.binding != Binding::Free);
            place.push(weights.map(|_| kept.len()));
            let Some(old) = weights else { continue };
            let joints = old.joints().iter().map(|j| number[usize::from(*j)].unwrap_or_default()).collect();
            kept.push(VertexSet {
                numbers: set.numbers.clone(),
                positions: set.positions.clone(),
                weights: Some(SkinWeights::new(old.offsets().to_vec(), joints, old.weights().to_vec())?),
                unweighted: set.unweighted.clone(),
                repairs: set.repairs.clone(),
                stored: set.stored,
                binding: set.binding,
            });
        }
        let own = |part: &Part| Some(Part { vertex_set: place[part.vertex_set]?, ..part.clone() });
        // Nothing is copied of what goes.
        let parts = self.parts.iter().filter(|part| place[part.vertex_set].is_some()).filter_map(own).collect();
        Ok((kept, parts))
    }
}

fn humanoid(all: &Humanoid, stays: impl Fn(JointId) -> Option<JointId>) -> Humanoid {
    let mut own = Humanoid::default();
    for (bone, joint) in all.iter() {
        if let Some(joint) = stays(joint) {
            own.insert(bone, joint);
        }
    }
    own
}

fn springs(all: &Springs, stays: impl Fn(JointId) -> Option<JointId>) -> Springs {
    let mut colliders = Vec::new();
    let mut place = Vec::new();
    for collider in all.colliders() {
        let joint = stays(collider.joint);
        place.push(joint.map(|_| colliders.len()));
        colliders.extend(joint.map(|joint| riglab_core::Collider { joint, ..*collider }));
    }
    let groups = all.groups().iter().map(|g| g.iter().filter_map(|&c| place[c]).collect()).collect();
    let own = all.springs().iter().filter_map(|spring| {
        let mut spring = spring.clone();
        spring.joints.retain_mut(|j| match stays(j.joint) {
            Some(joint) => {
                j.joint = joint;
                true
            }
            None => false,
        });
        spring.center = spring.center.and_then(&stays);
        (!spring.joints.is_empty()).then_some(spring)
    });
    // A part of what is sound is sound.
    Springs::new(own.collect(), colliders, groups).unwrap_or_default()
}

fn of_joints(clip: &Clip, number: &[Option<u16>]) -> Result<Clip, riglab_core::RigError> {
    let joints: Vec<usize> = number.iter().enumerate().filter(|(_, n)| n.is_some()).map(|(joint, _)| joint).collect();
    let frames = clip.maps().chunks(clip.joints());
    let own = frames.flat_map(|maps| joints.iter().map(|&joint| maps[joint]));
    Clip::new(clip.name().to_owned(), clip.rate(), joints.len(), own.collect())
}
