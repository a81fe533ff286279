//! A skeleton of which some joints are given: the model writes the others.
//!
//! Skeletons are drawn freely, as always. In each of them given joints take the places of drawn ones, limb by limb, what was
//! drawn around these follows them, and what is left of it are the joints that were missing: a draw as it would have been had
//! the given joints been in it. Of those the one that the others agree with most is taken, and the joints that it adds are
//! moved to where the others have them.
//!
//! The other way, to have the given joints read and the sequence go on from there, was measured, too (experiments/README.md):
//! it is further from the truth, and loses its way where given joints are not like those that the model learned from.
//!
//! The papers leave directed topology as an open limitation; this needs no training of its own.

mod merge;
mod part;

use glam::DVec3;
use riglab_core::{Joint, JointId, Similarity, Skeleton};
use riglab_metric::{Joints, consensus_with, refined};
use riglab_nn::generate::GenerateConfig;
use riglab_nn::params::Weights;
use riglab_random::stream;
use riglab_token::Bones;

use self::merge::{Merged, grafted};
pub(super) use self::part::part;
use super::{Condition, RigSample, Rigger};
use crate::unirig_skeleton::agree::{Agreement, joints_in_the_mirror};
use crate::unirig_skeleton::batch::class_of;
use crate::unirig_skeleton::evaluate::joints;

/// What a given joint counts, in the cube, that a draw has nowhere or further away: about what joints of two sane skeletons
/// are apart at most.
const LOST: f64 = 0.25;

impl Rigger {
    /// A skeleton that begins with these joints, as they are and in their order; after them come those that the model adds.
    /// `seen`: its mesh in as many clouds as draws are shared out to; `map`: from its units into the cube.
    ///
    /// # Errors
    /// When the given joints cannot be written within the limits, or nothing comes out.
    pub(super) fn completed(
        &self,
        w: &Weights,
        seen: &Condition,
        (begun, map): (&Skeleton, Similarity),
        how: &GenerateConfig,
        (agreement, seed): (Agreement, u64),
    ) -> Result<Skeleton, String> {
        self.given(begun, map)?;
        let drawn = self.free_draws(w, seen, how, (&agreement, seed))?;
        self.completed_by(&drawn, (begun, map), &agreement)
    }

    /// Skeletons of a mesh with nothing given, as many as are asked which they agree on.
    ///
    /// # Errors
    /// As [`Self::draw_skeletons`].
    pub(super) fn free_draws(
        &self,
        w: &Weights,
        seen: &Condition,
        how: &GenerateConfig,
        (agreement, seed): (&Agreement, u64),
    ) -> Result<Vec<RigSample>, String> {
        let shares = agreement.shares();
        let mut streams: Vec<_> = (0..agreement.draws as u64).map(|k| stream(seed, "rig draws", &[k])).collect();
        self.draw_skeletons(w, &seen.first(shares.len()), (&self.free(), &shares), how, &mut streams)
    }

    /// As [`Self::completed`], of these free draws.
    ///
    /// # Errors
    /// As [`Self::completed`].
    pub(super) fn completed_by(
        &self,
        drawn: &[RigSample],
        (begun, map): (&Skeleton, Similarity),
        agreement: &Agreement,
    ) -> Result<Skeleton, String> {
        self.given(begun, map)?;
        let given = Joints {
            positions: begun.heads().iter().map(|&p| map.apply(p).map(f64::from)).collect(),
            parents: begun.parents().iter().map(|p| p.map(JointId::index)).collect(),
        };
        let (mut own, mut voters) = (Vec::new(), Vec::new());
        for (drawn, mirrored) in drawn.iter().zip(agreement.draws_mirrored()) {
            match &drawn.decoded {
                Ok(decoded) if mirrored => voters.push(grafted(&given, &joints_in_the_mirror(decoded)).tree),
                Ok(decoded) => own.push(grafted(&given, &joints(decoded))),
                Err(_) => {}
            }
        }
        let all = agreed(&own, voters, agreement.refine).ok_or("no skeleton came out; try another --seed")?;
        let joints = whole(begun, &all, map);
        // The first ones, where there is no room for all.
        let (mut count, limits) = (joints.len(), self.config.limits);
        while count > begun.len() && !(count <= limits.joints && self.length(&joints[..count], map) <= limits.tokens) {
            count -= 1;
        }
        Skeleton::new(joints[..count].to_vec()).map_err(|e| e.to_string())
    }

    /// How many tokens joints take; more than there are where they cannot be written.
    pub(super) fn length(&self, all: &[Joint], map: Similarity) -> usize {
        let joints: Vec<_> = all.iter().map(|joint| map.apply(joint.head).map(f64::from)).collect();
        let parents: Vec<_> = all.iter().map(|joint| joint.parent.map(JointId::index)).collect();
        let names: Vec<_> = all.iter().map(|joint| joint.name.clone()).collect();
        let bones = Bones { joints: &joints, parents: &parents, names: &names };
        let class = class_of(&self.tokenizer, &self.config.class, &names);
        self.tokenizer.encode_bones(&bones, class).map_or(usize::MAX, |encoded| encoded.ids.len())
    }
}

