//! The robot's pose, from its measured poses and its motion since.
//!
//! ```text
//! p̂⁻ = p̂ + T R(θ̂ + T ω̄/2) v̄      p̂ = p̂⁻ + k (p − p̂⁻)
//! v̄: mean measured velocity of the period
//! ```
//! The noise of a measured pose is unknown. So filters of several gains k run side by side. The
//! filter in use has the least mean square of its innovations p − p̂⁻ over the last second; it is
//! chosen separately for the position and for the heading. A pose that jumps is followed at once by
//! k = 1, which then predicts best.

use model::{Pose, Velocity, wrap};

/// k.
const GAINS: [f64; 6] = [1.0, 0.5, 0.25, 0.12, 0.06, 0.03];

/// Time over which costs decay \[s\].
const MEMORY_S: f64 = 1.0;

/// Filters of several gains. Does not allocate.
#[derive(Debug)]
pub struct PoseFilter {
    period: f64,
    estimates: [Pose; GAINS.len()],
    /// Mean squared innovation \[m², m², rad²\].
    costs: [Pose; GAINS.len()],
    /// Index of the gain in use, for the position and for the heading.
    chosen: [usize; 2],
    taken: usize,
}

impl PoseFilter {
    /// Filters at the origin, for periods of `period` \[s\].
    pub fn new(period: f64) -> Self {
        let zero = [[0.0; 3]; GAINS.len()];
        Self { period, estimates: zero, costs: zero, chosen: [0; 2], taken: 0 }
    }

    /// p̂ \[m, m, rad\].
    pub fn estimate(&self) -> Pose {
        let [position, heading] = self.chosen.map(|gain| self.estimates[gain]);
        [position[0], position[1], heading[2]]
    }

    /// Continues from a measured pose, without memory of earlier poses.
    pub fn resume(&mut self, measured: &Pose) {
        self.estimates = [*measured; GAINS.len()];
        self.costs = [[0.0; 3]; GAINS.len()];
        (self.chosen, self.taken) = ([0; 2], 0);
    }

    /// Processes one period: its mean velocity in the body frame, and the pose measured at its end.
    pub fn update(&mut self, mean: &Velocity, measured: &Pose) {
        self.taken += 1;
        let fading = (self.period / MEMORY_S).max(1.0 / self.taken as f64);
        let (sin, cos) = (self.estimate()[2] + 0.5 * self.period * mean[2]).sin_cos();
        let moved = [cos * mean[0] - sin * mean[1], sin * mean[0] + cos * mean[1], mean[2]];
        for ((estimate, cost), gain) in self.estimates.iter_mut().zip(&mut self.costs).zip(GAINS) {
            for axis in 0..3 {
                let expected = estimate[axis] + self.period * moved[axis];
                let difference = measured[axis] - expected;
                let innovation = if axis == 2 { wrap(difference) } else { difference };
                estimate[axis] = expected + gain * innovation;
                cost[axis] += fading * (innovation * innovation - cost[axis]);
            }
        }
        let least = |cost: fn(&Pose) -> f64| {
            (0..GAINS.len())
                .min_by(|&a, &b| cost(&self.costs[a]).total_cmp(&cost(&self.costs[b])))
                .unwrap_or(0)
        };
        self.chosen = [least(|cost| cost[0] + cost[1]), least(|cost| cost[2])];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Drives a circle with measurement errors of about `noise` \[m, rad\]. Returns the root mean
    /// square error of the position over the last half, measured and estimated.
    fn driven(noise: f64, slip: f64) -> (f64, f64) {
        let period = 0.02;
        let mut filter = PoseFilter::new(period);
        let mut truth = [0.0; 3];
        let (mut of_measured, mut of_estimate) = (0.0, 0.0);
        filter.resume(&truth);
        for k in 0..1000 {
            let mean = [1.0, 0.0, 0.5];
            let (sin, cos) = (truth[2] + 0.5_f64 * period * mean[2]).sin_cos();
            truth[0] += period * (cos * mean[0] + slip * sin);
            truth[1] += period * (sin * mean[0] - slip * cos);
            truth[2] += period * mean[2];
            let error = |of: usize| noise * (12.9898 * (3 * k + of) as f64).sin();
            let measured = [truth[0] + error(0), truth[1] + error(1), wrap(truth[2] + error(2))];
            filter.update(&mean, &measured);
            if k >= 500 {
                let square =
                    |pose: &Pose| (pose[0] - truth[0]).powi(2) + (pose[1] - truth[1]).powi(2);
                of_measured += square(&measured) / 500.0;
                of_estimate += square(&filter.estimate()) / 500.0;
            }
        }
        (of_measured.sqrt(), of_estimate.sqrt())
    }

    #[test]
    fn most_of_the_pose_noise_is_removed() {
        let (measured, estimate) = driven(0.01, 0.0);
        assert!(estimate < 0.5 * measured, "{estimate} of {measured}");
    }

    #[test]
    fn a_wrong_velocity_adds_no_more_error_than_the_noise() {
        let (measured, estimate) = driven(0.001, 0.2);
        assert!(estimate < 1.5 * measured, "{estimate} of {measured}");
    }

    #[test]
    fn a_pose_that_jumps_is_followed_at_once() {
        let mut filter = PoseFilter::new(0.02);
        for _ in 0..100 {
            filter.update(&[0.0; 3], &[0.0; 3]);
        }
        filter.update(&[0.0; 3], &[2.0, -1.0, 3.0]);
        filter.update(&[0.0; 3], &[2.0, -1.0, 3.0]);
        for (found, truth) in filter.estimate().iter().zip([2.0, -1.0, 3.0]) {
            assert!((found - truth).abs() < 1e-9, "{found} is not {truth}");
        }
    }

    #[test]
    fn a_heading_that_wraps_is_not_taken_for_a_jump() {
        let (_, estimate) = driven(0.0, 0.0);
        assert!(estimate < 1e-9, "{estimate}");
    }
}
