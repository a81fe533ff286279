//! Keys and values of what was generated.

use tch::{Kind, Tensor};

/// Keys and values of rows that go on together, made once for the longest sequence.
pub struct Cache {
    /// Of each layer, [rows, heads, room, head width].
    layers: Vec<(Tensor, Tensor)>,
    len: i64,
}

impl Cache {
    /// Room for so many tokens.
    pub fn new(layers: usize, rows: i64, heads: i64, room: i64, width: i64, kind: Kind, device: tch::Device) -> Self {
        let empty = || Tensor::empty([rows, heads, room, width], (kind, device));
        Self { layers: (0..layers).map(|_| (empty(), empty())).collect(), len: 0 }
    }

    /// Tokens of each row so far.
    pub fn len(&self) -> i64 {
        self.len
    }

    /// Whether nothing was read yet.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Writes keys and values [rows, heads, t, width] of a layer behind those before, and gives all.
    pub(crate) fn extend(&mut self, layer: usize, k: &Tensor, v: &Tensor) -> (Tensor, Tensor) {
        let (keys, values) = &self.layers[layer];
        let new = k.size()[2];
        keys.narrow(2, self.len, new).copy_(k);
        values.narrow(2, self.len, new).copy_(v);
        let all = self.len + new;
        (keys.narrow(2, 0, all), values.narrow(2, 0, all))
    }

    /// After all layers have read `tokens` more.
    pub(crate) fn advance(&mut self, tokens: i64) {
        self.len += tokens;
    }

    /// Goes on with these rows, in this order; one may come several times.
    pub fn select(&mut self, rows: &[i64]) {
        let index = Tensor::from_slice(rows).to_device(self.layers.first().map_or(tch::Device::Cpu, |l| l.0.device()));
        for (k, v) in &mut self.layers {
            *k = k.index_select(0, &index);
            *v = v.index_select(0, &index);
        }
    }
}
