//! Promise: the robots whose files ship are driven, whatever their wheels. The whole grid is a
//! campaign (docs/robots.md); this is a short part of it.

use promises::{Outcome, binaries, repository, text_of};
use serde_json::Value;
use std::collections::BTreeSet;
use std::error::Error;
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
