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
    /// J \[–, –, m\].
    pub rim: [Velocity; WHEELS_MAX],
    /// A change of the rim speeds that keeps to `change` on each axis \[m/s\].
    pub rim_change: f64,
}

impl InputLimits {
    /// The limits of `robot` for a period of `period` \[s\].
    pub fn of(robot: &Robot, period: f64) -> Self {
        let limits = &robot.limits;
        let change = [limits.input_rate_mps2, limits.input_rate_mps2, limits.yaw_input_rate_radps2]
            .map(|rate| rate * period);
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
            change: Some(change),
            rim: robot.wheels.scaled_rows(|_| 1.0),
            rim_change: (0..3)
                .map(|axis| change[axis] / robot.wheels.largest_body(axis))
                .fold(f64::INFINITY, f64::min),
        }
    }

    /// Rows that are multiplied by a change of u, each at most 1 either way: per axis, or per wheel
    /// if the drive changes the rim speeds by no more than `ramp` in a period \[m/s\].
    pub(super) fn changes(&self, ramp: Option<f64>) -> [Velocity; WHEELS_MAX] {
        let mut rows = [[0.0; 3]; WHEELS_MAX];
        match (ramp, self.change) {
            (Some(ramp), _) => {
                let most = ramp.min(self.rim_change);
                rows = self.rim.map(|row| row.map(|value| value / most));
            }
            (None, Some(change)) => {
                for (axis, row) in rows.iter_mut().take(3).enumerate() {
                    row[axis] = 1.0 / change[axis];
                }
            }
            (None, None) => {}
        }
        rows
    }
}

/// A limit of the robot that a plan can reach.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RobotLimit {
    /// Current of a motor.
    MotorCurrent,
    /// Grip of the floor.
    Grip,
    /// Change of a wheel's set point, of a drive that ramps its command.
    Ramp,
    /// Speed of a wheel.
    WheelSpeed,
    /// Commanded velocity on an axis.
    Input,
}

impl Display for RobotLimit {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::MotorCurrent => "the motor currents",
            Self::Grip => "the grip of the floor",
            Self::Ramp => "the ramp of the drive",
            Self::WheelSpeed => "the wheel speeds",
            Self::Input => "the commanded velocity",
        })
    }
}
