//! Responses from which a fit starts: on each axis alone, the best of a grid.

use crate::log::Log;
use crate::response::Response;
use robot::AXES;

/// Dead times that are tried \[s\].
const DEAD_TIME_STEP_S: f64 = 0.01;
const DEAD_TIME_MAX_S: f64 = 0.5;
/// Time constants that are tried \[s\]: a geometric series.
const TIME_CONSTANT_MIN_S: f64 = 0.02;
const TIME_CONSTANT_FACTOR: f64 = 1.35;
const TIME_CONSTANTS: i32 = 15;
/// Integral parts that are tried \[1/s\].
const INTEGRALS_PER_S: [f64; 3] = [1.0, 2.5, 6.0];
/// Number of starts.
const STARTS: usize = 3;

/// One axis by itself.
#[derive(Debug, Clone, Copy, Default)]
struct Axis {
    cost: f64,
    dead_time_s: f64,
    time_constant_s: f64,
    integral_per_s: f64,
    gain: f64,
    offset: f64,
}

/// Starts with or without integral parts, the most promising first. On each axis they differ in the
/// dead time or in the integral part.
pub(crate) fn starts(log: &Log, axes: [bool; AXES], has_integral: bool) -> Vec<Response> {
    let integrals: &[f64] = if has_integral { &INTEGRALS_PER_S } else { &[0.0] };
    let mut starts = vec![Response::default(); STARTS];
    for axis in (0..AXES).filter(|&axis| axes[axis]) {
        let tried = dead_times().flat_map(|dead| {
            integrals.iter().map(move |&integral| best_with(log, axis, dead, integral))
        });
        let mut best: Vec<Axis> = tried.flatten().collect();
        best.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        let Some(first) = best.first().copied() else { continue };
        // The next ones are farther away than the grid is wide.
        let mut chosen = vec![first];
        for other in best {
            let is_apart = |one: &Axis| {
                let apart_s = (one.dead_time_s - other.dead_time_s).abs();
                apart_s > 2.5 * DEAD_TIME_STEP_S || one.integral_per_s != other.integral_per_s
            };
            if chosen.iter().all(is_apart) {
                chosen.push(other);
            }
        }
        for (start, axis_start) in starts.iter_mut().zip(chosen.iter().cycle()) {
            start.gain[axis][axis] = axis_start.gain;
            start.offset[axis] = if has_integral { 0.0 } else { axis_start.offset };
            start.time_constant_s[axis] = axis_start.time_constant_s;
            start.dead_time_s[axis] = axis_start.dead_time_s;
            start.integral_per_s[axis] = axis_start.integral_per_s;
        }
    }
    starts
}

fn dead_times() -> impl Iterator<Item = f64> {
    let count = (DEAD_TIME_MAX_S / DEAD_TIME_STEP_S) as usize;
    (0..=count).map(|number| number as f64 * DEAD_TIME_STEP_S)
}

/// The best time constant, gain and offset with this dead time and integral part.
fn best_with(log: &Log, axis: usize, dead_time_s: f64, integral_per_s: f64) -> Option<Axis> {
    let constants =
        (0..TIME_CONSTANTS).map(|power| TIME_CONSTANT_MIN_S * TIME_CONSTANT_FACTOR.powi(power));
    let tried = constants.filter_map(|time_constant_s| {
        with(log, axis, Axis { dead_time_s, time_constant_s, integral_per_s, ..Axis::default() })
    });
    tried.min_by(|a, b| a.cost.total_cmp(&b.cost))
}

/// v = gain · s + offset by least squares, where s is the response of the axis with gain 1.
fn with(log: &Log, axis: usize, tried: Axis) -> Option<Axis> {
    let period = log.period_s;
    let decay = (-period / tried.time_constant_s).exp();
    let periods = tried.dead_time_s / period;
    let (whole, part) = (periods.floor() as usize, periods.fract());
    let [mut n, mut s, mut v, mut ss, mut sv, mut vv] = [0.0; 6];
    for stretch in &log.stretches {
        let (mut shape, mut integral) = (0.0, 0.0);
        for (number, sample) in stretch.iter().enumerate().skip(whole + 2) {
            let input = (1.0 - part) * stretch[number - whole].input[axis]
                + part * stretch[number - whole - 1].input[axis];
            let before = shape;
            shape = decay * shape + (1.0 - decay) * (input + integral);
            integral += period * tried.integral_per_s * (input - 0.5 * (before + shape));
            let velocity = sample.velocity[axis];
            n += 1.0;
            s += shape;
            v += velocity;
            ss += shape * shape;
            sv += shape * velocity;
            vv += velocity * velocity;
        }
    }
    let (ss, sv, vv) = (ss - s * s / n, sv - s * v / n, vv - v * v / n);
    let gain = sv / ss;
    let offset = (v - gain * s) / n;
    let cost = (vv - gain * sv) / n;
    let is_finite = gain.is_finite() && offset.is_finite() && cost.is_finite();
    is_finite.then_some(Axis { cost, gain, offset, ..tried })
}
