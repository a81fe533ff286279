//! A point backbone after Point Transformer V3 (Wu et al. 2024), as UniRig and SAMPart3D use it: the encoder
//! alone, all stages at full resolution, in plain libtorch ops.
//!
//! Points are put in order along space-filling curves and attend within patches of that order; the blocks
//! take the four orders by turns. Where points are is told by convolutions over occupied cells.
//!
//! Names of parameters are those of the released weights. Shapes: n points of all clouds, c channels, l
//! points of a patch, h heads.

mod block;
mod conv;
mod curves;
mod layout;
mod norm;
mod pool;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use tch::{Device, Tensor};

pub use block::Block;
pub use conv::{SubmConv, TapTensors};
pub use curves::Curve;
pub use layout::{Layout, Patches, Taps, order};
pub use pool::{Pool, Pooled, Reduce, Unpool};

use crate::layers::Linear;
use crate::params::{Role, Scope, Weights};
use norm::StemNorm;

/// Numbers of a point: position, normal, and three that are 0 (colours in the code it comes from).
pub const INPUT: usize = 9;

/// Sizes of the backbone. The default is UniRig's release.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Ptv3Config {
    /// Side of a cell, where the mesh fills the cube from -1 to 1.
    pub grid: f32,
    /// Blocks of each stage.
    pub depths: Vec<usize>,
    /// Channels of each stage.
    pub channels: Vec<usize>,
    /// Heads of each stage.
    pub heads: Vec<usize>,
    /// Points of a patch.
    pub patch: usize,
    /// Inner width of feed-forward layers over the channels.
    pub mlp_ratio: usize,
    /// Whether queries and keys are normalised, head by head.
    pub qk_norm: bool,
    /// The norm behind the stem.
    pub norm: Norm,
    /// Whether a linear map of the input passes the stem by.
    pub skip: bool,
    /// Whether the four orders are exchanged at random for each cloud: in training, and as released where it
    /// is used, too.
    pub shuffle: bool,
}

/// The norm behind the stem.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Norm {
    /// Over a point's channels: what to train with.
    #[default]
    Layer,
    /// Over points, with the statistics of the released weights. They stay as they are: a point's features
    /// then do not depend on the others of the batch.
    Batch,
}

impl Default for Ptv3Config {
    fn default() -> Self {
        Self {
            grid: 0.005,
            depths: vec![3, 3, 3, 6, 16],
            channels: vec![32, 64, 128, 256, 384],
            heads: vec![2, 4, 8, 16, 24],
            patch: 1024,
            mlp_ratio: 4,
            qk_norm: true,
            norm: Norm::default(),
            skip: true,
            shuffle: true,
        }
    }
}

impl Ptv3Config {
    /// Checks sizes and their relations.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), (&'static str, String)> {
        let stages = self.depths.len();
        if stages == 0 || self.channels.len() != stages || self.heads.len() != stages {
            let message = "depths, channels and heads must have a number for each stage, and one stage at least";
            return Err(("depths", message.into()));
        }
        if self.depths.contains(&0) {
            return Err(("depths", "a stage has at least one block".into()));
        }
        let odd = |(c, h): &(&usize, &usize)| **h == 0 || **c == 0 || *c % *h != 0;
        if let Some((c, h)) = self.channels.iter().zip(&self.heads).find(odd) {
            return Err(("channels", format!("{c} channels for {h} heads: give a multiple")));
        }
        // Meshes lie in a cube of side 2: finer cells than can be counted lump its far end together, larger ones all of it.
        if !(1e-4..=1.0).contains(&self.grid) {
            return Err(("grid", format!("grid = {:?} must lie in [0.0001, 1]", self.grid)));
        }
        if self.patch == 0 || self.mlp_ratio == 0 {
            return Err(("patch", "patch and mlp_ratio must be at least 1".into()));
        }
        Ok(())
    }

    /// Channels that come out.
    pub fn output(&self) -> usize {
        self.channels.last().copied().unwrap_or(0)
    }
}

/// A layout on a device, with the orders in the turn in which blocks take them.
pub struct Places {
    pub(crate) stem: TapTensors,
    pub(crate) blocks: TapTensors,
    /// By patch size, then order.
    views: BTreeMap<usize, Vec<View>>,
}

