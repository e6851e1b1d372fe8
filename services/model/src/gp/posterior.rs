//! Posterior of three outputs over shared inputs: mean, gradient, variance.
//!
//! | here      | in the equations              | size                  |
//! |-----------|-------------------------------|-----------------------|
//! | `noise_scale` | s: noise of a sample over σₙ² | `n`               |
//! | `weights` | α = (K + σₙ² diag(s))⁻¹ y     | `n`, per output       |
//! | `factor`  | L, L Lᵀ = K + σₙ² diag(s)     | `n` × `n`, lower half |
//! | `k`       | k(X, x)                       | `n`                   |
//!
//! ```text
//! mean = kᵀα,   variance = k(x, x) − ‖L⁻¹k‖²
//! ```
//!
//! The linear part of the kernel adds a plane to the mean, which is computed once. s is the
//! squared-exponential part of k, p its place part, if there is one:
//!
//! ```text
//! mean = Σᵢ αᵢ (sᵢ + pᵢ) + w·x + b,   w = λ² Σᵢ αᵢ Xᵢ,   b = λ² Σᵢ αᵢ
//! ∂mean/∂x_d = −Σᵢ αᵢ sᵢ (x_d − Xᵢ_d) / ℓ_d² + w_d,   with pᵢ in place of sᵢ for a place input
//! ```
//!
//! The variance is that of the function; an observation has σₙ² more. Samples are stored in blocks
//! of eight, padded by samples of zero weight. So a query runs in vector registers with its sums in
//! a fixed order. It has the same bits on every call, and with registers of any width.
//!
//! Reference: Rasmussen & Williams 2006, eqs. 2.25, 2.26 and algorithm 2.1.
//!
//! ```
//! use model::gp::hyperparameters::Hyperparameters;
//! use model::gp::posterior::{Posterior, VarianceScratch};
//!
//! // Eleven samples of three functions of one input.
//! let inputs: Vec<[f64; 1]> = (0..=10).map(|i| [0.5 * f64::from(i)]).collect();
//! let targets: Vec<[f64; 3]> = inputs.iter().map(|[x]| [x.sin(), x.cos(), 0.1 * x]).collect();
//! let prior = Hyperparameters::new([1.0], 1.0, 1e-6); // length scale, variance, noise variance
//! let posterior = Posterior::new(&inputs, &targets, &[prior; 3])?;
//!
//! let [sine, cosine, _] = posterior.mean(&[1.75]);
//! assert!((sine - 1.75_f64.sin()).abs() < 1e-2 && (cosine - 1.75_f64.cos()).abs() < 1e-2);
//!
//! // The variance is small between the samples, and that of the prior far away from them.
//! let mut scratch = VarianceScratch::new(posterior.samples());
//! assert!(posterior.variance(&[1.75], &mut scratch)[0] < 1e-4);
//! assert!((posterior.variance(&[50.0], &mut scratch)[0] - 1.0).abs() < 1e-9);
//! # Ok::<(), model::gp::posterior::PosteriorError>(())
//! ```

mod block;
mod output;

use faer::traits::pulp::Arch;

use crate::gp::data::{self, DataError};
use crate::gp::hyperparameters::{Hyperparameters, HyperparametersError};
use crate::gp::vectorise::vectorise;
use block::LANES;
use output::{Output, Work};

/// How many outputs share the inputs: one per axis of the body velocity.
pub const OUTPUTS: usize = 3;

/// Posterior of three functions.
#[derive(Debug, Clone)]
pub struct Posterior<const D: usize> {
    outputs: [Output<D>; OUTPUTS],
    samples: usize,
    /// Vector instructions of this machine.
    machine: Arch,
}

/// Mean of each output and its gradient.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeanAndGradient<const D: usize> {
    /// In output units.
    pub mean: [f64; OUTPUTS],
    /// Row per output, column per input: output units per input unit.
    pub gradient: [[f64; D]; OUTPUTS],
}

/// Memory of a variance query; one per thread.
#[derive(Debug, Clone)]
pub struct VarianceScratch {
    column: Vec<f64>,
}

/// Why samples give no posterior.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum PosteriorError {
    /// The samples are not usable.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The hyperparameters of an output are not usable.
    #[error("output {output}: {reason}")]
    Hyperparameters {
        /// Index of the output.
        output: usize,
        /// The hyperparameter, and why.
        reason: HyperparametersError,
    },
    /// K + σₙ² I lost positive definiteness; more noise or fewer duplicate inputs help.
    #[error(
        "output {output}: the covariance of {samples} samples is not positive definite, even with \
         the largest jitter; use more noise or fewer duplicate inputs"
    )]
    NotPositiveDefinite {
        /// Index of the output.
        output: usize,
        /// Number of samples.
        samples: usize,
    },
}

