//! Puppeteer's HDF5: a group a sample.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use hdf5_pure::{AttrValue, Datatype, DatatypeByteOrder, Error, File, FileBuilder, FloatingPointLayout, GroupBuilder};
use riglab_core::{Asset, Rig, Skeleton};

use super::WriteNote;
use super::articulation::{REACH, cloud};
use super::filling::{Begin, Fault, Fills};
use super::npz::{corners, dense_row, f16s, too_many_weights};
use super::target::Writes;
use crate::maker::{MAKER, is_maker};

/// Joints the peer's own networks take.
const JOINTS: usize = 70;

/// Joints whose table of steps between each two is still written.
const MOST_JOINTS: usize = 4096;

/// The attribute that says who wrote a file.
const WRITER: &str = "writer";

/// Puppeteer's HDF5.
pub(super) struct PuppeteerH5;

impl Writes for PuppeteerH5 {
    fn name(&self) -> &'static str {
        "puppeteer-h5"
    }

    fn suffix(&self) -> &'static str {
        ".h5"
    }

    fn filled(&self) -> Option<Begin> {
        Some(|file, _| Ok(Box::new(Samples { builder: FileBuilder::new(), file, count: 0 })))
    }

    fn lacks(&self, rig: &Rig) -> Option<String> {
        let joints = rig.skeleton().len();
        let why = "the format has a table of each with each, so";
        let too_many = (joints > MOST_JOINTS).then(|| format!("{joints} joints; {why} {MOST_JOINTS} is the most"));
        too_many.or_else(|| too_many_weights(rig))
    }

    fn half_cube(&self) -> Option<f32> {
        Some(REACH)
    }

    fn is_at(&self, _: &Path, start: &[u8]) -> bool {
        start.starts_with(b"\x89HDF\r\n\x1a\n")
    }

    fn is_own(&self, path: &Path, _: &[u8]) -> bool {
        let writer = || File::open_streaming(path).ok()?.root().attrs().ok()?.remove(WRITER);
        matches!(writer(), Some(AttrValue::String(own)) if is_maker(own.as_bytes()))
    }
}

/// Samples that wait for the last of them: hdf5-pure writes a file when all of it is known.
struct Samples {
    builder: FileBuilder,
    file: fs::File,
    count: usize,
}

impl Fills for Samples {
    fn lacks(&self) -> Option<&'static str> {
        Some("joint names are not in it: the format has no place for them")
    }

    fn add(&mut self, asset: &Asset, notes: &mut Vec<WriteNote>) -> Result<(), Fault> {
        let joints = asset.rig.skeleton().len();
        if joints > JOINTS {
            let asset = asset.name.clone();
            WriteNote::ManyJoints { assets: 1, asset, joints, most: JOINTS }.put(notes);
        }
        if let Some(reason) = PuppeteerH5.lacks(&asset.rig) {
            return Err(Fault::Cannot(reason));
        }
        let mut group = self.builder.create_group(&format!("sample_{}", self.count));
        self.count += 1;
        sample(asset, &mut group);
        self.builder.add_group(group.finish());
        Ok(())
    }

    fn end(self: Box<Self>, count: usize) -> Result<fs::File, Fault> {
        let Self { mut builder, file, .. } = *self;
        builder.set_attr("num_samples", AttrValue::I64(count as i64));
        builder.set_attr("version", AttrValue::String("1.0".into()));
        builder.set_attr(WRITER, AttrValue::String(MAKER.into()));
        builder.finish_to(&file).map_err(|e| match e {
            Error::Io(e) => Fault::Io(e),
            e => Fault::Cannot(e.to_string()),
        })?;
        Ok(file)
    }
}

