//! Reading a corpus.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use hdf5::types::VarLenUnicode;
use hdf5::{Dataset, H5Type};
use riglab_asset::LONE_JOINT;
use riglab_core::{Asset, Clip, Joint, JointId, JointMap, Mesh, Provenance, Rig, Skeleton, SkinWeights, Vec3};

use crate::DataError;
use crate::claims;
use crate::schema::{CLIP_NAMES, DIGEST, FORMAT, JOINT_NAMES, OFFSETS, SCHEMA, TEXTS};
use crate::writer::{digest, short};

/// Said of an asset that is not what its digest was made of.
const CHANGED: &str = "its arrays are not those that were written";

/// An open corpus. Shared by threads; HDF5 serves one at a time.
pub struct Corpus {
    path: PathBuf,
    file: hdf5::File,
    tables: Tables,
    offsets: [Vec<i64>; OFFSETS.len()],
    names: OnceLock<Vec<String>>,
}

struct Tables {
    vertices: Dataset,
    faces: Dataset,
    joints: Dataset,
    parents: Dataset,
    influences: Dataset,
    weight_joints: Dataset,
    weights: Dataset,
    texts: Vec<Dataset>,
    joint_names: Dataset,
    clip_names: Dataset,
    clip_rates: Dataset,
    clip_frames: Dataset,
    clip_maps: Dataset,
}

/// What [`Corpus::verify`] found wrong with an asset.
#[derive(Clone, Debug, PartialEq)]
pub struct Fault {
    /// The asset's number.
    pub index: usize,
    /// What is wrong.
    pub message: String,
}

