//! Puppeteer's h5: a group a sample.

use hdf5_pure::{Dataset, Datatype, DatatypeByteOrder, File, Group, VlenStringReadOptions};

use super::super::archive::Input;
use super::super::array_rig::{ArrayRig, SparseRows};
use super::super::budget::Budget;
use super::super::fault::{PeerFault, shown};
use super::super::numbers::{Dtype, Numbers, elements};
use super::super::{fields, npy};
use super::{Assets, Give, Wanted};
use crate::Fault;
use crate::format::Reads;
use crate::peers::Source;

/// Elements of a dense matrix read in one go.
const BLOCK: usize = 1 << 16;

/// A chunk that any file may have: h5py makes them up to a megabyte, however well they shrink.
const CHUNK: u64 = 2 << 20;

/// HDF5, as Puppeteer has it.
pub(crate) struct Hdf5;

impl Reads for Hdf5 {
    fn name(&self) -> &'static str {
        "HDF5"
    }

    fn endings(&self) -> &'static [&'static str] {
        &["h5", "hdf5"]
    }

    fn starts(&self, bytes: &[u8]) -> bool {
        bytes.starts_with(b"\x89HDF\r\n\x1a\n")
    }

    fn has_models(&self) -> bool {
        false
    }

    fn short(&self) -> Option<&'static str> {
        Some("h5")
    }

    fn open<'a>(&self, file: &Source<'a>, _: bool) -> Result<Box<dyn Assets + 'a>, Fault> {
        Ok(Box::new(open(file.input)?))
    }
}

struct Puppeteer {
    file: File,
    length: u64,
    samples: Vec<String>,
}

fn fault(e: impl std::fmt::Display) -> PeerFault {
    PeerFault::Hdf5(shown(&e.to_string()))
}

fn open(input: Input<'_>) -> Result<Puppeteer, PeerFault> {
    let length = input.len().map_err(fault)?;
    let file = match input {
        Input::Bytes(bytes) => File::from_bytes(bytes.to_vec()),
        Input::File(path) => File::open_streaming(path),
    };
    let file = file.map_err(fault)?;
    let mut samples: Vec<(u64, String)> = Vec::new();
    for group in file.root().groups().map_err(fault)? {
        if let Some(number) = group.strip_prefix("sample_").and_then(|n| n.parse().ok()) {
            samples.push((number, group));
        }
    }
    samples.sort_unstable();
    if samples.is_empty() && ["weight_joints", "influences"].iter().all(|name| file.root().dataset(name).is_ok()) {
        return Err(PeerFault::Corpus);
    }
    if samples.is_empty() {
        return Err(fault("it has no group `sample_0`, as files of Puppeteer have"));
    }
    Ok(Puppeteer { file, length, samples: samples.into_iter().map(|(_, name)| name).collect() })
}

impl Assets for Puppeteer {
    fn count(&self) -> usize {
        self.samples.len()
    }

    fn each(&mut self, wanted: Wanted, give: Give<'_>) -> Result<(), PeerFault> {
        for (item, sample) in self.samples.iter().enumerate().filter(|(item, _)| wanted.has(*item)) {
            let rig = self.file.group(sample).map_err(fault).and_then(|group| {
                Sample { group, budget: Budget::of(self.length), passing: Budget::passing(self.length) }
                    .read(wanted.extras)
            });
            if give(item, rig).is_break() {
                break;
            }
        }
        Ok(())
    }
}

/// A data set of numbers that may be read.
struct Claim {
    data: Dataset,
    dtype: Dtype,
    shape: Vec<usize>,
    /// All elements, unpacked.
    bytes: usize,
}

fn dtype(stored: &Datatype) -> Option<Dtype> {
    let (size, order, kind) = match stored {
        Datatype::FixedPoint { size, byte_order, layout } if matches!(size, 1 | 2 | 4 | 8) => {
            (*size, byte_order, if layout.signed { b'i' } else { b'u' })
        }
        Datatype::FloatingPoint { size, byte_order, layout } => match (size, layout.exponent_size) {
            (2, 5) | (4, 8) | (8, 11) => (*size, byte_order, b'f'),
            (2, 8) => (*size, byte_order, b'g'),
            _ => return None,
        },
        _ => return None,
    };
    let big = match order {
        DatatypeByteOrder::LittleEndian => false,
        DatatypeByteOrder::BigEndian => true,
        DatatypeByteOrder::Vax => return None,
    };
    Some(Dtype { kind, size: size as usize, big })
}

/// A group, and what reading it may hold.
struct Sample {
    group: Group,
    budget: Budget,
    passing: Budget,
}

