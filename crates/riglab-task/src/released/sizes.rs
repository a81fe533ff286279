//! Sizes of networks from the shapes of their tensors.
//!
//! A size that cannot be read stays as the config has it: that the tensor is missing is told later.

use std::collections::BTreeMap;

use riglab_nn::fsq_cvae::SkinQueries;
use riglab_nn::perceiver::PerceiverConfig;
use riglab_nn::skin_stage::ptv3::{Norm, Ptv3Config};

use crate::fsq_cvae::FsqCvaeTaskConfig;
use crate::tokenrig::TokenRigTaskConfig;
use crate::unirig_skeleton::SkeletonTaskConfig;
use crate::unirig_skin::SkinTaskConfig;

/// Rows of OPT's table of positions before the first.
const OPT_OFFSET: usize = 2;
/// Ids of the vocabulary with which UniRig was trained on RigNet's data, and its classes.
const RIGNET: (usize, [&str; 2]) = (266, ["rignet", "vroid"]);

/// Shapes by the networks' names.
pub(super) struct Shapes<'a>(BTreeMap<&'a str, &'a [i64]>);

impl<'a> Shapes<'a> {
    pub fn new(all: impl Iterator<Item = (&'a str, &'a [i64])>) -> Self {
        Self(all.collect())
    }

    fn has(&self, name: &str) -> bool {
        self.0.contains_key(name)
    }

    /// Sets `size` to what `of` makes of a tensor's length along an axis.
    fn take(&self, size: &mut usize, name: &str, axis: usize, of: impl Fn(usize) -> Option<usize>) {
        let length = self.0.get(name).and_then(|shape| usize::try_from(*shape.get(axis)?).ok());
        if let Some(found) = length.and_then(of).filter(|n| *n > 0) {
            *size = found;
        }
    }

    fn length(&self, size: &mut usize, name: &str, axis: usize) {
        self.take(size, name, axis, Some);
    }

    /// How many parts are numbered after this beginning of a name.
    fn count(&self, start: &str) -> Option<usize> {
        let number = |name: &&str| -> Option<usize> {
            let rest = name.strip_prefix(start)?;
            rest[..rest.find(|c: char| !c.is_ascii_digit()).unwrap_or(rest.len())].parse().ok()
        };
        // A hostile number is no count: as many parts have as many names.
        let most = self.0.keys().filter_map(number).max()?;
        (most < self.0.len()).then_some(most + 1)
    }

    fn parts(&self, size: &mut usize, start: &str) {
        if let Some(count) = self.count(start) {
            *size = count;
        }
    }
}

/// Of the numbers that tell a point with its normal, the octaves of its position.
fn octaves(length: usize) -> Option<usize> {
    let rest = length.checked_sub(6)?;
    rest.is_multiple_of(6).then_some(rest / 6)
}

fn perceiver(s: &Shapes<'_>, at: &str, c: &mut PerceiverConfig) {
    s.length(&mut c.width, &format!("{at}input_proj.weight"), 0);
    s.take(&mut c.frequencies, &format!("{at}input_proj.weight"), 1, octaves);
    s.parts(&mut c.layers, &format!("{at}self_attn.resblocks."));
    c.qkv_bias = s.has(&format!("{at}cross_attn.attn.c_q.bias"));
}

pub(super) fn skeleton(s: &Shapes<'_>, c: &mut SkeletonTaskConfig) {
    let shape = &mut c.model.shape;
    perceiver(s, "mesh_encoder.encoder.", shape);
    let (d, at) = (&mut c.model.decoder, "transformer.model.decoder.");
    let table = format!("{at}embed_tokens.weight");
    s.length(&mut d.width, &table, 1);
    s.parts(&mut d.layers, &format!("{at}layers."));
    s.length(&mut d.ffn, &format!("{at}layers.0.fc1.weight"), 0);
    s.take(&mut d.positions, &format!("{at}embed_positions.weight"), 0, |n| n.checked_sub(OPT_OFFSET));
    let mut ids = 0;
    s.length(&mut ids, &table, 0);
    if ids == RIGNET.0 {
        // That release's other sizes, which shapes do not tell.
        c.tokenizer.classes = RIGNET.1.map(String::from).to_vec();
        (shape.heads, shape.tokens) = (16, 512);
        if !c.class.is_empty() {
            c.class = RIGNET.1[0].into();
        }
    }
    c.limits.tokens = c.limits.tokens.min(d.positions.saturating_sub(shape.tokens)).max(1);
}

