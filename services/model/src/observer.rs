//! The disturbance observer: per axis, what neither the main model nor the learned one explains.
//!
//! ```text
//! innovation = v⁺ − (f(v, u) + g(v, u) + d)      d ← d + ℓ · innovation
//! ```
//! In the steady state d is the constant part of what is left, which makes the controller offset-free. GP and observer share the
//! residual without fighting: when another g is adopted, d is worked out again from the last samples, as if that g had always been there.

use crate::Velocity;

/// How many samples are kept for working d out again.
pub const MEMORY: usize = 12;

/// One period as the observer saw it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sample {
    /// Velocity at its start.
    pub velocity: Velocity,
    /// Input that the wheels got.
    pub input: Velocity,
    /// Residual of the main model.
    pub residual: Velocity,
}

/// d and the samples that it came from. Does not allocate.
#[derive(Debug, Clone)]
pub struct Observer {
    gain: f64,
    /// Largest |d| that physics allows.
    bound: Velocity,
    disturbance: Velocity,
    innovation: Velocity,
    samples: [Sample; MEMORY],
    /// Number of samples ever taken in; the last [`MEMORY`] are kept, in a ring.
    taken: usize,
}

impl Observer {
    /// An observer of gain ℓ: 0 never corrects, 1 believes the last sample alone. |d| stays within `bound` \[m/s, m/s, rad/s\].
    pub fn new(gain: f64, bound: Velocity) -> Self {
        Self { gain, bound, disturbance: [0.0; 3], innovation: [0.0; 3], samples: [Sample::default(); MEMORY], taken: 0 }
    }

    /// d \[m/s, m/s, rad/s\], per period.
    pub fn disturbance(&self) -> Velocity {
        self.disturbance
    }

    /// Last one-step error of the whole model, before d was corrected \[m/s, m/s, rad/s\].
    pub fn innovation(&self) -> Velocity {
        self.innovation
    }

    /// Takes in one period, of which the learned model says `learned`.
    pub fn update(&mut self, sample: Sample, learned: &Velocity) {
        self.correct(&sample, learned);
        let place = self.taken % MEMORY;
        if let Some(slot) = self.samples.get_mut(place) {
            *slot = sample;
        }
        self.taken += 1;
    }

    /// Works d out again for another learned model, over the samples that are kept, and gives the mean squared innovations on the
    /// way: no number on an axis of which the model says none.
    pub fn replay(&mut self, learned: impl Fn(&Velocity, &Velocity) -> Velocity) -> Velocity {
        let innovation = self.innovation;
        self.disturbance = [0.0; 3];
        let mut squares = [0.0; 3];
        for age in (0..self.taken.min(MEMORY)).rev() {
            let place = (self.taken - 1 - age) % MEMORY;
            if let Some(&sample) = self.samples.get(place) {
                let learned = learned(&sample.velocity, &sample.input);
                self.correct(&sample, &learned);
                // What the model does not say counts as the worst it could have said.
                squares = std::array::from_fn(|axis| squares[axis] + self.innovation[axis] * self.innovation[axis] + 0.0 * learned[axis]);
            }
        }
        self.innovation = innovation;
        squares.map(|sum| sum / self.taken.clamp(1, MEMORY) as f64)
    }

    /// Forgets everything: the robot has been put somewhere else.
    pub fn reset(&mut self) {
        *self = Self::new(self.gain, self.bound);
    }

    fn correct(&mut self, sample: &Sample, learned: &Velocity) {
        for axis in 0..3 {
            // A model that says no number explains nothing, and must not poison what was found without it.
            let explained = if learned[axis].is_finite() { learned[axis] } else { 0.0 };
            self.innovation[axis] = sample.residual[axis] - explained - self.disturbance[axis];
            let corrected = self.disturbance[axis] + self.gain * self.innovation[axis];
            self.disturbance[axis] = corrected.clamp(-self.bound[axis], self.bound[axis]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(residual: Velocity) -> Sample {
        Sample { residual, ..Sample::default() }
    }

    #[test]
    fn a_constant_disturbance_is_found() {
        let mut observer = Observer::new(0.5, [1.0; 3]);
        for _ in 0..60 {
            observer.update(sample([0.1, -0.2, 0.3]), &[0.0; 3]);
        }
        for (found, truth) in observer.disturbance().iter().zip([0.1, -0.2, 0.3]) {
            assert!((found - truth).abs() < 1e-12);
        }
    }

    #[test]
    fn a_model_that_explains_everything_leaves_nothing_to_the_observer_after_a_replay() {
        let mut observer = Observer::new(0.5, [1.0; 3]);
        for _ in 0..30 {
            observer.update(sample([0.1, -0.2, 0.3]), &[0.0; 3]);
        }
        let left = observer.replay(|_, _| [0.1, -0.2, 0.3]);
        assert!(left.iter().all(|square| *square < 1e-24));
        for left in observer.disturbance() {
            assert!(left.abs() < 1e-12);
        }
    }

    #[test]
    fn one_absurd_sample_moves_it_no_further_than_physics_allows() {
        let mut observer = Observer::new(0.5, [0.2; 3]);
        observer.update(sample([1000.0, -1000.0, 0.0]), &[0.0; 3]);
        assert_eq!(observer.disturbance(), [0.2, -0.2, 0.0]);
    }
}
