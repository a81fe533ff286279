//! The exponential of numbers that are not positive, the same on every machine.

/// eˣ for x ≤ 0, off by less than 1e-14 of itself; 0 below -700. Sums and products alone, without branches, so that
/// several are taken at a time.
#[inline(always)]
#[allow(clippy::excessive_precision)] // ln 2 in two parts
pub(crate) fn exp(x: f64) -> f64 {
    let x = x.max(-700.0);
    // Adding and taking away 1.5 · 2⁵² rounds to a whole number, which then stands in the last bits.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    let shifted = x * std::f64::consts::LOG2_E + ROUND;
    let k = shifted - ROUND;
    let r = (x - k * 6.931_471_803_691_238_16e-1) - k * 1.908_214_929_270_587_70e-10;
    let terms = [
        1.0 / 479_001_600.0,
        1.0 / 39_916_800.0,
        1.0 / 3_628_800.0,
        1.0 / 362_880.0,
        1.0 / 40_320.0,
        1.0 / 5_040.0,
        1.0 / 720.0,
        1.0 / 120.0,
        1.0 / 24.0,
        1.0 / 6.0,
        0.5,
        1.0,
        1.0,
    ];
    let mut sum = 0.0;
    for t in terms {
        sum = sum * r + t;
    }
    sum * f64::from_bits(shifted.to_bits().wrapping_add(1023) << 52)
}

#[cfg(test)]
mod tests {
    #[test]
    fn is_the_exponential() {
        for k in 0..7000 {
            let x = -0.1 * f64::from(k);
            let (got, wanted) = (super::exp(x), x.exp());
            assert!((got / wanted - 1.0).abs() < 1e-13, "{x}: {got}, not {wanted}");
        }
        assert_eq!(super::exp(0.0), 1.0);
        assert!(super::exp(-1e9) < 1e-300);
    }
}
