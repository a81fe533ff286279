//! What a file says, before it becomes a rig.

use riglab_core::{Clip, Humanoid, SkinWeights, Springs, Vec3};

use crate::influences::Repairs;
use crate::{Up, Warning};

/// What was read from a file, in its own units and axes and numbered as in the file.
///
/// The skeleton may be several trees and meshes may be unbound; names are unique already. Joints come
/// depth first, children in the order of the file, so that each tree is an unbroken run.
#[derive(Clone, Debug, Default)]
pub struct Reading {
    /// Parents before children.
    pub joints: Vec<ReadJoint>,
    /// Vertices with their weights.
    pub vertex_sets: Vec<VertexSet>,
    /// Triangles over them, a part for each primitive, by node and primitive.
    pub parts: Vec<Part>,
    /// Human bones and springs.
    pub body: Body,
    /// Motions, where they were asked for.
    pub clips: Vec<Clip>,
    /// Where a root above all joints would stand.
    pub origin: Vec3,
    /// How far the file shows everything that hangs on the joints from where it was bound, and is read, where that is the same
    /// way for all of it: quantised meshes are brought to size by their inverse bind matrices, which a rig has no scale for.
    pub shown_off: Vec3,
    /// Which axis of the file points up; rigs have y up.
    pub up: Up,
    /// Whether the format says that a model's front is -z, as VRM 0.x does; what says nothing mostly faces +z.
    pub faces_back: bool,
    /// Meshes that the file shows with blend shapes, without which they are read; none where [`crate::ImportOptions::shaped`] asks
    /// for these and all could be applied.
    pub shaped: Vec<Shaped>,
    /// What warnings say of skins, and of meshes that are not of the rig, one by one: whose they are, where one of several
    /// skeletons is wanted alone.
    pub(crate) told: Told,
    /// What was repaired or is doubtful.
    pub warnings: Vec<Warning>,
}

/// What warnings are about, by skeleton.
#[derive(Clone, Debug, Default)]
pub(crate) struct Told {
    /// The skins that warnings name by their numbers.
    pub(crate) skins: Vec<ToldSkin>,
    pub(crate) left_out: LeftOut,
}

/// The nodes of [`Warning::LeftOut`], with the joint that each hangs on, if on any.
pub(crate) type LeftOut = Vec<(usize, Option<u16>)>;

/// A skin in warnings.
#[derive(Clone, Debug)]
pub(crate) struct ToldSkin {
    pub(crate) number: usize,
    pub(crate) skeleton: usize,
    /// How the nodes show it where that is another pose.
    pub(crate) posed: Option<Posed>,
}

/// What [`Warning::RestIsNotBind`] says, of one skin.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Posed {
    pub(crate) size: f64,
    pub(crate) off: f64,
}

impl Posed {
    /// What is told of skins that are shown in another pose, by their numbers; none where there are none.
    pub(crate) fn warning(skins: impl Iterator<Item = (usize, Self)>) -> Option<Warning> {
        let (skins, posed): (Vec<usize>, Vec<Self>) = skins.unzip();
        let size = posed.first()?.size;
        Some(Warning::RestIsNotBind { skins, size, off: posed.iter().map(|posed| posed.off).fold(0.0, f64::max) })
    }
}

/// A mesh that is shown with blend shapes before anything moves.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Shaped {
    /// The node that shows it.
    pub node: usize,
    /// Its name, or else its number.
    pub mesh: String,
    /// How many shapes have a weight.
    pub weighted: usize,
    /// Of how many.
    pub shapes: usize,
}

/// What a file says of the joints beyond their places, by joint of the reading.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Body {
    /// Whether it says so as a VRM does; rigs that riglab wrote tell human bones by themselves.
    pub vrm: bool,
    /// Which are human bones.
    pub humanoid: Humanoid,
    /// What swings.
    pub springs: Springs,
}

/// A joint as read.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadJoint {
    /// Unique, not empty.
    pub name: String,
    /// Its node's number in the file.
    pub node: usize,
    /// Index of its parent among the joints; before its own.
    pub parent: Option<usize>,
    /// Position at rest.
    pub head: Vec3,
    /// Which skeleton it belongs to, from 0: joints under one root and joints bound by one skin
    /// are of one skeleton.
    pub skeleton: usize,
}

/// Vertices that one or several parts draw from.
#[derive(Clone, Debug)]
pub struct VertexSet {
    /// Their numbers in the file, rising; those of glTF that no part uses are left out.
    pub numbers: Vec<u32>,
    /// Rest positions.
    pub positions: Vec<Vec3>,
    /// A row for each vertex, by joint of the reading. A vertex without weight in the file has
    /// weight 1 on the joint of its first slot here.
    pub weights: Option<SkinWeights>,
    /// Vertices (indices into this set) that have no weight in the file.
    pub unweighted: Vec<u32>,
    /// What was mended of their weights.
    pub(crate) repairs: Repairs,
    /// How many vertices there are in the file, used or not.
    pub stored: usize,
    /// How they hang on the skeleton.
    pub binding: Binding,
}

/// How vertices hang on the skeleton.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Binding {
    /// By weights of the file.
    Skinned,
    /// Wholly on one joint, as an unskinned mesh below it does.
    Rigid,
    /// Not at all; the file has no skeleton.
    Free,
}

/// The triangles of one primitive.
#[derive(Clone, Debug)]
pub struct Part {
    /// Number of the node that holds the mesh.
    pub node: usize,
    /// Number of the primitive in its mesh.
    pub primitive: usize,
    /// Which [`VertexSet`] it draws from.
    pub vertex_set: usize,
    /// The vertices it uses, rising (indices into the set).
    pub used: Vec<u32>,
    /// Triangles that name three different vertices, each triple once (indices into the set).
    pub triangles: Vec<[u32; 3]>,
    /// How many triangles there are in the file.
    pub stored: usize,
}

impl Reading {
    /// How the vertices of a part hang on the skeleton.
    pub fn binding(&self, part: &Part) -> Binding {
        self.vertex_sets[part.vertex_set].binding
    }

    /// The roots in order: where each tree of the joints starts.
    pub fn roots(&self) -> Vec<usize> {
        (0..self.joints.len()).filter(|&j| self.joints[j].parent.is_none()).collect()
    }

    /// How many skeletons there are: several characters make several.
    pub fn skeletons(&self) -> usize {
        self.joints.iter().map(|j| j.skeleton + 1).max().unwrap_or(0)
    }
}
