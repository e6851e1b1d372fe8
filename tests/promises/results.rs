//! Promise: the tables of docs/results.md are the results of this code: this test measures a part
//! of them again. docs/results.py measures all.

use promises::{Outcome, binaries, repository, text_of};
use serde_json::Value;
use std::collections::BTreeMap;
use std::error::Error;
use std::fs;
use std::process::Command;

const CONTROLLERS: [&str; 3] = ["mpc+observer", "rls-mpc+observer", "gpr-mpc+observer"];

/// Scenario and controller.
type Cell = (String, String);

/// Position RMSE of seed 1 by docs/results.csv, cold \[mm\].
fn written(table: &str) -> Result<BTreeMap<Cell, f64>, Box<dyn Error>> {
    let mut reader = csv::Reader::from_path(repository().join("docs/results.csv"))?;
    let mut cells = BTreeMap::new();
    for record in reader.records() {
        let record = record?;
        let field = |index: usize| record.get(index).unwrap_or_default();
        if field(0) == table && field(5) == "cold" {
            let first = field(6).split(' ').next().unwrap_or_default();
            cells.insert((field(3).to_owned(), field(4).to_owned()), first.parse()?);
        }
    }
    Ok(cells)
}

/// The same, measured now.
fn measured(profile: &str, scenarios: &str) -> Result<BTreeMap<Cell, f64>, Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let rows = folder.path().join("rows.jsonl");
    let mut command = Command::new(binaries()?.join("coxswain"));
    command.current_dir(repository()).args(["experiment", "compare", "--seeds", "1"]);
    command.args(["--profile", profile, "--scenarios", scenarios]);
    command.args(["--controllers", &CONTROLLERS.join(","), "--json"]).arg(&rows);
    text_of(&mut command)?;
    let mut cells = BTreeMap::new();
    for line in fs::read_to_string(rows)?.lines() {
        let row: Value = serde_json::from_str(line)?;
        let text = |key: &str| row[key].as_str().map(str::to_owned).ok_or("a name is missing");
        let rmse = row["position_rmse_m"].as_f64().ok_or("a figure is missing")?;
        cells.insert((text("scenario")?, text("controller")?), 1e3 * rmse);
    }
    Ok(cells)
}

/// Largest change of a figure: another processor may round differently.
fn is_like(now: f64, then: f64) -> bool {
    (now - then).abs() < (0.05 * then).max(0.05)
}

fn compare(table: &str, profile: &str, scenarios: &[&str]) -> Outcome {
    let (written, measured) = (written(table)?, measured(profile, &scenarios.join(","))?);
    assert_eq!(measured.len(), scenarios.len() * CONTROLLERS.len());
    for (cell, now) in measured {
        let then = written.get(&cell).ok_or_else(|| format!("no line of {cell:?}"))?;
        assert!(
            is_like(now, *then),
            "{cell:?}: {now} mm, and {then} mm in docs/results.csv: run docs/results.py"
        );
    }
    Ok(())
}

#[test]
fn the_figures_at_100_ms_are_what_is_measured() -> Outcome {
    compare("held-out-100", "paper", &["slalom", "slalom+payload", "shuttle+stiction", "ring+soft"])
}

#[test]
fn the_figures_at_20_ms_are_what_is_measured() -> Outcome {
    compare("held-out-20", "agile", &["ring+weak-motor", "shuttle"])
}
