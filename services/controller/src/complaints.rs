//! Errors of driver or robot file that show in the states. Without a report they would only show
//! as bad driving.
//!
//! | complaint   | evidence over the last 2 s                                              |
//! |-------------|-------------------------------------------------------------------------|
//! | `Refusals`  | the gate refused a command in more than half of the periods             |
//! | `Rate`      | states arrive at another rate than one per period, unless in lock step  |
//! | `Period`    | the pose moved further, or less far, than velocity times period         |
//! | `Current`   | a motor was at its current limit in more than half of the periods       |
//! | `Limit`     | plans reached a limit of the robot in nearly all periods                |
//! | `Row`       | a motor carries far less than its limit although plans take it for full |
//! | `NoEffect`  | the robot hardly moves as commanded                                     |
//! | `Simple`    | the simple controller drove: plans did not hold the robot, or were none |
//! | `NoList`    | the gate slowed the robot: its list of obstacles was too old            |
//!
//! ```text
//! ratio = Σ Δp·v̄ T / Σ (v̄ T)²        Δp: displacement of a period in the body's frame
//! ```
//! is 1 if the driver's period is T and its velocity is in metres per second. For a robot that
//! follows, ū·v̄ / ū² is near 1 as well, with the mean ū of the commanded velocity and v̄ of the
//! measured one, and L ω for the yaw. A robot that is late follows too: commands that alternate
//! faster than it answers have no mean. The ratio must be small for a second, so that a dead time
//! after a standstill does not count.

mod sentence;

use crate::currents::Contradicted;
use crate::mpc::constraint::RobotLimit;
use model::{AXES, Velocity, wrap};
use process::Pace;
use protocol::message::{FallbackLevel, PlantState, Reason};
use robot::{Robot, WHEELS_MAX};
use std::fmt::{self, Display, Formatter};

pub use sentence::Sentence;

/// Time over which periods decay \[s\].
const MEMORY_S: f64 = 2.0;

/// From this share of the periods on, a complaint is reported.
const OFTEN: f64 = 0.5;

/// From this share of the periods on, plans reach a limit all the time.
const NEARLY_ALWAYS: f64 = 0.8;

/// Plans that reach a limit are evaluated once the decayed number of periods is this share of its
/// final value: after 4.6 s.
const LONG: f64 = 0.9;

/// A state that comes later than this counts as this late: one stall is no other rate \[periods\].
const LATE_MAX: f64 = 10.0;

/// Ratios that badly calibrated sensors may have.
const RATIOS: std::ops::Range<f64> = 0.6..1.6;

/// Below this mean speed the ratio is not evaluated \[m/s\].
const SPEED_LEAST: f64 = 0.2;

/// A motor this close to its limit counts as at its limit.
const AT_LIMIT: f64 = 0.95;

/// A robot that follows less than this share of its commands has no effect of them.
const FOLLOWS_LEAST: f64 = 0.2;

/// Time for which commands must have no effect \[s\].
const NO_EFFECT_S: f64 = 1.0;

/// Below this mean command the effect is not evaluated \[m/s\].
const COMMANDED_LEAST: f64 = 0.1;

/// From this share of periods of the simple controller on, it is reported.
const SIMPLE_LEAST: f64 = 0.1;

/// An error that an operator must repair.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Complaint {
    /// The gate refuses commands.
    Refusals {
        /// In this share of the periods.
        share: f64,
        /// Reason of the last refusal.
        reason: Reason,
    },
    /// Pose and velocity do not match.
    Period {
        /// Distance of the pose over the distance that the velocity gives.
        ratio: f64,
        /// T of this controller \[s\].
        period_s: f64,
    },
    /// States arrive at another rate.
    Rate {
        /// Mean time between two states; a time above ten periods counts as ten \[s\].
        interval_s: f64,
        /// T of this controller \[s\].
        period_s: f64,
    },
    /// Plans reach a limit of the robot.
    Limit {
        /// In this share of the periods.
        share: f64,
        /// The limit that they reached last.
        limit: RobotLimit,
    },
    /// A motor is at its limit.
    Current {
        /// In this share of the periods.
        share: f64,
        /// The robot file's limit \[A\].
        limit_a: f64,
    },
    /// Plans take motors for full that are not.
    Row {
        /// Whether each motor is one of them, in the robot file's order.
        wheels: [bool; WHEELS_MAX],
        /// Largest current that they carry, as a share of the limit.
        carried: f64,
    },
    /// Commands have no effect.
    NoEffect {
        /// Share of the commanded velocity that the robot reaches.
        share: f64,
    },
    /// The simple controller drives.
    Simple {
        /// In this share of the periods.
        share: f64,
    },
    /// The robot is slow, because its list of obstacles is too old.
    NoList {
        /// In this share of the periods.
        share: f64,
    },
}

