//! Log marginal likelihood of one output, and its gradient.
//!
//! | here             | in the equations                  | size      |
//! |------------------|-----------------------------------|-----------|
//! | `targets`        | y                                 | `n`       |
//! | `covariance`     | K = S + λ² G + P, its parts       | `n` × `n` |
//! | `noise_scale`    | s: noise of a sample over σₙ²     | `n`       |
//! | `factor`         | L, L Lᵀ = C = K + σₙ² diag(s)     | `n` × `n` |
//! | `inverse`        | C⁻¹                               | `n` × `n` |
//! | `weights`        | α = C⁻¹ y                         | `n`       |
//!
//! ln p(y | X, θ) = −½ yᵀα − Σᵢ ln Lᵢᵢ − ½ n ln 2π. With W = C⁻¹ − α αᵀ,
//!
//! ```text
//! ∂/∂θ = −½ tr(W ∂C/∂θ)
//! ∂/∂ ln ℓ_d = −½ Σᵢⱼ Wᵢⱼ Sᵢⱼ ((xᵢ_d − xⱼ_d) / ℓ_d)²,   with P in place of S for a place input
//! ∂/∂ ln σ² = −½ Σᵢⱼ Wᵢⱼ Sᵢⱼ,   ∂/∂ ln π² = −½ Σᵢⱼ Wᵢⱼ Pᵢⱼ
//! ∂/∂ ln λ² = −½ λ² Σᵢⱼ Wᵢⱼ Gᵢⱼ,   ∂/∂ ln σₙ² = −½ σₙ² Σᵢ Wᵢᵢ sᵢ
//! ```
//!
//! S is the squared-exponential part of K, G = 1 + X Xᵀ that of the linear part, and P the place
//! part. Only the lower halves are ever formed.
//!
//! Reference: Rasmussen & Williams 2006, eqs. 5.8 and 5.9.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt;
use faer::traits::pulp::Arch;
use faer::{Mat, MatMut, Par};
use std::ops::Range;

use crate::gp::covariance::{Covariance, factor_scratch, factorise};
use crate::gp::data::{self, DataError};
use crate::gp::hyperparameters::{Hyperparameters, HyperparametersError, LogHyperparameters};
use crate::gp::kernel::Kernel;
use crate::gp::vectorise::vectorise;

/// Number of partial sums. They fix the order of a sum and fill vector registers.
const LANES: usize = 8;

/// Log marginal likelihood of the targets as a function of the hyperparameters, with the memory to
/// compute it.
pub struct Likelihood<'a, const D: usize> {
    inputs: &'a [[f64; D]],
    targets: &'a [f64],
    noise_scale: Vec<f64>,
    covariance: Covariance<D>,
    factor: Mat<f64>,
    inverse: Mat<f64>,
    weights: Vec<f64>,
    /// One column of W.
    slopes: Vec<f64>,
    /// The same, times a part of K.
    products: Vec<f64>,
    memory: MemBuffer,
}

/// The likelihood at one point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Evaluation<const D: usize> {
    /// ln p(y | X, θ).
    pub log_likelihood: f64,
    /// Its derivative with respect to the logarithm of each hyperparameter.
    pub gradient: LogHyperparameters<D>,
    /// Jitter: addition to the noise variance that the factorisation needed; normally zero.
    pub jitter: f64,
}

/// Why there is no likelihood.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum LikelihoodError {
    /// A likelihood needs at least one sample.
    #[error("there are no samples")]
    NoSamples,
    /// The samples are not usable.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The hyperparameters are not usable.
    #[error(transparent)]
    Hyperparameters(#[from] HyperparametersError),
    /// K + σₙ² I lost positive definiteness; more noise or fewer duplicate inputs help.
    #[error(
        "the covariance of {samples} samples is not positive definite, even with the largest \
         jitter; use more noise or fewer duplicate inputs"
    )]
    NotPositiveDefinite {
        /// Number of samples.
        samples: usize,
    },
}

