//! One of several characters in a file.

use std::collections::HashSet;
use std::fmt;
use std::mem::discriminant;
use std::str::FromStr;

use riglab_core::{Clip, Humanoid, JointId, SkinWeights, Springs};

use crate::influences::Repairs;
use crate::reading::Posed;
use crate::{Binding, Body, Fault, Reading, Warning};

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
        let skeleton = match wanted {
            Character::Number(number) => Some(*number),
            Character::Root(name) => {
                self.joints.iter().find(|j| j.parent.is_none() && j.name == *name).map(|j| j.skeleton)
            }
        };
        let Some(skeleton) = skeleton.filter(|s| *s < self.skeletons()) else {
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
        let several = self.skeletons() > 1;
        let stays = |joint: JointId| number[joint.index()].map(JointId);
        let gone: HashSet<usize> = self.joints.iter().filter(|j| j.skeleton != skeleton).map(|j| j.node).collect();
        self.joints.retain(|j| j.skeleton == skeleton);
        for joint in &mut self.joints {
            joint.skeleton = 0;
            joint.parent = joint.parent.and_then(|p| number[p]).map(usize::from);
        }
        self.keep_sets(&number)?;
        if several {
            self.keep_warnings(skeleton, &number, &gone);
        }
        self.body = Body {
            vrm: self.body.vrm,
            humanoid: humanoid(&self.body.humanoid, stays),
            springs: springs(&self.body.springs, stays),
        };
        self.clips = self.clips.iter().map(|clip| of_joints(clip, &number)).collect::<Result<_, _>>()?;
        Ok(())
    }

    /// Leaves what warnings say of the skeleton that is left, one of several; what is said of no part of it is said of none.
    /// `gone` are the nodes of the other skeletons' joints.
    fn keep_warnings(&mut self, skeleton: usize, number: &[Option<u16>], gone: &HashSet<usize>) {
        let told = std::mem::take(&mut self.told);
        let skins: Vec<_> = told.skins.iter().filter(|skin| skin.skeleton == skeleton).collect();
        let held = |joint: Option<u16>| joint.is_some_and(|joint| number[usize::from(joint)].is_some());
        let left_out: HashSet<usize> =
            told.left_out.iter().filter(|(_, joint)| held(*joint)).map(|(node, _)| *node).collect();
        let names: HashSet<&str> = self.joints.iter().map(|joint| joint.name.as_str()).collect();
        let mut repairs = Repairs::default();
        self.vertex_sets.iter().for_each(|set| repairs.add(&set.repairs));
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
                nodes.retain(|node| !gone.contains(&node.number));
                (!nodes.is_empty()).then_some(Warning::ZeroScale { nodes })
            }
            Warning::LeftOut { mut nodes } => {
                nodes.retain(|node| left_out.contains(&node.number));
                (!nodes.is_empty()).then_some(Warning::LeftOut { nodes })
            }
            other => Some(other),
        };
        self.warnings = std::mem::take(&mut self.warnings).into_iter().filter_map(own).collect();
    }

    /// Leaves the vertices that hang on joints which stay.
    fn keep_sets(&mut self, number: &[Option<u16>]) -> Result<(), Fault> {
        let mut kept = Vec::with_capacity(self.vertex_sets.len());
        let mut place = Vec::with_capacity(self.vertex_sets.len());
        for mut set in std::mem::take(&mut self.vertex_sets) {
            // A skin binds to one skeleton, so any weight tells.
            let first = set.weights.as_ref().and_then(|w| w.joints().first().copied());
            let stays = first.is_some_and(|joint| number[usize::from(joint)].is_some());
            place.push(stays.then_some(kept.len()));
            if !stays || set.binding == Binding::Free {
                continue;
            }
            if let Some(old) = &set.weights {
                let joints = old.joints().iter().map(|j| number[usize::from(*j)].unwrap_or_default()).collect();
                set.weights = Some(SkinWeights::new(old.offsets().to_vec(), joints, old.weights().to_vec())?);
            }
            kept.push(set);
        }
        self.vertex_sets = kept;
        self.parts.retain_mut(|part| match place[part.vertex_set] {
            Some(set) => {
                part.vertex_set = set;
                true
            }
            None => false,
        });
        Ok(())
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
    let frames = clip.maps().chunks(clip.joints());
    let own = frames.flat_map(|maps| maps.iter().zip(number).filter(|(_, n)| n.is_some()).map(|(map, _)| *map));
    let joints = number.iter().flatten().count();
    Clip::new(clip.name().to_owned(), clip.rate(), joints, own.collect())
}
