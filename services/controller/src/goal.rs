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
mod request;
pub mod schedule;

use crate::reference::{Reference, ReferencePoint};
use clear::{Clear, Counted};
use model::delay::DELAY_MAX;
use model::{Pose, Velocity, wrap};
use motion::{Limits, Moment, Motion, MotionError, Path, to_standstill, with_velocity};
use protocol::message::{GateState, Goal, GoalPhase, HORIZON_MAX, OBSTACLES_MAX, ObstacleSource};
use robot::{Obstacle, Robot, Surroundings};

pub use request::{Demand, GoalError, GoalRequest, VELOCITY_VALID_MAX_S};

/// Distance from the reference above which a goal begins at the robot \[m\], and heading \[rad\].
const NEAR: (f64, f64) = (0.2, 0.3);
/// Time that the exchange of the reference may take \[s\].
const EXCHANGE_S: f64 = 0.1;
/// Points of the way ahead: those that the control thread knows.
pub const OUTLOOK_POINTS: usize = DELAY_MAX + HORIZON_MAX + 1;
/// Longest motion \[s\].
const MOTION_MAX_S: f64 = 1e4;

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