/// Of draws with the given joints in them the one that the others and `voters` agree with most; what it adds is moved to
/// where these have it.
fn agreed(own: &[Merged], mut voters: Vec<Joints>, rounds: usize) -> Option<Merged> {
    let mut candidates: Vec<Joints> = own.iter().map(|all| all.tree.clone()).collect();
    let lost = |all: &Merged| {
        let off = |by: &Option<DVec3>| by.map_or(LOST, |by| by.length().min(LOST));
        let given = all.given.iter().zip(&all.moved).filter(|(given, _)| given.is_some());
        let (count, sum) = given.fold((0, 0.0), |(count, sum), (_, by)| (count + 1, sum + off(by)));
        // On average, as one more of the three distances between draws.
        sum / f64::from(count.max(1))
    };
    let lost: Vec<f64> = own.iter().map(lost).collect();
    let mut all = own.get(consensus_with(&candidates, &voters, &lost)?)?.clone();
    voters.append(&mut candidates);
    // What has no bones says nothing of where joints are.
    voters.retain(|v| v.positions.len() > 1);
    let moved = refined(&all.tree, &voters, rounds);
    for (joint, given) in all.given.iter().enumerate() {
        if given.is_none() {
            all.tree.positions[joint] = moved.positions[joint];
        }
    }
    Some(all)
}

/// The given joints as they are, and the others after them.
fn whole(begun: &Skeleton, all: &Merged, map: Similarity) -> Vec<Joint> {
    let (names, parents, heads) = begun.clone().into_parts();
    let joints = names.into_iter().zip(parents).zip(heads);
    let mut joints: Vec<Joint> = joints.map(|((name, parent), head)| Joint { name, parent, head }).collect();
    let mut place: Vec<usize> = all.given.iter().map(|g| g.unwrap_or(0)).collect();
    for at in (0..all.given.len()).filter(|&at| all.given[at].is_none()) {
        place[at] = joints.len();
        let free = |name: &String| joints.iter().all(|joint| joint.name != *name);
        joints.push(Joint {
            name: (joints.len()..).map(|n| format!("bone_{n}")).find(free).unwrap_or_default(),
            parent: all.tree.parents[at].and_then(|p| u16::try_from(place[p]).ok()).map(JointId),
            head: map.inverse().apply(all.tree.positions[at].map(|x| x as f32)),
        });
    }
    joints
}

#[cfg(test)]
mod tests {
    use riglab_core::Mesh;
    use riglab_nn::tokenrig::Head;
    use riglab_random::{Draw, Stream};

    use super::*;
    use crate::tokenrig::RigRequest;
    use crate::tokenrig::testing::{tetrahedron, untrained};

    /// A tree of so many joints within the mesh.
    fn tree(count: u16, random: &mut Stream) -> Skeleton {
        let joint = |k: u16, random: &mut Stream| Joint {
            name: format!("own {k}"),
            parent: (k > 0).then(|| JointId(random.below(usize::from(k)) as u16)),
            head: std::array::from_fn(|_| random.within(-0.9, 0.9)),
        };
        Skeleton::new((0..count).map(|k| joint(k, random)).collect()).unwrap()
    }

    fn completed(rigger: &Rigger, mesh: &Mesh, begun: &Skeleton, seed: u64) -> Skeleton {
        let wish =
            RigRequest { skeleton: Some(begun), complete: true, samples: Some(3), seed, ..RigRequest::default() };
        let made = rigger.make(mesh, &wish).unwrap();
        assert_eq!((made.weights.rows(), made.draws.len()), (mesh.positions().len(), 1));
        made.skeleton
    }

    #[test]
    fn given_joints_come_back_unchanged_and_others_after_them() {
        let mesh = tetrahedron();
        let mut added = 0;
        for (head, empty) in [(Head::Flat, false), (Head::Levels, true)] {
            let mut rigger = untrained(head, empty);
            for up in [crate::assets::Up::Y, crate::assets::Up::Z] {
                rigger.config.data.up = up;
                for count in [1u16, 2, 4, 6] {
                    let begun = tree(count, &mut stream(0, "test", &[u64::from(count)]));
                    let whole = completed(&rigger, &mesh, &begun, u64::from(count));
                    let first = usize::from(count);
                    assert_eq!(whole.names()[..first], *begun.names());
                    assert_eq!(whole.parents()[..first], *begun.parents());
                    assert_eq!(whole.heads()[..first], *begun.heads());
                    // As many as the model may have.
                    assert!(whole.len() <= 6 && whole.names()[first..].iter().all(|name| name.starts_with("bone_")));
                    added += whole.len() - first;
                }
            }
        }
        assert!(added > 0);
        let rigger = untrained(Head::Levels, true);
        let begun = tree(2, &mut stream(7, "test", &[]));
        assert_eq!(completed(&rigger, &mesh, &begun, 1), completed(&rigger, &mesh, &begun, 1), "the same each time");
    }

    #[test]
    fn what_has_no_room_is_refused_as_any_given_skeleton() {
        let (rigger, mesh) = (untrained(Head::Levels, true), tetrahedron());
        let begun = tree(7, &mut stream(0, "test", &[]));
        let wish = RigRequest { skeleton: Some(&begun), complete: true, ..RigRequest::default() };
        assert!(rigger.make(&mesh, &wish).unwrap_err().contains("reads at most 6 joints"));
    }
}