/// What the last plan says of the limits.
#[derive(Debug, Clone, Copy, Default)]
pub struct LimitsInUse {
    /// The limit on a motor's current that the measured current contradicts, if there is one.
    pub contradicted: Option<Contradicted>,
    /// The limit that the plan reaches in its first period, if it reaches one.
    pub reached: Option<RobotLimit>,
}

/// Number of complaints.
const COUNT: usize = 9;

/// All present complaints, the worst first.
type Complained = [Option<Complaint>; COUNT];

/// Index of `Refusals`, `Limit`, `Current` and `NoList` among them.
const REFUSALS: usize = 0;
const LIMIT: usize = 6;
const CURRENT: usize = 7;
const NO_LIST: usize = 8;

/// Motors by their numbers, from 1 on.
struct Motors([bool; WHEELS_MAX]);

impl Display for Motors {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let numbers = self.0.iter().zip(1..).filter(|(is_one, _)| **is_one);
        for (count, (_, number)) in numbers.enumerate() {
            write!(f, "{}{number}", if count == 0 { "" } else { ", " })?;
        }
        Ok(())
    }
}

impl Display for Complaint {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        match self {
            Self::Refusals { share, reason } => write!(
                f,
                "{:.0} % of the periods have refused commands ({reason}): driver and robot file \
                 differ",
                100.0 * share
            ),
            Self::Period { ratio, period_s } => write!(
                f,
                "the pose moves {ratio:.2} times as far as the velocity implies: is the driver's \
                 period {:.1} ms?",
                1e3 * period_s
            ),
            Self::Rate { interval_s, period_s } => write!(
                f,
                "states arrive every {:.1} ms, and the period is {:.1} ms: is it the driver's?",
                1e3 * interval_s,
                1e3 * period_s
            ),
            Self::Limit { share, limit } => write!(
                f,
                "plans reach the limit of {limit} in {:.0} % of the periods: is the robot file \
                 right?",
                100.0 * share
            ),
            Self::Current { share, limit_a } => write!(
                f,
                "a motor is at its limit of {limit_a} A in {:.0} % of the periods",
                100.0 * share
            ),
            Self::Row { wheels, carried } => write!(
                f,
                "plans ignore the current limit of motor {}: the model predicts it, and {:.0} % \
                 of it is measured",
                Motors(*wheels),
                100.0 * carried
            ),
            Self::NoEffect { share } => write!(
                f,
                "the robot has {:.0} % of the commanded velocity: is it held, or are its motors \
                 off?",
                100.0 * share
            ),
            Self::Simple { share } => write!(
                f,
                "the simple controller drives in {:.0} % of the periods: plans fail, or track \
                 worse than it",
                100.0 * share
            ),
            Self::NoList { share } => write!(
                f,
                "the gate slows the robot in {:.0} % of the periods: its list of obstacles is too \
                 old",
                100.0 * share
            ),
        }
    }
}

/// The evaluated part of a state.
#[derive(Debug, Clone, Copy)]
struct Seen {
    epoch: u64,
    tick: u64,
    sent_nanos: u64,
    refused: u64,
    pose: [f64; 3],
    velocity: Velocity,
    input: Velocity,
    is_simple: bool,
}

