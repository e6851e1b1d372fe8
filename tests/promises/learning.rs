//! Promise: learning improves control. In lock step, so that the numbers are the same on every
//! machine.

use promises::{Launched, Outcome, Record};

fn summary(learner: &str) -> Result<serde_json::Value, Box<dyn std::error::Error>> {
    let (ended, home) = Launched::new(&["--pace", "lock-step", "--learner", learner])?.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    Ok(Record::read(&home.path().join("run"))?.summary)
}

#[test]
fn with_the_learner_the_robot_arrives_earlier_and_stays_closer() -> Outcome {
    let (on, off) = (summary("on")?, summary("off")?);
    let figure =
        |summary: &serde_json::Value, name: &str| summary[name].as_f64().unwrap_or(f64::INFINITY);
    assert!(figure(&on, "arrival_s") < figure(&off, "arrival_s"), "{on}\n{off}");
    assert!(figure(&on, "position_rmse_m") < 0.1 * figure(&off, "position_rmse_m"), "{on}\n{off}");
    assert!(figure(&on, "steady_speed_error_mps") <= 0.07, "{on}");
    assert!(figure(&on, "snapshots_adopted") >= 3.0, "{on}");
    assert_eq!(figure(&off, "snapshots_published"), 0.0, "{off}");
    for summary in [on, off] {
        assert_eq!(summary["fallback_levels"]["fresh plan"], summary["periods"], "{summary}");
        assert_eq!(figure(&summary, "periods_missed"), 0.0);
    }
    Ok(())
}

#[test]
fn nominal_control_keeps_the_offset_that_the_scenario_promises() -> Outcome {
    let off = summary("off")?;
    let error = off["position_rmse_m"].as_f64().unwrap_or(f64::NAN);
    assert!((0.05..=0.08).contains(&error), "{error} m");
    Ok(())
}
