//! The kernels, for registers of either width.

use std::arch::x86_64::{__m256, __m512};
use std::ops::Range;

use super::register::Register;
use super::{BLOCK, Heard, PANEL, Panels};

/// Whether there are registers of 256 bits, with products that add.
pub(super) fn is_fast() -> bool {
    is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")
}

/// Whether there are some of 512 bits, too.
fn is_wide() -> bool {
    #[cfg(test)]
    if NARROW.get() {
        return false;
    }
    is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512dq")
}

#[cfg(test)]
std::thread_local! {
    /// Whether tests of this thread do without registers of 512 bits.
    pub(super) static NARROW: std::cell::Cell<bool> = const { std::cell::Cell::new(false) };
}

/// Some panels' outputs of all rows: see [`Panels::span`].
///
/// # Safety
/// The processor [is fast](is_fast), x and y have so many rows, and the panels are there.
pub(super) unsafe fn span(of: &Panels, x: &[f32], y: *mut f32, rows: usize, panels: Range<usize>) {
    #[target_feature(enable = "avx2,fma")]
    unsafe fn of_256(of: &Panels, x: &[f32], y: *mut f32, rows: usize, panels: Range<usize>) {
        unsafe { spanned::<__m256, 2, 4, 1, 6>(of, x, y, rows, panels) }
    }
    #[target_feature(enable = "avx512f,avx512dq")]
    unsafe fn of_512(of: &Panels, x: &[f32], y: *mut f32, rows: usize, panels: Range<usize>) {
        unsafe { spanned::<__m512, 1, 8, 2, 12>(of, x, y, rows, panels) }
    }
    // SAFETY: the processor was asked.
    unsafe { if is_wide() { of_512(of, x, y, rows, panels) } else { of_256(of, x, y, rows, panels) } }
}

