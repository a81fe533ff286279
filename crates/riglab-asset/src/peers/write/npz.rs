//! Npz archives.

use std::fs::File;
use std::io::{self, BufWriter, Cursor, Read, Seek, SeekFrom, Write};
use std::path::Path;

use riglab_core::{Rig, Vec3};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use super::super::array_rig::Up;
use super::pickle::Pickle;
use crate::maker::{MAKER, is_maker};

/// An archive being filled, in memory or in a file. The same content gives the same bytes.
pub(super) struct Npz<W: Write + Seek = Cursor<Vec<u8>>> {
    zip: ZipWriter<W>,
    options: SimpleFileOptions,
}

impl<W: Write + Seek> Npz<W> {
    fn with(out: W, compressed: bool) -> Self {
        let method = if compressed { CompressionMethod::Deflated } else { CompressionMethod::Stored };
        let mut zip = ZipWriter::new(out);
        zip.set_comment(MAKER);
        Self { zip, options: SimpleFileOptions::default().compression_method(method).large_file(true) }
    }

    /// Begins a member of any name, which what is written next goes into.
    pub(super) fn begin(&mut self, name: &str) -> io::Result<&mut impl Write> {
        self.zip.start_file(name, self.options)?;
        Ok(&mut self.zip)
    }
}

impl Npz<BufWriter<File>> {
    pub(super) fn in_file(file: File, compressed: bool) -> Self {
        Self::with(BufWriter::new(file), compressed)
    }

    /// The file, with all of it.
    pub(super) fn close(self) -> io::Result<File> {
        self.zip.finish()?.into_inner().map_err(io::IntoInnerError::into_error)
    }
}

impl Npz {
    pub(super) fn new(compressed: bool) -> Self {
        Self::with(Cursor::new(Vec::new()), compressed)
    }

    /// A member of any name.
    fn member(&mut self, name: &str, bytes: &[u8]) {
        let written = self.begin(name).and_then(|member| member.write_all(bytes));
        // Into memory: there is nothing that could refuse.
        debug_assert!(written.is_ok(), "{name}");
    }

    fn array(&mut self, name: &str, descr: &str, shape: &[usize], data: &[u8]) {
        let mut bytes = head(descr, shape);
        bytes.extend(data);
        self.member(&format!("{name}.npy"), &bytes);
    }

    pub(super) fn floats(&mut self, name: &str, shape: &[usize], data: &[f32]) {
        self.array(name, "<f4", shape, &f32s(data));
    }

    /// The weights as a dense matrix [vertices, joints], a row at a time.
    pub(super) fn weights(&mut self, name: &str, rig: &Rig) {
        let (vertices, joints) = (rig.weights().rows(), rig.skeleton().len());
        let mut row = vec![0.0f32; joints];
        let member = format!("{name}.npy");
        let mut write = || -> io::Result<()> {
            let member = self.begin(&member)?;
            member.write_all(&head("<f4", &[vertices, joints]))?;
            (0..vertices).try_for_each(|vertex| {
                dense_row(rig, vertex, &mut row);
                member.write_all(&f32s(&row))
            })
        };
        let written = write();
        // Into memory: there is nothing that could refuse.
        debug_assert!(written.is_ok(), "{name}");
    }

    pub(super) fn points(&mut self, name: &str, points: &[Vec3]) {
        self.floats(name, &[points.len(), 3], points.as_flattened());
    }

    pub(super) fn ints(&mut self, name: &str, shape: &[usize], data: impl IntoIterator<Item = i64>) {
        self.array(name, "<i8", shape, &i64s(data));
    }

    /// Text in UTF-32, padded to the longest.
    pub(super) fn texts(&mut self, name: &str, shape: &[usize], texts: &[String]) {
        let longest = texts.iter().map(|t| t.chars().count()).max().unwrap_or(0).max(1);
        let pad = |t: &String| t.chars().map(u32::from).chain(std::iter::repeat(0)).take(longest).collect::<Vec<_>>();
        let data: Vec<u8> = texts.iter().flat_map(pad).flat_map(u32::to_le_bytes).collect();
        self.array(name, &format!("<U{longest}"), shape, &data);
    }

