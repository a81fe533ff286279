//! Animations, sampled at a steady rate: for each frame the map of every joint from rest to pose.
//!
//! A vertex v of the file goes to global(joint, t) * inverse bind * v; at rest it stands at frame *
//! inverse bind * v. So the map from rest to pose is global(joint, t) * frame⁻¹, whatever pose the
//! nodes stand in. Motions of nodes above the joints count; morph targets do not.

mod track;

use glam::{DAffine3, DQuat, DVec3};
use riglab_core::{Clip, JointMap};
use serde::Deserialize;

use super::accessor::Accessors;
use super::document::{self, Document};
use super::nodes::{Nodes, parts};
use super::placing;
use crate::{Fault, Resample, Warning};
pub(crate) use track::{Path, Track};

/// Maps of nodes of all clips of a file, frame by frame: 100 MB. Files claim long times in few bytes.
const MAX_MAPS: usize = 1 << 21;

/// The animations of a document.
#[derive(Deserialize)]
pub(super) struct Motions {
    #[serde(default)]
    pub(super) animations: Vec<Animation>,
}

#[derive(Deserialize)]
pub(super) struct Animation {
    #[serde(default)]
    pub(super) name: String,
    #[serde(default)]
    pub(super) channels: Vec<Channel>,
    #[serde(default)]
    pub(super) samplers: Vec<track::Sampler>,
}

#[derive(Deserialize)]
pub(super) struct Channel {
    pub(super) sampler: usize,
    pub(super) target: Target,
}

#[derive(Deserialize)]
pub(super) struct Target {
    pub(super) node: Option<usize>,
    pub(super) path: String,
}

/// What is needed to sample.
struct Scene<'a> {
    document: &'a Document,
    nodes: &'a Nodes,
    /// Joints of the reading, and what takes the scene at rest to the space of each.
    joints: Vec<(usize, DAffine3)>,
    /// Nodes at or above joints, parents first.
    chain: Vec<usize>,
}

/// The clips of a file that move its joints, by joint of the reading, or only the first of the name that is `wanted`. A clip
/// that cannot be read is left out, with a warning.
pub(super) fn read(
    json: &[u8],
    document: &Document,
    file: &placing::Scene<'_, '_>,
    (resample, wanted): (Resample, Option<&str>),
    warnings: &mut Vec<Warning>,
) -> Vec<Clip> {
    // The document was read already; its animations only when somebody asks for them.
    let motions: Motions = match serde_json::from_slice(document::body(json)) {
        Ok(motions) => motions,
        Err(e) => {
            warnings.push(Warning::ClipsLeftOut { clips: vec![format!("all: {e}")] });
            return Vec::new();
        }
    };
    let &placing::Scene { accessors, nodes, skins, binds } = file;
    let mut held = vec![false; nodes.len() + 1];
    for &node in nodes.order().iter().rev() {
        held[node] |= skins.joint_of_node(node).is_some();
        held[nodes.parent(node)] |= held[node];
    }
    let scene = Scene {
        document,
        nodes,
        joints: skins.joint_nodes().iter().map(|&node| (node, binds.frame(node).inverse())).collect(),
        chain: nodes.order().iter().copied().filter(|&node| held[node]).collect(),
    };
    let (mut clips, mut left_out, mut cut) = (Vec::new(), Vec::new(), Vec::new());
    let mut room = MAX_MAPS;
    for (number, animation) in motions.animations.into_iter().enumerate() {
        let name = if animation.name.is_empty() { format!("animation {number}") } else { animation.name.clone() };
        if wanted.is_some_and(|wanted| wanted != name || !clips.is_empty()) {
            continue;
        }
        match scene.clip(animation, name.clone(), &held, accessors, resample, &mut room) {
            Ok(Some((clip, whole))) => {
                cut.extend((!whole).then_some(name));
                clips.push(clip);
            }
            Ok(None) => {}
            Err(reason) => left_out.push(format!("`{name}` ({reason})")),
        }
    }
    if !cut.is_empty() {
        warnings.push(Warning::ClipsCut { clips: cut, frames: resample.frames });
    }
    if !left_out.is_empty() {
        warnings.push(Warning::ClipsLeftOut { clips: left_out });
    }
    clips
}

