//! Rules a to c: the wheel commands of one plant epoch, tick by tick.

use super::{Limits, OLDEST_PERIODS, Rule, Ticks, Violation};
use crate::record::Message;

/// Rounding, and the permitted error of a wheel's noise-free command, relative.
const TOLERANCE: f64 = 1e-6;
/// Smallest number of ticks between the answers of two writers of one epoch.
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
        // A second writer of the same epoch is obeyed after the first was silent for 3 T. Its
        // answer may be to a state that is 1.5 T old.
        if let Some((epoch, writer, before)) = last.filter(|_| acting > 0)
            && epoch == acting
            && writer != truth.count("acting_writer")
            && answered < before + SILENT_TICKS
        {
            violate(
                Rule::Epoch,
                format!(
                    "of epoch {epoch}, writer {writer} acted until tick {before}, \
                     and another from tick {answered} on"
                ),
                "another one only after a silence of 3 T".to_owned(),
            );
        }
        if acting > 0 {
            last = Some((acting, truth.count("acting_writer"), answered));
        }
    }
}

/// Rule a, for one instant and the period before it.
fn judge_values(truth: &Message, limits: &Limits, violate: &mut impl FnMut(Rule, String, String)) {
    for field in ["wheel_command", "wheel_peak"] {
        let wheels = truth.numbers(field);
        // A number that is not finite is recorded as null.
        if wheels.len() != limits.wheels.count() {
            violate(
                Rule::Finite,
                format!("{field} {}", truth.fields[field]),
                format!("{} finite numbers", limits.wheels.count()),
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
