//! Writing a corpus.

use std::borrow::Cow;
use std::collections::HashSet;
use std::fs::File;
use std::path::{Path, PathBuf};

use hdf5::types::VarLenUnicode;
use hdf5::{Dataset, H5Type};
use ndarray::{ArrayView1, ArrayView2};
use riglab_core::{Asset, JointMap};
use riglab_files::Unfinished;

use crate::DataError;
use crate::reader::is_corpus;
use crate::room::{release, reserve};
use crate::schema::{CLIP_NAMES, DIGEST, FORMAT, JOINT_NAMES, OFFSETS, SCHEMA, SPLIT, TEXTS};

/// Rows are kept in memory until they come to this many bytes.
const BUFFER: usize = 8 << 20;
/// Rows of a chunk on disk.
const CHUNK: usize = 1 << 14;
/// Room for what is not rows: headers, indices, and the last chunk of each table, which is whole.
const OVERHEAD: u64 = 4 << 20;

/// A corpus being written: add assets, then [`CorpusWriter::finish`]. Dropped before that, it leaves
/// nothing behind.
pub struct CorpusWriter {
    path: PathBuf,
    unfinished: Unfinished,
    file: hdf5::File,
    rows: Rows,
    texts: [Vec<VarLenUnicode>; TEXTS.len()],
    joint_names: Vec<VarLenUnicode>,
    clip_names: Vec<VarLenUnicode>,
    /// Bytes on disk that the corpus may have come to.
    room: u64,
    offsets: [Vec<i64>; OFFSETS.len()],
    names: HashSet<String>,
}

/// Rows not yet on disk.
#[derive(Default)]
struct Rows {
    vertices: Vec<[f32; 3]>,
    faces: Vec<[u32; 3]>,
    joints: Vec<[f32; 3]>,
    parents: Vec<i32>,
    influences: Vec<u16>,
    weight_joints: Vec<u16>,
    weights: Vec<f32>,
    clip_rates: Vec<f32>,
    clip_frames: Vec<u32>,
    clip_maps: Vec<JointMap>,
}

impl Rows {
    fn bytes(&self) -> usize {
        12 * (self.vertices.len() + self.faces.len() + self.joints.len())
            + 4 * (self.parents.len() + self.weights.len() + 2 * self.clip_rates.len())
            + 48 * self.clip_maps.len()
            + 2 * (self.influences.len() + self.weight_joints.len())
    }
}

