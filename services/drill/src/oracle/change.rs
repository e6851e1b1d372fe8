//! Rules a and d, for two instants a period apart: how far the wheel command moves between them.
//!
//! Notation:
//!
//! - w_k: body velocity that is commanded at the end of the period before tick k
//! - m_a: the gate's mean output in the period before tick a, as its state reports it
//! - c: change that the robot file permits in one period, rate × T
//!
//! A controller that answers the state of tick a starts from m_a, because the state contains all
//! that it knows of the gate: |input − m_a| ≤ c. Each entry of its tail is at most c from the one
//! before. Entry i acts while the state is i periods old, with the input as entry 0. So
//!
//! | what acts at w_{k+1}                     | bound of abs(w_{k+1} − w_k), per axis    |
//! |------------------------------------------|------------------------------------------|
//! | the next entry of the same command       | c                                        |
//! | entry i of another command, to tick a    | (1 + i) c + abs(m_a − w_k)               |
//! | the brake, for the whole period          | ramp × (T + grain)                       |
//! | the brake, after a command of the period | c + ramp × (T + grain)                   |
//!
//! A command that answers in time has i = 0, so its only slack is m_k − w_k. The record shows that
//! the controller could not know it. It is zero where one input acted for the whole period before.
//!
//! The same holds for each wheel, |Δω| ≤ Σ |J| bound / r. This also catches wheel commands that are
//! no body velocity at all.
//!
//! If a link changes the numbers of a command, the controller is not responsible for the acting
//! command. Then only the gate is judged: rule `Leap`, with the 2.2 changes of decision 22.

use super::{Limits, Rule, Ticks, Violation};
use crate::record::Message;
use robot::PerWheel;

/// Tolerance of the optimiser's rows, relative to their bound, and of rounding \[m/s, rad/s\].
const TOLERANCE: f64 = 1e-5;
/// The gate decides every 2 ms. The last decision of a period may be that long before its end
/// \[s\].
const GRAIN_S: f64 = 0.002;
/// Changes of one period that the gate permits for any sender (decision 22).
const LEAP: f64 = 2.2;

/// Judges every pair of consecutive ticks of one plant epoch.
pub(super) fn judge(
    epoch: u64,
    truths: &Ticks<'_>,
    states: &Ticks<'_>,
    limits: &Limits,
    violations: &mut Vec<Violation>,
) {
    for (&tick, now) in truths {
        let Some(before) = tick.checked_sub(1).and_then(|before| truths.get(&before)) else {
            continue;
        };
        let (Some(from), Some(to)) = (body(before, limits), body(now, limits)) else { continue };
        let mut violate = |rule, found: String, expected: String| {
            violations.push(Violation { rule, epoch, tick, found, expected });
        };
        if is_braking(now) {
            judge_ramp(&from, &to, limits, &mut violate);
        }
        let step = Step { tick, before, now, from, to };
        if let Some(bound) = bound(&step, states, limits) {
            judge_rate(&step, &bound, limits, &mut violate);
        }
        judge_leap(&step, limits, &mut violate);
    }
}

/// Two samples of the wheel command, a period apart.
struct Step<'a> {
    /// Tick of the later sample.
    tick: u64,
    before: &'a Message,
    now: &'a Message,
    /// Commanded body velocities \[m/s, m/s, rad/s\].
    from: [f64; 3],
    to: [f64; 3],
}

/// Whether no command determines what the wheels get.
fn is_by_itself(truth: &Message) -> bool {
    truth.count("acting_epoch") == 0
}

/// Whether no command acted in any part of the past period.
fn is_braking(truth: &Message) -> bool {
    is_by_itself(truth) && truth.count("acting_age_nanos") == 0
}

