//! What is made of the part of the residual that a given model leaves: a linear function of velocity and input, found at once by
//! recursive least squares, and the disturbance observer for the rest.
//!
//! ```text
//! g − ĝ = W φ(v, u) + d + error
//! ```
//! A learned model ĝ takes seconds to come; the linear part knows a wrong gain after a few periods, and shrinks as ĝ takes it over.
//!
//! The quality of an explanation is what a plan needs of it: its error with the d of a few periods ago, since a plan holds d.

use crate::learned::Residual;
use crate::least_squares::LeastSquares;
use crate::observer::Observer;
use crate::{AXES, Velocity};

/// For so many periods d has been held when the error is taken.
const LEAD: usize = 3;

/// One period as it is to be explained.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sample {
    /// Velocity at its start.
    pub velocity: Velocity,
    /// Input that the wheels got.
    pub input: Velocity,
    /// Residual of the main model.
    pub residual: Velocity,
}

/// W, d, and how well they do. Does not allocate.
#[derive(Debug, Clone)]
pub struct Explanation {
    linear: Option<LeastSquares>,
    observer: Observer,
    /// d of the last periods, newest first.
    held: [Velocity; LEAD],
    error: Velocity,
}

impl Explanation {
    /// Explains with an observer, and with a linear function if there is one. Both know nothing yet.
    pub fn new(linear: Option<LeastSquares>, observer: Observer) -> Self {
        Self { linear, observer, held: [[0.0; AXES]; LEAD], error: [0.0; AXES] }
    }

    /// W.
    pub fn linear(&self) -> Option<&LeastSquares> {
        self.linear.as_ref()
    }

    /// d \[m/s, m/s, rad/s\].
    pub fn disturbance(&self) -> Velocity {
        self.observer.disturbance()
    }

    /// Last one-step error of the whole model \[m/s, m/s, rad/s\].
    pub fn innovation(&self) -> Velocity {
        self.observer.innovation()
    }

    /// Last error with the d of a few periods before; no number where the model said none \[m/s, m/s, rad/s\].
    pub fn error(&self) -> Velocity {
        self.error
    }

    /// Takes in one period, of which the model ĝ says `opinion`.
    pub fn update(&mut self, sample: &Sample, opinion: &Velocity) {
        // A model that says no number explains nothing, and must not poison what is found without it.
        let left: Velocity =
            std::array::from_fn(|axis| sample.residual[axis] - if opinion[axis].is_finite() { opinion[axis] } else { 0.0 });
        let linear = self.linear.as_ref().map_or([0.0; AXES], |linear| linear.mean(&sample.velocity, &sample.input));
        let rest: Velocity = std::array::from_fn(|axis| left[axis] - linear[axis]);
        let [.., oldest] = self.held;
        self.error = std::array::from_fn(|axis| rest[axis] - oldest[axis] + 0.0 * opinion[axis]);
        self.held.rotate_right(1);
        self.held[0] = self.observer.disturbance();
        self.observer.update(&rest);
        if let Some(linear) = &mut self.linear {
            linear.update(&sample.velocity, &sample.input, &left);
        }
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        self.observer.reset();
        if let Some(linear) = &mut self.linear {
            linear.reset();
        }
        (self.held, self.error) = ([[0.0; AXES]; LEAD], [0.0; AXES]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples() -> impl Iterator<Item = Sample> {
        (0..60).map(|i| {
            let velocity = [(0.4 * f64::from(i)).sin(), (0.3 * f64::from(i)).cos(), 0.1];
            let input = [1.1 * velocity[0] + 0.1 * (1.1 * f64::from(i)).cos(), velocity[1], 0.0];
            Sample { velocity, input, residual: [0.02 - 0.1 * velocity[0] + 0.05 * input[0], 0.03 * input[1], -0.01] }
        })
    }

    fn explained(linear: bool, opinion: impl Fn(&Sample) -> Velocity) -> Explanation {
        let linear = linear.then(|| LeastSquares::new(0.995, [1.0; 3]));
        let mut explanation = Explanation::new(linear, Observer::new(0.5, [1.0; 3]));
        for sample in samples() {
            explanation.update(&sample, &opinion(&sample));
        }
        explanation
    }

    #[test]
    fn a_wrong_gain_is_explained_by_the_linear_part_and_not_by_the_observer() {
        let (with, without) = (explained(true, |_| [0.0; 3]), explained(false, |_| [0.0; 3]));
        for axis in 0..2 {
            assert!(with.error()[axis].abs() < 1e-3, "{:?}", with.error());
        }
        assert!(without.error()[0].abs() > 0.02, "{:?}", without.error());
        assert!(with.disturbance().iter().all(|d| d.abs() < 1e-3), "{:?}", with.disturbance());
    }

    #[test]
    fn what_a_model_knows_is_left_to_it() {
        let explanation = explained(true, |sample| sample.residual);
        let left = explanation.linear().map(|linear| linear.mean(&[0.5; 3], &[0.5; 3])).unwrap_or([1.0; 3]);
        assert!(left.iter().chain(&explanation.disturbance()).all(|value| value.abs() < 1e-12));
    }

    #[test]
    fn a_model_that_says_no_number_is_no_error_that_could_be_small() {
        let explanation = explained(true, |_| [f64::NAN, 0.0, 0.0]);
        assert!(explanation.error()[0].is_nan() && explanation.error()[1].is_finite());
        assert!(explanation.disturbance().iter().all(|d| d.is_finite()));
    }
}
