//! Whether tensors can be weights.

use tch::{Kind, Tensor};

/// What keeps a tensor from being weights: that its numbers are whole ones, or not all finite in single precision.
/// `None` where nothing does.
pub fn unsound(t: &Tensor) -> Option<String> {
    if !matches!(t.kind(), Kind::Float | Kind::Double | Kind::Half | Kind::BFloat16) {
        return Some(format!("holds whole numbers ({:?}), where weights are real", t.kind()));
    }
    let _no_grad = tch::no_grad_guard();
    // What is too large for single precision is infinite there.
    let t = if t.kind() == Kind::Double { t.to_kind(Kind::Float) } else { t.shallow_clone() };
    let all = t.isfinite().all().int64_value(&[]) != 0;
    (!all).then(|| "holds NaN or infinity".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_real_and_finite() {
        assert_eq!(unsound(&Tensor::from_slice(&[0.0f32, -1e38])), None);
        assert_eq!(unsound(&Tensor::from_slice(&[1.0f32]).to_kind(Kind::BFloat16)), None);
        assert_eq!(unsound(&Tensor::zeros([0], (Kind::Float, tch::Device::Cpu))), None);
        for wrong in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert!(unsound(&Tensor::from_slice(&[0.0, wrong])).unwrap().contains("NaN or infinity"));
        }
        assert!(unsound(&Tensor::from_slice(&[1e300f64])).unwrap().contains("infinity"));
        assert!(unsound(&Tensor::from_slice(&[1i64])).unwrap().contains("whole numbers (Int64)"));
    }
}
