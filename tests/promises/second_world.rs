//! Promise: the claims about the controller hold on independent physics, in MuJoCo. The whole grid
//! is a campaign (docs/second_world.md); this is a short part of it.

use promises::{Outcome, binaries, repository, text_of};
use serde_json::Value;
use std::error::Error;
use std::fs;
use std::process::Command;

/// The position RMSE of `controllers` in `scenarios` at 20 ms \[mm\], one row each.
fn compared(scenarios: &str, controllers: &str) -> Result<Vec<Value>, Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let rows = folder.path().join("rows.jsonl");
    let mut command = Command::new(binaries()?.join("coxswain"));
    command.current_dir(repository()).args(["experiment", "compare", "--world", "mujoco"]);
    command.args(["--profile", "agile", "--seeds", "1"]);
    command.args(["--scenarios", scenarios, "--controllers", controllers, "--json"]).arg(&rows);
    text_of(&mut command)?;
    fs::read_to_string(rows)?.lines().map(|line| Ok(serde_json::from_str(line)?)).collect()
}

fn rmse_mm(rows: &[Value], scenario: &str, controller: &str) -> Result<f64, Box<dyn Error>> {
    let row = rows
        .iter()
        .find(|row| row["scenario"] == scenario && row["controller"] == controller)
        .ok_or_else(|| format!("no row of {controller} in {scenario}"))?;
    let rmse = row["position_rmse_m"].as_f64();
    Ok(1e3 * rmse.ok_or_else(|| format!("no figure of {controller} in {scenario}"))?)
}

/// A lag of 60 ms that no process reports, and a worn wheel.
#[test]
fn learning_does_no_harm_on_a_robot_in_another_world() -> Outcome {
    let cases = ["courier+eight+late-60", "scout+circle+worn"];
    let baselines = ["feedforward-p", "mpc", "mpc+observer"];
    let ours = "gpr-mpc+observer";
    let rows = compared(&cases.join(","), &[&baselines[..], &[ours]].concat().join(","))?;
    for case in cases {
        let mut best = f64::INFINITY;
        for baseline in baselines {
            best = best.min(rmse_mm(&rows, case, baseline)?);
        }
        let reached = rmse_mm(&rows, case, ours)?;
        assert!(reached < 1.05 * best + 2.0, "{case}: {reached} mm, the best baseline {best} mm");
    }
    let without =
        rmse_mm(&compared("courier+eight+nominal", ours)?, "courier+eight+nominal", ours)?;
    let with = rmse_mm(&rows, "courier+eight+late-60", ours)?;
    assert!(with < 1.3 * without + 2.0, "{with} mm with a lag, {without} mm without");
    Ok(())
}

#[test]
fn the_same_seed_gives_the_same_figures_in_another_world() -> Outcome {
    let figures = || -> Result<[Value; 3], Box<dyn Error>> {
        let rows = compared("hauler+circle+slippery", "mpc+observer")?;
        let row = rows.first().ok_or("no row")?;
        Ok(["position_rmse_m", "heading_rmse_rad", "input_effort"].map(|key| row[key].clone()))
    };
    let first = figures()?;
    assert!(first.iter().all(Value::is_number), "{first:?}");
    assert_eq!(first, figures()?);
    Ok(())
}
