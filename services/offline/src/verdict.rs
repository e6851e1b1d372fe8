//! No harm: whether a learned model may be used.
//!
//! The controller has an observer in any case. So the learned model with an observer is compared
//! with the main model with the same observer, on held-out motion. The error one step ahead is
//! mostly that of noise and random forces, and the controller plans over many steps. So a single
//! axis is judged ten steps ahead.

use crate::cross_validation::{Errors, Findings};
use model::{AXES, Velocity};

/// Largest ratio of the errors on one axis, ten steps ahead.
pub const WORSE_MAX: f64 = 1.05;

/// Errors of the learned model per error of the main model, both with an observer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Verdict {
    /// One step ahead, and ten steps ahead, per axis.
    pub ratios: [Velocity; 2],
}

impl Verdict {
    /// The verdict on the last model of `findings`.
    pub fn of(findings: &Findings) -> Self {
        let [_, main, .., learned] = &findings.errors;
        Self::between(learned, main)
    }

    /// The errors `of` per error of `other`.
    pub fn between(of: &Errors, other: &Errors) -> Self {
        let ratio = |steps: usize| {
            std::array::from_fn(|axis| of[steps][axis] / other[steps][axis].max(f64::MIN_POSITIVE))
        };
        Self { ratios: [ratio(0), ratio(1)] }
    }

    /// Geometric mean over the axes: one step ahead, and ten steps ahead.
    pub fn means(&self) -> [f64; 2] {
        self.ratios.map(|ratios| ratios.iter().product::<f64>().powf(1.0 / AXES as f64))
    }

    /// Largest ratio of an axis, ten steps ahead.
    pub fn worst(&self) -> f64 {
        let [_, ten] = self.ratios;
        ten.into_iter().fold(f64::NEG_INFINITY, f64::max)
    }

    /// Whether the model predicts better on average, and on no axis clearly worse. Numbers that are
    /// not finite are no better.
    pub fn is_better(&self) -> bool {
        self.means().iter().all(|mean| *mean < 1.0) && self.worst() <= WORSE_MAX
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn verdict(one: Velocity, ten: Velocity) -> Verdict {
        Verdict { ratios: [one, ten] }
    }

    #[test]
    fn better_on_average_and_clearly_worse_nowhere_is_better() {
        assert!(verdict([0.5, 1.2, 0.9], [0.8, 1.04, 0.9]).is_better());
        assert!(!verdict([0.5; AXES], [0.5, 1.06, 0.5]).is_better(), "worse on an axis");
        assert!(!verdict([1.0, 1.0, 1.01], [0.5; AXES]).is_better(), "worse one step ahead");
        assert!(!verdict([0.5; AXES], [1.0; AXES]).is_better(), "equal ten steps ahead");
        assert!(!verdict([f64::NAN, 0.5, 0.5], [0.5; AXES]).is_better());
    }
}
