//! Anymate's pt: a list of dictionaries of tensors, as torch saves it.

use std::collections::{BTreeSet, HashMap};
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use riglab_core::{Asset, Rig, Vec3};

use super::super::read::bone_parents;
use super::WriteNote;
use super::filling::{Begin, Fault, Fills};
use super::npz::{self, Npz, corners, f16s, f32s, i64s};
use super::pickle::Pickle;
use super::surface::{self, Point};
use super::tails;
use super::target::Writes;

/// Points of the sampled surface.
const POINTS: usize = 8192;

/// Cells along a side of the voxels, which span -1 to 1.
const CELLS: f32 = 64.0;

/// Bones that an i8 numbers from 0.
const MOST_BONES: usize = 128;

const FOLDER: &str = "archive";

/// Anymate's pt.
pub(super) struct Anymate;

impl Writes for Anymate {
    fn name(&self) -> &'static str {
        "anymate"
    }

    fn suffix(&self) -> &'static str {
        ".pt"
    }

    fn filled(&self) -> Option<Begin> {
        Some(|file, _| Ok(Box::new(Saved::begin(file))))
    }

    fn lacks(&self, rig: &Rig) -> Option<String> {
        joints(rig).err()
    }

    /// That of its voxels.
    fn half_cube(&self) -> Option<f32> {
        Some(1.0)
    }

    fn is_at(&self, _: &Path, start: &[u8]) -> bool {
        start.starts_with(b"PK")
    }

    fn is_own(&self, path: &Path, _: &[u8]) -> bool {
        npz::is_own(path)
    }
}

/// Numbers go into the file as they come, each tensor's into a member; what says whose they are comes last.
struct Saved {
    zip: Npz<BufWriter<File>>,
    pickle: Pickle,
    storages: usize,
}

impl Fills for Saved {
    fn lacks(&self) -> Option<&'static str> {
        Some("joint names are not in it: the format has no place for them")
    }

    fn add(&mut self, asset: &Asset, _: &mut Vec<WriteNote>) -> Result<(), Fault> {
        self.asset(asset, joints(&asset.rig).map_err(Fault::Cannot)?).map_err(Fault::Io)
    }

    fn end(self: Box<Self>, _: usize) -> Result<File, Fault> {
        let Self { mut zip, mut pickle, .. } = *self;
        pickle.op(b"e");
        zip.begin(&format!("{FOLDER}/data.pkl"))?.write_all(&pickle.end())?;
        zip.begin(&format!("{FOLDER}/byteorder"))?.write_all(b"little")?;
        zip.begin(&format!("{FOLDER}/version"))?.write_all(b"3\n")?;
        Ok(zip.close()?)
    }
}

impl Saved {
    fn begin(file: File) -> Self {
        let mut pickle = Pickle::new(2);
        pickle.op(b"](");
        Self { zip: Npz::in_file(file, false), pickle, storages: 0 }
    }

    fn asset(&mut self, asset: &Asset, joints: Joints) -> io::Result<()> {
        let rig = &asset.rig;
        let (mesh, bones) = (rig.mesh(), rig.skeleton().len());
        let Joints { ends, positions, above } = joints;
        let rows = |columns: usize, data: &[f32]| ([data.len() / columns, columns], f32s(data));
        let points = surface::points(mesh, POINTS);
        let segments: Vec<f32> =
            rig.skeleton().heads().iter().zip(&ends).flat_map(|(h, t)| [*h, *t].concat()).collect();
        let vertices: Vec<f32> =
            mesh.positions().iter().zip(mesh.vertex_normals()).flat_map(|(p, n)| [*p, n].concat()).collect();
        let on_points: Vec<_> = points.iter().map(|p| surface::weights(rig, p)).collect();
        let row = |v: usize| rig.weights().row(v).map(|(j, w)| (j.0, w)).collect::<Vec<_>>();
        let on_vertices: Vec<_> = (0..mesh.positions().len()).map(row).collect();
        let voxels = voxels(&points);

        self.pickle.op(b"}(").text("name").text(&asset.name);
        let (shape, data) = rows(6, &surface::six(&points));
        self.tensor("pc", "Float", 4, &shape, &data)?;
        self.tensor("vox", "Char", 1, &[voxels.len() / 3, 3], &voxels)?;
        self.pickle.text("bones_num").int(bones);
        let (shape, data) = rows(6, &segments);
        self.tensor("bones", "Float", 4, &shape, &data)?;
        self.pickle.text("joints_num").int(positions.len());
        let (shape, data) = rows(3, positions.as_flattened());
        self.tensor("joints", "Float", 4, &shape, &data)?;
        self.tensor("conns", "Char", 1, &[above.len()], &above)?;
        self.weights("skins", &on_points)?;
        self.weights("mesh_skins", &on_vertices)?;
        let (shape, data) = rows(6, &vertices);
        self.tensor("mesh_pc", "Float", 4, &shape, &data)?;
        self.tensor("mesh_face", "Long", 8, &[mesh.triangles().len(), 3], &i64s(corners(rig)))?;
        self.pickle.op(b"u");
        Ok(())
    }

