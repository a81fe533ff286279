//! A decoder's steps of one token in plain f32 on the CPU.
//!
//! libtorch's products of a few rows pack the weights anew at each call or fall back to a plain matrix-vector
//! kernel, and its attention of one query goes by way of such products, row and head by row and head. Here weights
//! are packed once, and keys lie so that a query meets them a register at a time. A row's numbers do not depend on
//! how many rows there are. Measured by `cargo xtask bench generate`.

use rayon::prelude::*;

use super::kernels::{BLOCK, PANEL, Panels, attend, is_fast, key_at, norm};

/// A norm: gain and bias.
pub(super) type Norm = (Vec<f32>, Vec<f32>);

/// The packed weights of a layer.
pub(super) struct LayerWeights {
    pub norm: Norm,
    /// Query, key and value.
    pub qkv: Panels,
    pub out: Panels,
    pub norm_out: Norm,
    pub up: Panels,
    pub down: Panels,
}

/// Keys (of each row and head by [`key_at`]) and values [row, head, room, e] of a layer.
struct Memory {
    keys: Vec<f32>,
    values: Vec<f32>,
}

/// Weights, and keys and values of rows that go on together.
pub(super) struct Steps {
    layers: Vec<LayerWeights>,
    norm: Norm,
    memory: Vec<Memory>,
    rows: usize,
    heads: usize,
    /// Width of a head.
    width: usize,
    room: usize,
    /// Whether work is dealt to threads where there is enough of it.
    threads: bool,
}

/// Multiplications from which on a product is worth dealing out.
const MUCH: usize = 1 << 20;

impl Steps {
    /// Whether this processor and such heads are served.
    pub fn serve(width: usize, head: usize) -> bool {
        is_fast() && head.is_multiple_of(8) && width.is_multiple_of(PANEL)
    }

    /// With room for so many tokens, none of them written.
    pub fn new(layers: Vec<LayerWeights>, norm: Norm, [rows, heads, room, width]: [usize; 4], threads: bool) -> Self {
        // Keys are read a block at a time.
        let room = room.next_multiple_of(BLOCK);
        let size = rows * heads * room * width;
        let memory = layers.iter().map(|_| Memory { keys: vec![0.0; size], values: vec![0.0; size] }).collect();
        Self { layers, norm, memory, rows, heads, width, room, threads }
    }

    /// Takes the keys and values [rows, heads, len, e] that a layer has read so far.
    pub fn write(&mut self, layer: usize, keys: &[f32], values: &[f32]) {
        let (room, e) = (self.room, self.width);
        let len = keys.len() / (self.rows * self.heads * e);
        let memory = &mut self.memory[layer];
        for part in 0..self.rows * self.heads {
            let (from, to) = (part * len * e, part * room * e);
            memory.values[to..to + len * e].copy_from_slice(&values[from..from + len * e]);
            for (at, key) in keys[from..from + len * e].chunks_exact(e).enumerate() {
                key.iter().enumerate().for_each(|(c, x)| memory.keys[to + key_at(at, c, e)] = *x);
            }
        }
    }

    /// Vectors x [rows, d] at place `at` to what the last norm gives.
    pub fn step(&mut self, x: &mut [f32], at: usize) {
        let (rows, heads, e, room, threads) = (self.rows, self.heads, self.width, self.room, self.threads);
        let d = heads * e;
        let mut own = vec![0.0; rows * d];
        let mut qkv = vec![0.0; rows * 3 * d];
        let mut inner = Vec::new();
        for (layer, memory) in self.layers.iter().zip(&mut self.memory) {
            norm(x, &layer.norm, &mut own);
            product(&layer.qkv, &own, &mut qkv, threads);
            let one = |row: usize, keys: &mut [f32], values: &mut [f32], out: &mut [f32]| {
                let (q, kv) = qkv[3 * row * d..3 * (row + 1) * d].split_at(d);
                let (k, v) = kv.split_at(d);
                for head in 0..heads {
                    let keys = &mut keys[head * room * e..(head + 1) * room * e];
                    let values = &mut values[head * room * e..(head + 1) * room * e];
                    let span = head * e..(head + 1) * e;
                    k[span.clone()].iter().enumerate().for_each(|(c, x)| keys[key_at(at, c, e)] = *x);
                    values[at * e..(at + 1) * e].copy_from_slice(&v[span.clone()]);
                    attend(&q[span.clone()], keys, values, at + 1, &mut out[span]);
                }
            };
            let size = heads * room * e;
            if threads && rows * at * d > MUCH / 4 {
                let keys = memory.keys.par_chunks_mut(size);
                let parts = keys.zip(memory.values.par_chunks_mut(size)).zip(own.par_chunks_mut(d));
                parts.enumerate().for_each(|(row, ((keys, values), out))| one(row, keys, values, out));
            } else {
                let keys = memory.keys.chunks_mut(size);
                let parts = keys.zip(memory.values.chunks_mut(size)).zip(own.chunks_mut(d));
                parts.enumerate().for_each(|(row, ((keys, values), out))| one(row, keys, values, out));
            }
            let mut read = vec![0.0; rows * d];
            product(&layer.out, &own, &mut read, threads);
            x.iter_mut().zip(&read).for_each(|(x, y)| *x += y);
            norm(x, &layer.norm_out, &mut own);
            inner.resize(rows * layer.up.outputs(), 0.0);
            product(&layer.up, &own, &mut inner, threads);
            inner.iter_mut().for_each(|y| *y = y.max(0.0));
            product(&layer.down, &inner, &mut read, threads);
            x.iter_mut().zip(&read).for_each(|(x, y)| *x += y);
        }
        norm(x, &self.norm, &mut own);
        x.copy_from_slice(&own);
    }

    /// Goes on with these rows, in this order, of which `len` places are written.
    pub fn select(&mut self, rows: &[i64], len: usize) {
        let one = self.room * self.width;
        let size = self.heads * one;
        // What is not written yet need not move; of keys, blocks are written.
        let written = len.next_multiple_of(BLOCK) * self.width;
        // As in the tensors: no row moves to behind where it stands.
        let forward = rows.iter().enumerate().all(|(to, &from)| from >= to as i64);
        for all in self.memory.iter_mut().flat_map(|m| [&mut m.keys, &mut m.values]) {
            if forward {
                for (to, &from) in rows.iter().enumerate().filter(|(to, from)| *to as i64 != **from) {
                    for head in 0..self.heads {
                        let start = from as usize * size + head * one;
                        all.copy_within(start..start + written, to * size + head * one);
                    }
                }
                all.truncate(rows.len() * size);
                continue;
            }
            let mut other = vec![0.0; rows.len() * size];
            for (to, &from) in rows.iter().enumerate() {
                for head in 0..self.heads {
                    let (from, to) = (from as usize * size + head * one, to * size + head * one);
                    other[to..to + written].copy_from_slice(&all[from..from + written]);
                }
            }
            *all = other;
        }
        self.rows = rows.len();
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
