//! The time of the reference: it brakes and stands with the robot while the gate is shut.

use crate::reference::{Reference, ReferencePoint};
use model::Pose;
use protocol::message::GateState;

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
        /// Its time when it began to brake \[periods\].
        from: f64,
        /// Tick at which it began.
        since: u64,
        /// Time to the standstill \[periods\].
        ramp: f64,
    },
    /// It runs again.
    Runs {
        /// Its time when it began to run \[periods\].
        from: f64,
        /// Tick at which it began.
        since: u64,
    },
    /// The robot holds a pose, whatever the reference is.
    Holds(Pose),
}

impl ReferenceClock {
    /// The clock for `tick`, when the gate was in the state `gate` before it, and the robot needs
    /// `braking` periods to a standstill.
    pub(super) fn look(&mut self, gate: GateState, tick: u64, braking: f64) {
        let is_shut = matches!(gate, GateState::Disarmed | GateState::Stopped);
        let from = self.time(tick).0;
        *self = match (*self, is_shut) {
            (Self::Plant | Self::Runs { .. }, true) => {
                Self::Stops { from, since: tick, ramp: braking }
            }
            (Self::Stops { .. }, false) => Self::Runs { from, since: tick },
            (same, _) => same,
        };
    }

    /// Time of the reference at `tick` \[periods\], and its rate.
    fn time(self, tick: u64) -> (f64, f64) {
        match self {
            Self::Plant | Self::Holds(_) => (tick as f64, 1.0),
            Self::Stops { from, since, ramp } => {
                let run = tick.saturating_sub(since) as f64;
                if run < ramp {
                    (from + run - 0.5 * run * run / ramp, 1.0 - run / ramp)
                } else {
                    (from + 0.5 * ramp, 0.0)
                }
            }
            Self::Runs { from, since } => {
                let (run, ramp) = (tick.saturating_sub(since) as f64, RAMP_TICKS as f64);
                if run < ramp {
                    (from + 0.5 * run * run / ramp, run / ramp)
                } else {
                    (from + run - 0.5 * ramp, 1.0)
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
            clock.look(GateState::Driving, tick, 8.0);
            assert_eq!(clock.point(&reference, tick), reference.at(tick));
        }
        for tick in 10..50 {
            clock.look(GateState::Stopped, tick, 8.0);
            let point = clock.point(&reference, tick + 8);
            assert_eq!((point.pose[0], point.velocity), (14.0, [0.0; 3]), "tick {tick}");
        }
        let mut before = 14.0;
        for tick in 50..120 {
            clock.look(GateState::Armed, tick, 0.0);
            let point = clock.point(&reference, tick);
            let moved = point.pose[0] - before;
            assert!((0.0..=1.0).contains(&moved), "tick {tick}: {moved}");
            assert!((point.velocity[0] - moved).abs() < 0.04, "tick {tick}: {moved}");
            before = point.pose[0];
        }
        assert_eq!(clock.point(&reference, 120).pose[0], 120.0 - 36.0 - 10.0);
    }

    #[test]
    fn a_held_pose_is_the_reference_at_every_tick() {
        let clock = ReferenceClock::Holds([1.0, 2.0, 3.0]);
        let point = clock.point(&line(), 77);
        assert_eq!((point.pose, point.velocity), ([1.0, 2.0, 3.0], [0.0; 3]));
    }
}
