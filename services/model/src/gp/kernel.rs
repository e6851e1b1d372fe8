//! The linear plus squared-exponential kernel with one length scale per input.
//!
//! Most of the error of a main model is a wrong gain and an offset. The linear part learns these
//! from a handful of samples, and extrapolates them beyond the data. The squared-exponential part
//! models the rest.
//!
//! Reference: Rasmussen & Williams 2006, sections 2.7, 4.2.2 and 5.1.

/// Linear plus squared-exponential kernel, one length scale per input ("automatic relevance
/// determination").
///
/// k(a, b) = σ² exp(−½ Σᵢ ((aᵢ − bᵢ) / ℓᵢ)²) + λ² (1 + a·b)
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Kernel<const D: usize> {
    /// σ²: prior variance of the squared-exponential part, in squared output units.
    pub variance: f64,
    /// ℓ: distance over which that part decorrelates, in (normalised) input units.
    pub length_scale: [f64; D],
    /// λ²: prior variance of the offset and of each slope, in squared output units. Zero is the
    /// squared-exponential kernel alone.
    pub linear_variance: f64,
}

impl<const D: usize> Kernel<D> {
    /// k(a, b).
    pub fn value(&self, a: &[f64; D], b: &[f64; D]) -> f64 {
        self.local(a, b) + self.linear_variance * one_plus_product(a, b)
    }

    /// ∂k(a, b)/∂a = −σ² exp(…) (aᵢ − bᵢ) / ℓᵢ² + λ² bᵢ
    pub fn gradient(&self, a: &[f64; D], b: &[f64; D]) -> [f64; D] {
        let local = self.local(a, b);
        std::array::from_fn(|i| {
            -local * (a[i] - b[i]) / (self.length_scale[i] * self.length_scale[i])
                + self.linear_variance * b[i]
        })
    }

    /// k(x, x) = σ² + λ² (1 + ‖x‖²): the variance of the function at `x` before any sample.
    pub fn prior(&self, x: &[f64; D]) -> f64 {
        self.variance + self.linear_variance * one_plus_product(x, x)
    }

    /// The squared-exponential part.
    fn local(&self, a: &[f64; D], b: &[f64; D]) -> f64 {
        let squared_distance: f64 =
            (0..D).map(|i| ((a[i] - b[i]) / self.length_scale[i]).powi(2)).sum();
        self.variance * (-0.5 * squared_distance).exp()
    }
}

/// 1 + a·b
#[expect(
    clippy::inline_always,
    reason = "must be inlined to use the vector features of its caller"
)]
#[inline(always)]
pub(crate) fn one_plus_product<const D: usize>(a: &[f64; D], b: &[f64; D]) -> f64 {
    a.iter().zip(b).fold(1.0, |sum, (a, b)| sum + a * b)
}

#[cfg(test)]
mod tests {
    use super::Kernel;
    use proptest::prelude::*;

    const KERNELS: [Kernel<2>; 2] = [
        Kernel { variance: 1.5, length_scale: [0.7, 2.0], linear_variance: 0.0 },
        Kernel { variance: 1.5, length_scale: [0.7, 2.0], linear_variance: 0.4 },
    ];

    proptest! {
        #[test]
        fn is_symmetric_and_bounded_by_its_prior_variances(
            a in [-3.0..3.0, -3.0..3.0],
            b in [-3.0..3.0, -3.0..3.0],
        ) {
            for kernel in KERNELS {
                let value = kernel.value(&a, &b);
                prop_assert!((value - kernel.value(&b, &a)).abs() < 1e-14);
                prop_assert!(value.abs() <= (kernel.prior(&a) * kernel.prior(&b)).sqrt() + 1e-14);
            }
        }

        #[test]
        fn gradient_matches_finite_differences(
            a in [-3.0..3.0, -3.0..3.0],
            b in [-3.0..3.0, -3.0..3.0],
        ) {
            for kernel in KERNELS {
                let gradient = kernel.gradient(&a, &b);
                for i in 0..2 {
                    let (mut above, mut below) = (a, a);
                    above[i] += 1e-6;
                    below[i] -= 1e-6;
                    let difference = (kernel.value(&above, &b) - kernel.value(&below, &b)) / 2e-6;
                    prop_assert!((gradient[i] - difference).abs() < 1e-8);
                }
            }
        }

        #[test]
        fn its_prior_variance_is_its_value_at_equal_arguments(x in [-3.0..3.0, -3.0..3.0]) {
            for kernel in KERNELS {
                prop_assert!((kernel.prior(&x) - kernel.value(&x, &x)).abs() < 1e-14);
            }
        }
    }
}
