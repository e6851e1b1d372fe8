//! eˣ for x ≤ 0 without branches, so that a loop over it runs in vector registers.
//!
//! x = n ln 2 + r with |r| ≤ ½ ln 2; eˣ = 2ⁿ eʳ, eʳ by its Taylor polynomial of degree 11, whose
//! remainder is below 1e-14. Multiplications and additions are separate (none fused), and nothing
//! is summed across elements. So the bits do not depend on the width of the registers, nor on the
//! position in a slice.

const LOG2_E: f64 = std::f64::consts::LOG2_E;
/// ln 2 in two parts; the first has enough trailing zeros that `n * LN_2_HIGH` is exact.
const LN_2_HIGH: f64 = 6.931_471_803_691_238e-1;
const LN_2_LOW: f64 = 1.908_214_929_270_587_7e-10;
/// eˣ underflows to zero here, and 2ⁿ below stays representable in two factors.
const SMALLEST: f64 = -746.0;
/// Offset that makes n positive, so that its halves can be taken by an unsigned shift.
const OFFSET: f64 = 2046.0;
/// Adding 1.5·2⁵² leaves the nearest integer in the low bits of the mantissa.
const ROUND: f64 = 6_755_399_441_055_744.0 + OFFSET;
/// 1/k! for k = 11 … 0.
const COEFFICIENTS: [f64; 12] = [
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

/// eˣ for x ≤ 0, to about 1e-15 relative (absolute where the result is subnormal); NaN stays NaN.
#[expect(
    clippy::inline_always,
    reason = "must be inlined to use the vector features of its caller"
)]
#[inline(always)]
pub(crate) fn exponential(x: f64) -> f64 {
    let x = if x < SMALLEST { SMALLEST } else { x };
    let shifted = x * LOG2_E + ROUND;
    let n = shifted - ROUND;
    let r = (x - n * LN_2_HIGH) - n * LN_2_LOW;

    let mut polynomial = COEFFICIENTS[0];
    for coefficient in &COEFFICIENTS[1..] {
        polynomial = polynomial * r + coefficient;
    }

    // 2ⁿ in two factors, because n reaches below the exponent of the smallest normal number.
    let exponent = shifted.to_bits() & 0xFFF;
    let half = exponent >> 1;
    let rest = exponent - half;
    polynomial * f64::from_bits(half << 52) * f64::from_bits(rest << 52)
}

#[cfg(test)]
mod tests {
    use super::exponential;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]
        #[test]
        fn agrees_with_the_standard_library_over_its_whole_range(x in -745.0..=0.0_f64) {
            let expected = x.exp();
            prop_assert!((exponential(x) - expected).abs() <= 1e-14 * expected + f64::from_bits(1));
        }
    }

    #[test]
    fn is_exact_at_the_ends_of_its_range() {
        assert_eq!(exponential(0.0).to_bits(), 1.0_f64.to_bits());
        assert_eq!(exponential(f64::NEG_INFINITY).to_bits(), 0);
        assert_eq!(exponential(-1e300).to_bits(), 0);
        assert!(exponential(f64::NAN).is_nan());
    }
}
