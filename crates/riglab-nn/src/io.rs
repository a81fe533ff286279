//! Tensors in safetensors files.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::Write;
use std::path::Path;

use safetensors::tensor::{Dtype, SafeTensors, TensorView, serialize};
use tch::{Device, Kind, Tensor};

use crate::NnError;

fn dtype(kind: Kind) -> Option<Dtype> {
    Some(match kind {
        Kind::Float => Dtype::F32,
        Kind::Double => Dtype::F64,
        Kind::BFloat16 => Dtype::BF16,
        Kind::Half => Dtype::F16,
        Kind::Int64 => Dtype::I64,
        Kind::Int => Dtype::I32,
        Kind::Uint8 => Dtype::U8,
        Kind::Bool => Dtype::BOOL,
        _ => return None,
    })
}

fn kind(dtype: Dtype) -> Option<Kind> {
    Some(match dtype {
        Dtype::F32 => Kind::Float,
        Dtype::F64 => Kind::Double,
        Dtype::BF16 => Kind::BFloat16,
        Dtype::F16 => Kind::Half,
        Dtype::I64 => Kind::Int64,
        Dtype::I32 => Kind::Int,
        Dtype::U8 => Kind::Uint8,
        Dtype::BOOL => Kind::Bool,
        _ => return None,
    })
}

/// The bytes of a safetensors file of these tensors, sorted by name.
///
/// # Errors
/// [`NnError::Config`] for a kind that the format has no name for.
pub fn to_bytes<'a>(tensors: impl IntoIterator<Item = (&'a str, &'a Tensor)>) -> Result<Vec<u8>, NnError> {
    to_bytes_with(tensors, None)
}

/// As [`to_bytes`], with texts by name in the file's head.
///
/// # Errors
/// As [`to_bytes`].
pub fn to_bytes_with<'a>(
    tensors: impl IntoIterator<Item = (&'a str, &'a Tensor)>,
    texts: Option<HashMap<String, String>>,
) -> Result<Vec<u8>, NnError> {
    let mut data: BTreeMap<String, (Dtype, Vec<usize>, Vec<u8>)> = BTreeMap::new();
    for (name, t) in tensors {
        let t = t.detach().to_device(Device::Cpu).contiguous();
        let Some(dtype) = dtype(t.kind()) else {
            return Err(NnError::Config(format!("tensor `{name}` is of kind {:?}, which files cannot hold", t.kind())));
        };
        let mut bytes = vec![0; t.numel() * t.kind().elt_size_in_bytes()];
        let n = t.numel();
        t.copy_data_u8(&mut bytes, n);
        data.insert(name.to_string(), (dtype, t.size().iter().map(|&s| s as usize).collect(), bytes));
    }
    let views = data.iter().map(|(name, (dtype, shape, bytes))| {
        (name.as_str(), TensorView::new(*dtype, shape.clone(), bytes).expect("shape and bytes agree"))
    });
    serialize(views, texts).map_err(|e| NnError::Config(e.to_string()))
}

/// Writes a safetensors file; use a temporary name and rename it where the path matters.
///
/// # Errors
/// [`NnError::File`].
pub fn write<'a>(path: &Path, tensors: impl IntoIterator<Item = (&'a str, &'a Tensor)>) -> Result<(), NnError> {
    let bytes = to_bytes(tensors)?;
    let written = File::create(path).and_then(|mut f| f.write_all(&bytes).and_then(|()| f.sync_all()));
    written.map_err(|e| NnError::File { path: path.into(), message: format!("cannot be written: {e}") })
}

/// All tensors of a safetensors file.
///
/// # Errors
/// [`NnError::File`] when it cannot be read, is no safetensors file, or holds a kind libtorch lacks.
pub fn read(path: &Path) -> Result<BTreeMap<String, Tensor>, NnError> {
    let fault = |message: String| NnError::File { path: path.into(), message };
    let file = File::open(path).map_err(|e| fault(format!("cannot be opened: {e}")))?;
    // SAFETY: the file is not expected to change while it is read; a truncation would end in SIGBUS,
    // as for every memory-mapped checkpoint.
    let map = unsafe { memmap2::Mmap::map(&file) }.map_err(|e| fault(format!("cannot be read: {e}")))?;
    of_bytes(&map).map_err(fault)
}

/// Tensors by name, and the texts in a file's head.
pub type Held = (BTreeMap<String, Tensor>, HashMap<String, String>);

/// All tensors of a safetensors file in memory, and the texts in its head.
///
/// # Errors
/// A sentence without a subject: what is wrong with it.
pub fn from_bytes(bytes: &[u8]) -> Result<Held, String> {
    let (_, head) = SafeTensors::read_metadata(bytes).map_err(|e| format!("is no safetensors file ({e})"))?;
    Ok((of_bytes(bytes)?, head.metadata().clone().unwrap_or_default()))
}

fn of_bytes(bytes: &[u8]) -> Result<BTreeMap<String, Tensor>, String> {
    let tensors = SafeTensors::deserialize(bytes).map_err(|e| format!("is no safetensors file ({e})"))?;
    let mut out = BTreeMap::new();
    for (name, view) in tensors.iter() {
        let kind = kind(view.dtype()).ok_or_else(|| format!("tensor `{name}` has the type {:?}", view.dtype()))?;
        let shape: Vec<i64> = view.shape().iter().map(|&s| s as i64).collect();
        let tensor =
            Tensor::f_from_data_size(view.data(), &shape, kind).map_err(|e| format!("tensor `{name}`: {e}"))?;
        out.insert(name.to_string(), tensor);
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tensors_survive_a_file_and_a_cut_file_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.safetensors");
        let (a, b) = (Tensor::arange(6, (Kind::Float, Device::Cpu)).view([2, 3]), Tensor::from_slice(&[1i64, -2]));
        // Not contiguous: written as it reads.
        write(&path, [("b", &b), ("a", &a.transpose(0, 1))]).unwrap();
        let back = read(&path).unwrap();
        assert!(back["a"].equal(&a.transpose(0, 1)) && back["b"].equal(&b));
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() - 3]).unwrap();
        assert!(read(&path).unwrap_err().to_string().contains("is no safetensors file"));
        std::fs::write(&path, b"").unwrap();
        assert!(read(&path).is_err());
    }
}
