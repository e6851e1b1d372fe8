//! plant → controller: what the sensors measured, and what the gate did.

use super::{FallbackLevel, GateState, Reason, Stamp, check_count, fixed_message};
use crate::frame::code;
use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};

/// Most wheels that a robot can have.
pub const WHEELS_MAX: usize = 8;

/// Measured state, published once per control period, at its start. Its `stamp.epoch` is the
/// plant's.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, Serialize, Deserialize)]
pub struct PlantState {
    /// Writer and time.
    pub stamp: Stamp,
    /// Pose in the world (x, y, yaw) \[m, m, rad\]; yaw is not wrapped.
    pub pose: [f64; 3],
    /// Body velocity (forward, left, yaw) \[m/s, m/s, rad/s\].
    pub velocity: [f64; 3],
    /// Wheel speeds, in the order of the robot file, of which the first `wheels` count \[rad/s\].
    pub wheel_speed: [f64; WHEELS_MAX],
    /// Motor currents, in the order of the wheels \[A\].
    pub current: [f64; WHEELS_MAX],
    /// Output of the gate, mean over the past period \[m/s, m/s, rad/s\].
    pub input: [f64; 3],
    /// Dead time from the gate's output to the motors, as far as the driver knows it; 0 if it knows
    /// of none \[s\].
    pub input_delay_s: f64,
    /// Highest controller epoch that the gate has seen.
    pub controller_epoch: u64,
    /// Epoch of the last command that the gate accepted; 0 before the first.
    pub accepted_epoch: u64,
    /// Tick that the last accepted command answered.
    pub accepted_tick: u64,
    /// Commands that the gate has refused so far.
    pub refused: u64,
    /// [`FallbackLevel`] of the past period.
    pub fallback_level: u32,
    /// [`Reason`] of that fallback level, or of the last refusal in the past period.
    pub reason: u32,
    /// Wheels of the robot; 0 for a base without any that it knows.
    pub wheels: u32,
    /// 1 if `wheel_speed` is measured, else 0.
    pub wheel_speed_valid: u32,
    /// 1 if `current` is measured, else 0: 0 A is a measurement.
    pub current_valid: u32,
    /// 1 while the robot's own emergency stop is pressed, else 0.
    pub estop: u32,
    /// [`GateState`] at the end of the past period.
    pub gate: u32,
    /// [`Reason`] of the stop while the gate is stopped, else none.
    pub stop: u32,
}

impl PlantState {
    /// Fallback level of the past period.
    pub fn fallback_level(&self) -> FallbackLevel {
        FallbackLevel::try_from(self.fallback_level).unwrap_or(FallbackLevel::LatchedStop)
    }

    /// Why the past period was on its fallback level.
    pub fn reason(&self) -> Reason {
        Reason::try_from(self.reason).unwrap_or(Reason::Malformed)
    }

    /// State of the gate.
    pub fn gate(&self) -> GateState {
        GateState::try_from(self.gate).unwrap_or(GateState::Stopped)
    }

    /// Why the gate has stopped; [`Reason::None`] if it has not.
    pub fn stop(&self) -> Reason {
        Reason::try_from(self.stop).unwrap_or(Reason::Malformed)
    }

    /// Reason to show to a person: why the gate has stopped, else why the past period was on its
    /// fallback level.
    pub fn cause(&self) -> Reason {
        if self.stop == Reason::None.code() { self.reason() } else { self.stop() }
    }

    /// Measured wheel speeds; empty if there are none \[rad/s\].
    pub fn wheel_speed(&self) -> &[f64] {
        self.measured(&self.wheel_speed, self.wheel_speed_valid)
    }

    /// Measured motor currents; empty if there are none \[A\].
    pub fn current(&self) -> &[f64] {
        self.measured(&self.current, self.current_valid)
    }

    fn measured<'a>(&self, values: &'a [f64; WHEELS_MAX], valid: u32) -> &'a [f64] {
        let count = if valid == 1 { self.wheels as usize } else { 0 };
        values.get(..count).unwrap_or(values)
    }
}

fixed_message!(
    PlantState,
    1,
    [pose, velocity, wheel_speed, current, input, input_delay_s],
    |state| {
        code::<FallbackLevel>("PlantState", "fallback_level", state.fallback_level)?;
        code::<Reason>("PlantState", "reason", state.reason)?;
        check_count("PlantState", "wheels", state.wheels, WHEELS_MAX)?;
        check_count("PlantState", "wheel_speed_valid", state.wheel_speed_valid, 1)?;
        check_count("PlantState", "current_valid", state.current_valid, 1)?;
        check_count("PlantState", "estop", state.estop, 1)?;
        code::<GateState>("PlantState", "gate", state.gate)?;
        code::<Reason>("PlantState", "stop", state.stop)
    }
);
