//! No harm: per axis, the learned model is used only while it foretells better than what there is without it.
//!
//! Three explanations of the residual run side by side, and all are asked in every period, before the sample can have been learnt from:
//!
//! | way       | what it rests on                                                 |
//! |-----------|------------------------------------------------------------------|
//! | `Plain`   | main model and observer                                          |
//! | `Linear`  | the same, with a linear part found here                          |
//! | `Learned` | the same, with the learned model                                 |
//!
//! ```text
//! E = Σ e² over the last M periods      the way of least E is taken, once its E is below 0.9 of that of the present way;
//!                                       a way whose E is above that of `Plain` is left at once
//! ```
//! Few periods, and all alike: one large error is enough to be out, and it is forgotten soon. The record of `Learned` belongs to the
//! learner and not to one snapshot: snapshots follow each other every few periods, and each is nearly the one before. But a new snapshot
//! also has to explain the last samples, most of which it was made from: where it does that worse than was foretold, that counts.

use model::{AXES, Velocity};

/// M: length of the record \[periods\].
const MEMORY: usize = 10;

/// Share of the present way's error below which another way is taken.
const BETTER: f64 = 0.9;

/// A way to explain the residual.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Way {
    /// Main model and observer.
    Plain,
    /// With a linear part.
    Linear,
    /// With the learned model.
    Learned,
}

impl Way {
    /// All of them, in the order of their records.
    pub const ALL: [Self; 3] = [Self::Plain, Self::Linear, Self::Learned];
}

/// Squared errors of the last periods, in a ring.
type Record = [Velocity; MEMORY];

/// Which way is taken on which axis, and why. Does not allocate.
#[derive(Debug, Clone, PartialEq)]
pub struct Trust {
    records: [Record; 3],
    /// Periods ever taken in.
    taken: usize,
    open: [bool; 3],
    chosen: [Way; AXES],
}

impl Trust {
    /// Chooses among the `open` ways, of which the first is taken until another is better.
    pub fn new(open: &[Way]) -> Self {
        let first = open.first().copied().unwrap_or(Way::Plain);
        Self { records: [[[0.0; AXES]; MEMORY]; 3], taken: 0, open: Way::ALL.map(|way| open.contains(&way)), chosen: [first; AXES] }
    }

    /// The way that is taken on each axis.
    pub fn chosen(&self) -> [Way; AXES] {
        self.chosen
    }

    /// Takes in the errors of one period, by way. One that is no number is worse than any.
    pub fn update(&mut self, errors: &[Velocity; 3]) {
        let place = self.taken % MEMORY;
        self.taken += 1;
        for (record, error) in self.records.iter_mut().zip(errors) {
            record[place] = error.map(|error| if error.is_finite() { error * error } else { f64::INFINITY });
        }
        self.choose();
    }

    /// A new snapshot: what its errors over the last periods would have been, oldest first.
    pub fn judge(&mut self, errors: impl ExactSizeIterator<Item = Velocity>) {
        let first = !self.open[Way::Learned as usize];
        self.open[Way::Learned as usize] = true;
        let record = &mut self.records[Way::Learned as usize];
        let known = errors.len().min(self.taken).min(MEMORY);
        let skipped = errors.len() - known;
        for (age, error) in (0..known).rev().zip(errors.skip(skipped)) {
            let slot = &mut record[(self.taken - 1 - age) % MEMORY];
            for axis in 0..AXES {
                let square = if error[axis].is_finite() { error[axis] * error[axis] } else { f64::INFINITY };
                slot[axis] = if first { square } else { slot[axis].max(square) };
            }
        }
        self.choose();
    }

    fn choose(&mut self) {
        for axis in 0..AXES {
            let sum = |way: Way| self.records[way as usize].iter().map(|errors| errors[axis]).sum::<f64>();
            let present = sum(self.chosen[axis]);
            let open = Way::ALL.into_iter().filter(|&way| self.open[way as usize]);
            let Some(best) = open.min_by(|&a, &b| sum(a).total_cmp(&sum(b))) else { continue };
            let harmful = self.open[Way::Plain as usize] && present > sum(Way::Plain);
            if harmful || sum(best) < BETTER * present {
                self.chosen[axis] = best;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after(periods: usize, errors: [Velocity; 3]) -> Trust {
        let mut trust = Trust::new(&Way::ALL);
        for _ in 0..periods {
            trust.update(&errors);
        }
        trust
    }

    #[test]
    fn a_model_that_turns_worse_on_one_axis_is_left_there_within_a_period_and_taken_again_when_it_is_better() {
        let mut trust = after(30, [[0.011; 3], [0.012; 3], [0.009; 3]]);
        assert_eq!(trust.chosen(), [Way::Learned; 3]);
        trust.update(&[[0.011; 3], [0.012; 3], [0.009, 0.050, 0.009]]);
        assert_eq!(trust.chosen(), [Way::Learned, Way::Plain, Way::Learned]);
        for _ in 0..30 {
            trust.update(&[[0.011; 3], [0.012; 3], [0.009; 3]]);
        }
        assert_eq!(trust.chosen(), [Way::Learned; 3]);
    }

    #[test]
    fn a_snapshot_that_explains_less_than_the_observer_is_not_used() {
        let mut trust = Trust::new(&[Way::Plain]);
        for _ in 0..5 {
            trust.update(&[[0.010; 3]; 3]);
        }
        trust.judge([[0.005, 0.020, f64::NAN]; 5].into_iter());
        assert_eq!(trust.chosen(), [Way::Learned, Way::Plain, Way::Plain]);
    }

    #[test]
    fn errors_that_are_no_numbers_are_worse_than_any() {
        let mut trust = after(5, [[0.02; 3], [0.02; 3], [0.01; 3]]);
        trust.update(&[[0.02; 3], [0.02; 3], [f64::NAN, 0.01, f64::INFINITY]]);
        assert_eq!(trust.chosen(), [Way::Plain, Way::Learned, Way::Plain]);
    }

    #[test]
    fn with_one_way_there_is_nothing_to_choose() {
        let mut trust = Trust::new(&[Way::Linear]);
        trust.update(&[[0.0; 3], [1.0; 3], [0.0; 3]]);
        assert_eq!(trust.chosen(), [Way::Linear; 3]);
    }
}