fn sample(asset: &Asset, group: &mut GroupBuilder) {
    let rig = &asset.rig;
    let (mesh, skeleton) = (rig.mesh(), rig.skeleton());
    let (vertices, joints) = (mesh.positions().len(), skeleton.len());
    let doubles = |all: &[f32]| all.iter().map(|x| f64::from(*x)).collect::<Vec<_>>();
    let bones: Vec<i64> =
        skeleton.ids().filter_map(|j| Some([skeleton.parent(j)?.0.into(), i64::from(j.0)])).flatten().collect();
    let edges = edges(rig);
    let mut skin = vec![0.0f64; vertices * joints];
    skin.chunks_exact_mut(joints).enumerate().for_each(|(vertex, row)| dense_row(rig, vertex, row));
    let mut floats = |name: &str, rows: usize, columns: usize, all: &[f64]| {
        let data = group.create_dataset(name).with_f64_data(all).with_shape(&[rows as u64, columns as u64]);
        if rows > 0 {
            data.with_chunks(&[rows_at_once(rows, columns), columns as u64]).with_deflate(4);
        }
    };
    floats("vertices", vertices, 3, &doubles(mesh.positions().as_flattened()));
    floats("joints", joints, 3, &doubles(skeleton.heads().as_flattened()));
    floats("skin", vertices, joints, &skin);
    drop(skin);
    let mut ints = |name: &str, columns: usize, all: &[i64]| {
        let rows = all.len() / columns;
        let data = group.create_dataset(name).with_i64_data(all).with_shape(&[rows as u64, columns as u64]);
        if rows > 0 {
            data.with_chunks(&[rows_at_once(rows, columns), columns as u64]).with_deflate(4);
        }
    };
    ints("bones", 2, &bones);
    ints("faces", 3, &corners(rig).collect::<Vec<_>>());
    ints("edges", 2, &edges);
    let square = [joints as u64; 2];
    group
        .create_dataset("graph_dist")
        .with_f32_data(&hops(skeleton))
        .with_shape(&square)
        .with_chunks(&square)
        .with_deflate(4);
    group.create_dataset("root_index").with_i32_data(&[0]).with_shape(&[]);
    let points = cloud(rig, REACH);
    let shape = [points.len() as u64 / 6, 6];
    group
        .create_dataset("pc_w_norm")
        .with_raw_data(half_type(), f16s(&points), points.len() as u64)
        .with_shape(&shape)
        .with_chunks(&shape)
        .with_deflate(4);
    group.create_dataset("file_name").with_vlen_strings(&[&asset.name]).with_shape(&[]);
}

/// Rows of a chunk of some 256 KB: what readers hold at a time.
fn rows_at_once(rows: usize, columns: usize) -> u64 {
    rows.min((1 << 15) / columns).max(1) as u64
}

/// Pairs of vertices that triangles connect, each once.
fn edges(rig: &Rig) -> Vec<i64> {
    let sides = |t: &[u32; 3]| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])];
    let pairs: BTreeSet<(u32, u32)> =
        rig.mesh().triangles().iter().flat_map(sides).map(|(a, b)| (a.min(b), a.max(b))).collect();
    pairs.into_iter().flat_map(|(a, b)| [i64::from(a), i64::from(b)]).collect()
}

/// Steps from each joint to each other along the tree, [joints, joints].
fn hops(skeleton: &Skeleton) -> Vec<f32> {
    let count = skeleton.len();
    let mut out = vec![0.0; count * count];
    // Parents come first: a joint is one step farther from every earlier joint than its parent is.
    for (joint, parent) in skeleton.parents().iter().enumerate() {
        let Some(parent) = parent else { continue };
        for other in 0..joint {
            let steps = out[parent.index() * count + other] + 1.0;
            out[joint * count + other] = steps;
            out[other * count + joint] = steps;
        }
    }
    out
}

/// IEEE's 16-bit float.
fn half_type() -> Datatype {
    Datatype::FloatingPoint {
        size: 2,
        byte_order: DatatypeByteOrder::LittleEndian,
        layout: FloatingPointLayout {
            bit_offset: 0,
            bit_precision: 16,
            exponent_location: 10,
            exponent_size: 5,
            mantissa_location: 0,
            mantissa_size: 10,
            exponent_bias: 15,
        },
    }
}
