//! Products, attention and norms of a few rows in f32, with AVX2 and FMA.

#![allow(unsafe_code)]

use rayon::prelude::*;

/// Outputs that are computed together: two registers.
pub(super) const PANEL: usize = 16;
/// Rows that are computed together with a panel.
const ROWS: usize = 6;

/// Whether the processor has what the kernels take.
pub(super) fn is_fast() -> bool {
    #[cfg(target_arch = "x86_64")]
    {
        is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")
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
            if rows == 1 {
                let mut panel = panels.start;
                while panel + 4 <= panels.end {
                    x86::panels::<1, 4>(self, x, y, 0, panel);
                    panel += 4;
                }
                (panel..panels.end).for_each(|panel| x86::panels::<1, 1>(self, x, y, 0, panel));
                return;
            }
            // As equal parts as go: one row left over would cost as much as four.
            let each = rows.div_ceil(rows.div_ceil(ROWS).max(1));
            for panel in panels {
                let mut row = 0;
                while row < rows {
                    match (rows - row).min(each) {
                        1 => x86::panels::<1, 1>(self, x, y, row, panel),
                        2 => x86::panels::<2, 1>(self, x, y, row, panel),
                        3 => x86::panels::<3, 1>(self, x, y, row, panel),
                        4 => x86::panels::<4, 1>(self, x, y, row, panel),
                        5 => x86::panels::<5, 1>(self, x, y, row, panel),
                        _ => x86::panels::<ROWS, 1>(self, x, y, row, panel),
                    }
                    row += each;
                }
            }
        }
        #[cfg(not(target_arch = "x86_64"))]
        {
            let _ = (x, y, rows, panels, ROWS);
            unreachable!("`is_fast` says no")
        }
    }
}

/// A place to write to from several threads, each its own part.
struct Out(*mut f32);

// SAFETY: spans of panels write to places that do not overlap.
unsafe impl Sync for Out {}

/// The norm of each row of x, eps 1e-5.
pub(super) fn norm(x: &[f32], (gain, bias): &(Vec<f32>, Vec<f32>), y: &mut [f32]) {
    let d = gain.len();
    for (x, y) in x.chunks_exact(d).zip(y.chunks_exact_mut(d)) {
        let mean = sum(x.iter().copied()) / d as f32;
        let variance = sum(x.iter().map(|x| (x - mean) * (x - mean))) / d as f32;
        let scale = 1.0 / (variance + 1e-5).sqrt();
        for (((y, x), g), b) in y.iter_mut().zip(x).zip(gain).zip(bias) {
            *y = (x - mean) * scale * g + b;
        }
    }
}

