//! What the errors of a response are made of: the effect of forces, which lasts for a while, and
//! the noise of the sensor, which is new in each period.
//!
//! ```text
//! e_k = d_k + n_k,   d_k = φ d_{k−1} + w_k
//! ```
//!
//! φ and the two variances follow from the autocovariances r_0, r_1, r_2 of the errors: φ = r_2/r_1
//! and σ_d² = r_1/φ. The innovations ε_k of the steady Kalman filter of this model are about
//! independent. A fit that minimises them has the least variance (Ljung, *System Identification*,
//! 1999, sections 3.2 and 7.2), and it does not follow slow errors at the expense of the rest.

/// Largest φ: forces that last longer are an offset.
const LASTING_MAX: f64 = 0.98;

/// The errors of one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Noise {
    /// φ.
    lasting: f64,
    /// Share of an innovation that lasts: gain of the filter.
    gain: f64,
}

/// Errors that are independent as they are.
pub(super) const WHITE: Noise = Noise { lasting: 0.0, gain: 0.0 };

impl Noise {
    /// That of the errors of each stretch, where an error counts as at most `most`.
    pub(super) fn of<'a>(stretches: impl Iterator<Item = &'a [f64]>, most: f64) -> Self {
        let mut sums = [0.0; 3];
        for errors in stretches {
            let errors: Vec<f64> = errors.iter().map(|error| error.clamp(-most, most)).collect();
            for (lag, sum) in sums.iter_mut().enumerate() {
                *sum += errors.iter().zip(errors.iter().skip(lag)).map(|(a, b)| a * b).sum::<f64>();
            }
        }
        let [all, one, two] = sums;
        let lasting = (two / one).min(LASTING_MAX);
        if !(one > 0.0 && lasting > 0.0) {
            return WHITE;
        }
        // Without any noise of the sensor, the whole innovation lasts.
        let forces = (one / lasting).min(all);
        let sensor = all - forces;
        let new = (1.0 - lasting * lasting) * forces;
        // P = φ² P R/(P + R) + Q, solved for P.
        let half = 0.5 * (new - sensor * (1.0 - lasting * lasting));
        let before = half + (half * half + new * sensor).sqrt();
        let gain = before / (before + sensor);
        if gain.is_finite() { Self { lasting, gain } } else { WHITE }
    }

    /// ε of the errors of one stretch.
    pub(super) fn innovations(
        self,
        errors: impl Iterator<Item = f64>,
    ) -> impl Iterator<Item = f64> {
        let mut expected = 0.0;
        errors.map(move |error| {
            let innovation = error - expected;
            expected = self.lasting * (expected + self.gain * innovation);
            innovation
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    /// Correlation of each value with the next.
    fn correlation(values: &[f64]) -> f64 {
        let squares: f64 = values.iter().map(|value| value * value).sum();
        values.windows(2).map(|pair| pair[0] * pair[1]).sum::<f64>() / squares
    }

    #[test]
    fn innovations_of_lasting_forces_and_noise_are_independent_and_smaller() {
        let mut random = Pcg64Mcg::seed_from_u64(4);
        for (forces, sensor) in [(1.0, 0.3), (1.0, 0.0), (0.1, 1.0), (0.0, 1.0)] {
            let mut lasting = 0.0;
            let errors: Vec<f64> = (0..20_000)
                .map(|_| {
                    lasting = 0.9 * lasting + forces * random.random_range(-1.0..1.0);
                    lasting + sensor * random.random_range(-1.0..1.0)
                })
                .collect();
            let noise = Noise::of([&errors[..]].into_iter(), f64::INFINITY);
            let found: Vec<f64> = noise.innovations(errors.iter().copied()).collect();
            assert!(correlation(&found).abs() < 0.03, "{noise:?} {}", correlation(&found));
            let squares = |values: &[f64]| values.iter().map(|it| it * it).sum::<f64>();
            assert!(squares(&found) < 1.001 * squares(&errors), "{noise:?}");
        }
    }
}
