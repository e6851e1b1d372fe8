//! Scores a fitted model on samples that it was not trained on, and writes its message.

use crate::fit::FittedModel;
use model::AXES;
use model::learned::{Moment, Residual};
use protocol::frame::DecodeError;
use protocol::message::{INPUTS_MAX, ModelSnapshot, ResidualSample, SnapshotHead};

/// Header fields of a snapshot that are independent of the model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Label {
    /// Version, from 1.
    pub version: u64,
    /// Fingerprint of main model and layout.
    pub fingerprint: u64,
    /// Epoch of the plant that sent the samples.
    pub plant_epoch: u64,
    /// Tick of the last training sample.
    pub trained_tick: u64,
    /// In lock step: tick at which it takes effect; 0 is at once.
    pub effective_tick: u64,
}

/// The period of `sample`.
pub fn moment(sample: &ResidualSample) -> Moment {
    let [x, y, heading] = sample.pose;
    Moment {
        velocity: sample.velocity,
        input: sample.input,
        before: sample.input_before,
        heading,
        position: [x, y],
    }
}

/// RMS one-step error of the fitted model and of the main model alone, per axis, over `samples`;
/// zeros if there are none.
pub fn score<const D: usize>(
    fitted: &FittedModel<D>,
    samples: &[ResidualSample],
) -> ([f64; AXES], [f64; AXES]) {
    let (mut learned, mut main) = ([0.0; AXES], [0.0; AXES]);
    for sample in samples {
        let mean = fitted.learned.mean(&moment(sample));
        for axis in 0..AXES {
            learned[axis] += (sample.residual[axis] - mean[axis]).powi(2);
            main[axis] += sample.residual[axis].powi(2);
        }
    }
    let count = samples.len().max(1) as f64;
    (learned.map(|sum| (sum / count).sqrt()), main.map(|sum| (sum / count).sqrt()))
}

/// Writes the message of a fitted model, scored on `newer`: usable samples that it was not trained
/// on.
///
/// # Errors
/// [`DecodeError`] if it has more points than a message can carry.
pub fn write<const D: usize>(
    fitted: &FittedModel<D>,
    label: &Label,
    newer: &[ResidualSample],
) -> Result<ModelSnapshot, DecodeError> {
    let posterior = &fitted.learned.posterior;
    let mut head: SnapshotHead = bytemuck::Zeroable::zeroed();
    head.stamp.tick = label.trained_tick;
    head.version = label.version;
    head.fingerprint = label.fingerprint;
    head.effective_tick = label.effective_tick;
    head.plant_epoch = label.plant_epoch;
    head.inputs = D as u32;
    head.score_samples = newer.len() as u32;
    head.input_mean = widened(&fitted.learned.normalisation.mean, 0.0);
    head.input_scale = widened(&fitted.learned.normalisation.scale, 1.0);
    head.log_likelihood = fitted.log_likelihood;
    head.jitter = posterior.jitter();
    for (axis, hyperparameters) in fitted.hyperparameters.iter().enumerate() {
        head.length_scale[axis] = widened(&hyperparameters.kernel.length_scale, 1.0);
        head.signal_variance[axis] = hyperparameters.kernel.variance;
        head.linear_variance[axis] = hyperparameters.kernel.linear_variance;
        head.place_variance[axis] = hyperparameters.kernel.place_variance;
        head.noise_variance[axis] = hyperparameters.noise_variance;
        head.sample_variance[axis] = fitted.learned.sample_variance[axis];
    }
    (head.score_learned, head.score_main) = score(fitted, newer);
    let mut snapshot = ModelSnapshot::new(head);
    let weights = posterior.weights();
    for (row, ((input, target), &noise_scale)) in
        fitted.inputs.iter().zip(&fitted.targets).zip(&fitted.noise_scale).enumerate()
    {
        let weight = weights.map(|of_axis| of_axis.get(row).copied().unwrap_or(0.0));
        snapshot.push_with_noise(input, *target, weight, noise_scale)?;
    }
    Ok(snapshot)
}

fn widened(values: &[f64], rest: f64) -> [f64; INPUTS_MAX] {
    let mut wide = [rest; INPUTS_MAX];
    for (slot, &value) in wide.iter_mut().zip(values) {
        *slot = value;
    }
    wide
}
