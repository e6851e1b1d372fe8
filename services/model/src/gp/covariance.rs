//! Covariance of samples under a kernel, and its Cholesky factor.
//!
//! | here           | in the equations       | size                  |
//! |----------------|------------------------|-----------------------|
//! | `ScaledInputs` | xᵢ / ℓ                 | D arrays of `n`       |
//! | `local`        | σ² exp(…)              | `n` × `n`, lower half |
//! | `gram`         | 1 + X Xᵀ               | `n` × `n`, lower half |
//! | `covariance`   | K = local + λ² gram    | `n` × `n`, lower half |
//! | `noise_scale`  | s: noise of a sample over σₙ² | `n`                  |
//! | `factor`       | L, L Lᵀ = K + σₙ² diag(s) + jitter I | `n` × `n`, lower half |

use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::cholesky::llt;
use faer::traits::pulp::Arch;
use faer::{Mat, Par};

use crate::gp::exponential::exponential;
use crate::gp::kernel::one_plus_product;
use crate::gp::vectorise::vectorise;

/// Added to the diagonal when the plain covariance does not factorise, relative to its largest
/// entry there: first this …
const FIRST_JITTER: f64 = 1e-12;
/// … then ten times more each time, up to this.
const LARGEST_JITTER: f64 = 1e-4;

/// Inputs in units of the length scales, one contiguous array per input.
#[derive(Debug, Clone)]
pub(crate) struct ScaledInputs<const D: usize> {
    columns: [Vec<f64>; D],
}

impl<const D: usize> ScaledInputs<D> {
    /// All zero until [`scale`](Self::scale).
    pub(crate) fn new(samples: usize) -> Self {
        Self { columns: std::array::from_fn(|_| vec![0.0; samples]) }
    }

    /// Copies `inputs`, as many as at construction. Does not allocate.
    pub(crate) fn scale(&mut self, inputs: &[[f64; D]], length_scale: &[f64; D]) {
        for (dimension, column) in self.columns.iter_mut().enumerate() {
            let rate = 1.0 / length_scale[dimension];
            for (scaled, input) in column.iter_mut().zip(inputs) {
                *scaled = input[dimension] * rate;
            }
        }
    }

    /// One array per input.
    pub(crate) fn columns(&self) -> &[Vec<f64>; D] {
        &self.columns
    }

    /// Lower half of the squared-exponential part of K, the diagonal included. O(n² D); does not
    /// allocate.
    pub(crate) fn local_covariance(&self, variance: f64, local: &mut Mat<f64>) {
        vectorise(
            Arch::new(),
            #[inline(always)]
            || self.fill(variance, local),
        );
    }

    #[expect(
        clippy::inline_always,
        reason = "must be inlined to use the vector features of its caller"
    )]
    #[inline(always)]
    fn fill(&self, variance: f64, local: &mut Mat<f64>) {
        for first in 0..local.ncols() {
            let column = &mut local.col_as_slice_mut(first)[first..];
            column.fill(0.0);
            for scaled in &self.columns {
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
    }
}

/// Lower half of 1 + X Xᵀ, the diagonal included. It does not depend on any hyperparameter. O(n²
/// D).
pub(crate) fn gram<const D: usize>(inputs: &[[f64; D]]) -> Mat<f64> {
    Mat::from_fn(inputs.len(), inputs.len(), |row, column| {
        if row < column { 0.0 } else { one_plus_product(&inputs[row], &inputs[column]) }
    })
}

/// K = local + λ² gram, lower halves. O(n²); does not allocate.
pub(crate) fn add_linear(
    local: &Mat<f64>,
    linear_variance: f64,
    gram: &Mat<f64>,
    covariance: &mut Mat<f64>,
) {
    for column in 0..covariance.ncols() {
        let (local, gram) =
            (&local.col_as_slice(column)[column..], &gram.col_as_slice(column)[column..]);
        for ((sum, local), gram) in
            covariance.col_as_slice_mut(column)[column..].iter_mut().zip(local).zip(gram)
        {
            *sum = local + linear_variance * gram;
        }
    }
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
    use super::{NotPositiveDefinite, ScaledInputs, add_linear, factor_scratch, factorise, gram};
    use crate::gp::kernel::Kernel;
    use crate::gp::split_mix::SplitMix64;
    use faer::Mat;
    use faer::dyn_stack::MemBuffer;

    const KERNEL: Kernel<3> =
        Kernel { variance: 1.7, length_scale: [0.5, 1.0, 2.0], linear_variance: 0.3 };

    fn inputs(samples: usize) -> Vec<[f64; 3]> {
        let mut random = SplitMix64::new(1);
        (0..samples).map(|_| std::array::from_fn(|_| random.normal())).collect()
    }

    fn covariance(inputs: &[[f64; 3]]) -> Mat<f64> {
        let mut scaled = ScaledInputs::new(inputs.len());
        scaled.scale(inputs, &KERNEL.length_scale);
        let mut local = Mat::zeros(inputs.len(), inputs.len());
        scaled.local_covariance(KERNEL.variance, &mut local);
        let mut covariance = Mat::zeros(inputs.len(), inputs.len());
        add_linear(&local, KERNEL.linear_variance, &gram(inputs), &mut covariance);
        covariance
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
    fn entries_are_those_of_the_kernel() {
        let inputs = inputs(23);
        let covariance = covariance(&inputs);
        for (column, a) in inputs.iter().enumerate() {
            for (row, b) in inputs.iter().enumerate().skip(column) {
                assert!((covariance[(row, column)] - KERNEL.value(a, b)).abs() < 1e-14);
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