impl Corpus {
    /// Opens a corpus and reads its offsets.
    ///
    /// # Errors
    /// When there is no such file, it is no HDF5 file or no corpus, or its parts do not fit together.
    pub fn open(path: &Path) -> Result<Self, DataError> {
        if path.is_dir() {
            return Err(DataError::NoCorpus(path.into()));
        }
        if !path.is_file() {
            return Err(DataError::Missing(path.into(), "corpus"));
        }
        let file = hdf5::File::open(path).map_err(|e| match is_called_corpus(path) {
            true => DataError::NotHdf5 { path: path.into(), message: short(&e) },
            false => DataError::OtherKind(path.into()),
        })?;
        let foreign = |message: String| DataError::NotCorpus { path: path.into(), message };
        if !is_corpus(&file) {
            return Err(DataError::OtherHdf5(path.into()));
        }
        let schema: u32 =
            file.attr("schema").and_then(|a| a.read_scalar()).map_err(|_| foreign("no attribute `schema`".into()))?;
        if schema != SCHEMA {
            return Err(foreign(format!("its schema is {schema}, this version reads {SCHEMA}")));
        }
        let tables = Tables::open(&file).map_err(|e| foreign(short(&e)))?;
        for table in tables.all() {
            claims::check(path, file.size(), table)?;
        }
        let mut offsets: [Vec<i64>; OFFSETS.len()] = Default::default();
        for (name, column) in OFFSETS.iter().zip(&mut offsets) {
            let dataset = file.dataset(name).map_err(|e| foreign(short(&e)))?;
            claims::check(path, file.size(), &dataset)?;
            *column = dataset.read_raw().map_err(|e| foreign(short(&e)))?;
        }
        let t = &tables;
        let ends = [&t.vertices, &t.faces, &t.joints, &t.weights, &t.clip_rates, &t.clip_maps];
        let ends = ends.map(|t| t.shape()[0] as i64);
        let fits = offsets.iter().zip(ends).all(|(o, end)| {
            o.len() == offsets[0].len()
                && o.first() == Some(&0)
                && o.last() == Some(&end)
                && o.windows(2).all(|w| w[0] <= w[1])
        });
        let columns = tables.texts.iter().all(|t| t.shape()[0] + 1 == offsets[0].len());
        if !fits || !columns {
            return Err(foreign("offsets and tables do not fit together".into()));
        }
        Ok(Self { path: path.into(), file, tables, offsets, names: OnceLock::new() })
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// How many assets.
    pub fn len(&self) -> usize {
        self.offsets[0].len() - 1
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Size of the file in bytes.
    pub fn bytes(&self) -> u64 {
        self.file.size()
    }

    /// Vertices, triangles, joints and non-zero weights of an asset, without reading it.
    pub fn counts(&self, index: usize) -> [usize; 4] {
        std::array::from_fn(|k| (self.offsets[k][index + 1] - self.offsets[k][index]) as usize)
    }

    /// A column of texts (see [`crate::schema`]): `name`, `split`, `category`, ...
    ///
    /// # Errors
    /// When there is no such column, or it cannot be read.
    pub fn texts(&self, column: &str) -> Result<Vec<String>, DataError> {
        let table = TEXTS.iter().position(|t| *t == column).map(|k| &self.tables.texts[k]);
        let table = table.ok_or_else(|| DataError::NotCorpus {
            path: self.path.clone(),
            message: format!("no column `{column}`"),
        })?;
        let read: hdf5::Result<Vec<VarLenUnicode>> = table.read_raw();
        let texts = read.map_err(|e| DataError::NotHdf5 { path: self.path.clone(), message: short(&e) })?;
        Ok(texts.iter().map(|t| t.as_str().to_string()).collect())
    }

    /// The assets' names.
    ///
    /// # Errors
    /// When they cannot be read.
    pub fn names(&self) -> Result<&[String], DataError> {
        if let Some(names) = self.names.get() {
            return Ok(names);
        }
        let names = self.texts("name")?;
        Ok(self.names.get_or_init(|| names))
    }

    /// The assets of a split, in corpus order.
    ///
    /// # Errors
    /// When the column cannot be read.
    pub fn split(&self, split: &str) -> Result<Vec<usize>, DataError> {
        Ok(self.texts("split")?.iter().enumerate().filter(|(_, s)| *s == split).map(|(i, _)| i).collect())
    }

    /// The assets that are bare meshes, as `riglab dataset import --meshes` writes them: held by one joint,
    /// [`LONE_JOINT`]. Their split says so only until they are split anew.
    ///
    /// # Errors
    /// When the column cannot be read.
    pub fn bare(&self) -> Result<Vec<usize>, DataError> {
        let lone: Vec<usize> = (0..self.len()).filter(|&index| self.counts(index)[2] == 1).collect();
        if lone.is_empty() {
            return Ok(lone);
        }
        let read: hdf5::Result<Vec<VarLenUnicode>> = self.tables.joint_names.read_raw();
        let names = read.map_err(|e| DataError::NotHdf5 { path: self.path.clone(), message: short(&e) })?;
        let is_bare = |index: &usize| names.get(*index).is_some_and(|name| name.as_str() == LONE_JOINT);
        Ok(lone.into_iter().filter(is_bare).collect())
    }

    /// One asset.
    ///
    /// # Errors
    /// [`DataError::Damaged`] when its rows cannot be read or are no rig.
    pub fn asset(&self, index: usize) -> Result<Asset, DataError> {
        let name = self.names()?.get(index).cloned().unwrap_or_default();
        self.read(index).map_err(|message| DataError::damaged(&self.path, index, &name, message))
    }

    /// One asset, compared with the digest it was written with: for whoever writes it anew, which gives it a fresh digest
    /// that would vouch for what is damaged.
    ///
    /// # Errors
    /// [`DataError::Damaged`], as [`Self::asset`] and when they differ.
    pub fn verified(&self, index: usize) -> Result<Asset, DataError> {
        let asset = self.asset(index)?;
        let damaged = |message: String| DataError::damaged(&self.path, index, &asset.name, message);
        let wanted = self.tables.texts[DIGEST].read_slice_1d::<VarLenUnicode, _>(index..index + 1);
        let wanted = wanted.map_err(|e| damaged(short(&e)))?;
        if digest(&asset) != wanted[0].as_str() {
            return Err(damaged(CHANGED.into()));
        }
        Ok(asset)
    }

    fn read(&self, index: usize) -> Result<Asset, String> {
        if index >= self.len() {
            return Err(format!("the corpus has {} assets", self.len()));
        }
        let hdf5 = |e: hdf5::Error| short(&e);
        let span = |k: usize| self.offsets[k][index] as usize..self.offsets[k][index + 1] as usize;
        let (v, f, j, w) = (span(0), span(1), span(2), span(3));
        let t = &self.tables;
        let text = |d: &Dataset| -> Result<String, String> {
            let one = d.read_slice_1d::<VarLenUnicode, _>(index..index + 1).map_err(hdf5)?;
            Ok(one[0].as_str().to_string())
        };
        let names = text(&t.joint_names)?;
        let heads: Vec<Vec3> = rows_of(&t.joints, j.clone()).map_err(hdf5)?;
        let parents: Vec<i32> = rows(&t.parents, j).map_err(hdf5)?;
        let names: Vec<&str> = names.split('\n').collect();
        if names.len() != heads.len() {
            return Err(format!("{} names for {} joints", names.len(), heads.len()));
        }
        let joints = names.iter().zip(parents).zip(heads).map(|((name, parent), head)| {
            let parent = match parent {
                -1 => None,
                p => Some(JointId(u16::try_from(p).map_err(|_| format!("joint `{name}` has parent {p}"))?)),
            };
            Ok(Joint { name: (*name).to_string(), parent, head })
        });
        let skeleton = Skeleton::new(joints.collect::<Result<_, String>>()?).map_err(|e| e.to_string())?;
        let mesh = Mesh::new(rows_of(&t.vertices, v.clone()).map_err(hdf5)?, rows_of(&t.faces, f).map_err(hdf5)?)
            .map_err(|e| e.to_string())?;
        let influences: Vec<u16> = rows(&t.influences, v).map_err(hdf5)?;
        let mut offsets = Vec::with_capacity(influences.len() + 1);
        offsets.push(0u32);
        offsets.extend(influences.iter().scan(0u32, |sum, &n| {
            *sum += u32::from(n);
            Some(*sum)
        }));
        let weights = SkinWeights::new(
            offsets,
            rows(&t.weight_joints, w.clone()).map_err(hdf5)?,
            rows(&t.weights, w).map_err(hdf5)?,
        )
        .map_err(|e| e.to_string())?;
        let rig = Rig::new(skeleton, mesh, weights).map_err(|e| e.to_string())?;
        let clips = self.read_clips(index, rig.skeleton().len())?;
        let texts = t.texts.iter().map(text).collect::<Result<Vec<_>, _>>()?;
        let provenance = Provenance {
            source: texts[2].clone(),
            licence: texts[3].clone(),
            author: texts[4].clone(),
            category: texts[5].clone(),
            checksum: texts[6].clone(),
            notes: texts[7].lines().map(String::from).collect(),
        };
        let (humanoid, springs) = (parsed(&texts[9])?, parsed(&texts[10])?);
        let rig = rig.with_humanoid(humanoid).and_then(|rig| rig.with_springs(springs)).map_err(|e| e.to_string())?;
        Ok(Asset { name: texts[0].clone(), rig, clips, provenance })
    }

    fn read_clips(&self, index: usize, joints: usize) -> Result<Vec<Clip>, String> {
        let hdf5 = |e: hdf5::Error| short(&e);
        let [c, m] = [4, 5].map(|k| self.offsets[k][index] as usize..self.offsets[k][index + 1] as usize);
        if c.is_empty() {
            return Ok(Vec::new());
        }
        let t = &self.tables;
        let names: Vec<VarLenUnicode> = rows(&t.clip_names, c.clone()).map_err(hdf5)?;
        let rates: Vec<f32> = rows(&t.clip_rates, c.clone()).map_err(hdf5)?;
        let frames: Vec<u32> = rows(&t.clip_frames, c).map_err(hdf5)?;
        let mut maps = rows_of::<f32, 12>(&t.clip_maps, m).map_err(hdf5)?.into_iter();
        let mut clips = Vec::with_capacity(names.len());
        for ((name, rate), frames) in names.iter().zip(rates).zip(frames) {
            let own = maps.by_ref().take((frames as usize).saturating_mul(joints));
            let own = own.map(|m| -> JointMap { std::array::from_fn(|k| [m[3 * k], m[3 * k + 1], m[3 * k + 2]]) });
            let clip = Clip::new(name.as_str().to_owned(), rate, joints, own.collect()).map_err(|e| e.to_string())?;
            if clip.frames() != frames as usize {
                return Err(format!("the clip `{}` has {} of {frames} frames", clip.name(), clip.frames()));
            }
            clips.push(clip);
        }
        Ok(clips)
    }

    /// Reads every asset and compares it with its digest.
    ///
    /// # Errors
    /// When the columns of names or digests cannot be read; a damaged asset is a [`Fault`].
    pub fn verify(&self, mut progress: impl FnMut(usize)) -> Result<Vec<Fault>, DataError> {
        let digests = self.texts("digest")?;
        let mut faults = Vec::new();
        for (index, wanted) in digests.iter().enumerate() {
            match self.asset(index) {
                Err(e) => faults.push(Fault { index, message: e.to_string() }),
                Ok(asset) if digest(&asset) != *wanted => {
                    faults.push(Fault { index, message: CHANGED.into() });
                }
                Ok(_) => {}
            }
            progress(index + 1);
        }
        Ok(faults)
    }

    /// One BLAKE3 sum for the whole corpus: over the assets' names, splits and digests.
    ///
    /// # Errors
    /// When the columns cannot be read.
    pub fn checksum(&self) -> Result<String, DataError> {
        let mut hash = blake3::Hasher::new();
        for column in ["name", "split", "digest"] {
            for text in self.texts(column)? {
                hash.update(text.as_bytes());
                hash.update(b"\n");
            }
        }
        Ok(hash.finalize().to_hex().to_string())
    }
}

impl Tables {
    fn all(&self) -> impl Iterator<Item = &Dataset> {
        let rows = [&self.vertices, &self.faces, &self.joints, &self.parents, &self.influences, &self.weight_joints];
        let more =
            [&self.weights, &self.joint_names, &self.clip_names, &self.clip_rates, &self.clip_frames, &self.clip_maps];
        rows.into_iter().chain(more).chain(&self.texts)
    }

    fn open(file: &hdf5::File) -> hdf5::Result<Self> {
        let columns = |name: &str, n: usize| {
            let d = file.dataset(name)?;
            let shape = d.shape();
            let fits = if n == 1 { shape.len() == 1 } else { shape.len() == 2 && shape[1] == n };
            if fits { Ok(d) } else { Err(hdf5::Error::Internal(format!("`{name}` has shape {shape:?}"))) }
        };
        Ok(Self {
            vertices: columns("vertices", 3)?,
            faces: columns("faces", 3)?,
            joints: columns("joints", 3)?,
            parents: columns("parents", 1)?,
            influences: columns("influences", 1)?,
            weight_joints: columns("weight_joints", 1)?,
            weights: columns("weights", 1)?,
            texts: TEXTS.iter().map(|t| columns(t, 1)).collect::<hdf5::Result<_>>()?,
            joint_names: columns(JOINT_NAMES, 1)?,
            clip_names: columns(CLIP_NAMES, 1)?,
            clip_rates: columns("clip_rates", 1)?,
            clip_frames: columns("clip_frames", 1)?,
            clip_maps: columns("clip_maps", 12)?,
        })
    }
}

fn rows<T: H5Type>(table: &Dataset, span: std::ops::Range<usize>) -> hdf5::Result<Vec<T>> {
    Ok(table.read_slice_1d::<T, _>(span)?.into_raw_vec_and_offset().0)
}

fn rows_of<T: H5Type + Copy, const N: usize>(
    table: &Dataset,
    span: std::ops::Range<usize>,
) -> hdf5::Result<Vec<[T; N]>> {
    let flat = table.read_slice_2d::<T, _>((span, ..))?.into_raw_vec_and_offset().0;
    Ok(flat.as_chunks().0.to_vec())
}

/// What a JSON column says; the default where it is empty.
fn parsed<T: Default + serde::de::DeserializeOwned>(text: &str) -> Result<T, String> {
    if text.is_empty() { Ok(T::default()) } else { serde_json::from_str(text).map_err(|e| e.to_string()) }
}

/// Whether an HDF5 file says that it is a corpus.
pub(crate) fn is_corpus(file: &hdf5::File) -> bool {
    let format: Option<VarLenUnicode> = file.attr("format").and_then(|a| a.read_scalar()).ok();
    format.as_deref() == Some(FORMAT)
}

/// Whether a file ends as corpora do: one that is no HDF5 file was cut off.
fn is_called_corpus(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ["h5", "hdf5"].iter().any(|own| ending.eq_ignore_ascii_case(own)))
}

#[cfg(test)]
mod tests {
    use riglab_core::{Humanoid, Spring, SpringJoint, Springs, Swing};

