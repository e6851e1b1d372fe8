//! Gains of disturbance observers: the share of an innovation in velocity, disturbance and slope.
//!
//! ```text
//! v⁺ = A v + B u + d    d⁺ = d + s    s⁺ = s + w    y = v + n     Var w = q Var n
//! ```
//! | here          | in the equations                                   | unit            |
//! |---------------|----------------------------------------------------|-----------------|
//! | `velocity`    | v: body velocity                                   | m/s, m/s, rad/s |
//! | `disturbance` | d: what is added to the main model in each period  | the same        |
//! | `slope`       | s: change of d from one period to the next         | the same        |
//!
//! A plain observer assumes that the measured velocity is exact, and has no slope. The Kalman
//! filter of the equations above assumes noise on the velocity and a disturbance that is a ramp.
//! Only the ratio q of the two variances matters to its stationary gain.
//!
//! Reference: Särkkä, *Bayesian Filtering and Smoothing*, 2013, section 4.3; Pannocchia, Rawlings,
//! *Disturbance models for offset-free model-predictive control*, AIChE Journal 49, 2003.

use nalgebra::{Matrix3, Vector3};

/// Iterations after which the covariance is taken for stationary; it converges geometrically.
const ITERATIONS: usize = 2000;

/// Share of an innovation that goes to each part of the estimate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObserverGain {
    /// To v.
    pub velocity: f64,
    /// To d.
    pub disturbance: f64,
    /// To s.
    pub slope: f64,
}

impl ObserverGain {
    /// A plain observer of gain ℓ; 0 is no observer.
    pub const fn plain(gain: f64) -> Self {
        Self { velocity: 1.0, disturbance: gain, slope: 0.0 }
    }

    /// The stationary Kalman filter of an axis with A = `decay` and q = `ratio`.
    pub fn kalman(decay: f64, ratio: f64) -> Self {
        let transition = Matrix3::new(decay, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0);
        let mut covariance = Matrix3::identity();
        let mut gain = Vector3::zeros();
        for _ in 0..ITERATIONS {
            covariance = transition * covariance * transition.transpose();
            covariance[(2, 2)] += ratio;
            let along: Vector3<f64> = covariance.column(0).into();
            gain = along / (covariance[(0, 0)] + 1.0);
            covariance -= gain * along.transpose();
        }
        let [velocity, disturbance, slope] = gain.into();
        Self { velocity, disturbance, slope }
    }
}

/// Estimate of the observer of one axis. Its input `left` is the one-step error of the model: the
/// measured residual without the part that the model predicts.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Observer {
    /// Measured velocity minus the estimated one.
    beyond: f64,
    /// d of the next period.
    pub disturbance: f64,
    /// s.
    slope: f64,
}

impl Observer {
    /// Updates the estimate with one period, |d| ≤ `bound`, and returns the innovation. A `left`
    /// that is not finite changes nothing.
    pub fn update(&mut self, gain: &ObserverGain, decay: f64, left: f64, bound: f64) -> f64 {
        let innovation = decay * self.beyond + left - self.disturbance;
        if innovation.is_finite() {
            self.beyond = (1.0 - gain.velocity) * innovation;
            let next = self.disturbance + self.slope + gain.disturbance * innovation;
            self.disturbance = next.clamp(-bound, bound);
            self.slope += gain.slope * innovation;
        }
        innovation
    }

    /// Continues after a missing period: takes the measured velocity for exact and d for constant.
    pub fn resume(&mut self) {
        (self.beyond, self.slope) = (0.0, 0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DECAY: f64 = 0.9;

    /// The estimate after 2000 periods in which the main model is wrong by `of(k)`, with noise
    /// `noise(k)` on the measured velocity.
    fn observed(
        gain: &ObserverGain,
        of: impl Fn(usize) -> f64,
        noise: impl Fn(usize) -> f64,
    ) -> Observer {
        let mut observer = Observer::default();
        for k in 0..2000 {
            let left = of(k) + noise(k + 1) - DECAY * noise(k);
            observer.update(gain, DECAY, left, 1.0);
        }
        observer
    }

    #[test]
    fn a_disturbance_that_grows_linearly_is_estimated_without_lag() {
        let growing = |k| 1e-4 * k as f64;
        for ratio in [1.0, 1e-2, 1e-4] {
            let found = observed(&ObserverGain::kalman(DECAY, ratio), growing, |_| 0.0);
            assert!((found.disturbance - growing(2000)).abs() < 1e-4, "{found:?}");
        }
        let plain = observed(&ObserverGain::plain(0.1), growing, |_| 0.0);
        assert!((plain.disturbance - growing(2000)).abs() > 5e-4, "{plain:?}");
    }

    #[test]
    fn a_small_ratio_filters_noise_of_the_velocity() {
        let noise = |k: usize| 0.01 * (12.9898 * k as f64).sin();
        let gain = ObserverGain::kalman(DECAY, 1e-5);
        let found = observed(&gain, |_| 0.02, noise);
        assert!((found.disturbance - 0.02).abs() < 1e-3, "{found:?}");
    }

    #[test]
    fn an_error_that_is_not_finite_changes_nothing() {
        let gain = ObserverGain::kalman(DECAY, 1e-2);
        let mut observer = observed(&gain, |_| 0.02, |_| 0.0);
        let before = observer;
        observer.update(&gain, DECAY, f64::NAN, 1.0);
        assert_eq!(observer, before);
    }
}