/// The largest change per axis; none if the record lacks the necessary messages.
fn bound(step: &Step<'_>, states: &Ticks<'_>, limits: &Limits) -> Option<[f64; 3]> {
    let Step { tick, before, now, from, .. } = step;
    let change = limits.rate.map(|rate| rate * limits.period_s);
    let ramp = limits.brake.map(|brake| brake * (limits.period_s + GRAIN_S));
    if is_braking(now) {
        return Some(ramp);
    }
    if is_by_itself(now) {
        return Some(std::array::from_fn(|axis| change[axis] + ramp[axis]));
    }
    let command = |truth: &Message| {
        ["acting_epoch", "acting_writer", "acting_tick"].map(|field| truth.count(field))
    };
    if command(before) == command(now) {
        return Some(change);
    }
    if !limits.at_once {
        return None; // the present wheel command was decided one dead time ago
    }
    let answered = now.count("acting_tick");
    let entry = (tick - 1).checked_sub(answered)? as f64;
    let known: [f64; 3] = states.get(&answered)?.numbers("input").try_into().ok()?;
    Some(std::array::from_fn(|axis| {
        (1.0 + entry) * change[axis] + (known[axis] - from[axis]).abs()
    }))
}

/// The same sign, and smaller by the ramp, until the robot stands.
fn judge_ramp(
    from: &[f64; 3],
    to: &[f64; 3],
    limits: &Limits,
    violate: &mut impl FnMut(Rule, String, String),
) {
    for axis in 0..3 {
        let (from, to) = (from[axis], to[axis]);
        let ramp = limits.brake[axis] * (limits.period_s - GRAIN_S).max(0.0);
        let left = (from.abs() - ramp).max(0.0);
        if to.abs() > left + TOLERANCE || from * to < -TOLERANCE {
            violate(
                Rule::Ramp,
                format!("axis {axis} commanded {from:.3}, then {to:.3}"),
                format!("{left:.3} at most while nothing acts"),
            );
        }
    }
}

/// Each axis of the body, and each wheel.
fn judge_rate(
    step: &Step<'_>,
    bound: &[f64; 3],
    limits: &Limits,
    violate: &mut impl FnMut(Rule, String, String),
) {
    let Step { before, now, from, to, .. } = step;
    for axis in 0..3 {
        let (from, to, most) = (from[axis], to[axis], bound[axis]);
        if (to - from).abs() > most + TOLERANCE {
            violate(
                Rule::Rate,
                format!("axis {axis} commanded {from:.3}, then {to:.3}"),
                format!("a change of {most:.3} at most"),
            );
        }
    }
    let wheels = |truth: &Message| truth.numbers("wheel_command");
    let rows = limits.wheels.rows().iter().zip(limits.wheels.radii_m());
    let commands = wheels(before).into_iter().zip(wheels(now));
    for (wheel, ((from, to), (row, radius))) in commands.zip(rows).enumerate() {
        let most = row.iter().zip(bound).map(|(by, bound)| by.abs() * bound).sum::<f64>() / radius;
        if (to - from).abs() > most + TOLERANCE / radius {
            violate(
                Rule::Rate,
                format!("wheel {wheel} commanded {from:.3} rad/s, then {to:.3}"),
                format!("a change of {most:.3} rad/s at most"),
            );
        }
    }
}

/// What the gate guarantees for any command.
fn judge_leap(step: &Step<'_>, limits: &Limits, violate: &mut impl FnMut(Rule, String, String)) {
    for axis in 0..3 {
        let (from, to) = (step.from[axis], step.to[axis]);
        let most = limits.rate[axis] * limits.period_s * LEAP;
        if !is_braking(step.now) && (to - from).abs() > most + TOLERANCE {
            violate(
                Rule::Leap,
                format!("axis {axis} commanded {from:.3}, then {to:.3}"),
                format!("a change of {most:.3} at most, for every command"),
            );
        }
    }
}

/// Body velocity of the wheel command: forward, left, yaw \[m/s, m/s, rad/s\].
pub(crate) fn body(truth: &Message, limits: &Limits) -> Option<[f64; 3]> {
    let wheels = truth.numbers("wheel_command");
    let mut speeds = PerWheel::default();
    speeds.get_mut(..wheels.len())?.copy_from_slice(&wheels);
    (wheels.len() == limits.wheels.count()).then(|| limits.wheels.body(&speeds))
}
