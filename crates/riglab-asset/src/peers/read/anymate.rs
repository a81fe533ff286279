//! Anymate: a list of dictionaries of tensors, as torch saves it.

use super::super::archive::Input;
use super::super::array_rig::{Array, ArrayRig, SparseRows};
use super::super::fault::PeerFault;
use super::super::fields;
use super::super::numbers::{Numbers, elements};
use super::super::pickle::{self, Id, Node, View};
use super::super::torch::TorchArchive;
use super::{Assets, Give, Wanted};
use crate::Fault;
use crate::format::Reads;
use crate::peers::Source;
use riglab_core::Vec3;
use std::borrow::Cow;
use std::collections::HashSet;

/// Joints from a root to a leaf, at most.
const DEEP: usize = 1000;

/// Bones of an asset, at most; the format's own indices end at 127.
const BONES: usize = 1 << 15;

/// What torch saves, as Anymate has it.
pub(crate) struct TorchZip;

impl Reads for TorchZip {
    fn name(&self) -> &'static str {
        "torch"
    }

    fn endings(&self) -> &'static [&'static str] {
        &["pt", "pth"]
    }

    fn has_models(&self) -> bool {
        false
    }

    fn short(&self) -> Option<&'static str> {
        Some("pt")
    }

    fn open<'a>(&self, file: &Source<'a>, _: bool) -> Result<Box<dyn Assets + 'a>, Fault> {
        Ok(Box::new(open(file.input)?))
    }
}

struct Anymate<'a> {
    file: TorchArchive<'a>,
    nodes: Vec<Node>,
    assets: Vec<Id>,
}

fn open(input: Input<'_>) -> Result<Anymate<'_>, PeerFault> {
    let mut file = TorchArchive::open(input)?;
    let bytes = file.pickle()?;
    let read = pickle::read("data.pkl", &mut &bytes[..], &mut file.archive.budget, None)?;
    let (nodes, id) = read.ok_or_else(|| PeerFault::field("data.pkl", "is empty"))?;
    file.archive.budget.give_back(bytes.len() as u64);
    let assets: Option<Vec<Id>> = View { nodes: &nodes, id }.members().map(|all| all.map(|v| v.id).collect());
    let assets = assets.ok_or_else(|| PeerFault::field("data.pkl", "is no list of assets"))?;
    let mut seen = HashSet::with_capacity(assets.len());
    if assets.iter().any(|id| !seen.insert(*id)) {
        return Err(PeerFault::field("data.pkl", "lists the same asset twice"));
    }
    Ok(Anymate { file, nodes, assets })
}

impl Assets for Anymate<'_> {
    fn count(&self) -> usize {
        self.assets.len()
    }

    fn each(&mut self, wanted: Wanted, give: Give<'_>) -> Result<(), PeerFault> {
        let Self { file, nodes, assets } = self;
        for (item, &id) in assets.iter().enumerate().filter(|(item, _)| wanted.has(*item)) {
            let view = View { nodes, id };
            let budget = file.archive.budget.clone();
            let rig = Record { view, file: &mut *file }.read(wanted.extras);
            file.archive.budget = budget;
            if give(item, rig).is_break() {
                break;
            }
        }
        Ok(())
    }
}

/// One dictionary.
struct Record<'r, 'a> {
    view: View<'r>,
    file: &'r mut TorchArchive<'a>,
}