    use super::*;
    use crate::CorpusWriter;

    fn asset(name: &str, n: u16) -> Asset {
        let joints = (0..n).map(|i| Joint {
            name: format!("j{i}"),
            parent: i.checked_sub(1).map(JointId),
            head: [0.0, f32::from(i), 0.0],
        });
        let skeleton = Skeleton::new(joints.collect()).unwrap();
        let mesh = Mesh::new((0..=n).map(|i| [f32::from(i), 1.0, 0.5]).collect(), vec![[0, 1, u32::from(n)]]).unwrap();
        let weights = SkinWeights::normalized((0..=n).map(|i| vec![(i % n, 0.7), (0, 0.3)])).unwrap();
        let provenance =
            Provenance { licence: "CC0-1.0".into(), notes: vec!["a".into(), "b".into()], ..Default::default() };
        let mut humanoid = Humanoid::default();
        humanoid.insert("head".parse().unwrap(), JointId(n - 1));
        let joint = SpringJoint { joint: JointId(n - 1), tail: Some([0.1, 0.2, 0.3]), swing: Swing::default() };
        let spring = Spring { name: "hair".into(), joints: vec![joint], groups: vec![], center: None };
        let rig = Rig::new(skeleton, mesh, weights).unwrap().with_humanoid(humanoid).unwrap();
        let rig = rig.with_springs(Springs::new(vec![spring], vec![], vec![]).unwrap()).unwrap();
        let map = |x: usize| [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [x as f32, 0.0, 0.25]];
        let clip = |name: &str, frames: usize| {
            Clip::new(name.into(), 24.0, n.into(), (0..frames * usize::from(n)).map(map).collect()).unwrap()
        };
        Asset { name: name.into(), rig, clips: vec![clip("walk", 3), clip("idle", 1)], provenance }
    }

