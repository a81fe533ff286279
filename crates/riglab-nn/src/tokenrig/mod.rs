//! TokenRig (SkinTokens 3.3): the shape as a prefix, then a skeleton's tokens, then its bones' skin codes, as one
//! sequence of a Qwen3-style decoder.
//!
//! Shapes: b rigs, p tokens of the shape, T tokens of all sequences, M places whose next token is asked, d width.

mod config;
mod layout;
mod likelihood;
mod loss;
mod place;
mod reader;
mod told;

use tch::{Device, Kind, Tensor};

pub use config::TokenRigConfig;
pub use layout::{Head, Layout};
pub use likelihood::{Choices, Likelihood};
pub use loss::{NextTokens, Parts};
pub use reader::{Joints as JointsOf, Reader};
pub use told::{GEOMETRY, JointTold};

use crate::decoder::{Cache, Packed, Qwen};
use crate::embed::{EmbedConfig, EmbedKind, Embedding};
use crate::fsq_cvae::FRAME_SIZES;
use crate::layers::{Linear, RmsNorm};
use crate::params::{Init, ParamId, Role, Scope, Weights};
use crate::perceiver::Perceiver;
use place::{Place, Places, Walk};

/// eps of the norm after the shape's projection: the f32 epsilon, as released.
const PREFIX_EPS: f64 = f32::EPSILON as f64;
/// Octaves with which joints are told.
const OCTAVES: usize = 6;
/// Smaller shares of the surface are told as this one.
const LEAST_SHARE: f64 = 1e-6;

/// The network, by the names of its released weights.
pub struct TokenRig {
    shape: Perceiver,
    to_decoder: Linear,
    norm: RmsNorm,
    decoder: Qwen,
    levels: Option<Levels>,
    joints: Option<Joints>,
    places: Option<Places>,
    layout: Layout,
    scored_at_once: i64,
}

/// Tables of [`Head::Levels`], each [Σ levels (+ 1), d].
struct Levels {
    /// What a read code adds up from.
    read: ParamId,
    /// What scores levels; the last row scores a bone that moves nothing.
    score: ParamId,
    /// What a drawn level adds for those after it.
    chain: ParamId,
}

/// What tells a code's joint.
struct Joints {
    embedding: Embedding,
    linear: Linear,
    region: bool,
    /// Numbers that tell a rule's codes; 0 where none are told.
    rule: usize,
    slots: i64,
}

/// Sequences as the network reads them.
pub struct Sequences<'a> {
    /// Ids of all, one after another, [T].
    pub ids: &'a Tensor,
    /// How many of each.
    pub lengths: &'a [i64],
    /// For [`TokenRigConfig::tell_joint`], [T, [`TokenRigConfig::told`]]: of each place whose next token is a code, what it
    /// is told ([`JointTold::at`]); else 0. Without [`TokenRigConfig::tell_region`] what is near a joint's bones is not
    /// read.
    pub told: Option<&'a Tensor>,
}

impl TokenRig {
    /// `slots`: codes of a bone. The config was validated.
    pub fn new(mut at: Scope, c: &TokenRigConfig, layout: &Layout, slots: usize) -> Self {
        let (d, std) = (c.decoder.width, c.decoder.init_std);
        let shape = Perceiver::new(at.sub("mesh_encoder").sub("encoder"), &c.shape);
        let mut proj = at.sub("output_proj");
        let to_decoder = Linear::new(proj.sub(0), Role::Projection, c.shape.width, d, true);
        let norm = RmsNorm::new(proj.sub(1), d, PREFIX_EPS);
        let rows = match c.head {
            // As released: empty bones are of the other head alone.
            Head::Flat => layout.end() + 1,
            Head::Levels => layout.skeleton() + 2,
        };
        let decoder = Qwen::new(at.sub("transformer").sub("model"), &c.decoder, rows as usize);
        let levels = (c.head == Head::Levels).then(|| {
            let all = layout.offsets().1;
            let mut at = at.sub("skin");
            let mut table = |name: &str, rows: i64| {
                at.sub(name).add("weight", Role::Embedding, &[rows, d as i64], Init::Normal { std })
            };
            Levels { read: table("read", all), score: table("score", all + 1), chain: table("chain", all) }
        });
        let joints = c.tell_joint.then(|| {
            let kind =
                EmbedConfig { kind: EmbedKind::Fourier, frequencies: OCTAVES, base: std::f64::consts::FRAC_PI_2 };
            let embedding = Embedding::new(&kind);
            let points = if c.tell_region { 4 * embedding.width() + 2 } else { 2 * embedding.width() };
            let rule = if c.tell_rule { told::rule(layout, slots) } else { 0 };
            // And those of the code that follows once more.
            let again = if c.tell_rule { layout.levels().len() } else { 0 };
            let linear = Linear::plain(at.sub("joint"), Role::Projection, points + rule + again + slots, d, std);
            Joints { embedding, linear, region: c.tell_region, rule, slots: slots as i64 }
        });
        let places = c.tell_place.then(|| Places::new(at.sub("place"), d, std));
        let (layout, scored_at_once) = (layout.clone(), c.scored_at_once as i64);
        Self { shape, to_decoder, norm, decoder, levels, joints, places, layout, scored_at_once }
    }

