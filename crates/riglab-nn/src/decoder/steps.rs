//! A decoder's steps of one token in plain f32 on the CPU.
//!
//! libtorch's products of a few rows pack the weights anew at each call or fall back to a plain matrix-vector
//! kernel, and its attention of one query goes by way of such products, row and head by row and head. Here weights
//! are packed once, and keys lie so that a query meets them a register at a time. A row's numbers do not depend on
//! how many rows there are. Measured by `cargo xtask bench generate`.

use rayon::prelude::*;
use tch::Tensor;

use super::kernels::{BLOCK, Heard, PANEL, Panels, attend, gate, is_fast, key_at, norm, rms};
use super::moves::{Move, Moves};

/// A norm of rows.
pub(super) enum Norm {
    /// Gain and bias.
    Layer((Vec<f32>, Vec<f32>)),
    /// Gain and eps.
    Rms(Vec<f32>, f32),
}

impl Norm {
    fn apply(&self, x: &[f32], y: &mut [f32]) {
        match self {
            Self::Layer(own) => norm(x, own, y),
            Self::Rms(gain, eps) => rms(x, gain, *eps, y),
        }
    }
}

/// The packed weights of a layer.
pub(super) struct LayerWeights {
    pub norm: Norm,
    /// Query, key and value.
    pub qkv: Panels,
    /// Of heads of queries and of keys, before they are turned.
    pub norm_heads: Option<[Norm; 2]>,
    pub out: Panels,
    pub norm_out: Norm,
    /// What is cut at zero; or gates, then what they let through.
    pub up: Panels,
    pub gated: bool,
    pub down: Panels,
}

/// Numbers of a decoder.
#[derive(Clone, Copy)]
pub(super) struct Sizes {
    pub rows: usize,
    /// Heads of queries.
    pub heads: usize,
    /// Heads of keys and values.
    pub kv_heads: usize,
    /// Tokens that there is room for, in all.
    pub room: usize,
    /// The first ones, which are the same in all rows: they are kept once.
    pub same: usize,
    /// Width of a head.
    pub width: usize,
}

/// Keys (of each row and head by [`key_at`]) and values [row, head, room, e] of a layer.
struct Memory {
    keys: Vec<f32>,
    values: Vec<f32>,
}

impl Memory {
    fn new(size: usize) -> Self {
        Self { keys: vec![0.0; size], values: vec![0.0; size] }
    }

    /// Those of a head, of one row.
    fn heard(&self, head: usize, size: usize) -> Heard<'_> {
        let span = head * size..(head + 1) * size;
        Heard { keys: &self.keys[span.clone()], values: &self.values[span] }
    }
}

/// Weights, and keys and values of rows that go on together.
pub(super) struct Steps {
    layers: Vec<LayerWeights>,
    norm: Norm,
    /// Cosines and sines of every place, [room, e] each; empty where positions are learned.
    angles: [Vec<f32>; 2],
    /// Of each layer, what is the same in all rows, and then each row's own.
    memory: Vec<(Memory, Memory)>,
    /// `room` is here that of a row's own.
    sizes: Sizes,
    /// Whether work is dealt to threads where there is enough of it.
    threads: bool,
}

/// Multiplications from which on a product is worth dealing out.
const MUCH: usize = 1 << 20;

impl Steps {
    /// Whether this processor and such heads and widths of layers are served.
    pub fn serve(head: usize, widths: &[usize]) -> bool {
        is_fast() && head.is_multiple_of(8) && widths.iter().all(|w| w.is_multiple_of(PANEL))
    }

    /// Nothing is written yet. `angles`: see [`super::rotary::Angles::floats`].
    pub fn new(layers: Vec<LayerWeights>, norm: Norm, angles: [Vec<f32>; 2], sizes: Sizes, threads: bool) -> Self {
        // Keys are read a block at a time.
        let same = sizes.same / BLOCK * BLOCK;
        let sizes = Sizes { room: sizes.room.next_multiple_of(BLOCK) - same, same, ..sizes };
        let one = sizes.kv_heads * sizes.width;
        let both = || (Memory::new(one * same), Memory::new(one * sizes.room * sizes.rows));
        let memory = layers.iter().map(|_| both()).collect();
        Self { layers, norm, angles, memory, sizes, threads }
    }

