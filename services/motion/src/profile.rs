//! Jerk-limited motions to a pose, to a standstill, and with a body velocity: the Ruckig algorithm
//! (Berscheid and Kröger, RSS 2021), from `rsruckig`.

use crate::{Course, Limits, Moment, Motion, MotionError};
use robot::{AXES, Velocity};
use rsruckig::prelude::{
    ControlInterface, DataArrayOrVec, InputParameter, Ruckig, Synchronization, ThrowErrorHandler,
    Trajectory,
};
use std::f64::consts::{PI, TAU};

/// Attempts to slow a motion down until it is within the limits of the wheels.
const ATTEMPTS: usize = 12;
/// Factor on each correction of the limits, so that few are needed.
const OVERSHOOT: f64 = 1.01;
/// Excess of the limits that counts as none.
const SLACK: f64 = 1e-3;
/// Times at which the limits are checked. The peaks of an acceleration are short.
const CHECKS: usize = 2000;
/// Interval of the integration of a body velocity \[s\].
const STEP_S: f64 = 2e-3;
/// Interval that `rsruckig` requires and does not use here \[s\].
const UNUSED_INTERVAL_S: f64 = 1e-3;

/// A motion of the pose in the world.
#[derive(Debug, Clone)]
pub(crate) struct Profile(Trajectory<AXES>);

impl Profile {
    pub(crate) fn at(&self, time: f64) -> Moment {
        let [mut pose, mut velocity, mut acceleration] = [0, 1, 2].map(|_| axes([0.0; AXES]));
        let out = (&mut Some(&mut pose), &mut Some(&mut velocity), &mut Some(&mut acceleration));
        self.0.at_time(time, out.0, out.1, out.2, &mut None, &mut None);
        Moment {
            pose: numbers(&pose),
            velocity: numbers(&velocity),
            acceleration: numbers(&acceleration),
        }
    }
}

/// A motion that was integrated from a body velocity: moments at every [`STEP_S`].
#[derive(Debug, Clone)]
pub(crate) struct BodyMotion(Vec<Moment>);

impl BodyMotion {
    pub(crate) fn at(&self, time: f64) -> Moment {
        let place = time / STEP_S;
        let (index, share) = (place as usize, place.fract());
        let last = self.0.last().copied().unwrap_or_default();
        let [from, to] = [index, index + 1].map(|i| self.0.get(i).copied().unwrap_or(last));
        let between = |a: [f64; AXES], b: [f64; AXES]| {
            std::array::from_fn(|axis| a[axis] + share * (b[axis] - a[axis]))
        };
        Moment {
            pose: between(from.pose, to.pose),
            velocity: between(from.velocity, to.velocity),
            acceleration: between(from.acceleration, to.acceleration),
        }
    }
}

/// The motion from `from` to a standstill at `pose`, by the shorter turn, within `limits`. It is
/// straight if it begins at rest.
///
/// # Errors
/// [`MotionError`] if a number is not finite, or if there is no such motion.
pub fn to_pose(from: &Moment, pose: [f64; AXES], limits: &Limits) -> Result<Motion, MotionError> {
    check(from, "the present state")?;
    check(&Moment::at_rest(pose), "the pose")?;
    let turn = (pose[2] - from.pose[2] + PI).rem_euclid(TAU) - PI;
    let target = [pose[0], pose[1], from.pose[2] + turn];
    lowered(from, limits, |limits| {
        let mut input = input(from, limits);
        input.target_position = axes(target);
        input.synchronization = Synchronization::Phase;
        input
    })
}

/// The shortest motion from `from` to a standstill.
///
/// # Errors
/// [`MotionError`] if a number is not finite, or if there is no such motion.
pub fn to_standstill(from: &Moment, limits: &Limits) -> Result<Motion, MotionError> {
    check(from, "the present state")?;
    lowered(from, limits, |limits| {
        let mut input = input(from, limits);
        input.control_interface = ControlInterface::Velocity;
        input.synchronization = Synchronization::Phase;
        input
    })
}

/// The motion from `from` with the body velocity `velocity` (forward, left, yaw) for `valid_s`,
/// then to a standstill. A velocity beyond the limits is scaled down as a whole.
///
/// # Errors
/// [`MotionError`] if a number is not finite, or if there is no such motion.
pub fn with_velocity(
    from: &Moment,
    velocity: Velocity,
    valid_s: f64,
    limits: &Limits,
) -> Result<Motion, MotionError> {
    check(from, "the present state")?;
    check(&Moment { velocity, ..Moment::default() }, "the velocity")?;
    check(&Moment::at_rest([valid_s, 0.0, 0.0]), "the time of validity")?;
    let used = limits.speed_use(&Moment { velocity, ..Moment::default() });
    let wanted = velocity.map(|value| value / used.max(1.0));
    let begin = in_body(from);
    let start = calculated(&towards(&begin, wanted, limits))?;
    let held_s = valid_s.max(start.get_duration());
    let reached = Profile(start.clone()).at(start.get_duration());
    let end = calculated(&towards(&Moment { pose: [0.0; AXES], ..reached }, [0.0; AXES], limits))?;
    let steps = ((held_s + end.get_duration()) / STEP_S).ceil();
    let (start, end) = (Profile(start), Profile(end));
    let body = |time: f64| match time {
        time if time < held_s => start.at(time.min(start.0.get_duration())),
        time => end.at((time - held_s).min(end.0.get_duration())),
    };
    let moments = integrate(from.pose, body, steps as usize);
    Ok(Motion { course: Course::Body(BodyMotion(moments)), duration_s: steps * STEP_S })
}

