//! Sequences of several lengths one after another, without padding.

use riglab_torch::{Span, flash_attention, packed_attention};
use tch::{Device, Kind, Tensor};

use crate::layers::{mix, shared_heads};

/// Where each sequence lies among the rows of a packed tensor [T, d].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Packed {
    lengths: Vec<i64>,
    /// Of each, the one that it goes on from, which stands among those before it and begins by itself.
    behind: Vec<Option<usize>>,
}

impl Packed {
    /// Of these lengths.
    pub fn new(lengths: Vec<i64>) -> Self {
        Self { behind: vec![None; lengths.len()], lengths }
    }

    /// So many prefixes of `p` rows each, and after them all sequences of these lengths, each of which goes on from the
    /// prefix that `of` names. A prefix that several share is read once: a causal decoder gives it the same for all.
    pub fn behind(prefixes: usize, p: i64, of: &[usize], lengths: &[i64]) -> Self {
        let lengths = std::iter::repeat_n(p, prefixes).chain(lengths.iter().copied()).collect();
        Self { lengths, behind: std::iter::repeat_n(None, prefixes).chain(of.iter().copied().map(Some)).collect() }
    }

    /// The lengths.
    pub fn lengths(&self) -> &[i64] {
        &self.lengths
    }

    /// Rows in all.
    pub fn rows(&self) -> i64 {
        self.lengths.iter().sum()
    }

    /// The place of every row in its sequence, [T].
    pub fn places(&self) -> Vec<i64> {
        let first = |behind: &Option<usize>| behind.map_or(0, |k| self.lengths[k]);
        self.lengths.iter().zip(&self.behind).flat_map(|(&n, behind)| (first(behind)..).take(n as usize)).collect()
    }

    /// x [T, ..] apart by sequence.
    pub fn apart(&self, x: &Tensor) -> Vec<Tensor> {
        x.split_with_sizes(&self.lengths, 0)
    }

    /// Attention within each sequence: queries [T, h, e] over keys and values [T, g, e], a g-th of the heads of queries
    /// over each head of keys, to [T, h, e]. A row sees its sequence up to itself, and what that goes on from.
    ///
    /// In bfloat16 on the CPU sequences are shared among threads ([`packed_attention`]): of one alone the products are
    /// small. On a GPU there is a kernel for all of them ([`flash_attention`]), if none goes on from another. Elsewhere
    /// libtorch's fused kernel takes one sequence after another.
    pub(super) fn attend(&self, q: &Tensor, k: &Tensor, v: &Tensor) -> Tensor {
        if q.kind() == Kind::BFloat16 && q.device() == Device::Cpu {
            return packed_attention(q, k, v, &self.spans()).unwrap_or_else(|e| panic!("{e}"));
        }
        let half = matches!(q.kind(), Kind::BFloat16 | Kind::Half);
        // Not on all GPUs, nor for heads of all widths.
        if half
            && q.device() != Device::Cpu
            && self.behind.iter().all(Option::is_none)
            && let Ok(read) = flash_attention(q, k, v, &self.lengths)
        {
            return read;
        }
        let group = q.size()[1] / k.size()[1];
        // [t, h, e] as one batch row of heads.
        let row = |x: Tensor| x.transpose(0, 1).unsqueeze(0);
        let shared = |x: Tensor| shared_heads(&row(x), group);
        let parts = self.apart(q).into_iter().zip(self.seen(k)).zip(self.seen(v));
        let parts = parts.map(|((q, k), v)| mix(&row(q), &shared(k), &shared(v), true).squeeze_dim(0).transpose(0, 1));
        Tensor::cat(&parts.collect::<Vec<_>>(), 0)
    }

    fn spans(&self) -> Vec<Span> {
        let firsts: Vec<i64> =
            self.lengths.iter().scan(0, |next, n| Some(std::mem::replace(next, *next + n))).collect();
        let behind = |k: &Option<usize>| k.map(|k| (firsts[k], self.lengths[k]));
        self.lengths.iter().zip(&self.behind).map(|(&rows, k)| Span { rows, behind: behind(k) }).collect()
    }

    /// As [`Self::apart`], each with the rows of what it goes on from before its own: keys and values that its queries
    /// may see.
    fn seen(&self, x: &Tensor) -> Vec<Tensor> {
        let own = self.apart(x);
        let whole = |(k, behind): (usize, &Option<usize>)| match behind {
            Some(before) => Tensor::cat(&[&own[*before], &own[k]], 0),
            None => own[k].shallow_clone(),
        };
        self.behind.iter().enumerate().map(whole).collect()
    }
}

#[cfg(test)]
mod tests {
    use tch::{Device, Kind};

    use super::*;

    #[test]
    fn sequences_go_on_from_their_prefixes() {
        let packed = Packed::behind(2, 3, &[1, 0, 1], &[2, 1, 4]);
        assert_eq!((packed.rows(), packed.lengths()), (13, &[3, 3, 2, 1, 4][..]));
        assert_eq!(packed.places(), [0, 1, 2, 0, 1, 2, 3, 4, 3, 3, 4, 5, 6]);
        let x = Tensor::arange(13, (Kind::Int64, Device::Cpu));
        let seen: Vec<Vec<i64>> = packed.seen(&x).iter().map(|t| Vec::try_from(t).unwrap()).collect();
        let wanted: [&[i64]; 5] = [&[0, 1, 2], &[3, 4, 5], &[3, 4, 5, 6, 7], &[0, 1, 2, 8], &[3, 4, 5, 9, 10, 11, 12]];
        assert_eq!(seen, wanted);
    }
}
