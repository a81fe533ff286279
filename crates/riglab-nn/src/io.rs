//! Tensors in safetensors files.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use safetensors::tensor::{Dtype, Metadata, SafeTensors, TensorInfo};
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

/// Writes the bytes of a safetensors file of these tensors, sorted by type and name, with texts by name in its head; numbers
/// as `as_kind`, or as they are. A tensor at a time is in memory beside the network that it is of.
///
/// # Errors
/// Those of `out`, and a sentence for a kind that the format has no name for.
pub fn write_to<N: AsRef<str>>(
    out: &mut impl Write,
    tensors: impl IntoIterator<Item = (N, Tensor)>,
    as_kind: Option<Kind>,
    texts: Option<HashMap<String, String>>,
) -> io::Result<()> {
    let mut all = Vec::new();
    for (name, t) in tensors {
        let (name, kind) = (name.as_ref().to_owned(), as_kind.unwrap_or(t.kind()));
        let dtype = dtype(kind)
            .ok_or_else(|| io::Error::other(format!("tensor `{name}` is of kind {kind:?}, which files cannot hold")))?;
        all.push((name, dtype, kind, t));
    }
    // Wide elements first, as the format's own library has it, so that each stands at a multiple of its size.
    all.sort_by(|(a, p, ..), (b, q, ..)| q.cmp(p).then_with(|| a.cmp(b)));
    let mut end = 0;
    let infos = all.iter().map(|(name, dtype, kind, t)| {
        let start = end;
        end += t.numel() * kind.elt_size_in_bytes();
        let shape = t.size().iter().map(|&s| s as usize).collect();
        (name.clone(), TensorInfo { dtype: *dtype, shape, data_offsets: (start, end) })
    });
    let head = Metadata::new(texts, infos.collect()).map_err(io::Error::other)?;
    let mut head = serde_json::to_vec(&head)?;
    head.resize(head.len().next_multiple_of(HEAD_SIZE), b' ');
    out.write_all(&(head.len() as u64).to_le_bytes())?;
    out.write_all(&head)?;
    let mut bytes = Vec::new();
    for (_, _, kind, t) in all {
        let t = t.detach().to_device(Device::Cpu).to_kind(kind).contiguous();
        bytes.resize(t.numel() * kind.elt_size_in_bytes(), 0);
        t.copy_data_u8(&mut bytes, t.numel());
        out.write_all(&bytes)?;
    }
    Ok(())
}

/// Writes a safetensors file; use a temporary name and rename it where the path matters.
///
/// # Errors
/// [`NnError::File`].
pub fn write<'a>(path: &Path, tensors: impl IntoIterator<Item = (&'a str, &'a Tensor)>) -> Result<(), NnError> {
    let tensors = tensors.into_iter().map(|(name, t)| (name, t.shallow_clone()));
    let written =
        File::create(path).and_then(|mut f| write_to(&mut f, tensors, None, None).and_then(|()| f.sync_all()));
    written.map_err(|e| NnError::File { path: path.into(), message: format!("cannot be written: {e}") })
}

/// An open safetensors file. Tensors are read one by one, so that a large file is never in memory beside the network
/// that it fills.
pub struct Reader {
    path: PathBuf,
    bytes: Bytes,
    head: Metadata,
    /// Where the tensors begin in the file.
    start: usize,
}

/// Where a file's bytes are.
enum Bytes {
    Mapped(memmap2::Mmap),
    Held(&'static [u8]),
}

impl std::ops::Deref for Bytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        match self {
            Self::Mapped(map) => map,
            Self::Held(bytes) => bytes,
        }
    }
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
        Self::of(path, Bytes::Mapped(map))
    }

    /// A file that is part of the program; `name` stands in messages.
    ///
    /// # Errors
    /// [`NnError::File`] when it is no safetensors file.
    pub fn of_held(name: &str, bytes: &'static [u8]) -> Result<Self, NnError> {
        Self::of(Path::new(name), Bytes::Held(bytes))
    }

    fn of(path: &Path, bytes: Bytes) -> Result<Self, NnError> {
        let fault = |e| NnError::File { path: path.into(), message: no_file(&e) };
        let (size, head) = SafeTensors::read_metadata(&bytes).map_err(fault)?;
        Ok(Self { path: path.into(), bytes, head, start: size + HEAD_SIZE })
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
        let tensor = tensor(name, info.dtype, &info.shape, &self.bytes[from..to]).map_err(fault)?;
        // Its pages are not asked for again; where they stay, they only count as memory of this process.
        #[cfg(unix)]
        if let Bytes::Mapped(map) = &self.bytes {
            // SAFETY: nothing borrows them any more, and what is read again comes from the file again.
            let _ = unsafe { map.unchecked_advise_range(memmap2::UncheckedAdvice::DontNeed, from, to - from) };
        }
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
        let held = Reader::of_held("a", bytes.clone().leak()).unwrap();
        assert!(held.read("a").unwrap().equal(&back["a"]));
        std::fs::write(&path, &bytes[..bytes.len() - 3]).unwrap();
        assert!(read(&path).unwrap_err().to_string().contains("is no safetensors file"));
        std::fs::write(&path, b"").unwrap();
        assert!(read(&path).is_err());
    }

    /// Whoever reads such files maps their numbers in place.
    #[test]
    fn what_is_written_is_what_the_formats_library_writes() {
        let (a, b) = (Tensor::arange(3, (Kind::Float, Device::Cpu)), Tensor::from_slice(&[1i64, -2]));
        let all = || [("z", a.shallow_clone()), ("b", b.shallow_clone()), ("a", a.to_kind(Kind::Half))];
        let texts = || Some(HashMap::from([("about".to_string(), "a \"word\"".to_string())]));
        let mut own = Vec::new();
        write_to(&mut own, all(), None, texts()).unwrap();
        let data = all().map(|(name, t)| {
            let mut bytes = vec![0; t.numel() * t.kind().elt_size_in_bytes()];
            t.copy_data_u8(&mut bytes, t.numel());
            (name, dtype(t.kind()).unwrap(), vec![t.numel()], bytes)
        });
        let views = data.iter().map(|(name, dtype, shape, bytes)| {
            (*name, safetensors::tensor::TensorView::new(*dtype, shape.clone(), bytes).unwrap())
        });
        assert_eq!(own, safetensors::serialize(views, texts()).unwrap());
        // In another kind, and in one that has no name there.
        let mut half = Vec::new();
        write_to(&mut half, [("a", a.shallow_clone())], Some(Kind::BFloat16), None).unwrap();
        let half = Reader::of_held("half", half.leak()).unwrap().read("a").unwrap();
        assert!(half.kind() == Kind::BFloat16 && half.equal(&a.to_kind(Kind::BFloat16)));
        let told = write_to(&mut Vec::new(), [("c", a.to_kind(Kind::ComplexFloat))], None, None).unwrap_err();
        assert!(told.to_string().contains("`c` is of kind ComplexFloat"), "{told}");
    }
}