    /// Numbers of bones, padded with -1, and their weights.
    fn weights(&mut self, prefix: &str, rows: &[Vec<(u16, f32)>]) -> io::Result<()> {
        let columns = rows.iter().map(Vec::len).max().unwrap_or(0).max(1);
        let padded =
            rows.iter().flat_map(|row| row.iter().copied().map(Some).chain(std::iter::repeat(None)).take(columns));
        let (mut indices, mut weights) = (Vec::new(), Vec::new());
        for pair in padded {
            indices.push(pair.map_or(0xff, |(joint, _)| joint as u8));
            weights.push(pair.map_or(0.0, |(_, weight)| weight));
        }
        let shape = [rows.len(), columns];
        self.tensor(&format!("{prefix}_index"), "Char", 1, &shape, &indices)?;
        self.tensor(&format!("{prefix}_weight"), "Half", 2, &shape, &f16s(&weights))
    }

    fn tensor(&mut self, key: &str, kind: &str, size: usize, shape: &[usize], data: &[u8]) -> io::Result<()> {
        let number = self.storages;
        self.storages += 1;
        self.zip.begin(&format!("{FOLDER}/data/{number}"))?.write_all(data)?;
        let strides: Vec<usize> = (0..shape.len()).map(|axis| shape[axis + 1..].iter().product()).collect();
        self.pickle.text(key).op(b"ctorch._utils\n_rebuild_tensor_v2\n((").text("storage");
        self.pickle.op(format!("ctorch\n{kind}Storage\n").as_bytes()).text(&number.to_string()).text("cpu");
        self.pickle.int(data.len() / size).op(b"tQK\0").ints(shape).ints(&strides);
        self.pickle.op(b"\x89ccollections\nOrderedDict\n)RtR");
        Ok(())
    }
}

/// The joints of the format: distinct heads and ends of bones, and the joint above each.
struct Joints {
    ends: Vec<Vec3>,
    positions: Vec<Vec3>,
    /// As i8; a root names itself.
    above: Vec<u8>,
}

fn joints(rig: &Rig) -> Result<Joints, String> {
    let skeleton = rig.skeleton();
    let (heads, ends) = (skeleton.heads(), tails::tails(skeleton));
    let key = |p: &Vec3| p.map(|x| (x + 0.0).to_bits());
    let mut number: HashMap<[u32; 3], usize> = HashMap::new();
    let mut positions = Vec::new();
    let mut find = |p: &Vec3| {
        *number.entry(key(p)).or_insert_with(|| {
            positions.push(*p);
            positions.len() - 1
        })
    };
    let starts: Vec<usize> = heads.iter().map(&mut find).collect();
    let stops: Vec<usize> = ends.iter().map(&mut find).collect();
    if positions.len() > 127 {
        return Err(format!(
            "it has {} distinct heads and ends of bones; the format numbers up to 127",
            positions.len()
        ));
    }
    // Several may be in one place, so that there are more of them than places.
    if skeleton.len() > MOST_BONES {
        return Err(format!("it has {} bones; the format numbers up to {MOST_BONES}", skeleton.len()));
    }
    let mut above: Vec<usize> = (0..positions.len()).collect();
    // The end of a bone lies below its head; the head of a bone below the end of the one above it, or
    // below its head where the two bones meet.
    for joint in skeleton.ids().rev() {
        let bone = joint.index();
        if !starts.contains(&stops[bone]) {
            above[stops[bone]] = starts[bone];
        }
        if let Some(parent) = skeleton.parent(joint).map(riglab_core::JointId::index) {
            above[starts[bone]] = if stops[parent] == starts[bone] { starts[parent] } else { stops[parent] };
        }
    }
    let named = above.iter().enumerate().map(|(joint, &p)| (p != joint).then_some(p)).collect::<Vec<_>>();
    let read = bone_parents(heads, &ends, &positions, &named);
    let wanted = skeleton.parents().iter().map(|p| p.map(riglab_core::JointId::index));
    if let Some(bone) = wanted.zip(read).position(|(wanted, read)| wanted != read) {
        let name = &skeleton.names()[bone];
        return Err(format!("joint `{name}` is where another is, and the format tells bones by their places alone"));
    }
    Ok(Joints { ends, positions, above: above.into_iter().map(|p| p as u8).collect() })
}

/// The cells that points lie in, three bytes each.
fn voxels(points: &[Point]) -> Vec<u8> {
    let cell = |p: &Point| p.position.map(|x| ((x + 1.0) * 0.5 * CELLS).clamp(0.0, CELLS - 1.0) as u8);
    points.iter().map(cell).collect::<BTreeSet<_>>().into_iter().flatten().collect()
}
