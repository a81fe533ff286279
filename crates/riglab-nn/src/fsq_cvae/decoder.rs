//! The decoder: from a bone's tokens and the shape to a logit at every point asked.

use tch::{Kind, Tensor};

use super::config::FsqCvaeConfig;
use super::frame::{self, Frame};
use crate::layers::{Block, BlockConfig, Context, LayerNorm, Linear};
use crate::params::{Role, Scope, Weights};

/// Numbers per bone: head, tail, length.
pub const BONE_FEATURES: usize = 7;
/// Numbers per bone and point: how the point lies to the bone and its rivals.
pub const BONE_POINT_FEATURES: usize = 10;
/// Numbers per bone that tell its region, with the extension `prior`: centre and deviation.
pub const REGION: usize = 6;
/// Numbers per bone and point that the extension `prior` adds.
pub const PRIOR: usize = 7;

/// What the decoder is told of the bones, with the extension `bone_geometry`.
pub struct BoneGeometry {
    /// [m, [`BONE_FEATURES`]], with a prior followed by [`REGION`].
    pub bones: Tensor,
    /// [m, p, [`BONE_POINT_FEATURES`]], with a prior followed by [`PRIOR`].
    pub points: Tensor,
}

/// Bones as the decoder has read them: what any points are then asked of.
pub struct ReadBones {
    /// [m, t, d]
    tokens: Tensor,
    /// [r, s, d]
    cond: Tensor,
    /// In which points are seen.
    pub(super) frame: Option<Frame>,
    /// In which they are seen, too.
    pub(super) region: Option<Frame>,
}

/// Self-attention over tokens, then points attend to them.
pub struct Decoder {
    blocks: Vec<Block>,
    concat: bool,
    proj_query: Linear,
    shape_points: Vec<Block>,
    points: Vec<Block>,
    norm_out: LayerNorm,
    proj_out: Linear,
    dot: Option<Linear>,
    bone_token: Option<Linear>,
    bone_points: Option<Linear>,
    frame_tokens: Option<Linear>,
    frame_points: Option<Linear>,
    region_points: Option<Linear>,
}

impl Decoder {
    /// `input`: features of a point.
    pub fn new(mut at: Scope, c: &FsqCvaeConfig, input: usize) -> Self {
        let width = c.decoder_width;
        let x = &c.extensions;
        let block =
            BlockConfig { width, context_width: width, heads: c.heads, mlp_ratio: c.mlp_ratio, split: c.head_split };
        let point_block =
            BlockConfig { mlp_ratio: if x.point_mlp_ratio > 0.0 { x.point_mlp_ratio } else { c.mlp_ratio }, ..block };
        let own = if x.cross_condition { Context::Both } else { Context::Itself };
        let std = 0.25 / (width as f64).sqrt();
        Self {
            blocks: (0..c.decoder_layers).map(|i| Block::new(at.sub("blocks").sub(i), block, own)).collect(),
            concat: !x.cross_condition,
            proj_query: Linear::normal(at.sub("proj_query"), Role::Projection, input, width, std, 0.0),
            shape_points: (0..x.shape_point_layers)
                .map(|i| Block::new(at.sub("shape_points").sub(i), block, Context::Other))
                .collect(),
            points: (0..x.point_layers)
                .map(|i| Block::new(at.sub("blocks").sub(c.decoder_layers + i), point_block, Context::Other))
                .collect(),
            norm_out: LayerNorm::new(at.sub("norm_out"), width),
            proj_out: Linear::normal(at.sub("proj_out"), Role::Projection, width, 1, std, x.logit_bias),
            dot: x.dot_head.then(|| Linear::normal(at.sub("dot"), Role::Projection, width, width, std, 0.0)),
            bone_token: x
                .bone_geometry
                .then(|| Linear::new(at.sub("bone_token"), Role::Projection, x.bone_features(), width, true)),
            bone_points: x
                .bone_geometry
                .then(|| Linear::new(at.sub("bone_points"), Role::Projection, x.point_features(), width, true)),
            frame_tokens: x
                .framed()
                .then(|| Linear::new(at.sub("frame_tokens"), Role::Projection, frame::TOKEN, width, true)),
            frame_points: x
                .framed()
                .then(|| Linear::new(at.sub("frame_points"), Role::Projection, frame::POINT, width, true)),
            region_points: x
                .framed_twice()
                .then(|| Linear::new(at.sub("region_points"), Role::Projection, frame::POINT, width, true)),
        }
    }