impl<const D: usize> Posterior<D> {
    /// Conditions three priors on samples. O(n³) time, O(n²) memory. Without samples, the posterior
    /// is the prior.
    pub fn new(
        inputs: &[[f64; D]],
        targets: &[[f64; OUTPUTS]],
        hyperparameters: &[Hyperparameters<D>; OUTPUTS],
    ) -> Result<Self, PosteriorError> {
        Self::with_noise_scale(inputs, targets, &vec![1.0; inputs.len()], hyperparameters)
    }

    /// The same with one noise per sample: σₙ² times its scale.
    pub fn with_noise_scale(
        inputs: &[[f64; D]],
        targets: &[[f64; OUTPUTS]],
        noise_scale: &[f64],
        hyperparameters: &[Hyperparameters<D>; OUTPUTS],
    ) -> Result<Self, PosteriorError> {
        data::check(inputs, targets)?;
        data::check_noise_scale(inputs.len(), noise_scale)?;
        let mut posterior = Self::prior_only(hyperparameters)?;
        posterior.samples = inputs.len();
        let mut work = Work::new(inputs.len());
        for (output, state) in posterior.outputs.iter_mut().enumerate() {
            work.weights.clear();
            work.weights.extend(targets.iter().map(|target| target[output]));
            state
                .condition(inputs, noise_scale, &mut work)
                .ok_or(PosteriorError::NotPositiveDefinite { output, samples: inputs.len() })?;
        }
        Ok(posterior)
    }

    /// Three priors: mean zero, variance k(x, x) everywhere.
    pub fn prior_only(
        hyperparameters: &[Hyperparameters<D>; OUTPUTS],
    ) -> Result<Self, PosteriorError> {
        for (output, hyperparameters) in hyperparameters.iter().enumerate() {
            hyperparameters
                .check()
                .map_err(|reason| PosteriorError::Hyperparameters { output, reason })?;
        }
        Ok(Self { outputs: hyperparameters.map(Output::prior), samples: 0, machine: Arch::new() })
    }

    /// Slope of the linear part of each output's mean; zero for a kernel without one.
    pub fn slope(&self) -> [[f64; D]; OUTPUTS] {
        self.outputs.each_ref().map(|output| output.slope)
    }

    /// Number of samples.
    pub fn samples(&self) -> usize {
        self.samples
    }

    /// Hyperparameters of each output.
    pub fn hyperparameters(&self) -> [Hyperparameters<D>; OUTPUTS] {
        self.outputs.each_ref().map(|output| output.hyperparameters)
    }

    /// α of each output, one entry per sample.
    pub fn weights(&self) -> [&[f64]; OUTPUTS] {
        self.outputs.each_ref().map(|output| output.weights.as_slice())
    }

    /// Jitter: addition to the noise variance of each output that the factorisation needed;
    /// normally zero.
    pub fn jitter(&self) -> [f64; OUTPUTS] {
        self.outputs.each_ref().map(|output| output.jitter)
    }

    /// Mean of each output at `x`. O(n D); does not allocate.
    pub fn mean(&self, x: &[f64; D]) -> [f64; OUTPUTS] {
        let mut mean = [0.0; OUTPUTS];
        vectorise(
            self.machine,
            #[inline(always)]
            || {
                for (mean, output) in mean.iter_mut().zip(&self.outputs) {
                    *mean = output.mean(x);
                }
            },
        );
        mean
    }

    /// Mean of each output at `x`, and its gradient. O(n D); does not allocate. The mean has the
    /// bits of [`mean`](Self::mean).
    pub fn mean_and_gradient(&self, x: &[f64; D]) -> MeanAndGradient<D> {
        let mut answer = MeanAndGradient { mean: [0.0; OUTPUTS], gradient: [[0.0; D]; OUTPUTS] };
        vectorise(
            self.machine,
            #[inline(always)]
            || {
                for ((mean, gradient), output) in
                    answer.mean.iter_mut().zip(&mut answer.gradient).zip(&self.outputs)
                {
                    (*mean, *gradient) = output.mean_and_gradient(x);
                }
            },
        );
        answer
    }

    /// Variance of each function at `x`, between zero and its prior variance. O(n²).
    ///
    /// Does not allocate if the scratch is for at least as many samples; else the scratch grows.
    pub fn variance(&self, x: &[f64; D], scratch: &mut VarianceScratch) -> [f64; OUTPUTS] {
        let padded = self.samples.next_multiple_of(LANES);
        if scratch.column.len() < padded {
            scratch.column.resize(padded, 0.0);
        }
        let column = &mut scratch.column[..padded];
        let mut variance = [0.0; OUTPUTS];
        vectorise(
            self.machine,
            #[inline(always)]
            || {
                for (variance, output) in variance.iter_mut().zip(&self.outputs) {
                    *variance = output.variance(x, column);
                }
            },
        );
        variance
    }
}

impl VarianceScratch {
    /// Memory for posteriors of up to `samples` samples.
    pub fn new(samples: usize) -> Self {
        Self { column: vec![0.0; samples.next_multiple_of(LANES)] }
    }
}

#[cfg(test)]
mod tests;
