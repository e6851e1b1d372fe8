//! The limits of a robot's inputs, as rows that are multiplied by inputs and velocities.

use model::Velocity;
use robot::{Robot, WHEELS_MAX};
use std::fmt::{self, Display, Formatter};

/// Limits of the inputs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InputLimits {
    /// Rows that are multiplied by u, each at most 1 either way: J/(r `ω_max`).
    pub wheel: [Velocity; WHEELS_MAX],
    /// Rows that are multiplied by u − v, each at most 1 either way: `k_p` J/(r `i_max`), if the
    /// currents are limited.
    pub current: Option<[Velocity; WHEELS_MAX]>,
    /// Number of wheels; the rows of the others are 0.
    pub wheels: usize,
    /// `u_max` \[m/s, m/s, rad/s\].
    pub input: Velocity,
    /// Largest change in one period, if there is one \[m/s, m/s, rad/s\].
    pub change: Option<Velocity>,
}

impl InputLimits {
    /// The limits of `robot` for a period of `period` \[s\].
    pub fn of(robot: &Robot, period: f64) -> Self {
        let limits = &robot.limits;
        let top_speed = robot.wheel_speed_limit_radps();
        Self {
            wheel: robot.wheels.scaled_rows(|radius| 1.0 / (radius * top_speed)),
            current: robot.drive.map(|drive| {
                robot.wheels.scaled_rows(|radius| {
                    drive.speed_loop_gain_a_s_per_rad / (radius * drive.current_limit_a)
                })
            }),
            wheels: robot.wheels.count(),
            input: [limits.input_mps, limits.input_mps, limits.yaw_input_radps],
            change: Some(
                [limits.input_rate_mps2, limits.input_rate_mps2, limits.yaw_input_rate_radps2]
                    .map(|rate| rate * period),
            ),
        }
    }
}

/// A limit of the robot that a plan can reach.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RobotLimit {
    /// Current of a motor.
    MotorCurrent,
    /// Speed of a wheel.
    WheelSpeed,
    /// Commanded velocity on an axis.
    Input,
}

impl Display for RobotLimit {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::MotorCurrent => "the motor currents",
            Self::WheelSpeed => "the wheel speeds",
            Self::Input => "the commanded velocity",
        })
    }
}
