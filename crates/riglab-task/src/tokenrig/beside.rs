//! Bodies with things beside them: a sword in the hand, a plate under the feet, another level of detail.
//!
//! The network has seen few of these, and what it draws then is often no body at all. Where the draw that is taken is none,
//! though one piece of surface has most of the area, skeletons are drawn of that piece alone. If the one that these agree on
//! is a body, and they agree better, it is taken, and weights are made for the whole mesh with it. Geometry proposes and the
//! draws decide, as with [turns](super::facing).

use riglab_core::Bounds;
use riglab_geom::main_piece;

use super::make::{GeneratedRig, Rank, RigRequest};
use super::stage::Stage;
use super::template::{Anatomy, FindHuman};
use super::{RigSample, Rigger};
use crate::unirig_skeleton::agree::{Agreement, Chosen};

/// A piece has as much of the area, at least.
const MOST: f64 = 0.5;

/// Skeletons that are drawn to see whether it is worth it.
const TRIES: usize = 16;

/// Whether so many draws are bodies that it may be one. Of a man of whom all is seen about half are.
pub fn many_bodies(bodies: usize, draws: usize) -> bool {
    4 * bodies >= draws
}

impl Rigger {
    /// A rig whose skeleton was made without what stands beside the body, if there is such a thing, what was `taken` is no body,
    /// and what is taken without it is one on which draws agree better.
    ///
    /// # Errors
    /// As [`Self::make`].
    pub(super) fn without_beside(
        &self,
        stage: &Stage<'_>,
        wish: &RigRequest<'_>,
        anatomy: Anatomy<'_>,
        (agreement, taken): (&Agreement, &Chosen<RigSample>),
    ) -> Result<Option<GeneratedRig>, String> {
        let is_body = |decoded| anatomy.is_body(decoded);
        if taken.drawn.decoded.as_ref().is_ok_and(is_body) {
            return Ok(None);
        }
        let Some((body, others)) = main_piece(stage.mesh, MOST) else { return Ok(None) };
        // What is held on one side would not be the mirror image of anything.
        let facing = self.facing(self.params.weights(), &body, wish.seed)?;
        let tries = Agreement { draws: TRIES.min(agreement.draws), ..*agreement };
        let (alone, _) = self.stage(&body, None, wish, facing)?;
        let tried =
            self.candidates(self.params.weights(), &alone, (self.free(), tries.draws), Some(&tries), wish.seed)?;
        if !many_bodies(self.anatomy(&alone, anatomy.human).bodies(&tried, &tries), tries.draws) {
            return Ok(None);
        }
        let one = RigRequest { skins: Some(1), ..wish.clone() };
        let body = self.make_facing(&body, None, &one, facing)?;
        let agreed = body.apart.zip(taken.apart).is_none_or(|(without, with)| without < with);
        if !(agreed && body.human && body.bodies.is_some_and(|bodies| many_bodies(bodies, agreement.draws))) {
            return Ok(None);
        }
        let up = self.config.data.up;
        let skeleton = up.skeleton(&body.skeleton).map_err(|e| e.to_string())?;
        let given = RigRequest { samples: None, rank: Rank::Likelihood, ..wish.clone() };
        let made = self.make_facing(stage.mesh, Some(skeleton), &given, facing)?;
        let GeneratedRig { bodies, human, apart, sample, draws, .. } = body;
        Ok(Some(GeneratedRig { bodies, human, apart, sample, draws, beside: Some(others), ..made }))
    }

    /// How bodies are told among draws on a stage.
    pub(super) fn anatomy<'a>(&self, stage: &Stage<'_>, human: &'a FindHuman<'a>) -> Anatomy<'a> {
        let up = self.config.data.up;
        let bounds = Bounds::of(stage.cube.positions().iter().map(|&p| up.back(p)));
        Anatomy { human, up, bounds, plane: None }
    }
}

#[cfg(test)]
mod tests {
    use riglab_core::{Humanoid, Mesh, Skeleton};
    use riglab_nn::tokenrig::Head;

    use super::*;
    use crate::tokenrig::testing::{tetrahedron, untrained};

    /// A tetrahedron with a small one beside it.
    fn holding() -> Mesh {
        let own = tetrahedron();
        let small = own.positions().iter().map(|p| [0.2 * p[0] + 2.0, 0.2 * p[1], 0.2 * p[2]]);
        let positions = own.positions().iter().copied().chain(small).collect();
        let count = own.positions().len() as u32;
        let beside = own.triangles().iter().map(|t| t.map(|v| v + count));
        Mesh::new(positions, own.triangles().iter().copied().chain(beside).collect()).unwrap()
    }

    #[test]
    fn where_draws_are_bodies_without_what_is_beside_its_skeleton_is_made_so() {
        let mut rigger = untrained(Head::Levels, true);
        rigger.config.eval.consensus = 4;
        let mesh = holding();
        // A body is what fits into the box of the large piece alone.
        let body = |all: bool| {
            move |_: &Skeleton, bounds: Option<Bounds>| {
                let size = bounds?.size();
                (all || size[0] < 1.5 * size[1]).then(Humanoid::default)
            }
        };
        let make = |mesh: &Mesh, human: &FindHuman<'_>, seed| {
            rigger.make(mesh, &RigRequest { human: Some(human), seed, ..RigRequest::default() }).unwrap()
        };
        let mut made_so = 0;
        for seed in 0..6 {
            let own = make(&tetrahedron(), &body(false), seed);
            let with = make(&mesh, &|_: &Skeleton, _: Option<Bounds>| None, seed);
            assert_eq!((own.beside, with.beside, own.bodies, with.bodies), (None, None, Some(4), Some(0)));
            let made = make(&mesh, &body(false), seed);
            assert_eq!(made.weights.rows(), mesh.positions().len());
            // If draws agree better on the piece alone, its skeleton is taken.
            let better = own.apart < with.apart;
            assert_eq!(made.beside, better.then_some(1));
            let taken = if better { &own } else { &with };
            assert_eq!((made.skeleton.heads(), made.apart), (taken.skeleton.heads(), taken.apart));
            made_so += u32::from(better);
            assert_eq!(make(&mesh, &body(true), seed).beside, None, "bodies are drawn as it is");
        }
        assert!((1..6).contains(&made_so), "{made_so}");
    }
}
