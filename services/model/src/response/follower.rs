//! A response that follows the speeds of the wheels.
//!
//! A body velocity is noisy, and a body slides away from its wheels. Prediction by one period tells
//! little in noise, because A and B explain most of what another input changes. So the response
//! also follows the wheels, and is only drawn to them slowly:
//!
//! ```text
//! w = J⁺ r ω      e = w⁺ − (A x + B u + c + t)      x⁺ = w⁺ − e^{−T/τ} e      τ = 0.15 s
//! ```
//! x is that of a Luenberger observer with a small gain. The error of a wrong u adds up in it, and
//! noise does not. A, B and c are identified from the wheels by the same least squares as those of
//! the body.

use super::FRAMES;
use super::hypothesis::{Hypothesis, Period};
use crate::{AXES, Velocity};

/// τ \[s\].
pub(super) const FOLLOWING_S: f64 = 0.15;

/// Largest |e| of a response that follows \[m/s\]. Beyond, it begins anew at the wheels.
const LOST_MPS: f64 = 10.0;

/// Sums of squared errors with forgetting \[(m/s)²\].
#[derive(Debug, Clone, Copy)]
pub(super) struct Errors {
    /// Of a response that follows.
    pub(super) followed: f64,
    /// Of a prediction over one period.
    pub(super) one_step: f64,
}

impl Errors {
    /// The least of each.
    pub(super) fn min(self, other: Self) -> Self {
        Self {
            followed: self.followed.min(other.followed),
            one_step: self.one_step.min(other.one_step),
        }
    }

    /// The least of several responses.
    pub(super) fn least(followers: &[Follower]) -> Self {
        let none = Self { followed: f64::INFINITY, one_step: f64::INFINITY };
        followers.iter().fold(none, |least, follower| {
            let (followed, one_step) = (follower.cost(), follower.hypothesis.cost());
            least.min(Self { followed, one_step })
        })
    }
}

/// One response that follows the wheels.
#[derive(Debug, Clone, Copy)]
pub(super) struct Follower {
    pub(super) hypothesis: Hypothesis,
    /// x, without t and with it \[m/s, m/s, rad/s\].
    followed: [Velocity; FRAMES],
    /// Sum of e² with forgetting, without t and with it \[(m/s)²\].
    costs: [f64; FRAMES],
}

impl Follower {
    pub(super) fn new(hypothesis: &Hypothesis) -> Self {
        Self { hypothesis: *hypothesis, followed: [[0.0; AXES]; FRAMES], costs: [0.0; FRAMES] }
    }

    /// The next period begins with w = `wheels`.
    pub(super) fn resume(&mut self, wheels: &Velocity) {
        self.followed = [*wheels; FRAMES];
    }

    /// Processes a period in which `acted` acted.
    pub(super) fn update(&mut self, period: &Period, acted: &Velocity) {
        let mut errors = [[0.0; AXES]; FRAMES];
        for (frame, followed) in self.followed.iter_mut().enumerate() {
            for axis in 0..AXES {
                let of = self.hypothesis.fits[axis].first_order(frame);
                let turned = if frame == 0 { 0.0 } else { period.turning[axis] };
                let next = of.decay * followed[axis] + of.gain * acted[axis] + of.offset + turned;
                let error = period.after[axis] - next;
                errors[frame][axis] = error;
                let kept = if error.abs() < LOST_MPS { period.kept } else { 0.0 };
                followed[axis] = period.after[axis] - kept * error;
            }
        }
        period.add(&mut self.costs, &errors);
        self.hypothesis.update(period, acted);
    }

    /// Sum of e² with forgetting \[(m/s)²\].
    pub(super) fn cost(&self) -> f64 {
        self.costs[self.hypothesis.frame()]
    }
}
