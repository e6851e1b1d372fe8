//! plant → controller: what the sensors measured, and what the gate did.

use super::define::message;
use super::kinds::first;
use super::{FallbackLevel, GateState, Reason};

/// Most wheels that a robot can have.
pub const WHEELS_MAX: usize = 8;

message! {
    /// Measured state, published once per control period, at its start. Its `stamp.epoch` is the
    /// plant's.
    PlantState = 1 {
        /// Pose in the world (x, y, yaw) \[m, m, rad\]; yaw is not wrapped.
        pose: [f64; 3],
        /// Body velocity (forward, left, yaw) \[m/s, m/s, rad/s\].
        velocity: [f64; 3],
        /// Wheel speeds, in the order of the robot file, of which the first `wheels` count
        /// \[rad/s\].
        wheel_speed: [f64; WHEELS_MAX] = leading(wheels if wheel_speed_valid),
        /// Motor currents, in the order of the wheels \[A\].
        current: [f64; WHEELS_MAX] = leading(wheels if current_valid),
        /// Output of the gate, mean over the past period \[m/s, m/s, rad/s\].
        input: [f64; 3],
        /// Dead time from the gate's output to the motors, as far as the driver knows it; 0 if it
        /// knows of none \[s\].
        input_delay_s: f64,
        /// Highest controller epoch that the gate has seen.
        controller_epoch: u64,
        /// Epoch of the last command that the gate accepted; 0 before the first.
        accepted_epoch: u64,
        /// Tick that the last accepted command answered.
        accepted_tick: u64,
        /// Commands that the gate has refused so far.
        refused: u64,
        /// [`FallbackLevel`] of the past period.
        fallback_level: u32 = code(FallbackLevel),
        /// [`Reason`] of that fallback level, or of the last refusal in the past period.
        reason: u32 = code(Reason),
        /// Wheels of the robot; 0 for a base without any that it knows.
        wheels: u32 = at_most(WHEELS_MAX),
        /// 1 if `wheel_speed` is measured, else 0.
        wheel_speed_valid: u32 = flag,
        /// 1 if `current` is measured, else 0: 0 A is a measurement.
        current_valid: u32 = flag,
        /// 1 while the robot's own emergency stop is pressed, else 0.
        estop: u32 = flag,
        /// [`GateState`] at the end of the past period.
        gate: u32 = code(GateState),
        /// [`Reason`] of the stop while the gate is stopped, else none.
        stop: u32 = code(Reason),
    }
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
        first(values, if valid == 1 { self.wheels as usize } else { 0 })
    }
}