impl CorpusWriter {
    /// Begins a corpus that will stand at `path`, in an existing folder.
    ///
    /// # Errors
    /// When the folder cannot be written to, and as [`Self::may_take`].
    pub fn create(path: &Path) -> Result<Self, DataError> {
        Self::may_take(path)?;
        let dir = path.parent().filter(|d| !d.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let (_, unfinished) =
            Unfinished::beside(path).map_err(|e| DataError::io(dir, format!("cannot be written to ({e})")))?;
        // Without times of day: the same corpus has the same bytes.
        let file =
            unfinished.made_by(|path| hdf5::FileBuilder::new().with_fcpl(|p| p.obj_track_times(false)).create(path));
        let file = file.map_err(|e| write_error(path, &e))?;
        let mut writer = Self {
            path: path.into(),
            unfinished,
            file,
            rows: Rows::default(),
            texts: std::array::from_fn(|_| Vec::new()),
            joint_names: Vec::new(),
            clip_names: Vec::new(),
            room: OVERHEAD,
            offsets: std::array::from_fn(|_| vec![0]),
            names: HashSet::new(),
        };
        writer.reserve(0)?;
        writer.begin().map_err(|e| write_error(path, &e))?;
        Ok(writer)
    }

    /// Takes room for so many more bytes, before HDF5 writes them.
    fn reserve(&mut self, bytes: usize) -> Result<(), DataError> {
        // Indices of chunks and heaps of strings: some hundredths.
        self.room += bytes as u64 + bytes as u64 / 16;
        reserve(self.unfinished.path(), self.room)
            .map_err(|e| DataError::Write { path: self.path.clone(), message: e.to_string() })
    }

    fn begin(&mut self) -> hdf5::Result<()> {
        let text =
            |name: &str, value: &str| self.file.new_attr::<VarLenUnicode>().create(name)?.write_scalar(&unicode(value));
        text("format", FORMAT)?;
        text("riglab_version", env!("CARGO_PKG_VERSION"))?;
        self.file.new_attr::<u32>().create("schema")?.write_scalar(&SCHEMA)?;
        for name in ["vertices", "joints"] {
            self.table::<f32>(name, 3)?;
        }
        self.table::<u32>("faces", 3)?;
        self.table::<i32>("parents", 1)?;
        self.table::<u16>("influences", 1)?;
        self.table::<u16>("weight_joints", 1)?;
        self.table::<f32>("weights", 1)?;
        self.table::<f32>("clip_rates", 1)?;
        self.table::<u32>("clip_frames", 1)?;
        self.table::<f32>("clip_maps", 12)?;
        Ok(())
    }

    fn table<T: H5Type>(&self, name: &str, columns: usize) -> hdf5::Result<Dataset> {
        let builder = self.file.new_dataset::<T>();
        match columns {
            1 => builder.chunk((CHUNK,)).shape((0..,)).create(name),
            _ => builder.chunk((CHUNK, columns)).shape((0.., columns)).create(name),
        }
    }

    /// How many assets were added.
    pub fn len(&self) -> usize {
        self.joint_names.len()
    }

    /// Whether none was added yet.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The digests of those that were added: equal for assets that are equal but for their names and where they are from.
    pub fn digests(&self) -> Vec<&str> {
        self.texts[DIGEST].iter().map(VarLenUnicode::as_str).collect()
    }

    /// Whether a corpus may take a place: a folder, a device, somebody's own file, or what is write-protected is not replaced;
    /// an earlier corpus is, sound or broken. For whoever works long before the corpus is begun.
    ///
    /// # Errors
    /// When it may not.
    pub fn may_take(path: &Path) -> Result<(), DataError> {
        if path.exists() && !replaceable(path) {
            return Err(DataError::io(path, "is there already and no corpus; give another name"));
        }
        riglab_files::may_replace(path).map_err(|e| DataError::io(path, e))
    }

    /// Adds an asset; its split is given to [`Self::finish`].
    ///
    /// # Errors
    /// [`DataError::DuplicateName`], and when the disk refuses.
    pub fn add(&mut self, asset: &Asset) -> Result<(), DataError> {
        if !self.names.insert(stored(&asset.name).into_owned()) {
            return Err(DataError::DuplicateName(asset.name.clone()));
        }
        let (rig, from) = (&asset.rig, &asset.provenance);
        // A note takes a line; names from files that it quotes may hold more.
        let notes: Vec<String> = from.notes.iter().map(|note| note.replace(char::is_control, " ")).collect();
        let notes = notes.join("\n");
        let digest = digest(asset);
        let (humanoid, springs) = body(asset);
        let texts = [
            &asset.name,
            "",
            &from.source,
            &from.licence,
            &from.author,
            &from.category,
            &from.checksum,
            &notes,
            &digest,
            &humanoid,
            &springs,
        ];
        for (column, text) in self.texts.iter_mut().zip(texts) {
            column.push(unicode(text));
        }
        self.joint_names.push(unicode(&rig.skeleton().names().join("\n")));
        let (mesh, skeleton, weights) = (rig.mesh(), rig.skeleton(), rig.weights());
        let maps = asset.clips.iter().map(|c| c.maps().len()).sum();
        let counts = [
            mesh.positions().len(),
            mesh.triangles().len(),
            skeleton.len(),
            weights.nonzero(),
            asset.clips.len(),
            maps,
        ];
        for (offsets, n) in self.offsets.iter_mut().zip(counts) {
            offsets.push(offsets[offsets.len() - 1] + n as i64);
        }
        let rows = &mut self.rows;
        rows.vertices.extend(mesh.positions());
        rows.faces.extend(mesh.triangles());
        rows.joints.extend(skeleton.heads());
        rows.parents.extend(skeleton.parents().iter().map(|p| p.map_or(-1, |p| i32::from(p.0))));
        rows.influences.extend(weights.offsets().windows(2).map(|w| (w[1] - w[0]) as u16));
        rows.weight_joints.extend(weights.joints());
        rows.weights.extend(weights.weights());
        for clip in &asset.clips {
            self.clip_names.push(unicode(clip.name()));
            rows.clip_rates.push(clip.rate());
            rows.clip_frames.push(clip.frames() as u32);
            rows.clip_maps.extend(clip.maps());
        }
        if self.rows.bytes() > BUFFER { self.flush() } else { Ok(()) }
    }

    /// Completes the corpus with the split of each asset, in the order they were added, and puts it
    /// in its place.
    ///
    /// # Errors
    /// When the disk refuses; an older corpus at the path is left alone.
    pub fn finish<S: AsRef<str>>(mut self, splits: &[S]) -> Result<(), DataError> {
        assert_eq!(splits.len(), self.len(), "a split for each asset");
        self.texts[SPLIT] = splits.iter().map(|s| unicode(s.as_ref())).collect();
        self.flush()?;
        // A string takes its bytes, a reference, and its share of a heap's block.
        let strings = self
            .texts
            .iter()
            .chain([&self.joint_names, &self.clip_names])
            .flatten()
            .map(|t| t.len() + 64)
            .sum::<usize>();
        self.reserve(2 * strings + 8 * OFFSETS.len() * (self.len() + 1))?;
        let path = self.path.clone();
        self.end().map_err(|e| write_error(&path, &e))?;
        let Self { file, unfinished, .. } = self;
        file.close().map_err(|e| write_error(&path, &e))?;
        let written = File::options().write(true).open(unfinished.path());
        written.and_then(|f| release(&f).and_then(|()| f.sync_all())).map_err(|e| DataError::io(&path, e))?;
        unfinished.finish().map_err(|e| DataError::io(&path, e))
    }

    fn end(&self) -> hdf5::Result<()> {
        let others = [(&JOINT_NAMES, &self.joint_names), (&CLIP_NAMES, &self.clip_names)];
        for (name, column) in TEXTS.iter().zip(&self.texts).chain(others) {
            self.file.new_dataset_builder().with_data(column.as_slice()).create(*name)?;
        }
        for (name, offsets) in OFFSETS.iter().zip(&self.offsets) {
            self.file.new_dataset_builder().with_data(offsets.as_slice()).create(*name)?;
        }
        self.file.flush()
    }

    fn flush(&mut self) -> Result<(), DataError> {
        let rows = std::mem::take(&mut self.rows);
        self.reserve(rows.bytes())?;
        let all = || -> hdf5::Result<()> {
            self.append_rows("vertices", &rows.vertices)?;
            self.append_rows("faces", &rows.faces)?;
            self.append_rows("joints", &rows.joints)?;
            self.append("parents", &rows.parents)?;
            self.append("influences", &rows.influences)?;
            self.append("weight_joints", &rows.weight_joints)?;
            self.append("weights", &rows.weights)?;
            self.append("clip_rates", &rows.clip_rates)?;
            self.append("clip_frames", &rows.clip_frames)?;
            let (maps, _) = rows.clip_maps.as_flattened().as_flattened().as_chunks::<12>();
            self.append_rows("clip_maps", maps)
        };
        all().map_err(|e| write_error(&self.path, &e))
    }

    fn append<T: H5Type>(&self, name: &str, rows: &[T]) -> hdf5::Result<()> {
        let table = self.file.dataset(name)?;
        let at = table.shape()[0];
        table.resize((at + rows.len(),))?;
        if rows.is_empty() {
            return Ok(());
        }
        table.write_slice(ArrayView1::from(rows), at..at + rows.len())
    }

    fn append_rows<T: H5Type + Copy, const N: usize>(&self, name: &str, rows: &[[T; N]]) -> hdf5::Result<()> {
        let table = self.file.dataset(name)?;
        let at = table.shape()[0];
        table.resize((at + rows.len(), N))?;
        if rows.is_empty() {
            return Ok(());
        }
        let view = ArrayView2::from_shape((rows.len(), N), rows.as_flattened()).expect("N columns");
        table.write_slice(view, (at..at + rows.len(), ..))
    }
}

/// What stands at the beginning of each corpus, within so many bytes, whether or not the rest is there.
const BEGINNING: u64 = 1 << 16;

/// Whether a file is empty, a corpus, or one that was cut off or is in use: then its beginning tells what it is.
fn replaceable(path: &Path) -> bool {
    use std::io::Read;
    if !path.is_file() {
        return false;
    }
    let mut start = Vec::new();
    if File::open(path).and_then(|f| f.take(BEGINNING).read_to_end(&mut start)).is_err() {
        return false;
    }
    let named = || start.windows(FORMAT.len()).any(|bytes| bytes == FORMAT.as_bytes());
    let hdf5 = start.starts_with(b"\x89HDF\r\n\x1a\n");
    start.is_empty() || (hdf5 && hdf5::File::open(path).map_or_else(|_| named(), |file| is_corpus(&file)))
}

/// A text as it comes back: HDF5 strings end at a zero byte, and names from files may hold one.
fn stored(text: &str) -> Cow<'_, str> {
    if text.contains('\0') { text.replace('\0', "").into() } else { text.into() }
}

