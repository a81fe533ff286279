//! The recipe that is measured, and its data.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow};
use riglab_asset::ImportOptions;
use riglab_config::Loader;
use riglab_data::{Splitter, import_folder};
use riglab_nn::tokenrig::TokenRigConfig;
use riglab_task::fsq_cvae::FsqCvaeTaskConfig;
use riglab_task::grpo::GrpoTaskConfig;
use riglab_task::tokenrig::TokenRigTaskConfig;
use riglab_task::unirig_skeleton::SkeletonTaskConfig;
use riglab_task::unirig_skin::SkinTaskConfig;
use riglab_train::Precision;
use serde::de::DeserializeOwned;

/// The experiment whose network, sampling and training are measured.
const EXPERIMENT: &str = "experiments/quickstart/fsq_cvae.toml";
/// The same of the skeleton model.
const SKELETON: &str = "experiments/quickstart/unirig_skeleton.toml";

/// The same of TokenRig, and of the auto-encoder that it stands on.
const TOKENRIG: [&str; 2] =
    ["experiments/quickstart/tokenrig.toml", "experiments/skintokens/fsq_cvae_for_tokenrig.toml"];

/// GRPO of TokenRig.
const GRPO: &str = "experiments/skintokens/grpo_quick.toml";

/// TokenRig as the paper trains it.
const TOKENRIG_PAPER: &str = "experiments/skintokens/tokenrig_paper.toml";

/// UniRig's skin stage.
const UNIRIG_SKIN: &str = "experiments/quickstart/unirig_skin.toml";

/// The root of the workspace.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).expect("two ancestors").to_path_buf()
}

/// The folder of rigged files, if there is one.
pub fn rigs() -> Option<PathBuf> {
    let given = std::env::var_os("RIGLAB_RIGS").filter(|v| !v.is_empty()).map(PathBuf::from);
    Some(given.unwrap_or_else(|| root().join("../shared/rigs"))).filter(|f| f.is_dir())
}

/// What is said where there is none.
pub const NO_RIGS: &str =
    "skipped: no folder of rigged files (glb, gltf, vrm); point RIGLAB_RIGS at one, or put it at ../shared/rigs";

/// Imports the rigs into a corpus at `out`, as `riglab dataset import` does.
pub fn corpus(rigs: &Path, out: &Path) -> Result<()> {
    let split = rigs.join("split.json");
    let splitter = if split.is_file() { Splitter::read(&split)? } else { Splitter::ByTopology(0) };
    import_folder(rigs, out, &splitter, &ImportOptions::default(), &|_, _| ())?;
    Ok(())
}

/// The experiment's settings over a corpus, in a given precision.
pub fn config(corpus: &Path, precision: Precision) -> Result<FsqCvaeTaskConfig> {
    let mut c: FsqCvaeTaskConfig = read(EXPERIMENT)?;
    c.data.corpora = vec![corpus.into()];
    c.train.precision = precision;
    c.validate().map_err(|(key, message)| anyhow!("{key}: {message}")).context(EXPERIMENT)?;
    Ok(c)
}

/// The skeleton experiment's settings over a corpus, in a given precision.
pub fn skeleton(corpus: &Path, precision: Precision) -> Result<SkeletonTaskConfig> {
    let mut c: SkeletonTaskConfig = read(SKELETON)?;
    c.data.corpora = vec![corpus.into()];
    c.train.precision = precision;
    c.validate().map_err(|(key, message)| anyhow!("{key}: {message}")).context(SKELETON)?;
    Ok(c)
}

/// TokenRig's settings over a corpus, in a given precision.
pub fn tokenrig(corpus: &Path, precision: Precision) -> Result<TokenRigTaskConfig> {
    let mut c: TokenRigTaskConfig = read(TOKENRIG[0])?;
    c.data.corpora = vec![corpus.into()];
    c.train.precision = precision;
    c.validate().map_err(|(key, message)| anyhow!("{key}: {message}")).context(TOKENRIG[0])?;
    Ok(c)
}

/// GRPO's settings over a corpus, everything in single precision.
pub fn grpo(corpus: &Path) -> Result<GrpoTaskConfig> {
    let mut c: GrpoTaskConfig = read(GRPO)?;
    c.data.corpora = vec![corpus.into()];
    (c.train.precision, c.rollout.precision) = (Precision::Fp32, Precision::Fp32);
    c.validate().map_err(|(key, message)| anyhow!("{key}: {message}")).context(GRPO)?;
    Ok(c)
}

/// The network of the paper's TokenRig.
pub fn tokenrig_paper() -> Result<TokenRigConfig> {
    Ok(read::<TokenRigTaskConfig>(TOKENRIG_PAPER)?.model)
}

/// Settings of TokenRig's auto-encoder, with 512 codes: one softmax over them is of a size that suits the small network.
pub fn skin(corpus: &Path) -> Result<FsqCvaeTaskConfig> {
    let mut c: FsqCvaeTaskConfig = read(TOKENRIG[1])?;
    c.data.corpora = vec![corpus.into()];
    c.model.levels = vec![8, 8, 8];
    c.model.extensions.frame = false;
    c.validate().map_err(|(key, message)| anyhow!("{key}: {message}")).context(TOKENRIG[1])?;
    Ok(c)
}

/// The skin stage's settings over a corpus, without the simulation of springs.
pub fn unirig_skin(corpus: &Path) -> Result<SkinTaskConfig> {
    let mut c: SkinTaskConfig = read(UNIRIG_SKIN)?;
    c.data.corpora = vec![corpus.into()];
    c.train.precision = Precision::Fp32;
    c.loss.physics.weight = 0.0;
    // A step as one batch, which is what the other side takes.
    (c.sampling.rigs, c.train.accumulate) = (c.sampling.rigs * c.train.accumulate as usize, 1);
    c.validate().map_err(|(key, message)| anyhow!("{key}: {message}")).context(UNIRIG_SKIN)?;
    Ok(c)
}

/// The precision that the experiment asks for.
pub fn precision() -> Result<Precision> {
    Ok(read::<FsqCvaeTaskConfig>(EXPERIMENT)?.train.precision)
}

/// The precision that the skeleton experiment asks for.
pub fn skeleton_precision() -> Result<Precision> {
    Ok(read::<SkeletonTaskConfig>(SKELETON)?.train.precision)
}

fn read<C: DeserializeOwned>(experiment: &str) -> Result<C> {
    let search = ["configs", "experiments"].map(|f| root().join(f));
    let none: [&str; 0] = [];
    Ok(Loader::new().search(&search).load(root().join(experiment), &none)?.get()?)
}
