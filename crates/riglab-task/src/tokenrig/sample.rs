//! Rigs as whole sequences: a skeleton's tokens, then its bones' codes.

use riglab_core::{JointId, Rig};
use riglab_nn::tokenrig::JointTold;
use riglab_random::Stream;
use riglab_token::{EncodeFault, Tokenizer};
use tch::Kind;

use super::config::SkinConfig;
use super::told::{Sight, Teller};
use crate::fsq_cvae::{Frozen, Prepared, threshold};
use crate::sequences::Unfit;
use crate::unirig_skeleton::batch::encode;

/// A rig as the network reads it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sample {
    /// Ids, from `bos` to the last end.
    pub ids: Vec<i64>,
    /// What each joint's codes are told, in the order of the sequence; none where codes are left out.
    pub joints: Vec<JointTold>,
    /// Tokens of the skeleton, its end with them.
    pub skeleton: usize,
    /// Joints outside the range, written at its border.
    pub clamped: usize,
}

impl Sample {
    /// About how many bytes it takes.
    pub fn bytes(&self) -> usize {
        let rules: usize = self.joints.iter().map(|own| 4 * own.rule.len()).sum();
        8 * self.ids.len() + size_of_val(&*self.joints) + rules + 96
    }
}

/// The beginning of a rig's sequence, its skeleton, and how many ids follow it in the whole. `class`, and whether it is
/// `told` by names, as of [`encode`].
///
/// # Errors
/// Where it cannot be written.
pub fn skeleton(
    tokenizer: &Tokenizer,
    skin: &SkinConfig,
    rig: &Rig,
    (class, told): (&str, bool),
) -> Result<(Sample, usize), EncodeFault> {
    let encoded = encode(tokenizer, class, rig.skeleton(), told)?;
    let ids: Vec<i64> = encoded.ids.iter().map(|&id| i64::from(id)).collect();
    let skeleton = ids.len();
    let follow = codes_of(skin, rig).into_iter().sum::<usize>() + 1;
    Ok((Sample { ids, skeleton, clamped: encoded.clamped, ..Sample::default() }, follow))
}

/// How many ids of each joint follow a skeleton.
fn codes_of(skin: &SkinConfig, rig: &Rig) -> Vec<usize> {
    if !skin.empty {
        return vec![skin.codes; rig.skeleton().len()];
    }
    let mut out = vec![1; rig.skeleton().len()];
    let threshold = threshold(rig.weights());
    let held = (0..rig.weights().rows()).flat_map(|v| rig.weights().row(v)).filter(|(_, w)| *w > threshold);
    held.for_each(|(joint, _)| out[joint.index()] = skin.codes);
    out
}

/// A rig's sequence, as of [`skeleton`]. `random` draws the points that its codes are made from.
///
/// # Errors
/// Where its skeleton cannot be written, or not be read again.
pub(crate) fn sample(
    tokenizer: &Tokenizer,
    skin: &SkinConfig,
    teller: &Teller,
    rig: &Rig,
    (class, told): (&str, bool),
    random: &mut Stream,
) -> Result<Sample, Unfit> {
    let encoded = encode(tokenizer, class, rig.skeleton(), told)?;
    let sight = Sight::of(teller.model, rig.mesh());
    let prepared = match sight.as_ref().and_then(Sight::ground) {
        Some(ground) => Prepared::with_ground(ground, String::new(), rig.clone(), !skin.empty),
        None => Prepared::of(String::new(), rig.clone(), !skin.empty),
    };
    let (layout, codes) = (teller.layout, codes(teller.vae, skin.codes, &prepared, random));
    let mut ids: Vec<i64> = encoded.ids.iter().map(|&id| i64::from(id)).collect();
    let skeleton = ids.len();
    for &joint in &encoded.order {
        match &codes[joint] {
            Some(codes) => ids.extend(codes.iter().map(|&code| layout.code(code))),
            None => ids.push(layout.empty()),
        }
    }
    ids.push(layout.end());
    let decoded = tokenizer.decode(&encoded.ids).map_err(|fault| Unfit::Unwritten(fault.to_string()))?;
    let joints = teller.joints(&decoded, sight.as_ref());
    Ok(Sample { ids, joints, skeleton, clamped: encoded.clamped })
}

/// Of every joint of a rig in the cube, its first so many codes; `None` for those that are no bones.
pub fn codes(vae: &Frozen, count: usize, prepared: &Prepared, random: &mut Stream) -> Vec<Option<Vec<i64>>> {
    let mut out = vec![None; prepared.rig.skeleton().len()];
    if prepared.bones.is_empty() {
        return out;
    }
    let ids = vae.with(|coder| {
        let codes = coder.encode(prepared, count, random).codes;
        let ids = coder.net.fsq().ids(&codes).to_kind(Kind::Int64).to_device(tch::Device::Cpu);
        Vec::<i64>::try_from(ids.contiguous().view([-1])).unwrap_or_default()
    });
    for (bone, codes) in prepared.bones.iter().zip(ids.chunks(count)) {
        let JointId(joint) = bone.joint;
        out[usize::from(joint)] = Some(codes.to_vec());
    }
    out
}