    fn written(dir: &Path) -> PathBuf {
        let path = dir.join("c.h5");
        let mut writer = CorpusWriter::create(&path).unwrap();
        writer.add(&asset("one", 3)).unwrap();
        writer.add(&asset("two", 7)).unwrap();
        assert!(matches!(writer.add(&asset("two", 2)), Err(DataError::DuplicateName(_))));
        assert!(!path.exists());
        writer.finish(&["train", "val"]).unwrap();
        path
    }

    #[test]
    fn assets_come_back_equal() {
        let dir = tempfile::tempdir().unwrap();
        let corpus = Corpus::open(&written(dir.path())).unwrap();
        assert_eq!(corpus.asset(0).unwrap(), asset("one", 3));
        assert_eq!(corpus.asset(1).unwrap(), asset("two", 7));
        assert_eq!((corpus.len(), corpus.split("val").unwrap()), (2, vec![1]));
        assert_eq!(corpus.verify(|_| ()).unwrap(), []);
        assert!(corpus.asset(2).unwrap_err().to_string().contains("has 2 assets"));
        // Nothing but the corpus is left.
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_zero_byte_in_a_name_damages_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("c.h5");
        let mut writer = CorpusWriter::create(&path).unwrap();
        let mut odd = asset("o\0ne", 3);
        let clip = &odd.clips[0];
        odd.clips[0] = Clip::new("wa\0lk".into(), clip.rate(), clip.joints(), clip.maps().to_vec()).unwrap();
        odd.provenance.author = "so\0me".into();
        writer.add(&odd).unwrap();
        // Both would come back under one name.
        assert!(matches!(writer.add(&asset("one", 2)), Err(DataError::DuplicateName(_))));
        writer.finish(&["train"]).unwrap();
        let corpus = Corpus::open(&path).unwrap();
        assert_eq!(corpus.verify(|_| ()).unwrap(), []);
        let back = corpus.verified(0).unwrap();
        assert_eq!((back.name.as_str(), back.clips[0].name()), ("one", "walk"));
    }

