//! What codes are told: of their joint, of the surface near it, and what a rule would have there.

use std::collections::VecDeque;
use std::sync::{Mutex, PoisonError};

use riglab_core::Mesh;
use riglab_metric::Baseline;
use riglab_nn::tokenrig::{JointTold, Layout, TokenRigConfig};
use riglab_random::stream;
use riglab_token::Decoded;

use super::sample::codes;
use crate::fsq_cvae::{Frozen, Ground, Prepared, Regions, Surface};

/// The rule whose codes are told: of those by straight distance the one whose IoU with artists' weights is highest on the
/// validation split of real rigs (`experiments/README.md`, the model that comes with riglab now).
const RULE: Baseline = Baseline::InverseCut { power: 4, cut: 0.15 };

/// Skeletons of a mesh whose joints' tellings are kept: as many as are drawn of one at a time.
const KEPT: usize = 64;

/// A mesh in the cube, as codes of one model are told of it.
pub struct Sight {
    surface: Option<Surface>,
    ruled: Option<(Mesh, Ground)>,
    /// What joints were told, by the ids of their skeletons, the last ones.
    known: Mutex<VecDeque<(Vec<u32>, Vec<JointTold>)>>,
}

impl Sight {
    /// Whether a model has codes told of meshes.
    pub fn asked(model: &TokenRigConfig) -> bool {
        model.tell_region || model.tell_rule
    }

    /// What a model has codes told of; `None` where that is nothing.
    pub fn of(model: &TokenRigConfig, mesh: &Mesh) -> Option<Self> {
        Self::asked(model).then(|| Self {
            surface: model.tell_region.then(|| Surface::new(mesh)),
            ruled: model.tell_rule.then(|| (mesh.clone(), Ground::new(mesh))),
            known: Mutex::default(),
        })
    }

    /// What of the mesh alone is known, where a rule's codes are told.
    pub fn ground(&self) -> Option<&Ground> {
        self.ruled.as_ref().map(|(_, ground)| ground)
    }

    /// What the joints of a skeleton are told, made once for many draws of codes for it.
    pub fn once(&self, skeleton: &[u32], make: impl FnOnce() -> Vec<JointTold>) -> Vec<JointTold> {
        let known = || self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, told)) = known().iter().find(|(ids, _)| ids == skeleton) {
            return told.clone();
        }
        let made = make();
        let mut known = known();
        known.push_front((skeleton.to_vec(), made.clone()));
        known.truncate(KEPT);
        made
    }
}

/// What tells the codes of a model.
#[derive(Clone, Copy)]
pub struct Teller<'a> {
    /// What is told.
    pub model: &'a TokenRigConfig,
    /// The ids of sequences.
    pub layout: &'a Layout,
    /// What has the codes of a rule.
    pub vae: &'a Frozen,
    /// Codes of a bone.
    pub codes: usize,
}

