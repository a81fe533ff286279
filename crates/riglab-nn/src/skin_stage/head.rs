//! From features of points and bones to weights.

use tch::{Kind, Tensor};

use super::SkinModelConfig;
use super::block::Mapped;
use crate::layers::{LayerNorm, Linear};
use crate::params::{Role, Scope, Weights};

/// softmax(Q Kᵀ / √F) over the bones for each head (UniRig 4.2, E_W), beside what is told of each pair of point and
/// bone, through a network to a logit.
pub struct Head {
    q: Linear,
    k: Linear,
    attention_norm: LayerNorm,
    pair: Linear,
    pair_norm: LayerNorm,
    joined: Mapped,
    layers: Vec<Mapped>,
    out: Linear,
    /// The extension `pair_width`.
    past: Option<(Mapped, Linear)>,
    heads: i64,
}

impl Head {
    /// The config was validated.
    pub fn new(mut at: Scope, c: &SkinModelConfig) -> Self {
        let (width, heads) = (c.width, c.heads);
        let mut project = |name: &str| Linear::new(at.sub(name), Role::Attention, width, width * heads, true);
        let (q, k) = (project("qmesh"), project("kmesh"));
        let mut deep = at.sub("skinweight_pred");
        let layers = (0..c.mlp_layers)
            .map(|i| Mapped::new(deep.sub("net"), 3 * i, if i == 0 { heads + c.pair_width } else { c.mlp }, c.mlp))
            .collect();
        let out = Linear::new(deep.sub("net").sub(3 * c.mlp_layers), Role::Projection, c.mlp, 1, true);
        let mut past = at.sub("pair_past");
        let past = (c.pair_width > 0).then(|| {
            let skip = Linear::new(past.sub("skip"), Role::Projection, c.pair, 1, false);
            (Mapped::new(past.sub("net"), 0, c.pair, c.pair_width), skip)
        });
        Self {
            past,
            q,
            k,
            layers,
            out,
            attention_norm: LayerNorm::new(at.sub("attn_skin_norm"), heads),
            pair: Linear::new(at.sub("voxel_skin_embed"), Role::Projection, c.pair, heads, true),
            pair_norm: LayerNorm::new(at.sub("voxel_skin_norm"), heads),
            joined: Mapped::new(at.sub("downscale"), 0, 2 * heads, heads),
            heads: heads as i64,
        }
    }

    /// Shares of every head, [b, n, j, h], of points [b, n, d] in bones [b, j, d]: each head sums to 1 over bones.
    pub fn attention(&self, w: &Weights, points: &Tensor, bones: &Tensor) -> Tensor {
        let apart = |x: Tensor| {
            let (b, t, hd) = x.size3().expect("three axes");
            x.view([b, t, self.heads, hd / self.heads]).transpose(1, 2)
        };
        let (q, k) = (apart(self.q.forward(w, points)), apart(self.k.forward(w, bones)));
        let scale = 1.0 / (q.size()[3] as f64).sqrt();
        (q * scale).matmul(&k.transpose(-2, -1)).softmax(-1, None::<Kind>).permute([0, 2, 3, 1])
    }

    /// Logits [b, n, j] of points [b, n, d] and bones [b, j, d], with what is told of each pair [b, n, j, p].
    pub fn logits(&self, w: &Weights, points: &Tensor, bones: &Tensor, pairs: &Tensor) -> Tensor {
        let attention = self.attention_norm.forward(w, &self.attention(w, points, bones));
        let pairs = pairs.to_kind(w.kind());
        let told = self.pair_norm.forward(w, &self.pair.forward(w, &pairs));
        let mut x = self.joined.forward(w, &Tensor::cat(&[attention, told], -1));
        if let Some((layer, _)) = &self.past {
            x = Tensor::cat(&[x, layer.forward(w, &pairs)], -1);
        }
        let x = self.layers.iter().fold(x, |x, layer| layer.forward(w, &x));
        let mut logits = self.out.forward(w, &x);
        if let Some((_, skip)) = &self.past {
            logits += skip.forward(w, &pairs);
        }
        logits.squeeze_dim(-1).to_kind(wide(w))
    }
}

/// Losses and metrics see at least f32.
fn wide(w: &Weights) -> Kind {
    if w.kind() == Kind::Double { Kind::Double } else { Kind::Float }
}
