//! Autodesk FBX, binary and as text, versions 3 to 8; reading is by ufbx.
//!
//! Read in this order: the scene with its nodes ([`scene`]), which nodes are joints and where they were
//! bound ([`joints`]), the meshes at rest ([`meshes`]), and, where asked for, motions ([`clips`]).
//!
//! Rest is where the skin was bound, as in glTF: a cluster's `TransformLink` is the place of its bone in the
//! world when it was bound, and that times its `Transform` the place of the mesh, whatever the pose in which
//! the file was saved. Vertices are the control points, numbered as in the file; the corners of polygons, which
//! may have normals and texture coordinates of their own, do not split them. Positions come out in metres,
//! right-handed and y up, as the axes and the unit in the file's settings say.
//!
//! Materials ([`looks`]) and blend shapes ([`shapes`]) are read where a model is to be written with its looks ([`model`]),
//! which tells what it leaves. Files that this one refers to are not opened.
//!
//! Written is a finished GLB with all that it has ([`document`]), or a rig alone ([`write`]), both by way of [`file`].

mod clips;
mod document;
mod file;
mod groups;
mod held;
mod hidden;
mod joints;
mod looks;
mod meshes;
mod model;
mod scene;
mod shapes;

use ufbx::{AllocatorOpts, ErrorType, FileFormat, IndexErrorHandling, LoadOpts, SceneRoot};

use crate::budget::Budget;
use crate::reading::Told;
use crate::{Fault, Reading, Resample};
pub use document::{FbxFault, FbxFile, FbxLeft, glb_to_fbx};
pub(crate) use file::{END, made_of};
use joints::Joints;
pub(crate) use model::{Left, Origin, Taken, counted, model};
use scene::Nodes;

/// What ufbx may allocate for a file, before and after it is linked up: so many times its bytes.
const MEMORY: usize = 10;

/// And as much as this for small ones, since arrays are compressed.
const SMALL: usize = 16 << 20;

/// Reads a file, with its motions, or the one that is `wanted`, if they are asked for.
pub(crate) fn read(bytes: &[u8], motions: Option<Resample>, wanted: Option<&str>) -> Result<Reading, Fault> {
    let scene = load(bytes, Load { motions: motions.is_some(), pictures: false })?;
    let nodes = Nodes::new(&scene);
    let mut warnings = Vec::new();
    let joints = Joints::read(&scene, &nodes, &mut warnings)?;
    let read_joints = joints.reading(&nodes, &mut warnings)?;
    let (vertex_sets, parts, left_out) =
        meshes::read(&nodes, &joints, &read_joints, &Budget::new(bytes.len()), &mut warnings)?;
    let origin = joints.origin(&nodes).as_vec3();
    let origin = if origin.is_finite() { origin.into() } else { [0.0; 3] };
    let clips = motions
        .map(|resample| clips::read(&scene, &nodes, &joints, (resample, wanted), memory(bytes), &mut warnings))
        .unwrap_or_default();
    let told = Told { skins: joints.told(&read_joints), left_out };
    Ok(Reading { joints: read_joints, vertex_sets, parts, origin, clips, told, warnings, ..Reading::default() })
}

/// What of a file is wanted beside meshes and nodes.
#[derive(Clone, Copy)]
struct Load {
    /// The keys of its animations.
    motions: bool,
    /// The pictures that it holds.
    pictures: bool,
}

/// What ufbx may allocate for a file.
fn memory(bytes: &[u8]) -> usize {
    bytes.len().saturating_mul(MEMORY).max(SMALL)
}

fn allocator(memory: usize) -> AllocatorOpts {
    AllocatorOpts {
        memory_limit: memory,
        // Else ufbx takes chunks of 16 MiB where a few KiB are wanted.
        huge_threshold: 1 << 16,
        max_chunk_size: 1 << 20,
        ..Default::default()
    }
}

/// The scene of a file's bytes.
fn load(bytes: &[u8], Load { motions, pictures }: Load) -> Result<SceneRoot, Fault> {
    let options = LoadOpts {
        temp_allocator: allocator(memory(bytes)),
        result_allocator: allocator(memory(bytes)),
        file_format: FileFormat::Fbx,
        ignore_animation: !motions,
        ignore_embedded: !pictures,
        load_external_files: false,
        skip_mesh_parts: true,
        // Numbers of what is not there: told here for vertices, of no matter elsewhere.
        index_error_handling: IndexErrorHandling::NoIndex,
        ..Default::default()
    };
    ufbx::load_memory(bytes, options).map_err(|error| {
        Fault::Fbx(match error.type_ {
            // It says no more.
            ErrorType::Unknown => "it is damaged: cut short, or with numbers out of range".into(),
            // Not `info` as well: ufbx cuts that at 256 bytes, perhaps inside a letter, and its Rust side panics.
            _ => error.description.to_string(),
        })
    })
}

/// A name short enough for a message.
fn shown(name: &str) -> String {
    name.chars().take(80).collect()
}
