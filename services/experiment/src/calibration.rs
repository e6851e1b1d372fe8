//! Calibration: the share of the robot's true residuals in the learner's 95 % interval.
//!
//! ```text
//! |residual − mean| ≤ 1.96 √(variance of a new sample)
//! ```
//! Every usable sample is compared, on each axis, with the snapshot that was due in its period.
//! That snapshot was trained without the sample. The disturbance observer has no part in it: the
//! interval is the learner's own.

use controller::adopt::{Expected, prepare};
use model::AXES;
use model::covariance::quantile;
use model::learned::Moment;
use protocol::message::{ModelSnapshot, ResidualSample};

/// Nominal share of the interval.
const SHARE: f64 = 0.95;

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

    pub(super) fn heard_snapshot(&mut self, snapshot: ModelSnapshot) {
        self.snapshots.push(snapshot);
    }

    pub(super) fn heard_sample(&mut self, sample: &ResidualSample) {
        if sample.usable == 1 {
            self.samples.push(*sample);
        }
    }

    /// Share of samples in the interval, per axis; none without a model or a sample.
    pub(super) fn coverage(&self) -> Option<[f64; AXES]> {
        let spread = quantile(0.5 + 0.5 * SHARE);
        let (mut within, mut counted) = ([0.0; AXES], 0.0);
        for (index, snapshot) in self.snapshots.iter().enumerate() {
            let until =
                self.snapshots.get(index + 1).map_or(u64::MAX, |next| next.head.effective_tick);
            // A sample carries the tick that ended its period.
            let due = |sample: &&ResidualSample| {
                (snapshot.head.effective_tick..until).contains(&sample.stamp.tick.saturating_sub(1))
            };
            let Ok(mut model) = prepare(snapshot, &self.expected) else { continue };
            for sample in self.samples.iter().filter(due) {
                let at = Moment {
                    velocity: sample.velocity,
                    input: sample.input,
                    before: sample.input_before,
                    heading: sample.pose[2],
                };
                let mean = model.learned.mean(&at);
                let variance = model.learned.sample_variance(&at, &mut model.scratch);
                counted += 1.0;
                for axis in 0..AXES {
                    let inside = (sample.residual[axis] - mean[axis]).abs()
                        <= spread * variance[axis].sqrt();
                    within[axis] += if inside { 1.0 } else { 0.0 };
                }
            }
        }
        (counted > 0.0).then(|| within.map(|count| count / counted))
    }
}