/// The root-mean-square norm of each row of x.
pub(super) fn rms(x: &[f32], gain: &[f32], eps: f32, y: &mut [f32]) {
    let d = gain.len();
    for (x, y) in x.chunks_exact(d).zip(y.chunks_exact_mut(d)) {
        let scale = 1.0 / (sum(x.iter().map(|x| x * x)) / d as f32 + eps).sqrt();
        y.iter_mut().zip(x).zip(gain).for_each(|((y, x), g)| *y = x * scale * g);
    }
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

/// In eight parts, as registers add.
fn sum(values: impl ExactSizeIterator<Item = f32>) -> f32 {
    let mut parts = [0.0f32; 8];
    values.enumerate().for_each(|(k, x)| parts[k % 8] += x);
    parts.iter().sum()
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

/// Queries [n, e] over the first `len` places: those of `before`, which are whole blocks, then those of `own`.
pub(super) fn attend(q: &[f32], e: usize, before: Heard<'_>, own: Heard<'_>, len: usize, out: &mut [f32]) {
    let room = |h: &Heard<'_>| h.keys.len() / e;
    assert!(e.is_multiple_of(8) && q.len().is_multiple_of(e) && out.len() == q.len() && is_fast());
    for h in [&before, &own] {
        assert!(room(h).is_multiple_of(BLOCK) && h.keys.len() == e * room(h) && h.values.len() == h.keys.len());
    }
    assert!(len > room(&before) && len <= room(&before) + room(&own));
    #[cfg(target_arch = "x86_64")]
    for (q, out) in q.chunks(2 * e).zip(out.chunks_mut(2 * e)) {
        // SAFETY: sizes and processor were checked.
        unsafe {
            // Two queries meet a key, or a value, once it is in a register; one alone takes two places at a time.
            if q.len() == e {
                x86::attend::<1, 2>(q, before, own, len, out);
            } else {
                x86::attend::<2, 1>(q, before, own, len, out);
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::*;

    use super::{BLOCK, Heard, PANEL, Panels};

    /// R rows from `row` on, P panels from `panel` on.
    #[target_feature(enable = "avx2,fma")]
    pub(super) unsafe fn panels<const R: usize, const P: usize>(
        of: &Panels,
        x: &[f32],
        y: *mut f32,
        row: usize,
        panel: usize,
    ) {
        let (inputs, outputs) = (of.inputs, of.outputs);
        // SAFETY: rows and panels are there, by the caller.
        unsafe {
            let (x, w) = (x.as_ptr().add(row * inputs), of.packed.as_ptr().add(panel * PANEL * inputs));
            let mut sums = [[[_mm256_setzero_ps(); 2]; P]; R];
            for sums in &mut sums {
                for (p, sums) in sums.iter_mut().enumerate() {
                    for (half, sum) in sums.iter_mut().enumerate() {
                        *sum = _mm256_loadu_ps(of.bias.as_ptr().add((panel + p) * PANEL + 8 * half));
                    }
                }
            }
            for k in 0..inputs {
                for p in 0..P {
                    let w = w.add((p * inputs + k) * PANEL);
                    let (low, high) = (_mm256_loadu_ps(w), _mm256_loadu_ps(w.add(8)));
                    for (r, sums) in sums.iter_mut().enumerate() {
                        let x = _mm256_broadcast_ss(&*x.add(r * inputs + k));
                        sums[p][0] = _mm256_fmadd_ps(x, low, sums[p][0]);
                        sums[p][1] = _mm256_fmadd_ps(x, high, sums[p][1]);
                    }
                }
            }
            for (r, sums) in sums.iter().enumerate() {
                for (p, sums) in sums.iter().enumerate() {
                    let start = (panel + p) * PANEL;
                    let to = y.add((row + r) * outputs + start);
                    if start + PANEL <= outputs {
                        _mm256_storeu_ps(to, sums[0]);
                        _mm256_storeu_ps(to.add(8), sums[1]);
                    } else {
                        let mut all = [0.0f32; PANEL];
                        _mm256_storeu_ps(all.as_mut_ptr(), sums[0]);
                        _mm256_storeu_ps(all.as_mut_ptr().add(8), sums[1]);
                        std::ptr::copy_nonoverlapping(all.as_ptr(), to, outputs - start);
                    }
                }
            }
        }
    }

    /// See [`super::attend`]; Q queries, of values U places at a time.
    #[target_feature(enable = "avx2,fma")]
    pub(super) unsafe fn attend<const Q: usize, const U: usize>(
        q: &[f32],
        before: Heard<'_>,
        own: Heard<'_>,
        len: usize,
        out: &mut [f32],
    ) {
        let (e, first) = (q.len() / Q, before.keys.len() / (q.len() / Q));
        let count = len.next_multiple_of(BLOCK);
        let mut scores = vec![0.0f32; Q * count];
        let scale = 1.0 / (e as f32).sqrt();
        // SAFETY: `count` is at most the room of both, which are whole blocks; channels are whole registers.
        unsafe {
            let scores = scores.as_mut_ptr();
            for at in (0..count).step_by(BLOCK) {
                let block =
                    if at < first { before.keys.as_ptr().add(at * e) } else { own.keys.as_ptr().add((at - first) * e) };
                let mut sums = [[_mm256_setzero_ps(); BLOCK / 8]; Q];
                for c in 0..e {
                    let key = block.add(c * BLOCK);
                    let asked: [__m256; Q] = std::array::from_fn(|k| _mm256_set1_ps(q[k * e + c] * scale));
                    let key: [__m256; BLOCK / 8] = std::array::from_fn(|b| _mm256_loadu_ps(key.add(8 * b)));
                    for (asked, sums) in asked.iter().zip(&mut sums) {
                        for (key, sum) in key.iter().zip(sums) {
                            *sum = _mm256_fmadd_ps(*asked, *key, *sum);
                        }
                    }
                }
                for (k, sums) in sums.iter().enumerate() {
                    for (b, sum) in sums.iter().enumerate() {
                        _mm256_storeu_ps(scores.add(k * count + at + 8 * b), *sum);
                    }
                }
            }
            let mut share = [0.0f32; Q];
            for (k, share) in share.iter_mut().enumerate() {
                let own = std::slice::from_raw_parts_mut(scores.add(k * count), count);
                own[len..].fill(f32::NEG_INFINITY);
                *share = 1.0 / exponentials(own);
            }
            let spans = [(before.values.as_ptr(), 0..first), (own.values.as_ptr(), first..len)];
            let mut c = 0;
            while c < e {
                let (spans, to) = (spans.each_ref().map(|(v, s)| (v.add(c), s.clone())), out.as_mut_ptr().add(c));
                if c + 32 <= e {
                    weigh::<Q, U, 4>(scores, count, spans, e, share, to);
                    c += 32;
                } else {
                    weigh::<Q, U, 1>(scores, count, spans, e, share, to);
                    c += 8;
                }
            }
        }
    }

    /// Scores, of whole blocks, to e^(score - the highest); gives their sum.
    #[target_feature(enable = "avx2,fma")]
    unsafe fn exponentials(scores: &mut [f32]) -> f32 {
        let mut parts = [0.0f32; 8];
        // SAFETY: chunks are whole registers.
        unsafe {
            let mut most = _mm256_set1_ps(f32::NEG_INFINITY);
            for s in scores.chunks_exact(8) {
                most = _mm256_max_ps(most, _mm256_loadu_ps(s.as_ptr()));
            }
            _mm256_storeu_ps(parts.as_mut_ptr(), most);
            let shift = _mm256_set1_ps(parts.iter().copied().fold(f32::NEG_INFINITY, f32::max));
            let mut total = _mm256_setzero_ps();
            for s in scores.chunks_exact_mut(8) {
                let p = exp(_mm256_sub_ps(_mm256_loadu_ps(s.as_ptr()), shift));
                total = _mm256_add_ps(total, p);
                _mm256_storeu_ps(s.as_mut_ptr(), p);
            }
            _mm256_storeu_ps(parts.as_mut_ptr(), total);
        }
        parts.iter().sum()
    }

    /// N registers of the sum of values by weights [Q, count], each query's times its share. `spans`: values, and the
    /// places that they are of.
    #[target_feature(enable = "avx2,fma")]
    unsafe fn weigh<const Q: usize, const U: usize, const N: usize>(
        weights: *const f32,
        count: usize,
        spans: [(*const f32, std::ops::Range<usize>); 2],
        e: usize,
        share: [f32; Q],
        out: *mut f32,
    ) {
        // SAFETY: the places are there, by the caller.
        unsafe {
            let mut sums = [[[_mm256_setzero_ps(); N]; Q]; U];
            for (values, places) in spans {
                for at in places.clone().step_by(U) {
                    // Behind the last place, up to the end of its block, weights are 0.
                    for (u, sums) in sums.iter_mut().enumerate() {
                        let from = values.add((at - places.start + u) * e);
                        let value: [__m256; N] = std::array::from_fn(|n| _mm256_loadu_ps(from.add(8 * n)));
                        for (k, sums) in sums.iter_mut().enumerate() {
                            let weight = _mm256_broadcast_ss(&*weights.add(k * count + at + u));
                            for (value, sum) in value.iter().zip(sums) {
                                *sum = _mm256_fmadd_ps(weight, *value, *sum);
                            }
                        }
                    }
                }
            }
            for (k, share) in share.iter().enumerate() {
                for (n, first) in sums[0][k].iter().enumerate() {
                    let sum = sums[1..].iter().fold(*first, |sum, more| _mm256_add_ps(sum, more[k][n]));
                    _mm256_storeu_ps(out.add(k * e + 8 * n), _mm256_mul_ps(sum, _mm256_set1_ps(*share)));
                }
            }
        }
    }

    /// See [`super::gate`].
    #[target_feature(enable = "avx2,fma")]
    pub(super) unsafe fn gate(gates: &[f32], held: &[f32], out: &mut [f32]) {
        let (one, sign) = (_mm256_set1_ps(1.0), _mm256_set1_ps(-0.0));
        for at in (0..gates.len()).step_by(8) {
            // SAFETY: the caller has checked the sizes.
            unsafe {
                let g = _mm256_loadu_ps(gates.as_ptr().add(at));
                // e^-|g| / (1 + e^-|g|) below zero, 1 / (1 + e^-|g|) above.
                let e = exp(_mm256_or_ps(g, sign));
                let share = _mm256_div_ps(_mm256_blendv_ps(one, e, g), _mm256_add_ps(one, e));
                let held = _mm256_loadu_ps(held.as_ptr().add(at));
                _mm256_storeu_ps(out.as_mut_ptr().add(at), _mm256_mul_ps(_mm256_mul_ps(g, share), held));
            }
        }
    }

    /// e^x of x up to 0: 2^n times a polynomial of what is left, off by about 1e-7 of the value; 0 below -87.
    #[target_feature(enable = "avx2,fma")]
    fn exp(x: __m256) -> __m256 {
        let small = _mm256_cmp_ps::<_CMP_LT_OQ>(x, _mm256_set1_ps(-87.0));
        let x = _mm256_max_ps(x, _mm256_set1_ps(-87.0));
        let n = _mm256_round_ps::<{ _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC }>(_mm256_mul_ps(
            x,
            _mm256_set1_ps(std::f32::consts::LOG2_E),
        ));
        // ln 2 in two parts, so that the rest is exact.
        let rest = _mm256_fnmadd_ps(n, _mm256_set1_ps(0.693_359_4), x);
        let rest = _mm256_fnmadd_ps(n, _mm256_set1_ps(-2.121_944_4e-4), rest);
        // The series of e^rest, |rest| <= ln 2 / 2.
        let mut y = _mm256_set1_ps(1.0 / 5040.0);
        for c in [1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0] {
            y = _mm256_fmadd_ps(y, rest, _mm256_set1_ps(c));
        }
        let power = _mm256_slli_epi32::<23>(_mm256_add_epi32(_mm256_cvtps_epi32(n), _mm256_set1_epi32(127)));
        _mm256_andnot_ps(small, _mm256_mul_ps(y, _mm256_castsi256_ps(power)))
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

    #[test]
    fn products_are_those_of_the_formula_and_do_not_depend_on_the_other_rows() {
        if !is_fast() {
            return;
        }
        for (inputs, outputs) in [(16, 16), (48, 267), (5, 3), (192, 64)] {
            let (w, b) = (numbers("weights", inputs * outputs), numbers("bias", outputs));
            let panels = Panels::new(&w, &b, inputs);
            for rows in [1, 2, 6, 7, 24] {
                let x = numbers("inputs", rows * inputs);
                let (mut y, mut dealt) = (vec![0.0; rows * outputs], vec![0.0; rows * outputs]);
                panels.apply(&x, &mut y, rows);
                panels.apply_in_threads(&x, &mut dealt, rows);
                assert_eq!(y, dealt);
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
    }

    #[test]
    fn gates_and_norms_are_those_of_the_formulas() {
        let (g, held) = (numbers("gates", 64), numbers("held", 64));
        let g: Vec<f32> = g.iter().enumerate().map(|(k, x)| x * [0.1, 1.0, 10.0, 100.0][k % 4]).collect();
        let mut out = vec![0.0; 64];
        if is_fast() {
            gate(&g, &held, &mut out);
            for ((g, held), out) in g.iter().zip(&held).zip(&out) {
                let (g, held) = (f64::from(*g), f64::from(*held));
                let wanted = g / (1.0 + (-g).exp()) * held;
                assert!((f64::from(*out) - wanted).abs() < 1e-5 * wanted.abs().max(1.0), "{out} {wanted}");
            }
        }
        let gain = numbers("gain", 16);
        rms(&g, &gain, 1e-6, &mut out);
        for (x, y) in g.chunks(16).zip(out.chunks(16)) {
            let mean = x.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>() / 16.0;
            for ((x, y), gain) in x.iter().zip(y).zip(&gain) {
                let wanted = f64::from(*x) / (mean + 1e-6).sqrt() * f64::from(*gain);
                assert!((f64::from(*y) - wanted).abs() < 1e-5, "{y} {wanted}");
            }
        }
    }

    #[test]
    fn attention_is_that_of_the_formula() {
        if !is_fast() {
            return;
        }
        for (n, e, room, len) in [(1, 8, 32, 1), (2, 32, 64, 37), (3, 64, 96, 96), (1, 16, 64, 33), (4, 40, 64, 34)] {
            let (q, keys, values) = (numbers("q", n * e), numbers("keys", e * room), numbers("values", e * room));
            let mut out = vec![0.0; n * e];
            // The first block may lie elsewhere, where another follows.
            for first in [0, BLOCK].into_iter().filter(|first| *first < len) {
                let mut again = vec![0.0; n * e];
                let [before, own] = [0..first * e, first * e..room * e]
                    .map(|span| Heard { keys: &keys[span.clone()], values: &values[span] });
                attend(&q, e, before, own, len, &mut again);
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
        attend(&[1.0; 8], 8, none, Heard { keys: &keys, values: &values }, 8, &mut out);
        assert_eq!(out, values[24..32]);
    }
}
