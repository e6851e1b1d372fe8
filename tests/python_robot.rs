//! Promise: a robot written in another language, from `protocol/WIRE.md` alone, is driven and
//! learned.

use promises::{Launched, Outcome, graph_file, launch_command, python, repository, text_of};
use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::TempDir;

/// Bound on the error of a learned drive \[m\]: without a learner, the controller keeps an error of
/// 0.1 m on this circle.
const LEARNED_M: f64 = 0.05;

fn clients() -> PathBuf {
    repository().join("deploy/clients/python")
}

/// Whether a recorder takes part.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Record {
    None,
    Kept,
}

/// Controller and learner, as in `control-host.toml`, in a graph called `graph` that is connected
/// to no other launch.
fn control_host(graph: &str, record: Record, home: &Path) -> Result<PathBuf, Box<dyn Error>> {
    let mut text = fs::read_to_string(graph_file("control-host"))?;
    if record == Record::Kept {
        text = text.replace(
            "[processes.recorder]\nenabled = false",
            "[processes.recorder]\nenabled = true",
        );
    }
    let deploy = format!("\"{}/", repository().join("deploy").display());
    let lines = text.lines().map(|line| match line.split_once(" = ") {
        Some(("graph", _)) => format!("graph = \"{graph}\""),
        Some(("connect", _)) => "connect = []".to_owned(),
        _ => line.replace("\"../", &deploy),
    });
    let file = home.join("control-host.toml");
    fs::write(&file, lines.collect::<Vec<_>>().join("\n"))?;
    Ok(file)
}

/// Result of a circle of 15 s.
struct Driven {
    /// Output of the robot.
    text: String,
    /// Output of the launch.
    told: String,
    /// Its folder.
    home: TempDir,
}

/// Output of `script` for a circle of 15 s in lock step, driven by a real controller with a real
/// learner.
fn circle_of(script: &Path, record: Record) -> Result<String, Box<dyn Error>> {
    Ok(driven(script, record, &[])?.text)
}

/// The same with more arguments for the robot.
fn driven(script: &Path, record: Record, arguments: &[&str]) -> Result<Driven, Box<dyn Error>> {
    let python = python()?;
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    let graph = format!("robot-{}", std::process::id());
    let options = ["--pace", "lock-step", "--listen", "tcp/127.0.0.1:0"];
    let mut command = launch_command(
        &control_host(&graph, record, home.path())?,
        &home.path().join("run"),
        &options,
    )?;
    command.arg("--scenario").arg(repository().join("deploy/scenarios/circle.toml"));
    let launched = Launched::by(command, home)?;
    let text = text_of(
        Command::new(python)
            .arg("-B")
            .arg(script)
            .args([
                "--connect",
                &launched.told("controller", "connect")?,
                "--graph",
                &graph,
                "--pace",
                "lock-step",
                "--circle",
                "2",
                "1.5",
            ])
            .arg("--robot")
            .arg(repository().join("deploy/robots/mecanum.toml"))
            .args((record == Record::Kept).then_some("--recorded"))
            .args(arguments),
    )?;
    let (ended, home) = launched.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    assert_eq!(
        home.path().join("run/record.mcap").exists(),
        record == Record::Kept,
        "{}",
        ended.text
    );
    Ok(Driven { text, told: ended.text, home })
}

#[test]
fn a_robot_in_python_drives_a_circle_and_is_learned_through_losses_too() -> Outcome {
    let text = circle_of(&clients().join("robot.py"), Record::None)?;
    let summary: serde_json::Value =
        serde_json::from_str(text.lines().last().ok_or("the robot said nothing")?)?;
    assert_eq!(text.lines().count(), 16, "a line for each of 15 s, and the summary: {text}");
    for error in ["final_error_m", "rmse_m"] {
        assert!(summary[error].as_f64().is_some_and(|error| error < LEARNED_M), "{text}");
    }
    assert!(summary["model_version"].as_u64().is_some_and(|version| version > 0), "{text}");
    assert_eq!(
        (summary["refused"].as_u64(), summary["periods_on_fallback_level"]["1"].as_u64()),
        (Some(0), Some(150)),
        "{text}"
    );
    let lossy = circle_of(&repository().join("tests/python/lossy_robot.py"), Record::Kept)?;
    assert_eq!(
        lossy, text,
        "a state, command or credit that was lost is said again, with the same bits"
    );
    Ok(())
}

/// Two robots: the driver of one has another period than the controller's settings, and the wheels
/// of the other may do much less than the robot file contains.
#[test]
fn a_driver_that_contradicts_the_controllers_settings_is_reported() -> Outcome {
    let weak = tempfile::NamedTempFile::new()?;
    let robot = fs::read_to_string(repository().join("deploy/robots/mecanum.toml"))?;
    let lines = robot.lines().map(|line| match line.split_once('=') {
        Some((key, _)) if key.trim() == "input_mps" => "input_mps = 0.2".to_owned(),
        _ => line.to_owned(),
    });
    fs::write(weak.path(), lines.collect::<Vec<_>>().join("\n"))?;
    let weak = weak.path().display().to_string();
    for (key, value) in [("--period-ms", "20"), ("--robot", weak.as_str())] {
        let arguments = [key, value, "--duration", "6"];
        let driven = driven(&clients().join("robot.py"), Record::Kept, &arguments)?;
        let summary = fs::read_to_string(driven.home.path().join("run/summary.json"))?;
        let summary: serde_json::Value = serde_json::from_str(&summary)?;
        let text =
            summary["told"][0].as_str().ok_or_else(|| format!("{arguments:?}: {summary}"))?;
        assert!(driven.told.contains(text), "{arguments:?}: {text} is not in {}", driven.told);
        assert_eq!(summary["figures_of"], "measured");
    }
    Ok(())
}

#[test]
fn the_robot_in_python_encodes_and_decodes_the_test_vectors() -> Outcome {
    let vectors = repository().join("protocol/vectors");
    text_of(
        Command::new(python()?)
            .arg("-B")
            .arg(clients().join("robot.py"))
            .arg("--check")
            .arg(vectors),
    )?;
    Ok(())
}

#[test]
fn the_gate_in_python_keeps_the_duties_of_a_driver() -> Outcome {
    text_of(
        Command::new(python()?).args(["-B", "-m", "unittest", "discover", "-s"]).arg(clients()),
    )?;
    Ok(())
}