/// One order cut into patches.
pub(crate) struct View {
    /// Which points stand in the patches.
    pub take: Tensor,
    /// Where in the patches each point's result stands.
    pub back: Tensor,
    pub lengths: Vec<i64>,
}

impl Places {
    /// Of a layout. `turns` says which order comes first, second, and so on.
    pub fn new(layout: &Layout, config: &Ptv3Config, turns: [usize; 4], device: Device) -> Self {
        let patches = Patches::new(&layout.sizes, config.patch);
        let views = turns.iter().map(|&turn| {
            let order = &layout.orders[turn];
            let take: Vec<i64> = patches.pad.iter().map(|&p| order[p as usize]).collect();
            let mut back = vec![0; order.len()];
            order.iter().zip(&patches.unpad).for_each(|(&point, &place)| back[point as usize] = place);
            let of = |v: &[i64]| Tensor::from_slice(v).to_device(device);
            View { take: of(&take), back: of(&back), lengths: patches.lengths.clone() }
        });
        Self {
            stem: TapTensors::new(&layout.stem, device),
            blocks: TapTensors::new(&layout.blocks, device),
            views: [(config.patch, views.collect())].into(),
        }
    }

    /// The same tensors.
    fn shared(&self) -> Self {
        let view =
            |v: &View| View { take: v.take.shallow_clone(), back: v.back.shallow_clone(), lengths: v.lengths.clone() };
        let views = self.views.iter().map(|(&patch, views)| (patch, views.iter().map(view).collect()));
        Self { stem: self.stem.shared(), blocks: self.blocks.shared(), views: views.collect() }
    }

    pub(crate) fn view(&self, patch: usize, turn: usize) -> &View {
        &self.views[&patch][turn % Curve::ALL.len()]
    }
}

/// The backbone.
pub struct Ptv3 {
    stem: SubmConv,
    norm: StemNorm,
    skip: Option<Linear>,
    stages: Vec<(Option<Linear>, Vec<Block>)>,
}

impl Ptv3 {
    /// The config was validated; `input` numbers a point.
    pub fn new(mut at: Scope, c: &Ptv3Config, input: usize) -> Self {
        let mut embedding = at.sub("embedding");
        let first = c.channels[0];
        let mut stem_at = embedding.sub("stem");
        let stem = SubmConv::new(stem_at.sub("conv"), input, first, layout::STEM, false);
        let norm = StemNorm::new(stem_at.sub("norm"), first, c.norm);
        let skip = c.skip.then(|| Linear::new(embedding.sub("res_linear"), Role::Projection, input, first, true));
        let mut enc = at.sub("enc");
        let stages = (0..c.depths.len()).map(|s| {
            let mut stage = enc.sub(format_args!("enc{s}"));
            let widen =
                (s > 0).then(|| Linear::new(stage.sub(0), Role::Projection, c.channels[s - 1], c.channels[s], true));
            let block = |k| Block::new(stage.sub(format_args!("block{k}")), c, s, k);
            (widen, (0..c.depths[s]).map(block).collect())
        });
        let stages = stages.collect();
        Self { stem, norm, skip, stages }
    }

    /// Numbers of points [n, input] to the first stage's channels [n, c].
    pub fn embed(&self, w: &Weights, features: &Tensor, places: &Places) -> Tensor {
        let x = self.norm.forward(w, &self.stem.forward(w, features, &places.stem)).gelu("none");
        match &self.skip {
            Some(skip) => x + skip.forward(w, features),
            None => x,
        }
    }

    /// The blocks of a stage.
    pub fn blocks(&self, stage: usize) -> &[Block] {
        &self.stages[stage].1
    }

    /// Numbers of points [n, input] to features [n, c].
    pub fn forward(&self, w: &Weights, features: &Tensor, places: &Places) -> Tensor {
        let mut x = self.embed(w, &features.to_kind(w.kind()), places);
        for (widen, blocks) in &self.stages {
            if let Some(widen) = widen {
                x = widen.forward(w, &x);
            }
            for block in blocks {
                x = block.forward(w, &x, places);
            }
        }
        x
    }
}