pub(super) fn tokenrig(s: &Shapes<'_>, c: &mut TokenRigTaskConfig) {
    perceiver(s, "mesh_encoder.encoder.", &mut c.model.shape);
    let (d, at) = (&mut c.model.decoder, "transformer.model.");
    s.length(&mut d.width, &format!("{at}embed_tokens.weight"), 1);
    s.parts(&mut d.layers, &format!("{at}layers."));
    s.length(&mut d.ffn, &format!("{at}layers.0.mlp.gate_proj.weight"), 0);
    s.length(&mut d.head_width, &format!("{at}layers.0.self_attn.q_norm.weight"), 0);
    let width = d.head_width;
    let heads = |n: usize| n.is_multiple_of(width).then_some(n / width);
    s.take(&mut d.heads, &format!("{at}layers.0.self_attn.q_proj.weight"), 0, heads);
    s.take(&mut d.kv_heads, &format!("{at}layers.0.self_attn.k_proj.weight"), 0, heads);
}

pub(super) fn fsq_cvae(s: &Shapes<'_>, c: &mut FsqCvaeTaskConfig) {
    let m = &mut c.model;
    s.length(&mut m.encoder_width, "cond_encoder.proj_in.weight", 0);
    s.take(&mut m.embed.frequencies, "cond_encoder.proj_in.weight", 1, octaves);
    s.length(&mut m.decoder_width, "decoder.proj_query.weight", 0);
    s.length(&mut m.latent, "cond_quant.weight", 0);
    // Each has one more, in which points are read or asked.
    for (layers, start) in [(&mut m.encoder_layers, "cond_encoder.blocks."), (&mut m.decoder_layers, "decoder.blocks.")]
    {
        if let Some(count) = s.count(start) {
            *layers = count - 1;
        }
    }
    let mut inner = 0;
    s.length(&mut inner, "decoder.blocks.0.ff.net.0.proj.weight", 0);
    if inner > 0 {
        m.mlp_ratio = inner as f64 / m.decoder_width as f64;
    }
    m.skin_queries = if s.has("encoder.learned_queries") { SkinQueries::Learned } else { SkinQueries::Farthest };
    s.length(&mut m.skin_tokens, "encoder.learned_queries", 0);
}

pub(super) fn skin(s: &Shapes<'_>, c: &mut SkinTaskConfig) {
    let m = &mut c.model;
    perceiver(s, "global_encoder.encoder.", &mut m.shape);
    s.length(&mut m.width, "out_proj.0.weight", 0);
    s.length(&mut m.heads, "attn_skin_norm.weight", 0);
    s.length(&mut m.mlp, "skinweight_pred.net.0.weight", 0);
    if let Some(count) = s.count("skinweight_pred.net.") {
        m.mlp_layers = (count / 3).max(1);
    }
    s.length(&mut m.pair, "voxel_skin_embed.weight", 1);
    let bones = "bone_encoder.bone_encoder.1.weight";
    s.length(&mut m.bones.embed, bones, 0);
    s.take(&mut m.bones.frequencies, bones, 1, |n| n.checked_sub(3).filter(|n| n.is_multiple_of(6)).map(|n| n / 6));
    s.parts(&mut m.bones.layers, "bone_encoder.attn.");
    s.parts(&mut m.points.layers, "mesh_bone_attn.");
    ptv3(s, &mut m.points.ptv3);
}

fn ptv3(s: &Shapes<'_>, c: &mut Ptv3Config) {
    let at = "mesh_encoder.";
    if let Some(stages) = s.count(&format!("{at}enc.enc")) {
        let sizes = (0..stages).map(|stage| {
            let (mut depth, mut channels) = (1, 1);
            s.parts(&mut depth, &format!("{at}enc.enc{stage}.block"));
            s.length(&mut channels, &format!("{at}enc.enc{stage}.block0.attn.proj.weight"), 0);
            (depth, channels)
        });
        (c.depths, c.channels) = sizes.unzip();
    }
    let first = format!("{at}enc.enc0.block0.mlp.0.fc1.weight");
    if let Some(channels) = c.channels.first().copied().filter(|n| *n > 0) {
        s.take(&mut c.mlp_ratio, &first, 0, |n| n.is_multiple_of(channels).then_some(n / channels));
    }
    c.norm = if s.has(&format!("{at}embedding.stem.norm.running_mean")) { Norm::Batch } else { Norm::Layer };
    c.skip = s.has(&format!("{at}embedding.res_linear.weight"));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_counted_and_hostile_numbers_are_not() {
        let shape: &[i64] = &[2, 3];
        let shapes = Shapes::new([("a.0.w", shape), ("a.1.w", shape), ("a.12x", shape)].into_iter());
        assert_eq!(shapes.count("b."), None);
        assert_eq!(shapes.count("a."), None);
        let shapes = Shapes::new([("a.0.w", shape), ("a.1.w", shape)].into_iter());
        assert_eq!(shapes.count("a."), Some(2));
        let mut n = 7;
        shapes.length(&mut n, "a.1.w", 1);
        assert_eq!(n, 3);
        shapes.length(&mut n, "a.2.w", 1);
        shapes.length(&mut n, "a.1.w", 2);
        assert_eq!(n, 3);
        assert_eq!((octaves(54), octaves(30), octaves(7), octaves(2)), (Some(8), Some(4), None, None));
    }
}
