//! The sensors: seeded noise, then rounding to a step; and values that are stuck for a time.

use core::ops::Range;

use rand::{Rng, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64Mcg;
use robot::PerWheel;

use super::parameters::{Sensor, Stuck, StuckSensor, Truth};
use super::schedule::window;
use super::world::TrueState;

/// Measured values.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Measurement {
    /// x, y and heading in the world \[m, m, rad\]; the heading is not wrapped.
    pub pose: [f64; 3],
    /// Body velocity (forward, left, yaw) \[m/s, m/s, rad/s\].
    pub velocity: [f64; 3],
    /// Wheel speeds \[rad/s\].
    pub wheel_speed: PerWheel,
    /// Motor currents \[A\].
    pub current: PerWheel,
}

/// The sensors with a random generator of their own.
#[derive(Debug, Clone)]
pub(super) struct Sensors {
    settings: Sensor,
    wheels: usize,
    generator: Pcg64Mcg,
    stuck: Vec<Standstill>,
}

/// A sensor that is stuck for a time, and its value then, after the first measurement.
#[derive(Debug, Clone)]
struct Standstill {
    window: Range<u64>,
    sensor: StuckSensor,
    shows: Option<Measurement>,
}

impl Standstill {
    /// Replaces stuck values in `seen`. Does not allocate.
    fn hold(&mut self, now_nanos: u64, seen: &mut Measurement) {
        if !self.window.contains(&now_nanos) {
            return;
        }
        let shows = *self.shows.get_or_insert(*seen);
        match self.sensor {
            StuckSensor::Pose => seen.pose = shows.pose,
            StuckSensor::Velocity => seen.velocity = shows.velocity,
            StuckSensor::Everything => *seen = shows,
        }
    }
}

impl Sensors {
    /// Sensors whose noise depends on the seed alone.
    pub(super) fn new(truth: &Truth, seed: u64) -> Self {
        let standstill = |stuck: &Stuck| Standstill {
            window: window(stuck.from_s, stuck.until_s),
            sensor: stuck.sensor,
            shows: None,
        };
        Self {
            settings: truth.sensor,
            wheels: truth.wheels.count(),
            generator: Pcg64Mcg::seed_from_u64(seed),
            stuck: truth.stuck.iter().map(standstill).collect(),
        }
    }

    /// Measures the truth at this time. It draws the same number of random numbers for all
    /// settings, so that one noise does not change the others. Does not allocate.
    pub(super) fn measure(&mut self, truth: &TrueState, now_nanos: u64) -> Measurement {
        let s = self.settings;
        let mut see = |truth: f64, noise: f64, step: f64| {
            let draw: f64 = self.generator.sample(StandardNormal);
            quantised(truth + noise * draw, step)
        };
        let [x, y, heading] = truth.pose;
        let [forward, left, yaw] = truth.velocity;
        let mut seen = Measurement {
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
            ..Measurement::default()
        };
        let wheels = self.wheels;
        for (seen, truth) in seen.wheel_speed.iter_mut().zip(truth.wheel_speed).take(wheels) {
            *seen = see(truth, s.wheel_speed_noise_radps, s.wheel_speed_step_radps);
        }
        for (seen, truth) in seen.current.iter_mut().zip(truth.current).take(wheels) {
            *seen = see(truth, s.current_noise_a, s.current_step_a);
        }
        self.stuck.iter_mut().for_each(|standstill| standstill.hold(now_nanos, &mut seen));
        seen
    }
}

/// The multiple of `step` nearest to `value`; `value` itself if the step is 0.
fn quantised(value: f64, step: f64) -> f64 {
    if step > 0.0 { (value / step).round() * step } else { value }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sensors(sensor: Sensor, seed: u64) -> Sensors {
        Sensors::new(&Truth { sensor, ..Truth::default() }, seed)
    }

    fn truth() -> TrueState {
        TrueState {
            pose: [1.234, -0.567, 0.89],
            velocity: [2.7, -0.1, 0.3],
            wheel_speed: [50.0, 51.0, 52.0, 53.0, 0.0, 0.0, 0.0, 0.0],
            current: [1.0, -2.0, 3.0, -4.0, 0.0, 0.0, 0.0, 0.0],
            force: [0.0; 3],
        }
    }

    #[test]
    fn ideal_sensors_measure_the_truth() {
        let seen = sensors(Sensor::default(), 1).measure(&truth(), 0);
        let TrueState { pose, velocity, wheel_speed, current, .. } = truth();
        assert_eq!(seen, Measurement { pose, velocity, wheel_speed, current });
    }

    #[test]
    fn rounding_changes_a_value_by_at_most_half_a_step() {
        let settings =
            Sensor { position_step_m: 0.1, wheel_speed_step_radps: 0.7, ..Sensor::default() };
        let seen = sensors(settings, 1).measure(&truth(), 0);
        assert!((seen.pose[0] - 1.2).abs() < 1e-12 && (seen.pose[1] + 0.6).abs() < 1e-12);
        for (seen, truth) in seen.wheel_speed.iter().zip(truth().wheel_speed) {
            assert!((seen - truth).abs() <= 0.35 + 1e-12);
        }
    }

    #[test]
    fn noise_has_the_standard_deviation_of_the_settings() {
        let mut noisy = sensors(Sensor { velocity_noise_mps: 0.02, ..Sensor::default() }, 3);
        let looks = 20_000;
        let squares: f64 =
            (0..looks).map(|_| (noisy.measure(&truth(), 0).velocity[0] - 2.7).powi(2)).sum();
        let deviation = (squares / f64::from(looks)).sqrt();
        assert!((deviation - 0.02).abs() < 0.001, "{deviation}");
    }

    #[test]
    fn a_stuck_sensor_repeats_its_first_value_and_the_others_continue() {
        let stuck = Stuck { sensor: StuckSensor::Velocity, from_s: 1e-6, until_s: Some(3e-6) };
        let mut standing = Sensors::new(&Truth { stuck: vec![stuck], ..Truth::default() }, 1);
        let mut look = |now_nanos: u64| {
            let mut truth = truth();
            (truth.pose[0], truth.velocity[0]) = (now_nanos as f64, now_nanos as f64);
            let seen = standing.measure(&truth, now_nanos);
            (seen.pose[0], seen.velocity[0])
        };
        let seen = [500, 1500, 2500, 3500].map(&mut look);
        assert_eq!(seen, [(500.0, 500.0), (1500.0, 1500.0), (2500.0, 1500.0), (3500.0, 3500.0)]);
    }

    #[test]
    fn one_noise_does_not_change_the_others() {
        let one = Sensor { current_noise_a: 0.1, ..Sensor::default() };
        let two = Sensor { position_noise_m: 0.1, ..one };
        let (mut one, mut two) = (sensors(one, 5), sensors(two, 5));
        let (alone, beside) = (one.measure(&truth(), 0), two.measure(&truth(), 0));
        assert_eq!(alone.current.map(f64::to_bits), beside.current.map(f64::to_bits));
    }
}
