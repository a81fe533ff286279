//! Coarser and finer clouds along the curves. The released skin model leaves them out: all its stages are at
//! full resolution.

use tch::{Device, Tensor};

use super::curves::Curve;
use super::layout::order;
use crate::layers::{LayerNorm, Linear};
use crate::params::{Role, Scope, Weights};

/// A cloud on a lattice, along some curves.
#[derive(Clone, Debug, PartialEq)]
pub struct Pooled {
    /// The cell of each point.
    pub cells: Vec<[u32; 3]>,
    /// The cloud of each point.
    pub batch: Vec<usize>,
    /// By curve, the code of each point.
    pub codes: Vec<Vec<i64>>,
    /// By curve, the points in order.
    pub orders: Vec<Vec<i64>>,
    /// Bits an axis.
    pub bits: u32,
    /// Of each point of the finer cloud, the point it went into; empty for the finest.
    pub cluster: Vec<i64>,
}

impl Pooled {
    /// The finest cloud: points in cells, along curves.
    pub fn finest(cells: Vec<[u32; 3]>, batch: Vec<usize>, curves: &[Curve]) -> Self {
        let most = cells.iter().flatten().copied().max().unwrap_or(0);
        let bits = (u32::BITS - most.leading_zeros()).max(1);
        let of = |curve: &Curve| cells.iter().zip(&batch).map(|(c, b)| curve.code(*c, *b, bits)).collect::<Vec<_>>();
        let codes: Vec<Vec<i64>> = curves.iter().map(of).collect();
        let orders = codes.iter().map(|c| order(c)).collect();
        Self { cells, batch, codes, orders, bits, cluster: Vec::new() }
    }

    /// The cloud of cells 2^`halvings` times as large: what shares one is one point. Points come in the order of
    /// the first curve; the first point of each stands for it.
    pub fn coarser(&self, halvings: u32) -> Self {
        let halvings = halvings.min(self.bits);
        let up = |code: i64| code >> (3 * halvings);
        let n = self.cells.len();
        let mut cluster = vec![0; n];
        let mut heads: Vec<usize> = Vec::new();
        for &i in &self.orders[0] {
            let i = i as usize;
            let new = heads.last().is_none_or(|&h| up(self.codes[0][h]) != up(self.codes[0][i]));
            if new {
                heads.push(i);
            }
            cluster[i] = heads.len() as i64 - 1;
        }
        let codes: Vec<Vec<i64>> =
            self.codes.iter().map(|codes| heads.iter().map(|&h| up(codes[h])).collect()).collect();
        Self {
            cells: heads.iter().map(|&h| self.cells[h].map(|c| c >> halvings)).collect(),
            batch: heads.iter().map(|&h| self.batch[h]).collect(),
            orders: codes.iter().map(|c| order(c)).collect(),
            codes,
            bits: self.bits - halvings,
            cluster,
        }
    }

    /// The points of each cluster, all clusters filled up to the size of the largest by their first point.
    fn members(&self) -> Vec<i64> {
        let mut of = vec![Vec::new(); self.cells.len()];
        self.cluster.iter().enumerate().for_each(|(i, &c)| of[c as usize].push(i as i64));
        let most = of.iter().map(Vec::len).max().unwrap_or(0);
        of.iter().flat_map(|own| (0..most).map(|k| *own.get(k).unwrap_or(&own[0]))).collect()
    }

    fn clusters(&self, device: Device) -> Tensor {
        Tensor::from_slice(&self.cluster).to_device(device)
    }

    /// x [n, c] summed over each cluster, [m, c].
    fn sums(&self, x: &Tensor) -> Tensor {
        let room = Tensor::zeros([self.cells.len() as i64, x.size()[1]], (x.kind(), x.device()));
        room.index_add(0, &self.clusters(x.device()), x)
    }

    fn means(&self, x: &Tensor) -> Tensor {
        self.sums(x) / self.sums(&x.narrow(1, 0, 1).ones_like())
    }
}

/// What becomes of the points of a cluster, channel by channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reduce {
    /// The largest.
    Max,
    /// The least.
    Min,
    /// Their mean.
    Mean,
    /// Their sum.
    Sum,
}

/// Features of a finer cloud to those of a coarser one: a linear map, one point of each cluster, a norm, GELU.
pub struct Pool {
    proj: Linear,
    norm: LayerNorm,
    reduce: Reduce,
}

impl Pool {
    /// From and to so many channels.
    pub fn new(mut at: Scope, input: usize, output: usize, reduce: Reduce) -> Self {
        let proj = Linear::new(at.sub("proj"), Role::Projection, input, output, true);
        Self { proj, norm: LayerNorm::new(at.sub("norm").sub(0), output), reduce }
    }

    /// x [n, in] to [m, out].
    pub fn forward(&self, w: &Weights, x: &Tensor, to: &Pooled) -> Tensor {
        let x = self.proj.forward(w, x);
        let apart = || {
            let members = Tensor::from_slice(&to.members()).to_device(x.device());
            x.index_select(0, &members).view([to.cells.len() as i64, -1, x.size()[1]])
        };
        let joined = match self.reduce {
            Reduce::Max => apart().amax([1], false),
            Reduce::Min => apart().amin([1], false),
            Reduce::Mean => to.means(&x),
            Reduce::Sum => to.sums(&x),
        };
        self.norm.forward(w, &joined).gelu("none")
    }

    /// Mean positions of the clusters: [n, 3] to [m, 3].
    pub fn positions(positions: &Tensor, to: &Pooled) -> Tensor {
        to.means(positions)
    }
}

/// Features of a coarser cloud told to the finer one, beside its own.
pub struct Unpool {
    proj: (Linear, LayerNorm),
    skip: (Linear, LayerNorm),
}

impl Unpool {
    /// From so many channels of the coarser and of the finer cloud.
    pub fn new(mut at: Scope, coarse: usize, fine: usize, output: usize) -> Self {
        let mut part = |name: &str, input| {
            let mut at = at.sub(name);
            (Linear::new(at.sub(0), Role::Projection, input, output, true), LayerNorm::new(at.sub(1), output))
        };
        Self { proj: part("proj", coarse), skip: part("proj_skip", fine) }
    }

    /// [m, coarse] and [n, fine] to [n, out].
    pub fn forward(&self, w: &Weights, coarse: &Tensor, fine: &Tensor, of: &Pooled) -> Tensor {
        let part =
            |(linear, norm): &(Linear, LayerNorm), x: &Tensor| norm.forward(w, &linear.forward(w, x)).gelu("none");
        part(&self.skip, fine) + part(&self.proj, coarse).index_select(0, &of.clusters(fine.device()))
    }
}
