//! Rigs as whole sequences: a skeleton's tokens, then its bones' codes.

use riglab_core::{JointId, Rig};
use riglab_metric::ACTIVE;
use riglab_nn::tokenrig::Layout;
use riglab_random::Stream;
use riglab_token::Tokenizer;
use tch::Kind;

use super::config::SkinConfig;
use crate::fsq_cvae::{Frozen, Prepared};
use crate::unirig_skeleton::batch::encode;

/// A rig as the network reads it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sample {
    /// Ids, from `bos` to the last end.
    pub ids: Vec<i64>,
    /// Of each, what [`riglab_nn::tokenrig::Sequences::told`] is.
    pub told: Vec<[f32; 7]>,
    /// Tokens of the skeleton, its end with them.
    pub skeleton: usize,
    /// Joints outside the range, written at its border.
    pub clamped: usize,
}

impl Sample {
    /// About how many bytes it takes.
    pub fn bytes(&self) -> usize {
        36 * self.ids.len() + 96
    }
}

/// Of each joint in the order of a sequence, itself and its parent (the root: itself).
pub fn joints_told(joints: &[[f32; 3]], parents: &[Option<usize>]) -> Vec<[f32; 6]> {
    let each = joints.iter().zip(parents).map(|(own, parent)| {
        let parent = parent.map_or(own, |p| &joints[p]);
        [own[0], own[1], own[2], parent[0], parent[1], parent[2]]
    });
    each.collect()
}

/// What a sequence says of its codes' joints, place by place. `skeleton`: its first ids, to the skeleton's end.
pub fn told(layout: &Layout, ids: &[i64], skeleton: usize, joints: &[[f32; 6]], codes: usize) -> Vec<[f32; 7]> {
    let mut out = vec![[0.0; 7]; ids.len()];
    let (mut joint, mut slot) = (0, 0);
    for (at, row) in out.iter_mut().enumerate().skip(skeleton - 1) {
        if at >= skeleton {
            slot += 1;
            if ids[at] == layout.empty() || slot == codes {
                (joint, slot) = (joint + 1, 0);
            }
        }
        let Some(own) = joints.get(joint) else { break };
        row[..6].copy_from_slice(own);
        row[6] = (slot + 1) as f32;
    }
    out
}

/// The beginning of a rig's sequence, its skeleton, and how many ids follow it in the whole; `None` where it cannot be
/// written.
pub fn skeleton(tokenizer: &Tokenizer, skin: &SkinConfig, rig: &Rig, class: bool) -> Option<(Sample, usize)> {
    let encoded = encode(tokenizer, rig.skeleton(), class).ok()?;
    let ids: Vec<i64> = encoded.ids.iter().map(|&id| i64::from(id)).collect();
    let (told, skeleton) = (vec![[0.0; 7]; ids.len()], ids.len());
    let follow = codes_of(skin, rig).into_iter().sum::<usize>() + 1;
    Some((Sample { ids, told, skeleton, clamped: encoded.clamped }, follow))
}

/// How many ids of each joint follow a skeleton.
fn codes_of(skin: &SkinConfig, rig: &Rig) -> Vec<usize> {
    if !skin.empty {
        return vec![skin.codes; rig.skeleton().len()];
    }
    let mut out = vec![1; rig.skeleton().len()];
    let held = (0..rig.weights().rows()).flat_map(|v| rig.weights().row(v)).filter(|(_, w)| *w > ACTIVE);
    held.for_each(|(joint, _)| out[joint.index()] = skin.codes);
    out
}

/// A rig's sequence; `None` where its skeleton cannot be written. `random` draws the points that its codes are made
/// from.
pub fn sample(
    tokenizer: &Tokenizer,
    (layout, skin): (&Layout, &SkinConfig),
    vae: &Frozen,
    rig: &Rig,
    class: bool,
    random: &mut Stream,
) -> Option<Sample> {
    let encoded = encode(tokenizer, rig.skeleton(), class).ok()?;
    let codes = codes(vae, skin, rig, random);
    let mut ids: Vec<i64> = encoded.ids.iter().map(|&id| i64::from(id)).collect();
    let skeleton = ids.len();
    for &joint in &encoded.order {
        match &codes[joint] {
            Some(codes) => ids.extend(codes.iter().map(|&code| layout.code(code))),
            None => ids.push(layout.empty()),
        }
    }
    ids.push(layout.end());
    let decoded = tokenizer.decode(&encoded.ids).ok()?;
    let joints = joints_told(&decoded.joints, &decoded.parents);
    let told = told(layout, &ids, skeleton, &joints, skin.codes);
    Some(Sample { ids, told, skeleton, clamped: encoded.clamped })
}

/// Of every joint of a rig in the cube, its codes; `None` for those that have none.
pub fn codes(vae: &Frozen, skin: &SkinConfig, rig: &Rig, random: &mut Stream) -> Vec<Option<Vec<i64>>> {
    let prepared = Prepared::of(String::new(), rig.clone(), !skin.empty);
    let mut out = vec![None; rig.skeleton().len()];
    if prepared.bones.is_empty() {
        return out;
    }
    let ids = vae.with(|coder| {
        let codes = coder.encode(&prepared, skin.codes, random).codes;
        let ids = coder.net.fsq().ids(&codes).to_kind(Kind::Int64).to_device(tch::Device::Cpu);
        Vec::<i64>::try_from(ids.contiguous().view([-1])).unwrap_or_default()
    });
    for (bone, codes) in prepared.bones.iter().zip(ids.chunks(skin.codes)) {
        let JointId(joint) = bone.joint;
        out[usize::from(joint)] = Some(codes.to_vec());
    }
    out
}

#[cfg(test)]
mod tests {
    use riglab_nn::tokenrig::Head;

    use super::*;

    #[test]
    fn each_place_is_told_the_joint_of_the_code_that_follows() {
        let layout = Layout::new(10, &[3, 4], Head::Levels);
        let joints = joints_told(&[[0.0; 3], [1.0; 3], [2.0; 3]], &[None, Some(0), Some(1)]);
        let code = layout.code(5);
        // Three ids of a skeleton, two codes, an empty bone, two codes, the end.
        let ids = [1, 2, 3, code, code, layout.empty(), code, code, layout.end()];
        let told = told(&layout, &ids, 3, &joints, 2);
        let shown: Vec<(f32, f32)> = told.iter().map(|t| (t[0], t[6])).collect();
        let (none, last) = ((0.0, 0.0), 2.0);
        assert_eq!(shown, [none, none, (0.0, 1.0), (0.0, 2.0), (1.0, 1.0), (last, 1.0), (last, 2.0), none, none]);
        assert_eq!(told[5][3..6], [1.0; 3]);
    }
}
