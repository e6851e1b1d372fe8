//! The live line: simulated time, position error, model, tick time, and unusual states.

use crate::watch::PlanView;
use protocol::message::FallbackLevel;
use std::fmt::Write;

/// One line about the run.
pub fn line(plan: &PlanView, period_nanos: u64, duration_s: f64, restarts: u64) -> String {
    let seconds = plan.tick as f64 * period_nanos as f64 * 1e-9;
    let mut line =
        format!("{seconds:6.1} of {duration_s:.1} s   error {:6.3} m   ", plan.position_error);
    // Writing to a String never fails.
    let _ = match plan.model_version {
        0 => write!(line, "main model"),
        version => write!(line, "model {version:4}"),
    };
    let _ = write!(line, "   tick {:5.0} µs", plan.tick_nanos as f64 * 1e-3);
    if plan.fallback_level != FallbackLevel::FreshPlan {
        let _ = write!(line, "   {}", plan.fallback_level);
    }
    if restarts > 0 {
        let _ = write!(line, "   restarts {restarts}");
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_line_shows_unusual_states_only_when_present() {
        let mut plan = PlanView {
            tick: 123,
            position_error: 0.0432,
            model_version: 7,
            tick_nanos: 412_300,
            fallback_level: FallbackLevel::FreshPlan,
        };
        assert_eq!(
            line(&plan, 100_000_000, 25.0, 0),
            "  12.3 of 25.0 s   error  0.043 m   model    7   tick   412 µs"
        );
        plan.fallback_level = FallbackLevel::Simple;
        plan.model_version = 0;
        let line = line(&plan, 100_000_000, 25.0, 2);
        assert_eq!(
            line,
            "  12.3 of 25.0 s   error  0.043 m   main model   \
             tick   412 µs   simple controller   restarts 2"
        );
    }
}
