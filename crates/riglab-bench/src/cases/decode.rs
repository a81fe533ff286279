//! Compressed geometry decoded, against the reference decoders in WebAssembly.
//!
//! Both sides get the same chunks from memory: what compressed primitives and buffer views of the rigs
//! hold. Each makes arrays of its own language; their sums are compared.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, Result, ensure};
use riglab_asset::{decode_draco, decode_meshopt};
use riglab_data::rigged_files;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::Context;
use crate::rounds::in_turn;
use crate::row::{Better, Row};
use crate::side;
use crate::{node, recipe};

/// Each chunk is decoded so often a round.
const TIMES: usize = 20;

/// A compressed chunk in a file of its own, and what is to be made of it.
#[derive(Clone, Serialize, Deserialize)]
struct Chunk {
    file: PathBuf,
    /// The attributes of a Draco mesh.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    draco: Option<Vec<u32>>,
    /// The extension of a meshopt view.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    meshopt: Option<Value>,
}

#[derive(Deserialize)]
struct Decoded {
    seconds: f64,
    sum: f64,
}

/// Which compression.
#[derive(Clone, Copy, PartialEq)]
pub enum Codec {
    /// `KHR_draco_mesh_compression`.
    Draco,
    /// `EXT_meshopt_compression`.
    Meshopt,
}

pub fn run(context: &mut Context, codec: Codec) -> Result<Vec<Row>> {
    let name = if codec == Codec::Draco { "decode/draco" } else { "decode/meshopt" };
    let Some(rigs) = recipe::rigs() else { return Ok(vec![Row::skipped(name, recipe::NO_RIGS)]) };
    let chunks = chunks(&rigs, codec, &context.path(&name.replace('/', "-")))?;
    if chunks.is_empty() {
        return Ok(vec![Row::skipped(name, format!("skipped: no file in {} is compressed so", rigs.display()))]);
    }
    let (mut ours, mut theirs) = (context.ours("decode")?, node::start("Node", "decode.mjs")?);
    for side in [&mut ours, &mut theirs] {
        side.ask::<Value>(&json!({"do": "load", "chunks": chunks}))?;
    }
    let ask = json!({"do": "decode", "times": TIMES});
    // The first time warms up: WebAssembly is compiled while it runs.
    let (a, b): (Decoded, Decoded) = (ours.ask(&ask)?, theirs.ask(&ask)?);
    ensure!((a.sum - b.sum).abs() <= 1e-6 * a.sum.abs(), "the sides decode other values: {} and {}", a.sum, b.sum);
    let each = |seconds: f64| 1e3 * seconds / (TIMES * chunks.len()) as f64;
    let found = in_turn(
        context.rounds(5),
        || Ok(each(ours.ask::<Decoded>(&ask)?.seconds)),
        || Ok(each(theirs.ask::<Decoded>(&ask)?.seconds)),
    )?;
    let (a, b) = found.medians();
    let note = format!("{} chunks, {}", chunks.len(), found.spread());
    Ok(vec![Row::new(name, a, b, "ms/chunk", Better::Lower).note(note)])
}

/// The compressed chunks of all rigs, written to files in `folder`.
fn chunks(rigs: &Path, codec: Codec, folder: &Path) -> Result<Vec<Chunk>> {
    std::fs::create_dir_all(folder)?;
    let mut chunks = Vec::new();
    for path in rigged_files(rigs)? {
        let bytes = std::fs::read(&path)?;
        let Some((document, data)) = parts(&bytes) else { continue };
        let found = if codec == Codec::Draco { draco(&document) } else { meshopt(&document) };
        for (view, mut chunk) in found {
            let of = |key: &str| view[key].as_u64().unwrap_or(0) as usize;
            let own = data.get(of("byteOffset")..).and_then(|d| d.get(..of("byteLength")));
            let own = own.with_context(|| format!("{}: a compressed view beyond its buffer", path.display()))?;
            chunk.file = folder.join(chunks.len().to_string());
            std::fs::write(&chunk.file, own)?;
            chunks.push(chunk);
        }
    }
    Ok(chunks)
}

