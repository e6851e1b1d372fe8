//! What the sensors and the wheels say of each other.
//!
//! - **Noise** of a sensor: the third difference of a smooth signal is nearly all noise, with 20
//!   times its variance. Of the velocity, what the response explains is taken away first. The
//!   interval is that of the scatter between blocks of two seconds.
//! - **Latency** λ of the velocity behind the pose: v(t) = v_pose(t − λ), so the two differ by λ v̇.
//!   The measured v̇ has noise, which would make λ smaller. So the simulated one, which has none, is
//!   the instrument: λ = Σ z y/Σ z v̇ with the difference y and the simulated v̇ as z.
//! - **Wheels**: the body velocity that the wheel speeds and the robot file give, per velocity by
//!   the poses. A ratio that is not 1 is another effective radius, slip, or another distance of the
//!   wheels. Where the wheels roll forward, the ratio gives the radius; how much more or less it is
//!   in yaw gives their lever.

use crate::fit::Beside;
use crate::log::{Log, Sample, Stretch};
use robot::{AXES, Velocity, Wheels};

/// Time over which displacements by pose and by wheels are compared \[s\].
const APART_S: f64 = 0.5;
/// Least root mean square of such displacements that tells a ratio \[m, m, rad\]: an axis that
/// rests only has noise.
const APART_LEAST: f64 = 0.03;
/// Length of the blocks whose noise is compared \[s\].
const BLOCK_S: f64 = 2.0;
/// Half width of a 95 % interval, in standard deviations.
const WIDTH_95: f64 = 1.96;

/// A number with half of its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured {
    /// The number.
    pub value: f64,
    /// Half of its 95 % interval.
    pub half_width: f64,
}

/// Estimates of the sensors.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensors {
    /// Noise of the velocity, one standard deviation \[m/s, m/s, rad/s\].
    pub velocity_noise: [Measured; AXES],
    /// Noise of the pose, one standard deviation \[m, m, rad\].
    pub pose_noise: [Measured; AXES],
    /// Latency of the velocity behind the pose, if the robot accelerates enough to tell \[s\].
    pub latency_s: Option<Measured>,
    /// Velocity by the poses per body velocity by the wheels, if wheel speeds are measured.
    pub per_wheels: Option<[Option<Measured>; AXES]>,
    /// Effective mean radius of the wheels \[m\].
    pub wheel_radius_m: Option<Measured>,
    /// Effective lever of the wheels in yaw: a + b of mecanum wheels in a rectangle \[m\].
    pub wheel_lever_m: Option<Measured>,
}

/// Estimates the sensors of a robot with `wheels` from `log`, of which `beside` has the simulation.
pub fn sensors(log: &Log, wheels: &Wheels, beside: &[Vec<Beside>]) -> Sensors {
    let block = ((BLOCK_S / log.period_s) as usize).max(4);
    let velocity_noise = std::array::from_fn(|axis| {
        let error = |both: &Beside| both.sample.velocity[axis] - both.simulated[axis];
        let errors = beside.iter().map(|stretch| stretch.iter().map(error).collect());
        noise(&errors.collect::<Vec<Vec<f64>>>(), block)
    });
    let pose_noise = std::array::from_fn(|axis| {
        let pose = |stretch: &Stretch| stretch.iter().map(|sample| sample.pose[axis]).collect();
        noise(&log.stretches.iter().map(pose).collect::<Vec<Vec<f64>>>(), block)
    });
    let has_wheels = log.wheels > 0 && wheels.count() > 0;
    let per_wheels = has_wheels.then(|| per_wheels(log, wheels));
    let [ahead, _, yaw] = per_wheels.unwrap_or_default();
    let wheel_radius_m = ahead.map(|ahead| ahead.times(wheels.radius_m()));
    let wheel_lever_m = ahead.zip(yaw).map(|(ahead, yaw)| ahead.per(yaw).times(wheels.lever_m()));
    let latency_s = latency(log.period_s, beside);
    Sensors { velocity_noise, pose_noise, latency_s, per_wheels, wheel_radius_m, wheel_lever_m }
}

impl Measured {
    fn times(self, factor: f64) -> Self {
        Self { value: factor * self.value, half_width: factor * self.half_width }
    }

    /// The quotient of two numbers whose errors are independent.
    fn per(self, other: Self) -> Self {
        let value = self.value / other.value;
        let relative = (self.half_width / self.value).hypot(other.half_width / other.value);
        Self { value, half_width: value.abs() * relative }
    }
}

/// Noise of a sensor whose values come in stretches, from blocks of so many values.
fn noise(stretches: &[Vec<f64>], block: usize) -> Measured {
    let parts = stretches.iter().flat_map(|stretch| stretch.chunks_exact(block));
    let noises: Vec<f64> = parts.map(deviation).collect();
    let count = noises.len() as f64;
    if noises.len() < 2 {
        let whole: Vec<f64> = stretches.iter().flatten().copied().collect();
        return Measured { value: deviation(&whole), half_width: f64::INFINITY };
    }
    let value = noises.iter().sum::<f64>() / count;
    let squares: f64 = noises.iter().map(|noise| (noise - value).powi(2)).sum();
    Measured { value, half_width: WIDTH_95 * (squares / (count - 1.0) / count).sqrt() }
}

