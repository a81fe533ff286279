//! Animations.

use super::{Contents, Left, Places};
use crate::gltf::accessor::Accessors;
use crate::gltf::clips::{Motions, Path, Track};
use crate::gltf::document;

/// A clip.
#[derive(Debug)]
pub(crate) struct Motion {
    pub(crate) name: String,
    pub(crate) moves: Vec<Move>,
}

/// What moves.
#[derive(Debug)]
pub(crate) enum Move {
    /// A part of a node's place.
    Node(usize, Track),
    /// The shapes of the mesh of a node, each of which has a track of one number.
    Shapes(usize, Vec<Track>),
}

/// The clips of a document; `number` gives the place of its nodes among those of the contents, whose meshes are there already.
/// Channels that cannot be read are counted.
pub(super) fn read(
    json: &[u8],
    places: &Places<'_>,
    accessors: &Accessors<'_>,
    number: &[usize],
    contents: &mut Contents,
) -> Vec<Motion> {
    let Ok(motions) = serde_json::from_slice::<Motions>(document::body(json)) else { return Vec::new() };
    let mut left = |what| *Left::entry(&mut contents.left, what).or_default() += 1;
    let mut clips = Vec::new();
    for (at, animation) in motions.animations.into_iter().enumerate() {
        let mut moves = Vec::new();
        for channel in &animation.channels {
            let sampler = animation.samplers.get(channel.sampler);
            let Some((node, sampler)) = channel.target.node.filter(|node| *node < places.nodes.len()).zip(sampler)
            else {
                left("animation channel of something else than nodes");
                continue;
            };
            let own = number[node];
            let shapes = contents.nodes[own].mesh.map_or(0, |mesh| contents.meshes[mesh].shapes.len());
            let found = match Path::of(&channel.target.path) {
                Some(path) => Track::read(sampler, path, accessors).ok().map(|track| Move::Node(own, track)),
                None if channel.target.path == "weights" && shapes > 0 => {
                    Track::of_shapes(sampler, shapes, accessors).ok().map(|tracks| Move::Shapes(own, tracks))
                }
                None => None,
            };
            match found {
                Some(found) => moves.push(found),
                None => left("animation channel that could not be read"),
            }
        }
        let name = if animation.name.is_empty() { format!("animation {at}") } else { animation.name };
        if !moves.is_empty() {
            clips.push(Motion { name, moves });
        }
    }
    clips
}
