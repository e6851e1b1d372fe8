//! Fits hyperparameters and posterior to a data set. Deterministic: budgets count evaluations.

use model::gp::dictionary::Observation;
use model::gp::fit::{FitError, FitOptions, LogNormal, Priors, fit_likelihood};
use model::gp::hyperparameters::{Bounds, Hyperparameters};
use model::gp::likelihood::Likelihood;
use model::gp::normalisation::Normalisation;
use model::gp::posterior::{Posterior, PosteriorError};
use model::learned::{Layout, Learned};
use model::{AXES, Velocity};

use crate::settings::KernelChoice;

/// Smallest number of samples for a fit; with fewer, the model is the prior.
const SAMPLES_MIN: usize = 4;

/// Smallest standard deviation of the noise, as a share of the largest plausible residual.
const NOISE_FLOOR: f64 = 1e-4;

/// Prior knowledge of the learner, for a residual over D inputs.
#[derive(Debug, Clone, Copy)]
pub struct FitSettings<const D: usize> {
    /// Layout of the inputs.
    pub layout: Layout,
    /// Kernel.
    pub kernel: KernelChoice,
    /// Unit of each normalised input. It comes from physics, because the data may have no spread.
    pub input_scale: [f64; D],
    /// Largest |g| that physics allows \[m/s, m/s, rad/s\].
    pub bound: Velocity,
    /// Budget of one fit, in evaluations per axis.
    pub evaluations_max: usize,
}

/// Why a fit failed.
#[derive(Debug, thiserror::Error)]
pub enum FailedFit {
    /// The hyperparameters of one axis.
    #[error("axis {axis}: {source}")]
    Axis {
        /// 0 forward, 1 left, 2 yaw.
        axis: usize,
        /// Error of the fit.
        source: FitError,
    },
    /// The posterior.
    #[error(transparent)]
    Posterior(#[from] PosteriorError),
}

/// A fitted model with the data of its message.
#[derive(Debug, Clone)]
pub struct FittedModel<const D: usize> {
    /// The model.
    pub learned: Learned<D>,
    /// Its hyperparameters; the next fit begins with them.
    pub hyperparameters: [Hyperparameters<D>; AXES],
    /// Log marginal likelihood per axis.
    pub log_likelihood: [f64; AXES],
    /// Evaluations of all axes.
    pub evaluations: usize,
    /// Normalised inputs and targets.
    pub inputs: Vec<[f64; D]>,
    /// Residuals.
    pub targets: Vec<[f64; AXES]>,
    /// Noise variance of each sample over σₙ².
    pub noise_scale: Vec<f64>,
}

impl<const D: usize> FitSettings<D> {
    /// Scales of the inputs. The mean is zero, so that the linear part of the kernel goes through a
    /// robot at rest.
    pub fn normalisation(&self) -> Normalisation<D> {
        Normalisation { mean: [0.0; D], scale: self.input_scale }
    }

    /// Hyperparameters before any data: the medians of their priors.
    pub fn hyperparameters(&self) -> [Hyperparameters<D>; AXES] {
        self.bound.map(|bound| self.medians(bound))
    }

    /// Medians for a smooth function of the size that physics allows; beside a linear part, a
    /// quarter of it. The effect of a place is as large as that.
    fn medians(&self, bound: f64) -> Hyperparameters<D> {
        let smooth = |share: f64| {
            Hyperparameters::new([3.0; D], (share * bound).powi(2), (0.01 * bound).powi(2))
        };
        match self.kernel {
            KernelChoice::SquaredExponential => smooth(0.2),
            KernelChoice::LinearPlusSquaredExponential => {
                let place = if self.layout.has_place() { 0.05 } else { 0.0 };
                smooth(0.05).with_linear((0.2 * bound).powi(2)).with_place((place * bound).powi(2))
            }
        }
    }

    /// Smallest noise variance, per axis \[(m/s)², (m/s)², (rad/s)²\].
    pub fn noise_floor(&self) -> Velocity {
        self.bound.map(|bound| (NOISE_FLOOR * bound).powi(2))
    }

