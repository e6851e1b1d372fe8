//! The bounded random force: an Ornstein–Uhlenbeck process, clipped, and held for a millisecond of
//! simulated time.
//!
//! x⁺ = φ x + √(1 − φ²) n, φ = e^(−h/τ), n ~ N(0, 1), h = 1 ms. The force is half the bound times
//! x, clipped to the bound.

use nalgebra::Vector3;
use rand::{Rng, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64Mcg;

use super::parameters::RandomForce;

/// h: time for which a force is held \[s\].
const HOLD_S: f64 = 1e-3;

/// The process with a random generator of its own.
#[derive(Debug, Clone)]
pub(super) struct Disturbance {
    /// Bounds along x and y \[N\] and about the vertical axis \[N m\].
    bound: Vector3<f64>,
    /// φ: share of the process that remains after one hold.
    memory: f64,
    /// x: of mean zero and variance one, independent of the bound.
    process: Vector3<f64>,
    generator: Pcg64Mcg,
}

impl Disturbance {
    /// A stationary process for this seed.
    pub(super) fn new(settings: Option<&RandomForce>, seed: u64) -> Self {
        let settings = settings.copied().unwrap_or_default();
        let mut generator = Pcg64Mcg::seed_from_u64(seed);
        Self {
            bound: Vector3::new(settings.bound_n, settings.bound_n, settings.bound_nm),
            memory: if settings.correlation_s > 0.0 {
                (-HOLD_S / settings.correlation_s).exp()
            } else {
                0.0
            },
            process: Vector3::from_fn(|_, _| generator.sample(StandardNormal)),
            generator,
        }
    }

    /// The present force, in the body frame \[N, N, N m\].
    pub(super) fn force(&self) -> Vector3<f64> {
        self.process
            .zip_map(&self.bound, |process, bound| (0.5 * bound * process).clamp(-bound, bound))
    }

    /// Advances the process by one hold. Does not allocate.
    pub(super) fn next(&mut self) {
        let news = (1.0 - self.memory * self.memory).sqrt();
        for process in &mut self.process {
            let draw: f64 = self.generator.sample(StandardNormal);
            *process = self.memory * *process + news * draw;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn process(correlation_s: f64) -> Disturbance {
        Disturbance::new(Some(&RandomForce { bound_n: 2.0, bound_nm: 0.1, correlation_s }), 7)
    }

    #[test]
    fn no_force_is_beyond_its_bound() {
        let mut process = process(0.05);
        for _ in 0..50_000 {
            process.next();
            let force = process.force();
            assert!(force.x.abs() <= 2.0 && force.y.abs() <= 2.0 && force.z.abs() <= 0.1);
        }
    }

    #[test]
    fn the_autocorrelation_is_one_half_after_ln_2_time_constants() {
        let mut process = process(0.05);
        let lag = 35; // 0.05 s · ln 2 in milliseconds
        let forces: Vec<f64> =
            (0..400_000).map(|_| (process.next(), process.force().x).1).collect();
        let power: f64 = forces.iter().map(|x| x * x).sum::<f64>() / forces.len() as f64;
        let product: f64 = forces.iter().zip(&forces[lag..]).map(|(a, b)| a * b).sum::<f64>()
            / (forces.len() - lag) as f64;
        assert!((product / power - 0.5).abs() < 0.05, "{}", product / power);
    }

    #[test]
    fn without_settings_there_is_no_force() {
        let mut process = Disturbance::new(None, 7);
        process.next();
        assert_eq!(process.force(), Vector3::zeros());
    }
}