fn unicode(text: &str) -> VarLenUnicode {
    // Without zero bytes the conversion cannot fail.
    stored(text).parse().unwrap_or_default()
}

fn write_error(path: &Path, e: &hdf5::Error) -> DataError {
    DataError::Write { path: path.into(), message: short(e) }
}

/// The first sentence of an HDF5 error.
pub(crate) fn short(e: &hdf5::Error) -> String {
    e.to_string().lines().next().unwrap_or_default().chars().take(200).collect()
}

/// Human bones and springs as JSON; empty where there are none.
fn body(asset: &Asset) -> (String, String) {
    let (humanoid, springs) = (asset.rig.humanoid(), asset.rig.springs());
    // Numbers and names: nothing that JSON cannot hold.
    let humanoid = (!humanoid.is_empty()).then(|| serde_json::to_string(humanoid).unwrap_or_default());
    let springs = (!springs.is_empty()).then(|| serde_json::to_string(springs).unwrap_or_default());
    (humanoid.unwrap_or_default(), springs.unwrap_or_default())
}

/// BLAKE3 over an asset's arrays, names, human bones, springs and clips, as they are stored.
pub(crate) fn digest(asset: &Asset) -> String {
    let rig = &asset.rig;
    let mut hash = blake3::Hasher::new();
    let mut part = |n: usize, bytes: &mut dyn Iterator<Item = [u8; 4]>| {
        hash.update(&(n as u64).to_le_bytes());
        let all: Vec<u8> = bytes.flatten().collect();
        hash.update(&all);
    };
    let (mesh, skeleton, weights) = (rig.mesh(), rig.skeleton(), rig.weights());
    part(mesh.positions().len(), &mut mesh.positions().as_flattened().iter().map(|x| x.to_le_bytes()));
    part(mesh.triangles().len(), &mut mesh.triangles().as_flattened().iter().map(|x| x.to_le_bytes()));
    part(skeleton.len(), &mut skeleton.heads().as_flattened().iter().map(|x| x.to_le_bytes()));
    part(skeleton.len(), &mut skeleton.parents().iter().map(|p| p.map_or(-1, |p| i32::from(p.0)).to_le_bytes()));
    part(weights.rows(), &mut weights.offsets().iter().map(|x| x.to_le_bytes()));
    part(weights.nonzero(), &mut weights.joints().iter().map(|x| u32::from(*x).to_le_bytes()));
    part(weights.nonzero(), &mut weights.weights().iter().map(|x| x.to_le_bytes()));
    for clip in &asset.clips {
        part(clip.frames(), &mut clip.maps().as_flattened().as_flattened().iter().map(|x| x.to_le_bytes()));
        part(1, &mut [clip.rate().to_le_bytes()].into_iter());
    }
    let (humanoid, springs) = body(asset);
    let clips = asset.clips.iter().map(|c| c.name());
    for text in skeleton.names().iter().map(String::as_str).chain([humanoid.as_str(), &springs]).chain(clips) {
        hash.update(stored(text).as_bytes());
        hash.update(b"\n");
    }
    hash.finalize().to_hex().to_string()
}
