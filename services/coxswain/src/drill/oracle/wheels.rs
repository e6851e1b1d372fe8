//! Rules a to d: what the wheels got, in one plant epoch.

use super::{Limits, OLDEST_PERIODS, Rule, Ticks, Violation};
use crate::drill::record::Message;

/// Rounding, and what a wheel's noise-free command may be off by, relative.
const TOLERANCE: f64 = 1e-6;
/// Steps of one period's change that may lie between two looks at the wheels: onto a tail, and from it onto the next plan. A tenth on top,
/// since a change is planned from the mean of a period and begins at its end.
const STEPS: f64 = 2.2;
/// Grain of the ramp in time: the gate of the simulator decides every 2 ms, and a look may fall before or behind it \[s\].
const GRAIN_S: f64 = 0.005;

/// Ticks at least between the answers of two writers of one epoch.
const SILENT_TICKS: u64 = 2;

pub(super) fn judge(
    epoch: u64,
    truths: &Ticks<'_>,
    limits: &Limits,
    violations: &mut Vec<Violation>,
) {
    let (mut highest, mut last) = (0, None);
    for (&tick, truth) in truths {
        let mut violate = |rule, found: String, expected: String| {
            violations.push(Violation { rule, epoch, tick, found, expected });
        };
        judge_values(truth, limits, &mut violate);
        let age_periods = truth.count("acting_age_nanos") as f64 * 1e-9 / limits.period_s;
        let answered = truth.count("acting_tick");
        let acting = truth.count("acting_epoch");
        let age_periods =
            if acting > 0 { age_periods.max(tick as f64 - answered as f64) } else { age_periods };
        if age_periods > OLDEST_PERIODS + TOLERANCE {
            violate(
                Rule::Age,
                format!("an answer to a state {age_periods:.2} T old acted"),
                format!("{OLDEST_PERIODS} T at most"),
            );
        }
        if acting > 0 && answered > tick {
            violate(
                Rule::Age,
                format!("an answer to tick {answered} acts"),
                "one to a tick that has been".to_owned(),
            );
        }
        let (takeovers, back) = (truth.count("takeovers"), truth.count("takeovers_back"));
        if takeovers > 1 || back > 0 {
            violate(
                Rule::Epoch,
                format!("{takeovers} takeovers in a period, {back} of them back"),
                "one at most, to a greater epoch".to_owned(),
            );
        }
        if acting > 0 && acting < highest {
            violate(
                Rule::Epoch,
                format!("epoch {acting} acts after {highest}"),
                "never a smaller one".to_owned(),
            );
        }
        highest = highest.max(acting);
        // Before another writer of the same epoch is heard, the first was silent for 3 T; its answer may be to a state that is 1.5 T old.
        if let Some((epoch, writer, before)) = last.filter(|_| acting > 0)
            && epoch == acting
            && writer != truth.count("acting_writer")
            && answered < before + SILENT_TICKS
        {
            violate(
                Rule::Epoch,
                format!(
                    "of epoch {epoch}, writer {writer} acted until tick {before}, and another from tick {answered} on"
                ),
                "another one only after a silence of 3 T".to_owned(),
            );
        }
        if acting > 0 {
            last = Some((acting, truth.count("acting_writer"), answered));
        }
        if let Some(before) = tick.checked_sub(1).and_then(|before| truths.get(&before)) {
            judge_change(before, truth, limits, &mut violate);
        }
    }
}

/// Rule a, of one moment and of the period before it.
fn judge_values(truth: &Message, limits: &Limits, violate: &mut impl FnMut(Rule, String, String)) {
    for field in ["wheel_command", "wheel_peak"] {
        let wheels = truth.numbers(field);
        // What is not finite is recorded as null.
        if wheels.len() != 4 {
            violate(
                Rule::Finite,
                format!("{field} {}", truth.says[field]),
                "four finite numbers".to_owned(),
            );
        }
        if let Some(wheel) =
            wheels.iter().find(|wheel| wheel.abs() > limits.wheel_radps * (1.0 + TOLERANCE))
        {
            violate(
                Rule::Bounds,
                format!("{field} of {wheel:.3} rad/s"),
                format!("{} rad/s at most", limits.wheel_radps),
            );
        }
    }
}

/// Rules a and d, from one period's start to the next.
fn judge_change(
    before: &Message,
    now: &Message,
    limits: &Limits,
    violate: &mut impl FnMut(Rule, String, String),
) {
    let (Some(from), Some(to)) = (body(before, limits), body(now, limits)) else { return };
    let by_itself = |truth: &Message| truth.count("acting_epoch") == 0;
    for axis in 0..3 {
        let (from, to) = (from[axis], to[axis]);
        if by_itself(before) && by_itself(now) && now.count("acting_age_nanos") == 0 {
            // The same sign, and smaller by the ramp, until it stands.
            let left =
                (from.abs() - limits.brake[axis] * (limits.period_s - GRAIN_S).max(0.0)).max(0.0);
            if to.abs() > left + TOLERANCE || from * to < -TOLERANCE {
                violate(
                    Rule::Ramp,
                    format!("axis {axis} commanded {from:.3}, then {to:.3}"),
                    format!("{left:.3} at most while nothing acts"),
                );
            }
        } else {
            // Of a period that ends on the brake, a part may have been a command's.
            let ramp =
                if by_itself(now) { limits.brake[axis] * (limits.period_s + GRAIN_S) } else { 0.0 };
            let most = limits.rate[axis] * limits.period_s * STEPS + ramp;
            if (to - from).abs() > most * (1.0 + TOLERANCE) {
                violate(
                    Rule::Rate,
                    format!("axis {axis} commanded {from:.3}, then {to:.3}"),
                    format!("a change of {most:.3} at most"),
                );
            }
        }
    }
}

/// Body velocity of the wheels' command, r J⁺ ω: forward, left, yaw \[m/s, m/s, rad/s\]. Wheels: front-right, front-left, rear-left, rear-right.
pub(super) fn body(truth: &Message, limits: &Limits) -> Option<[f64; 3]> {
    let wheels = truth.numbers("wheel_command");
    let &[front_right, front_left, rear_left, rear_right] = wheels.as_slice() else { return None };
    let quarter = limits.wheel_radius_m / 4.0;
    Some([
        quarter * (front_right + front_left + rear_left + rear_right),
        quarter * (front_right - front_left + rear_left - rear_right),
        quarter / limits.lever_m * (front_right - front_left - rear_left + rear_right),
    ])
}