impl Sample {
    fn read(mut self, extras: bool) -> Result<ArrayRig, PeerFault> {
        let vertices = self.required("vertices")?.rows::<3>("vertices")?;
        let joints = self.required("joints")?.rows::<3>("joints")?;
        let faces = fields::faces(&self.required("faces")?.int_rows("faces")?, vertices.len())?;
        let bones = self.required("bones")?.int_rows("bones")?;
        let root = match self.numbers("root_index")? {
            Some(root) => root.ints("root_index")?.first().copied(),
            None => None,
        };
        let mut rig = ArrayRig {
            name: self.file_name()?,
            parents: fields::parents_of_bones(&bones, root, joints.len())?,
            weights: self.weights(joints.len())?,
            joints,
            vertices,
            faces,
            ..ArrayRig::default()
        };
        if extras {
            for (field, name) in [("edges", "edges"), ("graph_dist", "graph_dist"), ("pc_w_norm", "points")] {
                if let Some(numbers) = self.numbers(field)? {
                    rig.extras.insert(name.to_owned(), numbers.array(field)?);
                }
            }
        }
        Ok(rig)
    }

    /// A data set of numbers; `None` where there is none of the name.
    fn numbers(&mut self, field: &str) -> Result<Option<Numbers<'static>>, PeerFault> {
        let Some(Claim { data, dtype, shape, bytes }) = self.open(field)? else { return Ok(None) };
        self.budget.take(dtype.unpacked(bytes), field)?;
        let stored = data.read_raw().map_err(fault)?;
        Numbers::new(shape, dtype, false, stored).map(Some).map_err(|reason| PeerFault::field(field, reason))
    }

    fn required(&mut self, field: &str) -> Result<Numbers<'static>, PeerFault> {
        self.numbers(field)?.ok_or_else(|| PeerFault::field(field, "is missing"))
    }

    /// A data set and what it claims to hold.
    ///
    /// The library allocates what a data set claims before it reads it, so that is checked first.
    fn open(&mut self, field: &str) -> Result<Option<Claim>, PeerFault> {
        if !self.group.datasets().map_err(fault)?.iter().any(|name| name == field) {
            return Ok(None);
        }
        let data = self.group.dataset(field).map_err(fault)?;
        let dtype =
            dtype(&data.datatype().map_err(fault)?).ok_or_else(|| PeerFault::field(field, "holds no numbers"))?;
        let bytes = |shape: &[u64]| {
            let lengths: Vec<usize> = shape.iter().map(|n| usize::try_from(*n).unwrap_or(usize::MAX)).collect();
            (elements(&lengths).and_then(|n| n.checked_mul(dtype.size)), lengths)
        };
        let (size, shape) = bytes(&data.shape().map_err(fault)?);
        let chunk = data.chunk_shape().map_err(fault)?.map_or(Some(0), |c| bytes(&c).0);
        match (size, chunk) {
            (Some(size), Some(chunk)) => {
                // A chunk is held whole while it is taken apart.
                if chunk as u64 > CHUNK {
                    self.budget.clone().take(chunk as u64, field)?;
                }
                Ok(Some(Claim { data, dtype, shape, bytes: size }))
            }
            _ => Err(PeerFault::TooLarge(shown(field))),
        }
    }

    /// The dense weights, some rows at a time, without their zeros.
    fn weights(&mut self, joints: usize) -> Result<Option<SparseRows>, PeerFault> {
        const FIELD: &str = "skin";
        let Some(Claim { data, dtype, shape, bytes }) = self.open(FIELD)? else { return Ok(None) };
        let [rows, columns] = shape[..] else {
            return Err(PeerFault::field(FIELD, format!("has the shape {shape:?}, not [vertices, joints]")));
        };
        if columns != joints || columns == 0 {
            return Err(PeerFault::field(FIELD, format!("has {columns} columns for {joints} joints")));
        }
        self.passing.take(bytes as u64, FIELD)?;
        let at_once = (BLOCK / columns).max(1);
        let mut out = SparseRows::default();
        for start in (0..rows).step_by(at_once) {
            let count = at_once.min(rows - start);
            let block = data.read_raw_rows(start as u64, count as u64).map_err(fault)?;
            let before = out.pairs.len();
            let part = Numbers::new(vec![count, columns], dtype, false, block);
            part.map_err(|reason| PeerFault::field(FIELD, reason))?.append_sparse(FIELD, &mut out)?;
            self.budget.take(npy::held(out.pairs.len() - before, count), FIELD)?;
        }
        Ok(Some(out))
    }

    /// The name of the asset; empty where there is none.
    fn file_name(&self) -> Result<String, PeerFault> {
        const FIELD: &str = "file_name";
        if !self.group.datasets().map_err(fault)?.iter().any(|name| name == FIELD) {
            return Ok(String::new());
        }
        let data = self.group.dataset(FIELD).map_err(fault)?;
        match data.datatype().map_err(fault)? {
            Datatype::VariableLength { .. } => {
                let limits = VlenStringReadOptions::new().with_max_payload_bytes(4096).with_max_elements(1);
                let names = data.read_vlen_strings(limits).map_err(fault)?;
                Ok(names.into_iter().next().unwrap_or_default())
            }
            Datatype::String { size, .. } if size <= 4096 && data.shape().map_err(fault)?.iter().all(|n| *n == 1) => {
                Ok(data.read_string().map_err(fault)?.into_iter().next().unwrap_or_default())
            }
            _ => Err(PeerFault::field(FIELD, "is no text")),
        }
    }
}
