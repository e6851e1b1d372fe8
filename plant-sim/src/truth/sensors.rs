//! What the sensors make of the truth: seeded noise, then rounding to a step.

use rand::{Rng, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64Mcg;

use super::parameters::Sensor;
use super::world::TrueState;

/// What the sensors saw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measurement {
    /// x, y and heading in the world \[m, m, rad\]; the heading is not wrapped.
    pub pose: [f64; 3],
    /// Body velocity (forward, left, yaw) \[m/s, m/s, rad/s\].
    pub velocity: [f64; 3],
    /// Wheel speeds \[rad/s\].
    pub wheel_speed: [f64; 4],
    /// Motor currents \[A\].
    pub current: [f64; 4],
}

/// The sensors and their generator, which nothing else draws from.
#[derive(Debug, Clone)]
pub(super) struct Sensors {
    settings: Sensor,
    generator: Pcg64Mcg,
}

impl Sensors {
    /// Sensors whose noise the seed determines.
    pub(super) fn new(settings: Sensor, seed: u64) -> Self {
        Self { settings, generator: Pcg64Mcg::seed_from_u64(seed) }
    }

    /// One look at the truth. It draws equally often whatever is off, so that turning one noise on leaves the others
    /// alone. Does not allocate.
    pub(super) fn measure(&mut self, truth: &TrueState) -> Measurement {
        let s = self.settings;
        let mut see = |truth: f64, noise: f64, step: f64| {
            let draw: f64 = self.generator.sample(StandardNormal);
            quantised(truth + noise * draw, step)
        };
        let [x, y, heading] = truth.pose;
        let [forward, left, yaw] = truth.velocity;
        Measurement {
            pose: [
                see(x, s.position_noise_m, s.position_step_m),
                see(y, s.position_noise_m, s.position_step_m),
                see(heading, s.heading_noise_rad, s.heading_step_rad),
            ],
            velocity: [
                see(forward, s.velocity_noise_mps, s.velocity_step_mps),
                see(left, s.velocity_noise_mps, s.velocity_step_mps),
                see(yaw, s.yaw_rate_noise_radps, s.yaw_rate_step_radps),
            ],
            wheel_speed: truth.wheel_speed.map(|w| see(w, s.wheel_speed_noise_radps, s.wheel_speed_step_radps)),
            current: truth.current.map(|i| see(i, s.current_noise_a, s.current_step_a)),
        }
    }
}

/// The multiple of `step` nearest to `value`; `value` itself if there is no step.
fn quantised(value: f64, step: f64) -> f64 {
    if step > 0.0 { (value / step).round() * step } else { value }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn truth() -> TrueState {
        TrueState {
            pose: [1.234, -0.567, 0.89],
            velocity: [2.7, -0.1, 0.3],
            wheel_speed: [50.0, 51.0, 52.0, 53.0],
            current: [1.0, -2.0, 3.0, -4.0],
            force: [0.0; 3],
        }
    }

    #[test]
    fn ideal_sensors_tell_the_truth() {
        let seen = Sensors::new(Sensor::default(), 1).measure(&truth());
        let TrueState { pose, velocity, wheel_speed, current, .. } = truth();
        assert_eq!(seen, Measurement { pose, velocity, wheel_speed, current });
    }

    #[test]
    fn a_step_leaves_at_most_half_a_step() {
        let settings = Sensor { position_step_m: 0.1, wheel_speed_step_radps: 0.7, ..Sensor::default() };
        let seen = Sensors::new(settings, 1).measure(&truth());
        assert!((seen.pose[0] - 1.2).abs() < 1e-12 && (seen.pose[1] + 0.6).abs() < 1e-12);
        for (seen, truth) in seen.wheel_speed.iter().zip(truth().wheel_speed) {
            assert!((seen - truth).abs() <= 0.35 + 1e-12);
        }
    }

    #[test]
    fn noise_has_the_deviation_that_was_asked_for() {
        let mut sensors = Sensors::new(Sensor { velocity_noise_mps: 0.02, ..Sensor::default() }, 3);
        let looks = 20_000;
        let squares: f64 = (0..looks).map(|_| (sensors.measure(&truth()).velocity[0] - 2.7).powi(2)).sum();
        let deviation = (squares / f64::from(looks)).sqrt();
        assert!((deviation - 0.02).abs() < 0.001, "{deviation}");
    }

    #[test]
    fn one_noise_leaves_the_others_alone() {
        let one = Sensor { current_noise_a: 0.1, ..Sensor::default() };
        let two = Sensor { position_noise_m: 0.1, ..one };
        let (mut one, mut two) = (Sensors::new(one, 5), Sensors::new(two, 5));
        let (alone, beside) = (one.measure(&truth()), two.measure(&truth()));
        assert_eq!(alone.current.map(f64::to_bits), beside.current.map(f64::to_bits));
    }
}
