//! The cost: tracking error, distance from the target, change of the input.
//!
//! The error is taken in the reference's frame,
//!
//! ```text
//! e = (Rᵀ(θ_r) (p − p_r),  θ − θ_r,  R(θ − θ_r) v_xy − v_r,  ω − ω_r)
//! ```
//! In this frame the linearised axes separate, so that the LQR of [`model::lqr`] belongs to the
//! same error. Other controllers use v − v_r in the body's frame ([`Formulation::Plain`]).

use super::qp::{Penalties, QuadraticProgram};
use super::{Formulation, PresentPlan, Stage};
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
    formulation: Formulation,
}

/// Error of a state against the reference: x, y, yaw, forward, left, yaw rate in the reference's
/// frame.
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

    /// e with v − v_r in the body's frame, whatever the heading error, and its Jacobian.
    fn plain(state: &State, point: &ReferencePoint) -> (SVector<f64, 6>, SMatrix<f64, 6, 6>) {
        let mut error = Self::new(state, point);
        for axis in 0..2 {
            error.value[axis + 3] = state.velocity[axis] - point.velocity[axis];
        }
        (error.value, error.pose_jacobian())
    }

    /// ∂e/∂x for the pose; identity for all other entries.
    fn pose_jacobian(&self) -> SMatrix<f64, 6, 6> {
        let (sr, cr) = self.reference;
        let mut jacobian = SMatrix::<f64, 6, 6>::identity();
        jacobian[(0, 0)] = cr;
        jacobian[(0, 1)] = sr;
        jacobian[(1, 0)] = -sr;
        jacobian[(1, 1)] = cr;
        jacobian
    }

    /// ∂e/∂x.
    fn jacobian(&self) -> SMatrix<f64, 6, 6> {
        let (st, ct) = self.turned;
        let [forward, left, _] = self.velocity;
        let mut jacobian = self.pose_jacobian();
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
    pub(super) fn new(
        settings: &MpcSettings,
        formulation: Formulation,
        main: &MainModel,
    ) -> Result<Self, NoGain> {
        let w = &settings.weights;
        let planar = AxisCost { position: w.position, velocity: w.velocity, input: w.input };
        let yaw = AxisCost { position: w.heading, velocity: w.yaw_rate, input: w.input };
        Ok(Self {
            stage: [w.position, w.position, w.heading, w.velocity, w.velocity, w.yaw_rate],
            terminal_factor: w.terminal_factor,
            input: w.input,
            change: w.input_change,
            gains: gains(main, &[planar, planar, yaw])?,
            formulation,
        })
    }

    /// u = t − K e, rotated from the reference's frame to the body's: the answer without an
    /// optimiser.
    pub fn lqr_input(&self, error: &TrackingError, target: &Velocity) -> Velocity {
        let correction: Velocity = std::array::from_fn(|axis| {
            -self.gains[axis].gain[0] * error.value[axis]
                - self.gains[axis].gain[1] * error.value[axis + 3]
        });
        let (sin, cos) = error.turned;
        [
            target[0] + cos * correction[0] + sin * correction[1],
            target[1] + cos * correction[1] - sin * correction[0],
            target[2] + correction[2],
        ]
    }

    /// K = ∂u/∂x of [`lqr_input`](Self::lqr_input), for a target that does not rotate with the
    /// robot.
    pub(super) fn feedback(&self, error: &TrackingError) -> Feedback {
        let mut by_error = Feedback::zeros();
        for (axis, of_axis) in self.gains.iter().enumerate() {
            (by_error[(axis, axis)], by_error[(axis, axis + 3)]) =
                (-of_axis.gain[0], -of_axis.gain[1]);
        }
        let (sin, cos) = error.turned;
        let into_body = SMatrix::<f64, 3, 3>::new(cos, sin, 0.0, -sin, cos, 0.0, 0.0, 0.0, 1.0);
        into_body * by_error * error.jacobian()
    }

    /// Penalties of the free inputs; slacks have no penalty yet.
    pub(super) fn penalties(&self) -> Penalties {
        Penalties { input: self.input, change: self.change, slack: 0.0, slack_curvature: 0.0 }
    }

    /// Writes the cost of the present plan, to second order. O(N), does not allocate.
    pub(super) fn write(&self, plan: &PresentPlan<'_>, program: &mut QuadraticProgram) {
        program.clear_gradients();
        let horizon = plan.stages.len();
        for (k, (stage, point)) in program.stages.iter_mut().zip(plan.reference).enumerate().skip(1)
        {
            let state = plan.state(k);
            let factor = if k == horizon { self.terminal_factor } else { 1.0 };
            let weights = SVector::<f64, 6>::from(self.stage) * factor;
            let (error, jacobian) = match self.formulation {
                Formulation::Holding => {
                    let error = TrackingError::new(state, point);
                    (error.value, error.jacobian())
                }
                Formulation::Plain => TrackingError::plain(state, point),
            };
            let weighted =
                SMatrix::<f64, 6, 6>::from_fn(|row, column| weights[row] * jacobian[(row, column)]);
            stage.curvature = jacobian.transpose() * weighted;
            stage.gradient[..6].copy_from_slice(weighted.tr_mul(&error).as_slice());
        }
        self.write_inputs(plan.stages, plan.last_input, program);
    }

    /// Updates the cost after the target of period `k` has moved.
    pub(super) fn move_target(
        &self,
        k: usize,
        from: &Velocity,
        to: &Velocity,
        program: &mut QuadraticProgram,
    ) {
        for axis in 0..3 {
            program.add_slope(k, axis, self.input * (from[axis] - to[axis]));
        }
    }

    /// R on the distance from the target, S on the change.
    fn write_inputs(
        &self,
        stages: &[Stage],
        last_input: &Velocity,
        program: &mut QuadraticProgram,
    ) {
        let mut before = last_input;
        for (k, stage) in stages.iter().enumerate() {
            for axis in 0..3 {
                program.add_slope(k, axis, self.input * (stage.input[axis] - stage.target[axis]));
                if k < program.blocks() {
                    program.add_change(k, axis, stage.input[axis] - before[axis]);
                }
            }
            before = &stage.input;
        }
    }
}
