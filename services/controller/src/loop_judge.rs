//! Whether the plans hold the robot, or the simple controller would do better.
//!
//! One-step errors do not show it: in a loop that oscillates, a model that fits the oscillation
//! predicts best. The tracking error shows it, compared with the error of the [simple
//! controller](crate::fallback::simple). That controller commands the reference's velocity plus K
//! times the error. So its error is the velocity that is lost between command and robot, over K. An
//! oscillation is lost in one direction and then in the other, and does not count.
//!
//! ```text
//! e² = |p − p_r|² + (L Δθ)²           E²: mean of e² over 0.5 s
//! w = u_δ − v, of the yaw L times     E' = |mean of w over 1 s|/K
//! ```
//! with u_δ the gate's output one dead time ago. Plans may cut corners, and bounds may require it;
//! the margin m = 0.4 L + 0.2 s |v_r| allows for that. While E² > s² (ρ² E'² + m²) for 0.3 s, the
//! simple controller drives: for 1 s, and for twice as long as the last time if plans fail again
//! within 10 s. At first s = 1. Whenever the simple controller did not make E smaller, s grows.
//! Once plans have held the robot for 10 s, s is 1 again. Commands that chatter make m smaller. A
//! robot that comes from farther away is judged once it is near, or moves away again.

use crate::fallback::GAIN_PER_S;
use crate::reference::ReferencePoint;
use model::{AXES, Pose, Velocity, wrap};

/// ρ: allowed ratio of the plans' error to the expected one.
const RATIO: f64 = 1.5;
/// Factor by which s grows after the simple controller did not help, and the largest s.
const STRICTER: f64 = 2.0;
const STRICTER_MOST: f64 = 16.0;

/// m: as a share of the lever arm L, and as a time of the reference \[s\].
const MARGIN: f64 = 0.4;
const MARGIN_S: f64 = 0.2;
/// Share of the margin that is left when commands chatter.
const CHATTERING: f64 = 0.5;
/// A robot is approaching the reference until it is this near, as a share of the lever arm L,
const NEAR: f64 = 0.2;
/// or until its distance is this multiple of its smallest distance.
const AWAY: f64 = 3.0;
/// A pose that moves in one period by this much more than the velocity explains has jumped: the
/// robot was moved by hand. As a share of the lever arm L.
const LEAPT: f64 = 0.4;

/// Time over which e² is averaged \[s\].
const ERROR_S: f64 = 0.5;
/// Time over which w and chatter are averaged \[s\].
const MEMORY_S: f64 = 1.0;
/// Time for which plans must be worse before the simple controller drives \[s\].
const PATIENCE_S: f64 = 0.3;
/// Time for which it drives at first, and at most \[s\].
const DRIVES_S: f64 = 1.0;
const DRIVES_MOST_S: f64 = 16.0;
/// Plans that fail within this time after their return fail again \[s\].
const AGAIN_S: f64 = 10.0;

/// Share of a command's limit from which on its alternating part counts as chatter.
const CHATTER: f64 = 0.05;

/// One past period.
#[derive(Debug, Clone, Copy)]
pub struct Passed<'a> {
    /// The gate's output.
    pub given: Velocity,
    /// The input that acted in it, as far as the dead time is known.
    pub acted: Velocity,
    /// Pose at its end.
    pub pose: Pose,
    /// Body velocity at its end.
    pub velocity: Velocity,
    /// The reference at its end.
    pub point: &'a ReferencePoint,
}

/// The controller in charge.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Driver {
    /// The plans, since this time; they were worse for this time without interruption \[s\].
    Plans { since_s: f64, worse_s: f64 },
    /// The simple controller, for this remaining time; E² was `begun_with` when it began \[s, m²\].
    Simple { left_s: f64, begun_with: f64 },
}

