//! The squared-exponential kernel with one length scale per input.

/// Squared-exponential kernel, one length scale per input ("automatic relevance determination").
///
/// k(a, b) = σ² exp(−½ Σᵢ ((aᵢ − bᵢ) / ℓᵢ)²)
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SquaredExponential<const D: usize> {
    /// σ²: prior variance, in squared output units.
    pub variance: f64,
    /// ℓ: distance over which the function forgets, in (normalised) input units.
    pub length_scale: [f64; D],
}

impl<const D: usize> SquaredExponential<D> {
    /// k(a, b).
    pub fn value(&self, a: &[f64; D], b: &[f64; D]) -> f64 {
        self.variance * (-0.5 * self.squared_distance(a, b)).exp()
    }

    /// ∂k(a, b)/∂a = −k(a, b) (aᵢ − bᵢ) / ℓᵢ²
    pub fn gradient(&self, a: &[f64; D], b: &[f64; D]) -> [f64; D] {
        let value = self.value(a, b);
        std::array::from_fn(|i| -value * (a[i] - b[i]) / (self.length_scale[i] * self.length_scale[i]))
    }

    /// Σᵢ ((aᵢ − bᵢ) / ℓᵢ)²
    pub fn squared_distance(&self, a: &[f64; D], b: &[f64; D]) -> f64 {
        (0..D).map(|i| ((a[i] - b[i]) / self.length_scale[i]).powi(2)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::SquaredExponential;
    use proptest::prelude::*;

    const KERNEL: SquaredExponential<2> = SquaredExponential { variance: 1.5, length_scale: [0.7, 2.0] };

    proptest! {
        #[test]
        fn is_symmetric_and_at_most_its_variance(a in [-3.0..3.0, -3.0..3.0], b in [-3.0..3.0, -3.0..3.0]) {
            let value = KERNEL.value(&a, &b);
            prop_assert!((value - KERNEL.value(&b, &a)).abs() < 1e-15);
            prop_assert!(value > 0.0 && value <= KERNEL.variance);
        }

        #[test]
        fn gradient_matches_finite_differences(a in [-3.0..3.0, -3.0..3.0], b in [-3.0..3.0, -3.0..3.0]) {
            let gradient = KERNEL.gradient(&a, &b);
            for i in 0..2 {
                let (mut above, mut below) = (a, a);
                above[i] += 1e-6;
                below[i] -= 1e-6;
                let difference = (KERNEL.value(&above, &b) - KERNEL.value(&below, &b)) / 2e-6;
                prop_assert!((gradient[i] - difference).abs() < 1e-8);
            }
        }
    }
}