    /// Takes the keys and values [rows, heads, len, e] that a layer has read so far.
    pub fn write(&mut self, layer: usize, keys: &[f32], values: &[f32]) {
        let Sizes { rows, kv_heads, room, same, width: e, .. } = self.sizes;
        let len = keys.len() / (rows * kv_heads * e);
        let (shared, own) = &mut self.memory[layer];
        for part in 0..rows * kv_heads {
            let put = |to: &mut Memory, start: usize, span: std::ops::Range<usize>| {
                for (at, place) in span.enumerate() {
                    let from = (part * len + place) * e..(part * len + place + 1) * e;
                    to.values[start + at * e..start + (at + 1) * e].copy_from_slice(&values[from.clone()]);
                    keys[from].iter().enumerate().for_each(|(c, x)| to.keys[start + key_at(at, c, e)] = *x);
                }
            };
            if part < kv_heads {
                put(shared, part * same * e, 0..same);
            }
            put(own, part * room * e, same..len);
        }
    }

    /// Vectors [rows, t, d] from place `at` on to what the last norm gives [rows, t, d].
    pub fn read(&mut self, x: &Tensor, at: usize) -> Tensor {
        let (rows, t, d) = x.size3().expect("three axes");
        let each = (0..t).map(|k| {
            let mut own = floats(&x.select(1, k));
            self.step(&mut own, at + k as usize);
            Tensor::from_slice(&own).view([rows, 1, d])
        });
        Tensor::cat(&each.collect::<Vec<_>>(), 1)
    }

    /// Vectors x [rows, d] at place `at` to what the last norm gives.
    ///
    /// Many rows are dealt to threads, each of which takes its own through all layers: threads then wait for each
    /// other once a token. A few are read by all threads together, product by product.
    fn step(&mut self, x: &mut [f32], at: usize) {
        let Self { layers, norm, angles, memory, sizes, threads } = self;
        let Sizes { rows, kv_heads, room, width, .. } = *sizes;
        let net = Net { layers, norm, angles, sizes: *sizes };
        let (d, size) = (x.len() / rows, kv_heads * room * width);
        let hands = if *threads { rayon::current_num_threads() } else { 1 };
        let each = rows.div_ceil(hands);
        if hands == 1 || each < FEW {
            let own = memory.iter_mut().map(|(shared, own)| Spoken::new(shared, &mut own.keys, &mut own.values));
            return net.step(x, &mut own.collect::<Vec<_>>(), at, *threads);
        }
        let mut parts: Vec<Vec<Spoken<'_>>> = x.chunks(each * d).map(|_| Vec::new()).collect();
        for (shared, own) in memory.iter_mut() {
            let dealt = own.keys.chunks_mut(each * size).zip(own.values.chunks_mut(each * size));
            parts.iter_mut().zip(dealt).for_each(|(part, (keys, values))| part.push(Spoken::new(shared, keys, values)));
        }
        let mut parts = x.chunks_mut(each * d).zip(parts);
        let first = parts.next();
        // The first part is this thread's own: it need not wait for another to wake.
        rayon::in_place_scope(|scope| {
            let net = &net;
            parts.for_each(|(x, mut memory)| scope.spawn(move |_| net.step(x, &mut memory, at, false)));
            first.into_iter().for_each(|(x, mut memory)| net.step(x, &mut memory, at, false));
        });
    }

    /// Goes on with these rows, in this order, of which `len` places are written.
    pub fn select(&mut self, rows: &[i64], len: usize) {
        let Sizes { kv_heads: heads, room, same, width, .. } = self.sizes;
        let one = room * width;
        let size = heads * one;
        // What is not written yet need not move; of keys, blocks are written.
        let written = (len - same).next_multiple_of(BLOCK) * width;
        let moves = Moves::of(rows, self.sizes.rows as i64);
        for all in self.memory.iter_mut().flat_map(|(_, own)| [&mut own.keys, &mut own.values]) {
            if let Some(moves) = &moves {
                let spans = |row: usize| (0..heads).map(move |head| row * size + head * one);
                let mut kept = Vec::new();
                for step in &moves.0 {
                    match *step {
                        Move::Copy { from, to } => {
                            spans(from).zip(spans(to)).for_each(|(from, to)| all.copy_within(from..from + written, to))
                        }
                        Move::Keep { from } => {
                            kept.clear();
                            spans(from).for_each(|from| kept.extend_from_slice(&all[from..from + written]));
                        }
                        Move::Put { to } => spans(to)
                            .zip(kept.chunks_exact(written.max(1)))
                            .for_each(|(to, own)| all[to..to + written].copy_from_slice(own)),
                    }
                }
                all.truncate(rows.len() * size);
                continue;
            }
            let mut other = vec![0.0; rows.len() * size];
            for (to, &from) in rows.iter().enumerate() {
                for head in 0..heads {
                    let (from, to) = (from as usize * size + head * one, to * size + head * one);
                    other[to..to + written].copy_from_slice(&all[from..from + written]);
                }
            }
            *all = other;
        }
        self.sizes.rows = rows.len();
    }
}

