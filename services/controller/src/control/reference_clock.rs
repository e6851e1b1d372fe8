//! The time of the reference: it brakes and stands with the robot while the gate is shut, and while
//! an obstacle holds the robot up.

use crate::reference::{Reference, ReferencePoint};
use model::Pose;

/// Periods in which the reference's clock gets from standstill to its full rate; an even number.
const RAMP_TICKS: u64 = 20;

/// Relation of the reference's time to the plant's ticks.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) enum ReferenceClock {
    /// It is the plant's.
    #[default]
    Plant,
    /// It brakes to a standstill.
    Stops {
        /// Where it began to brake.
        since: Since,
        /// Time from the full rate to the standstill \[periods\].
        ramp: f64,
    },
    /// It runs again.
    Runs {
        /// Where it began to run.
        since: Since,
    },
    /// The robot holds a pose, whatever the reference is.
    Holds(Pose),
}

/// Begin of a change of the rate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Since {
    tick: u64,
    /// Time of the reference \[periods\].
    time: f64,
    /// Its rate.
    rate: f64,
}

impl ReferenceClock {
    /// The clock for `tick`, when the robot was held before it or not, and needs `braking` periods
    /// to a standstill.
    pub(super) fn look(&mut self, waits: bool, tick: u64, braking: f64) {
        let (time, rate) = self.time(tick);
        let since = Since { tick, time, rate };
        *self = match (*self, waits) {
            (Self::Plant | Self::Runs { .. }, true) => Self::Stops { since, ramp: braking },
            (Self::Stops { .. }, false) => Self::Runs { since },
            (same, _) => same,
        };
    }

    /// Time of the reference at `tick` \[periods\], and its rate.
    fn time(self, tick: u64) -> (f64, f64) {
        match self {
            Self::Plant | Self::Holds(_) => (tick as f64, 1.0),
            Self::Stops { since: Since { tick: since, time, rate }, ramp } => {
                let run = tick.saturating_sub(since) as f64;
                if run < rate * ramp {
                    (time + rate * run - 0.5 * run * run / ramp, rate - run / ramp)
                } else {
                    (time + 0.5 * rate * rate * ramp, 0.0)
                }
            }
            Self::Runs { since: Since { tick: since, time, rate } } => {
                let (run, ramp) = (tick.saturating_sub(since) as f64, RAMP_TICKS as f64);
                let slow = 1.0 - rate;
                if run < slow * ramp {
                    (time + rate * run + 0.5 * run * run / ramp, rate + run / ramp)
                } else {
                    (time + run - 0.5 * slow * slow * ramp, 1.0)
                }
            }
        }
    }

    /// The point of `reference` at `tick`.
    pub(super) fn point(self, reference: &Reference, tick: u64) -> ReferencePoint {
        if let Self::Holds(pose) = self {
            return ReferencePoint { pose, ..ReferencePoint::default() };
        }
        let (time, rate) = self.time(tick);
        let (whole, share) = (time as u64, time.fract());
        let here = reference.at(whole);
        if self == Self::Plant || (share == 0.0 && rate == 1.0) {
            return here;
        }
        let next = reference.at(whole + 1);
        let between = |a: [f64; 3], b: [f64; 3]| -> [f64; 3] {
            std::array::from_fn(|axis| a[axis] + share * (b[axis] - a[axis]))
        };
        ReferencePoint {
            pose: between(here.pose, next.pose),
            velocity: between(here.velocity, next.velocity).map(|velocity| rate * velocity),
            course: here.course,
        }
    }

    /// Tick of the plant at whose time the reference is, as far as it runs now.
    pub(super) fn reference_tick(self, tick: u64) -> u64 {
        self.time(tick).0 as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line() -> Reference {
        let points = (0..200).map(|tick| ReferencePoint {
            pose: [f64::from(tick), 0.0, 0.0],
            velocity: [1.0, 0.0, 0.0],
            course: 0.0,
        });
        Reference::of_points(points.collect(), 0)
    }

    #[test]
    fn the_reference_brakes_with_the_robot_and_starts_again_from_rest() {
        let (mut clock, reference) = (ReferenceClock::default(), line());
        for tick in 0..10 {
            clock.look(false, tick, 8.0);
            assert_eq!(clock.point(&reference, tick), reference.at(tick));
        }
        for tick in 10..50 {
            clock.look(true, tick, 8.0);
            let point = clock.point(&reference, tick + 8);
            assert_eq!((point.pose[0], point.velocity), (14.0, [0.0; 3]), "tick {tick}");
        }
        let mut before = 14.0;
        for tick in 50..120 {
            clock.look(false, tick, 0.0);
            let point = clock.point(&reference, tick);
            let moved = point.pose[0] - before;
            assert!((0.0..=1.0).contains(&moved), "tick {tick}: {moved}");
            assert!((point.velocity[0] - moved).abs() < 0.04, "tick {tick}: {moved}");
            before = point.pose[0];
        }
        assert_eq!(clock.point(&reference, 120).pose[0], 120.0 - 36.0 - 10.0);
    }

    #[test]
    fn a_robot_that_is_held_for_a_moment_keeps_most_of_its_speed() {
        let (mut clock, reference) = (ReferenceClock::default(), line());
        let mut before = clock.point(&reference, 9);
        for tick in 10..60 {
            clock.look((10..13).contains(&tick), tick, 20.0);
            let point = clock.point(&reference, tick);
            let change = (point.velocity[0] - before.velocity[0]).abs();
            assert!(change < 0.11, "tick {tick}: {change}");
            assert!(point.velocity[0] > 0.8, "tick {tick}: {point:?}");
            before = point;
        }
    }

    #[test]
    fn a_held_pose_is_the_reference_at_every_tick() {
        let clock = ReferenceClock::Holds([1.0, 2.0, 3.0]);
        let point = clock.point(&line(), 77);
        assert_eq!((point.pose, point.velocity), ([1.0, 2.0, 3.0], [0.0; 3]));
    }
}
