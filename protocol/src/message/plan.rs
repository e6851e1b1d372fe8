//! controller → watchers: the planned motion, the model's estimates, and the computing time.

use super::define::message;
use super::{FallbackLevel, SolverStatus};

/// Longest horizon that a plan can carry \[periods\].
pub const HORIZON_MAX: usize = 40;

message! {
    /// The plan behind one command, sent after it. Rows 0 to `horizon` of the horizon arrays count;
    /// `input` has one row fewer.
    Plan = 6 {
        /// Epoch of the plant.
        plant_epoch: u64,
        /// Version of the learned model in use; 0 is the main model alone.
        model_version: u64,
        /// Length of the horizon \[periods\].
        horizon: u32 = length(HORIZON_MAX),
        /// [`SolverStatus`] of the last quadratic program.
        status: u32 = code(SolverStatus),
        /// Iterations of its solver.
        iterations: u32,
        /// [`FallbackLevel`] of the controller.
        fallback_level: u32 = code(FallbackLevel),
        /// Velocity axes on which the learned model is used: 1 forward, 2 left, 4 yaw, added up.
        learned_axes: u32 = at_most(7),
        /// Time from a command to the wheels that the plan assumes \[µs\].
        delay_micros: u32,
        /// Time from the receipt of the state to the finished command \[ns\].
        tick_nanos: u64,
        /// Part of it for prediction and linearisation, the Gaussian process included \[ns\].
        linearise_nanos: u64,
        /// Part of it for the quadratic program \[ns\].
        solve_nanos: u64,
        /// Disturbance that the observer estimates, per period \[m/s, m/s, rad/s\].
        disturbance: [f64; 3],
        /// One-step error of the whole model in the past period: measured minus predicted velocity
        /// \[m/s, m/s, rad/s\].
        innovation: [f64; 3],
        /// The same error of the main model alone: the residual \[m/s, m/s, rad/s\].
        residual: [f64; 3],
        /// Predicted x, y, yaw, forward, left and yaw velocity, from the measured state on
        /// \[m, m, rad, m/s, m/s, rad/s\].
        predicted: [[f64; 6]; HORIZON_MAX + 1] = rows(horizon + 1),
        /// Reference of the same, velocity in the reference's own heading
        /// \[m, m, rad, m/s, m/s, rad/s\].
        reference: [[f64; 6]; HORIZON_MAX + 1] = rows(horizon + 1),
        /// Variance of the learned residual at each predicted state, per velocity axis
        /// \[(m/s)², (m/s)², (rad/s)²\].
        variance: [[f64; 3]; HORIZON_MAX + 1] = rows(horizon + 1),
        /// Planned inputs \[m/s, m/s, rad/s\].
        input: [[f64; 3]; HORIZON_MAX] = rows(horizon),
    }
}

impl Plan {
    /// Fallback level of the controller.
    pub fn fallback_level(&self) -> FallbackLevel {
        FallbackLevel::try_from(self.fallback_level).unwrap_or(FallbackLevel::LatchedStop)
    }

    /// Result that the optimiser reports.
    pub fn status(&self) -> SolverStatus {
        SolverStatus::try_from(self.status).unwrap_or(SolverStatus::NumericalError)
    }

    /// Distance of the measured position from the reference \[m\].
    pub fn position_error(&self) -> f64 {
        let [state, ..] = &self.predicted;
        let [reference, ..] = &self.reference;
        (state[0] - reference[0]).hypot(state[1] - reference[1])
    }
}