/// JSON and binary chunk of a GLB.
fn parts(bytes: &[u8]) -> Option<(Value, &[u8])> {
    let length = u32::from_le_bytes(bytes.get(12..16)?.try_into().ok()?) as usize;
    let document = serde_json::from_slice(bytes.get(20..20 + length)?).ok()?;
    Some((document, bytes.get(28 + length..)?))
}

/// Buffer view and attributes of each compressed primitive: positions, joints and weights.
fn draco(document: &Value) -> Vec<(&Value, Chunk)> {
    let list = |value: &'_ Value| value.as_array().cloned().unwrap_or_default();
    let mut found = Vec::new();
    for primitive in list(&document["meshes"]).iter().flat_map(|m| list(&m["primitives"])) {
        let own = &primitive["extensions"]["KHR_draco_mesh_compression"];
        let Some(view) = own["bufferView"].as_u64() else { continue };
        let wanted = ["POSITION", "JOINTS_0", "WEIGHTS_0"].map(|name| own["attributes"][name].as_u64());
        let attributes = wanted.into_iter().flatten().map(|n| n as u32).collect();
        let chunk = Chunk { file: PathBuf::new(), draco: Some(attributes), meshopt: None };
        found.push((&document["bufferViews"][view as usize], chunk));
    }
    found
}

/// Each compressed buffer view.
fn meshopt(document: &Value) -> Vec<(&Value, Chunk)> {
    let views = document["bufferViews"].as_array().into_iter().flatten();
    let own = views.map(|view| &view["extensions"]["EXT_meshopt_compression"]).filter(|own| own.is_object());
    own.map(|own| (own, Chunk { file: PathBuf::new(), draco: None, meshopt: Some(own.clone()) })).collect()
}

#[derive(Deserialize)]
#[serde(tag = "do", rename_all = "snake_case")]
enum Request {
    Load { chunks: Vec<Chunk> },
    Decode { times: usize },
}

/// riglab's side.
pub fn serve() -> Result<()> {
    let mut loaded: Vec<(Chunk, Vec<u8>)> = Vec::new();
    side::serve(|request| match request {
        Request::Load { chunks } => {
            let read = |chunk: Chunk| Ok((chunk.clone(), std::fs::read(&chunk.file)?));
            loaded = chunks.into_iter().map(read).collect::<Result<_>>()?;
            Ok(json!(loaded.len()))
        }
        Request::Decode { times } => {
            let start = Instant::now();
            let mut sums = Vec::new();
            for _ in 0..times {
                sums = loaded.iter().map(|(chunk, bytes)| decode(chunk, bytes)).collect::<Result<_>>()?;
            }
            let seconds = start.elapsed().as_secs_f64();
            Ok(json!({"seconds": seconds, "sum": sums.iter().map(Arrays::sum).sum::<f64>()}))
        }
    })
}

/// What comes out of a chunk.
enum Arrays {
    Mesh(Vec<u32>, Vec<Vec<f32>>),
    View(Vec<u8>),
}

fn decode(chunk: &Chunk, bytes: &[u8]) -> Result<Arrays> {
    let decoded = match (&chunk.draco, &chunk.meshopt) {
        (Some(attributes), _) => decode_draco(bytes, attributes).map(|(corners, parts)| Arrays::Mesh(corners, parts)),
        (None, settings) => decode_meshopt(settings.as_ref().unwrap_or(&Value::Null), bytes).map(Arrays::View),
    };
    decoded.map_err(anyhow::Error::msg)
}

impl Arrays {
    fn sum(&self) -> f64 {
        match self {
            Self::Mesh(corners, parts) => {
                corners.iter().map(|c| f64::from(*c)).sum::<f64>()
                    + parts.iter().flatten().map(|x| f64::from(*x)).sum::<f64>()
            }
            Self::View(bytes) => bytes.iter().map(|b| f64::from(*b)).sum(),
        }
    }
}
