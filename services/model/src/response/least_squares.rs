//! Recursive least squares of one axis, and the detection of a change of the robot.

use super::{FRAMES, FirstOrder, MEMORY_S};
use serde::{Deserialize, Serialize};

/// Variance of A, B and c at the start, as a multiple of the variance of a sample.
const PRIOR: [f64; 3] = [100.0, 100.0, 0.01];

/// Time over which the errors of an axis are averaged to detect a change \[s\].
const RECENT_S: f64 = 1.0;

/// A change is detected when the recent mean square of the errors exceeds the lasting one by this
/// many of its standard deviations.
const ALARM: f64 = 10.0;

/// Added to P after a change, as a share of its initial value.
const REOPENED: f64 = 0.01;

/// Largest trace of P.
const TRACE_MAX: f64 = 300.0;

/// Recursive least squares of one axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Fit {
    /// A, B, c: without t, and with it.
    pub(super) weights: [[f64; 3]; FRAMES],
    /// P.
    pub(super) covariance: [[f64; 3]; 3],
}

impl Fit {
    pub(super) fn new(decay: f64, gain: f64) -> Self {
        let covariance = std::array::from_fn(|row| {
            std::array::from_fn(|column| if row == column { PRIOR[row] } else { 0.0 })
        });
        Self { weights: [[decay, gain, 0.0]; FRAMES], covariance }
    }

    /// Updates A, B and c with a sample that counts with the weight `certainty`. Returns the errors
    /// of the previous ones.
    pub(super) fn update(
        &mut self,
        features: &[f64; 3],
        targets: &[f64; FRAMES],
        forgetting: f64,
        certainty: f64,
    ) -> [f64; FRAMES] {
        let direction = self.covariance.map(|row| dot(&row, features));
        let scale = forgetting / certainty + dot(features, &direction);
        let mut errors = *targets;
        for (error, weights) in errors.iter_mut().zip(&mut self.weights) {
            *error -= dot(weights, features);
            for (weight, along) in weights.iter_mut().zip(direction) {
                *weight += along / scale * *error;
            }
        }
        for (row, along) in self.covariance.iter_mut().zip(direction) {
            for (value, across) in row.iter_mut().zip(direction) {
                *value -= along * across / scale;
            }
        }
        let trace: f64 = (0..3).map(|i| self.covariance[i][i]).sum();
        if trace < TRACE_MAX * forgetting {
            self.covariance = self.covariance.map(|row| row.map(|value| value / forgetting));
        }
        errors
    }

    /// Trusts the samples so far less.
    pub(super) fn reopen(&mut self) {
        for (index, prior) in PRIOR.iter().enumerate() {
            self.covariance[index][index] += REOPENED * prior;
        }
    }

    pub(super) fn first_order(&self, frame: usize) -> FirstOrder {
        let [decay, gain, offset] = self.weights[frame];
        FirstOrder { decay, gain, offset }
    }
}

fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Detects that the robot or its world has changed: the errors of an axis have grown for a while.
///
/// The mean of n squared errors of a normal distribution varies by √(2/n) of its value.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Change {
    /// Mean square of the errors over [`RECENT_S`] and over [`MEMORY_S`] \[(m/s)²\].
    recent: f64,
    lasting: f64,
    /// Number of periods so far.
    periods: u32,
}

impl Change {
    /// Whether the error of a period, of length `period_s`, reveals a change.
    pub(super) fn detects(&mut self, error: f64, period_s: f64) -> bool {
        self.periods = self.periods.saturating_add(1);
        let periods = f64::from(self.periods);
        let share = |memory_s: f64| (period_s / memory_s).max(1.0 / periods).min(1.0);
        let squared = error * error;
        self.recent += share(RECENT_S) * (squared - self.recent);
        let count = (2.0 * RECENT_S / period_s).max(1.0);
        let usual = self.lasting * (1.0 + ALARM * (2.0 / count).sqrt());
        let detected = periods * period_s > 2.0 * RECENT_S && self.recent > usual;
        self.lasting += share(MEMORY_S) * (squared - self.lasting);
        if detected {
            // The next change is one from here.
            self.lasting = self.recent;
        }
        detected
    }
}
