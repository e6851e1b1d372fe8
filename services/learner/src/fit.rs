//! A data set in, hyperparameters and posterior out. Deterministic: budgets count evaluations.

use model::gp::dataset::Observation;
use model::gp::fit::{FitError, FitOptions, LogNormal, Priors, fit};
use model::gp::hyperparameters::{Bounds, Hyperparameters};
use model::gp::normalisation::{Normalisation, NormalisationError};
use model::gp::posterior::{Posterior, PosteriorError};
use model::learned::{INPUTS, Layout, Learned};
use model::{AXES, Velocity};

/// Fewest samples that a fit is tried on; below, the model says nothing.
const SAMPLES_MIN: usize = 4;

/// What the learner believes before it has seen anything.
#[derive(Debug, Clone, Copy)]
pub struct Outset {
    /// What the Gaussian processes see.
    pub layout: Layout,
    /// Smallest scale of each input, by physics: data without spread must not give a huge gain.
    pub scale_floor: [f64; INPUTS],
    /// Largest |g| that physics allows \[m/s, m/s, rad/s\].
    pub bound: Velocity,
    /// Budget of one fit, in evaluations per axis.
    pub evaluations_max: usize,
}

/// Why a fit came to nothing.
#[derive(Debug, thiserror::Error)]
pub enum FailedFit {
    /// The inputs cannot be scaled.
    #[error(transparent)]
    Normalisation(#[from] NormalisationError),
    /// The hyperparameters of one axis.
    #[error("axis {axis}: {source}")]
    Axis {
        /// 0 forward, 1 left, 2 yaw.
        axis: usize,
        /// What went wrong.
        source: FitError,
    },
    /// The posterior.
    #[error(transparent)]
    Posterior(#[from] PosteriorError),
}

/// A fitted model with what is to be told of it.
#[derive(Debug, Clone)]
pub struct FittedModel {
    /// The model.
    pub learned: Learned,
    /// Its hyperparameters: where the next fit begins.
    pub hyperparameters: [Hyperparameters<INPUTS>; AXES],
    /// Log marginal likelihood per axis.
    pub log_likelihood: [f64; AXES],
    /// Evaluations of all axes.
    pub evaluations: usize,
    /// Normalised inputs and targets.
    pub inputs: Vec<[f64; INPUTS]>,
    /// Residuals.
    pub targets: Vec<[f64; AXES]>,
}

impl Outset {
    /// Hyperparameters before any data: smooth, and of the size that physics allows.
    pub fn hyperparameters(&self) -> [Hyperparameters<INPUTS>; AXES] {
        self.bound.map(|bound| Hyperparameters::new([3.0; INPUTS], (0.2 * bound).powi(2), (0.01 * bound).powi(2)))
    }

    /// Fits `observations`, beginning at `start`.
    ///
    /// # Errors
    /// [`FailedFit`].
    pub fn fit(&self, observations: &[Observation<INPUTS>], start: &[Hyperparameters<INPUTS>; AXES]) -> Result<FittedModel, FailedFit> {
        let raw: Vec<[f64; INPUTS]> = observations.iter().map(|observation| observation.input).collect();
        let normalisation = if raw.is_empty() {
            Normalisation { mean: [0.0; INPUTS], scale: self.scale_floor }
        } else {
            Normalisation::from_samples(&raw, &self.scale_floor)?
        };
        let inputs: Vec<[f64; INPUTS]> = raw.iter().map(|input| normalisation.apply(input)).collect();
        let targets: Vec<[f64; AXES]> = observations.iter().map(|observation| observation.target).collect();
        let mut hyperparameters = *start;
        let mut log_likelihood = [0.0; AXES];
        let mut evaluations = 0;
        if inputs.len() >= SAMPLES_MIN {
            for axis in 0..AXES {
                let of_axis: Vec<f64> = targets.iter().map(|target| target[axis]).collect();
                let fitted =
                    fit(&inputs, &of_axis, &start[axis], &self.options(axis)).map_err(|source| FailedFit::Axis { axis, source })?;
                hyperparameters[axis] = fitted.hyperparameters;
                log_likelihood[axis] = fitted.log_likelihood;
                evaluations += fitted.evaluations;
            }
        }
        let posterior = Posterior::new(&inputs, &targets, &hyperparameters)?;
        let learned = Learned { layout: self.layout, normalisation, posterior, bound: self.bound, used: [true; 3] };
        Ok(FittedModel { learned, hyperparameters, log_likelihood, evaluations, inputs, targets })
    }

    /// Bounds and priors of one axis: wide, but such that a direction which the data does not excite keeps a sane length scale.
    fn options(&self, axis: usize) -> FitOptions<INPUTS> {
        let bound = self.bound[axis];
        let bounds = Bounds {
            lower: Hyperparameters::new([0.3; INPUTS], (1e-3 * bound).powi(2), (1e-4 * bound).powi(2)),
            upper: Hyperparameters::new([100.0; INPUTS], (2.0 * bound).powi(2), (0.3 * bound).powi(2)),
        };
        let length_scale = Some(LogNormal { median: 3.0, log_deviation: 1.0 });
        let variance = Some(LogNormal { median: (0.2 * bound).powi(2), log_deviation: 3.0 });
        let noise_variance = Some(LogNormal { median: (0.01 * bound).powi(2), log_deviation: 3.0 });
        FitOptions {
            bounds,
            priors: Some(Priors { length_scale: [length_scale; INPUTS], variance, noise_variance }),
            max_evaluations: self.evaluations_max,
            max_iterations: self.evaluations_max,
            restarts: 0,
            seed: 0,
        }
    }
}
