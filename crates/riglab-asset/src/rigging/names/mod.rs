//! Names for joints that have none worth keeping: those of human bodies as engines know them, others by place.

mod body;
mod hands;
mod plain;
mod tree;
mod words;

use std::collections::HashSet;
use std::str::FromStr;

use riglab_core::{Bounds, Humanoid, Joint, JointId, RigError, Skeleton};

pub use body::{human_bones, humanoid};

/// How joints are called.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum NameStyle {
    /// As they are.
    Keep,
    /// Human bones as in Mixamo (`mixamorig:LeftForeArm`), others by place.
    #[default]
    Mixamo,
    /// Human bones as in VRM 1.0 (`leftLowerArm`), others by place.
    Vrm,
    /// All by place: `root`, `spine_1`, `leg_2_l_1`.
    Plain,
}

impl FromStr for NameStyle {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.to_ascii_lowercase().as_str() {
            "keep" => Ok(Self::Keep),
            "mixamo" => Ok(Self::Mixamo),
            "vrm" => Ok(Self::Vrm),
            "plain" => Ok(Self::Plain),
            _ => Err(format!("`{text}` is no way to name joints: one of keep, mixamo, vrm, plain")),
        }
    }
}

/// The skeleton with other names, and which of its joints are human bones (none where it is no humanoid).
///
/// Order, tree and heads stay. `mesh` is the box around the mesh. Names go by the tree and the places of
/// joints, not by what they are called.
///
/// # Errors
/// As [`Skeleton::new`]; none are known.
pub fn name_joints(
    skeleton: &Skeleton,
    mesh: Option<Bounds>,
    style: NameStyle,
) -> Result<(Skeleton, Humanoid), RigError> {
    name_bones(skeleton, mesh, humanoid(skeleton, mesh).unwrap_or_default(), style)
}

/// As [`name_joints`], where it is known which joints are human bones, as of a template's: these go by what they are.
///
/// # Errors
/// As [`name_joints`].
pub fn name_bones(
    skeleton: &Skeleton,
    mesh: Option<Bounds>,
    human: Humanoid,
    style: NameStyle,
) -> Result<(Skeleton, Humanoid), RigError> {
    if style == NameStyle::Keep {
        return Ok((skeleton.clone(), human));
    }
    let mut names = plain::names(skeleton, mesh);
    for (bone, joint) in human.iter() {
        match style {
            NameStyle::Mixamo => names[joint.index()] = words::mixamo(bone),
            NameStyle::Vrm => names[joint.index()] = bone.name().to_owned(),
            NameStyle::Keep | NameStyle::Plain => {}
        }
    }
    Ok((named(skeleton, names)?, human))
}

/// The skeleton with names for the joints from the `first` on, by their places as with [`NameStyle::Plain`]; those before
/// keep theirs.
///
/// # Errors
/// As [`name_joints`].
pub fn name_added(skeleton: &Skeleton, first: usize, mesh: Option<Bounds>) -> Result<Skeleton, RigError> {
    named_but(skeleton, |joint| joint.index() < first, mesh)
}

/// The skeleton with names for the joints that are not called well, by their places as with [`NameStyle::Plain`].
///
/// # Errors
/// As [`name_joints`].
pub fn name_others(
    skeleton: &Skeleton,
    well: impl Fn(&str) -> bool,
    mesh: Option<Bounds>,
) -> Result<Skeleton, RigError> {
    named_but(skeleton, |joint| well(skeleton.name(joint)), mesh)
}

/// With names by place but for joints that keep theirs.
fn named_but(skeleton: &Skeleton, keeps: impl Fn(JointId) -> bool, mesh: Option<Bounds>) -> Result<Skeleton, RigError> {
    let own = |(joint, place)| if keeps(joint) { skeleton.name(joint).to_owned() } else { place };
    named(skeleton, skeleton.ids().zip(plain::names(skeleton, mesh)).map(own).collect())
}

/// With other names, of which those that came before are numbered.
fn named(skeleton: &Skeleton, names: Vec<String>) -> Result<Skeleton, RigError> {
    let mut seen: HashSet<String> = HashSet::new();
    let joints = skeleton.ids().zip(names).map(|(joint, wanted)| {
        let numbered = (2..).map(|n| format!("{wanted}.{n}"));
        let name = std::iter::once(wanted.clone()).chain(numbered).find(|name| !seen.contains(name));
        let name = name.unwrap_or(wanted);
        seen.insert(name.clone());
        Joint { name, parent: skeleton.parent(joint), head: skeleton.head(joint) }
    });
    Skeleton::new(joints.collect())
}

#[cfg(test)]
mod tests;
