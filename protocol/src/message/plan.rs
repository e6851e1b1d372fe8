//! controller → watchers: the planned motion, the model's estimates, and the computing time.

use super::sequence::Bounded;
use super::{FallbackLevel, SolverStatus, Stamp, check_count, fixed_message};
use crate::frame::code;
use bytemuck::{Pod, Zeroable};
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Longest horizon that a plan can carry \[periods\].
pub const HORIZON_MAX: usize = 40;

/// The plan behind one command, sent after it. Rows 0 to `horizon` of the horizon arrays count;
/// `input` has one row fewer.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct Plan {
    /// Writer and time; `tick` is the one that is answered.
    pub stamp: Stamp,
    /// Epoch of the plant.
    pub plant_epoch: u64,
    /// Version of the learned model in use; 0 is the main model alone.
    pub model_version: u64,
    /// Length of the horizon \[periods\].
    pub horizon: u32,
    /// [`SolverStatus`] of the last quadratic program.
    pub status: u32,
    /// Iterations of its solver.
    pub iterations: u32,
    /// [`FallbackLevel`] of the controller.
    pub fallback_level: u32,
    /// Velocity axes on which the learned model is used: 1 forward, 2 left, 4 yaw, added up.
    pub learned_axes: u32,
    /// Time from a command to the wheels that the plan assumes \[µs\].
    pub delay_micros: u32,
    /// Time from the receipt of the state to the finished command \[ns\].
    pub tick_nanos: u64,
    /// Part of it for prediction and linearisation, the Gaussian process included \[ns\].
    pub linearise_nanos: u64,
    /// Part of it for the quadratic program \[ns\].
    pub solve_nanos: u64,
    /// Disturbance that the observer estimates, per period \[m/s, m/s, rad/s\].
    pub disturbance: [f64; 3],
    /// One-step error of the whole model in the past period: measured minus predicted velocity
    /// \[m/s, m/s, rad/s\].
    pub innovation: [f64; 3],
    /// The same error of the main model alone: the residual \[m/s, m/s, rad/s\].
    pub residual: [f64; 3],
    /// Predicted x, y, yaw, forward, left and yaw velocity, from the measured state on
    /// \[m, rad, m/s, rad/s\].
    pub predicted: [[f64; 6]; HORIZON_MAX + 1],
    /// Reference of the same, velocity in the reference's own heading.
    pub reference: [[f64; 6]; HORIZON_MAX + 1],
    /// Variance of the learned residual at each predicted state, per velocity axis
    /// \[(m/s)², (m/s)², (rad/s)²\].
    pub variance: [[f64; 3]; HORIZON_MAX + 1],
    /// Planned inputs \[m/s, m/s, rad/s\].
    pub input: [[f64; 3]; HORIZON_MAX],
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

fixed_message!(
    Plan,
    6,
    [disturbance, innovation, residual, predicted, reference, variance, input],
    |plan| {
        check_count("Plan", "horizon", plan.horizon, HORIZON_MAX)?;
        code::<SolverStatus>("Plan", "status", plan.status)?;
        code::<FallbackLevel>("Plan", "fallback_level", plan.fallback_level)?;
        check_count("Plan", "learned_axes", plan.learned_axes, 7)
    }
);

/// The serialised part of a plan: only the rows that count. Their number gives the length of the
/// horizon.
#[derive(Serialize)]
#[serde(rename = "Plan")]
struct Said<'a> {
    stamp: Stamp,
    plant_epoch: u64,
    model_version: u64,
    status: u32,
    iterations: u32,
    fallback_level: u32,
    learned_axes: u32,
    delay_micros: u32,
    tick_nanos: u64,
    linearise_nanos: u64,
    solve_nanos: u64,
    disturbance: [f64; 3],
    innovation: [f64; 3],
    residual: [f64; 3],
    predicted: &'a [[f64; 6]],
    reference: &'a [[f64; 6]],
    variance: &'a [[f64; 3]],
    input: &'a [[f64; 3]],
}

#[derive(Deserialize)]
#[serde(rename = "Plan")]
struct Heard {
    stamp: Stamp,
    plant_epoch: u64,
    model_version: u64,
    status: u32,
    iterations: u32,
    fallback_level: u32,
    learned_axes: u32,
    delay_micros: u32,
    tick_nanos: u64,
    linearise_nanos: u64,
    solve_nanos: u64,
    disturbance: [f64; 3],
    innovation: [f64; 3],
    residual: [f64; 3],
    predicted: Bounded<[f64; 6], { HORIZON_MAX + 1 }>,
    reference: Bounded<[f64; 6], { HORIZON_MAX + 1 }>,
    variance: Bounded<[f64; 3], { HORIZON_MAX + 1 }>,
    input: Bounded<[f64; 3], HORIZON_MAX>,
}

/// The first `count` rows; all of them if there are fewer.
fn first<T>(rows: &[T], count: usize) -> &[T] {
    rows.get(..count).unwrap_or(rows)
}

impl Serialize for Plan {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let horizon = self.horizon as usize;
        let serialised = Said {
            stamp: self.stamp,
            plant_epoch: self.plant_epoch,
            model_version: self.model_version,
            status: self.status,
            iterations: self.iterations,
            fallback_level: self.fallback_level,
            learned_axes: self.learned_axes,
            delay_micros: self.delay_micros,
            tick_nanos: self.tick_nanos,
            linearise_nanos: self.linearise_nanos,
            solve_nanos: self.solve_nanos,
            disturbance: self.disturbance,
            innovation: self.innovation,
            residual: self.residual,
            predicted: first(&self.predicted, horizon + 1),
            reference: first(&self.reference, horizon + 1),
            variance: first(&self.variance, horizon + 1),
            input: first(&self.input, horizon),
        };
        serialised.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Plan {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let received = Heard::deserialize(deserializer)?;
        let horizon = received.input.len;
        if [received.predicted.len, received.reference.len, received.variance.len]
            != [horizon + 1; 3]
        {
            return Err(D::Error::custom("its rows do not belong to one horizon"));
        }
        Ok(Self {
            horizon: horizon as u32,
            stamp: received.stamp,
            plant_epoch: received.plant_epoch,
            model_version: received.model_version,
            status: received.status,
            iterations: received.iterations,
            fallback_level: received.fallback_level,
            learned_axes: received.learned_axes,
            delay_micros: received.delay_micros,
            tick_nanos: received.tick_nanos,
            linearise_nanos: received.linearise_nanos,
            solve_nanos: received.solve_nanos,
            disturbance: received.disturbance,
            innovation: received.innovation,
            residual: received.residual,
            predicted: received.predicted.items,
            reference: received.reference.items,
            variance: received.variance.items,
            input: received.input.items,
        })
    }
}
