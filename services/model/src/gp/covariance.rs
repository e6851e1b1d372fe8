//! Covariance of samples under a kernel, and its Cholesky factor.
//!
//! | here          | in the equations                     | size                  |
//! |---------------|--------------------------------------|-----------------------|
//! | `scaled`      | xᵢ / ℓ                               | D arrays of `n`       |
//! | `local`       | S = σ² exp(…)                        | `n` × `n`, lower half |
//! | `place`       | P = π² exp(…)                        | `n` × `n`, lower half |
//! | `gram`        | G = 1 + X Xᵀ                         | `n` × `n`, lower half |
//! | `sum`         | K = S + λ² G + P                     | `n` × `n`, lower half |
//! | `noise_scale` | s: noise of a sample over σₙ²        | `n`                   |
//! | `factor`      | L, L Lᵀ = K + σₙ² diag(s) + jitter I | `n` × `n`, lower half |

use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::cholesky::llt;
use faer::traits::pulp::Arch;
use faer::{Mat, Par};

use crate::gp::exponential::exponential;
use crate::gp::kernel::{Kernel, one_plus_product};
use crate::gp::vectorise::vectorise;

/// Added to the diagonal when the plain covariance does not factorise, relative to its largest
/// entry there: first this …
const FIRST_JITTER: f64 = 1e-12;
/// … then ten times more each time, up to this.
const LARGEST_JITTER: f64 = 1e-4;

/// Covariance of samples, and the parts that it is the sum of.
#[derive(Debug, Clone)]
pub(crate) struct Covariance<const D: usize> {
    /// Inputs in units of the length scales, one contiguous array per input.
    scaled: [Vec<f64>; D],
    local: Mat<f64>,
    /// Empty until a kernel has a place part.
    place: Mat<f64>,
    gram: Mat<f64>,
    /// Number of inputs that `gram` is of; it depends on no other property of the kernel.
    gram_inputs: Option<usize>,
    sum: Mat<f64>,
}

impl<const D: usize> Covariance<D> {
    /// Memory for this number of samples; all zero until [`fill`](Self::fill).
    pub(crate) fn new(samples: usize) -> Self {
        Self {
            scaled: std::array::from_fn(|_| vec![0.0; samples]),
            local: Mat::zeros(samples, samples),
            place: Mat::new(),
            gram: Mat::zeros(samples, samples),
            gram_inputs: None,
            sum: Mat::zeros(samples, samples),
        }
    }

    /// Computes it for `inputs`, as many as at construction and the same in every call. O(n² D);
    /// allocates at the first kernel with a place part only.
    pub(crate) fn fill(&mut self, inputs: &[[f64; D]], kernel: &Kernel<D>) {
        for (dimension, column) in self.scaled.iter_mut().enumerate() {
            let rate = 1.0 / kernel.length_scale[dimension];
            for (scaled, input) in column.iter_mut().zip(inputs) {
                *scaled = input[dimension] * rate;
            }
        }
        let split = kernel.local_inputs();
        if self.gram_inputs != Some(split) {
            self.gram_inputs = Some(split);
            for column in 0..inputs.len() {
                let own = &inputs[column][..split];
                let below = &mut self.gram.col_as_slice_mut(column)[column..];
                for (entry, other) in below.iter_mut().zip(&inputs[column..]) {
                    *entry = one_plus_product(own, &other[..split]);
                }
            }
        }
        decay(&self.scaled[..split], kernel.variance, &mut self.local);
        let has_place = kernel.place_variance != 0.0;
        if has_place {
            if self.place.ncols() != inputs.len() {
                self.place = Mat::zeros(inputs.len(), inputs.len());
            }
            decay(&self.scaled[split..], kernel.place_variance, &mut self.place);
        }
        for column in 0..inputs.len() {
            let below = &mut self.sum.col_as_slice_mut(column)[column..];
            let local = &self.local.col_as_slice(column)[column..];
            let gram = &self.gram.col_as_slice(column)[column..];
            for ((sum, local), gram) in below.iter_mut().zip(local).zip(gram) {
                *sum = local + kernel.linear_variance * gram;
            }
            if has_place {
                let place = &self.place.col_as_slice(column)[column..];
                for (sum, place) in below.iter_mut().zip(place) {
                    *sum += place;
                }
            }
        }
    }

