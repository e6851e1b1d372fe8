//! No harm: per axis, the learned model is used only while it foretells the next velocity better than the main model with its observer.
//!
//! Both are asked in every period, before the sample can have been learnt from. Of their errors e and e₀
//!
//! ```text
//! E ← E + (e² − E)/M        out when E > E₀, back when E < 0.9 E₀
//! ```
//! The record E belongs to the learner, not to one snapshot: snapshots follow each other every few periods, and each is nearly the one
//! before. One that explains the last samples, of which it has seen most, worse than no model does is out at once.

use model::{AXES, Velocity};

/// M: memory of the record \[periods\].
const MEMORY: f64 = 15.0;

/// Share of the error without a model below which the model is used again.
const RETURN: f64 = 0.9;

/// Which axes are used, and the record behind it. Does not allocate.
#[derive(Debug, Clone, PartialEq)]
pub struct Trust {
    /// E: mean squared one-step error with the learned model.
    learned: Velocity,
    /// E₀: the same without it.
    plain: Velocity,
    used: [bool; AXES],
}

impl Default for Trust {
    /// Trusts until the first error.
    fn default() -> Self {
        Self { learned: [0.0; AXES], plain: [0.0; AXES], used: [true; AXES] }
    }
}

impl Trust {
    /// The axes on which the learned model is used.
    pub fn used(&self) -> [bool; AXES] {
        self.used
    }

    /// Takes in the errors of one period, with and without the learned model. One that is no number is worse than any.
    pub fn update(&mut self, learned: &Velocity, plain: &Velocity) {
        for axis in 0..AXES {
            let (e, e0) = (learned[axis] * learned[axis], plain[axis] * plain[axis]);
            if !e0.is_finite() {
                continue;
            }
            self.plain[axis] += (e0 - self.plain[axis]) / MEMORY;
            if !e.is_finite() {
                self.distrust(axis);
                continue;
            }
            self.learned[axis] += (e - self.learned[axis]) / MEMORY;
            if self.learned[axis] > self.plain[axis] {
                self.used[axis] = false;
            } else if self.learned[axis] < RETURN * self.plain[axis] {
                self.used[axis] = true;
            }
        }
    }

    /// Judges a snapshot before its use, by the mean squared errors over the last samples with it and without.
    pub fn judge(&mut self, learned: &Velocity, plain: &Velocity) {
        for axis in 0..AXES {
            // Written so that what is no number is not good.
            let good = learned[axis] <= plain[axis];
            if !good {
                self.distrust(axis);
            }
        }
    }

    fn distrust(&mut self, axis: usize) {
        self.used[axis] = false;
        self.learned[axis] = self.learned[axis].max(self.plain[axis]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_that_turns_worse_on_one_axis_is_left_there_within_a_period_and_returns_when_it_is_better() {
        let mut trust = Trust::default();
        for _ in 0..30 {
            trust.update(&[0.010; 3], &[0.011; 3]);
        }
        assert_eq!(trust.used(), [true; 3]);
        trust.update(&[0.010, 0.050, 0.010], &[0.011; 3]);
        assert_eq!(trust.used(), [true, false, true]);
        for _ in 0..100 {
            trust.update(&[0.010, 0.009, 0.010], &[0.011; 3]);
        }
        assert_eq!(trust.used(), [true; 3]);
    }

    #[test]
    fn a_snapshot_that_explains_less_than_nothing_is_out_before_its_first_use() {
        let mut trust = Trust::default();
        trust.judge(&[1e-4, 3e-4, f64::NAN], &[2e-4, 2e-4, 2e-4]);
        assert_eq!(trust.used(), [true, false, false]);
    }

    #[test]
    fn errors_that_are_no_numbers_are_worse_than_any() {
        let mut trust = Trust::default();
        trust.update(&[f64::NAN, 0.0, f64::INFINITY], &[0.01, f64::NAN, 0.01]);
        assert_eq!(trust.used(), [false, true, false]);
    }
}
