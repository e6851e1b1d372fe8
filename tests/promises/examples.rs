//! Promise: every example runs, and prints the right figures.
//!
//! `error_live`, `watch.py` and `robot.py` need a robot that drives; `error_live.rs`,
//! `python_clients.rs` and `python_robot.rs` run them.

use promises::{Launched, Outcome, binaries, python, repository};
use std::collections::BTreeSet;
use std::error::Error;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

type Found<T> = Result<T, Box<dyn Error>>;

/// Standard output of a program that succeeds.
fn printed(command: &mut Command) -> Found<String> {
    let Output { status, stdout, stderr } = command.output()?;
    assert!(status.success(), "{command:?}: {}", String::from_utf8_lossy(&stderr));
    Ok(String::from_utf8(stdout)?)
}

fn example(name: &str, arguments: &[&Path]) -> Found<String> {
    printed(Command::new(binaries()?.join("examples").join(name)).args(arguments))
}

fn script(name: &str, arguments: &[&Path]) -> Found<String> {
    let script = repository().join("deploy/clients/python").join(name);
    printed(Command::new(python()?).arg("-B").arg(script).args(arguments))
}

/// The numbers after each `word`, in the order of the lines.
fn numbers(text: &str, word: &str) -> Vec<f64> {
    let words: Vec<&str> = text.split_whitespace().collect();
    words
        .windows(2)
        .filter(|pair| pair[0] == word)
        .filter_map(|pair| pair[1].parse().ok())
        .collect()
}

/// A run in lock step, and its summary.
fn run() -> Found<(tempfile::TempDir, serde_json::Value)> {
    let launched =
        Launched::new(&["--pace", "lock-step", "--scenario", "circle", "--duration", "8"])?;
    let (ended, home) = launched.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    let summary = serde_json::from_slice(&fs::read(home.path().join("run/summary.json"))?)?;
    Ok((home, summary))
}

#[test]
fn a_message_comes_back_from_its_bytes() -> Outcome {
    let text = example("frame", &[])?;
    assert_eq!((numbers(&text, "tick"), numbers(&text, "through_tick")), (vec![42.0], vec![50.0]));
    assert!(text.contains("Err(Checksum"), "{text}");
    Ok(())
}

#[test]
fn regression_finds_the_function_and_knows_where_it_does_not() -> Outcome {
    let text = example("gp_regression", &[])?;
    let (sines, means) = (numbers(&text, "sin"), numbers(&text, "mean"));
    let deviations = numbers(&text, "deviation");
    assert_eq!([sines.len(), means.len(), deviations.len()], [3; 3], "{text}");
    for query in 0..2 {
        assert!((sines[query] - means[query]).abs() < 0.02, "{text}");
        assert!(deviations[query] < 0.02, "{text}");
    }
    assert!(deviations[2] > 0.3, "far from all samples: {text}");
    Ok(())
}

#[test]
fn dead_time_and_gain_are_identified() -> Outcome {
    let text = example("identify_response", &[])?;
    assert_eq!(numbers(&text, "time"), [2.0], "{text}");
    let gains = numbers(&text, "gain");
    for (found, gain) in gains.iter().zip([0.8, 1.0, 1.0]) {
        assert!((found - gain).abs() < 0.01, "{text}");
    }
    assert_eq!(gains.len(), 3);
    Ok(())
}

#[test]
fn the_gate_plays_the_tail_and_brakes() -> Outcome {
    let forward = numbers(&example("gate", &[])?, "forward");
    assert_eq!(forward, [0.05, 0.04, 0.03, 0.0, 0.0, 0.0]);
    Ok(())
}

#[test]
fn the_optimiser_drives_onto_the_circle() -> Outcome {
    let errors = numbers(&example("mpc", &[])?, "error");
    assert_eq!(errors.len(), 6);
    assert!(errors[0] > 0.49 && errors[5] < 1e-3, "{errors:?}");
    Ok(())
}

#[test]
fn the_shortest_driver_moves_and_then_brakes() -> Outcome {
    let places = numbers(&example("shortest_driver", &[])?, "x");
    assert_eq!(places.len(), 5);
    assert!(places.is_sorted() && (places[1] - 0.01).abs() < 1e-3, "{places:?}");
    assert!((places[4] - places[3]).abs() < 1e-4, "it stands: {places:?}");
    Ok(())
}

#[test]
fn a_file_of_points_becomes_a_reference() -> Outcome {
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("points.csv");
    fs::write(&file, "time_s,x_m,y_m,yaw_rad\n0,0,0,0\n5,2,0,0\n10,2,2,0\n")?;
    let text = example("custom_reference", &[&file])?;
    let (x, y) = (numbers(&text, "x"), numbers(&text, "y"));
    for second in 0..10 {
        let time = second as f64;
        let expected = [(0.4 * time).min(2.0), (0.4 * (time - 5.0)).max(0.0)];
        assert!((x[second] - expected[0]).abs() < 1e-3, "{text}");
        assert!((y[second] - expected[1]).abs() < 1e-3, "{text}");
    }
    Ok(())
}

