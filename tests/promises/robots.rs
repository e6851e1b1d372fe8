//! Promise: the robots whose files ship are driven, whatever their wheels. The whole grid is a
//! campaign (docs/robots.md); this is a short part of it.

use promises::{Outcome, Record, binaries, graph_file, launch_command, repository, text_of};
use serde_json::Value;
use std::collections::BTreeSet;
use std::error::Error;
use std::f64::consts::TAU;
use std::fs;
use std::process::Command;

/// Largest position RMSE \[m\]: about twice the largest of docs/robots.md.
const RMSE_M: f64 = 0.02;

/// Names of the files in a folder below `deploy`, without their ends.
fn names(folder: &str) -> Result<BTreeSet<String>, Box<dyn Error>> {
    let entries = fs::read_dir(repository().join("deploy").join(folder))?;
    let stem = |entry: fs::DirEntry| entry.path().file_stem()?.to_str().map(str::to_owned);
    Ok(entries.flatten().filter_map(stem).collect())
}

#[test]
fn every_robot_that_ships_is_driven_through_corners_and_on_a_slope() -> Outcome {
    let folder = tempfile::tempdir()?;
    let rows = folder.path().join("rows.jsonl");
    let mut command = Command::new(binaries()?.join("coxswain"));
    command.current_dir(repository()).args(["experiment", "compare", "--world", "robots"]);
    command.args(["--scenarios", "*+square+slope,*+eight+weak-motor", "--seeds", "1"]);
    command.args(["--controllers", "gpr-mpc+observer", "--json"]).arg(&rows);
    text_of(&mut command)?;
    let mut driven = BTreeSet::from(["mecanum".to_owned()]);
    for line in fs::read_to_string(rows)?.lines() {
        let row: Value = serde_json::from_str(line)?;
        let scenario = row["scenario"].as_str().ok_or("no scenario")?;
        let rmse = row["position_rmse_m"].as_f64().ok_or("no position RMSE")?;
        assert!(rmse < RMSE_M, "{scenario}: {rmse} m");
        assert_eq!(row["constraint_violations"], 0, "{scenario}");
        driven.extend(scenario.split('+').next().map(str::to_owned));
    }
    assert_eq!(driven, names("robots")?, "the paper's robot drives in the other tests");
    assert_eq!(names("worlds/robots/graphs")?.len() + 1, driven.len());
    Ok(())
}

/// `[wheels]` of kinds that no robot file that ships has.
fn other_wheels() -> Vec<(&'static str, String)> {
    let x = "[wheels.mecanum]\nradius_m = 0.05\nwheelbase_m = 0.25\ntrack_m = 0.6\nrollers = \"X\"";
    let omni = "[wheels.omni]\nradius_m = 0.05\ncentre_to_wheel_m = 0.2\ncount = 4";
    // Two radii, and omni wheels beside mecanum wheels.
    let wheel = |number: u32| {
        let angle = f64::from(number) * TAU / 6.0;
        let (sin, cos) = angle.sin_cos();
        let direction_deg = (angle.to_degrees() + 90.0) % 360.0;
        let roller_deg = if number.is_multiple_of(2) { 30.0 } else { 0.0 };
        let radius_m = if number < 3 { 0.05 } else { 0.06 };
        format!(
            "[[wheels.list]]\nposition_m = [{:.4}, {:.4}]\ndirection_deg = {direction_deg:.1}\n\
             roller_deg = {roller_deg:.1}\nradius_m = {radius_m}\n",
            0.2 * cos,
            0.2 * sin
        )
    };
    let six = (0..6).map(wheel).collect();
    vec![("x", x.to_owned()), ("four-omni", omni.to_owned()), ("six", six)]
}

#[test]
fn robots_with_rollers_in_an_x_four_omni_wheels_or_a_list_of_six_drive_a_circle() -> Outcome {
    let shipped = fs::read_to_string(repository().join("deploy/robots/mecanum.toml"))?;
    let (before, rest) = shipped.split_once("[wheels.mecanum]").ok_or("no wheels")?;
    let (_, after) = rest.split_once("[body]").ok_or("no body")?;
    for (name, wheels) in other_wheels() {
        let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
        let robot = home.path().join(name).with_extension("toml");
        fs::write(&robot, format!("{before}{wheels}\n\n[body]{after}"))?;
        let options = ["--scenario", "circle", "--pace", "lock-step", "--duration", "20"];
        let out = home.path().join("run");
        let mut launch = launch_command(&graph_file("local"), &out, &options)?;
        text_of(launch.arg("--robot").arg(&robot).env("TMPDIR", home.path()))?;
        let record = Record::read(&out)?;
        let truths: Vec<_> = record.of("truth").collect();
        assert!(truths.len() > 190, "{name}: {} states", truths.len());
        // The circle of the scenario: 2 m around (0, 2), begun at the origin.
        for truth in truths.iter().skip(truths.len() - 20) {
            let [x, y, _] = truth.numbers("pose")[..] else { return Err("no pose".into()) };
            let off = (x.hypot(y - 2.0) - 2.0).abs();
            assert!(off < RMSE_M, "{name}: {off} m from the circle");
        }
    }
    Ok(())
}