/// Watches one robot. Does not allocate.
#[derive(Debug, Clone)]
pub struct LoopJudge {
    /// T \[s\].
    period: f64,
    /// L \[m\].
    lever: f64,
    /// Largest command \[m/s, m/s, rad/s\].
    limits: Velocity,
    /// Pose of the robot one period ago.
    pose: Option<Pose>,
    /// Smallest e² of a robot that is approaching the reference; `None` once it has been there
    /// \[m²\].
    least: Option<f64>,
    /// E² \[m²\].
    error: f64,
    /// m \[m\].
    margin: f64,
    /// Mean of w \[m/s, m/s, rad/s\].
    lost: Velocity,
    driver: Driver,
    /// Time for which the simple controller drives the next time \[s\].
    drives_s: f64,
    /// s.
    stricter: f64,
    /// The last two commands.
    before: [Velocity; 2],
    /// Mean square of their alternating part, in shares of the limits.
    alternating: f64,
}

impl LoopJudge {
    /// For a robot with this lever arm \[m\] and these largest commands, in periods of `period`
    /// \[s\].
    pub fn new(period: f64, lever: f64, limits: Velocity) -> Self {
        Self {
            period,
            lever,
            limits,
            pose: None,
            least: Some(f64::INFINITY),
            error: 0.0,
            margin: MARGIN * lever,
            lost: [0.0; AXES],
            driver: Driver::Plans { since_s: AGAIN_S, worse_s: 0.0 },
            drives_s: DRIVES_S,
            stricter: 1.0,
            before: [[0.0; AXES]; 2],
            alternating: 0.0,
        }
    }

    /// Whether the simple controller must drive.
    pub fn prefers_simple(&self) -> bool {
        matches!(self.driver, Driver::Simple { .. })
    }

    /// Resets: another controller has driven, or the reference has changed.
    pub fn reset(&mut self) {
        *self = Self::new(self.period, self.lever, self.limits);
    }

    /// Skips a period in which neither plans nor the simple controller acted, and which ended with
    /// `pose`.
    pub fn pass_over(&mut self, pose: &Pose) {
        if self.pose.is_some() {
            self.pose = Some(*pose);
        }
    }

    /// Processes a period in which a plan or the simple controller acted.
    pub fn look(&mut self, passed: &Passed<'_>) {
        if self.is_elsewhere(passed) {
            (self.pose, self.least, self.error) = (None, Some(f64::INFINITY), 0.0);
        }
        let error = self.error(&passed.pose, passed.point);
        if self.pose.replace(passed.pose).is_none() {
            self.before = [passed.given; 2];
        }
        let share = if self.least.is_none() { (self.period / ERROR_S).min(1.0) } else { 1.0 };
        self.error += share * (error - self.error);
        self.least = self
            .least
            .map(|least| least.min(error))
            .filter(|least| error > (NEAR * self.lever).powi(2) && error < AWAY.powi(2) * least);
        let fading = (self.period / MEMORY_S).min(1.0);
        for (axis, lost) in self.lost.iter_mut().enumerate() {
            *lost += fading * (passed.acted[axis] - passed.velocity[axis] - *lost);
        }
        let [forward, left, _] = passed.point.velocity;
        self.margin = MARGIN * self.lever + MARGIN_S * forward.hypot(left);
        self.listen(&passed.given);
        self.decide();
    }

    /// Whether the pose has jumped by clearly more than the velocity explains.
    fn is_elsewhere(&self, passed: &Passed<'_>) -> bool {
        let [forward, left, rate] = passed.velocity.map(|velocity| 2.0 * self.period * velocity);
        let leapt = |before: Pose| {
            let [x, y] = [passed.pose[0] - before[0], passed.pose[1] - before[1]];
            let turned = wrap(passed.pose[2] - before[2]).abs() - rate.abs();
            x.hypot(y) - forward.hypot(left) > LEAPT * self.lever || turned > LEAPT
        };
        self.pose.is_some_and(leapt)
    }

    /// e² \[m²\].
    fn error(&self, pose: &Pose, point: &ReferencePoint) -> f64 {
        let turned = self.lever * wrap(pose[2] - point.pose[2]);
        (pose[0] - point.pose[0]).powi(2) + (pose[1] - point.pose[1]).powi(2) + turned.powi(2)
    }

