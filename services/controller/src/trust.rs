//! No harm: per axis, the learned model is used only while it foretells better than what there is without it.
//!
//! Two explanations of the residual run side by side, the main model with an observer (`Plain`) and the learned model with one of its own
//! (`Learned`), and both are asked in every period, before the sample can have been learnt from.
//!
//! ```text
//! E = Σ e² over the last M periods      learned: taken when its E is below 0.9 of the plain one, left when it is above
//! ```
//! Few periods, and all alike: one large error is enough to be out, and it is forgotten soon. The record of `Learned` belongs to the
//! learner and not to one snapshot: snapshots follow each other every few periods, and each is nearly the one before. But a new snapshot
//! also has to explain the last samples, most of which it was made from: where it does that worse than was foretold, that counts.

use model::{AXES, Velocity};

/// M: length of the record \[periods\].
const MEMORY: usize = 10;

/// Share of the plain error below which the learned model is taken.
const BETTER: f64 = 0.9;

/// A way to explain the residual.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Way {
    /// Main model and observer.
    Plain,
    /// Learned model and observer.
    Learned,
}

/// Squared errors of the last periods, in a ring.
type Record = [Velocity; MEMORY];

/// Which way is taken on which axis, and why. Does not allocate.
#[derive(Debug, Clone, PartialEq)]
pub struct Trust {
    plain: Record,
    /// Nothing before the first snapshot.
    learned: Option<Record>,
    /// Periods ever taken in.
    taken: usize,
    chosen: [Way; AXES],
    /// How often the learned model was left, over all axes.
    left: u64,
    /// Whether the learned model is taken as soon as there is one, and never left.
    blind: bool,
}

impl Default for Trust {
    /// Nothing is learnt yet.
    fn default() -> Self {
        Self { plain: [[0.0; AXES]; MEMORY], learned: None, taken: 0, chosen: [Way::Plain; AXES], left: 0, blind: false }
    }
}

impl Trust {
    /// One that takes every learned model for better, to see what that costs.
    pub fn blind() -> Self {
        Self { blind: true, ..Self::default() }
    }

    /// The way that is taken on each axis.
    pub fn chosen(&self) -> [Way; AXES] {
        self.chosen
    }

    /// How often the learned model was left, over all axes.
    pub fn left(&self) -> u64 {
        self.left
    }

    /// Forgets everything, but for how often a model was left.
    pub fn reset(&mut self) {
        *self = Self { left: self.left, blind: self.blind, ..Self::default() };
    }

    /// Takes in the errors of one period. One that is no number is worse than any.
    pub fn update(&mut self, plain: &Velocity, learned: &Velocity) {
        let place = self.taken % MEMORY;
        self.taken += 1;
        self.plain[place] = plain.map(square);
        if let Some(record) = &mut self.learned {
            record[place] = learned.map(square);
        }
        self.choose();
    }

    /// A new snapshot: what its errors over the last periods would have been, oldest first.
    pub fn judge(&mut self, errors: &[Velocity]) {
        let record = self.learned.get_or_insert([[0.0; AXES]; MEMORY]);
        for (age, error) in errors.iter().rev().enumerate().take(self.taken.min(MEMORY)) {
            let slot = &mut record[(self.taken - 1 - age) % MEMORY];
            *slot = std::array::from_fn(|axis| slot[axis].max(square(error[axis])));
        }
        self.choose();
    }

    fn choose(&mut self) {
        let Some(learned) = &self.learned else { return };
        for axis in 0..AXES {
            let sum = |record: &Record| record.iter().map(|errors| errors[axis]).sum::<f64>();
            let (plain, learned) = (sum(&self.plain), sum(learned));
            // Written so that infinity is never better.
            if self.blind || learned < BETTER * plain && learned.is_finite() {
                self.chosen[axis] = Way::Learned;
            } else if !(learned <= plain && learned.is_finite()) {
                self.left += u64::from(self.chosen[axis] == Way::Learned);
                self.chosen[axis] = Way::Plain;
            }
        }
    }
}

fn square(error: f64) -> f64 {
    if error.is_finite() { error * error } else { f64::INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after(periods: usize, plain: Velocity, learned: Velocity) -> Trust {
        let mut trust = Trust::default();
        trust.judge(&[]);
        for _ in 0..periods {
            trust.update(&plain, &learned);
        }
        trust
    }

    #[test]
    fn a_model_that_turns_worse_on_one_axis_is_left_there_within_a_period_and_taken_again_when_it_is_better() {
        let mut trust = after(30, [0.011; 3], [0.009; 3]);
        assert_eq!(trust.chosen(), [Way::Learned; 3]);
        trust.update(&[0.011; 3], &[0.009, 0.050, 0.009]);
        assert_eq!(trust.chosen(), [Way::Learned, Way::Plain, Way::Learned]);
        assert_eq!(trust.left(), 1);
        for _ in 0..30 {
            trust.update(&[0.011; 3], &[0.009; 3]);
        }
        assert_eq!(trust.chosen(), [Way::Learned; 3]);
    }

    #[test]
    fn a_snapshot_that_explains_less_than_the_observer_is_not_used() {
        let mut trust = Trust::default();
        for _ in 0..5 {
            trust.update(&[0.010; 3], &[0.0; 3]);
        }
        trust.judge(&[[0.005, 0.020, f64::NAN]; 5]);
        assert_eq!(trust.chosen(), [Way::Learned, Way::Plain, Way::Plain]);
    }

    #[test]
    fn without_the_gate_a_model_is_used_however_bad_it_is() {
        let mut trust = Trust::blind();
        trust.update(&[0.01; 3], &[0.05; 3]);
        assert_eq!(trust.chosen(), [Way::Plain; 3], "there is none yet");
        trust.judge(&[[0.05; 3]]);
        trust.update(&[0.01; 3], &[0.05; 3]);
        assert_eq!((trust.chosen(), trust.left()), ([Way::Learned; 3], 0));
    }

    #[test]
    fn errors_that_are_no_numbers_are_worse_than_any() {
        let mut trust = after(5, [0.02; 3], [0.01; 3]);
        trust.update(&[0.02; 3], &[f64::NAN, 0.01, f64::INFINITY]);
        assert_eq!(trust.chosen(), [Way::Plain, Way::Learned, Way::Plain]);
    }
}
