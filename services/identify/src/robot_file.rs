//! The robot file: wheels and limits of the file that was given, with the identified response.

use crate::fit::Estimate;
use crate::log::{AXIS_NAMES, Log};
use crate::numbers::Known;
use crate::parameter::Parameter;
use crate::tuned::Recommendation;
use model::main_model::MainModel;
use robot::{AXES, Response, Robot};
use std::fmt::Write;

/// The response of a robot file that gives it by masses and motors.
pub fn stated(robot: &Robot) -> Response {
    if let Some(response) = robot.response {
        return response;
    }
    let period = 1e-3;
    let model = MainModel::new(robot, period);
    Response {
        gain: std::array::from_fn(|axis| model.gain[axis] / (1.0 - model.decay[axis])),
        time_constant_s: model.decay.map(|decay| -period / decay.ln()),
        dead_time_s: 0.0,
        wheel_speed_limit_radps: None,
    }
}

/// The given robot with the identified response. Axes that were not moved, and parameters that the
/// data do not tell at all, keep what the file says.
pub fn robot(given: &Robot, estimate: &Estimate) -> Robot {
    let mut response = stated(given);
    for axis in 0..AXES {
        if let Some(gain) = told(estimate, Parameter::Gain(axis, axis)) {
            response.gain[axis] = rounded(gain);
        }
        if let Some(constant) = told(estimate, Parameter::TimeConstant(axis)) {
            response.time_constant_s[axis] = rounded(constant);
        }
    }
    if let Some(dead_time) = dead_time_s(estimate) {
        response.dead_time_s = rounded(dead_time.max(0.0));
    }
    let limit = given.wheel_speed_limit_radps();
    response.wheel_speed_limit_radps = limit.is_finite().then_some(limit);
    Robot { body: None, drive: None, response: Some(response), ..*given }
}

/// The value of a parameter whose interval is narrower than the value itself.
fn told(estimate: &Estimate, parameter: Parameter) -> Option<f64> {
    let found = estimate.of(parameter)?;
    (found.half_width < found.value.abs()).then_some(found.value)
}

/// Mean dead time of all axes, each by its precision: the robot file has one. None if the data do
/// not tell it \[s\].
fn dead_time_s(estimate: &Estimate) -> Option<f64> {
    let (mut sum, mut weights) = (0.0, 0.0);
    for axis in 0..AXES {
        let found = estimate.of(Parameter::DeadTime(axis));
        if let Some(dead) = found.filter(|dead| dead.half_width < UNTOLD_S) {
            let weight = 1.0 / (dead.half_width * dead.half_width).max(1e-12);
            sum += weight * dead.value;
            weights += weight;
        }
    }
    (weights > 0.0).then(|| sum / weights)
}

/// Interval of a dead time that tells nothing \[s\].
const UNTOLD_S: f64 = 0.1;

/// Four digits, which is more than any interval allows.
fn rounded(value: f64) -> f64 {
    format!("{value:.3e}").parse().unwrap_or(value)
}

/// The text of the file.
///
/// # Errors
/// If the robot cannot be written as TOML.
pub fn text(
    robot: &Robot,
    known: &Known<'_>,
    untold: &[String],
    (log, source): (&Log, &str),
    recommended: &Recommendation,
) -> Result<String, toml::ser::Error> {
    let estimate = known.estimate;
    let mut text = format!(
        "# Identified by `coxswain identify` from {source}: {:.0} s at {:.0} ms.\n\
         # Wheels and limits are those of the robot file that was given.\n#\n\
         # With 95 % intervals:\n",
        log.duration_s(),
        1e3 * log.period_s
    );
    for axis in (0..AXES).filter(|&axis| estimate.axes[axis]) {
        let number = |parameter: Parameter| {
            estimate.of(parameter).map_or_else(
                || "-".to_owned(),
                |found| format!("{:.4} ± {:.4}", found.value, found.half_width),
            )
        };
        let _ = writeln!(
            text,
            "#   {}: gain {}, time constant {} s, dead time {} s, dry friction {} {}",
            AXIS_NAMES[axis],
            number(Parameter::Gain(axis, axis)),
            number(Parameter::TimeConstant(axis)),
            number(Parameter::DeadTime(axis)),
            number(Parameter::Friction(axis)),
            Parameter::Friction(axis).unit(),
        );
    }
    text.push_str(
        "#\n# Measured as well. The wheels and limits below stay as they were given: see \
         docs/how-to/identify-a-robot.md.\n",
    );
    for number in known.coupling().iter().chain(&known.others()) {
        let _ = writeln!(text, "#   {number}");
    }
    text.push_str("#\n");
    for line in untold {
        let _ = writeln!(text, "# Not told by the data: {line}.");
    }
    let _ = writeln!(
        text,
        "#\n# Recommended: period_millis = {}, mpc.horizon_steps = {}, weights of the profile \
         {}.\n",
        recommended.period_millis, recommended.horizon_steps, recommended.profile
    );
    text.push_str(&toml::to_string(robot)?);
    Ok(text)
}
