//! Promise: a robot written in another language, from `protocol/WIRE.md` alone, is driven and
//! learned.

use access::Credentials;
use coxswain::obstacles::ObstacleLists;
use driver::{Listed, PlannerList};
use graph::assembly::robot_of;
use process::lists::{Lists, Verdict, socket};
use promises::{
    Launched, Outcome, Reader, Record, binaries, graph_file, graph_with, launch_command, port,
    python, repository, signal, text_of,
};
use rustix::process::Signal;
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

/// The driver prints its distance to the circle of the scenario.
const CIRCLE: [&str; 3] = ["--circle", "2", "1.5"];

/// Whether bridge and driver have certificates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Access {
    Open,
    Certificates,
}

/// A launch of the host `control` of `foreign-driver.toml` for `scenario`, with more options, and
/// the command of its driver. No other test has its port.
fn control_host(
    script: &Path,
    access: Access,
    pace: &str,
    (scenario, more): (&str, &[&str]),
) -> Result<(Launched, Command), Box<dyn Error>> {
    control_host_of(&graph_file("foreign-driver"), script, access, pace, (scenario, more))
}

/// The same for a graph like `foreign-driver.toml`.
fn control_host_of(
    graph: &Path,
    script: &Path,
    access: Access,
    pace: &str,
    (scenario, more): (&str, &[&str]),
) -> Result<(Launched, Command), Box<dyn Error>> {
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    let port = port::free()?;
    let address = format!("127.0.0.1:{port}");
    let mut robot = Command::new(python()?);
    robot.arg("-B").arg(script).arg("--robot").arg(repository().join("deploy/robots/mecanum.toml"));
    robot.args(["--graph", "mecanum", "--host", "driver", "--to", "control", "--pace", pace]);
    robot.args(["--recorded", "--connect"]);
    let options = ["--host", "control", "--scenario", scenario, "--pace", pace];
    let mut launch = launch_command(graph, &home.path().join("run"), &options)?;
    launch.args(more).args(["--address", &format!("driver={address}"), "--duration", "600"]);
    if access == Access::Certificates {
        let certificates = home.path().join("certificates");
        let mut issue = Command::new(binaries()?.join("coxswain"));
        issue.args(["certificates", "--robot", "mecanum", "--host", "control", "--out"]);
        text_of(issue.arg(&certificates))?;
        launch.arg("--certificates").arg(&certificates);
        robot.arg(format!("tls/{address}")).arg("--certificates").arg(certificates);
    } else {
        robot.arg(format!("tcp/{address}"));
    }
    Ok((Launched::by(launch, home)?, robot))
}

/// Result of a circle of 15 s in lock step.
struct Driven {
    /// Output of the robot.
    text: String,
    /// Output of the launch.
    told: String,
    /// Its folder.
    home: TempDir,
}

/// A circle of 15 s in lock step, driven by a real controller with a real learner, with more
/// `arguments` for the robot.
fn driven(script: &Path, access: Access, arguments: &[&str]) -> Result<Driven, Box<dyn Error>> {
    let (launched, mut robot) = control_host(script, access, "lock-step", ("circle", &[]))?;
    let text = text_of(robot.args(CIRCLE).args(arguments))?;
    let (ended, home) = launched.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    Ok(Driven { text, told: ended.text, home })
}

/// `robot.py` beside the package that pip has installed, far from its source.
fn installed() -> Result<TempDir, Box<dyn Error>> {
    let (source, installed) = (tempfile::tempdir()?, tempfile::tempdir()?);
    for name in ["coxswain", "pyproject.toml", "README.md"] {
        // Not the original: pip leaves files beside it.
        text_of(Command::new("cp").arg("-r").arg(clients().join(name)).arg(source.path()))?;
    }
    let mut pip = Command::new(python()?);
    pip.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps"]);
    text_of(pip.arg("--target").arg(installed.path()).arg(source.path()))?;
    fs::copy(clients().join("robot.py"), installed.path().join("robot.py"))?;
    Ok(installed)
}

#[test]
fn a_robot_in_python_drives_a_circle_and_is_learned_through_losses_too() -> Outcome {
    let installed = installed()?;
    assert!(installed.path().join("coxswain/py.typed").is_file());
    let text = driven(&installed.path().join("robot.py"), Access::Open, &[])?.text;
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
    let lossy = repository().join("tests/python/lossy_robot.py");
    assert_eq!(
        driven(&lossy, Access::Certificates, &[])?.text,
        text,
        "a state, command or credit that was lost is sent again, with the same bits"
    );
    Ok(())
}

