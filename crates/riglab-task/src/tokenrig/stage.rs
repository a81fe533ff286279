//! A mesh as it is looked at while its rig is made, and what is done there.

use riglab_core::{Bounds, Mesh, Similarity, Skeleton, SkinWeights};
use riglab_nn::generate::GenerateConfig;
use riglab_nn::params::Weights;
use riglab_random::stream;
use riglab_token::Template;

use super::condition::Condition;
use super::facing::Facing;
use super::make::{GeneratedRig, Rank, RigRequest};
use super::skin::{Hold, in_order};
use super::template::{Anatomy, Placed, alone, known};
use super::thinned::ReadSkeleton;
use super::{RigSample, Rigger};
use crate::unirig_skeleton::agree::Agreement;

/// A mesh, turned and in the cube, as the encoder sees it.
pub(super) struct Stage<'a> {
    /// As it stands, in the network's axes.
    pub mesh: &'a Mesh,
    /// How it was turned.
    pub facing: Facing,
    /// From the turned mesh into the cube.
    pub map: Similarity,
    /// It there.
    pub cube: Mesh,
    /// What the decoder reads of it.
    pub clouds: Condition,
    /// How the first skeleton is drawn; others are sampled.
    pub how: GenerateConfig,
}

impl Stage<'_> {
    /// A skeleton of the turned mesh in the cube.
    ///
    /// # Errors
    /// None for the joints of a skeleton.
    pub fn in_cube(&self, turned: &Skeleton) -> Result<Skeleton, String> {
        let heads = turned.heads().iter().map(|&p| self.map.apply(p)).collect();
        turned.with_heads(heads).map_err(|e| e.to_string())
    }

    /// A skeleton in the cube as it stands with the mesh, in the network's axes.
    ///
    /// # Errors
    /// As [`Self::in_cube`].
    pub fn stood(&self, in_cube: &Skeleton) -> Result<Skeleton, String> {
        let back = self.map.inverse();
        let heads = in_cube.heads().iter().map(|&p| self.facing.back(back.apply(p))).collect();
        in_cube.with_heads(heads).map_err(|e| e.to_string())
    }
}

/// What becomes of a template.
pub(super) enum Settled {
    /// The drawn rig is taken.
    Stays(Placed),
    /// Another one takes its place.
    Instead(Box<GeneratedRig>),
}

/// What a wish gives: a turned skeleton, and how it is read.
pub(super) type GivenSkeleton<'a> = (&'a Skeleton, ReadSkeleton<'a>);

impl RigRequest<'_> {
    /// Which of a skeleton's joints may hold anything, where that is told of them all.
    pub(super) fn holders_of(&self, skeleton: &Skeleton) -> Option<&[bool]> {
        self.holders.filter(|able| able.len() == skeleton.len() && able.contains(&true))
    }
}

