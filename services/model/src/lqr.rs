//! The gain K of u = −K x^f (eq. 23), per axis, and its cost-to-go.
//!
//! About u = `u_ref`, with the velocity error in the reference frame, the tracking error of each
//! axis is
//!
//! ```text
//! e = (position error, velocity error)     e⁺ = ⎡1  T(1−w+w A)⎤ e + ⎡T w B⎤ δu
//!                                               ⎣0      A     ⎦     ⎣  B  ⎦
//! ```
//! K and P solve the discrete algebraic Riccati equation of the stage cost
//! eᵀ diag(`q_p`, `q_v`) e + r δu².
//!
//! Reference: Anderson & Moore, *Optimal Control: Linear Quadratic Methods*, 1990, ch. 2.

use crate::main_model::MainModel;
use nalgebra::{Matrix2, RowVector2, Vector2};

/// Stage cost of one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisCost {
    /// `q_p`: weight on the position error.
    pub position: f64,
    /// `q_v`: weight on the velocity error.
    pub velocity: f64,
    /// r: weight on the input's deviation; greater than 0.
    pub input: f64,
}

/// Gain and cost-to-go of one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisGain {
    /// K: input per position and velocity error \[1/s, –\].
    pub gain: [f64; 2],
    /// P: cost-to-go eᵀ P e, symmetric.
    pub cost: [[f64; 2]; 2],
}

/// The iteration of the Riccati equation did not converge.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "the Riccati equation of axis {axis} did not converge in {iterations} iterations; \
     expected weights greater than 0"
)]
pub struct NoGain {
    /// 0 forward, 1 left, 2 yaw.
    pub axis: usize,
    /// Number of iterations.
    pub iterations: usize,
}

/// K and P of the three axes.
///
/// # Errors
/// [`NoGain`] if a weight makes the problem ill-posed.
pub fn gains(model: &MainModel, costs: &[AxisCost; 3]) -> Result<[AxisGain; 3], NoGain> {
    let mut gains = [AxisGain { gain: [0.0; 2], cost: [[0.0; 2]; 2] }; 3];
    for (axis, (slot, cost)) in gains.iter_mut().zip(costs).enumerate() {
        *slot = axis_gain(model, axis, cost)?;
    }
    Ok(gains)
}

fn axis_gain(model: &MainModel, axis: usize, cost: &AxisCost) -> Result<AxisGain, NoGain> {
    const ITERATIONS: usize = 20_000;
    let (decay, gain, period) = (model.decay[axis], model.gain[axis], model.period);
    let share = model.end_share[axis];
    let a = Matrix2::new(1.0, period * (1.0 - share + share * decay), 0.0, decay);
    let b = Vector2::new(period * share * gain, gain);
    let stage = Matrix2::new(cost.position, 0.0, 0.0, cost.velocity);
    let mut p = stage;
    for _ in 0..ITERATIONS {
        let k: RowVector2<f64> = (b.transpose() * p * a) / (cost.input + (b.transpose() * p * b).x);
        let next = stage + a.transpose() * p * (a - b * k);
        let next = 0.5 * (next + next.transpose());
        let change = (next - p).amax();
        p = next;
        if change <= 1e-12 * p.amax() {
            return Ok(AxisGain { gain: [k.x, k.y], cost: [[p.m11, p.m12], [p.m21, p.m22]] });
        }
    }
    Err(NoGain { axis, iterations: ITERATIONS })
}

#[cfg(test)]
mod tests {
    use super::*;
    use robot::Robot;

    const COST: AxisCost = AxisCost { position: 10.0, velocity: 2.0, input: 0.05 };

    #[test]
    fn the_cost_to_go_is_the_cost_of_the_closed_loop() -> Result<(), NoGain> {
        let model = MainModel::new(&Robot::example(), 0.1);
        let [forward, ..] = gains(&model, &[COST; 3])?;
        let (mut position, mut velocity, mut total) = (1.0, -0.5, 0.0);
        let promised = forward.cost[0][0] * position * position
            + 2.0 * forward.cost[0][1] * position * velocity
            + forward.cost[1][1] * velocity * velocity;
        for _ in 0..500 {
            let input = -forward.gain[0] * position - forward.gain[1] * velocity;
            total += COST.position * position * position
                + COST.velocity * velocity * velocity
                + COST.input * input * input;
            let next = model.decay[0] * velocity + model.gain[0] * input;
            position += model.period * (velocity + model.end_share[0] * (next - velocity));
            velocity = next;
        }
        assert!((total - promised).abs() < 1e-9 * promised, "{total} is not {promised}");
        Ok(())
    }

    #[test]
    fn an_axis_without_any_weight_has_no_gain_or_a_finite_one() {
        let nothing = AxisCost { position: 0.0, velocity: 0.0, input: 0.0 };
        let model = MainModel::new(&Robot::example(), 0.1);
        assert!(gains(&model, &[nothing; 3]).is_err());
    }
}
