//! Goals as motions over time, within what a robot can do.
//!
//! | module     | what it does                                                            |
//! |------------|-------------------------------------------------------------------------|
//! | [`limits`] | largest speeds, accelerations and jerks, and how far a motion uses them |
//! | `profile`  | to a pose, to a velocity, to a standstill: jerk-limited (Ruckig)        |
//! | `curve`    | points → a smooth curve with headings                                   |
//! | `timing`   | a curve → the fastest motion along it within the limits                 |
//! | `time_law` | place along a curve at each time, averaged: limited jerk                |
//! | `entry`    | the present motion → a curve that joins a path                          |
//! | `join`     | the present motion → a path, without a stop                             |
//! | `route`    | obstacles → a way around them, as points (A*)                           |
//!
//! Poses are in the world (x, y, yaw) \[m, m, rad\], yaw is not wrapped. Velocities and
//! accelerations of a [`Moment`] are those of the pose, in the world as well.
//!
//! ```
//! use motion::{Limits, Moment, to_pose};
//!
//! let limits = Limits::of(&robot::Robot::example());
//! let motion = to_pose(&Moment::at_rest([0.0; 3]), [2.0, 1.0, 1.57], &limits)?;
//! let end = motion.at(motion.duration_s());
//! assert!((end.pose[0] - 2.0).abs() < 1e-9 && end.velocity.iter().all(|v| v.abs() < 1e-9));
//! # Ok::<(), motion::MotionError>(())
//! ```

mod curve;
mod entry;
mod join;
pub mod limits;
mod profile;
mod route;
mod time_law;
mod timing;

pub use curve::{Heading, Path, Waypoint};
pub use join::along_in_motion;
pub use limits::Limits;
pub use profile::{to_pose, to_standstill, with_velocity};
pub use route::{Ground, route};
pub use timing::along;

use robot::AXES;

/// Most points of one path.
pub const POINTS_MAX: usize = 10_000;
/// Longest path \[m\].
pub const PATH_LENGTH_MAX_M: f64 = 2_000.0;
/// Shortest path \[m\].
pub const PATH_LENGTH_MIN_M: f64 = 1e-3;
/// Largest distance from the world's origin \[m\], and largest yaw \[rad\].
pub const PLACE_MAX: f64 = 1e6;

/// Pose with its derivatives at one time, all in the world.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Moment {
    /// x, y, yaw \[m, m, rad\].
    pub pose: [f64; AXES],
    /// Their rates \[m/s, m/s, rad/s\].
    pub velocity: [f64; AXES],
    /// Rates of the velocity \[m/s², m/s², rad/s²\].
    pub acceleration: [f64; AXES],
}

impl Moment {
    /// Standing at `pose`.
    pub const fn at_rest(pose: [f64; AXES]) -> Self {
        Self { pose, velocity: [0.0; AXES], acceleration: [0.0; AXES] }
    }

    /// Velocity in the body (forward, left, yaw) \[m/s, m/s, rad/s\].
    pub fn body_velocity(&self) -> robot::Velocity {
        let ([x, y, rate], (sin, cos)) = (self.velocity, self.pose[2].sin_cos());
        [cos * x + sin * y, cos * y - sin * x, rate]
    }

    fn is_finite(&self) -> bool {
        let all = [self.pose, self.velocity, self.acceleration];
        all.iter().flatten().all(|value| value.abs() <= PLACE_MAX)
    }
}

/// A motion that ends.
#[derive(Debug, Clone)]
pub struct Motion {
    course: Course,
    duration_s: f64,
}

#[derive(Debug, Clone)]
enum Course {
    Profile(Box<profile::Profile>),
    Body(profile::BodyMotion),
    Path(Box<timing::TimedCurve>),
}

impl Motion {
    /// Length of the motion \[s\].
    pub fn duration_s(&self) -> f64 {
        self.duration_s
    }

    /// The moment at `time_s` after its begin \[s\]; after its end, its last pose at rest.
    pub fn at(&self, time_s: f64) -> Moment {
        let time = time_s.clamp(0.0, self.duration_s);
        let moment = match &self.course {
            Course::Profile(profile) => profile.at(time),
            Course::Body(motion) => motion.at(time),
            Course::Path(timed) => timed.at(time),
        };
        if time_s > self.duration_s { Moment::at_rest(moment.pose) } else { moment }
    }
}

/// A goal that no motion reaches.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MotionError {
    /// A number is not finite, or too large.
    #[error("{what}: expected finite numbers of at most {PLACE_MAX}, either way")]
    NotFinite {
        /// Part of the goal.
        what: String,
    },
    /// No robot gets to a point at this speed.
    #[error("point {point}: speed_mps = {speed_mps}: expected more than 0")]
    Speed {
        /// Number of the point, from 1.
        point: usize,
        /// Its speed \[m/s\].
        speed_mps: f64,
    },
    /// Too few or too many points.
    #[error("{points} points: expected 1 to {POINTS_MAX}")]
    Points {
        /// Their number.
        points: usize,
    },
    /// The path is too long.
    #[error("the path is {length_m:.0} m long: expected at most {PATH_LENGTH_MAX_M} m")]
    TooLong {
        /// Its length \[m\].
        length_m: f64,
    },
    /// The path has no length.
    #[error("the path is {length_m} m long: expected at least {PATH_LENGTH_MIN_M} m")]
    TooShort {
        /// Its length \[m\].
        length_m: f64,
    },
    /// The path begins elsewhere.
    #[error(
        "the path begins {distance_m:.2} m from the robot: expected at most {most_m} m; go to its \
         first point before"
    )]
    StartsElsewhere {
        /// Distance of its first point from the robot \[m\].
        distance_m: f64,
        /// Largest distance \[m\].
        most_m: f64,
    },
    /// The robot cannot stand at the goal.
    #[error(
        "the goal is {room_m:.2} m from an obstacle or from the border: expected at least \
         {needed_m:.2} m"
    )]
    GoalBlocked {
        /// Distance to it \[m\].
        room_m: f64,
        /// Smallest distance that the robot needs \[m\].
        needed_m: f64,
    },
    /// Obstacles are all around the robot or the goal.
    #[error("no way leads around the obstacles to the goal")]
    NoWay,
    /// No motion within the limits was found.
    #[error("no motion within the limits was found: {reason}")]
    NotFound {
        /// Cause.
        reason: String,
    },
}

impl MotionError {
    /// Its kind, for programs.
    pub fn code(&self) -> &'static str {
        match self {
            Self::NotFinite { .. } => "not-finite",
            Self::Speed { .. } => "limit",
            Self::Points { .. } => "points",
            Self::TooLong { .. } => "path-too-long",
            Self::TooShort { .. } => "path-too-short",
            Self::StartsElsewhere { .. } => "path-starts-elsewhere",
            Self::GoalBlocked { .. } => "goal-blocked",
            Self::NoWay => "no-way",
            Self::NotFound { .. } => "no-motion",
        }
    }
}