impl Record<'_, '_> {
    fn read(mut self, extras: bool) -> Result<ArrayRig, PeerFault> {
        if !self.view.is_dict() {
            return Err(PeerFault::field("data.pkl", "has an asset that is no dictionary"));
        }
        let bones = self.required("bones")?.rows::<6>("bones")?;
        let count = self.count("bones_num", bones.len())?;
        if count > BONES {
            return Err(PeerFault::field("bones", format!("has {count} rows, up to {BONES} are read")));
        }
        let heads: Vec<Vec3> = bones[..count].iter().map(|b| [b[0], b[1], b[2]]).collect();
        let tails: Vec<Vec3> = bones[..count].iter().map(|b| [b[3], b[4], b[5]]).collect();
        let joints = self.required("joints")?.rows::<3>("joints")?;
        let joints = &joints[..self.count("joints_num", joints.len())?];
        let above = self.joint_parents(joints.len())?;
        let name = self.view.get("name").and_then(View::text).unwrap_or_default().to_owned();
        let mut rig = ArrayRig { name, ..ArrayRig::default() };
        let points = self.required("pc")?;
        if let Some(mesh) = self.tensor("mesh_pc")? {
            rig.vertices = mesh.rows("mesh_pc")?;
            rig.faces = fields::faces(&self.required("mesh_face")?.int_rows("mesh_face")?, rig.vertices.len())?;
            rig.weights = self.weights("mesh_skins", count)?;
        } else {
            rig.vertices = points.rows("pc")?;
            rig.weights = self.weights("skins", count)?;
        }
        if extras {
            let array = |shape: Vec<usize>, data: Vec<f32>| Array { shape, data };
            rig.extras.insert("points".into(), points.array("pc")?);
            rig.extras.insert("joints".into(), array(vec![joints.len(), 3], joints.as_flattened().to_vec()));
            let numbers = above.iter().map(|p| p.map_or(-1.0, |p| p as f32)).collect();
            rig.extras.insert("joint_parents".into(), array(vec![above.len()], numbers));
            if let Some(rows) = self.weights("skins", count)? {
                rig.extras.insert("point_weights".into(), dense(&rows, count)?);
            }
        }
        rig.parents = bone_parents(&heads, &tails, joints, &above);
        (rig.joints, rig.tails) = (heads, tails);
        Ok(rig)
    }

    /// A tensor; `None` where there is none of the name.
    fn tensor(&mut self, field: &str) -> Result<Option<Numbers<'static>>, PeerFault> {
        let tensor = match self.view.get(field).map(View::node) {
            Some(Node::Tensor(tensor)) => tensor,
            None | Some(Node::None) => return Ok(None),
            Some(_) => return Err(PeerFault::field(field, "is no tensor")),
        };
        let fault = |reason: String| PeerFault::field(field, reason);
        let mut dtype = tensor.dtype;
        dtype.big = self.file.big;
        let from = tensor.offset.checked_mul(dtype.size);
        let mut bytes = self.file.storage(&tensor.key)?;
        match from.filter(|from| *from <= bytes.len()) {
            Some(from) => drop(bytes.drain(..from)),
            None => return Err(fault("starts beyond its storage".into())),
        }
        let (shape, strides) = (tensor.shape.clone(), tensor.strides.clone());
        let numbers = Numbers::strided(shape, strides, dtype, Cow::Owned(bytes)).map_err(fault)?;
        // Beside its bytes, which the archive counts.
        self.file.archive.budget.take(dtype.unpacked(numbers.len() * dtype.size), field)?;
        Ok(Some(numbers))
    }

    fn required(&mut self, field: &str) -> Result<Numbers<'static>, PeerFault> {
        self.tensor(field)?.ok_or_else(|| PeerFault::field(field, "is missing"))
    }

    /// How many of `rows` are meant: padded tensors say so.
    fn count(&self, field: &str, rows: usize) -> Result<usize, PeerFault> {
        match self.view.get(field).map(View::int) {
            None => Ok(rows),
            Some(count) => count
                .and_then(|n| usize::try_from(n).ok())
                .filter(|n| *n <= rows)
                .ok_or_else(|| PeerFault::field(field, format!("is no number up to {rows}, the rows of its tensor"))),
        }
    }

    /// `conns`: the parent of each joint, itself for a root.
    fn joint_parents(&mut self, joints: usize) -> Result<Vec<Option<usize>>, PeerFault> {
        let conns = self.required("conns")?.ints("conns")?;
        if conns.len() < joints {
            return Err(PeerFault::field("conns", format!("has {} entries for {joints} joints", conns.len())));
        }
        let parent = |(joint, p): (usize, &i64)| {
            let p = fields::number(*p, joints, || format!("`conns`, entry {joint},"), "joint")?;
            Ok((p != joint).then_some(p))
        };
        conns[..joints].iter().enumerate().map(parent).collect()
    }

    /// `{prefix}_index` and `{prefix}_weight`, padded with -1; `None` where there are none.
    fn weights(&mut self, prefix: &str, bones: usize) -> Result<Option<SparseRows>, PeerFault> {
        let (index, weight) = (format!("{prefix}_index"), format!("{prefix}_weight"));
        let (Some(indices), Some(weights)) = (self.tensor(&index)?, self.tensor(&weight)?) else { return Ok(None) };
        let [_, columns] = indices.shape[..] else {
            return Err(PeerFault::field(&index, format!("has the shape {:?}, not [points, bones]", indices.shape)));
        };
        if indices.shape != weights.shape || columns == 0 {
            return Err(PeerFault::field(&index, "has not the shape of its weights"));
        }
        let mut rows = SparseRows::default();
        let (indices, weights) = (indices.ints(&index)?, weights.floats(&weight)?);
        for (bone, weight) in indices.chunks_exact(columns).zip(weights.chunks_exact(columns)) {
            for (&bone, &weight) in bone.iter().zip(weight).filter(|(bone, _)| **bone != -1) {
                let row = rows.rows();
                let bone = fields::number(bone, bones, || format!("`{index}`, row {row},"), "bone")?;
                if weight != 0.0 {
                    rows.pairs.push((bone as u32, weight));
                }
            }
            rows.end_row();
        }
        Ok(Some(rows))
    }
}

