//! Attention of packed sequences.

use std::os::raw::c_int;
use std::ptr::null_mut;

use tch::Tensor;
use torch_sys::C_tensor;

use crate::TorchError;
use crate::error::check;

unsafe extern "C" {
    fn rl_packed_attention(qkv: *const *const C_tensor, spans: *const i64, n: usize, out: *mut *mut C_tensor) -> c_int;
    fn rl_flash_attention(qkv: *const *const C_tensor, lengths: *const i64, n: usize, out: *mut *mut C_tensor)
    -> c_int;
}

/// Where a sequence lies among packed rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Span {
    /// Its rows; they follow those of the sequence before it.
    pub rows: i64,
    /// First row and number of rows of an earlier sequence that it goes on from.
    pub behind: Option<(i64, i64)>,
}

/// softmax(q kᵀ / √e) v of packed sequences, q [T, h, e] over k and v [T, g, e] to [T, h, e], each g-th part of the heads
/// of queries over one head of keys. A row sees the rows that its sequence goes on from, and its sequence up to itself.
///
/// Each sequence is a task by itself, forwards and backwards, and where there are few each head of one: the products of a
/// task are too small for threads to share. Results do not depend on the number of threads. Between the passes it holds
/// q, k, v and the scores after the softmax; it has no second derivative.
///
/// # Errors
/// libtorch's message; when spans and tensors do not fit.
pub fn packed_attention(q: &Tensor, k: &Tensor, v: &Tensor, spans: &[Span]) -> Result<Tensor, TorchError> {
    let mut first = 0;
    let mut numbers = Vec::with_capacity(4 * spans.len());
    for span in spans {
        let (before, seen) = span.behind.unwrap_or((0, 0));
        numbers.extend([first, span.rows, before, seen]);
        first += span.rows;
    }
    let inputs = [q, k, v].map(Tensor::as_ptr);
    let mut out = null_mut();
    // SAFETY: three live tensors, four numbers a span, and a place for the result.
    check(unsafe { rl_packed_attention(inputs.as_ptr(), numbers.as_ptr(), spans.len(), &mut out) })?;
    // SAFETY: made by `new` for the caller, on success alone.
    Ok(unsafe { Tensor::from_ptr(out) })
}

/// As [`packed_attention`], on GPUs in 16 bits, of sequences of these lengths that go on from nothing: one kernel for all,
/// where each by itself takes as many as it has ops.
///
/// # Errors
/// libtorch's message; of GPUs and widths that there is no such kernel for.
pub fn flash_attention(q: &Tensor, k: &Tensor, v: &Tensor, lengths: &[i64]) -> Result<Tensor, TorchError> {
    let [q, k, v] = [q, k, v].map(Tensor::contiguous);
    let inputs = [&q, &k, &v].map(Tensor::as_ptr);
    let mut out = null_mut();
    // SAFETY: three live tensors, a number a sequence, and a place for the result.
    check(unsafe { rl_flash_attention(inputs.as_ptr(), lengths.as_ptr(), lengths.len(), &mut out) })?;
    // SAFETY: made by `new` for the caller, on success alone.
    Ok(unsafe { Tensor::from_ptr(out) })
}

#[cfg(test)]
mod tests {
    use tch::{Device, Kind};

    use super::*;

    /// What each sequence comes to by itself, by the formula.
    fn plain(q: &Tensor, k: &Tensor, v: &Tensor, spans: &[Span]) -> Tensor {
        let (group, scale) = (q.size()[1] / k.size()[1], (q.size()[2] as f64).sqrt());
        let mut first = 0;
        let one = |span: &Span| {
            let rows = |x: &Tensor| {
                let own = x.narrow(0, first, span.rows);
                let all = match span.behind {
                    Some((from, n)) => Tensor::cat(&[x.narrow(0, from, n), own], 0),
                    None => own,
                };
                all.repeat_interleave_self_int(group, 1, None::<i64>).transpose(0, 1)
            };
            let (own, keys, values) = (q.narrow(0, first, span.rows).transpose(0, 1), rows(k), rows(v));
            first += span.rows;
            let scores = own.matmul(&keys.transpose(1, 2)) / scale;
            let [t, s] = [scores.size()[1], scores.size()[2]];
            let hidden = Tensor::ones([t, s], (Kind::Bool, Device::Cpu)).triu(s - t + 1);
            scores.masked_fill(&hidden, f64::NEG_INFINITY).softmax(-1, None::<Kind>).matmul(&values).transpose(0, 1)
        };
        Tensor::cat(&spans.iter().map(one).collect::<Vec<_>>(), 0)
    }

    /// The result and the gradients of a sum of it.
    fn passed(of: impl Fn(&Tensor, &Tensor, &Tensor) -> Tensor, inputs: &[Tensor; 3], kind: Kind) -> [Tensor; 4] {
        let [q, k, v] = inputs.each_ref().map(|x| x.to_kind(kind).set_requires_grad(true));
        let out = of(&q, &k, &v);
        let weight = (Tensor::arange(out.numel() as i64, (Kind::Float, Device::Cpu)) * 0.7).sin().view_as(&out);
        let loss = (out.to_kind(Kind::Float) * weight).sum(Kind::Float);
        let [dq, dk, dv] = Tensor::run_backward(&[loss], &[&q, &k, &v], false, false).try_into().unwrap();
        [out.detach(), dq, dk, dv]
    }