/// Rows from which on a thread has enough to do by itself.
const FEW: usize = 4;

/// What is written of some rows in a layer: what is the same in all, and keys and values of their own.
struct Spoken<'a> {
    shared: &'a Memory,
    keys: &'a mut [f32],
    values: &'a mut [f32],
}

impl<'a> Spoken<'a> {
    fn new(shared: &'a Memory, keys: &'a mut [f32], values: &'a mut [f32]) -> Self {
        Self { shared, keys, values }
    }
}

/// What all rows have in common.
struct Net<'a> {
    layers: &'a [LayerWeights],
    norm: &'a Norm,
    angles: &'a [Vec<f32>; 2],
    sizes: Sizes,
}

impl Net<'_> {
    /// As [`Steps::step`], of as many rows as x has; `memory`: of each layer.
    fn step(&self, x: &mut [f32], memory: &mut [Spoken<'_>], at: usize, threads: bool) {
        let Sizes { heads, kv_heads, room, same, width: e, .. } = self.sizes;
        let size = kv_heads * room * e;
        let rows = memory.first().map_or(0, |own| own.keys.len() / size);
        let d = x.len() / rows.max(1);
        let (wide, kv, group) = (heads * e, kv_heads * e, heads / kv_heads);
        let each = wide + 2 * kv;
        let place = at - same;
        let mut own = vec![0.0; rows * d];
        let mut qkv = vec![0.0; rows * each];
        let mut heard = vec![0.0; rows * wide];
        let mut read = vec![0.0; rows * d];
        let mut turned = vec![0.0; wide + kv];
        let (mut inner, mut passed, mut scores) = (Vec::new(), Vec::new(), Vec::new());
        for (layer, memory) in self.layers.iter().zip(memory) {
            layer.norm.apply(x, &mut own);
            product(&layer.qkv, &own, &mut qkv, threads);
            if let Some([of_queries, of_keys]) = &layer.norm_heads {
                let [cos, sin] = self.angles.each_ref().map(|all| &all[at * e..(at + 1) * e]);
                for row in qkv.chunks_exact_mut(each) {
                    of_queries.apply(&row[..wide], &mut turned[..wide]);
                    of_keys.apply(&row[wide..wide + kv], &mut turned[wide..]);
                    turn(&turned, cos, sin, &mut row[..wide + kv]);
                }
            }
            let shared = memory.shared;
            let one = |scores: &mut Vec<f32>, row: usize, keys: &mut [f32], values: &mut [f32], out: &mut [f32]| {
                let (q, others) = qkv[row * each..(row + 1) * each].split_at(wide);
                let (k, v) = others.split_at(kv);
                for head in 0..kv_heads {
                    let keys = &mut keys[head * room * e..(head + 1) * room * e];
                    let values = &mut values[head * room * e..(head + 1) * room * e];
                    let span = head * e..(head + 1) * e;
                    k[span.clone()].iter().enumerate().for_each(|(c, x)| keys[key_at(place, c, e)] = *x);
                    values[place * e..(place + 1) * e].copy_from_slice(&v[span.clone()]);
                    let span = group * span.start..group * span.end;
                    let heard = [shared.heard(head, same * e), Heard { keys, values }];
                    attend(&q[span.clone()], e, heard, at + 1, scores, &mut out[span]);
                }
            };
            if threads && rows * at * wide > MUCH / 4 {
                let parts = memory.keys.par_chunks_mut(size).zip(memory.values.par_chunks_mut(size));
                let parts = parts.zip(heard.par_chunks_mut(wide)).enumerate();
                parts.for_each_init(Vec::new, |scores, (row, ((keys, values), out))| {
                    one(scores, row, keys, values, out)
                });
            } else {
                let parts = memory.keys.chunks_mut(size).zip(memory.values.chunks_mut(size));
                let parts = parts.zip(heard.chunks_mut(wide)).enumerate();
                parts.for_each(|(row, ((keys, values), out))| one(&mut scores, row, keys, values, out));
            }
            product(&layer.out, &heard, &mut read, threads);
            x.iter_mut().zip(&read).for_each(|(x, y)| *x += y);
            layer.norm_out.apply(x, &mut own);
            inner.resize(rows * layer.up.outputs(), 0.0);
            product(&layer.up, &own, &mut inner, threads);
            let through = if layer.gated {
                let half = layer.up.outputs() / 2;
                passed.resize(rows * half, 0.0);
                inner.chunks_exact(2 * half).zip(passed.chunks_exact_mut(half)).for_each(|(all, out)| {
                    let (gates, held) = all.split_at(half);
                    gate(gates, held, out);
                });
                &passed
            } else {
                inner.iter_mut().for_each(|y| *y = y.max(0.0));
                &inner
            };
            product(&layer.down, through, &mut read, threads);
            x.iter_mut().zip(&read).for_each(|(x, y)| *x += y);
        }
        self.norm.apply(x, &mut own);
        x.copy_from_slice(&own);
    }
}

