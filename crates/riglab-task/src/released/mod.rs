//! Weights that UniRig's and SkinTokens' authors published, as models of riglab.
//!
//! The networks here have the names of the published weights, so what is left to do is to find out which model a
//! checkpoint holds and under which prefix ([`recognise`]), to take the sizes that the shapes tell ([`sizes`]), and to
//! see that every parameter is there with its shape ([`Fit`]). What shapes do not tell (heads, levels of the codes) is
//! the release's, or set.
//!
//! Holds: nothing is loaded unless everything fits; what is left over is told by name.
//!
//! Leaves out: how files hold tensors.

mod fit;
mod names;
mod sizes;

use std::collections::BTreeMap;
use std::sync::Arc;

use riglab_config::Config;
use riglab_nn::NnError;
use riglab_nn::fsq_cvae::FsqCvae;
use riglab_nn::params::{Builder, Params};
use riglab_nn::tokenrig::{Layout, TokenRig};
use riglab_token::Tokenizer;
use riglab_train::unsound;
use serde::Serialize;
use tch::{Device, Kind, Tensor};

pub use fit::Fit;
pub use names::{FoundModel, Model, plain as plain_name, recognise};
use names::{KnownAs, tied};

use crate::bundle::{Bundle, Card};
use crate::fsq_cvae::{Frozen, FsqCvaeTask, FsqCvaeTaskConfig};
use crate::tokenrig::{Rigger, TokenRigTaskConfig};
use crate::unirig_skeleton::{SkeletonTask, SkeletonTaskConfig};
use crate::unirig_skin::{SkinTask, SkinTaskConfig};

/// Reads a tensor by its name, or says in a sentence why not.
pub type Reads<'a> = Box<dyn FnMut(&str) -> Result<Tensor, String> + 'a>;
/// Tells whole numbers of a setting by its key.
pub type Tells<'a> = Box<dyn Fn(&str) -> Option<Vec<i64>> + 'a>;

/// A checkpoint as it is offered: what is in it, and how to get at it.
pub struct Offered<'a> {
    /// What it is called in messages.
    pub file: String,
    /// Names and shapes of its tensors.
    pub shapes: BTreeMap<String, Vec<i64>>,
    /// Names of what is there and cannot be read as a tensor.
    pub unread: Vec<String>,
    /// Steps it was trained, if it says.
    pub step: Option<u64>,
    /// Reads one of its tensors.
    pub read: Reads<'a>,
    /// Whole numbers of its settings, by their key, if it tells them.
    pub setting: Tells<'a>,
}

/// A model with the weights of a checkpoint.
pub enum Imported {
    /// UniRig's skeleton stage.
    Skeleton(Box<SkeletonTaskConfig>, Params),
    /// UniRig's skin stage.
    Skin(Box<SkinTaskConfig>, Params),
    /// SkinTokens' auto-encoder.
    FsqCvae(Box<FsqCvaeTaskConfig>, Params),
    /// SkinTokens' whole model.
    TokenRig(Box<Rigger>),
}

impl Imported {
    /// How it draws, where that is not simply by the likeliest tokens.
    pub fn draws(&self) -> Option<String> {
        let how = match self {
            Self::Skeleton(config, _) => &config.eval.generate,
            Self::TokenRig(rigger) => &rigger.config().eval.generate,
            Self::Skin(..) | Self::FsqCvae(..) => return None,
        };
        Some(how.draws(1)).filter(|said| !said.is_empty())
    }
}

/// What came of a checkpoint.
pub struct Outcome {
    /// How its tensors fit; of a TokenRig its own part, then its auto-encoder's.
    pub fits: Vec<Fit>,
    /// The model, if all did.
    pub model: Option<Imported>,
    /// Whether its numbers have 16 bits, all of them.
    pub half: bool,
    /// Sizes that shapes tell and that are not the settings', as sentences.
    pub sizes: Vec<String>,
}

/// A part of a checkpoint, with names as the networks have them.
struct Part<'o, 'a> {
    offered: &'o mut Offered<'a>,
    found: FoundModel,
    /// By the networks' name the checkpoint's.
    names: BTreeMap<String, String>,
}

