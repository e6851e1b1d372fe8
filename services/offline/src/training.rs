//! Periods → fitted model, with the data set and the fit of the learner.
//!
//! Two things differ from a learner that runs. Samples do not age: all logs count the same. And a
//! fit has a larger budget, because nothing waits for it.

use crate::periods::Period;
use crate::prior::Prior;
use learner::Settings;
use learner::data_set::{DataSet, fit_settings};
use learner::fit::{FailedFit, FitSettings, FittedModel};

/// Budget of a fit, in evaluations per axis.
const EVALUATIONS: usize = 100;

/// Trains models for one robot, period and layout of D inputs.
#[derive(Debug)]
pub struct Training<'a, const D: usize> {
    settings: &'a Settings,
    /// Prior knowledge of the fit.
    pub fit: FitSettings<D>,
    prior: Prior<D>,
}

impl<'a, const D: usize> Training<'a, D> {
    /// Training for the robot and the period of `settings`.
    pub fn new(settings: &'a Settings) -> Self {
        let fit = FitSettings { evaluations_max: EVALUATIONS, ..fit_settings(settings) };
        Self { settings, fit, prior: Prior::new() }
    }

    /// The same with the data of an earlier model, carried over.
    #[must_use]
    pub fn with_prior(self, prior: Prior<D>) -> Self {
        Self { prior, ..self }
    }

    /// The model of `periods`, in the order of time.
    ///
    /// # Errors
    /// [`FailedFit`].
    pub fn fit<'p>(
        &self,
        periods: impl IntoIterator<Item = &'p Period>,
    ) -> Result<FittedModel<D>, FailedFit> {
        let mut data = DataSet::with_memory(self.settings, &self.fit, f64::INFINITY);
        for (observation, noise_scale) in &self.prior {
            data.dictionary.restore(*observation, *noise_scale);
        }
        for period in periods {
            data.follow_dead_time(&period.sample);
            data.add(&period.sample);
        }
        self.fit.fit(&data.observations(), &self.fit.hyperparameters())
    }
}
