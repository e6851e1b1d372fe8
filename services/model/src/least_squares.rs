//! The cheap alternative to a Gaussian process: g as a linear function of velocity and input, by recursive least squares.
//!
//! ```text
//! g ≈ W φ,   φ = (v, u, 1)
//! K = P φ / (λ + φᵀ P φ)      W ← W + (g − W φ) Kᵀ      P ← (P − K φᵀ P)/λ
//! ```
//! one P for all axes, since all see the same φ. The forgetting factor λ < 1 lets old samples fade. Where the robot does not move in some
//! direction, forgetting alone would let P grow without end there: it stops where P would exceed what it was at the start.
//!
//! Reference: Åström, Wittenmark, *Adaptive Control*, 2nd ed., section 2.2.

use crate::Velocity;
use crate::learned::{Moment, Residual, Response};
use nalgebra::{SMatrix, SVector};

/// Entries of φ.
const FEATURES: usize = 7;

/// Prior variance of a weight over the variance of a sample.
const PRIOR: f64 = 100.0;

/// W and P. Does not allocate.
#[derive(Debug, Clone)]
pub struct LeastSquares {
    weights: SMatrix<f64, 3, FEATURES>,
    covariance: SMatrix<f64, FEATURES, FEATURES>,
    forgetting: f64,
    bound: Velocity,
}

impl LeastSquares {
    /// Knows nothing yet. Samples fade with the forgetting factor λ, 0 < λ ≤ 1; |g| stays within `bound` \[m/s, m/s, rad/s\].
    pub fn new(forgetting: f64, bound: Velocity) -> Self {
        Self { weights: SMatrix::zeros(), covariance: SMatrix::identity() * PRIOR, forgetting, bound }
    }

    /// Takes in one period. Numbers that are none are passed over.
    pub fn update(&mut self, at: &Moment, residual: &Velocity) {
        let features = features(at);
        let residual = SVector::<f64, 3>::from(*residual);
        if !features.iter().chain(residual.iter()).all(|value| value.is_finite()) {
            return;
        }
        let direction = self.covariance * features;
        let gain = direction / (self.forgetting + features.dot(&direction));
        self.weights += (residual - self.weights * features) * gain.transpose();
        let informed = self.covariance - gain * direction.transpose();
        let faded = informed / self.forgetting;
        self.covariance = if faded.trace() <= PRIOR * FEATURES as f64 { faded } else { informed };
        self.covariance = 0.5 * (self.covariance + self.covariance.transpose());
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        *self = Self::new(self.forgetting, self.bound);
    }
}

impl Residual for LeastSquares {
    fn mean(&self, at: &Moment) -> Velocity {
        let mean = self.weights * features(at);
        std::array::from_fn(|axis| mean[axis].max(-self.bound[axis]).min(self.bound[axis]))
    }

    fn response(&self, at: &Moment) -> Response {
        let unbounded = self.weights * features(at);
        let mean = self.mean(at);
        let varies = |axis: usize| f64::from(u8::from(unbounded[axis].abs() <= self.bound[axis]));
        let slope =
            |first: usize| std::array::from_fn(|row| std::array::from_fn(|column| varies(row) * self.weights[(row, first + column)]));
        Response { mean, by_velocity: slope(0), by_input: slope(3), ..Response::NONE }
    }
}

fn features(at: &Moment) -> SVector<f64, FEATURES> {
    let ([v, w, r], [a, b, c]) = (at.velocity, at.input);
    SVector::from([v, w, r, a, b, c, 1.0])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wave(i: usize, k: f64) -> Velocity {
        [(k * i as f64).sin(), (1.7 * k * i as f64).cos(), (0.3 * k * i as f64).sin()]
    }

    fn at(velocity: Velocity, input: Velocity) -> Moment {
        Moment { velocity, input, ..Moment::default() }
    }

    #[test]
    fn a_linear_residual_is_found_exactly() {
        let truth = |v: &Velocity, u: &Velocity| [0.1 * v[0] - 0.05 * u[0] + 0.01, 0.03 * u[1] + 0.02 * v[2], -0.04 * u[2]];
        let mut model = LeastSquares::new(0.999, [1.0; 3]);
        for i in 0..4_000 {
            let (v, u) = (wave(i, 0.37), wave(i, 0.91));
            model.update(&at(v, u), &truth(&v, &u));
        }
        let (v, u) = ([0.4, -0.2, 0.7], [0.1, 0.9, -0.5]);
        for (found, real) in model.mean(&at(v, u)).iter().zip(truth(&v, &u)) {
            assert!((found - real).abs() < 1e-4, "{found} is not {real}");
        }
    }

    #[test]
    fn the_response_is_the_slope_of_the_mean() {
        let mut model = LeastSquares::new(1.0, [1.0; 3]);
        for i in 0..50 {
            model.update(&at(wave(i, 0.5), wave(i, 1.1)), &wave(i, 0.2).map(|value| 0.1 * value));
        }
        let (v, u) = ([0.1, 0.2, 0.3], [0.3, 0.2, 0.1]);
        let response = model.response(&at(v, u));
        let moved = model.mean(&at(v, [0.3, 0.2 + 1e-3, 0.1]));
        for axis in 0..3 {
            assert!(((moved[axis] - response.mean[axis]) / 1e-3 - response.by_input[axis][1]).abs() < 1e-9);
        }
    }

    #[test]
    fn standing_still_for_hours_does_not_blow_it_up() {
        let mut model = LeastSquares::new(0.99, [1.0; 3]);
        for _ in 0..1_000_000 {
            model.update(&Moment::default(), &[0.01, 0.0, 0.0]);
        }
        assert!(model.covariance.iter().all(|value| value.is_finite() && value.abs() <= 7.0 * PRIOR));
        let driving = at([1.0, 0.0, 0.0], [1.0, 0.0, 0.0]);
        model.update(&driving, &[0.02, 0.0, 0.0]);
        assert!(model.mean(&driving)[0].abs() < 0.1);
        model.update(&at([f64::NAN; 3], [0.0; 3]), &[0.0; 3]);
        assert!(model.mean(&Moment::default()).iter().all(|value| value.is_finite()));
    }
}