/// The bone above each bone: the one whose tail is its head; where no tail is, the one whose tail is
/// the nearest joint above its head that a tail is at (branching bones get a tail that no bone starts
/// from).
pub(crate) fn bone_parents(
    heads: &[Vec3],
    tails: &[Vec3],
    joints: &[Vec3],
    above: &[Option<usize>],
) -> Vec<Option<usize>> {
    use std::collections::HashMap;
    let key = |p: &Vec3| p.map(|x| (x + 0.0).to_bits());
    // Of several the first that comes from elsewhere: one without length ends where it starts.
    let mut ending: HashMap<[u32; 3], usize> = HashMap::new();
    let has_length = |bone: &usize| key(&heads[*bone]) != key(&tails[*bone]);
    let (long, short): (Vec<usize>, Vec<usize>) = (0..tails.len()).partition(has_length);
    for bone in long.into_iter().chain(short) {
        ending.entry(key(&tails[bone])).or_insert(bone);
    }
    let mut number: HashMap<[u32; 3], usize> = HashMap::new();
    for (joint, position) in joints.iter().enumerate() {
        number.entry(key(position)).or_insert(joint);
    }
    let parent = |(bone, head): (usize, &Vec3)| {
        let ends = |at: &Vec3| ending.get(&key(at)).copied().filter(|other| *other != bone);
        if let Some(other) = ends(head) {
            return Some(other);
        }
        let mut joint = number.get(&key(head)).copied();
        // Not more steps than joints, as `conns` may lead round, nor than any skeleton is deep.
        for _ in 0..joints.len().min(DEEP) {
            joint = above[joint?];
            if let Some(other) = joint.and_then(|j| ends(&joints[j])) {
                return Some(other);
            }
        }
        None
    };
    heads.iter().enumerate().map(parent).collect()
}

fn dense(rows: &SparseRows, columns: usize) -> Result<Array, PeerFault> {
    let shape = vec![rows.rows(), columns];
    // A byte or two stand for each weight, so that the dense form is no more than the file may fill.
    let count =
        elements(&shape).filter(|n| *n <= 1 << 26).ok_or_else(|| PeerFault::TooLarge("point_weights".into()))?;
    let mut data = vec![0.0; count];
    for row in 0..rows.rows() {
        for &(column, weight) in rows.row(row) {
            data[row * columns + column as usize] += weight;
        }
    }
    Ok(Array { shape, data })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bone_hangs_on_the_one_that_ends_at_its_head() {
        let (a, b, c, d, e) = ([0.0; 3], [0.0, 1.0, 0.0], [0.0, 2.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.5, 0.0]);
        // a-b, b-c; d-e hangs on `b` by the joints alone.
        let (heads, tails) = ([a, b, d], [b, c, e]);
        let joints = [a, b, c, d, e];
        let above = [None, Some(0), Some(1), Some(1), Some(3)];
        assert_eq!(bone_parents(&heads, &tails, &joints, &above), [None, Some(0), Some(0)]);
        // Whoever is listed first: a bone without length hangs on the one that ends where it is, and takes nothing from it.
        let (heads, tails) = ([b, a, b], [b, b, c]);
        assert_eq!(bone_parents(&heads, &tails, &joints, &above), [Some(1), None, Some(1)]);
        // `conns` that lead round end.
        assert_eq!(bone_parents(&[d], &[e], &[d, a], &[Some(1), Some(0)]), [None]);
    }
}