impl<'o, 'a> Part<'o, 'a> {
    fn of(offered: &'o mut Offered<'a>, found: FoundModel) -> Self {
        let names = found.names(offered.shapes.keys());
        Self { offered, found, names }
    }

    fn sizes(&self) -> sizes::Shapes<'_> {
        sizes::Shapes::new(self.names.iter().map(|(own, name)| (own.as_str(), self.offered.shapes[name].as_slice())))
    }

    /// Compares with a network that is being built, by names and shapes: a network as large as some shapes claim is not
    /// made before all of it is there.
    fn fit(&mut self, network: &Builder) -> Result<Fit, String> {
        let mut fit = Fit::of(&self.found, network, &self.names, self.offered);
        for (own, as_what) in names::known(self.found.model, &self.names) {
            let table = tied(self.found.model);
            if as_what == KnownAs::Tied && self.names.contains_key(table) {
                let (head, table) = (self.read(&own)?, self.read(table)?);
                if !head.equal(&table) {
                    fit.differs(&own, tied(self.found.model));
                }
            }
        }
        Ok(fit)
    }

    /// Makes the network and reads its tensors, if all fit; with it, whether its numbers have 16 bits.
    fn taken(mut self, network: Builder, device: Device) -> Result<(Fit, Option<(Params, bool)>), String> {
        let mut fit = self.fit(&network)?;
        if !fit.is_whole() {
            return Ok((fit, None));
        }
        let params = network.blank(Kind::Float, device).map_err(|e| e.to_string())?;
        let half = self.load(&params, &mut fit)?;
        let whole = fit.is_whole();
        Ok((fit, whole.then_some((params, half))))
    }

    /// Reads the tensors of a network, which fit, one at a time; tells which hold numbers that are no weights. Gives whether
    /// all numbers are of bfloat16.
    fn load(&mut self, params: &Params, fit: &mut Fit) -> Result<bool, String> {
        let shapes = params.ids().map(|id| (params.name(id).to_owned(), params.shape(id).to_vec())).collect();
        let mut half = true;
        let loaded = params.load_each(&shapes, |own| {
            let tensor = self.read(own).map_err(NnError::Config)?;
            half &= tensor.kind() == Kind::BFloat16;
            if let Some(fault) = unsound(&tensor) {
                fit.unsound(own, &fault);
            }
            Ok(tensor)
        });
        loaded.map_err(|e| e.to_string())?;
        Ok(half)
    }

    fn read(&mut self, own: &str) -> Result<Tensor, String> {
        let name = self.names.get(own).ok_or_else(|| format!("no tensor `{own}`"))?;
        (self.offered.read)(name)
    }
}