impl Rigger {
    /// Sets a mesh on the stage, with the skeleton that is given for it, turned.
    ///
    /// # Errors
    /// A mesh without vertices.
    pub(super) fn stage<'a>(
        &self,
        mesh: &'a Mesh,
        given: Option<Skeleton>,
        wish: &RigRequest<'_>,
        facing: Facing,
    ) -> Result<(Stage<'a>, Option<Skeleton>), String> {
        let turned = facing.mesh(mesh).map_err(|e| e.to_string())?;
        let given = given.map(|s| facing.skeleton(&s)).transpose().map_err(|e| e.to_string())?;
        let heads = given.iter().flat_map(|s| s.heads().iter().copied());
        let bounds = Bounds::of(turned.positions().iter().copied().chain(heads)).ok_or("a mesh without vertices")?;
        let map = Similarity::into_cube(bounds);
        let moved = turned.positions().iter().map(|&p| map.apply(p)).collect();
        let cube = turned.with_positions(moved).map_err(|e| e.to_string())?;
        let clouds = self.clouds(self.params.weights(), &cube, wish.seed);
        let generate = &self.config.eval.generate;
        let how = GenerateConfig { temperature: wish.temperature.unwrap_or(generate.temperature), ..generate.clone() };
        Ok((Stage { mesh, facing, map, cube, clouds, how }, given))
    }

    /// Draws after a prompt, the first of the likeliest tokens unless `eval.generate` samples: skeletons alone where it is to be seen on which they `agree`,
    /// as that is known before any codes are, else whole rigs.
    ///
    /// # Errors
    /// As [`Self::draw`].
    pub(super) fn candidates(
        &self,
        w: &Weights,
        stage: &Stage<'_>,
        (prompt, samples): (Vec<u32>, usize),
        agree: Option<&Agreement>,
        seed: u64,
    ) -> Result<Vec<RigSample>, String> {
        let (clouds, how) = (&stage.clouds, &stage.how);
        let mut streams: Vec<_> = (0..samples as u64).map(|k| stream(seed, "rig draws", &[k])).collect();
        if let Some(agreement) = agree {
            let shares = agreement.shares();
            return self.draw_skeletons(w, &clouds.first(shares.len()), (&prompt, &shares), how, &mut streams);
        }
        let (seen, (first, others)) = (clouds.first(1), streams.split_at_mut(1));
        let mut drawn = self.draw(w, &seen, std::slice::from_ref(&prompt), how, first)?;
        if samples > 1 {
            let how = GenerateConfig { sample: true, ..how.clone() };
            drawn.extend(self.draw(w, &seen, &vec![prompt; samples - 1], &how, others)?);
        }
        Ok(drawn)
    }

    /// What becomes of a template, after the rig that was taken with it. `agree`: with which draws were chosen, and which of
    /// them are bodies as the template has them.
    ///
    /// # Errors
    /// As [`Self::make`].
    pub(super) fn settled(
        &self,
        stage: &Stage<'_>,
        wish: &RigRequest<'_>,
        (template, anatomy): (&Template, Anatomy<'_>),
        drawn: &RigSample,
        agree: Option<(Agreement, &[bool])>,
    ) -> Result<Settled, String> {
        let given = RigRequest { class: None, samples: None, rank: Rank::Likelihood, ..wish.clone() };
        let instead = |skeleton: Option<&Skeleton>, wish: &RigRequest<'_>, placed| {
            let skeleton = skeleton.map(|skeleton| stage.stood(skeleton)).transpose()?;
            let made = self.make_facing(stage.mesh, skeleton, wish, stage.facing)?;
            Ok(Settled::Instead(Box::new(GeneratedRig { placed: Some(placed), ..made })))
        };
        let body = drawn.decoded.as_ref().ok().filter(|decoded| anatomy.written(template, decoded, false));
        if let Some(decoded) = body {
            let whole = decoded.skeleton().map_err(|e| e.to_string())?;
            let own = alone(&whole, template).filter(|own| own.len() < whole.len());
            return match own.filter(|_| agree.is_some_and(|(_, written)| !known(written))) {
                Some(own) => instead(Some(&own), &given, Placed::Written { left_out: whole.len() - own.len() }),
                None => Ok(Settled::Stays(Placed::Written { left_out: 0 })),
            };
        }
        let Some((agreement, _)) = agree else { return Ok(Settled::Stays(Placed::Lost)) };
        let (w, how) = (self.params.weights(), (agreement, wish.seed));
        match self.voted(w, &stage.clouds, (template, anatomy), &stage.how, how)? {
            Some((voted, bodies)) => instead(Some(&voted), &given, Placed::Voted { bodies, draws: agreement.draws }),
            None => instead(None, &RigRequest { class: None, ..wish.clone() }, Placed::Without),
        }
    }

    /// The skeleton of a drawn rig, or the given one, in the mesh's own axes, its weights, and how many joints of a given one
    /// that may hold something were read where not all were.
    ///
    /// # Errors
    /// As [`Self::make`].
    pub(super) fn finished(
        &self,
        stage: &Stage<'_>,
        wish: &RigRequest<'_>,
        given: Option<&GivenSkeleton<'_>>,
        drawn: RigSample,
    ) -> Result<(Skeleton, SkinWeights, Option<usize>), String> {
        let (eval, up) = (&self.config.eval, self.config.data.up);
        let count = wish.skins.unwrap_or(eval.skins);
        let skins = self.skins(self.params.weights(), &self.straight(&stage.clouds), &drawn, count, wish.seed)?;
        let hold = Hold { without_codes: eval.without_codes, ..Hold::default() };
        let hold = Hold { influences: wish.influences.unwrap_or(hold.influences).max(1), ..hold };
        let Some((skeleton, read)) = given else {
            let in_cube = drawn.decoded.map_err(|e| e.to_string())?.skeleton().map_err(|e| e.to_string())?;
            let weights = self.pooled_skin(&stage.cube, &in_cube, &skins, wish.seed, hold)?;
            let stood = stage.stood(&in_cube)?;
            let heads = stood.heads().iter().map(|&p| up.back(p)).collect();
            return Ok((in_cube.with_heads(heads).map_err(|e| e.to_string())?, weights, None));
        };
        let own = |codes| in_order(codes, &read.encoded.order, read.skeleton.len());
        let skins: Vec<_> = skins.into_iter().map(own).collect();
        let in_cube = stage.in_cube(skeleton)?;
        let (thinned, hold) = (read.thinned(wish.holders_of(skeleton)), (wish.holders_of(skeleton), hold));
        let weights = self.read_skin((&stage.cube, &in_cube), (read, stage.map), &skins, wish.seed, hold)?;
        // A turn of axes and back rounds nothing, but turns by less than a quarter do: given joints stay what they are.
        let mut heads: Vec<_> = skeleton.heads().iter().map(|&p| up.back(stage.facing.back(p))).collect();
        let own = wish.skeleton.map_or(&[][..], Skeleton::heads);
        heads[..own.len()].copy_from_slice(own);
        Ok((skeleton.with_heads(heads).map_err(|e| e.to_string())?, weights, thinned))
    }
}