    /// xᵢ / ℓ, one array per input.
    pub(crate) fn scaled(&self) -> &[Vec<f64>; D] {
        &self.scaled
    }

    /// K, lower half.
    pub(crate) fn sum(&self) -> &Mat<f64> {
        &self.sum
    }

    /// S, lower half.
    pub(crate) fn local(&self) -> &Mat<f64> {
        &self.local
    }

    /// P, lower half; of the last kernel with a place part.
    pub(crate) fn place(&self) -> &Mat<f64> {
        &self.place
    }

    /// G, lower half.
    pub(crate) fn gram(&self) -> &Mat<f64> {
        &self.gram
    }
}

/// Lower half of variance · exp(−½ ‖xᵢ − xⱼ‖²) over `scaled` inputs, the diagonal included. O(n²
/// D); does not allocate.
fn decay(scaled: &[Vec<f64>], variance: f64, result: &mut Mat<f64>) {
    vectorise(
        Arch::new(),
        #[inline(always)]
        || {
            for first in 0..result.ncols() {
                let column = &mut result.col_as_slice_mut(first)[first..];
                column.fill(0.0);
                for scaled in scaled {
                    let here = scaled[first];
                    for (sum, there) in column.iter_mut().zip(&scaled[first..]) {
                        let difference = there - here;
                        *sum += difference * difference;
                    }
                }
                for value in column.iter_mut() {
                    *value = variance * exponential(-0.5 * *value);
                }
            }
        },
    );
}

/// K + σₙ² diag(s) stayed indefinite under the largest jitter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct NotPositiveDefinite;

/// Memory that a factorisation of up to `samples` needs.
pub(crate) fn factor_scratch(samples: usize) -> StackReq {
    llt::factor::cholesky_in_place_scratch::<f64>(samples, Par::Seq, faer::Spec::default())
}

