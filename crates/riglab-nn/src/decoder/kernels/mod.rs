//! Products, attention and norms of a few rows in f32, with AVX2 and FMA, or AVX-512.

#![allow(unsafe_code)]

#[cfg(target_arch = "x86_64")]
mod register;
#[cfg(target_arch = "x86_64")]
mod x86;

use rayon::prelude::*;

/// Outputs that are computed together: two registers of AVX2, or one of AVX-512.
pub(super) const PANEL: usize = 16;
/// Whether the processor has what the kernels take.
pub(super) fn is_fast() -> bool {
    #[cfg(target_arch = "x86_64")]
    {
        x86::is_fast()
    }
    #[cfg(not(target_arch = "x86_64"))]
    {
        false
    }
}

/// A linear map, packed: of each sixteen outputs, the weights of one input after another.
pub(super) struct Panels {
    packed: Vec<f32>,
    /// One an output, filled up with zeros.
    bias: Vec<f32>,
    inputs: usize,
    outputs: usize,
}

impl Panels {
    /// Of weights [outputs, inputs].
    pub fn new(weight: &[f32], bias: &[f32], inputs: usize) -> Self {
        let outputs = bias.len();
        let count = outputs.div_ceil(PANEL);
        let mut packed = vec![0.0; count * PANEL * inputs];
        for (output, own) in weight.chunks_exact(inputs).enumerate() {
            let start = output / PANEL * PANEL * inputs + output % PANEL;
            own.iter().enumerate().for_each(|(k, x)| packed[start + k * PANEL] = *x);
        }
        let mut bias = bias.to_vec();
        bias.resize(count * PANEL, 0.0);
        Self { packed, bias, inputs, outputs }
    }

    pub fn inputs(&self) -> usize {
        self.inputs
    }

    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// x [rows, inputs] to y [rows, outputs].
    pub fn apply(&self, x: &[f32], y: &mut [f32], rows: usize) {
        assert!(x.len() == rows * self.inputs && y.len() == rows * self.outputs && is_fast());
        self.span(x, y.as_mut_ptr(), rows, 0..self.bias.len() / PANEL);
    }

    /// As [`Self::apply`], panels dealt to threads.
    pub fn apply_in_threads(&self, x: &[f32], y: &mut [f32], rows: usize) {
        assert!(x.len() == rows * self.inputs && y.len() == rows * self.outputs && is_fast());
        let count = self.bias.len() / PANEL;
        let each = count.div_ceil(rayon::current_num_threads()).max(1);
        let out = Out(y.as_mut_ptr());
        (0..count.div_ceil(each)).into_par_iter().for_each(|k| {
            let out = &out;
            self.span(x, out.0, rows, k * each..((k + 1) * each).min(count));
        });
    }

    /// Some panels' outputs of all rows. `y` has room for all outputs; spans that do not overlap write to places
    /// that do not.
    fn span(&self, x: &[f32], y: *mut f32, rows: usize, panels: std::ops::Range<usize>) {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the callers have checked sizes and the processor; each panel writes its own outputs only.
        unsafe {
            x86::span(self, x, y, rows, panels);
        }
        #[cfg(not(target_arch = "x86_64"))]
        {
            let _ = (x, y, rows, panels);
            unreachable!("`is_fast` says no")
        }
    }
}

/// A place to write to from several threads, each its own part.
struct Out(*mut f32);

// SAFETY: spans of panels write to places that do not overlap.
unsafe impl Sync for Out {}

/// The norm of each row of x, eps 1e-5; rows fill registers.
pub(super) fn norm(x: &[f32], (gain, bias): &(Vec<f32>, Vec<f32>), y: &mut [f32]) {
    assert!(gain.len() == bias.len() && are_rows(x, gain.len(), y));
    #[cfg(target_arch = "x86_64")]
    // SAFETY: sizes and processor were checked.
    unsafe {
        x86::norm(x, gain, bias, 1e-5, y);
    }
}

