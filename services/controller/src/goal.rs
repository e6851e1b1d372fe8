//! What the robot is told to do while it drives.
//!
//! ```text
//!  control thread    ── Outlook: reference ahead, measured state ──▶ attendant thread
//!                                                                    request ▶ check ▶ motion
//!                    ◀── Course: reference from now on ──────────────
//! ```
//! A goal becomes a table of reference points, made beside the control thread. It begins with the
//! points of the present reference, for as long as the exchange may take. From there it goes on
//! with their velocity and acceleration. Where the robot is far from its reference, it begins at
//! the robot.

mod clear;
pub mod keeper;
pub mod schedule;

use crate::reference::{Reference, ReferencePoint};
use clear::{Clear, Counted};
use model::delay::DELAY_MAX;
use model::{Pose, Velocity, wrap};
use motion::limits::Stated;
use motion::{
    Heading, Limits, Moment, Motion, MotionError, Path, Waypoint, to_standstill, with_velocity,
};
use process::requests::GOAL_MARK;
use protocol::message::{
    GateState, Goal, GoalKind, GoalPhase, HORIZON_MAX, OBSTACLES_MAX, ObstacleSource,
};
use robot::{Obstacle, Robot, Surroundings};
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;

/// Distance from the reference above which a goal begins at the robot \[m\], and heading \[rad\].
const NEAR: (f64, f64) = (0.2, 0.3);
/// Time that the exchange of the reference may take \[s\].
const EXCHANGE_S: f64 = 0.1;
/// Points of the way ahead: those that the control thread knows.
pub const OUTLOOK_POINTS: usize = DELAY_MAX + HORIZON_MAX + 1;
/// Longest time for which a velocity can be valid \[s\].
pub const VELOCITY_VALID_MAX_S: f64 = 60.0;
/// Longest time within which a goal must begin \[s\].
const BEGINS_WITHIN_MAX_S: f64 = 3600.0;
/// Range of each limit that a request states.
const LIMITS: RangeInclusive<f64> = 1e-3..=1e4;
/// Longest motion \[s\].
const MOTION_MAX_S: f64 = 1e4;

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

    fn check(&self) -> Result<(), GoalError> {
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

/// What the control thread knows of the robot's way.
#[derive(Debug, Clone)]
pub struct Outlook {
    /// Epoch of the plant.
    pub plant_epoch: u64,
    /// Tick of the first point.
    pub tick: u64,
    /// The reference from there on.
    pub points: Vec<ReferencePoint>,
    /// Pose of the robot, one period before.
    pub pose: Pose,
    /// Its velocity in the body.
    pub velocity: Velocity,
    /// State of the gate.
    pub gate: GateState,
    /// Obstacles of the newest lists.
    pub obstacles: Vec<Obstacle>,
    /// Number of the goal that the robot is on the way to.
    pub goal: Option<u64>,
    /// Whether an obstacle holds the robot up.
    pub held_up: bool,
}

impl Outlook {
    /// Without content, with memory for `points` points.
    pub fn with_room(points: usize) -> Self {
        Self {
            plant_epoch: 0,
            tick: 0,
            points: Vec::with_capacity(points),
            pose: [0.0; 3],
            velocity: [0.0; 3],
            gate: GateState::Disarmed,
            obstacles: Vec::with_capacity(ObstacleSource::ALL.len() * OBSTACLES_MAX),
            goal: None,
            held_up: false,
        }
    }
}

/// A reference for a goal.
#[derive(Debug)]
pub struct Course {
    /// The reference from now on.
    pub reference: Reference,
    /// Way that remains at each of its points \[m\].
    pub left_m: Vec<f64>,
    /// Poses of the way, for its review.
    pub way: Vec<Pose>,
    /// The goal.
    pub goal: Goal,
    /// Last tick from which on it can be used: until then it is the reference before, or the robot
    /// has hardly moved.
    pub latest_tick: u64,
}

impl Course {
    /// The way to do `request`, which has the number `id`, from `outlook` on, clear of what `map`
    /// and `outlook` have.
    ///
    /// # Errors
    /// [`GoalError`] if the robot cannot do that.
    pub fn new(
        request: &GoalRequest,
        id: u64,
        outlook: &Outlook,
        robot: &Robot,
        map: &Surroundings,
        period_s: f64,
    ) -> Result<Self, GoalError> {
        Self::around(request, id, outlook, robot, (map, Counted::Standing), period_s)
    }

    /// The same, clear of what `map` has and of what the robot sees and is counted.
    fn around(
        request: &GoalRequest,
        id: u64,
        outlook: &Outlook,
        robot: &Robot,
        (map, counted): (&Surroundings, Counted),
        period_s: f64,
    ) -> Result<Self, GoalError> {
        if matches!(outlook.gate, GateState::Disarmed | GateState::Stopped) {
            return Err(GoalError::Shut { state: outlook.gate });
        }
        let limits = Limits::of(robot).stricter(&request.limits);
        let (mut points, begin) = lead(outlook, period_s);
        // A motion that begins at the robot is behind it by as much when it is taken.
        let taken_within = if points.is_empty() { exchange_ticks(period_s) } else { points.len() };
        let mut course = points.last().map_or(outlook.pose[2], |point| point.course);
        let clear = Clear::of(robot.footprint(), map, &outlook.obstacles, counted);
        for motion in motions(&request.goal, &begin, &limits, &clear)? {
            if motion.duration_s() > MOTION_MAX_S {
                return Err(GoalError::TooLong { duration_s: motion.duration_s() });
            }
            // The last point of a motion is the first one of the next.
            let ticks = (motion.duration_s() / period_s).ceil() as usize;
            points.extend((0..ticks).map(|tick| {
                let moment = motion.at(tick as f64 * period_s);
                point(&moment, &mut course)
            }));
            let end = motion.at(motion.duration_s()).pose;
            points.push(ReferencePoint { pose: end, velocity: [0.0; 3], course });
        }
        let target = points.last().map_or(outlook.pose, |last| last.pose);
        let mut goal: Goal = bytemuck::Zeroable::zeroed();
        (goal.id, goal.plant_epoch, goal.target) = (id, outlook.plant_epoch, target);
        goal.begins_at_tick = outlook.tick;
        goal.ends_at_tick = outlook.tick + points.len().saturating_sub(1) as u64;
        (goal.kind, goal.phase) = (request.goal.kind().code(), GoalPhase::Active.code());
        Ok(Self {
            left_m: way_left(&points),
            way: points.iter().map(|point| point.pose).collect(),
            latest_tick: outlook.tick + taken_within as u64,
            reference: Reference::of_points(points, outlook.tick),
            goal,
        })
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

/// The motions that do it, one after the other, from `begin` on.
fn motions(
    demand: &Demand,
    begin: &Moment,
    limits: &Limits,
    clear: &Clear,
) -> Result<Vec<Motion>, MotionError> {
    Ok(match demand {
        Demand::Hold {} => vec![to_standstill(begin, limits)?],
        Demand::Pose { to } => clear.motions(begin, *to, limits)?,
        Demand::Velocity { velocity, valid_s } => {
            vec![with_velocity(begin, *velocity, *valid_s, limits)?]
        }
        Demand::Path { points, heading } => {
            clear.along(begin, Path { points, heading: *heading }, limits)?
        }
    })
}

/// The points of the present reference during the exchange, and the moment behind them. Without
/// points, and at the robot, if the robot is far from its reference.
fn lead(outlook: &Outlook, period_s: f64) -> (Vec<ReferencePoint>, Moment) {
    let Outlook { pose, velocity, .. } = *outlook;
    let at_robot = || Moment { velocity: in_world(&pose, &velocity), ..Moment::at_rest(pose) };
    let ticks = exchange_ticks(period_s).min(outlook.points.len());
    let (Some(here), Some([before, last])) =
        (outlook.points.first(), outlook.points.get(..ticks).and_then(|lead| lead.last_chunk()))
    else {
        return (Vec::new(), at_robot());
    };
    let error = (here.pose[0] - pose[0]).hypot(here.pose[1] - pose[1]);
    if error > NEAR.0 || wrap(here.pose[2] - pose[2]).abs() > NEAR.1 {
        return (Vec::new(), at_robot());
    }
    let [earlier, now] = [before, last].map(|point| in_world(&point.pose, &point.velocity));
    let begin = Moment {
        pose: last.pose,
        velocity: now,
        acceleration: std::array::from_fn(|axis| (now[axis] - earlier[axis]) / period_s),
    };
    // The last point is the first one of the motion.
    (outlook.points[..ticks - 1].to_vec(), begin)
}

/// Periods that the exchange may take.
fn exchange_ticks(period_s: f64) -> usize {
    (EXCHANGE_S / period_s).ceil() as usize + 2
}

fn in_world(pose: &Pose, [forward, left, rate]: &Velocity) -> Velocity {
    let (sin, cos) = pose[2].sin_cos();
    [cos * forward - sin * left, sin * forward + cos * left, *rate]
}

/// The reference at a moment. At rest it has the course before.
fn point(moment: &Moment, course: &mut f64) -> ReferencePoint {
    let [x, y, _] = moment.velocity;
    if x.hypot(y) > 1e-6 {
        *course = y.atan2(x);
    }
    ReferencePoint { pose: moment.pose, velocity: moment.body_velocity(), course: *course }
}

/// Way from each point to the last one \[m\].
fn way_left(points: &[ReferencePoint]) -> Vec<f64> {
    let mut left = vec![0.0; points.len()];
    for index in (1..points.len()).rev() {
        let [a, b] = [points[index - 1].pose, points[index].pose];
        left[index - 1] = left[index] + (b[0] - a[0]).hypot(b[1] - a[1]);
    }
    left
}

#[cfg(test)]
mod tests;
