//! Fits the hyperparameters of one output to samples: the maximum of the log marginal likelihood,
//! or of the posterior under priors.

use nalgebra::DVector;

use crate::gp::hyperparameters::{
    Bounds, Hyperparameters, HyperparametersError, LogHyperparameters,
};
use crate::gp::likelihood::{Evaluation, Likelihood, LikelihoodError};
use crate::gp::optimise::{Convergence, MinimiseError, MinimiseOptions, SearchBox, minimise};

/// Options of a fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FitOptions<const D: usize> {
    /// Box of the hyperparameters.
    pub bounds: Bounds<D>,
    /// Priors of the hyperparameters; `None` is the plain marginal likelihood.
    pub priors: Option<Priors<D>>,
    /// Evaluations of the likelihood, O(n³) each.
    pub max_evaluations: usize,
    /// Quasi-Newton steps.
    pub max_iterations: usize,
}

impl<const D: usize> Default for FitOptions<D> {
    /// Wide bounds, no priors, at most 100 steps.
    fn default() -> Self {
        Self { bounds: Bounds::default(), priors: None, max_evaluations: 200, max_iterations: 100 }
    }
}

/// Prior knowledge of the hyperparameters. It decides where the data does not excite an input.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Priors<const D: usize> {
    /// Of each length scale.
    pub length_scale: [Option<LogNormal>; D],
    /// Of the prior variance σ².
    pub variance: Option<LogNormal>,
    /// Of the noise variance σₙ².
    pub noise_variance: Option<LogNormal>,
    /// Of the linear variance λ²; of no effect without a linear part.
    pub linear_variance: Option<LogNormal>,
    /// Of the place variance π²; of no effect without a place part.
    pub place_variance: Option<LogNormal>,
}

impl<const D: usize> Priors<D> {
    /// No prior knowledge.
    pub const NONE: Self = Self {
        length_scale: [None; D],
        variance: None,
        noise_variance: None,
        linear_variance: None,
        place_variance: None,
    };
}

/// Normal distribution of a logarithm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LogNormal {
    /// Median, in the unit of the hyperparameter.
    pub median: f64,
    /// Standard deviation of the natural logarithm.
    pub log_deviation: f64,
}

/// Result of a fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fitted<const D: usize> {
    /// The hyperparameters.
    pub hyperparameters: Hyperparameters<D>,
    /// Log marginal likelihood there, without the priors.
    pub log_likelihood: f64,
    /// Jitter: addition to the noise variance that the factorisation needed there; normally zero.
    pub jitter: f64,
    /// Evaluations used, over all starts.
    pub evaluations: usize,
    /// Why the search from the best start ended.
    pub converged: Convergence,
}

/// Why a fit failed.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum FitError {
    /// The samples, or the start, are not usable.
    #[error(transparent)]
    Likelihood(#[from] LikelihoodError),
    /// The start is not usable.
    #[error("the start: {0}")]
    Start(HyperparametersError),
    /// A bound is not usable.
    #[error("a bound: {0}")]
    Bounds(HyperparametersError),
    /// The priors are not usable.
    #[error(
        "a prior has median {median} and deviation {log_deviation}; \
         both must be positive and finite"
    )]
    Prior {
        /// Its median.
        median: f64,
        /// Its deviation.
        log_deviation: f64,
    },
    /// The search could not begin.
    #[error(transparent)]
    Minimise(#[from] MinimiseError),
}

/// Largest factor (as a logarithm) by which hyperparameters move in one step. Further out the
/// likelihood is not quadratic.
const LARGEST_STEP: f64 = 3.0;
/// Curvature of the log likelihood per sample, in a logarithm, before any was measured. (That in ln
/// σₙ² is at most ½.)
const CURVATURE_PER_SAMPLE: f64 = 0.1;

