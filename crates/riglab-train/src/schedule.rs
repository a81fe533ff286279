//! Learning rate and momentum over a run.

use crate::config::{ScheduleConfig, ScheduleKind};

/// The factor of the peak learning rate at `step` (from 0) of `steps`.
pub fn factor(config: &ScheduleConfig, step: u64, steps: u64) -> f64 {
    if config.kind == ScheduleKind::OneCycle {
        return one_cycle(config, step, steps, [config.one_cycle.start, 1.0, config.end]);
    }
    if step < config.warmup {
        return (step + 1) as f64 / config.warmup as f64;
    }
    let span = steps.saturating_sub(config.warmup + 1).max(1) as f64;
    let done = ((step - config.warmup) as f64 / span).min(1.0);
    match config.kind {
        // One cycle was told above.
        ScheduleKind::Constant | ScheduleKind::OneCycle => 1.0,
        ScheduleKind::Linear => 1.0 + (config.end - 1.0) * done,
        ScheduleKind::Cosine => config.end + (1.0 - config.end) * 0.5 * (1.0 + (std::f64::consts::PI * done).cos()),
    }
}

/// AdamW's decay of first moments at `step` of `steps`, where the schedule says it.
pub fn beta1(config: &ScheduleConfig, step: u64, steps: u64) -> Option<f64> {
    let [ends, peak] = config.one_cycle.beta1;
    (config.kind == ScheduleKind::OneCycle).then(|| one_cycle(config, step, steps, [ends, peak, ends]))
}

/// The first of `until` steps whose learning rate or momentum is another in a run of `a` steps than in one of `b`.
pub fn first_apart(config: &ScheduleConfig, [a, b]: [u64; 2], until: u64) -> Option<u64> {
    (0..until).find(|&s| factor(config, s, a) != factor(config, s, b) || beta1(config, s, a) != beta1(config, s, b))
}

/// From the first value to the second and on to the third, by half a cosine each. The peak may lie between two
/// steps; the step after it is on the way down then.
fn one_cycle(config: &ScheduleConfig, step: u64, steps: u64, [start, peak, end]: [f64; 3]) -> f64 {
    let (step, last) = (step as f64, steps.saturating_sub(1) as f64);
    let top = config.one_cycle.rise * steps as f64 - 1.0;
    let way = |from: f64, to: f64, share: f64| to + (from - to) * 0.5 * (1.0 + (std::f64::consts::PI * share).cos());
    if step <= top && top > 0.0 {
        way(start, peak, step / top)
    } else {
        way(peak, end, ((step - top) / (last - top)).clamp(0.0, 1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::OneCycleConfig;

    #[test]
    fn one_cycle_rises_and_falls_and_momentum_goes_the_other_way() {
        let c = ScheduleConfig { kind: ScheduleKind::OneCycle, warmup: 0, end: 0.02, ..ScheduleConfig::default() };
        let near = |x: f64, wanted: f64| assert!((x - wanted).abs() < 1e-12, "{x} {wanted}");
        for (step, rate, beta) in [(0, 0.2, 0.95), (9, 1.0, 0.85), (99, 0.02, 0.95), (500, 0.02, 0.95)] {
            near(factor(&c, step, 100), rate);
            near(beta1(&c, step, 100).unwrap(), beta);
        }
        assert!((0..9).all(|s| factor(&c, s, 100) < factor(&c, s + 1, 100)));
        assert!((9..99).all(|s| factor(&c, s, 100) > factor(&c, s + 1, 100)));
        assert_eq!(beta1(&ScheduleConfig::default(), 3, 100), None);
        // A rise that ends before the first step, and runs of a step.
        for (rise, steps) in [(0.0, 100), (0.1, 1), (0.5, 1), (0.1, 3), (0.999, 2)] {
            let one_cycle = OneCycleConfig { rise, ..OneCycleConfig::default() };
            let c = ScheduleConfig { one_cycle, ..c.clone() };
            assert!((0..steps + 2).all(|s| (0.0..=1.0).contains(&factor(&c, s, steps))), "{rise} {steps}");
        }
    }

    #[test]
    fn runs_of_other_lengths_part_where_their_rates_do() {
        let of = |kind| ScheduleConfig { kind, warmup: 10, ..ScheduleConfig::default() };
        for (kind, apart) in [
            (ScheduleKind::Constant, None),
            (ScheduleKind::Linear, Some(11)),
            (ScheduleKind::Cosine, Some(11)),
            (ScheduleKind::OneCycle, Some(1)),
        ] {
            assert_eq!(first_apart(&of(kind), [100, 200], 100), apart, "{kind:?}");
            assert_eq!(first_apart(&of(kind), [100, 100], 100), None, "{kind:?}");
        }
        assert_eq!(
            first_apart(&of(ScheduleKind::Cosine), [100, 200], 11),
            None,
            "warm-up does not follow from the steps"
        );
    }

    #[test]
    fn warms_up_to_the_peak_and_ends_low() {
        let c = ScheduleConfig { kind: ScheduleKind::Cosine, warmup: 10, end: 0.01, ..ScheduleConfig::default() };
        let at = |step| factor(&c, step, 100);
        assert_eq!((at(0), at(9), at(10)), (0.1, 1.0, 1.0));
        assert!((at(99) - 0.01).abs() < 1e-12 && (at(500) - 0.01).abs() < 1e-12);
        assert!((10..99).all(|s| at(s) > at(s + 1)));
        let linear = ScheduleConfig { kind: ScheduleKind::Linear, ..c.clone() };
        assert!((factor(&linear, 99, 100) - 0.01).abs() < 1e-12);
        let constant =
            ScheduleConfig { kind: ScheduleKind::Constant, warmup: 0, end: 0.0, ..ScheduleConfig::default() };
        assert_eq!((factor(&constant, 0, 1), factor(&constant, 7, 9)), (1.0, 1.0));
    }
}
