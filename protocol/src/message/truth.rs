//! plant-sim → recorder only: the true state. No controller may read it.

use super::{FallbackLevel, Reason, Stamp, fixed_message};
use crate::frame::code;
use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};

/// True state at the start of a period, and what acted in the period before it.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable, Serialize, Deserialize)]
pub struct Truth {
    /// Writer and time.
    pub stamp: Stamp,
    /// True pose in the world (x, y, yaw) \[m, m, rad\].
    pub pose: [f64; 3],
    /// True body velocity \[m/s, m/s, rad/s\].
    pub velocity: [f64; 3],
    /// Force and torque that the world exerts beside the wheels, body frame \[N, N, N m\].
    pub force: [f64; 3],
    /// Wheel speeds that the motors are commanded at this moment \[rad/s\].
    pub wheel_command: [f64; 4],
    /// Largest magnitude of each wheel's command in the past period; NaN if one was not finite
    /// \[rad/s\].
    pub wheel_peak: [f64; 4],
    /// Epoch of the controller whose command makes `wheel_command`; 0 if none does.
    pub acting_epoch: u64,
    /// Writer of that command.
    pub acting_writer: u64,
    /// Tick that it answered.
    pub acting_tick: u64,
    /// Greatest age of an answered state whose command acted in the past period; 0 if none acted
    /// \[ns\].
    pub acting_age_nanos: u64,
    /// How often, in the past period, a command of another controller (epoch or writer) replaced
    /// the acting one. No command acts on the brake.
    pub takeovers: u32,
    /// How many of those replacements went to a smaller epoch.
    pub takeovers_back: u32,
    /// [`FallbackLevel`] of the past period.
    pub fallback_level: u32,
    /// [`Reason`] of that fallback level.
    pub reason: u32,
}

fixed_message!(Truth, 5, [pose, velocity, force, wheel_command, wheel_peak], |truth| {
    code::<FallbackLevel>("Truth", "fallback_level", truth.fallback_level)?;
    code::<Reason>("Truth", "reason", truth.reason)
});