/// Evaluates every state. Does not allocate.
#[derive(Debug, Clone)]
pub struct Complaints {
    period_s: f64,
    /// Whether a clock paces the plant.
    is_paced: bool,
    limit_a: f64,
    lever_m: f64,
    fading: f64,
    /// The last state.
    before: Option<Seen>,
    /// Decayed sums over the past: periods, those with a refusal, those with a motor at its limit.
    periods: f64,
    refused: f64,
    at_limit: f64,
    /// Time between the states \[s\].
    passed_s: f64,
    /// Periods in which the plan reached a limit of the robot.
    reached: f64,
    /// The limit that a plan reached last.
    reached_last: Option<RobotLimit>,
    /// Σ Δp·v̄ T and Σ (v̄ T)² \[m²\].
    moved: f64,
    reported: f64,
    /// Σ v and Σ u \[m/s\].
    followed: Velocity,
    commanded: Velocity,
    /// Time for which commands have had no effect \[s\].
    no_effect_s: f64,
    /// Periods of the simple controller.
    simple: f64,
    /// Periods in which the list of obstacles was too old.
    no_list: f64,
    /// Complaints that have been reported and continue.
    told: [bool; COUNT],
}

impl Complaints {
    /// No complaints yet, for this robot with periods of `period_s` \[s\].
    pub fn new(robot: &Robot, period_s: f64, pace: Pace) -> Self {
        Self {
            period_s,
            is_paced: pace == Pace::RealTime,
            limit_a: robot.current_limit_a().unwrap_or(f64::INFINITY),
            lever_m: robot.wheels.lever_m(),
            fading: (-period_s / MEMORY_S).exp(),
            before: None,
            periods: 0.0,
            refused: 0.0,
            at_limit: 0.0,
            passed_s: 0.0,
            reached: 0.0,
            reached_last: None,
            moved: 0.0,
            reported: 0.0,
            followed: [0.0; AXES],
            commanded: [0.0; AXES],
            no_effect_s: 0.0,
            simple: 0.0,
            no_list: 0.0,
            told: [false; COUNT],
        }
    }

    /// Processes the next state, and what the plan for it says of the limits. Returns each
    /// complaint once when it begins, one at a time. A state with numbers that are not finite is
    /// skipped.
    pub fn look(&mut self, state: &PlantState, limits: &LimitsInUse) -> Option<Complaint> {
        let now = Seen {
            epoch: state.stamp.epoch,
            tick: state.stamp.tick,
            sent_nanos: state.stamp.sent_nanos,
            refused: state.refused,
            pose: state.pose,
            velocity: state.velocity,
            input: state.input,
            is_simple: state.fallback_level() == FallbackLevel::Simple,
        };
        let numbers = now.pose.iter().chain(&now.velocity).chain(&now.input);
        if !numbers.copied().all(f64::is_finite) {
            self.before = None;
            return None;
        }
        let is_next = |before: &Seen| (before.epoch, before.tick + 1) == (now.epoch, now.tick);
        let before = self.before.replace(now).filter(is_next)?;
        let add = |sum: &mut f64, value: f64| *sum = self.fading * *sum + value;
        add(&mut self.periods, 1.0);
        add(&mut self.refused, f64::from(u8::from(now.refused > before.refused)));
        let is_at_limit = state.current().iter().any(|amps| amps.abs() >= AT_LIMIT * self.limit_a);
        add(&mut self.at_limit, f64::from(u8::from(is_at_limit)));
        let passed_s = now.sent_nanos.saturating_sub(before.sent_nanos) as f64 * 1e-9;
        add(&mut self.passed_s, passed_s.min(LATE_MAX * self.period_s));
        let is_by_plan = state.fallback_level() == FallbackLevel::FreshPlan;
        let reached = limits.reached.filter(|_| is_by_plan);
        add(&mut self.reached, f64::from(u8::from(reached.is_some())));
        self.reached_last = reached.or(self.reached_last);
        let (moved, reported) = motion(&before, &now, self.period_s);
        add(&mut self.moved, moved);
        add(&mut self.reported, reported);
        let scale = [1.0, 1.0, self.lever_m];
        for axis in 0..AXES {
            add(&mut self.followed[axis], scale[axis] * now.velocity[axis]);
            add(&mut self.commanded[axis], scale[axis] * now.input[axis]);
        }
        let has_effect = self.share_without_effect().is_none();
        self.no_effect_s = if has_effect { 0.0 } else { self.no_effect_s + self.period_s };
        add(&mut self.simple, f64::from(u8::from(now.is_simple)));
        let is_without_list = state.reason() == Reason::ObstaclesUnknown;
        add(&mut self.no_list, f64::from(u8::from(is_without_list)));
        let complained = self.complained(state.reason(), limits.contradicted);
        for (told, complaint) in self.told.iter_mut().zip(&complained) {
            *told &= complaint.is_some();
        }
        let new = (0..self.told.len()).find(|&of| complained[of].is_some() && !self.told[of])?;
        self.told[new] = true;
        complained[new]
    }