/// Queries over keys and values: see [`super::attend`].
///
/// # Safety
/// The processor [is fast](is_fast), the heads' width e is a multiple of eight, and the first `len` places are there.
pub(super) unsafe fn attend(
    q: &[f32],
    e: usize,
    heard: [Heard<'_>; 2],
    len: usize,
    scores: &mut Vec<f32>,
    out: &mut [f32],
) {
    #[target_feature(enable = "avx2,fma")]
    unsafe fn of_256(q: &[f32], e: usize, heard: [Heard<'_>; 2], len: usize, s: &mut Vec<f32>, out: &mut [f32]) {
        // Two queries meet a key, or a value, once it is in a register; one alone takes two places at a time.
        unsafe {
            if q.len() == e {
                attended::<__m256, 1, 2, 1, 4, 4>(q, heard, len, s, out);
            } else {
                attended::<__m256, 2, 1, 1, 4, 4>(q, heard, len, s, out);
            }
        }
    }
    #[target_feature(enable = "avx512f,avx512dq")]
    unsafe fn of_512(q: &[f32], e: usize, heard: [Heard<'_>; 2], len: usize, s: &mut Vec<f32>, out: &mut [f32]) {
        // Half as many registers hold as many numbers: twice as many places keep as many sums going.
        unsafe {
            if q.len() == e {
                attended::<__m512, 1, 4, 2, 2, 2>(q, heard, len, s, out);
            } else {
                attended::<__m512, 2, 2, 2, 2, 2>(q, heard, len, s, out);
            }
        }
    }
    let wide = e.is_multiple_of(<__m512 as Register>::LANES) && is_wide();
    for (q, out) in q.chunks(2 * e).zip(out.chunks_mut(2 * e)) {
        // SAFETY: the processor was asked.
        unsafe { if wide { of_512(q, e, heard, len, scores, out) } else { of_256(q, e, heard, len, scores, out) } }
    }
}

/// silu(gates) · held: see [`super::gate`].
///
/// # Safety
/// The processor [is fast](is_fast), and all are as long, a multiple of eight.
pub(super) unsafe fn gate(gates: &[f32], held: &[f32], out: &mut [f32]) {
    #[target_feature(enable = "avx2,fma")]
    unsafe fn of_256(gates: &[f32], held: &[f32], out: &mut [f32]) {
        unsafe { gated::<__m256>(gates, held, out) }
    }
    #[target_feature(enable = "avx512f,avx512dq")]
    unsafe fn of_512(gates: &[f32], held: &[f32], out: &mut [f32]) {
        unsafe { gated::<__m512>(gates, held, out) }
    }
    let wide = gates.len().is_multiple_of(<__m512 as Register>::LANES) && is_wide();
    // SAFETY: the processor was asked.
    unsafe { if wide { of_512(gates, held, out) } else { of_256(gates, held, out) } }
}

/// H registers are a panel; one row takes ONE panels at a time, several take MANY, up to ROWS of them together.
#[inline(always)]
unsafe fn spanned<V: Register, const H: usize, const ONE: usize, const MANY: usize, const ROWS: usize>(
    of: &Panels,
    x: &[f32],
    y: *mut f32,
    rows: usize,
    span: Range<usize>,
) {
    let mut panel = span.start;
    // SAFETY: rows and panels are there, by the caller.
    unsafe {
        if rows == 1 {
            while panel + ONE <= span.end {
                panels::<V, H, 1, ONE>(of, x, y, 0, panel);
                panel += ONE;
            }
            (panel..span.end).for_each(|panel| panels::<V, H, 1, 1>(of, x, y, 0, panel));
            return;
        }
        while panel + MANY <= span.end {
            all_rows::<V, H, MANY, ROWS>(of, x, y, rows, panel);
            panel += MANY;
        }
        while panel < span.end {
            all_rows::<V, H, 1, ROWS>(of, x, y, rows, panel);
            panel += 1;
        }
    }
}

/// All rows, P panels from `panel` on.
#[inline(always)]
unsafe fn all_rows<V: Register, const H: usize, const P: usize, const ROWS: usize>(
    of: &Panels,
    x: &[f32],
    y: *mut f32,
    rows: usize,
    panel: usize,
) {
    // As equal parts as go: one row left over would cost as much as four.
    let each = rows.div_ceil(rows.div_ceil(ROWS).max(1));
    let mut row = 0;
    while row < rows {
        // SAFETY: as the caller's.
        unsafe {
            match (rows - row).min(each) {
                1 => panels::<V, H, 1, P>(of, x, y, row, panel),
                2 => panels::<V, H, 2, P>(of, x, y, row, panel),
                3 => panels::<V, H, 3, P>(of, x, y, row, panel),
                4 => panels::<V, H, 4, P>(of, x, y, row, panel),
                5 => panels::<V, H, 5, P>(of, x, y, row, panel),
                7 if ROWS > 6 => panels::<V, H, 7, P>(of, x, y, row, panel),
                8 if ROWS > 6 => panels::<V, H, 8, P>(of, x, y, row, panel),
                9 if ROWS > 6 => panels::<V, H, 9, P>(of, x, y, row, panel),
                10 if ROWS > 6 => panels::<V, H, 10, P>(of, x, y, row, panel),
                11 if ROWS > 6 => panels::<V, H, 11, P>(of, x, y, row, panel),
                12 if ROWS > 6 => panels::<V, H, 12, P>(of, x, y, row, panel),
                _ => panels::<V, H, 6, P>(of, x, y, row, panel),
            }
        }
        row += each;
    }
}

/// R rows from `row` on, P panels from `panel` on.
#[inline(always)]
unsafe fn panels<V: Register, const H: usize, const R: usize, const P: usize>(
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
        let mut sums = [[[V::all(0.0); H]; P]; R];
        for sums in &mut sums {
            for (p, sums) in sums.iter_mut().enumerate() {
                for (h, sum) in sums.iter_mut().enumerate() {
                    *sum = V::load(of.bias.as_ptr().add((panel + p) * PANEL + V::LANES * h));
                }
            }
        }
        for k in 0..inputs {
            let mut weights = [[V::all(0.0); H]; P];
            for (p, weights) in weights.iter_mut().enumerate() {
                for (h, weight) in weights.iter_mut().enumerate() {
                    *weight = V::load(w.add((p * inputs + k) * PANEL + V::LANES * h));
                }
            }
            for (r, sums) in sums.iter_mut().enumerate() {
                let x = V::all(*x.add(r * inputs + k));
                for (weights, sums) in weights.iter().zip(sums) {
                    for (weight, sum) in weights.iter().zip(sums) {
                        *sum = x.mul_add(*weight, *sum);
                    }
                }
            }
        }
        for (r, sums) in sums.iter().enumerate() {
            for (p, sums) in sums.iter().enumerate() {
                let start = (panel + p) * PANEL;
                let to = y.add((row + r) * outputs + start);
                if start + PANEL <= outputs {
                    sums.iter().enumerate().for_each(|(h, sum)| sum.store(to.add(V::LANES * h)));
                } else {
                    let mut all = [0.0f32; PANEL];
                    sums.iter().enumerate().for_each(|(h, sum)| sum.store(all.as_mut_ptr().add(V::LANES * h)));
                    std::ptr::copy_nonoverlapping(all.as_ptr(), to, outputs - start);
                }
            }
        }
    }
}

/// Q queries; of keys B blocks at a time, S registers each, of values U places at a time, of 32 of their numbers N
/// registers.
#[inline(always)]
unsafe fn attended<V: Register, const Q: usize, const U: usize, const B: usize, const S: usize, const N: usize>(
    q: &[f32],
    heard: [Heard<'_>; 2],
    len: usize,
    scores: &mut Vec<f32>,
    out: &mut [f32],
) {
    let e = q.len() / Q;
    let first = heard[0].keys.len() / e;
    let count = len.next_multiple_of(BLOCK);
    // All are written before they are read.
    scores.resize(scores.len().max(Q * count), 0.0);
    let scores = &mut scores[..Q * count];
    let scale = 1.0 / (e as f32).sqrt();
    // SAFETY: `count` is at most the room of both, which are whole blocks; a head's numbers are whole registers.
    unsafe {
        let to = scores.as_mut_ptr();
        let mut at = 0;
        while at + B * BLOCK <= count {
            blocks::<V, Q, B, S>(q, scale, heard, first, at, to, count);
            at += B * BLOCK;
        }
        while at < count {
            blocks::<V, Q, 1, S>(q, scale, heard, first, at, to, count);
            at += BLOCK;
        }
        let mut share = [0.0f32; Q];
        for (own, share) in scores.chunks_exact_mut(count).zip(&mut share) {
            own[len..].fill(f32::NEG_INFINITY);
            *share = 1.0 / exponentials::<V>(own);
        }
        let scores = scores.as_ptr();
        let [before, own] = heard.map(|heard| heard.values.as_ptr());
        let mut c = 0;
        while c < e {
            let (spans, to) = ([(before.add(c), 0..first), (own.add(c), first..len)], out.as_mut_ptr().add(c));
            if c + 32 <= e {
                weigh::<V, Q, U, N>(scores, count, spans, e, share, to);
                c += 32;
            } else {
                weigh::<V, Q, U, 1>(scores, count, spans, e, share, to);
                c += V::LANES;
            }
        }
    }
}

/// Scores [Q, count] of B blocks from place `at` on.
#[inline(always)]
unsafe fn blocks<V: Register, const Q: usize, const B: usize, const S: usize>(
    q: &[f32],
    scale: f32,
    heard: [Heard<'_>; 2],
    first: usize,
    at: usize,
    scores: *mut f32,
    count: usize,
) {
    let e = q.len() / Q;
    // SAFETY: the blocks are there, by the caller.
    unsafe {
        let mut keys = [std::ptr::null(); B];
        for (b, keys) in keys.iter_mut().enumerate() {
            let at = at + b * BLOCK;
            *keys = if at < first {
                heard[0].keys.as_ptr().add(at * e)
            } else {
                heard[1].keys.as_ptr().add((at - first) * e)
            };
        }
        let mut sums = [[[V::all(0.0); S]; B]; Q];
        for c in 0..e {
            let mut key = [[V::all(0.0); S]; B];
            for (keys, key) in keys.iter().zip(&mut key) {
                for (s, key) in key.iter_mut().enumerate() {
                    *key = V::load(keys.add(c * BLOCK + V::LANES * s));
                }
            }
            for (k, sums) in sums.iter_mut().enumerate() {
                let asked = V::all(q[k * e + c] * scale);
                for (key, sums) in key.iter().zip(sums) {
                    for (key, sum) in key.iter().zip(sums) {
                        *sum = asked.mul_add(*key, *sum);
                    }
                }
            }
        }
        for (k, sums) in sums.iter().enumerate() {
            for (b, sums) in sums.iter().enumerate() {
                for (s, sum) in sums.iter().enumerate() {
                    sum.store(scores.add(k * count + at + b * BLOCK + V::LANES * s));
                }
            }
        }
    }
}

/// Scores, of whole blocks, to e^(score - the highest); gives their sum.
#[inline(always)]
unsafe fn exponentials<V: Register>(scores: &mut [f32]) -> f32 {
    let mut parts = [0.0f32; PANEL];
    let parts = &mut parts[..V::LANES];
    // SAFETY: chunks are whole registers.
    unsafe {
        let mut most = V::all(f32::NEG_INFINITY);
        for s in scores.chunks_exact(V::LANES) {
            most = most.max(V::load(s.as_ptr()));
        }
        most.store(parts.as_mut_ptr());
        let shift = V::all(-parts.iter().copied().fold(f32::NEG_INFINITY, f32::max));
        let mut total = V::all(0.0);
        for s in scores.chunks_exact_mut(V::LANES) {
            let p = exp(V::load(s.as_ptr()).add(shift));
            total = total.add(p);
            p.store(s.as_mut_ptr());
        }
        sum(total)
    }
}

/// N registers of the sum of values by weights [Q, count], each query's times its share. `spans`: values, and the
/// places that they are of.
#[inline(always)]
unsafe fn weigh<V: Register, const Q: usize, const U: usize, const N: usize>(
    weights: *const f32,
    count: usize,
    spans: [(*const f32, Range<usize>); 2],
    e: usize,
    share: [f32; Q],
    out: *mut f32,
) {
    // SAFETY: the places are there, by the caller.
    unsafe {
        let mut sums = [[[V::all(0.0); N]; Q]; U];
        for (values, places) in spans {
            for at in places.clone().step_by(U) {
                // Behind the last place, up to the end of its block, weights are 0.
                for (u, sums) in sums.iter_mut().enumerate() {
                    let from = values.add((at - places.start + u) * e);
                    let mut value = [V::all(0.0); N];
                    value.iter_mut().enumerate().for_each(|(n, value)| *value = V::load(from.add(V::LANES * n)));
                    for (k, sums) in sums.iter_mut().enumerate() {
                        let weight = V::all(*weights.add(k * count + at + u));
                        for (value, sum) in value.iter().zip(sums) {
                            *sum = weight.mul_add(*value, *sum);
                        }
                    }
                }
            }
        }
        for (k, share) in share.iter().enumerate() {
            for n in 0..N {
                let mut sum = sums[0][k][n];
                sums[1..].iter().for_each(|more| sum = sum.add(more[k][n]));
                sum.mul(V::all(*share)).store(out.add(k * e + V::LANES * n));
            }
        }
    }
}

/// The norm of each row of x by gain and bias: see [`super::norm`].
///
/// # Safety
/// The processor [is fast](is_fast), gain and bias are as long, a multiple of eight, and x and y are such rows.
pub(super) unsafe fn norm(x: &[f32], gain: &[f32], bias: &[f32], eps: f32, y: &mut [f32]) {
    #[target_feature(enable = "avx2,fma")]
    unsafe fn of_256(x: &[f32], gain: &[f32], bias: &[f32], eps: f32, y: &mut [f32]) {
        unsafe { normed::<__m256>(x, gain, bias, eps, y) }
    }
    #[target_feature(enable = "avx512f,avx512dq")]
    unsafe fn of_512(x: &[f32], gain: &[f32], bias: &[f32], eps: f32, y: &mut [f32]) {
        unsafe { normed::<__m512>(x, gain, bias, eps, y) }
    }
    let wide = gain.len().is_multiple_of(<__m512 as Register>::LANES) && is_wide();
    // SAFETY: the processor was asked.
    unsafe { if wide { of_512(x, gain, bias, eps, y) } else { of_256(x, gain, bias, eps, y) } }
}

/// The root-mean-square norm of each row of x: see [`super::rms`].
///
/// # Safety
/// As [`norm`], without a bias.
pub(super) unsafe fn rms(x: &[f32], gain: &[f32], eps: f32, y: &mut [f32]) {
    #[target_feature(enable = "avx2,fma")]
    unsafe fn of_256(x: &[f32], gain: &[f32], eps: f32, y: &mut [f32]) {
        unsafe { rooted::<__m256>(x, gain, eps, y) }
    }
    #[target_feature(enable = "avx512f,avx512dq")]
    unsafe fn of_512(x: &[f32], gain: &[f32], eps: f32, y: &mut [f32]) {
        unsafe { rooted::<__m512>(x, gain, eps, y) }
    }
    let wide = gain.len().is_multiple_of(<__m512 as Register>::LANES) && is_wide();
    // SAFETY: the processor was asked.
    unsafe { if wide { of_512(x, gain, eps, y) } else { of_256(x, gain, eps, y) } }
}

#[inline(always)]
unsafe fn normed<V: Register>(x: &[f32], gain: &[f32], bias: &[f32], eps: f32, y: &mut [f32]) {
    let d = gain.len();
    // SAFETY: rows are whole registers, by the caller.
    unsafe {
        for (x, y) in x.chunks_exact(d).zip(y.chunks_exact_mut(d)) {
            let mut total = V::all(0.0);
            for x in x.chunks_exact(V::LANES) {
                total = total.add(V::load(x.as_ptr()));
            }
            let minus_mean = V::all(-(sum(total) / d as f32));
            let mut total = V::all(0.0);
            for x in x.chunks_exact(V::LANES) {
                let off = V::load(x.as_ptr()).add(minus_mean);
                total = total.add(off.mul(off));
            }
            let scale = V::all(1.0 / (sum(total) / d as f32 + eps).sqrt());
            for at in (0..d).step_by(V::LANES) {
                let off = V::load(x.as_ptr().add(at)).add(minus_mean).mul(scale);
                let (gain, bias) = (V::load(gain.as_ptr().add(at)), V::load(bias.as_ptr().add(at)));
                off.mul(gain).add(bias).store(y.as_mut_ptr().add(at));
            }
        }
    }
}

#[inline(always)]
unsafe fn rooted<V: Register>(x: &[f32], gain: &[f32], eps: f32, y: &mut [f32]) {
    let d = gain.len();
    // SAFETY: rows are whole registers, by the caller.
    unsafe {
        for (x, y) in x.chunks_exact(d).zip(y.chunks_exact_mut(d)) {
            let mut total = V::all(0.0);
            for x in x.chunks_exact(V::LANES) {
                let x = V::load(x.as_ptr());
                total = total.add(x.mul(x));
            }
            let scale = V::all(1.0 / (sum(total) / d as f32 + eps).sqrt());
            for at in (0..d).step_by(V::LANES) {
                let scaled = V::load(x.as_ptr().add(at)).mul(scale);
                scaled.mul(V::load(gain.as_ptr().add(at))).store(y.as_mut_ptr().add(at));
            }
        }
    }
}

/// The sum of a register's numbers.
#[inline(always)]
unsafe fn sum<V: Register>(x: V) -> f32 {
    let mut parts = [0.0f32; PANEL];
    // SAFETY: no register is longer.
    unsafe { x.store(parts.as_mut_ptr()) };
    parts[..V::LANES].iter().sum()
}

#[inline(always)]
unsafe fn gated<V: Register>(gates: &[f32], held: &[f32], out: &mut [f32]) {
    // SAFETY: the caller has checked the sizes.
    unsafe {
        let one = V::all(1.0);
        for at in (0..gates.len()).step_by(V::LANES) {
            let g = V::load(gates.as_ptr().add(at));
            // e^-|g| / (1 + e^-|g|) below zero, 1 / (1 + e^-|g|) above.
            let e = exp(g.where_negative(g, g.mul(V::all(-1.0))));
            let share = g.where_negative(e, one).div(one.add(e));
            g.mul(share).mul(V::load(held.as_ptr().add(at))).store(out.as_mut_ptr().add(at));
        }
    }
}

/// e^x of x up to 0: 2^n times a polynomial of what is left, off by about 1e-7 of the value; 0 below -87.
#[inline(always)]
unsafe fn exp<V: Register>(x: V) -> V {
    // SAFETY: the caller has these registers.
    unsafe {
        let least = V::all(-87.0);
        let held = x.max(least);
        let n = held.mul(V::all(std::f32::consts::LOG2_E)).round();
        // ln 2 in two parts, so that the rest is exact.
        let rest = n.mul_add(V::all(-0.693_359_4), held);
        let rest = n.mul_add(V::all(2.121_944_4e-4), rest);
        // The series of e^rest, |rest| <= ln 2 / 2.
        let mut y = V::all(1.0 / 5040.0);
        for c in [1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0] {
            y = y.mul_add(rest, V::all(c));
        }
        y.scale(n).unless_below(x, least)
    }
}
