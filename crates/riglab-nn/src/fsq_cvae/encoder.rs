//! The VecSet encoder: a few query tokens read a cloud of points (3DShape2VecSet; E_M and E_W).

use tch::Tensor;

use crate::layers::{Block, BlockConfig, Context, LayerNorm, Linear, picked};
use crate::params::{Init, ParamId, Role, Scope, Weights};

/// What the queries start from.
pub enum Queries<'a> {
    /// Points of the cloud: indices [b, t].
    Points(&'a Tensor),
    /// The first `t` learned vectors.
    Learned(i64),
}

/// One cross-attention block, then self-attention blocks.
pub struct Encoder {
    proj_in: Linear,
    learned_queries: Option<ParamId>,
    cross: Block,
    own: Vec<Block>,
    norm_out: LayerNorm,
}

impl Encoder {
    /// `learned` > 0 adds a table of that many query vectors.
    pub fn new(mut at: Scope, block: BlockConfig, input: usize, layers: usize, learned: usize) -> Self {
        let width = block.width;
        let init = Init::Normal { std: 0.02 };
        Self {
            learned_queries: (learned > 0)
                .then(|| at.add("learned_queries", Role::Embedding, &[learned as i64, width as i64], init)),
            proj_in: Linear::normal(
                at.sub("proj_in"),
                Role::Projection,
                input,
                width,
                0.25 / (width as f64).sqrt(),
                0.0,
            ),
            cross: Block::new(at.sub("blocks").sub(0), block, Context::Other),
            own: (1..=layers).map(|i| Block::new(at.sub("blocks").sub(i), block, Context::Itself)).collect(),
            norm_out: LayerNorm::new(at.sub("norm_out"), width),
        }
    }

    /// features [b, n, input] to tokens [b, t, width].
    ///
    /// Queries that are points share the input projection with the keys; if there is a table of
    /// learned vectors besides, each slot's is added.
    pub fn forward(&self, w: &Weights, features_bnc: &Tensor, queries: &Queries) -> Tensor {
        let x = self.proj_in.forward(w, features_bnc);
        let batch = x.size()[0];
        let learned = |t: i64| self.learned_queries.map(|id| w[id].narrow(0, 0, t));
        let start = match queries {
            Queries::Points(index_bt) => {
                let t = index_bt.size()[1];
                let points = picked(&x, index_bt);
                match learned(t) {
                    Some(slots) => points + slots,
                    None => points,
                }
            }
            Queries::Learned(t) => {
                let table = learned(*t).expect("an encoder with learned queries");
                table.unsqueeze(0).expand([batch, -1, -1], false)
            }
        };
        let mut tokens = self.cross.read(w, &start, Some(&x));
        for block in &self.own {
            tokens = block.read(w, &tokens, None);
        }
        self.norm_out.forward(w, &tokens)
    }
}