    /// ū·v̄ / ū², if it is small.
    fn share_without_effect(&self) -> Option<f64> {
        let along = |a: &Velocity, b: &Velocity| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let commanded = along(&self.commanded, &self.commanded);
        let is_commanded = commanded > (COMMANDED_LEAST * self.periods).powi(2);
        let share = along(&self.commanded, &self.followed) / commanded;
        (is_commanded && share < FOLLOWS_LEAST).then_some(share)
    }

    fn complained(&self, reason: Reason, row: Option<Contradicted>) -> Complained {
        // Less than a second is not evaluated.
        if self.periods * self.period_s < 0.4 * MEMORY_S {
            return [None; COUNT];
        }
        let share_of = |periods: f64| periods / self.periods;
        // A complaint continues until it has clearly ended.
        let often = |of: usize| if self.told[of] { 0.5 * OFTEN } else { OFTEN };
        let refused = share_of(self.refused);
        let moves = share_of(self.reported) > (SPEED_LEAST * self.period_s).powi(2);
        let ratio = self.moved / self.reported;
        let (simple, at_limit) = (share_of(self.simple), share_of(self.at_limit));
        let (no_list, reached) = (share_of(self.no_list), share_of(self.reached));
        let period_s = self.period_s;
        let interval_s = share_of(self.passed_s);
        let is_other_rate = self.is_paced && !RATIOS.contains(&(interval_s / period_s));
        // A robot that approaches its reference may be at a limit for seconds.
        let is_long = self.periods > LONG / (1.0 - self.fading);
        let least = if self.told[LIMIT] { OFTEN } else { NEARLY_ALWAYS };
        let limit = self.reached_last.filter(|_| is_long && reached > least);
        [
            (refused > often(REFUSALS)).then_some(Complaint::Refusals { share: refused, reason }),
            is_other_rate.then_some(Complaint::Rate { interval_s, period_s }),
            (moves && !is_other_rate && !RATIOS.contains(&ratio))
                .then_some(Complaint::Period { ratio, period_s }),
            self.share_without_effect()
                .filter(|_| self.no_effect_s > NO_EFFECT_S)
                .map(|share| Complaint::NoEffect { share }),
            (simple > SIMPLE_LEAST).then_some(Complaint::Simple { share: simple }),
            row.map(|Contradicted { wheels, carried }| Complaint::Row { wheels, carried }),
            limit.map(|limit| Complaint::Limit { share: reached, limit }),
            (at_limit > often(CURRENT))
                .then_some(Complaint::Current { share: at_limit, limit_a: self.limit_a }),
            (no_list > often(NO_LIST)).then_some(Complaint::NoList { share: no_list }),
        ]
    }
}

/// Δp·v̄ T and (v̄ T)² of one period \[m²\].
fn motion(before: &Seen, after: &Seen, period: f64) -> (f64, f64) {
    let mean: Velocity =
        std::array::from_fn(|axis| 0.5 * (before.velocity[axis] + after.velocity[axis]));
    let turned = wrap(after.pose[2] - before.pose[2]);
    let (sin, cos) = (before.pose[2] + 0.5 * turned).sin_cos();
    let [x, y] = [after.pose[0] - before.pose[0], after.pose[1] - before.pose[1]];
    let (forward, left) = (cos * x + sin * y, cos * y - sin * x);
    let expected = [period * mean[0], period * mean[1]];
    (forward * expected[0] + left * expected[1], expected[0].powi(2) + expected[1].powi(2))
}

#[cfg(test)]
mod tests;