/// Velocity and acceleration as the body has them, at the pose zero: the acceleration is the rate
/// of the body velocity.
fn in_body(from: &Moment) -> Moment {
    let velocity = from.body_velocity();
    let turned = Moment { velocity: from.acceleration, ..*from }.body_velocity();
    let rate = velocity[2];
    let acceleration = [turned[0] + rate * velocity[1], turned[1] - rate * velocity[0], turned[2]];
    Moment { pose: [0.0; AXES], velocity, acceleration }
}

/// Moments at every [`STEP_S`] of a robot that begins at `pose` with the body velocity `body`, by
/// the midpoint rule.
fn integrate(mut pose: [f64; AXES], body: impl Fn(f64) -> Moment, steps: usize) -> Vec<Moment> {
    let mut moments = Vec::with_capacity(steps + 1);
    for step in 0..=steps {
        let time = step as f64 * STEP_S;
        let Moment { velocity: now, acceleration: rate, .. } = body(time);
        let turning = [rate[0] - now[2] * now[1], rate[1] + now[2] * now[0], rate[2]];
        moments.push(Moment {
            pose,
            velocity: in_world(pose[2], now),
            acceleration: in_world(pose[2], turning),
        });
        let middle = body(time + 0.5 * STEP_S).velocity;
        let moved = in_world(pose[2] + 0.5 * STEP_S * now[2], middle);
        pose = std::array::from_fn(|axis| pose[axis] + STEP_S * moved[axis]);
    }
    moments
}

fn in_world(yaw: f64, [forward, left, rate]: [f64; AXES]) -> [f64; AXES] {
    let (sin, cos) = yaw.sin_cos();
    [cos * forward - sin * left, sin * forward + cos * left, rate]
}

fn towards(from: &Moment, velocity: Velocity, limits: &Limits) -> InputParameter<AXES> {
    let mut input = input(from, limits);
    input.control_interface = ControlInterface::Velocity;
    input.target_velocity = axes(velocity);
    input
}

/// The motion of `input`, with limits that are lowered until the limits of body and wheels hold as
/// well. A state at the begin that is beyond them may stay so.
fn lowered(
    from: &Moment,
    limits: &Limits,
    input: impl Fn(&Limits) -> InputParameter<AXES>,
) -> Result<Motion, MotionError> {
    let allowed = [limits.speed_use_turned(from).max(1.0), limits.acceleration_use(from).max(1.0)];
    let mut factors = [1.0; 2];
    for attempt in 0..ATTEMPTS {
        let profile = Profile(calculated(&input(&limits.lowered(factors[0], factors[1])))?);
        let duration_s = profile.0.get_duration();
        let mut used = [0.0_f64; 2];
        for check in 0..=CHECKS {
            let moment = profile.at(duration_s * check as f64 / CHECKS as f64);
            used[0] = used[0].max(limits.speed_use(&moment) / allowed[0]);
            used[1] = used[1].max(limits.acceleration_use(&moment) / allowed[1]);
        }
        if used.iter().all(|&used| used <= 1.0 + SLACK) {
            return Ok(Motion { course: Course::Profile(Box::new(profile)), duration_s });
        }
        factors = if attempt + 2 >= ATTEMPTS {
            limits.worst_use()
        } else {
            std::array::from_fn(|i| factors[i] * (used[i] * OVERSHOOT).max(1.0))
        };
    }
    Err(MotionError::NotFound { reason: "the wheels would be too fast".into() })
}

/// From `from` to rest at the pose zero, within `limits`.
fn input(from: &Moment, limits: &Limits) -> InputParameter<AXES> {
    let (speed, rate) = (limits.speed_mps, limits.yaw_rate_radps);
    let (acceleration, yaw) = (limits.acceleration_mps2, limits.yaw_acceleration_radps2);
    let mut input = InputParameter::new(None);
    input.current_position = axes(from.pose);
    input.current_velocity = axes(from.velocity);
    input.current_acceleration = axes(from.acceleration);
    input.max_velocity = axes([speed, speed, rate]);
    input.max_acceleration = axes([acceleration, acceleration, yaw]);
    input.max_jerk = axes([limits.jerk_mps3, limits.jerk_mps3, limits.yaw_jerk_radps3]);
    input
}

fn calculated(input: &InputParameter<AXES>) -> Result<Trajectory<AXES>, MotionError> {
    let mut trajectory = Trajectory::new(None);
    Ruckig::<AXES, ThrowErrorHandler>::new(None, UNUSED_INTERVAL_S)
        .calculate(input, &mut trajectory)
        .map_err(|error| MotionError::NotFound { reason: error.to_string() })?;
    Ok(trajectory)
}

