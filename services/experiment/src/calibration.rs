//! Calibration: the share of the robot's true residuals in the learner's 95 % interval.
//!
//! ```text
//! |residual − mean| ≤ 1.96 √(variance of a new sample)
//! ```
//! Every usable sample is compared, on each axis, with the snapshot that was due in its period.
//! That snapshot was trained without the sample. The disturbance observer has no part in it: the
//! interval is the learner's own.

use controller::adopt::{Expected, prepare};
use learner::snapshot::moment;
use model::AXES;
use model::covariance::quantile;
use protocol::message::{ModelSnapshot, ResidualSample};
use serde::Serialize;

/// Nominal share of the interval.
const SHARE: f64 = 0.95;

/// The learner's 95 % interval, per axis.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Interval {
    /// Share of samples in it.
    pub coverage: [f64; AXES],
    /// Mean of half its width \[m/s, m/s, rad/s\].
    pub half_width: [f64; AXES],
    /// RMS of the samples \[m/s, m/s, rad/s\].
    pub residual_rms: [f64; AXES],
}

/// The snapshots of a trial's learner, and the samples that followed.
#[derive(Debug)]
pub(super) struct Calibration {
    expected: Expected,
    /// In the order of their ticks.
    snapshots: Vec<ModelSnapshot>,
    samples: Vec<ResidualSample>,
}

impl Calibration {
    /// Without messages yet, of a learner whose snapshots have the properties `expected`.
    pub(super) fn new(expected: Expected) -> Self {
        Self { expected, snapshots: Vec::new(), samples: Vec::new() }
    }

    pub(super) fn received_snapshot(&mut self, snapshot: ModelSnapshot) {
        self.snapshots.push(snapshot);
    }

    pub(super) fn received_sample(&mut self, sample: &ResidualSample) {
        if sample.usable == 1 {
            self.samples.push(*sample);
        }
    }

    /// How good the interval is; none without a model or a sample.
    pub(super) fn interval(&self) -> Option<Interval> {
        let spread = quantile(0.5 + 0.5 * SHARE);
        let mut of = Interval::default();
        let mut counted = 0.0;
        for (index, snapshot) in self.snapshots.iter().enumerate() {
            let until =
                self.snapshots.get(index + 1).map_or(u64::MAX, |next| next.head.effective_tick);
            // A sample carries the tick that ended its period.
            let due = |sample: &&ResidualSample| {
                (snapshot.head.effective_tick..until).contains(&sample.stamp.tick.saturating_sub(1))
            };
            let Ok(mut model) = prepare(snapshot, &self.expected) else { continue };
            for sample in self.samples.iter().filter(due) {
                let at = moment(sample);
                let mean = model.learned.mean(&at);
                let variance = model.learned.sample_variance(&at, &mut model.scratch);
                counted += 1.0;
                for axis in 0..AXES {
                    let half_width = spread * variance[axis].sqrt();
                    let error = (sample.residual[axis] - mean[axis]).abs();
                    of.coverage[axis] += if error <= half_width { 1.0 } else { 0.0 };
                    of.half_width[axis] += half_width;
                    of.residual_rms[axis] += sample.residual[axis].powi(2);
                }
            }
        }
        (counted > 0.0).then(|| Interval {
            coverage: of.coverage.map(|sum| sum / counted),
            half_width: of.half_width.map(|sum| sum / counted),
            residual_rms: of.residual_rms.map(|sum| f64::sqrt(sum / counted)),
        })
    }
}
