//! One period of the pose by the Runge–Kutta method of fourth order, on the main model alone. This
//! is the discretisation of most MPC toolboxes.
//!
//! The velocity follows v̇ = (u − v)/τ. So at each of the four nodes it is a mixture of v and u,
//! and the heading there starts from θ:
//!
//! ```text
//! vᵢ = (1 − rᵢ) v + rᵢ u        r₁ = 0,  rᵢ = cᵢ (T/τ) (1 − rᵢ₋₁)        c = (0, ½, ½, 1)
//! θᵢ = θ + cᵢ T ωᵢ₋₁            p⁺ = p + T Σ bᵢ R(θᵢ) vᵢ                  b = (⅙, ⅓, ⅓, ⅙)
//! ```
//! The residual does not move the pose of its own period, only the velocity at its end.

use crate::{AXES, Pose, State, Velocity};
use nalgebra::{Matrix3, Vector3};

/// c.
const REACH: [f64; 4] = [0.0, 0.5, 0.5, 1.0];
/// b.
const WEIGHT: [f64; 4] = [1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0];

/// The four nodes of one period. Constant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RungeKutta {
    /// r of each node, per axis.
    input_share: [Velocity; 4],
    /// T \[s\].
    period: f64,
}

/// The pose at the end of a period, and how it varies; rows x, y, yaw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Displaced {
    pub(crate) pose: Pose,
    /// ∂/∂θ, beyond the identity.
    pub(crate) by_heading: Vector3<f64>,
    /// ∂/∂v.
    pub(crate) by_velocity: Matrix3<f64>,
    /// ∂/∂u.
    pub(crate) by_input: Matrix3<f64>,
}

impl RungeKutta {
    /// The nodes of a period of `period` \[s\], for axes of these time constants τ \[s\].
    pub fn new(time_constant: &Velocity, period: f64) -> Self {
        let mut input_share = [[0.0; AXES]; 4];
        for node in 1..4 {
            input_share[node] = std::array::from_fn(|axis| {
                REACH[node] * period / time_constant[axis] * (1.0 - input_share[node - 1][axis])
            });
        }
        Self { input_share, period }
    }

    /// B per axis: share of the input in the velocity at the end; the rest is A.
    pub fn gain(&self, time_constant: &Velocity) -> Velocity {
        std::array::from_fn(|axis| {
            let slope: f64 = WEIGHT
                .iter()
                .zip(&self.input_share)
                .map(|(weight, share)| weight * (1.0 - share[axis]))
                .sum();
            self.period / time_constant[axis] * slope
        })
    }

    /// The pose at the end of a period that begins with `state`, under `input`. Does not allocate.
    pub(crate) fn displace(&self, state: &State, input: &Velocity) -> Displaced {
        let [x, y, yaw] = state.pose;
        let (mut moved, mut by_heading) = (Vector3::new(x, y, yaw), Vector3::zeros());
        let (mut by_velocity, mut by_input) = (Matrix3::zeros(), Matrix3::zeros());
        let (mut rate_before, mut share_before) = (0.0, 0.0);
        for ((reach, weight), share) in REACH.iter().zip(WEIGHT).zip(&self.input_share) {
            let [forward, left, rate]: Velocity = std::array::from_fn(|axis| {
                state.velocity[axis] + share[axis] * (input[axis] - state.velocity[axis])
            });
            let (ahead, step) = (reach * self.period, weight * self.period);
            let (sin, cos) = (yaw + ahead * rate_before).sin_cos();
            let turned = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0) * step;
            let by_turn =
                Vector3::new(-sin * forward - cos * left, cos * forward - sin * left, 0.0) * step;
            moved += turned * Vector3::new(forward, left, rate);
            by_heading += by_turn;
            let share_now = Matrix3::from_diagonal(&Vector3::from(*share));
            by_velocity += turned * (Matrix3::identity() - share_now);
            by_input += turned * share_now;
            let (mut yaw_rate, mut yaw_input) = (by_velocity.column_mut(2), by_input.column_mut(2));
            yaw_rate += by_turn * (ahead * (1.0 - share_before));
            yaw_input += by_turn * (ahead * share_before);
            (rate_before, share_before) = (rate, share[2]);
        }
        Displaced { pose: moved.into(), by_heading, by_velocity, by_input }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The method as textbooks write it, on pose and velocity at once.
    fn textbook(
        state: &State,
        input: &Velocity,
        time_constant: &Velocity,
        period: f64,
    ) -> [f64; 6] {
        let slope = |x: [f64; 6]| -> [f64; 6] {
            let (sin, cos) = x[2].sin_cos();
            let pose = [cos * x[3] - sin * x[4], sin * x[3] + cos * x[4], x[5]];
            std::array::from_fn(|i| {
                if i < 3 { pose[i] } else { (input[i - 3] - x[i]) / time_constant[i - 3] }
            })
        };
        let start = state.to_array();
        let along = |by: f64, slope: [f64; 6]| -> [f64; 6] {
            std::array::from_fn(|i| start[i] + by * slope[i])
        };
        let first = slope(start);
        let second = slope(along(0.5 * period, first));
        let third = slope(along(0.5 * period, second));
        let fourth = slope(along(period, third));
        std::array::from_fn(|i| {
            start[i] + period / 6.0 * (first[i] + 2.0 * second[i] + 2.0 * third[i] + fourth[i])
        })
    }

    #[test]
    fn the_pose_is_that_of_the_textbook_method() {
        let (time_constant, period) = ([0.25, 0.3, 0.2], 0.1);
        let state =
            State { pose: [0.3, -0.2, 0.7], velocity: [1.2, -0.4, 0.9], ..State::default() };
        let input = [2.0, 0.5, -0.6];
        let expected = textbook(&state, &input, &time_constant, period);
        let nodes = RungeKutta::new(&time_constant, period);
        let (displaced, gain) = (nodes.displace(&state, &input), nodes.gain(&time_constant));
        for axis in 0..3 {
            let velocity = state.velocity[axis] + gain[axis] * (input[axis] - state.velocity[axis]);
            assert!(
                (displaced.pose[axis] - expected[axis]).abs() < 1e-15,
                "{} is not {}",
                displaced.pose[axis],
                expected[axis]
            );
            assert!(
                (velocity - expected[axis + 3]).abs() < 1e-15,
                "{velocity} is not {}",
                expected[axis + 3]
            );
        }
    }
}
