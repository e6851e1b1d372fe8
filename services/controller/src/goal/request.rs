//! A request: what the robot shall do, and what is wrong with a request that it cannot do.

use super::MOTION_MAX_S;
use model::Velocity;
use motion::limits::Stated;
use motion::{Heading, MotionError, Waypoint};
use process::requests::GOAL_MARK;
use protocol::message::{GateState, GoalKind};
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;

/// Longest time for which a velocity can be valid \[s\].
pub const VELOCITY_VALID_MAX_S: f64 = 60.0;
/// Longest time within which a goal must begin \[s\].
const BEGINS_WITHIN_MAX_S: f64 = 3600.0;
/// Range of each limit that a request states.
const LIMITS: RangeInclusive<f64> = 1e-3..=1e4;

/// What the robot shall do.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Demand {
    /// Stand still, as soon as its limits allow.
    Hold {},
    /// Drive to a pose.
    Pose {
        /// x, y, yaw in the world \[m, m, rad\].
        to: [f64; 3],
    },
    /// Drive along a path.
    Path {
        /// The points.
        points: Vec<Waypoint>,
        /// Heading on the way.
        #[serde(default)]
        heading: Heading,
    },
    /// Drive with a body velocity, then stand still.
    Velocity {
        /// Forward, left, yaw \[m/s, m/s, rad/s\].
        velocity: Velocity,
        /// Time for which it is valid \[s\].
        valid_s: f64,
    },
}

/// A goal as an operator's request has it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GoalRequest {
    /// What the robot shall do.
    pub goal: Demand,
    /// Stricter limits for it.
    #[serde(default)]
    pub limits: Stated,
    /// Time after the request within which it must begin \[s\]; `None` is no limit. A velocity has
    /// a time of its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub valid_s: Option<f64>,
}

/// Why a goal is rejected.
#[derive(Debug, thiserror::Error)]
pub enum GoalError {
    /// It cannot be parsed.
    #[error("not a goal: {reason}")]
    Syntax {
        /// Message of the parser.
        reason: String,
    },
    /// A limit that no robot can have.
    #[error(
        "limits.{key} = {value}: expected a number from {} to {}",
        LIMITS.start(),
        LIMITS.end()
    )]
    Limit {
        /// The limit.
        key: &'static str,
        /// Its value.
        value: f64,
    },
    /// The velocity is valid for too long, or for no time.
    #[error(
        "goal.velocity.valid_s = {valid_s}: expected more than 0, at most {VELOCITY_VALID_MAX_S} s"
    )]
    Validity {
        /// Its value.
        valid_s: f64,
    },
    /// The time within which it must begin is none.
    #[error("valid_s = {valid_s}: expected more than 0, at most {BEGINS_WITHIN_MAX_S} s")]
    BeginsWithin {
        /// Its value.
        valid_s: f64,
    },
    /// It was requested so long ago that it may no longer begin.
    #[error("the goal has ended: it was requested {age_s:.1} s ago, for {valid_s} s")]
    Ended {
        /// Time since the request \[s\].
        age_s: f64,
        /// Time for which it was to be valid \[s\].
        valid_s: f64,
    },
    /// A later request has been followed already.
    #[error("the goal is out of date: it was requested {by_s:.3} s before the present one")]
    OutOfDate {
        /// Time between both requests \[s\].
        by_s: f64,
    },
    /// It is given at no time.
    #[error("at_s = {at_s}: expected a finite number of seconds, 0 or more")]
    Schedule {
        /// Its value.
        at_s: f64,
    },
    /// The wheels are not driven.
    #[error("the gate is {state}: expected a robot that drives; see `coxswain arm` and `resume`")]
    Shut {
        /// State of the gate.
        state: GateState,
    },
    /// There is no motion to it.
    #[error(transparent)]
    Motion(#[from] MotionError),
    /// The motion takes too long.
    #[error("the motion takes {duration_s:.0} s: expected at most {MOTION_MAX_S} s")]
    TooLong {
        /// Its length \[s\].
        duration_s: f64,
    },
}

impl GoalError {
    /// Its kind, for programs.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Syntax { .. } => "syntax",
            Self::Limit { .. } => "limit",
            Self::Validity { .. } | Self::BeginsWithin { .. } => "validity",
            Self::Ended { .. } => "ended",
            Self::OutOfDate { .. } => "out-of-date",
            Self::Schedule { .. } => "schedule",
            Self::Shut { .. } => "gate",
            Self::Motion(error) => error.code(),
            Self::TooLong { .. } => "motion-too-long",
        }
    }
}

impl GoalRequest {
    /// A request for `goal` with the limits of the robot, whenever it arrives.
    pub fn of(goal: Demand) -> Self {
        Self { goal, limits: Stated::default(), valid_s: None }
    }

    /// Parses the text of a request.
    ///
    /// # Errors
    /// [`GoalError`] if it is no goal.
    pub fn parse(text: &str) -> Result<Self, GoalError> {
        let request: Self = toml::from_str(text)
            .map_err(|error| GoalError::Syntax { reason: error.message().to_owned() })?;
        request.check()?;
        Ok(request)
    }

    /// The text of the request.
    pub fn text(&self) -> String {
        // The first line marks a goal.
        let table = toml::Table::try_from(self).unwrap_or_default();
        format!("{GOAL_MARK}\n{table}")
    }

    /// Checks that the goal can still begin, `age_s` seconds after its request. One that had to
    /// wait longer than it is valid, for example for a restarted controller, moves no robot.
    ///
    /// # Errors
    /// [`GoalError::Ended`].
    pub fn check_age(&self, age_s: f64) -> Result<(), GoalError> {
        let own = match self.goal {
            Demand::Velocity { valid_s, .. } => Some(valid_s),
            _ => None,
        };
        match own.into_iter().chain(self.valid_s).find(|&valid_s| age_s > valid_s) {
            Some(valid_s) => Err(GoalError::Ended { age_s, valid_s }),
            None => Ok(()),
        }
    }

    pub(super) fn check(&self) -> Result<(), GoalError> {
        let limits = &self.limits;
        for (key, value) in [
            ("speed_mps", limits.speed_mps),
            ("yaw_rate_radps", limits.yaw_rate_radps),
            ("acceleration_mps2", limits.acceleration_mps2),
            ("yaw_acceleration_radps2", limits.yaw_acceleration_radps2),
        ] {
            if let Some(value) = value.filter(|value| !LIMITS.contains(value)) {
                return Err(GoalError::Limit { key, value });
            }
        }
        if let Some(valid_s) = self.valid_s
            && !(valid_s > 0.0 && valid_s <= BEGINS_WITHIN_MAX_S)
        {
            return Err(GoalError::BeginsWithin { valid_s });
        }
        match self.goal {
            Demand::Velocity { valid_s, .. }
                if !(valid_s > 0.0 && valid_s <= VELOCITY_VALID_MAX_S) =>
            {
                Err(GoalError::Validity { valid_s })
            }
            _ => Ok(()),
        }
    }
}

impl Demand {
    /// Its kind.
    pub fn kind(&self) -> GoalKind {
        match self {
            Self::Hold {} => GoalKind::Hold,
            Self::Pose { .. } => GoalKind::Pose,
            Self::Path { .. } => GoalKind::Path,
            Self::Velocity { .. } => GoalKind::Velocity,
        }
    }
}