impl<'a, const D: usize> Likelihood<'a, D> {
    /// Checks the samples and allocates the memory: five `n` × `n` matrices and faer's scratch, of
    /// the same size. A place part needs one more.
    pub fn new(inputs: &'a [[f64; D]], targets: &'a [f64]) -> Result<Self, LikelihoodError> {
        data::check(inputs, targets.as_chunks::<1>().0)?;
        let samples = inputs.len();
        if samples == 0 {
            return Err(LikelihoodError::NoSamples);
        }
        let scratch =
            factor_scratch(samples).or(llt::inverse::inverse_scratch::<f64>(samples, Par::Seq));
        Ok(Self {
            inputs,
            targets,
            noise_scale: vec![1.0; samples],
            covariance: Covariance::new(samples),
            factor: Mat::zeros(samples, samples),
            inverse: Mat::zeros(samples, samples),
            weights: vec![0.0; samples],
            slopes: vec![0.0; samples],
            products: vec![0.0; samples],
            memory: MemBuffer::new(scratch),
        })
    }

    /// The same with one noise per sample: σₙ² times its scale.
    pub fn with_noise_scale(mut self, noise_scale: &[f64]) -> Result<Self, LikelihoodError> {
        data::check_noise_scale(self.inputs.len(), noise_scale)?;
        self.noise_scale.copy_from_slice(noise_scale);
        Ok(self)
    }

    /// Number of samples.
    pub fn samples(&self) -> usize {
        self.inputs.len()
    }

    /// Value and gradient. O(n³); uses the memory allocated at construction.
    pub fn evaluate(
        &mut self,
        hyperparameters: &Hyperparameters<D>,
    ) -> Result<Evaluation<D>, LikelihoodError> {
        hyperparameters.check()?;
        let samples = self.inputs.len();
        let Hyperparameters { kernel, noise_variance } = *hyperparameters;
        self.covariance.fill(self.inputs, &kernel);
        let jitter = factorise(
            self.covariance.sum(),
            noise_variance,
            &self.noise_scale,
            &mut self.factor,
            &mut self.memory,
        )
        .map_err(|_| LikelihoodError::NotPositiveDefinite { samples })?;

        // α = L⁻ᵀ L⁻¹ y
        self.weights.copy_from_slice(self.targets);
        llt::solve::solve_in_place(
            self.factor.as_ref(),
            MatMut::from_column_major_slice_mut(&mut self.weights, samples, 1),
            Par::Seq,
            MemStack::new(&mut self.memory),
        );
        let fit: f64 =
            self.targets.iter().zip(&self.weights).map(|(target, weight)| target * weight).sum();
        let log_root_determinant: f64 = (0..samples).map(|i| self.factor[(i, i)].ln()).sum();
        let log_likelihood =
            -0.5 * fit - log_root_determinant - 0.5 * samples as f64 * std::f64::consts::TAU.ln();

        llt::inverse::inverse(
            self.inverse.as_mut(),
            self.factor.as_ref(),
            Par::Seq,
            MemStack::new(&mut self.memory),
        );
        let gradient = vectorise(
            Arch::new(),
            #[inline(always)]
            || self.gradient(&kernel, noise_variance),
        );
        Ok(Evaluation { log_likelihood, gradient, jitter })
    }

