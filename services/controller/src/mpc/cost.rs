//! The cost: tracking error, distance from the target, change of the input.
//!
//! The error is taken in the reference's frame,
//!
//! ```text
//! e = (Rᵀ(θ_r) (p − p_r),  θ − θ_r,  R(θ − θ_r) v_xy − v_r,  ω − ω_r)
//! ```
//! in which the linearised axes separate, so that the LQR of [`model::lqr`] belongs to the same error.

use super::condense::Condensed;
use super::qp::QuadraticProgram;
use super::{Outlook, Stage};
use crate::reference::ReferencePoint;
use crate::settings::MpcSettings;
use model::covariance::Feedback;
use model::lqr::{AxisCost, AxisGain, NoGain, gains};
use model::main_model::MainModel;
use model::{State, Velocity, wrap};
use nalgebra::{SMatrix, SVector};

/// Weights and LQR of one controller. Constant.
pub struct Cost {
    /// Diagonal of Q, in the order of the error.
    stage: [f64; 6],
    /// Factor from Q to F.
    terminal_factor: f64,
    /// R, per axis.
    input: f64,
    /// S, per axis.
    change: f64,
    gains: [AxisGain; 3],
}

/// Error of a state against the reference: x, y, yaw, forward, left, yaw rate in the reference's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackingError {
    /// e.
    pub value: SVector<f64, 6>,
    /// Sine and cosine of θ_r.
    reference: (f64, f64),
    /// Sine and cosine of θ − θ_r.
    turned: (f64, f64),
    velocity: Velocity,
}

impl TrackingError {
    /// e of `state` against `point`.
    pub fn new(state: &State, point: &ReferencePoint) -> Self {
        let heading = wrap(state.pose[2] - point.pose[2]);
        let (reference, turned) = (point.pose[2].sin_cos(), heading.sin_cos());
        let (dx, dy) = (state.pose[0] - point.pose[0], state.pose[1] - point.pose[1]);
        let [forward, left, rate] = state.velocity;
        let value = SVector::<f64, 6>::from([
            reference.1 * dx + reference.0 * dy,
            reference.1 * dy - reference.0 * dx,
            heading,
            turned.1 * forward - turned.0 * left - point.velocity[0],
            turned.0 * forward + turned.1 * left - point.velocity[1],
            rate - point.velocity[2],
        ]);
        Self { value, reference, turned, velocity: state.velocity }
    }

    /// ∂e/∂x.
    fn jacobian(&self) -> SMatrix<f64, 6, 6> {
        let ((sr, cr), (st, ct)) = (self.reference, self.turned);
        let [forward, left, _] = self.velocity;
        let mut jacobian = SMatrix::<f64, 6, 6>::identity();
        jacobian[(0, 0)] = cr;
        jacobian[(0, 1)] = sr;
        jacobian[(1, 0)] = -sr;
        jacobian[(1, 1)] = cr;
        jacobian[(3, 2)] = -st * forward - ct * left;
        jacobian[(4, 2)] = ct * forward - st * left;
        jacobian[(3, 3)] = ct;
        jacobian[(3, 4)] = -st;
        jacobian[(4, 3)] = st;
        jacobian[(4, 4)] = ct;
        jacobian
    }
}

impl Cost {
    pub(super) fn new(settings: &MpcSettings, main: &MainModel) -> Result<Self, NoGain> {
        let w = &settings.weights;
        let planar = AxisCost { position: w.position, velocity: w.velocity, input: w.input };
        let yaw = AxisCost { position: w.heading, velocity: w.yaw_rate, input: w.input };
        Ok(Self {
            stage: [w.position, w.position, w.heading, w.velocity, w.velocity, w.yaw_rate],
            terminal_factor: w.terminal_factor,
            input: w.input,
            change: w.input_change,
            gains: gains(main, &[planar, planar, yaw])?,
        })
    }

    /// u = t − K e, turned from the reference's frame into the body's: the answer without an optimiser.
    pub fn lqr_input(&self, error: &TrackingError, target: &Velocity) -> Velocity {
        let correction: Velocity =
            std::array::from_fn(|axis| -self.gains[axis].gain[0] * error.value[axis] - self.gains[axis].gain[1] * error.value[axis + 3]);
        let (sin, cos) = error.turned;
        [
            target[0] + cos * correction[0] + sin * correction[1],
            target[1] + cos * correction[1] - sin * correction[0],
            target[2] + correction[2],
        ]
    }

    /// K = ∂u/∂x of [`lqr_input`](Self::lqr_input), for a target that does not turn with the robot.
    pub(super) fn feedback(&self, error: &TrackingError) -> Feedback {
        let mut by_error = Feedback::zeros();
        for (axis, of_axis) in self.gains.iter().enumerate() {
            (by_error[(axis, axis)], by_error[(axis, axis + 3)]) = (-of_axis.gain[0], -of_axis.gain[1]);
        }
        let (sin, cos) = error.turned;
        let into_body = SMatrix::<f64, 3, 3>::new(cos, sin, 0.0, -sin, cos, 0.0, 0.0, 0.0, 1.0);
        into_body * by_error * error.jacobian()
    }

    /// Adds the cost of the present plan, to second order in the free inputs, to `program`.
    pub(super) fn write(&self, outlook: &Outlook<'_>, program: &mut QuadraticProgram) {
        let Outlook { condensed, stages, .. } = *outlook;
        let horizon = stages.len();
        for (k, point) in outlook.reference.iter().enumerate().take(horizon + 1).skip(1) {
            let state = outlook.state(k);
            let factor = if k == horizon { self.terminal_factor } else { 1.0 };
            let weights = SVector::<f64, 6>::from(self.stage) * factor;
            write_state(k, state, point, &weights, condensed, program);
        }
        self.write_inputs(stages, outlook.last_input, condensed.blocks(), program);
    }

    /// R on the distance from the target, S on the change.
    fn write_inputs(&self, stages: &[Stage], last_input: &Velocity, blocks: usize, program: &mut QuadraticProgram) {
        let mut before = last_input;
        for (k, stage) in stages.iter().enumerate() {
            let block = k.min(blocks - 1);
            for axis in 0..3 {
                let here = 3 * block + axis;
                program.add_square(here, self.input, stage.input[axis] - stage.target[axis]);
                if k < blocks {
                    let change = stage.input[axis] - before[axis];
                    program.add_square(here, self.change, change);
                    if block > 0 {
                        program.add_difference(here - 3, here, self.change, change);
                    }
                }
            }
            before = &stage.input;
        }
    }
}

/// Adds |e(x_k)|² of one predicted state, to second order.
fn write_state(
    k: usize,
    state: &State,
    point: &ReferencePoint,
    weights: &SVector<f64, 6>,
    condensed: &Condensed,
    program: &mut QuadraticProgram,
) {
    let error = TrackingError::new(state, point);
    let jacobian = error.jacobian();
    let weighted = weights.component_mul(&error.value);
    for column in 0..condensed.reach(k) {
        let of_column = jacobian * condensed.block(k, column);
        program.add_gradient(3 * column, &(of_column.transpose() * weighted));
        let weighted_column = SMatrix::<f64, 6, 3>::from_fn(|row, c| weights[row] * of_column[(row, c)]);
        for row in 0..=column {
            let of_row = jacobian * condensed.block(k, row);
            program.add_hessian(3 * row, 3 * column, &(of_row.transpose() * weighted_column));
        }
    }
}
