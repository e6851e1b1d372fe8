//! What is made of the part of the residual that a given model ĝ leaves: the disturbance observer, and how well the two do together.
//!
//! ```text
//! g = ĝ(v, u) + d + error
//! ```
//! Its innovation is the error one period ahead. The quality of an explanation is what a plan needs of it: its error with the d of a few periods ago, since a plan holds d.

use crate::learned::Moment;
use crate::observer::Observer;
use crate::{AXES, Velocity};

/// Periods that the spread of the innovation looks back on.
const MEMORY: f64 = 30.0;

/// For so many periods d has been held when the error is taken.
const LEAD: usize = 3;

/// One period as it is to be explained.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sample {
    /// What there was.
    pub at: Moment,
    /// Residual of the main model.
    pub residual: Velocity,
}

/// d, and how well it does. Does not allocate.
#[derive(Debug, Clone)]
pub struct Explanation {
    observer: Observer,
    /// d of the last periods, newest first.
    held: [Velocity; LEAD],
    error: Velocity,
    spread: Velocity,
    /// Periods taken in, as long as they are fewer than the spread looks back on.
    periods: f64,
}

impl Explanation {
    /// Explains with an observer that knows nothing yet.
    pub fn new(observer: Observer) -> Self {
        Self { observer, held: [[0.0; AXES]; LEAD], error: [0.0; AXES], spread: [0.0; AXES], periods: 0.0 }
    }

    /// d \[m/s, m/s, rad/s\].
    pub fn disturbance(&self) -> Velocity {
        self.observer.disturbance()
    }

    /// Last one-step error of the whole model \[m/s, m/s, rad/s\].
    pub fn innovation(&self) -> Velocity {
        self.observer.innovation()
    }

    /// Mean squared innovation of the last periods \[(m/s)², (m/s)², (rad/s)²\].
    pub fn spread(&self) -> Velocity {
        self.spread
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
        let [.., oldest] = self.held;
        self.error = std::array::from_fn(|axis| left[axis] - oldest[axis] + 0.0 * opinion[axis]);
        self.held.rotate_right(1);
        self.held[0] = self.observer.disturbance();
        self.observer.update(&left);
        self.periods = (self.periods + 1.0).min(MEMORY);
        let innovation = self.observer.innovation();
        for (spread, innovation) in self.spread.iter_mut().zip(innovation) {
            *spread += (innovation * innovation - *spread) / self.periods;
        }
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        self.observer.reset();
        (self.held, self.error) = ([[0.0; AXES]; LEAD], [0.0; AXES]);
        (self.spread, self.periods) = ([0.0; AXES], 0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn explained(opinion: impl Fn(&Sample) -> Velocity) -> Explanation {
        let mut explanation = Explanation::new(Observer::new(0.5, [1.0; 3]));
        for i in 0..60 {
            let velocity = [(0.4 * f64::from(i)).sin(), (0.3 * f64::from(i)).cos(), 0.1];
            let at = Moment { velocity, ..Moment::default() };
            let sample = Sample { at, residual: [0.02 - 0.1 * velocity[0], 0.03 * velocity[1], -0.01] };
            explanation.update(&sample, &opinion(&sample));
        }
        explanation
    }

    #[test]
    fn what_changes_faster_than_a_plan_is_long_is_an_error_of_the_observer_and_none_of_a_model_that_knows_it() {
        let (with, without) = (explained(|sample| sample.residual), explained(|_| [0.0; 3]));
        assert!(with.error().iter().chain(&with.disturbance()).all(|value| value.abs() < 1e-12));
        assert!(without.error()[0].abs() > 0.02, "{:?}", without.error());
    }

    #[test]
    fn a_model_that_says_no_number_is_no_error_that_could_be_small() {
        let explanation = explained(|_| [f64::NAN, 0.0, 0.0]);
        assert!(explanation.error()[0].is_nan() && explanation.error()[1].is_finite());
        assert!(explanation.disturbance().iter().all(|d| d.is_finite()));
    }
}
