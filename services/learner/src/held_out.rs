//! How far a new sample is off, found from samples that the model of their time had not seen.
//!
//! ```text
//! |e| ≤ z √(v + n)  for 95 of 100 samples      n = 95th of 100 of  e²/z² − v,    z = 1.96
//! ```
//! with v the variance of the function where the sample was made. The noise σₙ² that the likelihood finds belongs to the samples that the
//! model is made from: fitted, of different age and told apart by it. A quantile of errors has no such model, and a wild one among fifty
//! hardly moves it.
//!
//! Reference: Vovk, Gammerman & Shafer, *Algorithmic Learning in a Random World*, 2005, for intervals from held-out errors.

use model::Velocity;
use std::collections::VecDeque;

/// Samples that are looked back on.
const MEMORY: usize = 100;
/// Fewest that a quantile is taken of.
const SAMPLES_MIN: usize = 20;
/// Share of them that the interval is to hold.
const SHARE: f64 = 0.95;
/// Its half width in standard deviations.
const HALF_WIDTH: f64 = 1.96;

/// Samples by which what was learnt before is judged …
const LATELY: u32 = 20;
/// … and how few of them in the interval contradict it. Of a model that is only rough, with four in five inside, one in a hundred such windows
/// has so few.
const CONTRADICTED: u32 = 12;

/// The last held-out errors, per axis.
#[derive(Debug, Clone, Default)]
pub struct HeldOut {
    /// e²/z² − v, oldest first.
    beyond: VecDeque<Velocity>,
    counted: u64,
    within: [u64; 3],
    /// Whether each of the last samples was in its interval, per axis: one bit each, the newest lowest.
    lately: [u32; 3],
}

impl HeldOut {
    /// Takes in the error of one sample, the variance of the function there, and the n that it was told to have. Numbers that are none are
    /// passed over.
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

    /// Whether of the last samples so few were in their intervals, on one axis, that the robot cannot be the one that was learnt.
    pub fn contradicted(&self) -> bool {
        self.counted >= u64::from(LATELY)
            && self.lately.iter().any(|inside| inside.count_ones() < CONTRADICTED)
    }

    /// Share of all samples that were in the interval which they were told, per axis.
    pub fn covered(&self) -> Velocity {
        self.within.map(|within| within as f64 / self.counted.max(1) as f64)
    }

    /// n, or `otherwise` as long as too little has been held out; at least `floor` \[(m/s)², (m/s)², (rad/s)²\].
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
    fn of_new_errors_19_in_20_are_as_large_as_it_says_at_most() {
        let (mut held_out, mut random) = (HeldOut::default(), SplitMix64::new(1));
        for i in 0..20_000 {
            // Errors with tails, where the function is known well and not so well.
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
    fn one_wild_error_in_fifty_makes_little_difference() {
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
    fn before_anything_was_held_out_what_the_likelihood_says_is_taken() {
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