/// The root-mean-square norm of each row of x; rows fill registers.
pub(super) fn rms(x: &[f32], gain: &[f32], eps: f32, y: &mut [f32]) {
    assert!(are_rows(x, gain.len(), y));
    #[cfg(target_arch = "x86_64")]
    // SAFETY: sizes and processor were checked.
    unsafe {
        x86::rms(x, gain, eps, y);
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = eps;
}

/// Whether x and y are as many rows of d numbers, which fill registers.
fn are_rows(x: &[f32], d: usize, y: &[f32]) -> bool {
    d.is_multiple_of(8) && x.len().is_multiple_of(d) && x.len() == y.len() && is_fast()
}

/// silu(gates) · held, of as many numbers as fill registers.
pub(super) fn gate(gates: &[f32], held: &[f32], out: &mut [f32]) {
    assert!(gates.len() == held.len() && gates.len() == out.len() && gates.len().is_multiple_of(8) && is_fast());
    #[cfg(target_arch = "x86_64")]
    // SAFETY: sizes and processor were checked.
    unsafe {
        x86::gate(gates, held, out);
    }
}

/// Places whose keys lie together.
pub(super) const BLOCK: usize = 32;

/// Where number `c` of the key at a place lies among the keys of a head, each of `e` numbers: of each block of
/// places one number after another, as a query meets them.
pub(super) fn key_at(place: usize, c: usize, e: usize) -> usize {
    place / BLOCK * BLOCK * e + c * BLOCK + place % BLOCK
}

/// Keys of a head, which lie by [`key_at`], and values [room, e].
#[derive(Clone, Copy)]
pub(super) struct Heard<'a> {
    pub keys: &'a [f32],
    pub values: &'a [f32],
}

