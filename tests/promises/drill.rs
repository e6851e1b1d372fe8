//! Promise: a process that dies, hangs, sends false data or is cut off causes nothing unsafe at the
//! wheels, and one command shows it.

use promises::{Outcome, binaries, repository};
use serde_json::Value;
use std::collections::BTreeSet;
use std::error::Error;
use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// Far longer than any step here takes.
const GIVES_UP_AFTER: Duration = Duration::from_mins(2);

/// The processes of two drills delay each other, which is no fault of a robot. One drill at a time
/// launches graphs in real time.
static MACHINE: Mutex<()> = Mutex::new(());

fn drill(home: &Path, options: &[&str]) -> Result<Output, Box<dyn Error>> {
    let mut command = Command::new(binaries()?.join("coxswain"));
    command.arg("drill").args(options);
    if !options.contains(&"--json") {
        command.args(["--json", &home.join("rows.jsonl").to_string_lossy()]);
    }
    command.arg("--keep").arg(home.join("kept")).current_dir(repository()).env("TMPDIR", home);
    Ok(command.output()?)
}

/// Findings of the drill about a recovery that came later than required: `{}` is a number, `*` a
/// process.
const LATE: [&str; 4] = [
    "* was in use again {} s after fault {}, expected {} s at most",
    "launch {} drove after {} s, expected {} s at most",
    "cut {}, of {} ms: driving again after {} s, expected {} s at most",
    "below a fresh plan for {} s until tick {}, expected {} s at most",
];

/// Whether `found` is about a time limit, which a busy machine may exceed. Only the drill, on a
/// machine of its own, judges time limits. A recovery that did not happen at all is no such
/// finding.
fn is_late(found: &str) -> bool {
    let fields = |word: &str, expected: &str| match expected.strip_suffix(',') {
        _ if expected == "*" => {
            ["plant", "controller", "learner", "recorder", "gateway"].contains(&word)
        }
        Some("{}") => word.strip_suffix(',').is_some_and(|number| number.parse::<f64>().is_ok()),
        _ if expected == "{}" => word.parse::<f64>().is_ok(),
        _ => word == expected,
    };
    let words: Vec<&str> = found.split(' ').collect();
    LATE.iter().map(|late| late.split(' ').collect::<Vec<_>>()).any(|late| {
        late.len() == words.len()
            && words.iter().zip(&late).all(|(word, expected)| fields(word, expected))
    })
}

#[test]
fn only_a_late_recovery_counts_as_late() {
    for late in [
        "plant was in use again 1.20 s after fault 3, expected 1 s at most",
        "launch 2 drove after 2.53 s, expected 2 s at most",
        "cut 0, of 1000 ms: driving again after 2.10 s, expected 2 s at most",
        "below a fresh plan for 2.6 s until tick 700, expected 2.5 s at most",
    ] {
        assert!(is_late(late), "{late}");
    }
    for worse in [
        "plant was never in use again after fault 3",
        "launch 2 never drove",
        "cut 0, of 1000 ms: driving again never, expected 2 s at most",
        "it does not drive at the end",
        "stored tail (command missing) at tick 9, expected fresh plans alone: no process that the \
         robot needs was touched",
        "Age at tick 9 of epoch 1: a command acted that was in use again 3.20 T after its state, \
         expected 3 T at most",
    ] {
        assert!(!is_late(worse), "{worse}");
    }
}