/// Lower Cholesky factor of K + σₙ² diag(s) + jitter I, and the jitter. The jitter is zero unless
/// it was needed.
///
/// A pivot at the level of rounding counts as lost, so that duplicate inputs are detected. O(n³/3);
/// does not allocate, except where faer packs large blocks.
pub(crate) fn factorise(
    covariance: &Mat<f64>,
    noise_variance: f64,
    noise_scale: &[f64],
    factor: &mut Mat<f64>,
    memory: &mut MemBuffer,
) -> Result<f64, NotPositiveDefinite> {
    let samples = covariance.ncols();
    if samples == 0 {
        return Ok(0.0);
    }
    let diagonal =
        (0..samples).fold(0.0, |largest: f64, i| largest.max(covariance[(i, i)])) + noise_variance;
    let smallest_pivot = f64::EPSILON * samples as f64 * diagonal;
    let first_jitter = FIRST_JITTER * diagonal;
    // If the diagonal is infinite or zero, the loop below would never reach the largest jitter.
    if !(first_jitter.is_normal() && first_jitter > 0.0) {
        return Err(NotPositiveDefinite);
    }
    let mut jitter = 0.0;
    loop {
        for (column, scale) in noise_scale.iter().enumerate().take(samples) {
            factor.col_as_slice_mut(column)[column..]
                .copy_from_slice(&covariance.col_as_slice(column)[column..]);
            factor[(column, column)] += noise_variance * scale + jitter;
        }
        let outcome = llt::factor::cholesky_in_place(
            factor.as_mut(),
            llt::factor::LltRegularization::default(),
            Par::Seq,
            MemStack::new(memory),
            faer::Spec::default(),
        );
        if outcome.is_ok() && (0..samples).all(|i| factor[(i, i)] * factor[(i, i)] > smallest_pivot)
        {
            return Ok(jitter);
        }
        jitter = if jitter > 0.0 { 10.0 * jitter } else { first_jitter };
        if jitter > LARGEST_JITTER * diagonal {
            return Err(NotPositiveDefinite);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Covariance, NotPositiveDefinite, factor_scratch, factorise};
    use crate::gp::kernel::Kernel;
    use crate::gp::split_mix::SplitMix64;
    use faer::Mat;
    use faer::dyn_stack::MemBuffer;

    const KERNEL: Kernel<6> = Kernel {
        variance: 1.7,
        length_scale: [0.5, 1.0, 2.0, 0.8, 1.5, 3.0],
        linear_variance: 0.3,
        place_variance: 0.0,
    };

    fn inputs(samples: usize) -> Vec<[f64; 6]> {
        let mut random = SplitMix64::new(1);
        (0..samples).map(|_| std::array::from_fn(|_| random.normal())).collect()
    }

    fn covariance(inputs: &[[f64; 6]]) -> Mat<f64> {
        let mut covariance = Covariance::new(inputs.len());
        covariance.fill(inputs, &KERNEL);
        covariance.sum
    }

    #[test]
    fn a_diagonal_that_is_infinite_or_zero_is_rejected_at_once() {
        for value in [f64::INFINITY, f64::NAN, 0.0, 1e-310] {
            let covariance = Mat::from_fn(3, 3, |_, _| value);
            let mut memory = MemBuffer::new(factor_scratch(3));
            let refused =
                factorise(&covariance, 0.0, &[1.0; 3], &mut Mat::zeros(3, 3), &mut memory);
            assert_eq!(refused, Err(NotPositiveDefinite), "{value}");
        }
    }

    #[test]
    fn entries_are_those_of_each_kernel_in_turn() {
        let inputs = inputs(23);
        let mut covariance = Covariance::new(23);
        let placed = Kernel { place_variance: 0.6, ..KERNEL };
        for kernel in [KERNEL, placed, KERNEL] {
            covariance.fill(&inputs, &kernel);
            for (column, a) in inputs.iter().enumerate() {
                for (row, b) in inputs.iter().enumerate().skip(column) {
                    assert!((covariance.sum[(row, column)] - kernel.value(a, b)).abs() < 1e-14);
                }
            }
        }
    }

    #[test]
    fn factor_times_its_transpose_is_the_covariance() {
        let kernel = covariance(&inputs(40));
        let mut factor = Mat::zeros(40, 40);
        let jitter = factorise(
            &kernel,
            0.01,
            &[1.0; 40],
            &mut factor,
            &mut MemBuffer::new(factor_scratch(40)),
        );
        assert_eq!(jitter, Ok(0.0));
        for column in 0..40 {
            for row in column..40 {
                let product: f64 =
                    (0..=column).map(|k| factor[(row, k)] * factor[(column, k)]).sum();
                let noise = if row == column { 0.01 } else { 0.0 };
                assert!((product - kernel[(row, column)] - noise).abs() < 1e-13);
            }
        }
    }

    #[test]
    fn duplicate_inputs_need_a_jitter() {
        let mut inputs = inputs(20);
        inputs[13] = inputs[4];
        let kernel = covariance(&inputs);
        let mut factor = Mat::zeros(20, 20);
        let jitter = factorise(
            &kernel,
            1e-18,
            &[1.0; 20],
            &mut factor,
            &mut MemBuffer::new(factor_scratch(20)),
        );
        assert!(jitter.is_ok_and(|jitter| jitter > 0.0 && jitter < 1e-6));
    }

    #[test]
    fn no_jitter_makes_nan_positive_definite() {
        let kernel = Mat::from_fn(3, 3, |_, _| f64::NAN);
        let mut factor = Mat::zeros(3, 3);
        assert!(
            factorise(&kernel, 0.1, &[1.0; 3], &mut factor, &mut MemBuffer::new(factor_scratch(3)))
                .is_err()
        );
    }
}