    #[test]
    fn only_corpora_are_replaced_whether_or_not_they_can_be_opened() {
        let dir = tempfile::tempdir().unwrap();
        let path = written(dir.path());
        let whole = std::fs::read(&path).unwrap();
        let at = whole.windows(FORMAT.len()).position(|bytes| bytes == FORMAT.as_bytes()).unwrap();
        let mut foreign = whole.clone();
        foreign[at..at + FORMAT.len()].copy_from_slice(b"somebodyelses");
        for (bytes, replaced) in [
            (&whole[..], true),
            (&whole[..whole.len() / 2], true),
            (&[], true),
            (&foreign, false),
            (&foreign[..foreign.len() / 2], false),
            (b"\x89HDF\r\n\x1a\n", false),
        ] {
            std::fs::write(&path, bytes).unwrap();
            assert_eq!(CorpusWriter::may_take(&path).is_ok(), replaced, "{} bytes", bytes.len());
        }
    }

    #[test]
    fn a_note_is_one_whatever_it_quotes() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("c.h5");
        let mut writer = CorpusWriter::create(&path).unwrap();
        let mut odd = asset("one", 3);
        odd.provenance.notes = vec!["`a\nb` became `a_b`".into(), "second".into()];
        writer.add(&odd).unwrap();
        writer.finish(&["train"]).unwrap();
        assert_eq!(
            Corpus::open(&path).unwrap().verified(0).unwrap().provenance.notes,
            ["`a b` became `a_b`", "second"]
        );
    }