#[test]
fn a_quick_drill_of_everything_violates_at_most_the_recovery_time() -> Outcome {
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    let _machine = MACHINE.lock().unwrap_or_else(PoisonError::into_inner);
    let output = drill(home.path(), &["--quick", "--seed", "2", "--jobs", "3"])?;
    let (table, errors) =
        (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    let rows = fs::read_to_string(home.path().join("rows.jsonl"))?;
    let rows: Vec<Value> = rows.lines().map(serde_json::from_str).collect::<Result<_, _>>()?;
    for row in &rows {
        let unsafe_things = row["found"]
            .as_array()
            .into_iter()
            .flatten()
            .filter_map(Value::as_str)
            .filter(|found| !is_late(found));
        assert_eq!(unsafe_things.collect::<Vec<_>>(), [""; 0], "{row}\n{errors}");
        for key in [
            "fault",
            "target",
            "injections",
            "violations",
            "worst_reaction_periods",
            "worst_restart_s",
            "seed",
        ] {
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
    // Each row of the table begins with its fault.
    let is_shown = |fault: &&str| table.lines().any(|line| line.trim_start().starts_with(fault));
    assert!(faults.iter().all(is_shown), "{table}");
    Ok(())
}

#[test]
fn a_failed_step_is_a_violation_with_its_exit_code_and_is_kept() -> Outcome {
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    let output = drill(
        home.path(),
        &["--quick", "--fault", "payload", "--deploy", &without_wheels(home.path())?],
    )?;
    let (table, errors) =
        (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert_eq!(output.status.code(), Some(1), "{table}{errors}");
    assert!(errors.contains("wheel_speed_limit_radps"), "{errors}");
    let kept: Vec<_> = fs::read_dir(home.path().join("kept"))?.collect::<Result<_, _>>()?;
    let [drill] = kept.as_slice() else {
        return Err(format!("{kept:?} was kept, expected one folder: {table}").into());
    };
    assert!(table.contains(&*drill.path().to_string_lossy()), "{table}");
    assert_eq!(fs::read_dir(drill.path())?.count(), 1, "{table}");
    Ok(())
}

/// A robot whose wheels cannot turn cannot be launched.
fn without_wheels(home: &Path) -> Result<String, Box<dyn Error>> {
    let deploy = home.join("deploy");
    for folder in ["robots", "scenarios", "scenarios/profiles", "scenarios/variants"] {
        fs::create_dir_all(deploy.join(folder))?;
        for file in fs::read_dir(repository().join("deploy").join(folder))?
            .flatten()
            .filter(|file| file.path().is_file())
        {
            fs::copy(file.path(), deploy.join(folder).join(file.file_name()))?;
        }
    }
    let robot = deploy.join("robots/mecanum.toml");
    let text = fs::read_to_string(&robot)?;
    let line =
        text.lines().find(|line| line.starts_with("wheel_speed_limit_radps")).ok_or("no limit")?;
    fs::write(&robot, text.replace(line, "wheel_speed_limit_radps = 0.0"))?;
    Ok(deploy.to_string_lossy().into_owned())
}

#[test]
fn a_result_that_cannot_be_kept_hides_no_finding() -> Outcome {
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    fs::write(home.path().join("kept"), "a file where a folder should be")?;
    let output = drill(
        home.path(),
        &["--quick", "--fault", "payload", "--deploy", &without_wheels(home.path())?],
    )?;
    let (table, errors) =
        (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert_eq!(output.status.code(), Some(1), "{table}{errors}");
    let folder = home.path().join("kept").display().to_string();
    assert!(
        errors.contains("wheel_speed_limit_radps") && table.contains(&folder),
        "{table}{errors}"
    );
    Ok(())
}

/// Some processes whose environment contains this home.
fn of_home(home: &Path) -> Vec<String> {
    let ours = format!("TMPDIR={}", home.display());
    let has_it = |process: &Path| {
        fs::read(process.join("environ"))
            .is_ok_and(|text| String::from_utf8_lossy(&text).contains(&ours))
    };
    let name = |process: &Path| fs::read_to_string(process.join("comm")).unwrap_or_default();
    let processes = fs::read_dir("/proc").into_iter().flatten().flatten().map(|entry| entry.path());
    processes.filter(|process| has_it(process)).map(|process| name(&process)).collect()
}

#[test]
fn a_killed_drill_leaves_no_process_running() -> Outcome {
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    let _machine = MACHINE.lock().unwrap_or_else(PoisonError::into_inner);
    let mut command = Command::new(binaries()?.join("coxswain"));
    command.args([
        "drill",
        "--quick",
        "--fault",
        "partition",
        "--fault",
        "two controllers",
        "--fault",
        "kill",
        "--keep",
    ]);
    command.arg(home.path().join("kept")).current_dir(repository()).env("TMPDIR", home.path());
    let mut drill = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn()?;
    let begin = Instant::now();
    while of_home(home.path()).iter().filter(|name| name.trim_end() == "plant-sim").count() < 2 {
        assert!(begin.elapsed() < GIVES_UP_AFTER, "no robot was ever launched");
        thread::sleep(Duration::from_millis(20));
    }
    drill.kill()?;
    drill.wait()?;
    let killed = Instant::now();
    while !of_home(home.path()).is_empty() {
        assert!(killed.elapsed() < GIVES_UP_AFTER, "{:?} are left", of_home(home.path()));
        thread::sleep(Duration::from_millis(20));
    }
    Ok(())
}

#[test]
fn an_unknown_request_is_refused_with_the_known_ones() -> Outcome {
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    for (options, expected) in [
        (["--fault", "earthquake", "--quick"], ["earthquake", "kill all"]),
        (["--fault", "ten minutes", "--quick"], ["ten minutes", "whole"]),
        (["--deploy", "/nowhere", "--quick"], ["/nowhere", "scenarios"]),
        (["--json", "/nowhere/rows.jsonl", "--quick"], ["/nowhere/rows.jsonl", "--json"]),
    ] {
        let output = drill(home.path(), &options)?;
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{errors}");
        assert!(expected.iter().all(|part| errors.contains(part)), "{errors}");
        assert!(!home.path().join("rows.jsonl").exists());
    }
    Ok(())
}