    /// The ids.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// The decoder.
    pub fn decoder(&self) -> &Qwen {
        &self.decoder
    }

    /// Points with normals [b, n, 6] and those picked [b, p] to the prefix [b, p, d].
    pub fn condition(&self, w: &Weights, cloud: &Tensor, picks: &Tensor) -> Tensor {
        let shape = self.shape.forward(w, cloud, picks);
        self.norm.forward(w, &self.to_decoder.forward(w, &shape))
    }

    /// Ids [..] to vectors [.., d].
    pub fn embed(&self, w: &Weights, ids: &Tensor) -> Tensor {
        let Some(levels) = &self.levels else { return self.decoder.embed(w, ids) };
        let (first, codes) = (self.layout.skeleton(), self.layout.codes());
        // The rows of the end and of empty bones follow those of the skeleton.
        let plain = ids.where_self(&ids.lt(first), &(ids - codes).clamp_min(first)).clamp_max(first + 1);
        let is_code = ids.ge(first).logical_and(&ids.lt(first + codes));
        let sum = Tensor::embedding(&w[levels.read], &self.rows_of(ids), -1, false, false);
        let sum = sum.sum_dim_intlist(-2, false, None::<Kind>);
        let plain = self.decoder.embed(w, &plain);
        sum.where_self(&is_code.unsqueeze(-1), &plain)
    }

    /// The rows of a code's levels in the tables, [.., axes]; any rows for what is no code.
    fn rows_of(&self, ids: &Tensor) -> Tensor {
        let codes = (ids - self.layout.skeleton()).clamp(0, self.layout.codes() - 1);
        let (mut basis, mut parts) = (1, Vec::new());
        for (at, l) in self.layout.offsets().0.into_iter().zip(self.layout.levels()) {
            parts.push(codes.divide_scalar_mode(basis, "floor").remainder(*l) + at);
            basis *= l;
        }
        Tensor::stack(&parts, -1)
    }

    /// What telling joints adds, [.., d]; told as [`Sequences::told`].
    fn tell(&self, w: &Weights, told: &Tensor) -> Option<Tensor> {
        let joints = self.joints.as_ref()?;
        let slot = told.select(-1, GEOMETRY as i64).to_kind(Kind::Int64);
        let numbers = Tensor::arange_start(1, joints.slots + 1, (Kind::Int64, told.device()));
        let slots = slot.unsqueeze(-1).eq_tensor(&numbers).to_kind(told.kind());
        let embedded = |x: &Tensor| joints.embedding.forward(x);
        let part = |at: i64| told.narrow(-1, at, 3);
        let mut parts = vec![embedded(&part(0)), embedded(&part(3))];
        if joints.region {
            let (small, large) = FRAME_SIZES;
            // As the size of a frame is told, from -1 to 1.
            let size = (part(9).clamp(small, large) / small).log() * (2.0 / (large / small).ln()) - 1.0;
            let share = told.narrow(-1, 12, 1).clamp_min(LEAST_SHARE).log() / 5.0 + 1.0;
            parts.extend([embedded(&part(6)), embedded(&size), share, told.narrow(-1, 13, 1)]);
        }
        if joints.rule > 0 {
            let rule = told.narrow(-1, GEOMETRY as i64 + 1, joints.rule as i64);
            let codes = rule.narrow(-1, 0, joints.rule as i64 - 1).unflatten(-1, [joints.slots, -1]);
            let own = (codes * slots.unsqueeze(-1)).sum_dim_intlist(-2, false, None::<Kind>);
            parts.extend([rule, own]);
        }
        parts.push(slots);
        let features = Tensor::cat(&parts, -1) * slot.gt(0).unsqueeze(-1).to_kind(told.kind());
        Some(joints.linear.forward(w, &features.to_kind(w.kind())))
    }

