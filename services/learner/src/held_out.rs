//! Noise of a new sample, estimated from held-out samples: those that the model of their time was
//! not trained on.
//!
//! ```text
//! |e| ≤ z √(v + n)  for 95 of 100 samples      n = 95th of 100 of  e²/z² − v,    z = 1.96
//! ```
//! with v the variance of the function at the sample. The likelihood's noise σₙ² belongs to the
//! training samples, which are fitted and weighted by age. A quantile of held-out errors depends on
//! no such model, and one outlier among fifty samples hardly changes it.
//!
//! Reference: Vovk, Gammerman & Shafer, *Algorithmic Learning in a Random World*, 2005, for
//! intervals from held-out errors.

use model::Velocity;
use std::collections::VecDeque;

/// Number of the last samples in use.
const MEMORY: usize = 100;
/// Smallest number of samples for a quantile.
const SAMPLES_MIN: usize = 20;
/// Share of the samples that the interval must contain.
const SHARE: f64 = 0.95;
/// Its half width in standard deviations.
const HALF_WIDTH: f64 = 1.96;

/// Number of samples that judge what was learnt earlier …
const LATELY: u32 = 20;
/// … and the number of them in the interval that contradicts it. A merely rough model, with four in
/// five samples inside, has so few in one of a hundred such windows.
const CONTRADICTED: u32 = 12;

/// The last held-out errors, per axis.
#[derive(Debug, Clone, Default)]
pub struct HeldOut {
    /// e²/z² − v, oldest first.
    beyond: VecDeque<Velocity>,
    counted: u64,
    within: [u64; 3],
    /// Whether each of the last samples was in its interval, per axis: one bit each, the newest
    /// lowest.
    lately: [u32; 3],
}

impl HeldOut {
    /// Stores the error of one sample, the variance of the function there, and the n that was
    /// predicted for it. Ignores numbers that are not finite.
    pub fn push(&mut self, error: &Velocity, variance: &Velocity, told: &Velocity) {
        let beyond: Velocity =
            std::array::from_fn(|axis| (error[axis] / HALF_WIDTH).powi(2) - variance[axis]);
        if beyond.iter().all(|value| value.is_finite()) {
            self.counted += 1;
            for (axis, within) in self.within.iter_mut().enumerate() {
                let inside = beyond[axis] <= told[axis];
                *within += u64::from(inside);
                self.lately[axis] =
                    (self.lately[axis] << 1 | u32::from(inside)) & ((1 << LATELY) - 1);
            }
            self.beyond.push_back(beyond);
            if self.beyond.len() > MEMORY {
                self.beyond.pop_front();
            }
        }
    }

    /// Whether so few of the last samples of one axis were in their intervals that the robot must
    /// have changed.
    pub fn contradicted(&self) -> bool {
        self.counted >= u64::from(LATELY)
            && self.lately.iter().any(|inside| inside.count_ones() < CONTRADICTED)
    }

    /// Share of all samples that were in their predicted interval, per axis.
    pub fn covered(&self) -> Velocity {
        self.within.map(|within| within as f64 / self.counted.max(1) as f64)
    }

    /// n, or `otherwise` while too few samples are held out; at least `floor`
    /// \[(m/s)², (m/s)², (rad/s)²\].
    pub fn noise(&self, otherwise: &Velocity, floor: &Velocity) -> Velocity {
        let rank = ((self.beyond.len() + 1) as f64 * SHARE).ceil() as usize;
        std::array::from_fn(|axis| {
            let mut of_axis: Vec<f64> = self.beyond.iter().map(|beyond| beyond[axis]).collect();
            of_axis.sort_by(f64::total_cmp);
            let enough = self.beyond.len() >= SAMPLES_MIN;
            let noise =
                of_axis.get(rank.saturating_sub(1)).or(of_axis.last()).copied().filter(|_| enough);
            noise.unwrap_or(otherwise[axis]).max(floor[axis])
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use model::AXES;
    use model::gp::split_mix::SplitMix64;

    const FLOOR: Velocity = [1e-12; AXES];

    #[test]
    fn the_interval_contains_19_of_20_new_errors() {
        let (mut held_out, mut random) = (HeldOut::default(), SplitMix64::new(1));
        for i in 0..20_000 {
            // Heavy-tailed errors, where the function is known well and not so well.
            let variance = if i % 3 == 0 { 4e-4 } else { 1e-6 };
            let error = random.normal()
                * (variance + 1e-4_f64 * (1.0 + 0.5 * random.normal()).powi(2)).sqrt();
            let told = held_out.noise(&[1.0; AXES], &FLOOR);
            held_out.push(&[0.0, error, 0.0], &[0.0, variance, 0.0], &told);
        }
        let share = held_out.covered()[1];
        assert!((0.93..=0.97).contains(&share), "{share}");
    }

    #[test]
    fn one_outlier_in_fifty_changes_the_noise_little() {
        let noise = |wild: f64| {
            let (mut held_out, mut random) = (HeldOut::default(), SplitMix64::new(2));
            for i in 0..100 {
                held_out.push(
                    &[if i % 50 == 7 { wild } else { 0.01 * random.normal() }; AXES],
                    &[0.0; AXES],
                    &[0.0; AXES],
                );
            }
            held_out.noise(&[1.0; AXES], &FLOOR)[0]
        };
        assert!(noise(1e3) < 1.5 * noise(0.0));
    }

    #[test]
    fn without_held_out_samples_the_noise_is_that_of_the_likelihood() {
        let mut held_out = HeldOut::default();
        held_out.push(&[f64::NAN; AXES], &[0.0; AXES], &[0.0; AXES]);
        assert_eq!(held_out.noise(&[1.0, 2.0, 0.0], &[0.5; AXES]), [1.0, 2.0, 0.5]);
    }

    #[test]
    fn a_model_of_another_robot_is_contradicted_and_a_rough_one_is_not() {
        let contradicted = |scale: f64, samples: usize| {
            let (mut held_out, mut random) = (HeldOut::default(), SplitMix64::new(3));
            (0..samples).any(|_| {
                held_out.push(
                    &[0.01 * random.normal(), scale * random.normal(), 0.0],
                    &[1e-5; AXES],
                    &[9e-5; AXES],
                );
                held_out.contradicted()
            })
        };
        assert!(contradicted(0.05, 25) && !contradicted(0.05, 19));
        assert!(!contradicted(0.013, 100));
    }
}
