//! Rigs as whole sequences: a skeleton's tokens, then its bones' codes.

use riglab_core::{JointId, Rig};
use riglab_metric::ACTIVE;
use riglab_nn::tokenrig::{JointTold, Layout, TOLD, Told};
use riglab_random::Stream;
use riglab_token::{Decoded, Tokenizer};
use tch::Kind;

use super::config::SkinConfig;
use crate::fsq_cvae::{Frozen, Prepared, Regions, Surface};
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
        8 * self.ids.len() + size_of_val(&*self.joints) + 96
    }
}

/// What the codes of each joint are told, in the order of a sequence: itself, its parent (of the root: itself), and, of a
/// surface that is given, what lies near its bones.
pub fn joints_told(skeleton: &Decoded, surface: Option<&Surface>) -> Vec<JointTold> {
    let joints = &skeleton.joints;
    let each = joints.iter().zip(&skeleton.parents).map(|(own, parent)| {
        let mut told = [0.0; TOLD - 1];
        told[..3].copy_from_slice(own);
        told[3..6].copy_from_slice(parent.map_or(own, |p| &joints[p]));
        told
    });
    let mut out: Vec<JointTold> = each.collect();
    if let (Some(surface), Ok(skeleton)) = (surface, skeleton.skeleton()) {
        let regions = Regions::new(surface, &skeleton.segments());
        for ((told, region), shares) in out.iter_mut().zip(regions.under(|p| p)).zip(regions.shares()) {
            told[6..12].copy_from_slice(&region);
            told[12..].copy_from_slice(&shares);
        }
    }
    out
}

/// What each place of a sequence is told, by what its joints are. `skeleton`: its first ids, to the skeleton's end.
pub fn told(layout: &Layout, ids: &[i64], skeleton: usize, joints: &[JointTold], codes: usize) -> Vec<Told> {
    let mut out = vec![[0.0; TOLD]; ids.len()];
    let (mut joint, mut slot) = (0, 0);
    for (at, row) in out.iter_mut().enumerate().skip(skeleton - 1) {
        if at >= skeleton {
            slot += 1;
            if ids[at] == layout.empty() || slot == codes {
                (joint, slot) = (joint + 1, 0);
            }
        }
        let Some(own) = joints.get(joint) else { break };
        row[..TOLD - 1].copy_from_slice(own);
        row[TOLD - 1] = (slot + 1) as f32;
    }
    out
}

/// The beginning of a rig's sequence, its skeleton, and how many ids follow it in the whole; `None` where it cannot be
/// written.
pub fn skeleton(tokenizer: &Tokenizer, skin: &SkinConfig, rig: &Rig, class: bool) -> Option<(Sample, usize)> {
    let encoded = encode(tokenizer, rig.skeleton(), class).ok()?;
    let ids: Vec<i64> = encoded.ids.iter().map(|&id| i64::from(id)).collect();
    let skeleton = ids.len();
    let follow = codes_of(skin, rig).into_iter().sum::<usize>() + 1;
    Some((Sample { ids, skeleton, clamped: encoded.clamped, ..Sample::default() }, follow))
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

/// A rig's sequence; `None` where its skeleton cannot be written. `near`: whether its codes are told what lies near their
/// joints. `random` draws the points that its codes are made from.
pub fn sample(
    tokenizer: &Tokenizer,
    (layout, skin): (&Layout, &SkinConfig),
    vae: &Frozen,
    (rig, near): (&Rig, bool),
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
    let surface = near.then(|| Surface::new(rig.mesh()));
    let joints = joints_told(&decoded, surface.as_ref());
    Some(Sample { ids, joints, skeleton, clamped: encoded.clamped })
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
    use crate::tokenrig::testing::tetrahedron;

    /// Each joint the child of the one before.
    fn chain(joints: &[[f32; 3]]) -> Decoded {
        Decoded {
            joints: joints.to_vec(),
            parents: (0..joints.len()).map(|j| j.checked_sub(1)).collect(),
            names: (0..joints.len()).map(|j| format!("bone_{j}")).collect(),
            class: None,
            parts: Vec::new(),
        }
    }

    #[test]
    fn each_place_is_told_the_joint_of_the_code_that_follows() {
        let layout = Layout::new(10, &[3, 4], Head::Levels);
        let joints = joints_told(&chain(&[[0.0; 3], [1.0; 3], [2.0; 3]]), None);
        let code = layout.code(5);
        // Three ids of a skeleton, two codes, an empty bone, two codes, the end.
        let ids = [1, 2, 3, code, code, layout.empty(), code, code, layout.end()];
        let told = told(&layout, &ids, 3, &joints, 2);
        let shown: Vec<(f32, f32)> = told.iter().map(|t| (t[0], t[TOLD - 1])).collect();
        let (none, last) = ((0.0, 0.0), 2.0);
        assert_eq!(shown, [none, none, (0.0, 1.0), (0.0, 2.0), (1.0, 1.0), (last, 1.0), (last, 2.0), none, none]);
        assert_eq!(told[5][3..6], [1.0; 3]);
    }

    #[test]
    fn a_joint_is_told_what_of_the_surface_lies_near_it() {
        // Joints beyond two corners of the four, then one in the middle of the others, or one far from all.
        let (mesh, out) = (tetrahedron(), [9.0; 3]);
        let corners: Vec<[f32; 3]> = mesh.positions()[..2].iter().map(|p| p.map(|x| 1.5 * x)).collect();
        let skeleton = chain(&[corners[0], corners[1], [0.0, 0.0, 1.0]]);
        let alone = joints_told(&skeleton, None);
        assert!(alone.iter().all(|told| told[6..] == [0.0; 8]), "what was not asked");
        let surface = Surface::new(&mesh);
        let near = joints_told(&skeleton, Some(&surface));
        assert!(near.iter().zip(&alone).all(|(near, alone)| near[..6] == alone[..6]));
        let area: f32 = near.iter().map(|told| told[12]).sum();
        assert!((area - 1.0).abs() < 0.05, "shares of the whole: {area}");
        assert!(near.iter().all(|told| (0.0..=1.0).contains(&told[13])));
        // The last joint lies as near to the two corners that are left as the bone that ends there: half of half is its.
        assert!((near[2][12] - 0.25).abs() < 0.01 && (near[2][13] - 0.5).abs() < 0.01, "{:?}", near[2]);
        assert!((near[2][8] - 1.0).abs() < 0.01 && near[2][9] > 0.5, "{:?}", near[2]);
        let far = joints_told(&chain(&[corners[0], corners[1], out]), Some(&surface));
        assert!(far[2][12] < 1e-3 && far[2][13] < 0.1, "{:?}", far[2]);
    }
}