/// Fits the hyperparameters of one output to samples, from the point of the bounds nearest to
/// `start`.
///
/// The kernel has a linear part and a place part, whose variances are fitted too, if and only if
/// `start` has them.
///
/// At most `max_evaluations` evaluations of O(n³). Their memory is allocated once.
pub fn fit<const D: usize>(
    inputs: &[[f64; D]],
    targets: &[f64],
    start: &Hyperparameters<D>,
    options: &FitOptions<D>,
) -> Result<Fitted<D>, FitError> {
    fit_likelihood(&mut Likelihood::new(inputs, targets)?, start, options)
}

/// The same for a given likelihood, whose samples may have noise of their own.
pub fn fit_likelihood<const D: usize>(
    likelihood: &mut Likelihood<'_, D>,
    start: &Hyperparameters<D>,
    options: &FitOptions<D>,
) -> Result<Fitted<D>, FitError> {
    options.check(start)?;
    let first = options.bounds.clamp(&start.ln());
    // The cost is minus the log likelihood, minus the log density of the priors.
    let mut best_cost = f64::INFINITY;
    let mut best = Fitted {
        hyperparameters: first.exp(),
        log_likelihood: f64::NEG_INFINITY,
        jitter: 0.0,
        evaluations: 0,
        converged: Convergence::Budget,
    };
    let mut failure = None;
    let minimise_options = options.minimise_options(likelihood.samples());
    let objective = |point: &DVector<f64>| {
        let nowhere = (f64::INFINITY, DVector::zeros(point.len()));
        let Some(log) = LogHyperparameters::from_slice(point.as_slice()) else { return nowhere };
        let hyperparameters = log.exp();
        // O(n³) takes long: let other threads have the processor in between.
        std::thread::yield_now();
        let Evaluation { log_likelihood, gradient, jitter } =
            match likelihood.evaluate(&hyperparameters) {
                Ok(evaluation) => evaluation,
                Err(error) => {
                    failure = Some(error);
                    return nowhere;
                }
            };
        let (prior, prior_slopes) = options.log_prior(&log);
        let cost = -log_likelihood - prior;
        if cost < best_cost {
            best_cost = cost;
            best = Fitted { hyperparameters, log_likelihood, jitter, ..best };
        }
        (cost, vector(&prior_slopes) * -1.0 - vector(&gradient))
    };
    let minimum =
        minimise(objective, &vector(&first), &options.search_box(&first), &minimise_options)
            .map_err(|error| failure.map_or(FitError::Minimise(error), FitError::Likelihood))?;
    Ok(Fitted { evaluations: minimum.evaluations, converged: minimum.convergence, ..best })
}

impl<const D: usize> FitOptions<D> {
    fn check(&self, start: &Hyperparameters<D>) -> Result<(), FitError> {
        start.check().map_err(FitError::Start)?;
        self.bounds.lower.check().map_err(FitError::Bounds)?;
        self.bounds.upper.check().map_err(FitError::Bounds)?;
        let smallest = self.bounds.lower.kernel.linear_variance;
        if start.kernel.linear_variance != 0.0 && smallest == 0.0 {
            return Err(FitError::Bounds(HyperparametersError::LinearVariance { value: smallest }));
        }
        let smallest = self.bounds.lower.kernel.place_variance;
        if start.kernel.place_variance != 0.0 && smallest == 0.0 {
            return Err(FitError::Bounds(HyperparametersError::PlaceVariance { value: smallest }));
        }
        for &LogNormal { median, log_deviation } in
            self.priors.iter().flat_map(Priors::each).flatten()
        {
            let good = |value: f64| value.is_finite() && value > 0.0;
            if !(good(median) && good(log_deviation)) {
                return Err(FitError::Prior { median, log_deviation });
            }
        }
        Ok(())
    }

