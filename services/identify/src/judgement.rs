//! What an estimate is worth: prediction of motion that was held out, what the data do not tell,
//! and which motion would.

use crate::fit::{Estimate, Estimated};
use crate::log::{AXIS_NAMES, Log};
use crate::parameter::Parameter;
use crate::response::{Motion, Response, Simulation};
use robot::{AXES, Velocity, Wheels};

/// Interval above which a parameter is not told, per value.
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
pub fn untold(estimate: &Estimate) -> Vec<String> {
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
            _ => continue,
        };
        let is_wide = match parameter {
            Parameter::DeadTime(_) => *half_width > WIDE_S,
            _ => *half_width > WIDE * value.abs(),
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
        if estimate.response.acceleration[axis].is_infinite() {
            untold.push(format!(
                "largest acceleration, {name}: not reached; larger steps would tell"
            ));
        }
    }
    untold
}

/// Period, horizon and the profile whose weights fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Recommendation {
    /// T \[ms\].
    pub period_millis: f64,
    /// N \[periods\].
    pub horizon_steps: usize,
    /// Profile of `deploy/scenarios/profiles`.
    pub profile: &'static str,
}

/// Periods that are recommended \[ms\].
const PERIODS_MILLIS: [f64; 4] = [10.0, 20.0, 50.0, 100.0];
/// Longest recommended horizon \[periods\].
const HORIZON_MAX: usize = 40;

/// The period is at most half of the shortest time constant, so that the controller sees a response
/// while it happens, but not below 10 ms. The horizon covers the dead time and twice the longest
/// time constant, and has 5 to 40 periods.
pub fn recommendation(estimate: &Estimate) -> Recommendation {
    let moved = || (0..AXES).filter(|&axis| estimate.axes[axis]);
    let constant = |axis: usize| estimate.response.time_constant_s[axis];
    let shortest = moved().map(constant).fold(f64::INFINITY, f64::min);
    let longest = moved().map(constant).fold(0.0, f64::max);
    let dead = moved().map(|axis| estimate.response.dead_time_s[axis]).fold(0.0, f64::max);
    let fits = |period: &&f64| **period * 1e-3 <= 0.5 * shortest;
    let period_millis = PERIODS_MILLIS.iter().rev().find(fits).copied().unwrap_or(10.0);
    let horizon = ((dead + 2.0 * longest) / (period_millis * 1e-3)).ceil() as usize;
    Recommendation {
        period_millis,
        horizon_steps: horizon.clamp(5, HORIZON_MAX),
        profile: if period_millis < 50.0 { "agile" } else { "paper" },
    }
}