#[test]
fn the_graph_in_one_process_has_the_figures_of_the_processes() -> Outcome {
    let home = tempfile::tempdir()?;
    let (inside, outside) = (home.path().join("inside"), home.path().join("outside"));
    let graph = repository().join("deploy/graphs/local.toml");
    let text = example("in_process", &[&graph, &inside, Path::new("circle")])?;
    let mut launch = Command::new(binaries()?.join("coxswain"));
    launch.arg("launch").arg(&graph).args(["--scenario", "circle", "--duration", "10"]);
    printed(launch.args(["--pace", "lock-step", "--out"]).arg(&outside))?;
    let summary: serde_json::Value =
        serde_json::from_slice(&fs::read(outside.join("summary.json"))?)?;
    assert_eq!(
        numbers(&text, "position_rmse_m").first().copied(),
        summary["position_rmse_m"].as_f64()
    );
    Ok(())
}

#[test]
fn a_record_has_the_same_figures_in_rust_in_python_and_in_the_summary() -> Outcome {
    let (home, summary) = run()?;
    let run = home.path().join("run");
    let rmse = summary["position_rmse_m"].as_f64().ok_or("no figure")?;
    let text = example("read_record", &[&run])?;
    assert_eq!(numbers(&text, "position_rmse_m"), [rmse]);
    assert_eq!(numbers(&text, "periods").first().copied(), summary["periods"].as_f64());
    // As the plans knew it: with the noise of the sensors, and from the estimate of the pose.
    let known = numbers(&script("read_record.py", &[&run])?, "position_rmse_m");
    assert!(known.len() == 1 && (known[0] - rmse).abs() < 0.005, "{known:?} {rmse}");
    let table = script("compare_runs.py", &[&run, &run])?;
    let [found] = numbers(&table, "position_rmse_m")[..] else { return Err(table.into()) };
    assert!((found - rmse).abs() <= 1e-5 * rmse, "{table}");
    // The settings that the launch has written drive a controller alone.
    let errors =
        numbers(&example("closed_loop", &[&run.join("settings/controller.toml")])?, "error");
    assert!(errors.last().is_some_and(|&last| last < 0.01), "{errors:?}");
    Ok(())
}

#[test]
fn an_example_without_its_argument_reports_what_it_expects() -> Outcome {
    for name in ["custom_reference", "closed_loop", "read_record", "in_process"] {
        let output = Command::new(binaries()?.join("examples").join(name)).output()?;
        assert_eq!((output.status.code(), output.stderr.is_empty()), (Some(2), false), "{name}");
    }
    for name in ["read_record.py", "compare_runs.py"] {
        let file = repository().join("deploy/clients/python").join(name);
        let output = Command::new(python()?).arg("-B").arg(file).output()?;
        assert_eq!((output.status.code(), output.stderr.is_empty()), (Some(2), false), "{name}");
    }
    Ok(())
}

#[test]
fn a_file_that_is_none_ends_an_example_with_an_error_and_no_panic() -> Outcome {
    let folder = tempfile::tempdir()?;
    let (junk, record) = (folder.path().join("junk"), folder.path().join("record.mcap"));
    fs::write(&junk, "no points, no settings")?;
    fs::write(&record, "no record")?;
    fs::write(folder.path().join("summary.json"), "no figures")?;
    for (name, argument) in [
        ("custom_reference", junk.as_path()),
        ("closed_loop", junk.as_path()),
        ("read_record", folder.path()),
    ] {
        let file = binaries()?.join("examples").join(name);
        let output = Command::new(file).arg(argument).output()?;
        assert_eq!((output.status.code(), output.stderr.is_empty()), (Some(1), false), "{name}");
    }
    for name in ["read_record.py", "compare_runs.py"] {
        let file = repository().join("deploy/clients/python").join(name);
        let output = Command::new(python()?).arg("-B").arg(file).arg(folder.path()).output()?;
        let errors = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!((output.status.code(), errors.lines().count()), (Some(1), 1), "{errors}");
    }
    Ok(())
}

/// So that a new one is not forgotten: a test runs it, and the page of examples lists it.
#[test]
fn every_example_is_run_by_a_test_and_listed() -> Outcome {
    let mut tests = String::new();
    for file in fs::read_dir(repository().join("tests/promises"))? {
        let path = file?.path();
        if path.extension().is_some_and(|extension| extension == "rs") {
            tests += &fs::read_to_string(path)?;
        }
    }
    let page = fs::read_to_string(repository().join("docs/examples.md"))?;
    let mut names = BTreeSet::new();
    let crates = fs::read_dir(repository().join("services"))?
        .map(|folder| folder.map(|folder| folder.path().join("examples")))
        .chain([Ok(repository().join("protocol/examples"))]);
    for folder in crates {
        let folder = folder?;
        if folder.is_dir() {
            for file in fs::read_dir(folder)? {
                names.extend(
                    file?.path().file_stem().map(|name| name.to_string_lossy().into_owned()),
                );
            }
        }
    }
    assert!(names.len() >= 10, "{names:?}");
    for name in &names {
        let is_run = tests.contains(&format!("example(\"{name}\""))
            || tests.contains(&format!("examples/{name}\""));
        assert!(is_run, "{name}");
        assert!(page.contains(&format!("`{name}`")), "{name} is not on the page of examples");
    }
    for file in fs::read_dir(repository().join("deploy/clients/python"))? {
        let path = file?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let is_python = path.extension().is_some_and(|extension| extension == "py");
        let is_program = is_python && fs::read_to_string(&path)?.contains("__main__");
        if is_program && !name.starts_with("test_") {
            let calls =
                [format!("/{name}\""), format!("script(\"{name}\""), format!("join(\"{name}\")")];
            assert!(calls.iter().any(|call| tests.contains(call)), "{name}");
            assert!(page.contains(&name), "{name} is not on the page of examples");
        }
    }
    Ok(())
}
