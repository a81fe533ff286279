//! Weights in files of others and of runs, by the names of their tensors.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

use anyhow::{Context, Result, bail};
use riglab_asset::{StoredKind, StoredTensor, TensorFile};
use riglab_task::released::Offered;
use riglab_train::Checkpoint;
use tch::{Kind, Tensor};

/// A file's tensors, whichever of the formats it has.
///
/// # Errors
/// When it is a folder, or cannot be read or understood.
pub fn open(path: &Path) -> Result<Offered<'_>> {
    let file = path.display().to_string();
    let mut start = Vec::new();
    if path.is_dir() {
        bail!("{file} is a folder; give the checkpoint that lies in it");
    }
    let opened = std::fs::File::open(path).and_then(|f| f.take(64).read_to_end(&mut start));
    opened.with_context(|| format!("{file} cannot be read"))?;
    if start.starts_with(b"version https://git-lfs") {
        bail!("{file} only says where the weights lie; fetch them with `git lfs pull`");
    }
    if start.get(8) == Some(&b'{') && !start.starts_with(b"PK") {
        return safetensors(path);
    }
    let mut tensors = TensorFile::open(path)?;
    let length = |n: &usize| i64::try_from(*n).unwrap_or(i64::MAX);
    let shapes: BTreeMap<String, Vec<i64>> =
        tensors.shapes().map(|(n, s)| (n.to_owned(), s.iter().map(length).collect())).collect();
    let (step, unread) = (tensors.step(), tensors.unread().to_vec());
    // The settings that are asked for.
    let told: BTreeMap<&str, Vec<i64>> =
        ["levels", "tokens_per_skin"].into_iter().filter_map(|key| Some((key, tensors.setting(key)?))).collect();
    let read = move |name: &str| {
        let stored = tensors.read(name).map_err(|e| e.to_string())?;
        tensor(&stored.ok_or_else(|| format!("no `{name}`"))?).map_err(|e| format!("tensor `{name}`: {e}"))
    };
    Ok(Offered {
        file,
        shapes,
        unread,
        step,
        read: Box::new(read),
        setting: Box::new(move |key| told.get(key).cloned()),
    })
}

/// The tensors of a file, or of the best checkpoint of a run's folder, with which the run is evaluated.
///
/// # Errors
/// As [`open`], or when the folder has no checkpoint, or several of which none is the best.
pub fn open_weights(path: &Path) -> Result<Offered<'_>> {
    if !path.is_dir() {
        return open(path);
    }
    // A folder of a checkpoint, or of a run that has several.
    let checkpoints = path.join("checkpoints");
    let found = if checkpoints.is_dir() { checkpoints.join("best") } else { path.to_owned() };
    let checkpoint = Checkpoint::open(&found).with_context(|| format!("{}: no trained model", path.display()))?;
    safetensors(&checkpoint.weights())
}

fn safetensors(path: &Path) -> Result<Offered<'static>> {
    let tensors = riglab_nn::io::Reader::open(path)?;
    let shapes = tensors.shapes();
    let read = move |name: &str| tensors.read(name).map_err(|e| e.to_string());
    let file = path.display().to_string();
    let (unread, setting) = (Vec::new(), Box::new(|_: &str| None));
    Ok(Offered { file, shapes, unread, step: None, read: Box::new(read), setting })
}

fn tensor(stored: &StoredTensor) -> Result<Tensor, tch::TchError> {
    let kind = match stored.kind {
        StoredKind::F64 => Kind::Double,
        StoredKind::F32 => Kind::Float,
        StoredKind::F16 => Kind::Half,
        StoredKind::Bf16 => Kind::BFloat16,
        StoredKind::I64 => Kind::Int64,
        StoredKind::I32 => Kind::Int,
        StoredKind::I16 => Kind::Int16,
        StoredKind::I8 => Kind::Int8,
        StoredKind::U8 => Kind::Uint8,
        StoredKind::Bool => Kind::Bool,
    };
    let shape: Vec<i64> = stored.shape.iter().map(|&n| n as i64).collect();
    Tensor::f_from_data_size(&stored.bytes, &shape, kind)
}
