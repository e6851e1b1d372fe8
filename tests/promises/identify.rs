//! Promise: a robot is driven within its rectangle, and its record becomes a robot file. A drive
//! that fails leaves an error, and no robot file.

use graph::assembly::{map_of, robot_of};
use identify::log::bag::Topics;
use promises::{Outcome, binaries, graph_file, repository};
use std::error::Error;
use std::fs;
use std::path::PathBuf;
use std::process::{Command, Output};
use tempfile::TempDir;

/// `coxswain identify OPTIONS…`, with results in `out` and the graph's files in `home`.
fn identify(home: &TempDir, out: &str, options: &[&str]) -> Result<Output, Box<dyn Error>> {
    let mut command = Command::new(binaries()?.join("coxswain"));
    command.current_dir(repository()).env("TMPDIR", home.path());
    command.arg("identify").args(options).arg("--out").arg(home.path().join(out));
    Ok(command.output()?)
}

fn home() -> std::io::Result<TempDir> {
    tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")
}

fn graph(name: &str) -> String {
    graph_file(name).display().to_string()
}

#[test]
fn a_drive_stays_in_its_rectangle_and_its_record_gives_the_same_file_again() -> Outcome {
    let home = home()?;
    let graph = graph("local");
    let drive = ["--drive", &graph, "--pace", "lock-step", "--area", "3x3", "--duration", "30"];
    let output = identify(&home, "first", &drive)?;
    assert!(output.status.success(), "{output:?}");
    let first = robot_of(&home.path().join("first/robot.toml"))?;
    let response = first.response.ok_or("no response")?;
    // The truth of the paper's scenario: 22 kg, no dead time.
    let constant = (22.0 * 0.05 * 0.05 / 4.0 + 2e-3) / 0.084;
    assert!((response.time_constant_s[0] / constant - 1.0).abs() < 0.1, "{response:?}");
    assert!(response.dead_time_s < 0.005, "{response:?}");
    assert!(home.path().join("first/report.html").exists());

    let record = home.path().join("first/run").display().to_string();
    let log = identify::log::Log::read(&[PathBuf::from(&record)], &Topics::default())?;
    // Around the start of the paper's scenario, (0, -1).
    for sample in log.stretches.iter().flatten() {
        let [x, y, _] = sample.pose;
        assert!(x.abs() < 1.5 && (y + 1.0).abs() < 1.5, "{sample:?}");
    }
    let robot = home.path().join("first/driven-robot.toml").display().to_string();
    let output = identify(&home, "second", &[&record, "--robot", &robot])?;
    assert!(output.status.success(), "{output:?}");
    assert_eq!(robot_of(&home.path().join("second/robot.toml"))?.response, first.response);

    let output = identify(&home, "second", &[&record, "--robot", &robot])?;
    assert_eq!(output.status.code(), Some(2), "into a folder that is not empty: {output:?}");
    Ok(())
}

#[test]
fn all_of_a_large_robot_stays_in_a_tight_rectangle() -> Outcome {
    let home = home()?;
    let (graph, file) = (graph("local"), repository().join("deploy/robots/panther-mecanum.toml"));
    let robot = file.display().to_string();
    let drive = ["--drive", &graph, "--robot", &robot, "--pace", "lock-step", "--duration", "20"];
    let tight = ["--area", "2x2", "--set", "period_millis=20"];
    let output = identify(&home, "first", &[&drive[..], &tight].concat())?;
    assert!(output.status.success(), "{output:?}");
    let record = home.path().join("first/run");
    let footprint = robot_of(&file)?.footprint().shape();
    let log = identify::log::Log::read(&[record], &Topics::default())?;
    for sample in log.stretches.iter().flatten() {
        for [x, y] in footprint.placed(&sample.pose).corners() {
            assert!(x.abs() < 1.0 && (y + 1.0).abs() < 1.0, "{sample:?}");
        }
    }
    // The motion ends so near to the border that the gate slows the robot.
    let summary = fs::read_to_string(home.path().join("first/run/summary.json"))?;
    let summary: serde_json::Value = serde_json::from_str(&summary)?;
    assert!(summary["periods_slowed"].as_u64() > Some(0), "{summary}");
    Ok(())
}

#[test]
fn a_map_keeps_its_obstacles_and_its_border_in_a_drive() -> Outcome {
    let home = home()?;
    let graph = graph("local");
    let prepared = ["--drive", &graph, "--prepare", "--area", "3x2"];
    let output = identify(&home, "own", &prepared)?;
    assert!(output.status.success(), "{output:?}");
    // Around the start of the paper's scenario, (0, -1).
    let corners = vec![[1.5, 0.0], [-1.5, 0.0], [-1.5, -2.0], [1.5, -2.0]];
    assert_eq!(map_of(&home.path().join("own/map.toml"))?.fence_m, corners);

    let with_map = [&prepared[..], &["--set", "map=\"../maps/hall.toml\""]].concat();
    let output = identify(&home, "hall", &with_map)?;
    assert!(output.status.success(), "{output:?}");
    let hall = map_of(&repository().join("deploy/maps/hall.toml"))?;
    assert_eq!(map_of(&home.path().join("hall/map.toml"))?, hall);
    Ok(())
}

#[test]
fn a_drive_that_the_gate_stops_leaves_no_robot_file() -> Outcome {
    let home = home()?;
    let graph = graph("local");
    // Three dead motors: the robot does not follow.
    let drive = [
        "--drive",
        &graph,
        "--pace",
        "lock-step",
        "--area",
        "2x2",
        "--duration",
        "20",
        "--set",
        "truth.motor_gain=[0.0, 0.0, 0.0, 0.3]",
    ];
    let output = identify(&home, "stopped", &drive)?;
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    assert!(!home.path().join("stopped/robot.toml").exists());
    Ok(())
}

#[test]
fn options_that_cannot_be_used_create_nothing() -> Outcome {
    let home = home()?;
    let (one, two) = (graph("local"), graph("two-hosts"));
    let refused: [&[&str]; 5] = [
        &["--drive", &two],
        &["--drive", "none.toml"],
        &["--drive", &one, "--area", "0.5x0.5"],
        &["--drive", &one, "--speed", "0"],
        &["none.csv", "--robot", "deploy/robots/mecanum.toml", "--pace", "lock-step"],
    ];
    for options in refused {
        let output = identify(&home, "none", options)?;
        assert_eq!(output.status.code(), Some(2), "{options:?}: {output:?}");
        assert!(!home.path().join("none").exists(), "{options:?}");
    }
    Ok(())
}