/// x [rows, inputs] to y [rows, outputs].
fn product(panels: &Panels, x: &[f32], y: &mut [f32], threads: bool) {
    let rows = x.len() / panels.inputs();
    if threads && x.len() * panels.outputs() > MUCH {
        panels.apply_in_threads(x, y, rows);
    } else {
        panels.apply(x, y, rows);
    }
}

/// Heads of x, each turned as [`super::rotary::Angles::turn`] does.
fn turn(x: &[f32], cos: &[f32], sin: &[f32], y: &mut [f32]) {
    let (e, half) = (cos.len(), cos.len() / 2);
    for (x, y) in x.chunks_exact(e).zip(y.chunks_exact_mut(e)) {
        for c in 0..half {
            y[c] = x[c] * cos[c] - x[c + half] * sin[c];
            y[c + half] = x[c + half] * cos[c + half] + x[c] * sin[c + half];
        }
    }
}

/// A tensor's numbers.
pub(super) fn floats(t: &Tensor) -> Vec<f32> {
    Vec::<f32>::try_from(t.detach().contiguous().view([-1])).expect("floats on the CPU")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers without pattern.
    fn numbers(seed: usize, count: usize) -> Vec<f32> {
        (0..count).map(|k| ((seed * 7919 + k) as f32 * 0.618).fract() - 0.5).collect()
    }

    /// Two layers of two heads, for so many rows.
    fn steps(rows: usize, threads: bool) -> Steps {
        let (d, inner) = (32, 64);
        let panels = |seed: usize, outputs: usize, inputs: usize| {
            Panels::new(&numbers(seed, outputs * inputs), &numbers(seed + 1, outputs), inputs)
        };
        let norm = || Norm::Layer((vec![1.0; d], vec![0.0; d]));
        let layer = |k: usize| LayerWeights {
            norm: norm(),
            qkv: panels(10 * k, 3 * d, d),
            norm_heads: None,
            out: panels(10 * k + 2, d, d),
            norm_out: norm(),
            up: panels(10 * k + 4, inner, d),
            gated: false,
            down: panels(10 * k + 6, d, inner),
        };
        let sizes = Sizes { rows, heads: 2, kv_heads: 2, room: 8, same: 0, width: d / 2 };
        Steps::new(vec![layer(1), layer(2)], norm(), Default::default(), sizes, threads)
    }

    #[test]
    fn rows_that_are_dealt_to_threads_are_those_read_together() {
        if !Steps::serve(16, &[32, 64, 96]) {
            println!("skipped: this processor takes the network's own way");
            return;
        }
        let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
        // As many as threads share evenly, one more, and too few to deal.
        for rows in [12, 13, 6] {
            let (mut dealt, mut together) = (steps(rows, true), steps(rows, false));
            let mut left = rows;
            for at in 0..6 {
                let x = numbers(100 + at, 32 * left);
                let (mut a, mut b) = (x.clone(), x);
                pool.install(|| dealt.step(&mut a, at));
                together.step(&mut b, at);
                assert!(a == b && a.iter().all(|x| x.is_finite()), "{left} of {rows} rows, place {at}");
                // All change places, then the first leaves, and the last takes its place.
                if at == 1 {
                    let round: Vec<i64> = (1..left as i64).chain([0]).collect();
                    dealt.select(&round, at + 1);
                    together.select(&round, at + 1);
                }
                if at == 2 {
                    left -= 1;
                    let stay: Vec<i64> = [left as i64].into_iter().chain(1..left as i64).collect();
                    dealt.select(&stay, at + 1);
                    together.select(&stay, at + 1);
                }
            }
        }
    }
}