/// Standard deviation of white noise on a smooth signal, by the median of its third differences.
fn deviation(values: &[f64]) -> f64 {
    let mut sizes: Vec<f64> = values
        .windows(4)
        .map(|four| (four[3] - 3.0 * four[2] + 3.0 * four[1] - four[0]).abs())
        .collect();
    sizes.sort_by(f64::total_cmp);
    1.4826 * sizes.get(sizes.len() / 2).copied().unwrap_or(0.0) / 20.0_f64.sqrt()
}

/// Displacement between two samples in the body, with the heading in the middle.
fn displacement(from: &Sample, to: &Sample) -> Velocity {
    let turn = to.pose[2] - from.pose[2];
    let turn = turn.sin().atan2(turn.cos());
    let (sin, cos) = (from.pose[2] + 0.5 * turn).sin_cos();
    let [x, y] = [0, 1].map(|axis| to.pose[axis] - from.pose[axis]);
    [cos * x + sin * y, cos * y - sin * x, turn]
}

/// Numbers of one period: the instrument z, x and y of y ≈ a x.
type Triple = [f64; 3];

/// a of y ≈ a x with the instrument z, which is x itself in least squares. The interval is that of
/// errors that are correlated over `lags` samples.
fn slope(triples: &[Triple], lags: usize) -> Option<Measured> {
    let scale: f64 = triples.iter().map(|[z, x, _]| z * x).sum();
    let value = triples.iter().map(|[z, _, y]| z * y).sum::<f64>() / scale;
    let gradients: Vec<f64> = triples.iter().map(|[z, x, y]| z * (y - value * x)).collect();
    let mut variance: f64 = gradients.iter().map(|gradient| gradient * gradient).sum();
    for lag in 1..=lags.min(gradients.len().saturating_sub(1)) {
        let products = gradients.iter().zip(&gradients[lag..]).map(|(a, b)| a * b);
        variance += 2.0 * (1.0 - lag as f64 / (lags + 1) as f64) * products.sum::<f64>();
    }
    let half_width = WIDTH_95 * variance.max(0.0).sqrt() / scale.abs();
    (value.is_finite() && half_width.is_finite()).then_some(Measured { value, half_width })
}

/// Over one period the mean velocity by the poses is that at its middle; that by the velocities is
/// late by λ.
fn latency(period: f64, beside: &[Vec<Beside>]) -> Option<Measured> {
    let mut triples = Vec::new();
    for four in beside.iter().flat_map(|stretch| stretch.windows(4)) {
        let by_pose = displacement(&four[1].sample, &four[2].sample);
        for axis in 0..2 {
            let [first, second, third, fourth] =
                [0, 1, 2, 3].map(|place: usize| four[place].sample.velocity[axis]);
            let measured = (fourth - first) / (3.0 * period);
            let simulated = (four[3].simulated[axis] - four[0].simulated[axis]) / (3.0 * period);
            let difference = by_pose[axis] / period - 0.5 * (second + third);
            triples.push([simulated, measured, difference]);
        }
    }
    slope(&triples, (1.0 / period) as usize).filter(|latency| latency.half_width < 0.05)
}

fn per_wheels(log: &Log, wheels: &Wheels) -> [Option<Measured>; AXES] {
    let apart = ((APART_S / log.period_s) as usize).max(1);
    let mut triples: [Vec<Triple>; AXES] = Default::default();
    for stretch in &log.stretches {
        for span in stretch.windows(apart + 1) {
            let (Some(first), Some(last)) = (span.first(), span.last()) else { continue };
            let mut by_wheels = [0.0; AXES];
            if span.iter().any(|sample| sample.wheel_speed.is_none()) {
                continue;
            }
            for pair in span.windows(2) {
                let speeds = [&pair[0], &pair[1]]
                    .map(|sample| wheels.body(&sample.wheel_speed.unwrap_or_default()));
                // In the heading of the middle, as the displacement by the poses.
                let turn = 0.5 * (pair[0].pose[2] + pair[1].pose[2])
                    - 0.5 * (first.pose[2] + last.pose[2]);
                let (sin, cos) = turn.sin_cos();
                let mean: Velocity =
                    std::array::from_fn(|axis| 0.5 * (speeds[0][axis] + speeds[1][axis]));
                let [ahead, side, yaw] = mean.map(|speed| speed * log.period_s);
                by_wheels[0] += cos * ahead - sin * side;
                by_wheels[1] += sin * ahead + cos * side;
                by_wheels[2] += yaw;
            }
            let by_pose = displacement(first, last);
            for (axis, triples) in triples.iter_mut().enumerate() {
                triples.push([by_wheels[axis], by_wheels[axis], by_pose[axis]]);
            }
        }
    }
    triples.map(|triples| {
        let squares: f64 = triples.iter().map(|[_, by_wheels, _]| by_wheels * by_wheels).sum();
        let is_moved = squares > APART_LEAST.powi(2) * triples.len() as f64;
        let ratio = slope(&triples, 2 * apart).filter(|_| is_moved);
        ratio.filter(|ratio| ratio.value > 0.0 && ratio.half_width < 0.2 * ratio.value)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_noise_of_a_smooth_signal_is_found() {
        let mut state = 1_u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        let mut normal = || (0..12).map(|_| random()).sum::<f64>() - 6.0;
        let values: Vec<f64> =
            (0..4000).map(|k| (f64::from(k) * 0.02).sin() + 0.005 * normal()).collect();
        let found = noise(&[values], 100);
        assert!((found.value - 0.005).abs() < 3e-4 && found.half_width < 3e-4, "{found:?}");
    }
}
