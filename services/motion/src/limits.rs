//! What a motion may demand of a robot.

use crate::Moment;
use robot::{AXES, Robot, WHEELS_MAX};
use serde::{Deserialize, Serialize};
use std::f64::consts::{SQRT_2, TAU};

/// Share of the robot's own limits of speed that motions use by default. The rest is left to the
/// controller, which has to correct errors.
const SPEED_SHARE: f64 = 0.7;
/// Share of the deceleration of the gate's braking ramp that motions use by default.
const ACCELERATION_SHARE: f64 = 0.5;
/// Time from no acceleration to the largest one, by default \[s\].
const JERK_TIME_S: f64 = 0.15;
/// Headings at which the largest use of the wheels is looked for.
const HEADINGS: u8 = 32;

/// Largest speeds, accelerations and jerks of motions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Along the ground \[m/s\].
    pub speed_mps: f64,
    /// Of the heading \[rad/s\].
    pub yaw_rate_radps: f64,
    /// Along the ground \[m/s²\].
    pub acceleration_mps2: f64,
    /// Of the heading \[rad/s²\].
    pub yaw_acceleration_radps2: f64,
    /// Along the ground \[m/s³\].
    pub jerk_mps3: f64,
    /// Of the heading \[rad/s³\].
    pub yaw_jerk_radps3: f64,
    /// Rows of the wheels per their largest speed: |row · body velocity| ≤ 1. Rows of no wheel
    /// are 0.
    wheels: [[f64; AXES]; WHEELS_MAX],
}

/// Limits that a person states, in place of those that follow from the robot file.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Stated {
    /// Along the ground \[m/s\].
    pub speed_mps: Option<f64>,
    /// Of the heading \[rad/s\].
    pub yaw_rate_radps: Option<f64>,
    /// Along the ground \[m/s²\].
    pub acceleration_mps2: Option<f64>,
    /// Of the heading \[rad/s²\].
    pub yaw_acceleration_radps2: Option<f64>,
}

impl Limits {
    /// Limits of `robot`: 70 % of its speeds, and half of the deceleration of the gate's braking
    /// ramp, but no more than the inputs may change.
    pub fn of(robot: &Robot) -> Self {
        let limits = &robot.limits;
        let top = robot.wheel_speed_limit_radps();
        let acceleration = ACCELERATION_SHARE * limits.brake_mps2.min(limits.input_rate_mps2);
        let yaw_acceleration =
            ACCELERATION_SHARE * limits.yaw_brake_radps2.min(limits.yaw_input_rate_radps2);
        Self {
            speed_mps: SPEED_SHARE * limits.input_mps,
            yaw_rate_radps: SPEED_SHARE * limits.yaw_input_radps,
            acceleration_mps2: acceleration,
            yaw_acceleration_radps2: yaw_acceleration,
            jerk_mps3: acceleration / JERK_TIME_S,
            yaw_jerk_radps3: yaw_acceleration / JERK_TIME_S,
            wheels: robot.wheels.scaled_rows(|radius| 1.0 / (SPEED_SHARE * radius * top)),
        }
    }

    /// The same, with each limit that is stated and stricter.
    #[must_use]
    pub fn stricter(mut self, stated: &Stated) -> Self {
        let take = |limit: &mut f64, stated: Option<f64>| {
            *limit = stated.map_or(*limit, |stated| limit.min(stated));
        };
        take(&mut self.speed_mps, stated.speed_mps);
        take(&mut self.yaw_rate_radps, stated.yaw_rate_radps);
        take(&mut self.acceleration_mps2, stated.acceleration_mps2);
        take(&mut self.yaw_acceleration_radps2, stated.yaw_acceleration_radps2);
        self
    }

    /// The part of the limits of speed that `moment` uses: above 1 it is too fast.
    pub fn speed_use(&self, moment: &Moment) -> f64 {
        let body = moment.body_velocity();
        let ground = body[0].hypot(body[1]) / self.speed_mps;
        let wheel = |row: &[f64; AXES]| -> f64 {
            row.iter().zip(&body).map(|(a, b)| a * b).sum::<f64>().abs()
        };
        let yaw = body[2].abs() / self.yaw_rate_radps;
        self.wheels.iter().map(wheel).fold(ground.max(yaw), f64::max)
    }

    /// The largest [`speed_use`](Self::speed_use) of this velocity at any heading. A robot that
    /// turns while it brakes has some of them.
    pub(crate) fn speed_use_turned(&self, moment: &Moment) -> f64 {
        let turned = (0..HEADINGS).map(|i| {
            let mut turned = *moment;
            turned.pose[2] = TAU * f64::from(i) / f64::from(HEADINGS);
            self.speed_use(&turned)
        });
        turned.fold(0.0, f64::max)
    }

    /// The largest use of the limits of speed and of acceleration when all axes of the world are at
    /// their own limit at once.
    pub(crate) fn worst_use(&self) -> [f64; 2] {
        let wheel = |row: &[f64; AXES]| {
            SQRT_2 * row[0].hypot(row[1]) * self.speed_mps + row[2].abs() * self.yaw_rate_radps
        };
        [self.wheels.iter().map(wheel).fold(SQRT_2, f64::max), SQRT_2]
    }

    /// The part of the limits of acceleration that `moment` uses: above 1 it is too hard.
    pub fn acceleration_use(&self, moment: &Moment) -> f64 {
        let [x, y, yaw] = moment.acceleration;
        (x.hypot(y) / self.acceleration_mps2).max(yaw.abs() / self.yaw_acceleration_radps2)
    }

    /// The same, with speeds and accelerations that are that many times smaller.
    pub(crate) fn lowered(mut self, speed: f64, acceleration: f64) -> Self {
        self.speed_mps /= speed;
        self.yaw_rate_radps /= speed;
        self.acceleration_mps2 /= acceleration;
        self.yaw_acceleration_radps2 /= acceleration;
        self.jerk_mps3 /= acceleration;
        self.yaw_jerk_radps3 /= acceleration;
        self
    }
}
