//! The kernel: a linear part, a squared-exponential part with one length scale per input, and an
//! optional part for the place of the robot.
//!
//! Most of the error of a main model is a wrong gain and an offset. The linear part learns these
//! from a handful of samples, and extrapolates them beyond the data. The squared-exponential part
//! models the rest. What the floor does at a place adds to both: a slope or a seam is learnt from
//! one lap for the next.
//!
//! Reference: Rasmussen & Williams 2006, sections 2.7, 4.2.2, 4.2.4 and 5.1; for a sum of functions
//! of some inputs each, Duvenaud, Nickisch & Rasmussen, *Additive Gaussian Processes*, NIPS 2011.

/// Number of inputs of the place part: the last ones.
pub const PLACE_INPUTS: usize = 4;

/// Sum of a linear, a squared-exponential and a place part, with one length scale per input
/// ("automatic relevance determination").
///
/// ```text
/// k(a, b) = σ² exp(−½ Σᵢ ((aᵢ − bᵢ) / ℓᵢ)²) + λ² (1 + Σᵢ aᵢ bᵢ) + π² exp(−½ Σₚ ((aₚ − bₚ) / ℓₚ)²)
/// ```
/// With a place part, p runs over the last four inputs, and i over those before them. Without one,
/// i runs over all.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Kernel<const D: usize> {
    /// σ²: prior variance of the squared-exponential part, in squared output units.
    pub variance: f64,
    /// ℓ: distance over which that part and the place part decorrelate, in (normalised) input
    /// units.
    pub length_scale: [f64; D],
    /// λ²: prior variance of the offset and of each slope, in squared output units. Zero is no
    /// linear part.
    pub linear_variance: f64,
    /// π²: prior variance of the place part, in squared output units. Zero is no place part.
    pub place_variance: f64,
}

impl<const D: usize> Kernel<D> {
    /// Number of inputs of the linear and the squared-exponential part: the first ones.
    #[inline]
    pub const fn local_inputs(&self) -> usize {
        if self.place_variance == 0.0 { D } else { D.saturating_sub(PLACE_INPUTS) }
    }

    /// k(a, b).
    pub fn value(&self, a: &[f64; D], b: &[f64; D]) -> f64 {
        let split = self.local_inputs();
        self.variance * self.decay(a, b, 0..split)
            + self.linear_variance * one_plus_product(&a[..split], &b[..split])
            + self.place_variance * self.decay(a, b, split..D)
    }

    /// ∂k(a, b)/∂a = −σ² exp(…) (aᵢ − bᵢ) / ℓᵢ² + λ² bᵢ, and −π² exp(…) (aₚ − bₚ) / ℓₚ²
    pub fn gradient(&self, a: &[f64; D], b: &[f64; D]) -> [f64; D] {
        let split = self.local_inputs();
        let local = self.variance * self.decay(a, b, 0..split);
        let place = self.place_variance * self.decay(a, b, split..D);
        std::array::from_fn(|i| {
            let (share, linear) =
                if i < split { (local, self.linear_variance * b[i]) } else { (place, 0.0) };
            -share * (a[i] - b[i]) / (self.length_scale[i] * self.length_scale[i]) + linear
        })
    }

    /// k(x, x) = σ² + λ² (1 + ‖x‖²) + π²: the variance of the function at `x` before any sample.
    pub fn prior(&self, x: &[f64; D]) -> f64 {
        let local = &x[..self.local_inputs()];
        self.variance + self.linear_variance * one_plus_product(local, local) + self.place_variance
    }

    /// exp(−½ Σᵢ ((aᵢ − bᵢ) / ℓᵢ)²) over some inputs.
    fn decay(&self, a: &[f64; D], b: &[f64; D], inputs: std::ops::Range<usize>) -> f64 {
        let squared_distance: f64 =
            inputs.map(|i| ((a[i] - b[i]) / self.length_scale[i]).powi(2)).sum();
        (-0.5 * squared_distance).exp()
    }
}

/// 1 + a·b
#[expect(
    clippy::inline_always,
    reason = "must be inlined to use the vector features of its caller"
)]
#[inline(always)]
pub(crate) fn one_plus_product(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).fold(1.0, |sum, (a, b)| sum + a * b)
}

#[cfg(test)]
mod tests {
    use super::Kernel;
    use proptest::prelude::*;

    const KERNELS: [Kernel<2>; 2] = [
        Kernel {
            variance: 1.5,
            length_scale: [0.7, 2.0],
            linear_variance: 0.0,
            place_variance: 0.0,
        },
        Kernel {
            variance: 1.5,
            length_scale: [0.7, 2.0],
            linear_variance: 0.4,
            place_variance: 0.0,
        },
    ];

    const PLACED: Kernel<6> = Kernel {
        variance: 1.5,
        length_scale: [0.7, 2.0, 1.0, 0.5, 3.0, 1.5],
        linear_variance: 0.4,
        place_variance: 0.8,
    };

    fn compare_gradient<const D: usize>(
        kernel: &Kernel<D>,
        a: &[f64; D],
        b: &[f64; D],
    ) -> Result<(), TestCaseError> {
        let gradient = kernel.gradient(a, b);
        for i in 0..D {
            let (mut above, mut below) = (*a, *a);
            above[i] += 1e-6;
            below[i] -= 1e-6;
            let difference = (kernel.value(&above, b) - kernel.value(&below, b)) / 2e-6;
            prop_assert!((gradient[i] - difference).abs() < 1e-8);
        }
        Ok(())
    }

    fn compare_prior<const D: usize>(
        kernel: &Kernel<D>,
        a: &[f64; D],
        b: &[f64; D],
    ) -> Result<(), TestCaseError> {
        let value = kernel.value(a, b);
        prop_assert!((value - kernel.value(b, a)).abs() < 1e-14);
        prop_assert!(value.abs() <= (kernel.prior(a) * kernel.prior(b)).sqrt() + 1e-14);
        prop_assert!((kernel.prior(a) - kernel.value(a, a)).abs() < 1e-14);
        Ok(())
    }

    proptest! {
        #[test]
        fn is_symmetric_and_bounded_by_its_prior_variances(
            a in [-3.0..3.0, -3.0..3.0],
            b in [-3.0..3.0, -3.0..3.0],
            c in prop::array::uniform6(-3.0..3.0),
            d in prop::array::uniform6(-3.0..3.0),
        ) {
            for kernel in &KERNELS {
                compare_prior(kernel, &a, &b)?;
            }
            compare_prior(&PLACED, &c, &d)?;
        }

        #[test]
        fn gradient_matches_finite_differences(
            a in [-3.0..3.0, -3.0..3.0],
            b in [-3.0..3.0, -3.0..3.0],
            c in prop::array::uniform6(-3.0..3.0),
            d in prop::array::uniform6(-3.0..3.0),
        ) {
            for kernel in &KERNELS {
                compare_gradient(kernel, &a, &b)?;
            }
            compare_gradient(&PLACED, &c, &d)?;
        }
    }
}
