//! The model at work: a mesh comes in, a skeleton and weights come out.

use std::path::Path;
use std::sync::Arc;

use riglab_core::Mesh;
use riglab_geom::CloudSampler;
use riglab_nn::NnError;
use riglab_nn::params::{Builder, Params, Weights};
use riglab_nn::tokenrig::{Layout, TokenRig};
use riglab_random::stream;
use riglab_token::Tokenizer;
use tch::{Device, Kind, Tensor};

use super::condition::Condition;
use super::config::TokenRigTaskConfig;
use super::shipped::{self, WITH_PRIOR};
use super::told::Teller;
use crate::assets::Up;
use crate::experiment::checksum;
use crate::fsq_cvae::Frozen;
use crate::unirig_skeleton::Batch as Shapes;
use crate::unirig_skeleton::batch::shape;
use crate::unirig_skeleton::shape_tensors;

/// What `skin.run` is in a run's folder that holds its auto-encoder, and that one's folder below it.
pub const AUTO_ENCODER: &str = "auto_encoder";

/// What is said where none is named: where to get one that has the same axis up.
fn no_auto_encoder(up: Up) -> String {
    const NONE: &str = "skin.run names no auto-encoder";
    const TRAINED: &str = "trains one, then give its folder: --set skin.run=runs/fsq_cvae_with_prior/001";
    match up {
        Up::Y => format!(
            "{NONE}: --set skin.run={WITH_PRIOR} takes one that comes with riglab; `riglab train \
             skintokens/fsq_cvae_with_prior.toml` {TRAINED}"
        ),
        Up::Z => format!(
            "{NONE}: `riglab checkpoint import --as fsq_cvae CHECKPOINT -o skin.safetensors` reads the published one, then --set \
             skin.run=skin.safetensors; `riglab train skintokens/fsq_cvae_with_prior.toml --set data.up=z` {TRAINED}; those that \
             come with riglab are for data.up = \"y\""
        ),
    }
}

/// Network, tokenizer and frozen auto-encoder.
pub struct Rigger {
    pub(super) config: TokenRigTaskConfig,
    pub(super) tokenizer: Tokenizer,
    pub(super) net: TokenRig,
    pub(super) params: Params,
    pub(super) vae: Arc<Frozen>,
    pub(super) device: Device,
}

impl Rigger {
    /// Joints of a skeleton that it writes, at most.
    pub fn most_joints(&self) -> usize {
        self.config.limits.joints
    }

    /// Keeps so many beams whenever it draws (`eval.generate.beams`).
    ///
    /// # Errors
    /// A sentence: codes of its head are not drawn whole.
    pub fn keep_beams(&mut self, beams: usize) -> Result<(), String> {
        self.config.eval.generate.beams = beams;
        self.config.validate().map_err(|(_, why)| why)
    }

    /// The class of skeletons that a name means, as [`Vocabulary::class_meant`](riglab_token::Vocabulary::class_meant).
    pub fn class_meant(&self, told: &str) -> Option<&str> {
        self.tokenizer.vocabulary().class_meant(told)
    }

    /// With the network's starting weights; the config was validated.
    ///
    /// # Errors
    /// A sentence: impossible sizes, or an auto-encoder with too few codes.
    pub fn new(config: TokenRigTaskConfig, vae: Arc<Frozen>, device: Device) -> Result<Self, String> {
        let seed = config.train.seed;
        Self::built(config, vae, device, |builder| builder.finish(seed, Kind::Float, device))
    }

