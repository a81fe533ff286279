//! Batches: points of a few rigs, and their whole sequences.

use std::sync::Arc;

use riglab_core::Rig;
use riglab_data::Mixture;
use riglab_geom::CloudSampler;
use riglab_nn::tokenrig::Layout;
use riglab_random::{Draw, stream};
use riglab_token::Tokenizer;
use riglab_train::Source;

use super::config::TokenRigTaskConfig;
use super::sample::{Sample, sample, skeleton};
use super::told::Teller;
use crate::assets::{AssetId, Assets, Cache};
use crate::fsq_cvae::Frozen;
use crate::sequences::{Unfit, filled};
use crate::unirig_skeleton::Batch as Shapes;
use crate::unirig_skeleton::batch::{normalized, shape};

/// Plain arrays: points and ids as the skeleton task has them, and what is told of codes' joints.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Batch {
    /// Clouds, picks, ids of all rigs one after another, and their lengths.
    pub shapes: Shapes,
    /// [T, ..]: see [`riglab_nn::tokenrig::Sequences::told`].
    pub told: Vec<f32>,
    /// Numbers of skins that are left out, as their loss has no weight.
    pub unasked: usize,
}

impl Batch {
    /// Adds a sequence; its shape is added apart.
    pub fn push(&mut self, sample: &Sample, teller: &Teller) {
        self.shapes.ids.extend(&sample.ids);
        self.shapes.lengths.push(sample.ids.len() as i64);
        self.shapes.clamped += sample.clamped;
        self.told.extend(teller.places(&sample.ids, sample.skeleton, &sample.joints));
    }

    /// Some of its rigs alone; what is left out is counted by the whole.
    pub(super) fn some(&self, rigs: &[usize]) -> Self {
        let width = self.told.len() / self.shapes.ids.len().max(1);
        let told = |&rig: &usize| {
            let tokens = self.shapes.tokens(rig);
            self.told.get(width * tokens.start..width * tokens.end).unwrap_or_default()
        };
        Self { shapes: self.shapes.some(rigs), told: rigs.iter().flat_map(told).copied().collect(), unasked: 0 }
    }
}

/// Makes batches by number.
pub struct BatchSource {
    pub(super) config: TokenRigTaskConfig,
    pub(super) tokenizer: Tokenizer,
    pub(super) layout: Layout,
    pub(super) vae: Arc<Frozen>,
    pub(super) assets: Arc<Assets>,
    pub(super) cache: Arc<Cache<Rig>>,
    pub(super) samples: Arc<Cache<Result<Sample, Unfit>, (AssetId, u64)>>,
    pub(super) rigs: Mixture<AssetId>,
}

impl BatchSource {
    /// Adds the rig at a place of the endless training sequence, augmented, or says why it has no sequence. `skin`: whether
    /// its codes are asked for.
    fn add(&self, place: u64, skin: bool, batch: &mut Batch) -> Result<Result<(), Unfit>, String> {
        let (c, seed) = (&self.config, self.config.train.seed);
        let id = self.rigs.at(place);
        let mut random = stream(seed, "rig sample", &[place]);
        let variant = match c.sampling.variants {
            0 => place,
            n => random.below(n as usize) as u64,
        };
        let key = [id.key(), variant];
        let rig = normalized(&self.assets, &self.cache, id)?;
        let augmented = c.augment.apply_in_cube((*rig).clone(), seed, &key).map_err(|e| e.to_string())?;
        let rig = augmented.rig;
        // Where left and right are exchanged, the names of known makes are no longer true.
        let mirrored = augmented.motion.world.matrix3.determinant() < 0.0;
        let mut of_variant = stream(seed, "rig variant", &key);
        let told = !of_variant.chance(c.sampling.class_dropout) && !mirrored;
        let teller = Teller { model: &c.model, layout: &self.layout, vae: &self.vae, codes: c.skin.codes };
        let (class, joints) = ((c.class.as_str(), told), rig.skeleton().len());
        // The codes of such a skeleton have room.
        let fits = |s: &Sample| c.limits.hold(joints, s.skeleton);
        if skin {
            let mut make = || {
                let whole = sample(&self.tokenizer, &c.skin, &teller, &rig, class, &mut of_variant);
                let whole = whole.and_then(|s| if fits(&s) { Ok(s) } else { Err(Unfit::Long) });
                let bytes = whole.as_ref().map_or(0, Sample::bytes);
                Ok::<_, String>((whole, bytes))
            };
            let found = match c.sampling.variants {
                0 => Arc::new(make()?.0),
                _ => self.samples.get((id, variant), make)?,
            };
            match &*found {
                Ok(sample) => batch.push(sample, &teller),
                Err(unfit) => return Ok(Err(unfit.clone())),
            }
        } else {
            let (sample, follow) = match skeleton(&self.tokenizer, &c.skin, &rig, class) {
                Ok((sample, follow)) if fits(&sample) => (sample, follow),
                Ok(_) => return Ok(Err(Unfit::Long)),
                Err(fault) => return Ok(Err(fault.into())),
            };
            batch.unasked += self.layout.scored(follow);
            batch.push(&sample, &teller);
        }
        let sampler = match augmented.normals.as_ref() {
            Some(n) => CloudSampler::with_normals(rig.mesh(), &c.sampling.cloud, &n.vertices, &n.triangles),
            None => CloudSampler::new(rig.mesh(), &c.sampling.cloud),
        };
        shape(&c.sampling.cloud, &c.model.shape, &sampler, &mut random, &mut batch.shapes);
        Ok(Ok(()))
    }
}

impl Source for BatchSource {
    type Batch = Batch;

    fn batch(&self, number: u64) -> Result<Batch, String> {
        let c = &self.config;
        // Codes come last and change nothing before them: what has no weight need not be read.
        let done = (number / c.train.accumulate) as f64 / c.train.steps.max(1) as f64;
        let skin = c.loss.skin_weight(done) > 0.0;
        let mut batch = Batch::default();
        let skipped = filled(number, c.sampling.rigs, c.limits, |place| self.add(place, skin, &mut batch))?;
        batch.shapes.skipped += skipped;
        Ok(batch)
    }
}

#[cfg(test)]
mod tests {
    use riglab_geom::CloudConfig;
    use riglab_nn::tokenrig::Head;

    use super::*;
    use crate::assets::DataConfig;
    use crate::tokenrig::testing::{assert_placed, corpus_of_one, untrained};

    #[test]
    fn rigs_lie_where_the_recipe_leaves_them() {
        let dir = tempfile::tempdir().unwrap();
        let (assets, rigger) = (corpus_of_one(dir.path()), untrained(Head::Levels, true));
        assert_placed(|augment| {
            let mut config = TokenRigTaskConfig { augment, ..rigger.config.clone() };
            config.sampling.cloud = CloudConfig { points: 64, vertices: 4, ..CloudConfig::default() };
            (config.sampling.rigs, config.sampling.variants) = (2, 0);
            let source = BatchSource {
                rigs: Mixture::new(0, vec![(1.0, assets.split("train").unwrap())]),
                tokenizer: rigger.tokenizer.clone(),
                layout: rigger.net.layout().clone(),
                vae: rigger.vae.clone(),
                assets: assets.clone(),
                cache: Arc::new(Cache::of(&DataConfig::default(), 1)),
                samples: Arc::new(Cache::of(&DataConfig::default(), 1)),
                config,
            };
            // The first of the two.
            source.batch(0).unwrap().shapes.cloud[..6 * 64].to_vec()
        });
    }
}