/// The gains and lags are those of `robot.py`.
#[test]
fn a_robot_in_python_drives_prepared_files_and_is_identified() -> Outcome {
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    let path = |name: &str| home.path().join(name).display().to_string();
    let sheet = repository().join("deploy/robots/mecanum.toml").display().to_string();
    let identify = |arguments: &[&str]| -> Result<String, Box<dyn Error>> {
        let mut command = Command::new(binaries()?.join("coxswain"));
        text_of(command.env("TMPDIR", home.path()).arg("identify").args(arguments))
    };
    let (graph, out) = (graph_file("foreign-driver").display().to_string(), path("drive"));
    let told = identify(&[
        "--drive",
        &graph,
        "--prepare",
        "--area",
        "3x3",
        "--duration",
        "40",
        "--out",
        &out,
    ])?;
    assert!(
        told.contains("--host control --scenario") && !told.contains("--host driver"),
        "{told}"
    );
    let (scenario, robot) = (path("drive/drive.toml"), path("drive/driven-robot.toml"));
    let script = clients().join("robot.py");
    let more = ["--robot", &robot, "--learner", "off"];
    let (launched, mut driver) =
        control_host(&script, Access::Open, "lock-step", (&scenario, &more))?;
    text_of(driver.args(["--duration", "30"]))?;
    let (ended, run) = launched.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    let (run, found) = (run.path().join("run").display().to_string(), path("found"));
    identify(&[&run, "--robot", &sheet, "--out", &found])?;
    let response = robot_of(&home.path().join("found/robot.toml"))?.response.ok_or("none")?;
    for (axis, (gain, lag_s)) in [(0.8, 0.6), (0.75, 0.6), (0.8, 0.4)].into_iter().enumerate() {
        assert!((response.gain[axis] / gain - 1.0).abs() < 0.03, "{response:?}");
        assert!((response.time_constant_s[axis] / lag_s - 1.0).abs() < 0.1, "{response:?}");
    }
    Ok(())
}

/// The number behind `name` in a line of the robot.
fn number(line: &str, name: &str) -> Option<f64> {
    let (_, rest) = line.split_once(name)?;
    rest.split_whitespace().next()?.parse().ok()
}

/// The fallback level in a line of the robot.
fn fallback_level(line: &str) -> Option<u32> {
    let (_, rest) = line.split_once("fallback level ")?;
    rest.split(',').next()?.parse().ok()
}

#[test]
fn a_robot_in_python_drives_on_after_the_bridge_is_killed() -> Outcome {
    for access in [Access::Open, Access::Certificates] {
        let script = clients().join("robot.py");
        let (launched, mut robot) = control_host(&script, access, "real-time", ("circle", &[]))?;
        // The circle begins with the robot. A controller that starts seconds later stops a robot
        // that is that far behind.
        launched.process("controller", None)?;
        let mut robot = Reader::start(robot.args(CIRCLE).args(["--duration", "600"]))?;
        let drives = |robot: &mut Reader| -> Outcome {
            while fallback_level(robot.lines(1)?.first().ok_or("no line")?) != Some(1) {}
            Ok(())
        };
        drives(&mut robot)?;
        let bridge = launched.process("bridge", None)?;
        signal(bridge, Signal::KILL)?;
        launched.process("bridge", Some(bridge))?;
        // Commands from before the kill act for three periods at most.
        robot.lines(3)?;
        drives(&mut robot)?;
        signal(robot.pid(), Signal::TERM)?;
        assert_eq!(robot.end()?.code(), Some(128 + 15), "{access:?}: {}", robot.errors());
    }
    Ok(())
}

/// The robot file of `robot.py` with its true response.
fn slow_robot(home: &Path) -> Result<String, Box<dyn Error>> {
    let text = fs::read_to_string(repository().join("deploy/robots/mecanum.toml"))?;
    let (wheels, rest) = text.split_once("[body]").ok_or("no [body]")?;
    let (_, limits) = rest.split_once("[limits]").ok_or("no [limits]")?;
    let response = "[response]\ntime_constant_s = [0.6, 0.6, 0.4]\ngain = [0.8, 0.75, 0.8]\n\
                    wheel_speed_limit_radps = 120.0\n";
    let file = home.join("robot.toml");
    fs::write(&file, format!("{wheels}{response}[limits]{limits}"))?;
    Ok(file.display().to_string())
}