    /// The sums of the module's doc, over the lower half, column by column.
    #[expect(
        clippy::inline_always,
        reason = "must be inlined to use the vector features of its caller"
    )]
    #[inline(always)]
    fn gradient(&mut self, kernel: &Kernel<D>, noise_variance: f64) -> LogHyperparameters<D> {
        let samples = self.weights.len();
        let split = kernel.local_inputs();
        let has_place = kernel.place_variance != 0.0;
        let mut distance_sums = [[0.0; LANES]; D];
        let (mut local_sums, mut place_sums) = ([0.0; LANES], [0.0; LANES]);
        let mut linear_sums = [0.0; LANES];
        let (mut trace, mut linear_trace, mut noise_trace) = (0.0, 0.0, 0.0);
        let (scaled, gram) = (self.covariance.scaled(), self.covariance.gram());
        for first in 0..samples {
            let weight = self.weights[first];
            let diagonal = self.inverse[(first, first)] - weight * weight;
            trace += diagonal;
            noise_trace += diagonal * self.noise_scale[first];
            linear_trace += diagonal * gram[(first, first)];

            let below = first + 1;
            let slopes = &mut self.slopes[below..];
            let inverse = &self.inverse.col_as_slice(first)[below..];
            for ((slope, inverse), other) in
                slopes.iter_mut().zip(inverse).zip(&self.weights[below..])
            {
                *slope = inverse - weight * other;
            }
            if kernel.linear_variance != 0.0 {
                add_products(&mut linear_sums, slopes, &gram.col_as_slice(first)[below..]);
            }
            let products = &mut self.products[below..];
            let mut add_part = |part: &Mat<f64>, inputs: Range<usize>, sums: &mut [f64; LANES]| {
                let part = &part.col_as_slice(first)[below..];
                for ((product, slope), part) in products.iter_mut().zip(&*slopes).zip(part) {
                    *product = slope * part;
                }
                add(sums, products);
                for (sums, column) in distance_sums[inputs.clone()].iter_mut().zip(&scaled[inputs])
                {
                    add_squares(sums, products, &column[below..], column[first]);
                }
            };
            add_part(self.covariance.local(), 0..split, &mut local_sums);
            if has_place {
                add_part(self.covariance.place(), split..D, &mut place_sums);
            }
        }
        // Each pair below the diagonal counts twice, against the ½. On the diagonal S is σ², P is
        // π², and the distance zero.
        let linear = || -kernel.linear_variance * (total(&linear_sums) + 0.5 * linear_trace);
        LogHyperparameters {
            length_scale: distance_sums.map(|sums| -total(&sums)),
            variance: -total(&local_sums) - 0.5 * kernel.variance * trace,
            noise_variance: -0.5 * noise_variance * noise_trace,
            linear_variance: (kernel.linear_variance != 0.0).then(linear),
            place_variance: has_place
                .then(|| -total(&place_sums) - 0.5 * kernel.place_variance * trace),
        }
    }
}

/// sums += values, in lanes.
#[expect(
    clippy::inline_always,
    reason = "must be inlined to use the vector features of its caller"
)]
#[inline(always)]
fn add(sums: &mut [f64; LANES], values: &[f64]) {
    let (chunks, rest) = values.as_chunks::<LANES>();
    for chunk in chunks {
        for (sum, value) in sums.iter_mut().zip(chunk) {
            *sum += value;
        }
    }
    for (sum, value) in sums.iter_mut().zip(rest) {
        *sum += value;
    }
}

/// sums += a b, in lanes.
#[expect(
    clippy::inline_always,
    reason = "must be inlined to use the vector features of its caller"
)]
#[inline(always)]
fn add_products(sums: &mut [f64; LANES], a: &[f64], b: &[f64]) {
    let ((a, last_a), (b, last_b)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    for (a, b) in a.iter().zip(b) {
        for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
            *sum += a * b;
        }
    }
    for ((sum, a), b) in sums.iter_mut().zip(last_a).zip(last_b) {
        *sum += a * b;
    }
}

/// sums += factor (there − here)², in lanes.
#[expect(
    clippy::inline_always,
    reason = "must be inlined to use the vector features of its caller"
)]
#[inline(always)]
fn add_squares(sums: &mut [f64; LANES], factors: &[f64], there: &[f64], here: f64) {
    let ((factors, last_factors), (there, last_there)) =
        (factors.as_chunks::<LANES>(), there.as_chunks::<LANES>());
    for (factors, there) in factors.iter().zip(there) {
        for ((sum, factor), there) in sums.iter_mut().zip(factors).zip(there) {
            let difference = there - here;
            *sum += factor * (difference * difference);
        }
    }
    for ((sum, factor), there) in sums.iter_mut().zip(last_factors).zip(last_there) {
        let difference = there - here;
        *sum += factor * (difference * difference);
    }
}