    /// Fits `observations`, each with the scale of its noise. The search begins at `start`.
    ///
    /// ```
    /// use learner::fit::FitSettings;
    /// use learner::settings::KernelChoice;
    /// use model::gp::dictionary::Observation;
    /// use model::learned::{Layout, Moment, Residual};
    ///
    /// let settings = FitSettings {
    ///     layout: Layout::VelocitySlip,
    ///     kernel: KernelChoice::LinearPlusSquaredExponential,
    ///     input_scale: [1.0; 6],
    ///     bound: [0.5; 3],
    ///     evaluations_max: 30,
    /// };
    /// // A robot that loses a tenth of its forward speed in each period.
    /// let moment = |forward: f64| Moment {
    ///     velocity: [forward, 0.0, 0.0],
    ///     input: [forward, 0.0, 0.0],
    ///     ..Moment::default()
    /// };
    /// let observations: Vec<_> = (0..20)
    ///     .map(|step| 0.1 * f64::from(step))
    ///     .map(|forward| Observation {
    ///         input: settings.layout.inputs(&moment(forward)),
    ///         target: [-0.1 * forward, 0.0, 0.0],
    ///     })
    ///     .map(|observation| (observation, 1.0))
    ///     .collect();
    /// let fitted = settings.fit(&observations, &settings.hyperparameters())?;
    /// let [forward, ..] = fitted.learned.mean(&moment(1.05));
    /// assert!((forward + 0.105).abs() < 0.005, "{forward}");
    /// # Ok::<(), learner::fit::FailedFit>(())
    /// ```
    ///
    /// # Errors
    /// [`FailedFit`].
    pub fn fit(
        &self,
        observations: &[(Observation<D>, f64)],
        start: &[Hyperparameters<D>; AXES],
    ) -> Result<FittedModel<D>, FailedFit> {
        let normalisation = self.normalisation();
        let inputs: Vec<[f64; D]> = observations
            .iter()
            .map(|(observation, _)| normalisation.apply(&observation.input))
            .collect();
        let targets: Vec<[f64; AXES]> =
            observations.iter().map(|(observation, _)| observation.target).collect();
        let noise_scale: Vec<f64> = observations.iter().map(|&(_, scale)| scale).collect();
        let mut hyperparameters = *start;
        let mut log_likelihood = [0.0; AXES];
        let mut evaluations = 0;
        if inputs.len() >= SAMPLES_MIN {
            for axis in 0..AXES {
                let of_axis: Vec<f64> = targets.iter().map(|target| target[axis]).collect();
                let fitted = Likelihood::new(&inputs, &of_axis)
                    .and_then(|likelihood| likelihood.with_noise_scale(&noise_scale))
                    .map_err(FitError::Likelihood)
                    .and_then(|mut likelihood| {
                        fit_likelihood(&mut likelihood, &start[axis], &self.options(axis))
                    })
                    .map_err(|source| FailedFit::Axis { axis, source })?;
                hyperparameters[axis] = fitted.hyperparameters;
                log_likelihood[axis] = fitted.log_likelihood;
                evaluations += fitted.evaluations;
            }
        }
        let posterior =
            Posterior::with_noise_scale(&inputs, &targets, &noise_scale, &hyperparameters)?;
        let learned = Learned {
            layout: self.layout,
            normalisation,
            posterior,
            bound: self.bound,
            sample_variance: hyperparameters.map(|axis| axis.noise_variance),
        };
        Ok(FittedModel {
            learned,
            hyperparameters,
            log_likelihood,
            evaluations,
            inputs,
            targets,
            noise_scale,
        })
    }

    /// Bounds and priors of one axis. They are wide, but keep a plausible length scale for inputs
    /// that the data does not excite.
    fn options(&self, axis: usize) -> FitOptions<D> {
        let bound = self.bound[axis];
        let bounds = Bounds {
            lower: Hyperparameters::new(
                [0.3; D],
                (1e-3 * bound).powi(2),
                (NOISE_FLOOR * bound).powi(2),
            )
            .with_linear((1e-3 * bound).powi(2))
            .with_place((1e-3 * bound).powi(2)),
            upper: Hyperparameters::new([100.0; D], (2.0 * bound).powi(2), (0.3 * bound).powi(2))
                .with_linear((2.0 * bound).powi(2))
                .with_place((2.0 * bound).powi(2)),
        };
        let Hyperparameters { kernel, noise_variance } = self.medians(bound);
        let around = |median: f64, log_deviation: f64| Some(LogNormal { median, log_deviation });
        // Beside a linear part, the smooth part must not fit a wrong gain to a few samples.
        let (variance_deviation, linear_variance) = match self.kernel {
            KernelChoice::SquaredExponential => (3.0, None),
            KernelChoice::LinearPlusSquaredExponential => {
                (1.0, around(kernel.linear_variance, 1.0))
            }
        };
        let priors = Priors {
            length_scale: kernel.length_scale.map(|median| around(median, 1.0)),
            variance: around(kernel.variance, variance_deviation),
            noise_variance: around(noise_variance, 3.0),
            linear_variance,
            place_variance: around(kernel.place_variance, 1.0)
                .filter(|_| kernel.place_variance > 0.0),
        };
        FitOptions {
            bounds,
            priors: Some(priors),
            max_evaluations: self.evaluations_max,
            max_iterations: self.evaluations_max,
        }
    }
}
