//! Learning rate over a run.

use crate::config::{ScheduleConfig, ScheduleKind};

/// The factor of the peak learning rate at `step` (from 0) of `steps`.
pub fn factor(config: &ScheduleConfig, step: u64, steps: u64) -> f64 {
    if step < config.warmup {
        return (step + 1) as f64 / config.warmup as f64;
    }
    let span = steps.saturating_sub(config.warmup + 1).max(1) as f64;
    let done = ((step - config.warmup) as f64 / span).min(1.0);
    match config.kind {
        ScheduleKind::Constant => 1.0,
        ScheduleKind::Linear => 1.0 + (config.end - 1.0) * done,
        ScheduleKind::Cosine => config.end + (1.0 - config.end) * 0.5 * (1.0 + (std::f64::consts::PI * done).cos()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn warms_up_to_the_peak_and_ends_low() {
        let c = ScheduleConfig { kind: ScheduleKind::Cosine, warmup: 10, end: 0.01 };
        let at = |step| factor(&c, step, 100);
        assert_eq!((at(0), at(9), at(10)), (0.1, 1.0, 1.0));
        assert!((at(99) - 0.01).abs() < 1e-12 && (at(500) - 0.01).abs() < 1e-12);
        assert!((10..99).all(|s| at(s) > at(s + 1)));
        let linear = ScheduleConfig { kind: ScheduleKind::Linear, ..c.clone() };
        assert!((factor(&linear, 99, 100) - 0.01).abs() < 1e-12);
        let constant = ScheduleConfig { kind: ScheduleKind::Constant, warmup: 0, end: 0.0 };
        assert_eq!((factor(&constant, 0, 1), factor(&constant, 7, 9)), (1.0, 1.0));
    }
}