    /// Reads `z` [m, k, d] and `cond` [r, s, d], the bones' and the rigs' tokens in decoder width; rig i owns the bones
    /// from i m / r on. `frame` and `region`: in which points will be seen; `bones`: [`BoneGeometry::bones`].
    pub fn read(
        &self,
        w: &Weights,
        z: &Tensor,
        cond: Tensor,
        [frame, region]: [Option<Frame>; 2],
        bones: Option<&Tensor>,
    ) -> ReadBones {
        let m = z.size()[0];
        let mut tokens = match (&self.frame_tokens, &frame) {
            (Some(layer), Some(frame)) => z + layer.forward(w, &frame.token_features().to_kind(w.kind())),
            _ => z.shallow_clone(),
        };
        if let (Some(layer), Some(bones)) = (&self.bone_token, bones) {
            tokens = Tensor::cat(&[tokens, layer.forward(w, &bones.to_kind(w.kind())).unsqueeze(1)], 1);
        }
        if self.concat {
            tokens = Tensor::cat(&[tokens, per_bone(&cond, m)], 1);
        }
        for block in &self.blocks {
            tokens = block.read(w, &tokens, (!self.concat).then_some(&cond));
        }
        ReadBones { tokens, cond, frame, region }
    }

    /// Logits [m, p] of m bones at p points each. `points` are positions and more with their features: [m, p, c] for
    /// points of each bone's own, [r, p, c] for points that all bones of a rig share. `beside`:
    /// [`BoneGeometry::points`].
    pub fn ask(
        &self,
        w: &Weights,
        ReadBones { tokens, cond, frame, region }: &ReadBones,
        (points, features): (&Tensor, &Tensor),
        beside: Option<&Tensor>,
    ) -> Tensor {
        let m = tokens.size()[0];
        let mut x = self.proj_query.forward(w, features);
        for block in &self.shape_points {
            x = block.read(w, &x, Some(cond));
        }
        if let (Some(layer), Some(beside)) = (&self.bone_points, beside) {
            x = per_bone(&x, m) + layer.forward(w, &beside.to_kind(w.kind()));
        }
        for seen_in in [(&self.frame_points, frame), (&self.region_points, region)] {
            if let (Some(layer), Some(frame)) = seen_in {
                let seen = frame.point_features(&per_bone(&points.narrow(-1, 0, 3), m));
                x = per_bone(&x, m) + layer.forward(w, &seen.to_kind(w.kind()));
            }
        }
        for block in &self.points {
            x = block.read(w, &x, Some(tokens));
        }
        let x = self.norm_out.forward(w, &x);
        let logits = self.proj_out.forward(w, &x).squeeze_dim(-1).to_kind(float(w));
        match &self.dot {
            None => logits,
            Some(layer) => {
                let g = layer.forward(w, &tokens.mean_dim([1i64].as_slice(), false, None::<Kind>));
                logits + x.matmul(&g.unsqueeze(-1)).squeeze_dim(-1).to_kind(float(w))
            }
        }
    }
}

/// [r, t, d] to [m, t, d]: what a rig's bones share, for each of them.
fn per_bone(x: &Tensor, m: i64) -> Tensor {
    let r = x.size()[0];
    if r == m { x.shallow_clone() } else { x.unsqueeze(1).expand([-1, m / r, -1, -1], false).flatten(0, 1) }
}

/// Losses and metrics see at least f32.
fn float(w: &Weights) -> Kind {
    if w.kind() == Kind::Double { Kind::Double } else { Kind::Float }
}
