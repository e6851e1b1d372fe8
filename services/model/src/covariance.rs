//! Covariance of the predicted state along a prediction, under a linear feedback.
//!
//! ```text
//! Σ_{k+1} = (A + B K) Σ_k (A + B K)ᵀ + G diag(q) Gᵀ,   G = ∂x⁺/∂g
//! ```
//! q is the variance of one step's residual, observation noise included. K = ∂u/∂x is the gain of
//! the linear controller that reacts to a deviation. Without K, Σ would grow like that of an
//! uncontrolled robot. Errors of different periods count as independent.
//!
//! Zero-order: Σ belongs to the prediction at which the step was linearised. It is not updated
//! while the plan is improved.
//!
//! Reference: Hewing, Kabzan & Zeilinger, *Cautious Model Predictive Control Using Gaussian
//! Process Regression*, 2020.

use crate::AXES;
use crate::Velocity;
use crate::linearise::Linearised;
use nalgebra::{SMatrix, Vector3};

/// Covariance of x, y, yaw, forward, left, yaw rate.
pub type Covariance = SMatrix<f64, 6, 6>;

/// K = ∂u/∂x.
pub type Feedback = SMatrix<f64, AXES, 6>;

/// Σ one step after the Σ of `state`, for a residual of variance `noise`
/// \[(m/s)², (m/s)², (rad/s)²\]. Does not allocate.
pub fn propagate(
    before: &Covariance,
    step: &Linearised,
    feedback: &Feedback,
    noise: &Velocity,
) -> Covariance {
    let closed_loop = step.by_state + step.by_input * feedback;
    let entry = &step.by_residual;
    let scaled = entry * SMatrix::<f64, AXES, AXES>::from_diagonal(&Vector3::from(*noise));
    closed_loop * before * closed_loop.transpose() + scaled * entry.transpose()
}

/// Standard deviation along `direction`. Does not allocate.
pub fn deviation(covariance: &Covariance, direction: &SMatrix<f64, 6, 1>) -> f64 {
    direction.dot(&(covariance * direction)).max(0.0).sqrt()
}

/// Φ⁻¹(`level`), to six digits: the number of standard deviations above the mean below which a
/// normal variable stays with probability `level`. 0 for 0.5.
///
/// Reference: Wichura, algorithm AS 241, *Applied Statistics* 37, 1988.
pub fn quantile(level: f64) -> f64 {
    let ratio = |above: [f64; 4], below: [f64; 3], r: f64| {
        let numerator = ((above[3] * r + above[2]) * r + above[1]) * r + above[0];
        numerator / (((below[2] * r + below[1]) * r + below[0]) * r + 1.0)
    };
    let centred = level - 0.5;
    if centred.abs() <= 0.425 {
        let above = [3.387_132_717_9, 50.434_271_938, 159.291_132_02, 59.109_374_720];
        return centred
            * ratio(
                above,
                [17.895_169_469, 78.757_757_664, 67.187_563_600],
                0.180_625 - centred * centred,
            );
    }
    let tail = (-level.min(1.0 - level).ln()).sqrt();
    let size = if tail <= 5.0 {
        ratio(
            [1.423_437_277_7, 2.756_815_390_0, 1.306_728_481_6, 0.170_238_211_03],
            [0.737_001_642_50, 0.120_211_329_75, 0.0],
            tail - 1.6,
        )
    } else {
        ratio(
            [6.657_905_115_0, 3.081_226_386_0, 0.428_682_943_37, 0.017_337_203_997],
            [0.241_978_942_25, 0.012_258_202_635, 0.0],
            tail - 5.0,
        )
    };
    size.copysign(centred)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::State;
    use crate::linearise::linearise;
    use crate::main_model::MainModel;
    use crate::predict::Belief;
    use robot::Robot;

    fn close(ours: f64, theirs: f64, tolerance: f64) {
        assert!((ours - theirs).abs() < tolerance, "{ours} is not {theirs}");
    }

    #[test]
    fn variance_grows_as_calculated_by_hand_for_a_linear_system() {
        // Straight ahead at heading 0, the system of each axis is linear:
        // v⁺ = A v + B u + g, x⁺ = x + T ((1 − w) v + w v⁺).
        let main = MainModel::new(&Robot::example(), 0.1);
        let belief = Belief::of(&main);
        let (decay, gain, period, share) =
            (main.decay[0], main.gain[0], main.period, main.end_share[0]);
        let (noise, kp, kv) = ([4e-4, 0.0, 0.0], 1.3, 0.2);
        let mut feedback = Feedback::zeros();
        (feedback[(0, 0)], feedback[(0, 3)]) = (-kp, -kv);
        let mut state = State { velocity: [1.0, 0.0, 0.0], ..State::default() };
        let mut ours = Covariance::zeros();
        // Variance of x, covariance, variance of v.
        let (mut xx, mut xv, mut vv) = (0.0, 0.0, 0.0);
        for _ in 0..10 {
            let step = linearise(&belief, &state, &[1.0, 0.0, 0.0]);
            ours = propagate(&ours, &step, &feedback, &noise);
            state = step.next;
            // v⁺ = c x + d v + g, x⁺ = a x + b v + T w g
            let (c, d) = (-gain * kp, decay - gain * kv);
            let (a, b, e) =
                (1.0 + period * share * c, period * (1.0 - share + share * d), period * share);
            let q = noise[0];
            (xx, xv, vv) = (
                a * a * xx + 2.0 * a * b * xv + b * b * vv + e * e * q,
                a * c * xx + (a * d + b * c) * xv + b * d * vv + e * q,
                c * c * xx + 2.0 * c * d * xv + d * d * vv + q,
            );
            for (ours, by_hand) in [(ours[(0, 0)], xx), (ours[(0, 3)], xv), (ours[(3, 3)], vv)] {
                close(ours, by_hand, 1e-12);
            }
        }
        close(
            deviation(&ours, &SMatrix::<f64, 6, 1>::from([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])),
            xx.sqrt(),
            1e-12,
        );
    }

    #[test]
    fn feedback_reduces_the_predicted_variance() {
        let main = MainModel::new(&Robot::example(), 0.1);
        let belief = Belief::of(&main);
        let mut feedback = Feedback::zeros();
        (feedback[(1, 1)], feedback[(1, 4)]) = (-2.0, -0.3);
        let (mut steered, mut left_alone) = (Covariance::zeros(), Covariance::zeros());
        for _ in 0..20 {
            let step = linearise(&belief, &State::default(), &[0.0; 3]);
            steered = propagate(&steered, &step, &feedback, &[1e-4; 3]);
            left_alone = propagate(&left_alone, &step, &Feedback::zeros(), &[1e-4; 3]);
        }
        assert!(steered[(1, 1)] < 0.5 * left_alone[(1, 1)]);
        close(steered[(0, 0)], left_alone[(0, 0)], 1e-15);
    }

    #[test]
    fn quantiles_are_those_of_the_normal_distribution() {
        for (level, expected) in [
            (0.5, 0.0),
            (0.9, 1.281_551_6),
            (0.955, 1.695_397_7),
            (0.975, 1.959_964_0),
            (0.999, 3.090_232_3),
        ] {
            close(quantile(level), expected, 1e-6);
            close(quantile(1.0 - level), -expected, 1e-6);
        }
    }
}