    /// As [`Self::new`], without values of its own network: they are to be loaded.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub(crate) fn blank(config: TokenRigTaskConfig, vae: Arc<Frozen>, device: Device) -> Result<Self, String> {
        Self::built(config, vae, device, |builder| builder.blank(Kind::Float, device))
    }

    fn built(
        config: TokenRigTaskConfig,
        vae: Arc<Frozen>,
        device: Device,
        values: impl FnOnce(Builder) -> Result<Params, NnError>,
    ) -> Result<Self, String> {
        let most = vae.config().model.skin_tokens;
        if config.skin.codes > most {
            let codes = config.skin.codes;
            return Err(format!("skin.codes = {codes}, but the auto-encoder was trained with {most} at most"));
        }
        let tokenizer = Tokenizer::new(config.tokenizer.clone());
        let layout = Layout::new(tokenizer.vocabulary().len(), vae.levels(), config.model.head)
            .with_bins(config.tokenizer.bins.into());
        let mut builder = Builder::default();
        let net = TokenRig::new(builder.root(), &config.model, &layout, config.skin.codes);
        let params = values(builder).map_err(|e| e.to_string())?;
        Ok(Self { config, tokenizer, net, params, vae, device })
    }

    /// The auto-encoder of a config.
    ///
    /// # Errors
    /// As [`Frozen::open`].
    pub fn auto_encoder(config: &TokenRigTaskConfig, device: Device) -> Result<Arc<Frozen>, String> {
        if config.skin.run.as_os_str().is_empty() {
            return Err(no_auto_encoder(config.data.up));
        }
        let of_word = shipped::auto_encoder(&config.skin.run, device);
        of_word.unwrap_or_else(|| Frozen::open(&config.skin.run, device)).map(Arc::new)
    }

    /// Finds the auto-encoder of a run whose folder holds its own, wherever that folder is.
    pub fn own_auto_encoder(run: &Path, config: &mut TokenRigTaskConfig) {
        let own = run.join(AUTO_ENCODER);
        if config.skin.run == Path::new(AUTO_ENCODER) && own.is_dir() {
            config.skin.run = own;
        }
    }

    /// The key that names its auto-encoder, and a checksum of that one's weights.
    pub fn companions(&self) -> Vec<(String, String)> {
        let tensors = self.vae.tensors();
        let named = tensors.iter().map(|(name, tensor)| (name.as_str(), tensor.shallow_clone()));
        vec![("skin.run".into(), checksum(named))]
    }

    /// What is wrong where it has another axis up than its auto-encoder, which then sees bodies that lie: its codes say less
    /// of those. Models were trained so before that was refused.
    pub fn mismatch(&self) -> Option<String> {
        let (own, other) = (self.config.data.up, self.vae.config().data.up);
        (own != other).then(|| {
            format!(
                "data.up = \"{own}\", but the auto-encoder of skin.run was trained with data.up = \"{other}\": its codes say less \
                 of bodies that lie down"
            )
        })
    }

    /// Its settings.
    pub fn config(&self) -> &TokenRigTaskConfig {
        &self.config
    }

    /// Its parameters.
    pub fn params(&self) -> &Params {
        &self.params
    }

    /// The tokenizer of its skeletons.
    pub fn tokenizer(&self) -> &Tokenizer {
        &self.tokenizer
    }

    /// The auto-encoder.
    pub fn vae(&self) -> &Frozen {
        &self.vae
    }

    /// The auto-encoder, to be used beside it.
    pub fn shared_vae(&self) -> Arc<Frozen> {
        self.vae.clone()
    }

    /// The ids of its sequences.
    pub fn layout(&self) -> &Layout {
        self.net.layout()
    }

    /// Its network.
    pub fn net(&self) -> &TokenRig {
        &self.net
    }

    /// Where it computes.
    pub fn device(&self) -> Device {
        self.device
    }

    /// Reads the shapes of meshes in the cube; `keys` seed the points.
    pub fn condition(&self, w: &Weights, meshes: &[(&Mesh, u64)]) -> Condition {
        let _no_grad = tch::no_grad_guard();
        let (c, mut batch) = (&self.config, Shapes::default());
        for (mesh, key) in meshes {
            let mut random = stream(c.eval.seed, "skeleton evaluation", &[*key]);
            let sampler = CloudSampler::new(mesh, &c.sampling.cloud);
            shape(&c.sampling.cloud, &c.model.shape, &sampler, &mut random, &mut batch);
        }
        self.with_meshes(self.prefix(w, &batch), meshes.iter().map(|(mesh, _)| *mesh))
    }

    /// What tells its codes.
    pub(crate) fn teller(&self) -> Teller<'_> {
        let c = &self.config;
        Teller { model: &c.model, layout: self.net.layout(), vae: &self.vae, codes: c.skin.codes }
    }

    /// Prefixes [b, p, d] with as many meshes, where codes are told of them.
    pub(crate) fn with_meshes<'a>(&self, prefix: Tensor, meshes: impl IntoIterator<Item = &'a Mesh>) -> Condition {
        Condition::new(prefix, &self.config.model, meshes)
    }

    /// Reads the shape of a mesh in the cube from each of `eval.clouds` point clouds; the first is that of
    /// [`Self::condition`].
    pub(crate) fn clouds(&self, w: &Weights, mesh: &Mesh, key: u64) -> Condition {
        let _no_grad = tch::no_grad_guard();
        let (c, mut batch) = (&self.config, Shapes::default());
        let how = (&c.sampling.cloud, &c.model.shape);
        c.eval.agreement().shapes(how, mesh, (c.eval.seed, key), c.eval.clouds, &mut batch);
        self.with_meshes(self.prefix(w, &batch), std::iter::repeat_n(mesh, c.eval.clouds))
    }

    /// Of those, the ones that are seen as they are.
    pub(crate) fn straight(&self, clouds: &Condition) -> Condition {
        clouds.some(&self.config.eval.agreement().straight())
    }

    /// What the decoder reads of shapes, [b, p, d].
    pub fn prefix(&self, w: &Weights, shapes: &Shapes) -> Tensor {
        let (cloud, picks) = shape_tensors(shapes, self.config.model.shape.tokens, self.device);
        self.net.condition(w, &cloud, &picks)
    }
}