    /// E'² \[m²\].
    fn expected(&self) -> f64 {
        let [forward, left, rate] = self.lost;
        (forward.powi(2) + left.powi(2) + (self.lever * rate).powi(2)) / GAIN_PER_S.powi(2)
    }

    /// Updates the mean square of the part of commands that alternates from period to period.
    fn listen(&mut self, given: &Velocity) {
        let [last, older] = self.before;
        let share = |axis: usize| {
            (given[axis] - 2.0 * last[axis] + older[axis]) / (4.0 * self.limits[axis])
        };
        let square: f64 = (0..AXES).map(|axis| share(axis).powi(2)).sum();
        self.alternating += (self.period / MEMORY_S).min(1.0) * (square - self.alternating);
        self.before = [*given, last];
    }

    fn decide(&mut self) {
        self.driver = match self.driver {
            Driver::Plans { since_s, worse_s } => {
                let since_s = since_s + self.period;
                if since_s >= AGAIN_S {
                    self.stricter = 1.0;
                }
                let worse_s = if self.plans_are_worse() { worse_s + self.period } else { 0.0 };
                if worse_s < PATIENCE_S {
                    Driver::Plans { since_s, worse_s }
                } else {
                    self.drives_s = if since_s < AGAIN_S {
                        (2.0 * self.drives_s).min(DRIVES_MOST_S)
                    } else {
                        DRIVES_S
                    };
                    Driver::Simple { left_s: self.drives_s, begun_with: self.error }
                }
            }
            Driver::Simple { left_s, begun_with } if left_s > self.period => {
                Driver::Simple { left_s: left_s - self.period, begun_with }
            }
            Driver::Simple { begun_with, .. } => {
                self.stricter = if self.error < begun_with {
                    1.0
                } else {
                    (STRICTER * self.stricter).min(STRICTER_MOST)
                };
                self.least = Some(f64::INFINITY);
                Driver::Plans { since_s: 0.0, worse_s: 0.0 }
            }
        };
    }