fn check(moment: &Moment, what: &str) -> Result<(), MotionError> {
    if moment.is_finite() { Ok(()) } else { Err(MotionError::NotFinite { what: what.into() }) }
}

fn axes(values: [f64; AXES]) -> DataArrayOrVec<f64, AXES> {
    DataArrayOrVec::Stack(values)
}

fn numbers(values: &DataArrayOrVec<f64, AXES>) -> [f64; AXES] {
    std::array::from_fn(|axis| values.get(axis).copied().unwrap_or(f64::NAN))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn limits() -> Limits {
        Limits::of(&robot::Robot::example())
    }

    /// Largest jump of pose and velocity between two moments that are `step` apart, beyond what
    /// velocity and acceleration explain.
    fn jump(motion: &Motion, step: f64) -> f64 {
        let steps = (motion.duration_s() / step) as usize + 2;
        let moments: Vec<Moment> = (0..steps).map(|i| motion.at(i as f64 * step)).collect();
        let jumps = moments.windows(2).flat_map(|pair| {
            let [a, b] = [pair[0], pair[1]];
            (0..AXES).map(move |axis| {
                let mean = 0.5 * (a.velocity[axis] + b.velocity[axis]);
                (b.pose[axis] - a.pose[axis] - step * mean).abs() / step
            })
        });
        jumps.fold(0.0, f64::max)
    }

    #[test]
    fn a_motion_between_poses_is_straight_and_ends_at_rest() -> Result<(), MotionError> {
        let motion = to_pose(&Moment::at_rest([1.0, 2.0, 3.0]), [4.0, -2.0, -3.0], &limits())?;
        let end = motion.at(motion.duration_s() + 1.0);
        assert!((end.pose[2] - (TAU - 3.0)).abs() < 1e-9, "by the shorter turn: {end:?}");
        for i in 0..=100 {
            let [x, y, _] = motion.at(motion.duration_s() * f64::from(i) / 100.0).pose;
            let aside = (-4.0 * (x - 1.0) - 3.0 * (y - 2.0)) / 5.0;
            assert!(aside.abs() < 1e-6, "{x} {y}");
        }
        Ok(())
    }

    #[test]
    fn a_velocity_turns_with_the_robot_and_ends_at_rest() -> Result<(), MotionError> {
        let motion = with_velocity(&Moment::default(), [0.5, 0.0, 0.5], 4.0, &limits())?;
        let middle = motion.at(3.0);
        let body = middle.body_velocity();
        assert!((body[0] - 0.5).abs() < 1e-6 && body[1].abs() < 1e-3, "{body:?}");
        assert!(middle.pose[1] > 0.1 && middle.pose[2] > 1.0, "{middle:?}");
        assert!(motion.at(motion.duration_s()).velocity.iter().all(|v| v.abs() < 1e-9));
        assert!(jump(&motion, 1e-3) < 4e-3);
        Ok(())
    }

    #[test]
    fn numbers_that_are_not_finite_are_named() {
        let bad = to_pose(&Moment::default(), [f64::NAN, 0.0, 0.0], &limits());
        assert_eq!(bad.err(), Some(MotionError::NotFinite { what: "the pose".into() }));
        let bad = with_velocity(&Moment::default(), [0.1; 3], f64::INFINITY, &limits());
        assert_eq!(bad.err(), Some(MotionError::NotFinite { what: "the time of validity".into() }));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]

        #[test]
        fn a_motion_begins_as_the_robot_moves_and_stays_within_the_limits(
            pose in prop::array::uniform3(-3.0..3.0_f64),
            velocity in prop::array::uniform3(-0.8..0.8_f64),
            target in prop::array::uniform3(-5.0..5.0_f64),
        ) {
            let limits = limits();
            let from = Moment { pose, velocity, ..Moment::default() };
            for motion in [to_pose(&from, target, &limits), to_standstill(&from, &limits)] {
                let motion = motion.map_err(|error| TestCaseError::fail(error.to_string()))?;
                let begin = motion.at(0.0);
                for axis in 0..AXES {
                    prop_assert!((begin.pose[axis] - pose[axis]).abs() < 1e-9);
                    prop_assert!((begin.velocity[axis] - velocity[axis]).abs() < 1e-9);
                }
                for i in 0..=500 {
                    let moment = motion.at(motion.duration_s() * f64::from(i) / 500.0);
                    let allowed = limits.speed_use_turned(&from).max(1.0);
                    prop_assert!(limits.speed_use(&moment) < 1.01 * allowed, "{moment:?}");
                    prop_assert!(limits.acceleration_use(&moment) < 1.02, "{moment:?}");
                }
                prop_assert!(jump(&motion, 1e-3) < 2e-2);
                let end = motion.at(motion.duration_s());
                prop_assert!(end.velocity.iter().all(|v| v.abs() < 1e-6));
            }
        }
    }
}
