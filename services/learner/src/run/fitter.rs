//! The fitting thread, one data set after the other.

use crate::fit::{FailedFit, FitSettings, FittedModel};
use model::AXES;
use model::gp::dictionary::Observation;
use model::gp::hyperparameters::Hyperparameters;
use std::sync::mpsc::{Receiver, Sender};

/// A data set to fit.
pub(super) struct Job<const D: usize> {
    pub(super) cut: u64,
    /// Each with the scale of its noise.
    pub(super) observations: Vec<(Observation<D>, f64)>,
    /// Whether the fit begins from the initial hyperparameters, not where the last one ended.
    pub(super) anew: bool,
    /// Budget, in evaluations per axis.
    pub(super) evaluations_max: usize,
}

/// Result of a job.
pub(super) type Done<const D: usize> = (u64, Result<FittedModel<D>, FailedFit>);

/// Fits one job after the other. Each begins at the hyperparameters of the previous one.
pub(super) fn fit_jobs<const D: usize>(
    mut fit_settings: FitSettings<D>,
    mut start: [Hyperparameters<D>; AXES],
    inbox: &Receiver<Job<D>>,
    outbox: &Sender<Done<D>>,
) {
    while let Ok(job) = inbox.recv() {
        fit_settings.evaluations_max = job.evaluations_max;
        if job.anew {
            start = fit_settings.hyperparameters();
        }
        let fitted = fit_settings.fit(&job.observations, &start);
        if let Ok(fitted) = &fitted {
            start = fitted.hyperparameters;
        }
        if outbox.send((job.cut, fitted)).is_err() {
            return;
        }
    }
}