    /// Log density of the priors (without its constant) and its derivatives.
    fn log_prior(&self, at: &LogHyperparameters<D>) -> (f64, LogHyperparameters<D>) {
        let mut slopes = LogHyperparameters {
            length_scale: [0.0; D],
            variance: 0.0,
            noise_variance: 0.0,
            linear_variance: at.linear_variance.map(|_| 0.0),
            place_variance: at.place_variance.map(|_| 0.0),
        };
        let Some(priors) = &self.priors else { return (0.0, slopes) };
        let mut sum = 0.0;
        let mut pull = |prior: &Option<LogNormal>, at: f64, slope: &mut f64| {
            if let Some(LogNormal { median, log_deviation }) = prior {
                let deviations = (at - median.ln()) / log_deviation;
                sum -= 0.5 * deviations * deviations;
                *slope = -deviations / log_deviation;
            }
        };
        for (dimension, slope) in slopes.length_scale.iter_mut().enumerate() {
            pull(&priors.length_scale[dimension], at.length_scale[dimension], slope);
        }
        pull(&priors.variance, at.variance, &mut slopes.variance);
        pull(&priors.noise_variance, at.noise_variance, &mut slopes.noise_variance);
        if let (Some(at), Some(slope)) = (at.linear_variance, &mut slopes.linear_variance) {
            pull(&priors.linear_variance, at, slope);
        }
        if let (Some(at), Some(slope)) = (at.place_variance, &mut slopes.place_variance) {
            pull(&priors.place_variance, at, slope);
        }
        (sum, slopes)
    }

    /// The bounds, with a linear and a place part if `start` has them.
    fn search_box(&self, start: &LogHyperparameters<D>) -> SearchBox {
        let of_kind = |bound: &Hyperparameters<D>| {
            let log = bound.ln();
            vector(&LogHyperparameters {
                linear_variance: log.linear_variance.filter(|_| start.linear_variance.is_some()),
                place_variance: log.place_variance.filter(|_| start.place_variance.is_some()),
                ..log
            })
        };
        SearchBox { lower: of_kind(&self.bounds.lower), upper: of_kind(&self.bounds.upper) }
    }

    fn minimise_options(&self, samples: usize) -> MinimiseOptions {
        MinimiseOptions {
            max_evaluations: self.max_evaluations,
            max_iterations: self.max_iterations,
            largest_step: LARGEST_STEP,
            first_curvature: CURVATURE_PER_SAMPLE * samples as f64,
            ..MinimiseOptions::default()
        }
    }
}

impl<const D: usize> Priors<D> {
    fn each(&self) -> impl Iterator<Item = &Option<LogNormal>> {
        self.length_scale.iter().chain([
            &self.variance,
            &self.noise_variance,
            &self.linear_variance,
            &self.place_variance,
        ])
    }
}

