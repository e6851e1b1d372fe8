//! Promise: the claims about the controller hold on independent physics, in MuJoCo. The whole grid
//! is a campaign (docs/second_world.md); this is a short part of it.

use promises::{Outcome, binaries, repository, text_of};
use serde_json::Value;
use std::error::Error;
use std::fs;
use std::path::Path;
use std::process::Command;

/// The rows of `controllers` in `scenarios` of the second world, at 20 ms.
fn compared(scenarios: &str, controllers: &str) -> Result<Vec<Value>, Box<dyn Error>> {
    compared_in(Path::new("mujoco"), "agile", scenarios, controllers)
}

fn compared_in(
    world: &Path,
    profile: &str,
    scenarios: &str,
    controllers: &str,
) -> Result<Vec<Value>, Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let rows = folder.path().join("rows.jsonl");
    let mut command = Command::new(binaries()?.join("coxswain"));
    command.current_dir(repository()).args(["experiment", "compare", "--world"]).arg(world);
    command.args(["--profile", profile, "--seeds", "1"]);
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

/// Robots drawn at random. The tenth has a stiff loop: at the start of a period of 100 ms its
/// motors saturate in every corner.
#[test]
fn a_robot_with_a_stiff_loop_takes_corners_as_fast_as_its_motors_can() -> Outcome {
    let folder = tempfile::tempdir()?;
    let world = folder.path().join("drawn");
    let mut draw = Command::new("python3");
    draw.arg(repository().join("deploy/worlds/mujoco/draw.py")).arg(&world);
    let cells = text_of(draw.args(["--seed", "7", "--count", "10", "--cells", "1"]))?;
    assert_eq!(cells.trim().split(',').count(), 10, "{cells}");
    let case = "drawn-9+square+nominal";
    let (simple, ours) = ("feedforward-p", "gpr-mpc+observer");
    let rows = compared_in(&world, "paper", case, &format!("{simple},{ours}"))?;
    let (simple, ours) = (rmse_mm(&rows, case, simple)?, rmse_mm(&rows, case, ours)?);
    assert!(ours < 0.5 * simple, "{ours} mm, {simple} mm without plans");
    Ok(())
}
