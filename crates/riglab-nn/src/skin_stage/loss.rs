//! Losses of the skin stage, of one rig each.
//!
//! Shapes: n points, j bones; predicted and true weights are [n, j], rows summing to 1; `each` is a loss of every
//! point, [n].

use tch::{Kind, Tensor};

/// Weights above this count as held, as released.
pub const HELD: f64 = 1e-6;
/// ε in the logarithms of [`bce`], as released.
const EPS: f64 = 1e-6;

/// KL(W ‖ Ŵ) of each point (UniRig 4.3), [n]: from the logarithms of predicted shares.
pub fn divergence(log_predicted: &Tensor, truth: &Tensor) -> Tensor {
    // w ln w is 0 where w is; the logarithm of the smallest weight there is keeps it finite.
    let own = truth * truth.clamp_min(1e-12).log();
    (own - truth * log_predicted).sum_dim_intlist(-1, false, None::<Kind>)
}

/// Logarithms of shares, where some bones keep the true ones (UniRig's frozen bones): the others share what those leave
/// of each row. `frozen` [j] is 1 where a bone is, and not everywhere. Frozen bones have no gradient; their logarithms
/// are those of the true shares.
pub fn log_shares(logits: &Tensor, truth: &Tensor, frozen: Option<&Tensor>) -> Tensor {
    let Some(frozen) = frozen else { return logits.log_softmax(-1, None::<Kind>) };
    let kept = truth.masked_fill(&frozen.logical_not(), 0.0).sum_dim_intlist(-1, true, None::<Kind>);
    let rest = (kept.neg() + 1.0).clamp_min(1e-12);
    let free = logits.masked_fill(frozen, f64::NEG_INFINITY).log_softmax(-1, None::<Kind>) + rest.log();
    truth.clamp_min(1e-12).log().where_self(frozen, &free)
}

/// Mean over bones of the mean over the points that each holds (UniRig 4.3, skeletal equivalence):
/// 1/J Σ_i 1/S_i Σ_k 1[W_ki > 0] ℓ_k. A bone that holds no point is not counted: of few points some bones have none.
/// `counted` [j]: the bones that count at all.
pub fn over_bones(each: &Tensor, truth: &Tensor, counted: Option<&Tensor>) -> Tensor {
    let mut held = truth.gt(HELD);
    if let Some(counted) = counted {
        held = held.logical_and(counted);
    }
    let (mean, some) = per_bone(each, &held);
    mean.sum(None::<Kind>) / some.sum(None::<Kind>).clamp_min(1.0)
}

/// Of each bone, the mean of `each` over the points that it holds, 0 where it has none, and whether it has some.
fn per_bone(each: &Tensor, held: &Tensor) -> (Tensor, Tensor) {
    let held = held.to_kind(each.kind());
    let counts = held.sum_dim_intlist(0, false, None::<Kind>);
    (held.transpose(0, 1).mv(each) / counts.clamp_min(1.0), counts.clamp_max(1.0))
}

/// Positions [n, 3] moved by each bone's map [j, 3, 4] and weights [n, j]. A row of weights is divided by its sum, with
/// the release's ε of 1e-8.
pub fn lbs(weights: &Tensor, maps: &Tensor, positions: &Tensor) -> Tensor {
    let n = positions.size()[0];
    let j = maps.size()[0];
    let one = Tensor::ones([n, 1], (positions.kind(), positions.device()));
    let mixed = weights.matmul(&maps.view([j, 12])).view([n, 3, 4]);
    let moved = mixed.matmul(&Tensor::cat(&[positions, &one], 1).unsqueeze(-1)).squeeze_dim(-1);
    moved / (weights.sum_dim_intlist(-1, true, None::<Kind>) + 1e-8)
}

/// The release's losses by name, without their weights.
pub struct Released {
    /// Squared error of moved positions.
    pub vertex: Tensor,
    /// The same as the mean over bones of the mean over what each holds; bones that hold nothing count as 0.
    pub normalization: Tensor,
    /// Mean absolute error of weights.
    pub l1: Tensor,
    /// Binary cross-entropy of weights.
    pub bce: Tensor,
    /// Mean over bones of the mean absolute error over points that the bone does not hold.
    pub zero_l1: Tensor,
    /// The same over points that it holds.
    pub non_zero_l1: Tensor,
}

/// The release's losses of predicted shares, with the positions [n, 3] moved by maps [j, 3, 4]. True rows are
/// made to sum to 1 with its ε of 1e-6.
pub fn released(predicted: &Tensor, truth: &Tensor, maps: &Tensor, positions: &Tensor) -> Released {
    let truth = truth / (truth.sum_dim_intlist(-1, true, None::<Kind>) + 1e-6);
    let moved = lbs(predicted, maps, positions) - lbs(&truth, maps, positions);
    let each = moved.square().mean_dim([-1i64].as_slice(), false, None::<Kind>);
    let off = (predicted - &truth).abs();
    let held = truth.gt(HELD);
    let of_bones = |of: &Tensor| {
        let of = of.to_kind(off.kind());
        let count = of.sum_dim_intlist(0, false, None::<Kind>).clamp_min(1.0);
        ((&off * of).sum_dim_intlist(0, false, None::<Kind>) / count).mean(None::<Kind>)
    };
    Released {
        normalization: per_bone(&each, &held).0.mean(None::<Kind>),
        vertex: each.mean(None::<Kind>),
        zero_l1: of_bones(&truth.lt(HELD)),
        non_zero_l1: of_bones(&truth.ge(HELD)),
        bce: bce(predicted, &truth),
        l1: off.mean(None::<Kind>),
    }
}

/// Binary cross-entropy of shares, mean over all entries.
pub fn bce(predicted: &Tensor, truth: &Tensor) -> Tensor {
    let one = |t: &Tensor| t.neg() + 1.0;
    let all = truth * (predicted + EPS).log() + one(truth) * (one(predicted) + EPS).log();
    all.mean(None::<Kind>).neg()
}

/// Squared error of attributes [j, a] of the bones that have some: `has` [j] is 1 there. The mean over bones and
/// columns, each column times its scale [a]; 0 without any.
pub fn attributes(predicted: &Tensor, truth: &Tensor, has: &Tensor, scale: &Tensor) -> Tensor {
    let has = has.unsqueeze(-1).to_kind(predicted.kind());
    let off = ((predicted - truth) * scale).square() * &has;
    off.sum(None::<Kind>) / (has.sum(None::<Kind>).clamp_min(1.0) * truth.size()[1] as f64)
}