    /// Vectors [M, d] of the places before each token but the first of every sequence, in their order.
    /// `prefix` [b, p, d].
    pub fn forward(&self, w: &Weights, prefix: &Tensor, sequences: &Sequences, training: bool) -> Tensor {
        let p = prefix.size()[1];
        let tokens = self.tokens(w, sequences).split_with_sizes(sequences.lengths, 0);
        let mut parts = Vec::with_capacity(2 * tokens.len());
        for (shape, tokens) in prefix.unbind(0).into_iter().zip(tokens) {
            parts.extend([shape, tokens]);
        }
        let packed = Packed::new(sequences.lengths.iter().map(|n| n + p).collect());
        let out = self.decoder.forward(w, &Tensor::cat(&parts, 0), &packed, training);
        // Only what is scored goes through the heads.
        let asked = packed.apart(&out).into_iter().zip(sequences.lengths).map(|(rows, n)| rows.narrow(0, p, n - 1));
        Tensor::cat(&asked.collect::<Vec<_>>(), 0)
    }

    /// As [`Self::forward`] without what training adds, each sequence behind the prefix [b, p, d] that `of` names, which is
    /// read once for all of them.
    pub fn forward_behind(&self, w: &Weights, prefix: &Tensor, of: &[usize], sequences: &Sequences) -> Tensor {
        let (b, p, d) = prefix.size3().expect("three axes");
        let packed = Packed::behind(b as usize, p, of, sequences.lengths);
        let x = Tensor::cat(&[prefix.reshape([b * p, d]), self.tokens(w, sequences)], 0);
        let out = self.decoder.forward(w, &x, &packed, false);
        let own = packed.apart(&out).into_iter().skip(b as usize).zip(sequences.lengths);
        Tensor::cat(&own.map(|(rows, n)| rows.narrow(0, 0, n - 1)).collect::<Vec<_>>(), 0)
    }

    /// Vectors [T, d] of the tokens of sequences, with what they are told.
    fn tokens(&self, w: &Weights, sequences: &Sequences) -> Tensor {
        let mut tokens = self.embed(w, sequences.ids);
        if let Some(places) = &self.places {
            let ids = Vec::<i64>::try_from(sequences.ids.to_device(Device::Cpu)).expect("ids are whole numbers");
            let (mut told, mut left) = (Vec::with_capacity(ids.len()), &ids[..]);
            for &length in sequences.lengths {
                let (own, rest) = left.split_at(length as usize);
                let mut walk = Some(Walk::default());
                told.extend(own.iter().map(|&id| self.walked(&mut walk, id)));
                left = rest;
            }
            tokens += places.tell(w, &told, &[ids.len() as i64]);
        }
        match sequences.told.and_then(|told| self.tell(w, told)) {
            Some(more) => tokens + more,
            None => tokens,
        }
    }

    /// What is told of the place after an id; of no place once the skeleton has ended.
    fn walked(&self, walk: &mut Option<Walk>, id: i64) -> Place {
        if id >= self.layout.skeleton() {
            *walk = None;
        }
        walk.as_mut().map_or_else(Place::default, |walk| walk.take(id, self.layout.bins()))
    }

    /// A cache that has read the prefix [b, p, d], with room for so many tokens after it.
    pub fn start(&self, w: &Weights, prefix: &Tensor, tokens: i64) -> Cache {
        let size = prefix.size();
        let mut cache = self.decoder.cache(w, size[0], size[1] + tokens);
        let _ = self.decoder.read(w, prefix, &mut cache);
        cache
    }
}