    fn spans() -> Vec<Span> {
        let alone = |rows| Span { rows, behind: None };
        let after = |rows, behind| Span { rows, behind: Some(behind) };
        // Of several runs of queries, of one exactly (kRun of attention.cpp), of one row; three that go on from the first
        // and one from the fourth. As many as are not shared head by head (kFew).
        vec![
            alone(520),
            alone(256),
            alone(1),
            alone(40),
            after(17, (0, 520)),
            after(300, (0, 520)),
            after(256, (0, 520)),
            after(9, (777, 40)),
            alone(30),
        ]
    }

    fn inputs(heads: i64, shared: i64, spans: &[Span]) -> [Tensor; 3] {
        tch::manual_seed(1);
        let rows = spans.iter().map(|s| s.rows).sum();
        let of = |heads| Tensor::randn([rows, heads, 16], (Kind::Float, Device::Cpu));
        [of(heads), of(shared), of(shared)]
    }

    #[test]
    fn it_is_the_formula_with_its_gradients() {
        let (all, few) = (spans(), &spans()[..6]);
        for (heads, shared, spans) in [(3, 3, &all[..]), (4, 2, &all), (3, 1, &all), (3, 3, few), (4, 2, few)] {
            let inputs = inputs(heads, shared, spans);
            let exact = passed(|q, k, v| plain(q, k, v, spans), &inputs, Kind::Double);
            for (kind, most) in [(Kind::Double, 1e-12), (Kind::Float, 1e-5), (Kind::BFloat16, 0.02)] {
                let found = passed(|q, k, v| packed_attention(q, k, v, spans).unwrap(), &inputs, kind);
                for (name, (found, exact)) in ["out", "dq", "dk", "dv"].iter().zip(found.iter().zip(&exact)) {
                    assert_eq!(found.kind(), kind);
                    let off = ((found.to_kind(Kind::Double) - exact).norm() / exact.norm()).double_value(&[]);
                    assert!(off < most, "{name} of {heads} over {shared} heads, {kind:?}: {off}");
                }
            }
        }
    }

    #[test]
    fn gradients_stop_where_nothing_asks_and_parts_that_do_not_fit_are_refused() {
        let spans = spans();
        let [q, k, v] = inputs(2, 2, &spans);
        assert!(!packed_attention(&q, &k, &v, &spans).unwrap().requires_grad());
        let values = v.set_requires_grad(true);
        let sum = packed_attention(&q, &k, &values, &spans).unwrap().sum(Kind::Float);
        assert_eq!(Tensor::run_backward(&[sum], &[&values], false, false)[0].size(), values.size());
        let short = packed_attention(&q, &k, &values, &spans[..2]).unwrap_err().to_string();
        assert!(short.contains("rows in all"), "{short}");
        let ahead = [Span { rows: 5, behind: Some((4, 3)) }];
        let five = q.narrow(0, 0, 5);
        assert!(packed_attention(&five, &five, &five, &ahead).unwrap_err().to_string().contains("sequence 0"));
    }

    #[test]
    fn threads_change_nothing_and_parts_of_one_tensor_will_do() {
        for spans in [&spans()[..], &spans()[..2]] {
            let [q, k, v] = inputs(2, 2, spans);
            // As a layer has them: three parts of one product.
            let all = Tensor::stack(&[q, k, v], 1).to_kind(Kind::BFloat16);
            let of = |threads| {
                tch::set_num_threads(threads);
                let all = all.detach().set_requires_grad(true);
                let parts = all.unbind(1);
                let out = packed_attention(&parts[0], &parts[1], &parts[2], spans).unwrap();
                let grad = Tensor::run_backward(&[out.sin().sum(Kind::Float)], &[&all], false, false).remove(0);
                (out.detach(), grad)
            };
            let threads = tch::get_num_threads();
            let (one, three) = (of(1), of(3));
            tch::set_num_threads(threads);
            assert_eq!(one, three);
        }
    }

    #[test]
    fn its_products_are_counted_on_all_threads() {
        let spans = [Span { rows: 20, behind: None }; 8];
        let q = Tensor::randn([160, 2, 16], (Kind::Float, Device::Cpu)).set_requires_grad(true);
        let _counted = crate::flops::COUNTED.lock().unwrap_or_else(|e| e.into_inner());
        let (out, forward) = crate::count_flops(|| packed_attention(&q, &q, &q, &spans).unwrap()).unwrap();
        assert_eq!(forward, 8 * 2 * 2 * 2 * 20 * 20 * 16);
        let sum = out.sum(Kind::Float);
        let (_, backward) = crate::count_flops(|| Tensor::run_backward(&[sum], &[&q], false, false)).unwrap();
        assert_eq!(backward, 2 * forward);
    }
}