impl Teller<'_> {
    /// What the codes of each joint are told, in the order of a sequence: itself, its parent (of the root: itself), and, of
    /// a mesh that is given, what lies near its bones and the codes of a rule, as the model asks. A rule's codes are made
    /// from the same points whenever they are made.
    pub fn joints(&self, skeleton: &Decoded, sight: Option<&Sight>) -> Vec<JointTold> {
        let joints = &skeleton.joints;
        let each = joints.iter().zip(&skeleton.parents).map(|(own, parent)| {
            let mut told = JointTold::default();
            told.geometry[..3].copy_from_slice(own);
            told.geometry[3..6].copy_from_slice(parent.map_or(own, |p| &joints[p]));
            told
        });
        let mut out: Vec<JointTold> = each.collect();
        let (Some(sight), Ok(skeleton)) = (sight, skeleton.skeleton()) else { return out };
        if let Some(surface) = &sight.surface {
            let regions = Regions::new(surface, &skeleton.segments());
            for ((told, region), shares) in out.iter_mut().zip(regions.under(|p| p)).zip(regions.shares()) {
                told.geometry[6..12].copy_from_slice(&region);
                told.geometry[12..].copy_from_slice(&shares);
            }
        }
        if let Some((mesh, ground)) = &sight.ruled
            && let Ok(ruled) = RULE.rig(skeleton, mesh.clone())
        {
            let ruled = Prepared::with_ground(ground, String::new(), ruled, false);
            let of_joints = codes(self.vae, self.codes, &ruled, &mut stream(0, "codes of a rule", &[]));
            for (told, codes) in out.iter_mut().zip(of_joints) {
                told.rule = codes.into_iter().flatten().flat_map(|code| self.layout.levels_of(code)).collect();
            }
        }
        out
    }

    /// What each place of a sequence is told by what its joints are, one after another: see
    /// [`riglab_nn::tokenrig::Sequences::told`]. `skeleton`: its first ids, to the skeleton's end.
    pub fn places(&self, ids: &[i64], skeleton: usize, joints: &[JointTold]) -> Vec<f32> {
        let width = self.model.told(self.layout, self.codes);
        let mut out = vec![0.0; width * ids.len()];
        let (mut joint, mut slot) = (0, 0);
        for (at, place) in out.chunks_exact_mut(width).enumerate().skip(skeleton - 1) {
            if at >= skeleton {
                slot += 1;
                if ids[at] == self.layout.empty() || slot == self.codes {
                    (joint, slot) = (joint + 1, 0);
                }
            }
            let Some(own) = joints.get(joint) else { break };
            own.at(slot, place);
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use riglab_nn::tokenrig::{GEOMETRY, Head};

    use super::*;
    use crate::tokenrig::testing::{tetrahedron, untrained};

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
        let rigger = untrained(Head::Levels, true);
        let (teller, layout) = (rigger.teller(), rigger.layout());
        let joints = teller.joints(&chain(&[[0.0; 3], [1.0; 3], [2.0; 3]]), None);
        let code = layout.code(5);
        // Three ids of a skeleton, two codes, an empty bone, two codes, the end.
        let ids = [1, 2, 3, code, code, layout.empty(), code, code, layout.end()];
        let told = teller.places(&ids, 3, &joints);
        let told: Vec<&[f32]> = told.chunks(told.len() / ids.len()).collect();
        let shown: Vec<(f32, f32)> = told.iter().map(|t| (t[0], t[GEOMETRY])).collect();
        let (none, last) = ((0.0, 0.0), 2.0);
        assert_eq!(shown, [none, none, (0.0, 1.0), (0.0, 2.0), (1.0, 1.0), (last, 1.0), (last, 2.0), none, none]);
        assert_eq!(told[5][3..6], [1.0; 3]);
    }

    #[test]
    fn a_joint_is_told_what_of_the_surface_lies_near_it() {
        // Joints beyond two corners of the four, then one in the middle of the others, or one far from all.
        let (rigger, mesh, out) = (untrained(Head::Levels, true), tetrahedron(), [9.0; 3]);
        let teller = rigger.teller();
        let corners: Vec<[f32; 3]> = mesh.positions()[..2].iter().map(|p| p.map(|x| 1.5 * x)).collect();
        let skeleton = chain(&[corners[0], corners[1], [0.0, 0.0, 1.0]]);
        let of = |skeleton: &Decoded, sight| -> Vec<[f32; GEOMETRY]> {
            teller.joints(skeleton, sight).iter().map(|told| told.geometry).collect()
        };
        let alone = of(&skeleton, None);
        assert!(alone.iter().all(|told| told[6..] == [0.0; 8]), "what was not asked");
        let sight = Sight::of(teller.model, &mesh);
        let near = of(&skeleton, sight.as_ref());
        assert!(near.iter().zip(&alone).all(|(near, alone)| near[..6] == alone[..6]));
        let area: f32 = near.iter().map(|told| told[12]).sum();
        assert!((area - 1.0).abs() < 0.05, "shares of the whole: {area}");
        assert!(near.iter().all(|told| (0.0..=1.0).contains(&told[13])));
        // The last joint lies as near to the two corners that are left as the bone that ends there: half of half is its.
        assert!((near[2][12] - 0.25).abs() < 0.01 && (near[2][13] - 0.5).abs() < 0.01, "{:?}", near[2]);
        assert!((near[2][8] - 1.0).abs() < 0.01 && near[2][9] > 0.5, "{:?}", near[2]);
        let far = of(&chain(&[corners[0], corners[1], out]), sight.as_ref());
        assert!(far[2][12] < 1e-3 && far[2][13] < 0.1, "{:?}", far[2]);
    }

    #[test]
    fn what_is_told_of_a_skeleton_is_made_once_a_mesh() {
        let rigger = untrained(Head::Levels, true);
        let teller = rigger.teller();
        let (sight, other) = [tetrahedron(), tetrahedron()].map(|m| Sight::of(teller.model, &m).unwrap()).into();
        let ask = |sight: &Sight, skeleton: &[u32], x: f32| {
            sight.once(skeleton, || teller.joints(&chain(&[[x; 3]]), None))[0].geometry[0]
        };
        assert_eq!((ask(&sight, &[1], 1.0), ask(&sight, &[2], 2.0), ask(&sight, &[1], 3.0)), (1.0, 2.0, 1.0));
        assert_eq!(ask(&other, &[1], 3.0), 3.0, "another mesh");
        (10..10 + KEPT as u32).for_each(|id| _ = ask(&sight, &[id], 0.0));
        assert_eq!(ask(&sight, &[1], 4.0), 4.0, "the last ones are kept");
    }

    #[test]
    fn a_joint_is_told_the_codes_of_a_rule_where_it_holds_something() {
        let (rigger, mesh) = (untrained(Head::Levels, true), tetrahedron());
        let corners: Vec<[f32; 3]> = mesh.positions()[..2].iter().map(|p| p.map(|x| 1.5 * x)).collect();
        let skeleton = chain(&[corners[0], corners[1], [9.0; 3]]);
        let told = |model: &TokenRigConfig| {
            let teller = Teller { model, ..rigger.teller() };
            teller.joints(&skeleton, Sight::of(model, &mesh).as_ref())
        };
        let model = &rigger.config().model;
        let all = told(model);
        // Two codes of two axes, each on one of its levels.
        let levels = |own: &JointTold| own.rule.len() == 4 && own.rule.iter().all(|x| (-1.0..=1.0).contains(x));
        assert!(levels(&all[0]) && levels(&all[1]) && all[2].rule.is_empty(), "{all:?}");
        assert_eq!(all, told(model), "from the same points");
        let without = told(&TokenRigConfig { tell_rule: false, ..model.clone() });
        assert!(without.iter().all(|own| own.rule.is_empty()) && without[0].geometry == all[0].geometry);
        let alone = told(&TokenRigConfig { tell_region: false, ..model.clone() });
        assert!(alone[0].geometry[6..] == [0.0; 8] && alone[0].rule == all[0].rule);
        let none = TokenRigConfig { tell_region: false, tell_rule: false, ..model.clone() };
        assert!(Sight::of(&none, &mesh).is_none());
    }
}