impl Scene<'_> {
    /// A clip, and whether it is whole; `None` for one that moves no joint.
    fn clip(
        &self,
        animation: Animation,
        name: String,
        held: &[bool],
        accessors: &Accessors<'_>,
        resample: Resample,
        room: &mut usize,
    ) -> Result<Option<(Clip, bool)>, String> {
        let mut tracks = Vec::new();
        for (number, channel) in animation.channels.iter().enumerate() {
            let Some(node) = channel.target.node else { continue };
            if node >= self.nodes.len() {
                return Err(format!("channel {number} names node {node}, there are {}", self.nodes.len()));
            }
            // Other paths, of morph targets or of extensions, move no joint.
            let Some(path) = Path::of(&channel.target.path).filter(|_| held[node]) else { continue };
            let sampler = animation.samplers.get(channel.sampler);
            let sampler = sampler.ok_or_else(|| format!("channel {number} names no sampler"))?;
            let track = Track::read(sampler, path, accessors);
            let fault = |fault: Fault| format!("channel {number}: {fault}");
            tracks.push((node, track.map_err(|e| e.either(fault, |what| format!("channel {number} {what}")))?));
        }
        if tracks.is_empty() {
            return Ok(None);
        }
        let start = tracks.iter().map(|(_, t)| t.start()).fold(f64::INFINITY, f64::min);
        let end = tracks.iter().map(|(_, t)| t.end()).fold(start, f64::max);
        // The last frame is the last whole one; a thousandth of one for rounding of key times.
        let whole = ((end - start) * f64::from(resample.rate) + 1e-3).floor();
        let frames = (whole as usize).saturating_add(1).min(resample.frames.max(1));
        let maps = frames.saturating_mul(self.chain.len());
        *room = room.checked_sub(maps).ok_or("the clips of the file are longer than is read")?;

        // Where the tracks of each node are.
        tracks.sort_by_key(|(node, _)| *node);
        let mut locals: Vec<DAffine3> = self.chain.iter().map(|&n| *self.nodes.local(n)).collect();
        let moved: Vec<(usize, std::ops::Range<usize>)> = self
            .chain
            .iter()
            .enumerate()
            .map(|(at, &node)| {
                let first = tracks.partition_point(|(n, _)| *n < node);
                (at, first..tracks.partition_point(|(n, _)| *n <= node))
            })
            .filter(|(_, own)| !own.is_empty())
            .collect();
        let mut globals = vec![DAffine3::IDENTITY; self.nodes.len() + 1];
        let mut out: Vec<JointMap> = Vec::with_capacity(frames * self.joints.len());
        for frame in 0..frames {
            let time = start + frame as f64 / f64::from(resample.rate);
            for (at, own) in &moved {
                let node = self.chain[*at];
                locals[*at] =
                    posed(parts(&self.document.nodes[node]), tracks[own.clone()].iter().map(|(_, t)| t), time);
            }
            for (&node, local) in self.chain.iter().zip(&locals) {
                globals[node] = globals[self.nodes.parent(node)] * *local;
            }
            out.extend(self.joints.iter().map(|&(node, to_joint)| {
                let map = globals[node] * to_joint;
                [map.matrix3.x_axis, map.matrix3.y_axis, map.matrix3.z_axis, map.translation]
                    .map(|v| v.as_vec3().into())
            }));
        }
        let clip = Clip::new(name, resample.rate, self.joints.len(), out).map_err(|e| e.to_string())?;
        Ok(Some((clip, whole < frames as f64)))
    }
}

/// A node's transform, given by its parts, with what some tracks say of it at a time.
fn posed<'t>(
    (mut scale, mut rotation, mut translation): (DVec3, DQuat, DVec3),
    tracks: impl Iterator<Item = &'t Track>,
    time: f64,
) -> DAffine3 {
    for track in tracks {
        let value = track.at(time);
        match track.path() {
            Path::Translation => translation = DVec3::new(value[0], value[1], value[2]),
            Path::Scale => scale = DVec3::new(value[0], value[1], value[2]),
            Path::Rotation => rotation = DQuat::from_array(value),
        }
    }
    DAffine3::from_scale_rotation_translation(scale, rotation, translation)
}