/// Queries [n, e] over the first `len` places: those of `before`, which are whole blocks, then those of `own`. `scores`
/// is room for what lies between, which calls share.
pub(super) fn attend(
    q: &[f32],
    e: usize,
    [before, own]: [Heard<'_>; 2],
    len: usize,
    scores: &mut Vec<f32>,
    out: &mut [f32],
) {
    let room = |h: &Heard<'_>| h.keys.len() / e;
    assert!(e.is_multiple_of(8) && q.len().is_multiple_of(e) && out.len() == q.len() && is_fast());
    for h in [&before, &own] {
        assert!(room(h).is_multiple_of(BLOCK) && h.keys.len() == e * room(h) && h.values.len() == h.keys.len());
    }
    assert!(len > room(&before) && len <= room(&before) + room(&own));
    #[cfg(target_arch = "x86_64")]
    // SAFETY: sizes and processor were checked.
    unsafe {
        x86::attend(q, e, [before, own], len, scores, out);
    }
    #[cfg(not(target_arch = "x86_64"))]
    {
        let _ = scores;
        unreachable!("`is_fast` says no")
    }
}

#[cfg(test)]
mod tests {
    use riglab_random::{Draw, stream};

    use super::*;

    fn numbers(name: &str, count: usize) -> Vec<f32> {
        let mut random = stream(1, name, &[count as u64]);
        (0..count).map(|_| random.normal()).collect()
    }

    /// With registers of either width, where the processor has any.
    fn with_registers(test: impl Fn()) {
        if !is_fast() {
            println!("skipped: this processor takes the network's own way");
            return;
        }
        #[cfg(target_arch = "x86_64")]
        for narrow in [true, false] {
            x86::NARROW.set(narrow);
            test();
        }
    }

    #[test]
    fn products_are_those_of_the_formula_and_do_not_depend_on_the_other_rows() {
        with_registers(|| {
            for (inputs, outputs) in [(16, 16), (48, 267), (5, 3), (192, 64)] {
                let (w, b) = (numbers("weights", inputs * outputs), numbers("bias", outputs));
                let panels = Panels::new(&w, &b, inputs);
                for rows in (1..=14).chain([24]) {
                    let x = numbers("inputs", rows * inputs);
                    let (mut y, mut dealt) = (vec![0.0; rows * outputs], vec![0.0; rows * outputs]);
                    panels.apply(&x, &mut y, rows);
                    panels.apply_in_threads(&x, &mut dealt, rows);
                    assert_eq!(y, dealt);
                    // Other threads may take wider registers: the same in parts of this one.
                    let (count, mut parts) = (outputs.div_ceil(PANEL), vec![0.0; rows * outputs]);
                    for span in [0..count / 2, count / 2..count] {
                        panels.span(&x, parts.as_mut_ptr(), rows, span);
                    }
                    assert_eq!(y, parts);
                    for (row, y) in y.chunks(outputs).enumerate() {
                        let x = &x[row * inputs..(row + 1) * inputs];
                        let mut alone = vec![0.0; outputs];
                        panels.apply(x, &mut alone, 1);
                        assert_eq!(y, alone);
                        for (o, y) in y.iter().enumerate() {
                            let wanted: f64 = (0..inputs).map(|k| f64::from(x[k]) * f64::from(w[o * inputs + k])).sum();
                            assert!((f64::from(*y) - wanted - f64::from(b[o])).abs() < 1e-4, "{o}");
                        }
                    }
                }
            }
        });
    }

    #[test]
    fn gates_and_norms_are_those_of_the_formulas() {
        with_registers(|| {
            // Of a length that only the narrower ones fill, too.
            for d in [64, 24] {
                let (g, held) = (numbers("gates", 2 * d), numbers("held", 2 * d));
                let g: Vec<f32> = g.iter().enumerate().map(|(k, x)| x * [0.1, 1.0, 10.0, 100.0][k % 4]).collect();
                let mut out = vec![0.0; 2 * d];
                gate(&g, &held, &mut out);
                for ((g, held), out) in g.iter().zip(&held).zip(&out) {
                    let (g, held) = (f64::from(*g), f64::from(*held));
                    let wanted = g / (1.0 + (-g).exp()) * held;
                    assert!((f64::from(*out) - wanted).abs() < 1e-5 * wanted.abs().max(1.0), "{out} {wanted}");
                }
                let (gain, bias) = (numbers("gain", d), numbers("bias", d));
                for plain in [true, false] {
                    let own = (gain.clone(), bias.clone());
                    if plain {
                        rms(&g, &gain, 1e-6, &mut out)
                    } else {
                        norm(&g, &own, &mut out)
                    }
                    for (x, y) in g.chunks(d).zip(out.chunks(d)) {
                        let x: Vec<f64> = x.iter().map(|x| f64::from(*x)).collect();
                        let mean = if plain { 0.0 } else { x.iter().sum::<f64>() / d as f64 };
                        let spread = x.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / d as f64;
                        let scale = 1.0 / (spread + if plain { 1e-6 } else { 1e-5 }).sqrt();
                        for (((x, y), gain), bias) in x.iter().zip(y).zip(&gain).zip(&bias) {
                            let bias = if plain { 0.0 } else { f64::from(*bias) };
                            let wanted = (x - mean) * scale * f64::from(*gain) + bias;
                            assert!((f64::from(*y) - wanted).abs() < 1e-5, "{y} {wanted}");
                        }
                    }
                }
            }
        });
    }

    #[test]
    fn attention_is_that_of_the_formula() {
        with_registers(|| {
            let mut scores = Vec::new();
            let sizes =
                [(1, 8, 32, 1), (2, 32, 64, 37), (3, 64, 96, 96), (1, 16, 64, 33), (4, 40, 64, 34), (3, 48, 160, 130)];
            for (n, e, room, len) in sizes {
                let (q, keys, values) = (numbers("q", n * e), numbers("keys", e * room), numbers("values", e * room));
                let mut out = vec![0.0; n * e];
                // The first block may lie elsewhere, where another follows.
                for first in [0, BLOCK].into_iter().filter(|first| *first < len) {
                    let mut again = vec![0.0; n * e];
                    let [before, own] = [0..first * e, first * e..room * e]
                        .map(|span| Heard { keys: &keys[span.clone()], values: &values[span] });
                    attend(&q, e, [before, own], len, &mut scores, &mut again);
                    assert!(first == 0 || again == out);
                    out = again;
                }
                for (q, out) in q.chunks(e).zip(out.chunks(e)) {
                    let product = |t: usize| -> f64 {
                        (0..e).map(|c| f64::from(q[c]) * f64::from(keys[key_at(t, c, e)])).sum::<f64>()
                    };
                    let share = |t: usize| (product(t) / (e as f64).sqrt()).exp();
                    let total: f64 = (0..len).map(share).sum();
                    for (c, out) in out.iter().enumerate() {
                        let wanted: f64 = (0..len).map(|t| share(t) / total * f64::from(values[t * e + c])).sum();
                        assert!((f64::from(*out) - wanted).abs() < 1e-5, "{out} {wanted}");
                    }
                }
            }
            // One place takes all where the others are far behind.
            let mut keys = vec![0.0; 256];
            keys[key_at(3, 0, 8)] = 1e4;
            let values: Vec<f32> = (0..256).map(|k| k as f32).collect();
            let mut out = vec![0.0; 8];
            let none = Heard { keys: &[], values: &[] };
            attend(&[1.0; 8], 8, [none, Heard { keys: &keys, values: &values }], 8, &mut scores, &mut out);
            assert_eq!(out, values[24..32]);
        });
    }
}
