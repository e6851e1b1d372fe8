//! plant-sim → recorder only: the true state. No controller may read it.

use super::define::message;
use super::{FallbackLevel, Reason, WHEELS_MAX};

message! {
    /// True state at the start of a period, and what acted in the period before it.
    Truth = 5 {
        /// True pose in the world (x, y, yaw) \[m, m, rad\].
        pose: [f64; 3],
        /// True body velocity \[m/s, m/s, rad/s\].
        velocity: [f64; 3],
        /// Force and torque that the world exerts beside the wheels, body frame \[N, N, N m\].
        force: [f64; 3],
        /// Wheel speeds that the motors are commanded at this moment \[rad/s\].
        wheel_command: [f64; WHEELS_MAX] = leading(wheels),
        /// Largest magnitude of each wheel's command in the past period; NaN if one was not finite
        /// \[rad/s\].
        wheel_peak: [f64; WHEELS_MAX] = leading(wheels),
        /// Epoch of the controller whose command makes `wheel_command`; 0 if none does.
        acting_epoch: u64,
        /// Writer of that command.
        acting_writer: u64,
        /// Tick that it answered.
        acting_tick: u64,
        /// Greatest age of an answered state whose command acted in the past period; 0 if none
        /// acted \[ns\].
        acting_age_nanos: u64,
        /// How often, in the past period, a command of another controller (epoch or writer)
        /// replaced the acting one. No command acts on the brake.
        takeovers: u32,
        /// How many of those replacements went to a smaller epoch.
        takeovers_back: u32,
        /// [`FallbackLevel`] of the past period.
        fallback_level: u32 = code(FallbackLevel),
        /// [`Reason`] of that fallback level.
        reason: u32 = code(Reason),
        /// Wheels of the robot.
        wheels: u32 = at_most(WHEELS_MAX),
        /// Zero.
        reserved: u32 = unused,
    }
}