    /// An array of objects, pickled.
    pub(super) fn objects(&mut self, name: &str, shape: &[usize], members: impl FnOnce(&mut Pickle)) {
        let mut pickle = Pickle::new(3);
        pickle.objects(shape, members);
        self.array(name, "|O", shape, &pickle.end());
    }

    pub(super) fn end(self) -> Vec<u8> {
        self.zip.finish().map(Cursor::into_inner).unwrap_or_default()
    }
}

/// What an array of numpy begins with.
pub(super) fn head(descr: &str, shape: &[usize]) -> Vec<u8> {
    let lengths: String = shape.iter().map(|n| format!("{n},")).collect();
    let mut header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({lengths}), }}");
    // The data begin at a multiple of 64.
    let length = (10 + header.len() + 1).next_multiple_of(64) - 10;
    header.extend(std::iter::repeat_n(' ', length - 1 - header.len()));
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\0".to_vec();
    bytes.extend((length as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes
}

/// Whether an archive says that riglab wrote it: in the comment at its end.
pub(super) fn is_own(path: &Path) -> bool {
    // An end of 22 bytes, the comment's length among them, and the comment, which is short.
    const TAIL: u64 = 64;
    const END: usize = 22;
    let tail = || {
        let mut file = File::open(path)?;
        let length = file.metadata()?.len();
        file.seek(SeekFrom::Start(length.saturating_sub(TAIL)))?;
        let mut tail = Vec::new();
        file.take(TAIL).read_to_end(&mut tail)?;
        std::io::Result::Ok(tail)
    };
    tail().is_ok_and(|tail| {
        let end = tail.windows(4).rposition(|word| word == b"PK\x05\x06");
        end.and_then(|at| tail.get(at + END..)).is_some_and(is_maker)
    })
}

pub(super) fn f32s(data: &[f32]) -> Vec<u8> {
    data.iter().flat_map(|x| x.to_le_bytes()).collect()
}

pub(super) fn i64s(data: impl IntoIterator<Item = i64>) -> Vec<u8> {
    data.into_iter().flat_map(i64::to_le_bytes).collect()
}

pub(super) fn f16s(data: &[f32]) -> Vec<u8> {
    data.iter().flat_map(|x| half::f16::from_f32(*x).to_le_bytes()).collect()
}

/// Corners of all triangles.
pub(super) fn corners(rig: &Rig) -> impl Iterator<Item = i64> + '_ {
    rig.mesh().triangles().iter().flatten().map(|v| i64::from(*v))
}

/// Points turned from y up.
pub(super) fn turned(up: Up, points: &[Vec3]) -> Vec<Vec3> {
    points.iter().map(|p| up.from_y(*p)).collect()
}

/// Numbers of a matrix of weights that is still written: a gigabyte of floats.
const MOST_WEIGHTS: usize = 1 << 28;

/// Why no matrix of a weight of each joint for each vertex is written of a rig, where that is too much.
pub(super) fn too_many_weights(rig: &Rig) -> Option<String> {
    let (vertices, joints) = (rig.weights().rows(), rig.skeleton().len());
    let why = "the format has a weight of each joint for each vertex, so";
    (vertices.saturating_mul(joints) > MOST_WEIGHTS)
        .then(|| format!("{vertices} vertices and {joints} joints; {why} their product may be {MOST_WEIGHTS} at most"))
}

/// The weights of a vertex as a row of a dense matrix [vertices, joints].
pub(super) fn dense_row<T: Copy + From<f32>>(rig: &Rig, vertex: usize, row: &mut [T]) {
    row.fill(0.0.into());
    for (joint, weight) in rig.weights().row(vertex) {
        row[joint.index()] = weight.into();
    }
}