fn vector<const D: usize>(values: &LogHyperparameters<D>) -> DVector<f64> {
    DVector::from_vec(values.iter().collect())
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "a test ends at the first error")]

    use super::{Convergence, FitError, FitOptions, LogNormal, Priors, fit};
    use crate::gp::hyperparameters::Hyperparameters;
    use crate::gp::split_mix::SplitMix64;

    const START: Hyperparameters<2> = Hyperparameters::new([1.0; 2], 1.0, 0.1);

    /// A function of the first input alone, with noise of deviation 0.1.
    fn samples(count: usize) -> (Vec<[f64; 2]>, Vec<f64>) {
        let mut random = SplitMix64::new(5);
        let inputs: Vec<[f64; 2]> =
            (0..count).map(|_| [2.0 * random.normal(), random.normal()]).collect();
        let targets = inputs.iter().map(|x| (1.5 * x[0]).sin() + 0.1 * random.normal()).collect();
        (inputs, targets)
    }

    #[test]
    fn noise_and_length_scales_are_identified() {
        let (inputs, targets) = samples(100);
        let fitted = fit(&inputs, &targets, &START, &FitOptions::default()).unwrap();
        let Hyperparameters { kernel, noise_variance } = fitted.hyperparameters;
        assert_eq!(
            kernel.linear_variance.to_bits(),
            0.0_f64.to_bits(),
            "what began without a linear part ends without one"
        );
        assert!((noise_variance.sqrt() - 0.1).abs() < 0.03, "{noise_variance}");
        assert!(kernel.length_scale[0] < 3.0 && kernel.length_scale[1] > 10.0, "{kernel:?}");
        assert_ne!(fitted.converged, Convergence::Budget);
    }

    #[test]
    fn a_prior_decides_the_length_scale_of_an_input_without_excitation() {
        let (mut inputs, targets) = samples(60);
        for input in &mut inputs {
            input[1] = 0.0;
        }
        let prior = LogNormal { median: 2.0, log_deviation: 0.5 };
        let priors = Priors { length_scale: [Some(prior); 2], ..Priors::NONE };
        let options = FitOptions { priors: Some(priors), ..FitOptions::default() };
        let fitted = fit(&inputs, &targets, &START, &options).unwrap();
        assert!((fitted.hyperparameters.kernel.length_scale[1] - 2.0).abs() < 1e-3);
    }

    #[test]
    fn a_linear_function_is_fitted_by_the_linear_part() {
        let (inputs, _) = samples(60);
        let mut random = SplitMix64::new(8);
        let targets: Vec<f64> =
            inputs.iter().map(|x| 0.7 + 2.0 * x[0] - x[1] + 0.1 * random.normal()).collect();
        let fitted =
            fit(&inputs, &targets, &START.with_linear(0.1), &FitOptions::default()).unwrap();
        let plain = fit(&inputs, &targets, &START, &FitOptions::default()).unwrap();
        let Hyperparameters { kernel, noise_variance } = fitted.hyperparameters;
        assert!(
            kernel.linear_variance > 0.3 && kernel.length_scale.iter().all(|&scale| scale > 5.0),
            "{kernel:?}"
        );
        assert!((noise_variance.sqrt() - 0.1).abs() < 0.03, "{noise_variance}");
        assert!(fitted.log_likelihood > plain.log_likelihood);
    }

    #[test]
    fn the_evaluation_budget_and_the_bounds_are_kept() {
        let (inputs, targets) = samples(30);
        let mut options = FitOptions { max_evaluations: 5, ..FitOptions::default() };
        options.bounds.upper.kernel.length_scale = [1.2; 2];
        let fitted = fit(&inputs, &targets, &START, &options).unwrap();
        assert!(fitted.evaluations <= 5);
        assert!(
            fitted.hyperparameters.kernel.length_scale.iter().all(|&scale| scale <= 1.2 + 1e-12)
        );
    }

    #[test]
    fn a_fit_that_fails_reports_the_reason() {
        let (inputs, targets) = samples(10);
        let options = FitOptions::default();
        let message = |result: Result<_, FitError>| result.err().unwrap().to_string();
        assert_eq!(
            message(fit(&inputs, &targets[1..], &START, &options)),
            "10 inputs but 9 targets"
        );
        assert_eq!(message(fit::<2>(&[], &[], &START, &options)), "there are no samples");
        let start = Hyperparameters::new([1.0, -1.0], 1.0, 1.0);
        assert_eq!(
            message(fit(&inputs, &targets, &start, &options)),
            "the start: length scale 1 is -1; it must be positive and finite"
        );
        let mut crossed = options;
        crossed.bounds.upper.noise_variance = 1e-9;
        assert!(matches!(fit(&inputs, &targets, &START, &crossed), Err(FitError::Minimise(_))));
        let prior = LogNormal { median: 0.0, log_deviation: 1.0 };
        let priors = Priors { variance: Some(prior), ..Priors::NONE };
        let bad_prior = FitOptions { priors: Some(priors), ..options };
        assert!(matches!(fit(&inputs, &targets, &START, &bad_prior), Err(FitError::Prior { .. })));
    }
}
