//! plant → controller: what the sensors saw, and what the gate did.

use super::{Reason, Rung, Stamp, fixed_message};
use crate::frame::code;
use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};

/// Measured state, published once per control period, at its start. Its `stamp.epoch` is the plant's.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, Serialize, Deserialize)]
pub struct PlantState {
    /// Who measured, and when.
    pub stamp: Stamp,
    /// Pose in the world (x, y, yaw) \[m, m, rad\]; yaw is not wrapped.
    pub pose: [f64; 3],
    /// Body velocity (forward, left, yaw) \[m/s, m/s, rad/s\].
    pub velocity: [f64; 3],
    /// Wheel speeds, front-right, front-left, rear-left, rear-right \[rad/s\].
    pub wheel_speed: [f64; 4],
    /// Motor currents, in the order of the wheels \[A\].
    pub current: [f64; 4],
    /// Body velocity that the gate gave the wheels, mean over the past period \[m/s, m/s, rad/s\].
    pub input: [f64; 3],
    /// Highest controller epoch that the gate has seen.
    pub controller_epoch: u64,
    /// Epoch of the last command that the gate accepted; 0 before the first.
    pub accepted_epoch: u64,
    /// Tick that the last accepted command answered.
    pub accepted_tick: u64,
    /// Commands that the gate has refused so far.
    pub refused: u64,
    /// [`Rung`] of the past period.
    pub rung: u32,
    /// [`Reason`] of that rung, or of the last refusal in the past period.
    pub reason: u32,
}

impl PlantState {
    /// Rung of the past period.
    pub fn rung(&self) -> Rung {
        Rung::try_from(self.rung).unwrap_or(Rung::LatchedStop)
    }

    /// Why the past period was on its rung.
    pub fn reason(&self) -> Reason {
        Reason::try_from(self.reason).unwrap_or(Reason::Malformed)
    }
}

fixed_message!(PlantState, 1, [pose, velocity, wheel_speed, current, input], |state| {
    code::<Rung>("PlantState", "rung", state.rung)?;
    code::<Reason>("PlantState", "reason", state.reason)
});