/// Reads a checkpoint as the model that was found in it. `config` has the release's values, or other ones where
/// shapes do not tell; for [`Model::TokenRig`], `skin` has the auto-encoder's, and `vae` is a checkpoint that it
/// comes from, if not from the same.
///
/// # Errors
/// A sentence: settings that are impossible, or tensors that cannot be read. That tensors do not fit is no error but
/// told in [`Outcome::fits`].
pub fn import(
    offered: &mut Offered<'_>,
    found: &FoundModel,
    config: &Config,
    skin: Option<(&Config, Option<&mut Offered<'_>>)>,
    device: Device,
) -> Result<Outcome, String> {
    let mut sizes_told = Vec::new();
    let mut half = false;
    let (fits, model) = match found.model {
        Model::UnirigSkeleton => {
            let mut c: SkeletonTaskConfig = config.get().map_err(|e| e.to_string())?;
            let part = Part::of(offered, found.clone());
            let before = c.model.clone();
            sizes::skeleton(&part.sizes(), &mut c);
            sizes_told.extend(changed(found.model.title(), config, &before, &c.model)?);
            c.validate().map_err(impossible)?;
            let (fit, taken) = part.taken(SkeletonTask::built(&c).1, device)?;
            half = taken.as_ref().is_some_and(|(_, half)| *half);
            (vec![fit], taken.map(|(params, _)| Imported::Skeleton(Box::new(c), params)))
        }
        Model::UnirigSkin => {
            let mut c: SkinTaskConfig = config.get().map_err(|e| e.to_string())?;
            let part = Part::of(offered, found.clone());
            let before = c.model.clone();
            sizes::skin(&part.sizes(), &mut c);
            sizes_told.extend(changed(found.model.title(), config, &before, &c.model)?);
            c.validate().map_err(impossible)?;
            let (fit, taken) = part.taken(SkinTask::built(&c).1, device)?;
            half = taken.as_ref().is_some_and(|(_, half)| *half);
            (vec![fit], taken.map(|(params, _)| Imported::Skin(Box::new(c), params)))
        }
        Model::FsqCvae => {
            let Encoder { fit, config, loaded, half: own, sizes } =
                auto_encoder(offered, found.clone(), config, device)?;
            half = own;
            sizes_told.extend(sizes);
            (vec![fit], loaded.map(|(_, params)| Imported::FsqCvae(Box::new(config), params)))
        }
        Model::TokenRig => {
            let mut c: TokenRigTaskConfig = config.get().map_err(|e| e.to_string())?;
            let (skin, other) = skin.ok_or("no settings of an auto-encoder")?;
            let vae = match (other, recognise(offered.shapes.keys(), Some(Model::FsqCvae))) {
                (Some(other), _) => {
                    let found = recognise(other.shapes.keys(), Some(Model::FsqCvae))
                        .ok_or_else(|| format!("{}: holds no auto-encoder of skin weights", other.file))?;
                    auto_encoder(other, found, skin, device)?
                }
                (None, Some(found)) => auto_encoder(offered, found, skin, device)?,
                (None, None) => {
                    return Err(format!(
                        "{}: holds no auto-encoder of skin weights, without which skin codes mean nothing; give its \
                         checkpoint with --skin FILE",
                        offered.file
                    ));
                }
            };
            sizes_told.extend(vae.sizes);
            if let (false, Some([codes])) =
                (chosen(config, "skin.codes"), (offered.setting)("tokens_per_skin").as_deref())
            {
                c.skin.codes = usize::try_from(*codes).unwrap_or(c.skin.codes);
            }
            let mut part = Part::of(offered, found.clone());
            let before = c.model.clone();
            sizes::tokenrig(&part.sizes(), &mut c);
            sizes_told.extend(changed(found.model.title(), config, &before, &c.model)?);
            c.validate().map_err(impossible)?;
            let ids = Tokenizer::new(c.tokenizer.clone()).vocabulary().len();
            let layout = Layout::new(ids, &vae.config.model.levels, c.model.head);
            let mut builder = Builder::default();
            TokenRig::new(builder.root(), &c.model, &layout, c.skin.codes);
            let mut fit = part.fit(&builder)?;
            let mut model = None;
            if let (true, Some((net, params))) = (fit.is_whole(), vae.loaded) {
                let frozen = Frozen::new(vae.config, net, params, device);
                let rigger = Rigger::blank(c, Arc::new(frozen), device)?;
                half = part.load(rigger.params(), &mut fit)? && vae.half;
                model = fit.is_whole().then(|| Imported::TokenRig(Box::new(rigger)));
            }
            (vec![fit, vae.fit], model)
        }
    };
    Ok(Outcome { fits, model, half, sizes: sizes_told })
}

/// Whether a setting was given with the command.
fn chosen(config: &Config, key: &str) -> bool {
    config.origin(key).is_some_and(|origin| origin.name().starts_with("--set "))
}

/// Tells which settings became others by the tensors' shapes; refuses one that was chosen.
fn changed<T: Serialize>(what: &str, config: &Config, before: &T, after: &T) -> Result<Option<String>, String> {
    fn flat(at: &str, value: &toml::Value, out: &mut BTreeMap<String, String>) {
        match value {
            toml::Value::Table(table) => table.iter().for_each(|(key, value)| flat(&format!("{at}.{key}"), value, out)),
            other => drop(out.insert(at.to_string(), other.to_string())),
        }
    }
    let all = |value: &T| {
        let mut out = BTreeMap::new();
        if let Ok(value) = toml::Value::try_from(value) {
            flat("model", &value, &mut out);
        }
        out
    };
    let was = all(before);
    let own: Vec<_> = all(after).into_iter().filter(|(key, value)| was.get(key) != Some(value)).collect();
    if let Some((key, value)) = own.iter().find(|(key, _)| chosen(config, key)) {
        let set = config.origin(key).map(|origin| origin.name().to_owned()).unwrap_or_default();
        return Err(format!("{set}: the tensors' shapes say {key} = {value}; leave it out"));
    }
    let each: Vec<String> = own
        .into_iter()
        .map(|(key, value)| match was.get(&key) {
            Some(was) => format!("{key} = {value} ({was})"),
            None => format!("{key} = {value}"),
        })
        .collect();
    Ok((!each.is_empty()).then(|| format!("{what}: {}", each.join(", "))))
}

/// What is said where sizes and settings cannot go together.
fn impossible((key, message): (String, String)) -> String {
    format!(
        "{key}: {message}; sizes are those of the tensors' shapes, what shapes do not tell is the release's unless it is \
         set, as --set model.heads=8"
    )
}

/// An auto-encoder of a checkpoint.
struct Encoder {
    fit: Fit,
    config: FsqCvaeTaskConfig,
    /// If all fitted.
    loaded: Option<(FsqCvae, Params)>,
    half: bool,
    /// See [`Outcome::sizes`].
    sizes: Option<String>,
}

fn auto_encoder(
    offered: &mut Offered<'_>,
    found: FoundModel,
    config: &Config,
    device: Device,
) -> Result<Encoder, String> {
    let settings = config;
    let mut config: FsqCvaeTaskConfig = settings.get().map_err(|e| e.to_string())?;
    if let Some(levels) = (offered.setting)("levels").filter(|l| !l.is_empty() && !chosen(settings, "model.levels")) {
        config.model.levels = levels;
    }
    let part = Part::of(offered, found);
    let mut before = config.model.clone();
    sizes::fsq_cvae(&part.sizes(), &mut config);
    // Which queries the release has is not told anywhere else.
    before.skin_queries = config.model.skin_queries;
    let sizes = changed(Model::FsqCvae.title(), settings, &before, &config.model)?;
    config.validate().map_err(impossible)?;
    let (net, builder) = FsqCvaeTask::built(&config).map_err(|e| e.to_string())?;
    let (fit, taken) = part.taken(builder, device)?;
    let half = taken.as_ref().is_some_and(|(_, half)| *half);
    Ok(Encoder { fit, config, loaded: taken.map(|(params, _)| (net, params)), half, sizes })
}

impl Imported {
    /// The task that it is of.
    pub fn task(&self) -> &'static str {
        match self {
            Self::Skeleton(..) => "unirig_skeleton",
            Self::Skin(..) => "unirig_skin",
            Self::FsqCvae(..) => "fsq_cvae",
            Self::TokenRig(_) => "tokenrig",
        }
    }

    /// Its parameters, without those of an auto-encoder.
    pub fn params(&self) -> &Params {
        match self {
            Self::Skeleton(_, params) | Self::Skin(_, params) | Self::FsqCvae(_, params) => params,
            Self::TokenRig(rigger) => rigger.params(),
        }
    }

    /// Its settings as TOML.
    ///
    /// # Errors
    /// When they cannot be written.
    pub fn settings(&self) -> Result<String, String> {
        match self {
            Self::Skeleton(c, _) => toml_of(c),
            Self::Skin(c, _) => toml_of(c),
            Self::FsqCvae(c, _) => toml_of(c),
            Self::TokenRig(rigger) => toml_of(rigger.config()),
        }
    }

    /// For one file.
    ///
    /// # Errors
    /// When settings cannot be written.
    pub fn bundle(&self, card: &Card) -> Result<Bundle, String> {
        if let Self::TokenRig(rigger) = self {
            return rigger.bundle(card);
        }
        let params = self.params();
        let tensors = params.named(params.weights()).map(|(n, t)| (n.to_string(), t.detach()));
        Ok(Bundle {
            kind: self.task().into(),
            card: card.clone(),
            settings: self.settings()?,
            skin: String::new(),
            tensors: tensors.collect(),
        })
    }
}

fn toml_of(config: &impl Serialize) -> Result<String, String> {
    toml::to_string(config).map_err(|e| e.to_string())
}
