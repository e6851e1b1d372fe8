//! Promise: whatever dies, hangs, lies or is cut off, nothing unsafe comes of it at the wheels, and anybody can see that with one command.

use promises::{Outcome, binaries, repository};
use serde_json::Value;
use std::collections::BTreeSet;
use std::error::Error;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

fn drill(home: &Path, options: &[&str]) -> Result<Output, Box<dyn Error>> {
    let mut command = Command::new(binaries()?.join("coxswain"));
    command.arg("drill").args(options).args(["--json", &home.join("rows.jsonl").to_string_lossy()]);
    command.arg("--keep").arg(home.join("kept")).current_dir(repository()).env("TMPDIR", home);
    Ok(command.output()?)
}

/// A time that a machine with other work may not keep. Whether it is kept is for the drill alone to say, on a machine of its own.
fn is_late(found: &str) -> bool {
    ["was in use again", "drove after", "below a fresh plan for"].iter().any(|late| found.contains(late))
}

#[test]
fn a_quick_drill_of_everything_violates_nothing_but_perhaps_the_time_that_coming_back_takes() -> Outcome {
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    let output = drill(home.path(), &["--quick", "--seed", "2", "--jobs", "2"])?;
    let (table, errors) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    let rows = fs::read_to_string(home.path().join("rows.jsonl"))?;
    let rows: Vec<Value> = rows.lines().map(serde_json::from_str).collect::<Result<_, _>>()?;
    for row in &rows {
        let unsafe_things = row["found"].as_array().into_iter().flatten().filter_map(Value::as_str).filter(|found| !is_late(found));
        assert_eq!(unsafe_things.collect::<Vec<_>>(), [""; 0], "{row}\n{errors}");
        for key in ["fault", "target", "injections", "violations", "worst_reaction_periods", "worst_restart_s", "seed"] {
            assert!(row.get(key).is_some(), "{key} is not in {row}");
        }
        let reaction = row["worst_reaction_periods"].as_f64();
        assert!(reaction.is_none_or(|periods| periods <= 3.0 + 1e-6), "{row}");
    }
    let late = rows.iter().any(|row| row["violations"] != 0);
    assert_eq!(output.status.code(), Some(i32::from(late)), "{table}{errors}");
    let faults: BTreeSet<&str> = rows.iter().filter_map(|row| row["fault"].as_str()).collect();
    let injections: u64 = rows.iter().filter_map(|row| row["injections"].as_u64()).sum();
    assert!(faults.len() >= 12 && injections >= 100, "{injections} of {faults:?}");
    assert!(table.contains("95% bound") && table.contains("violations"), "{table}");
    Ok(())
}

#[test]
fn what_could_not_be_done_is_a_violation_with_its_exit_code_and_is_kept() -> Outcome {
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    // A robot whose wheels cannot turn cannot be launched.
    let deploy = home.path().join("deploy");
    for folder in ["robots", "scenarios", "scenarios/profiles", "scenarios/variants"] {
        fs::create_dir_all(deploy.join(folder))?;
        for file in fs::read_dir(repository().join("deploy").join(folder))?.flatten().filter(|file| file.path().is_file()) {
            fs::copy(file.path(), deploy.join(folder).join(file.file_name()))?;
        }
    }
    let robot = deploy.join("robots/mecanum.toml");
    let text = fs::read_to_string(&robot)?;
    let line = text.lines().find(|line| line.starts_with("wheel_speed_limit_radps")).ok_or("no limit")?;
    fs::write(&robot, text.replace(line, "wheel_speed_limit_radps = 0.0"))?;
    let output = drill(home.path(), &["--quick", "--fault", "payload", "--deploy", &deploy.to_string_lossy()])?;
    let (table, errors) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert_eq!(output.status.code(), Some(1), "{table}{errors}");
    assert!(errors.contains("wheel_speed_limit_radps"), "{errors}");
    assert!(table.contains("kept: ") && fs::read_dir(home.path().join("kept"))?.count() == 1, "{table}");
    Ok(())
}

#[test]
fn what_cannot_be_asked_for_is_refused_with_what_can() -> Outcome {
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    for (options, expected) in
        [(["--fault", "earthquake"], ["earthquake", "kill all"]), (["--deploy", "/nowhere"], ["/nowhere", "scenarios"])]
    {
        let output = drill(home.path(), &options)?;
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{errors}");
        assert!(expected.iter().all(|part| errors.contains(part)), "{errors}");
        assert!(!home.path().join("rows.jsonl").exists());
    }
    Ok(())
}