#[test]
fn a_robot_in_python_keeps_its_map_and_the_lists_of_planners() -> Outcome {
    let script = clients().join("robot.py");
    let (launched, mut robot) = control_host(&script, Access::Open, "real-time", ("hold", &[]))?;
    let (map, socket) = (launched.home().join("map.toml"), socket(launched.home()));
    // The controller does not know this map.
    fs::write(&map, "fence_m = [[-1, -2], [4, -2], [4, 2], [-1, 2]]\n")?;
    robot.arg("--map").arg(&map).arg("--lists").arg(&socket).args(["--duration", "600"]);
    let robot_file = slow_robot(launched.home())?;
    let mut robot = Reader::start(robot.args(["--robot", &robot_file]))?;
    launched.wait_for_controller(1)?;
    let drive = || -> Outcome {
        let mut drive = Command::new(binaries()?.join("coxswain"));
        drive.args(["drive", "0.5", "0", "0", "--for", "60", "--no-wait"]);
        text_of(drive.env("TMPDIR", launched.home()))?;
        Ok(())
    };
    // x where it stands, beyond `from`, in a line with `reason`.
    let mut standstill = |reason: &str, from: f64| -> Result<f64, Box<dyn Error>> {
        let mut before = f64::INFINITY;
        for _ in 0..120 {
            let line = robot.lines(1)?.pop().ok_or("no line")?;
            let x = number(&line, " x ").ok_or("no x")?;
            if line.contains(reason) && x > from && (x - before).abs() < 0.01 {
                return Ok(x);
            }
            before = x;
        }
        Err(format!("no standstill beyond {from} m with {reason:?}: {before} m").into())
    };
    drive()?;
    let x = standstill("reason 24,", -0.1)?;
    assert!(x.abs() < 0.05, "without a list it stands: {x} m");
    let mut lists = Lists::new(launched.home());
    let wall = r#"[{"corners_m": [[2, -9], [2.2, -9], [2.2, 9], [2, 9]]}]"#;
    let list = |obstacles: &str| format!(r#"{{"valid_s": 600, "obstacles": {obstacles}}}"#);
    assert_eq!(lists.send(&list(wall))?, Verdict::Accepted);
    assert!(matches!(lists.send(&list("1"))?, Verdict::Rejected { .. }));
    drive()?;
    let x = standstill("", 0.5)?;
    assert!(x < 2.0 - 0.175, "before the wall: {x} m");
    assert_eq!(lists.send(&list("[]"))?, Verdict::Accepted);
    drive()?;
    let x = standstill("reason 26,", 2.5)?;
    assert!(x < 4.0 - 0.175, "before the fence: {x} m");

    signal(launched.pid(), Signal::TERM)?;
    let (_, home) = launched.end()?;
    signal(robot.pid(), Signal::TERM)?;
    let record = Record::read(&home.path().join("run"))?;
    let sources: Vec<&str> = record.of("obstacles").map(|list| list.word("source")).collect();
    assert_eq!(sources, ["planner", "planner"]);
    let reasons: Vec<&str> = record.of("state").map(|state| state.word("reason")).collect();
    assert!(reasons.contains(&"obstacles unknown") && reasons.contains(&"geofence"));
    Ok(())
}

#[test]
fn a_list_from_another_machine_reaches_a_driver_outside_the_launch() -> Outcome {
    let folder = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    let socket = folder.path().join("lists");
    let address = format!("127.0.0.1:{}", port::free()?);
    let tables = format!("[requests]\ncontrol = \"{address}\"\n");
    let graph = graph_with("foreign-driver", &tables, folder.path())?;
    let driver = format!("driver = true\nlists = \"{}\" #", socket.display());
    fs::write(&graph, fs::read_to_string(&graph)?.replacen("driver = true", &driver, 1))?;
    let script = clients().join("robot.py");
    let hold = ("hold", [].as_slice());
    let (launched, mut robot) =
        control_host_of(&graph, &script, Access::Certificates, "real-time", hold)?;
    robot.arg("--lists").arg(&socket).args(["--duration", "600"]);
    let mut robot = Reader::start(&mut robot)?;
    launched.wait_for_controller(1)?;
    let planner = launched.home().join("certificates/planner");
    let mut lists =
        ObstacleLists::over_network(&format!("tls/{address}"), &Credentials::in_folder(planner))?;
    let disc = Listed { corners_m: vec![[9.0, 0.0]], radius_m: 0.2, velocity_mps: [0.0; 2] };
    let list = |valid_s: f64| PlannerList { valid_s, age_s: 0.0, obstacles: vec![disc.clone()] };
    for valid_s in [600.0, 599.0] {
        lists.send(&list(valid_s))?;
        robot.lines(2)?; // one per second: the list has begun to act
    }
    signal(robot.pid(), Signal::TERM)?;
    robot.end()?;
    assert!(lists.send(&list(598.0)).is_err(), "the driver has ended");
    signal(launched.pid(), Signal::TERM)?;
    let (_, home) = launched.end()?;
    let record = Record::read(&home.path().join("run"))?;
    let sources: Vec<&str> = record.of("obstacles").map(|list| list.word("source")).collect();
    assert_eq!(sources, ["planner", "planner"]);
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
        let driven = driven(&clients().join("robot.py"), Access::Open, &arguments)?;
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
            .current_dir(clients())
            .args(["-B", "-m", "coxswain.vectors"])
            .arg(vectors),
    )?;
    Ok(())
}

#[test]
fn the_gate_in_python_keeps_the_duties_of_a_driver() -> Outcome {
    text_of(
        Command::new(python()?).current_dir(clients()).args(["-B", "-m", "unittest", "discover"]),
    )?;
    Ok(())
}

#[test]
fn the_package_in_python_has_types_that_hold() -> Outcome {
    let cache = tempfile::tempdir()?;
    let mut check = Command::new(python()?);
    check.current_dir(clients()).args(["-m", "mypy", "--strict", "--cache-dir"]).arg(cache.path());
    text_of(check.args(["coxswain", "robot.py"]))?;
    Ok(())
}
