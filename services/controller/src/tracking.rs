//! Tracking error → a request to stop: the robot is farther from its reference than the robot file
//! allows.
//!
//! The judge counts errors only while the controller's own commands act, and only after the robot
//! has been near its reference since the last [reset](TrackingJudge::reset): both errors were below
//! their limits in one period. So a robot that begins far away, or that was cut off, catches up
//! without a stop, and may have another heading on its way.

use model::{Pose, wrap};
use protocol::message::{FallbackLevel, Reason};
use robot::Robot;

/// One limit, and the reason of a stop beyond it.
#[derive(Debug, Clone, Copy)]
struct Watched {
    /// `None` is no limit.
    limit: Option<f64>,
    reason: Reason,
}

impl Watched {
    /// Whether `error` is within the limit. NaN is not.
    fn allows(&self, error: f64) -> bool {
        self.limit.is_none_or(|limit| error < limit)
    }

    /// Whether `error` is a reason to stop. NaN is not.
    fn exceeds(&self, error: f64) -> bool {
        self.limit.is_some_and(|limit| error > limit)
    }
}

/// Judges every period. Does not allocate.
#[derive(Debug, Clone)]
pub struct TrackingJudge {
    watched: [Watched; 2],
    /// The robot has been near its reference.
    has_arrived: bool,
    request: Reason,
}

impl TrackingJudge {
    /// A judge with the limits of `robot`.
    pub fn new(robot: &Robot) -> Self {
        let watch = |limit, reason| Watched { limit, reason };
        Self {
            watched: [
                watch(robot.tracking_error_m(), Reason::PositionError),
                watch(robot.tracking_error_heading_rad(), Reason::HeadingError),
            ],
            has_arrived: false,
            request: Reason::None,
        }
    }

    /// Resets: at a start, with another reference, after a brake.
    pub fn reset(&mut self) {
        (self.request, self.has_arrived) = (Reason::None, false);
    }

    /// Judges the robot at `pose` against `reference`, after a period on `fallback_level`.
    pub fn judge(
        &mut self,
        pose: &Pose,
        reference: &Pose,
        fallback_level: FallbackLevel,
    ) -> Reason {
        match fallback_level {
            FallbackLevel::FreshPlan | FallbackLevel::ShiftedPlan | FallbackLevel::Simple => {
                let position = (pose[0] - reference[0]).hypot(pose[1] - reference[1]);
                let heading = wrap(pose[2] - reference[2]).abs();
                let errors = self.watched.iter().zip([position, heading]);
                self.has_arrived |= errors.clone().all(|(watched, error)| watched.allows(error));
                let mut exceeded = errors.filter(|(watched, error)| watched.exceeds(*error));
                let reason = exceeded.next().map_or(Reason::None, |(watched, _)| watched.reason);
                self.request = if self.has_arrived { reason } else { Reason::None };
            }
            FallbackLevel::StoredTail => self.request = Reason::None,
            FallbackLevel::Waiting | FallbackLevel::Brake | FallbackLevel::LatchedStop => {
                self.reset();
            }
        }
        self.request
    }

    /// Reason for a request to stop; [`Reason::None`] without a request.
    pub fn request(&self) -> Reason {
        self.request
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use robot::TrackingLimit;

    fn judge(position: TrackingLimit, heading: TrackingLimit) -> TrackingJudge {
        let mut robot = Robot::example();
        robot.limits.tracking_error_m = position;
        robot.limits.tracking_error_heading_rad = heading;
        TrackingJudge::new(&robot)
    }

    /// Requests after periods on `fallback_level` with these position errors.
    fn requests(
        judge: &mut TrackingJudge,
        fallback_level: FallbackLevel,
        errors: &[f64],
    ) -> Vec<Reason> {
        let reference = [3.0, -2.0, 3.0];
        let at = |error: f64| [reference[0], reference[1] - error, reference[2]];
        errors.iter().map(|&error| judge.judge(&at(error), &reference, fallback_level)).collect()
    }

    #[test]
    fn an_error_counts_once_it_has_been_below_the_limit() {
        let mut judge = judge(TrackingLimit::At(1.0), TrackingLimit::Off);
        let (no, yes) = (Reason::None, Reason::PositionError);
        let requested =
            requests(&mut judge, FallbackLevel::FreshPlan, &[2.0, 1.5, 0.9, 0.99, 1.01, 5.0, 0.5]);
        assert_eq!(requested, [no, no, no, no, yes, yes, no]);
    }

    #[test]
    fn after_a_brake_the_robot_may_catch_up() {
        let mut judge = judge(TrackingLimit::At(1.0), TrackingLimit::Off);
        requests(&mut judge, FallbackLevel::FreshPlan, &[0.1]);
        for fallback_level in
            [FallbackLevel::Brake, FallbackLevel::LatchedStop, FallbackLevel::Waiting]
        {
            assert_eq!(requests(&mut judge, fallback_level, &[0.1, 3.0]), [Reason::None; 2]);
            assert_eq!(requests(&mut judge, FallbackLevel::Simple, &[3.0, 2.0]), [Reason::None; 2]);
            let requested = requests(&mut judge, FallbackLevel::Simple, &[0.5, 2.0]);
            assert_eq!(requested, [Reason::None, Reason::PositionError]);
        }
    }

    #[test]
    fn a_stored_tail_neither_counts_nor_resets() {
        let mut judge = judge(TrackingLimit::At(1.0), TrackingLimit::Off);
        requests(&mut judge, FallbackLevel::FreshPlan, &[0.1]);
        assert_eq!(requests(&mut judge, FallbackLevel::StoredTail, &[2.0]), [Reason::None]);
        assert_eq!(requests(&mut judge, FallbackLevel::FreshPlan, &[2.0]), [Reason::PositionError]);
    }

    #[test]
    fn heading_error_is_the_shortest_angle() {
        let mut judge = judge(TrackingLimit::Off, TrackingLimit::Default);
        let mut requested =
            |yaw| judge.judge(&[0.0, 0.0, yaw], &[0.0, 0.0, 3.0], FallbackLevel::FreshPlan);
        assert_eq!(requested(-3.0), Reason::None);
        assert_eq!(requested(0.5), Reason::HeadingError);
        assert_eq!(requested(1.5), Reason::None);
    }

    #[test]
    fn a_robot_that_catches_up_may_have_another_heading_on_its_way() {
        let mut judge = judge(TrackingLimit::At(1.0), TrackingLimit::Default);
        let mut requested =
            |x: f64, yaw: f64| judge.judge(&[x, 0.0, yaw], &[0.0; 3], FallbackLevel::FreshPlan);
        assert_eq!([requested(4.0, 0.1), requested(2.0, 2.5)], [Reason::None; 2]);
        assert_eq!([requested(0.5, 2.5), requested(0.5, 0.1)], [Reason::None; 2]);
        assert_eq!(requested(0.5, 2.5), Reason::HeadingError);
        assert_eq!(requested(2.0, 2.0), Reason::PositionError);
    }

    #[test]
    fn neither_a_missing_limit_nor_nan_stops() {
        let mut none = judge(TrackingLimit::Off, TrackingLimit::Off);
        let requested = requests(&mut none, FallbackLevel::FreshPlan, &[0.0, 1e9]);
        assert_eq!(requested, [Reason::None; 2]);
        let mut limited = judge(TrackingLimit::At(1.0), TrackingLimit::Default);
        let requested =
            requests(&mut limited, FallbackLevel::FreshPlan, &[0.0, f64::NAN, f64::INFINITY]);
        assert_eq!(requested, [Reason::None, Reason::None, Reason::PositionError]);
    }
}
