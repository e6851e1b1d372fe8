//! What an estimate is worth: prediction of motion that was held out, what the data do not tell,
//! and which motion would.

use crate::fit::Estimated;
use crate::log::{AXIS_NAMES, Log};
use crate::numbers::Known;
use crate::parameter::Parameter;
use crate::response::{Motion, Response, Simulation};
use robot::{AXES, Velocity, Wheels};

/// Interval above which a parameter is not told, per value; of coupled axes, in m/s and rad/s.
const WIDE: f64 = 0.25;
/// The same for a dead time \[s\].
const WIDE_S: f64 = 0.02;

/// RMS of the prediction error `steps` periods ahead, from each sample after the first `share` of
/// its stretch; not a number if there is none \[m/s, m/s, rad/s\].
pub fn prediction_error(
    log: &Log,
    share: f64,
    wheels: &Wheels,
    response: &Response,
    steps: usize,
) -> Velocity {
    let (mut sums, mut count) = ([0.0; AXES], 0.0);
    for stretch in &log.stretches {
        let simulation = Simulation::new(wheels, stretch, log.period_s);
        // The integral parts are not measured: they are those of a simulation until then.
        let whole = simulation.whole(response);
        let first = ((share * stretch.len() as f64) as usize).max(1);
        for from in first..stretch.len().saturating_sub(steps) {
            let integral = whole[from - 1].integral;
            let begin = Motion { velocity: stretch[from].velocity, integral };
            let run = simulation.run(response, begin, from, steps);
            let Some(last) = run.last() else { continue };
            for axis in 0..AXES {
                let error = stretch[from + steps].velocity[axis] - last.velocity[axis];
                sums[axis] += error * error;
            }
            count += 1.0;
        }
    }
    sums.map(|sum: f64| (sum / count).sqrt())
}

/// What the data do not tell, each with the motion that would.
pub fn untold(known: &Known<'_>) -> Vec<String> {
    let estimate = known.estimate;
    let mut untold: Vec<String> = (0..AXES)
        .filter(|&axis| !estimate.axes[axis])
        .map(|axis| {
            let name = AXIS_NAMES[axis];
            format!(
                "{name}: the input does not move this axis; steps of the input {name} would tell"
            )
        })
        .collect();
    if !estimate.is_converged {
        untold.push("the fit did not end at a minimum: do not trust it".to_owned());
    }
    for Estimated { parameter, value, half_width } in &estimate.parameters {
        let needed = match parameter {
            Parameter::Gain(axis, other) if axis == other => {
                "steps that last several time constants"
            }
            Parameter::TimeConstant(_) => "more or larger steps",
            Parameter::DeadTime(_) => "more or larger steps, or a shorter period",
            Parameter::Gain(..) | Parameter::Cross(..) => "more steps on both axes at once",
            _ => "more motion of every kind",
        };
        let is_wide = match parameter {
            Parameter::DeadTime(_) => *half_width > WIDE_S,
            Parameter::Gain(axis, other) if axis != other => *half_width > WIDE,
            Parameter::Cross(..) => *half_width > WIDE,
            Parameter::Gain(..) | Parameter::TimeConstant(_) => *half_width > WIDE * value.abs(),
            // Often 0, and known to be small.
            _ => false,
        };
        // A number that is not a number is not told either.
        if is_wide || !half_width.is_finite() {
            untold.push(format!(
                "{parameter}: {value:.3} ± {half_width:.3} {}; {needed} would tell",
                parameter.unit()
            ));
        }
    }
    for (axis, name) in AXIS_NAMES.iter().enumerate().filter(|(axis, _)| estimate.axes[*axis]) {
        let limits = [
            ("acceleration", estimate.response.acceleration[axis]),
            ("deceleration", estimate.response.braking[axis]),
        ];
        for (what, _) in limits.iter().filter(|(_, limit)| limit.is_infinite()) {
            untold.push(format!(
                "largest {what}, {name}: the motion does not reach it; larger steps would tell"
            ));
        }
        if known.input_from_rest(axis).is_none() {
            untold.push(format!(
                "static friction and dead band, {name}: no more than the dry friction is seen; an \
                 input that rises slowly from rest would tell"
            ));
        }
    }
    if known.wheels.count() > 0 && estimate.response.saturation_mps.is_infinite() {
        untold.push(
            "saturation of the drives: the motion does not reach it; larger steps would tell"
                .to_owned(),
        );
    }
    untold.extend(untold_of_sensors(known));
    untold
}

fn untold_of_sensors(known: &Known<'_>) -> Vec<String> {
    let sensors = known.sensors;
    let mut untold = Vec::new();
    if sensors.latency_s.is_none() {
        untold.push(
            "latency of the velocity behind the pose: larger accelerations would tell".to_owned(),
        );
    }
    match sensors.per_wheels {
        None => untold.push(
            "radius and lever of the wheels: measured speeds of wheels beside the pose would tell"
                .to_owned(),
        ),
        Some(ratios) => {
            for (axis, ratio) in ratios.iter().enumerate() {
                if ratio.is_some() || !known.estimate.axes[axis] {
                    continue;
                }
                let name = AXIS_NAMES[axis];
                untold.push(format!(
                    "velocity by poses per velocity by wheels, {name}: longer motion {name} would \
                     tell"
                ));
            }
        }
    }
    untold
}
