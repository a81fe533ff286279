//! Tensors in safetensors files.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

use safetensors::tensor::{Dtype, Metadata, SafeTensors, TensorView, serialize};
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

/// An open safetensors file. Tensors are read one by one, so that a large file is never in memory beside the network
/// that it fills.
pub struct Reader {
    path: PathBuf,
    map: memmap2::Mmap,
    head: Metadata,
    /// Where the tensors begin in the file.
    start: usize,
}

impl Reader {
    /// Opens a file and reads its head.
    ///
    /// # Errors
    /// [`NnError::File`] when it cannot be read or is no safetensors file.
    pub fn open(path: &Path) -> Result<Self, NnError> {
        let fault = |message: String| NnError::File { path: path.into(), message };
        let file = File::open(path).map_err(|e| fault(format!("cannot be opened: {e}")))?;
        // SAFETY: the file is not expected to change while it is read; a truncation would end in SIGBUS,
        // as for every memory-mapped checkpoint.
        let map = unsafe { memmap2::Mmap::map(&file) }.map_err(|e| fault(format!("cannot be read: {e}")))?;
        let (size, head) = SafeTensors::read_metadata(&map).map_err(|e| fault(no_file(&e)))?;
        Ok(Self { path: path.into(), map, head, start: size + HEAD_SIZE })
    }

    /// Shapes by name.
    pub fn shapes(&self) -> BTreeMap<String, Vec<i64>> {
        self.head.tensors().into_iter().map(|(name, info)| (name, shape(&info.shape))).collect()
    }

    /// A text of the file's head.
    pub fn text(&self, key: &str) -> Option<&str> {
        self.head.metadata().as_ref()?.get(key).map(String::as_str)
    }

    /// A tensor by its name.
    ///
    /// # Errors
    /// [`NnError::File`] when there is none, or of a kind that libtorch lacks.
    pub fn read(&self, name: &str) -> Result<Tensor, NnError> {
        let fault = |message: String| NnError::File { path: self.path.clone(), message };
        let info = self.head.info(name).ok_or_else(|| fault(format!("has no tensor `{name}`")))?;
        let (from, to) = (self.start + info.data_offsets.0, self.start + info.data_offsets.1);
        let tensor = tensor(name, info.dtype, &info.shape, &self.map[from..to]).map_err(fault)?;
        // Its pages are not asked for again; where they stay, they only count as memory of this process.
        #[cfg(unix)]
        // SAFETY: nothing borrows them any more, and what is read again comes from the file again.
        let _ = unsafe { self.map.unchecked_advise_range(memmap2::UncheckedAdvice::DontNeed, from, to - from) };
        Ok(tensor)
    }
}

/// All tensors of a safetensors file; [`Reader`] reads them one by one.
///
/// # Errors
/// [`NnError::File`] when it cannot be read, is no safetensors file, or holds a kind libtorch lacks.
pub fn read(path: &Path) -> Result<BTreeMap<String, Tensor>, NnError> {
    let file = Reader::open(path)?;
    file.shapes().into_keys().map(|name| file.read(&name).map(|t| (name, t))).collect()
}

/// Tensors by name, and the texts in a file's head.
pub type TensorsAndTexts = (BTreeMap<String, Tensor>, HashMap<String, String>);

/// All tensors of a safetensors file in memory, and the texts in its head.
///
/// # Errors
/// A sentence without a subject: what is wrong with it.
pub fn from_bytes(bytes: &[u8]) -> Result<TensorsAndTexts, String> {
    let (_, head) = SafeTensors::read_metadata(bytes).map_err(|e| no_file(&e))?;
    let tensors = SafeTensors::deserialize(bytes).map_err(|e| no_file(&e))?;
    let each = tensors
        .iter()
        .map(|(name, view)| Ok((name.to_string(), tensor(name, view.dtype(), view.shape(), view.data())?)));
    Ok((each.collect::<Result<_, String>>()?, head.metadata().clone().unwrap_or_default()))
}

/// Before the head of a file stands its size, of so many bytes.
const HEAD_SIZE: usize = 8;

fn no_file(e: &safetensors::SafeTensorError) -> String {
    format!("is no safetensors file, or was cut off ({e}); copy it again, or take another")
}

fn shape(shape: &[usize]) -> Vec<i64> {
    shape.iter().map(|&s| s as i64).collect()
}

fn tensor(name: &str, dtype: Dtype, sizes: &[usize], data: &[u8]) -> Result<Tensor, String> {
    let kind = kind(dtype).ok_or_else(|| format!("tensor `{name}` has the type {dtype:?}"))?;
    Tensor::f_from_data_size(data, &shape(sizes), kind).map_err(|e| format!("tensor `{name}`: {e}"))
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
        let one = Reader::open(&path).unwrap();
        assert_eq!(one.shapes(), [("a".to_string(), vec![3, 2]), ("b".into(), vec![2])].into());
        // As often as one likes, and what it lacks is told.
        assert!((0..2).all(|_| one.read("b").unwrap().equal(&b)));
        assert!(one.read("c").unwrap_err().to_string().contains("a.safetensors: has no tensor `c`"));
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() - 3]).unwrap();
        assert!(read(&path).unwrap_err().to_string().contains("is no safetensors file"));
        std::fs::write(&path, b"").unwrap();
        assert!(read(&path).is_err());
    }
}
