//! Articulation-XL's npz: a pickled list of dictionaries, keys as in the released data.

use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::Path;

use riglab_core::{Asset, Bounds, Rig, Similarity};
use riglab_files::Unfinished;

use super::WriteNote;
use super::filling::{Begin, Fault, Fills};
use super::npz::{self, Npz, corners, f16s, f32s, i64s};
use super::pickle::Pickle;
use super::surface;
use super::target::Writes;

/// Points of the sampled surface, as the format has it.
const POINTS: usize = 8192;

/// Their largest coordinate.
pub(super) const REACH: f32 = 0.9995;

/// The largest coordinate of vertices.
const HALF: f32 = 0.5;

/// Articulation-XL's npz.
pub(super) struct ArticulationXl;

impl Writes for ArticulationXl {
    fn name(&self) -> &'static str {
        "articulation-xl"
    }

    fn suffix(&self) -> &'static str {
        ".npz"
    }

    /// Others are npz, too.
    fn is_told_by(&self, _: &str) -> bool {
        false
    }

    fn filled(&self) -> Option<Begin> {
        Some(|file, path| Ok(Box::new(List::begin(file, path)?)))
    }

    fn half_cube(&self) -> Option<f32> {
        Some(HALF)
    }

    fn is_at(&self, _: &Path, start: &[u8]) -> bool {
        start.starts_with(b"PK")
    }

    fn is_own(&self, path: &Path, _: &[u8]) -> bool {
        npz::is_own(path)
    }
}

/// A list that is being filled. How long it is stands before its members, which wait in a file of their own until then.
struct List {
    file: File,
    members: BufWriter<File>,
    /// Takes that file away in the end.
    _waiting: Unfinished,
}

impl List {
    fn begin(file: File, path: &Path) -> io::Result<Self> {
        let (members, waiting) = Unfinished::beside(path)?;
        Ok(Self { file, members: BufWriter::new(members), _waiting: waiting })
    }
}

impl Fills for List {
    fn add(&mut self, asset: &Asset, _: &mut Vec<WriteNote>) -> Result<(), Fault> {
        let mut member = Pickle::default();
        dictionary(asset, &mut member);
        Ok(self.members.write_all(&member.0)?)
    }

    fn end(self: Box<Self>, count: usize) -> Result<File, Fault> {
        let mut members = self.members.into_inner().map_err(io::IntoInnerError::into_error)?;
        members.seek(SeekFrom::Start(0))?;
        let (mut before, mut after, shape) = (Pickle::new(3), Pickle::default(), [count]);
        before.begin_objects(&shape);
        after.end_objects();
        let mut npz = Npz::in_file(self.file, true);
        let mut out = npz.begin("arr_0.npy")?;
        out.write_all(&npz::head("|O", &shape))?;
        out.write_all(&before.0)?;
        io::copy(&mut members, &mut out)?;
        out.write_all(&after.end())?;
        Ok(npz.close()?)
    }
}

fn dictionary(asset: &Asset, out: &mut Pickle) {
    let rig = &asset.rig;
    let (mesh, skeleton) = (rig.mesh(), rig.skeleton());
    let (vertices, joints) = (mesh.positions().len(), skeleton.len());
    let bones: Vec<i64> =
        skeleton.ids().filter_map(|j| Some([skeleton.parent(j)?.0.into(), i64::from(j.0)])).flatten().collect();
    let normals = mesh.vertex_normals();
    let weights = rig.weights();
    let row = |v: usize| weights.row(v).map(move |_| v as i32);
    let rows: Vec<u8> = (0..vertices).flat_map(row).flat_map(i32::to_le_bytes).collect();
    let columns: Vec<u8> = weights.joints().iter().flat_map(|j| i32::from(*j).to_le_bytes()).collect();
    let count = [weights.nonzero()];
    out.op(b"}(");
    out.text("vertices").array("f4", &[vertices, 3], &f32s(mesh.positions().as_flattened()));
    out.text("faces").array("i8", &[mesh.triangles().len(), 3], &i64s(corners(rig)));
    out.text("normals").array("f4", &[vertices, 3], &f32s(normals.as_flattened()));
    out.text("joints").array("f4", &[joints, 3], &f32s(skeleton.heads().as_flattened()));
    out.text("bones").array("i8", &[bones.len() / 2, 2], &i64s(bones.iter().copied()));
    out.text("root_index").int(0);
    out.text("uuid").text(&asset.name);
    out.text("pc_w_norm").array("f2", &[POINTS, 6], &f16s(&cloud(rig, HALF)));
    out.text("joint_names").op(b"](");
    for name in skeleton.names() {
        out.text(name);
    }
    out.op(b"e");
    out.text("skinning_weights_value").array("f4", &count, &f32s(weights.weights()));
    out.text("skinning_weights_row").array("i4", &count, &rows);
    out.text("skinning_weights_col").array("i4", &count, &columns);
    out.text("skinning_weights_shape").ints(&[vertices, joints]);
    out.op(b"u");
}

/// Points with normals, moved and scaled into their own cube, as the format has them: by what `half`, half a side of the cube
/// of vertices, says where these fill theirs, so that both go by one map.
pub(super) fn cloud(rig: &Rig, half: f32) -> Vec<f32> {
    let mut points = surface::points(rig.mesh(), POINTS);
    let own = || Bounds::of(points.iter().map(|p| p.position)).map(Similarity::into_cube);
    let unit = if fills(rig, half) { Some(Similarity { scale: 1.0 / half, shift: [0.0; 3] }) } else { own() };
    if let Some(map) = unit {
        points.iter_mut().for_each(|p| p.position = map.apply(p.position).map(|x| REACH * x));
    }
    surface::six(&points)
}

/// Whether a rig fills a cube about the origin, but for rounding.
fn fills(rig: &Rig, half: f32) -> bool {
    let bounds = rig.bounds();
    let longest = bounds.size().into_iter().fold(0.0f32, f32::max);
    let off = bounds.center().into_iter().fold((longest - 2.0 * half).abs(), |most, x| most.max(x.abs()));
    off <= 1e-5 * half
}
