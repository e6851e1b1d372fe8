//! Which data cannot be used: too little, no motion, or units that contradict each other.

use super::{AXIS_NAMES, Log, LogError, Sample, Stretch};
use robot::{AXES, Velocity, Wheels};
use std::path::Path;

/// Least data that an estimate needs \[s\].
const USABLE_MIN_S: f64 = 10.0;
/// Least length of a stretch \[s\].
pub(super) const STRETCH_MIN_S: f64 = 2.0;
/// Speed below which the robot stands, rms: forward, left, yaw \[m/s, m/s, rad/s\].
pub(crate) const STANDING: Velocity = [0.01, 0.01, 0.02];
/// Largest ratio of two measurements of one speed.
const SAME_UNIT: f64 = 3.0;
/// Largest ratio of input and velocity.
const SAME_INPUT_UNIT: f64 = 30.0;

pub(super) fn check(log: &Log) -> Result<(), LogError> {
    if log.duration_s() < USABLE_MIN_S {
        return Err(LogError::TooShort {
            usable_s: log.duration_s(),
            least_s: USABLE_MIN_S,
            notes: log.notes.clone(),
        });
    }
    let velocity = log.speed();
    let from_pose = rms(&log.stretches, log.period_s, from_poses);
    let moves = |speeds: &Velocity| (0..AXES).any(|axis| speeds[axis] > STANDING[axis]);
    if !moves(&velocity) && !moves(&from_pose) {
        return Err(LogError::NoMotion {
            speed_mps: velocity[0].hypot(velocity[1]),
            yaw_rate_radps: velocity[2],
        });
    }
    if super::moved(log) == [false; AXES] {
        return Err(LogError::NoInput);
    }
    log.by_file().try_for_each(|(path, stretches)| check_units(path, stretches, log.period_s))
}

/// Whether pose, velocity and input of one file have the same units.
fn check_units(path: &Path, stretches: &[Stretch], period_s: f64) -> Result<(), LogError> {
    let velocity = rms(stretches, period_s, |_, sample| sample.velocity);
    let input = rms(stretches, period_s, |_, sample| sample.input);
    let from_pose = rms(stretches, period_s, from_poses);
    for axis in 0..AXES {
        let (velocity, from_pose, input) = (velocity[axis], from_pose[axis], input[axis]);
        let (path, name) = (path.to_owned(), AXIS_NAMES[axis]);
        let factor = velocity / from_pose;
        let is_moving = velocity.max(from_pose) > 10.0 * STANDING[axis];
        if is_moving && !(1.0 / SAME_UNIT..=SAME_UNIT).contains(&factor) {
            return Err(LogError::Unit { path, axis: name, factor, velocity, from_pose });
        }
        let factor = input / velocity;
        // An axis without input may be moved by the others.
        let is_moving = input > STANDING[axis] && velocity.max(input) > 10.0 * STANDING[axis];
        if is_moving && !(1.0 / SAME_INPUT_UNIT..=SAME_INPUT_UNIT).contains(&factor) {
            return Err(LogError::InputUnit { path, axis: name, factor, input, velocity });
        }
    }
    Ok(())
}

pub(super) fn check_wheels(log: &Log, wheels: &Wheels) -> Result<(), LogError> {
    let (found, expected) = (log.wheels, wheels.count());
    // The file of a robot that takes a body velocity does not describe its wheels.
    if found == 0 || expected == 0 {
        return Ok(());
    }
    if found != expected {
        return Err(LogError::WheelCount { found, expected, source_of: "as in the robot file" });
    }
    let mut files = log.by_file();
    files.try_for_each(|(path, stretches)| check_speeds(path, stretches, log.period_s, wheels))
}

/// Whether the wheel speeds of one file give its velocity.
fn check_speeds(
    path: &Path,
    stretches: &[Stretch],
    period_s: f64,
    wheels: &Wheels,
) -> Result<(), LogError> {
    let speeds = |sample: &Sample| sample.wheel_speed.map(|speeds| wheels.body(&speeds));
    let by_wheels = rms(stretches, period_s, |_, sample| speeds(sample).unwrap_or_default());
    let velocity = rms(stretches, period_s, |_, sample| {
        speeds(sample).map_or([0.0; AXES], |_| sample.velocity)
    });
    for axis in 0..AXES {
        let (by_wheels, velocity) = (by_wheels[axis], velocity[axis]);
        let factor = by_wheels / velocity;
        let is_moving = by_wheels.max(velocity) > 10.0 * STANDING[axis];
        if is_moving && !(1.0 / SAME_UNIT..=SAME_UNIT).contains(&factor) {
            let (path, axis) = (path.to_owned(), AXIS_NAMES[axis]);
            return Err(LogError::WheelUnit { path, axis, factor, by_wheels, velocity });
        }
    }
    Ok(())
}

/// Body velocity between two samples by their poses. Noise of the pose counts much at a short
/// period, so this takes samples a fifth of a second apart.
fn from_poses(before: &Sample, sample: &Sample) -> Velocity {
    let time = sample.time_s - before.time_s;
    let turn = sample.pose[2] - before.pose[2];
    let turn = turn.sin().atan2(turn.cos());
    let (sin, cos) = (before.pose[2] + 0.5 * turn).sin_cos();
    let [x, y] = [0, 1].map(|axis| (sample.pose[axis] - before.pose[axis]) / time);
    [cos * x + sin * y, cos * y - sin * x, turn / time]
}

/// Root mean square of a value of `stretches`, from two samples a fifth of a second apart.
pub(crate) fn rms(
    stretches: &[Stretch],
    period_s: f64,
    value: impl Fn(&Sample, &Sample) -> Velocity,
) -> Velocity {
    let apart = ((0.2 / period_s) as usize).max(1);
    let (mut sums, mut count) = ([0.0; AXES], 0.0);
    for stretch in stretches {
        for (before, sample) in stretch.iter().zip(stretch.iter().skip(apart)) {
            let value = value(before, sample);
            (0..AXES).for_each(|axis| sums[axis] += value[axis] * value[axis]);
            count += 1.0;
        }
    }
    sums.map(|sum: f64| (sum / f64::max(count, 1.0)).sqrt())
}