fn total(lanes: &[f64; LANES]) -> f64 {
    lanes.iter().sum()
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "a test ends at the first error")]

    use super::{Likelihood, LikelihoodError};
    use crate::gp::hyperparameters::{Hyperparameters, LogHyperparameters};
    use crate::gp::split_mix::SplitMix64;
    use proptest::prelude::*;

    fn samples<const D: usize>(count: usize, seed: u64) -> (Vec<[f64; D]>, Vec<f64>) {
        let mut random = SplitMix64::new(seed);
        let inputs: Vec<[f64; D]> =
            (0..count).map(|_| std::array::from_fn(|_| random.normal())).collect();
        let targets = inputs
            .iter()
            .map(|x| (2.0 * x[0]).sin() + 0.3 * x[1] + 0.1 * random.normal())
            .collect();
        (inputs, targets)
    }

    /// Compares the gradient at `log` with finite differences.
    fn compare_gradient<const D: usize>(
        count: usize,
        seed: u64,
        log: &[f64],
    ) -> Result<(), TestCaseError> {
        let (inputs, targets) = samples::<D>(count, seed);
        let noise_scale: Vec<f64> = (0..count).map(|i| 1.0 + (i % 5) as f64).collect();
        let mut likelihood =
            Likelihood::new(&inputs, &targets).unwrap().with_noise_scale(&noise_scale).unwrap();
        let mut at = |log: &[f64]| {
            likelihood.evaluate(&LogHyperparameters::from_slice(log).unwrap().exp()).unwrap()
        };
        let gradient: Vec<f64> = at(log).gradient.iter().collect();
        prop_assert_eq!(gradient.len(), log.len());
        for i in 0..log.len() {
            let (mut above, mut below) = (log.to_vec(), log.to_vec());
            above[i] += 1e-5;
            below[i] -= 1e-5;
            let difference = (at(&above).log_likelihood - at(&below).log_likelihood) / 2e-5;
            prop_assert!(
                (gradient[i] - difference).abs() < 1e-5 * (1.0 + difference.abs()),
                "{i}: {} {difference}",
                gradient[i]
            );
        }
        Ok(())
    }

    proptest! {
        #[test]
        fn gradient_matches_finite_differences(
            count in 1_usize..40,
            seed in any::<u64>(),
            log in prop::collection::vec(-1.5..1.5, 4..=5),
        ) {
            compare_gradient::<2>(count, seed, &log)?;
        }

        #[test]
        fn gradient_with_a_place_part_matches_finite_differences(
            count in 1_usize..40,
            seed in any::<u64>(),
            log in prop::collection::vec(-1.5..1.5, 10),
        ) {
            compare_gradient::<6>(count, seed, &log)?;
        }
    }

    #[test]
    fn the_likelihood_of_one_sample_is_a_normal_density() {
        let mut likelihood = Likelihood::new(&[[0.3, 0.4]], &[0.7]).unwrap();
        let evaluation = likelihood.evaluate(&Hyperparameters::new([1.0, 1.0], 1.5, 0.5)).unwrap();
        let expected = -0.5 * 0.49 / 2.0 - 0.5 * (2.0 * std::f64::consts::TAU).ln();
        assert!((evaluation.log_likelihood - expected).abs() < 1e-14);
    }

    #[test]
    fn duplicate_inputs_get_a_jitter_that_is_reported() {
        let (mut inputs, targets) = samples::<2>(20, 3);
        inputs[5] = inputs[11];
        let mut likelihood = Likelihood::new(&inputs, &targets).unwrap();
        let evaluation =
            likelihood.evaluate(&Hyperparameters::new([1.0, 1.0], 1.0, 1e-20)).unwrap();
        assert!(evaluation.jitter > 0.0);
        assert!(
            evaluation.log_likelihood.is_finite() && evaluation.gradient.iter().all(f64::is_finite)
        );
    }

    #[test]
    fn bad_samples_are_rejected_with_their_index() {
        let empty: [[f64; 2]; 0] = [];
        assert_eq!(Likelihood::new(&empty, &[]).err(), Some(LikelihoodError::NoSamples));
        let error = Likelihood::new(&[[0.0, 1.0]], &[1.0, 2.0]).err().unwrap();
        assert_eq!(error.to_string(), "1 inputs but 2 targets");
        let error =
            Likelihood::new(&[[0.0, 1.0], [0.0, f64::INFINITY]], &[1.0, 2.0]).err().unwrap();
        assert_eq!(error.to_string(), "input 1 of sample 1 is inf");
        let error = Likelihood::new(&[[0.0, 1.0], [0.0, 0.0]], &[1.0, f64::NAN]).err().unwrap();
        assert_eq!(error.to_string(), "target 0 of sample 1 is NaN");
    }
}