    #[test]
    fn a_dropped_writer_leaves_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let mut writer = CorpusWriter::create(&dir.path().join("c.h5")).unwrap();
        writer.add(&asset("one", 3)).unwrap();
        drop(writer);
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    }

    #[test]
    fn a_corpus_cut_anywhere_is_an_error_not_a_panic() {
        let dir = tempfile::tempdir().unwrap();
        let path = written(dir.path());
        let bytes = std::fs::read(&path).unwrap();
        for cut in [0, 1, 7, 100, bytes.len() / 3, bytes.len() / 2, bytes.len() - 1] {
            std::fs::write(&path, &bytes[..cut]).unwrap();
            let message = match Corpus::open(&path) {
                Err(e) => e.to_string(),
                Ok(c) => c.verify(|_| ()).map(|f| f[0].message.clone()).unwrap_or_else(|e| e.to_string()),
            };
            assert!(message.contains("c.h5") && message.contains("import"), "{cut}: {message}");
        }
    }

    #[test]
    fn a_corpus_that_claims_rows_it_does_not_store_is_refused_when_it_is_opened() {
        let tables = ["vertices", "faces", "joints", "parents", "weights", "clip_maps"];
        for name in tables.into_iter().chain([OFFSETS[0], TEXTS[0]]) {
            let dir = tempfile::tempdir().unwrap();
            let path = written(dir.path());
            let file = hdf5::File::open_rw(&path).unwrap();
            let shape = file.dataset(name).unwrap().shape();
            file.unlink(name).unwrap();
            // Chunks that were never written.
            let made = match (shape.len(), name) {
                (1, "name") => file.new_dataset::<VarLenUnicode>().chunk((64,)).shape((1usize << 40,)).create(name),
                (1, _) => file.new_dataset::<i64>().chunk((64,)).shape((1usize << 40,)).create(name),
                _ => file.new_dataset::<f32>().chunk((64, shape[1])).shape((1usize << 40, shape[1])).create(name),
            };
            made.unwrap();
            file.close().unwrap();
            let said = Corpus::open(&path).err().unwrap().to_string();
            assert!(said.contains("c.h5") && said.contains(&format!("`{name}`")) && said.contains("import"), "{said}");
        }
    }

    #[test]
    fn flipped_bits_are_found() {
        let dir = tempfile::tempdir().unwrap();
        let path = written(dir.path());
        let mut bytes = std::fs::read(&path).unwrap();
        // A vertex coordinate: 1.0 followed by 0.5 occurs in no header.
        let pattern: Vec<u8> = [1.0f32, 0.5].iter().flat_map(|x| x.to_le_bytes()).collect();
        let at = bytes.windows(8).position(|w| w == pattern).unwrap();
        bytes[at] ^= 1;
        std::fs::write(&path, &bytes).unwrap();
        let corpus = Corpus::open(&path).unwrap();
        let faults = corpus.verify(|_| ()).unwrap();
        assert_eq!(faults.len(), 1);
        let index = faults[0].index;
        assert!(corpus.asset(index).is_ok());
        let said = corpus.verified(index).unwrap_err().to_string();
        assert!(said.contains("c.h5") && said.contains("damaged: its arrays"), "{said}");
        assert_eq!(corpus.verified(1 - index).unwrap(), corpus.asset(1 - index).unwrap());
    }

    #[test]
    fn other_hdf5_files_are_refused_politely() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.h5");
        hdf5::File::create(&path).unwrap().close().unwrap();
        assert!(matches!(Corpus::open(&path), Err(DataError::OtherHdf5(_))));
        let missing = Corpus::open(&dir.path().join("y.h5")).err().unwrap();
        assert!(matches!(missing, DataError::Missing(..)) && !missing.to_string().contains("looked for"));
        // A path that is of use in one folder alone says which.
        let said = Corpus::open(Path::new("nowhere.h5")).err().unwrap().to_string();
        let here = std::env::current_dir().unwrap();
        assert_eq!(said, format!("nowhere.h5: no such corpus (looked for from the folder {})", here.display()));
        let said = Corpus::open(dir.path()).err().unwrap().to_string();
        assert!(said.contains("a folder, not a corpus") && said.contains("riglab dataset import"), "{said}");
        // What is to be copied into a shell is quoted for one.
        let odd = dir.path().join("a b");
        std::fs::create_dir(&odd).unwrap();
        let said = Corpus::open(&odd).err().unwrap().to_string();
        assert!(said.contains("a b' -o corpus.h5"), "{said}");
        let here = dir.path().join("no/such/folder/c.h5");
        assert!(matches!(CorpusWriter::create(&here), Err(DataError::Io { .. })));
    }
}
