//! Keys and values of what was generated.

use tch::{Kind, Tensor};

use super::moves::{Move, Moves};
use super::rotary::Angles;
use super::steps::Steps;

/// Keys and values of rows that go on together, made once for the longest sequence.
pub struct Cache {
    /// Of each layer, keys and values [2, rows, heads, room, head width].
    layers: Vec<Tensor>,
    /// Rows that go on: the first ones of those there is room for.
    rows: i64,
    len: i64,
    /// The first tokens, which all rows have from one.
    pub(super) same: i64,
    /// Tensors of weights that a decoder has put together for the steps to come, by layer.
    pub(super) fused: Vec<Vec<Tensor>>,
    /// Of every place that there is room for, where positions are angles.
    pub(super) angles: Option<Angles>,
    /// What has taken over the rows, where one token is read at a time on the CPU.
    pub(super) steps: Option<Steps>,
}

impl Cache {
    /// Room for so many tokens.
    pub fn new(layers: usize, rows: i64, heads: i64, room: i64, width: i64, kind: Kind, device: tch::Device) -> Self {
        let empty = || Tensor::empty([2, rows, heads, room, width], (kind, device));
        let layers = (0..layers).map(|_| empty()).collect();
        Self { layers, rows, len: 0, same: 0, fused: Vec::new(), angles: None, steps: None }
    }

    /// Tokens of each row so far.
    pub fn len(&self) -> i64 {
        self.len
    }

    /// Whether nothing was read yet.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The keys and values [rows, heads, len, width] of each layer, which are given away.
    pub(super) fn take(&mut self) -> impl Iterator<Item = (Tensor, Tensor)> {
        let all: Vec<_> = (0..self.layers.len()).map(|layer| self.all(&self.own(layer), 0)).collect();
        self.layers.clear();
        all.into_iter()
    }

    /// Writes keys and values [rows, heads, t, width] of a layer behind those before, and gives all.
    pub(crate) fn extend(&mut self, layer: usize, k: &Tensor, v: &Tensor) -> (Tensor, Tensor) {
        let own = self.own(layer);
        let new = own.narrow(3, self.len, k.size()[2]);
        new.select(0, 0).copy_(k);
        new.select(0, 1).copy_(v);
        self.all(&own, k.size()[2])
    }

    /// As [`Self::extend`], of both in one tensor [2, rows, heads, t, width].
    pub(crate) fn extend_both(&mut self, layer: usize, both: &Tensor) -> (Tensor, Tensor) {
        let own = self.own(layer);
        let new = both.size()[3];
        own.narrow(3, self.len, new).copy_(both);
        self.all(&own, new)
    }

    /// Tokens that there is room for.
    pub(super) fn room(&self) -> i64 {
        self.layers.first().map_or(0, |layer| layer.size()[3])
    }

    fn own(&self, layer: usize) -> Tensor {
        self.layers[layer].narrow(1, 0, self.rows)
    }

    fn all(&self, own: &Tensor, new: i64) -> (Tensor, Tensor) {
        let all = own.narrow(3, 0, self.len + new);
        (all.select(0, 0), all.select(0, 1))
    }

    /// After all layers have read `tokens` more.
    pub(crate) fn advance(&mut self, tokens: i64) {
        self.len += tokens;
    }

    /// Goes on with these rows, in this order; one may come several times.
    pub fn select(&mut self, rows: &[i64]) {
        if self.rows == 1 && rows.len() > 1 {
            self.same = self.len;
        }
        if let Some(steps) = &mut self.steps {
            steps.select(rows, self.len as usize);
        }
        // Where there is room they move within it, else into larger tensors; what is not written yet need not move.
        if let Some(moves) = Moves::of(rows, self.rows) {
            self.layers.iter().for_each(|layer| moved(&layer.narrow(3, 0, self.len), &moves));
        } else {
            let device = self.layers.first().map_or(tch::Device::Cpu, Tensor::device);
            let index = Tensor::from_slice(rows).to_device(device);
            for layer in &mut self.layers {
                let mut size = layer.size();
                size[1] = rows.len() as i64;
                let other = Tensor::empty(size, (layer.kind(), layer.device()));
                let written = layer.narrow(3, 0, self.len);
                other.narrow(3, 0, self.len).copy_(&written.index_select(1, &index));
                *layer = other;
            }
        }
        self.rows = rows.len() as i64;
    }
}

/// Moves rows of keys and values [2, rows, heads, len, head width] where they are.
fn moved(layer: &Tensor, moves: &Moves) {
    let row = |row: usize| layer.select(1, row as i64);
    let mut kept = Tensor::new();
    for step in &moves.0 {
        match *step {
            Move::Copy { from, to } => row(to).copy_(&row(from)),
            Move::Keep { from } => kept = row(from).copy(),
            Move::Put { to } => row(to).copy_(&kept),
        }
    }
}

#[cfg(test)]
mod tests {
    use tch::Device;

    use super::*;

    #[test]
    fn rows_move_as_they_are_asked_to() {
        let mut cache = Cache::new(1, 4, 1, 3, 1, Kind::Float, Device::Cpu);
        let column = |values: [f32; 4]| Tensor::from_slice(&values).view([4, 1, 1, 1]);
        let keys = column([0.0, 1.0, 2.0, 3.0]);
        let _ = cache.extend(0, &keys, &(&keys + 10.0));
        cache.advance(1);
        let mut now: Vec<i64> = vec![0, 1, 2, 3];
        // Leaving, moving forward, changing places, doubling.
        for rows in [vec![1, 2, 0, 0], vec![0, 3, 2], vec![2, 1], vec![1, 0, 1], vec![1, 1], vec![1, 0, 0]] {
            cache.select(&rows);
            now = rows.iter().map(|&r| now[r as usize]).collect();
            let (keys, values) = cache.all(&cache.own(0), 0);
            let flat = |t: Tensor| Vec::<f32>::try_from(t.contiguous().view([-1])).unwrap();
            assert_eq!(flat(keys), now.iter().map(|&r| r as f32).collect::<Vec<_>>());
            assert_eq!(flat(values), now.iter().map(|&r| r as f32 + 10.0).collect::<Vec<_>>());
        }
    }
}