    fn plans_are_worse(&self) -> bool {
        let chatters = self.alternating > CHATTER.powi(2);
        let margin = if chatters { CHATTERING } else { 1.0 } * self.margin;
        let allowed = RATIO.powi(2) * self.expected() + margin.powi(2);
        self.least.is_none() && self.error > self.stricter.powi(2) * allowed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: f64 = 0.02;
    const DECAY: f64 = 0.8;
    const GAIN: f64 = 0.2;

    /// A robot that follows its commands at once, along a reference of 1 m/s in x, and its judge.
    struct Watched {
        judge: LoopJudge,
        pose: Pose,
        velocity: Velocity,
        tick: usize,
        /// Velocity that a slope adds \[m/s\].
        pushed: Velocity,
    }

    impl Watched {
        fn new() -> Self {
            let judge = LoopJudge::new(PERIOD, 0.3, [2.0, 2.0, 6.0]);
            Self { judge, pose: [0.0; 3], velocity: [1.0, 0.0, 0.0], tick: 0, pushed: [0.0; AXES] }
        }

        fn point(&self) -> ReferencePoint {
            let mut point = ReferencePoint::default();
            (point.pose, point.velocity) = ([PERIOD * self.tick as f64, 0.0, 0.0], [1.0, 0.0, 0.0]);
            point
        }

        fn simple(pose: &Pose, point: &ReferencePoint) -> Velocity {
            [0, 1, 2].map(|axis| point.velocity[axis] + 2.0 * (point.pose[axis] - pose[axis]))
        }

        /// Drives for `seconds` by the simple controller where it is preferred, and else by
        /// `plans`. Returns the seconds of the simple controller.
        fn drive(&mut self, seconds: f64, plans: impl Fn(&Self) -> Velocity) -> f64 {
            let mut simple = 0.0;
            for _ in 0..(seconds / PERIOD).round() as usize {
                let is_simple = self.judge.prefers_simple();
                simple += if is_simple { PERIOD } else { 0.0 };
                let given =
                    if is_simple { Self::simple(&self.pose, &self.point()) } else { plans(self) };
                for axis in 0..AXES {
                    self.velocity[axis] =
                        DECAY * self.velocity[axis] + GAIN * (given[axis] + self.pushed[axis]);
                    self.pose[axis] += PERIOD * self.velocity[axis];
                }
                self.tick += 1;
                let point = self.point();
                let passed = Passed {
                    given,
                    acted: given,
                    pose: self.pose,
                    velocity: self.velocity,
                    point: &point,
                };
                self.judge.look(&passed);
            }
            simple
        }
    }

    /// Plans that are as good as the simple controller.
    fn good(robot: &Watched) -> Velocity {
        Watched::simple(&robot.pose, &robot.point())
    }

    /// Plans that push the robot away to the left.
    fn bad(_: &Watched) -> Velocity {
        [1.0, 1.0, 0.0]
    }

    #[test]
    fn good_plans_keep_driving_also_where_a_slope_pushes_the_robot_away() {
        for pushed in [0.0, 0.5] {
            let mut robot = Watched::new();
            robot.pushed = [0.0, pushed, 0.0];
            assert_eq!(robot.drive(20.0, good), 0.0, "pushed by {pushed} m/s");
        }
    }

    #[test]
    fn plans_that_diverge_are_replaced_within_a_second() {
        let mut robot = Watched::new();
        robot.drive(5.0, good);
        robot.drive(1.0, bad);
        assert!(robot.judge.prefers_simple());
    }

    #[test]
    fn a_robot_that_is_moved_by_hand_is_approaching_and_no_plan_is_blamed() {
        let mut robot = Watched::new();
        robot.drive(5.0, good);
        robot.pose[1] += 0.8;
        assert_eq!(robot.drive(5.0, good), 0.0);
    }

    #[test]
    fn plans_that_recover_drive_again() {
        let mut robot = Watched::new();
        robot.drive(5.0, good);
        robot.drive(1.5, bad);
        robot.drive(DRIVES_S, good);
        assert_eq!(robot.drive(20.0, good), 0.0);
    }

    #[test]
    fn plans_that_fail_repeatedly_drive_less_and_less() {
        let mut robot = Watched::new();
        robot.drive(5.0, good);
        let shares: Vec<f64> = (0..4).map(|_| robot.drive(15.0, bad) / 15.0).collect();
        assert!(shares.is_sorted() && shares[3] > 0.8, "{shares:?}");
    }

    #[test]
    fn a_simple_controller_that_does_not_help_drives_less_until_plans_have_held_for_10_s() {
        let mut robot = Watched::new();
        robot.drive(5.0, good);
        // Loss between command and robot does not show in the robot's measurements.
        robot.judge.stricter = STRICTER_MOST;
        robot.judge.driver = Driver::Plans { since_s: 0.0, worse_s: 0.0 };
        assert_eq!(robot.drive(1.0, bad), 0.0);
        robot.pose[1] = 0.0;
        robot.drive(AGAIN_S, good);
        robot.drive(1.0, bad);
        assert!(robot.judge.prefers_simple());
    }

    #[test]
    fn a_skipped_period_keeps_the_memory() {
        let mut robot = Watched::new();
        robot.drive(5.0, good);
        robot.drive(1.5, bad);
        let before = robot.judge.clone();
        robot.judge.pass_over(&robot.pose.clone());
        assert_eq!(format!("{before:?}"), format!("{:?}", robot.judge));
    }

    #[test]
    fn commands_that_chatter_have_a_smaller_margin() {
        let (mut quiet, mut loud) = (Watched::new(), Watched::new());
        // 220 mm ahead of the reference; 320 mm are allowed without chatter.
        let ahead = |robot: &Watched, aside: f64| {
            let [x, y, yaw] = good(robot);
            [x + 0.44, y + if robot.tick.is_multiple_of(2) { aside } else { -aside }, yaw]
        };
        assert_eq!(quiet.drive(10.0, |robot| ahead(robot, 0.0)), 0.0);
        assert!(loud.drive(10.0, |robot| ahead(robot, 0.4)) > 0.0);
    }
}
