//! Promise: a robot drives to a goal that is given while it drives, without a jump of its
//! reference, and stands there. A stop outlasts it, a restarted controller takes it up again.

use promises::{Launched, Message, Outcome, Record, binaries, python, repository, signal};
use rustix::process::Signal;
use std::error::Error;
use std::fs;
use std::io::{self, Write};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// Bars for the robot at its goal: position [m], heading [rad], and overshoot [m].
const STANDS: (f64, f64, f64) = (0.005, 0.0087, 0.010);

pub(crate) fn launch() -> Result<Launched, Box<dyn Error>> {
    Launched::graph("local", &["--scenario", "goals", "--duration", "600"])
}

pub(crate) fn coxswain(launched: &Launched, arguments: &[&str]) -> Result<Command, Box<dyn Error>> {
    let mut command = Command::new(binaries()?.join("coxswain"));
    command.args(arguments).env("TMPDIR", launched.home());
    Ok(command)
}

/// Exit code and output of `coxswain ARGUMENTS` for the launch.
fn tell(launched: &Launched, arguments: &[&str]) -> Result<(Option<i32>, String), Box<dyn Error>> {
    let output = coxswain(launched, arguments)?.output()?;
    let text = [output.stdout, output.stderr].concat();
    Ok((output.status.code(), String::from_utf8_lossy(&text).into_owned()))
}

fn begin(launched: &Launched, arguments: &[&str]) -> Result<Child, Box<dyn Error>> {
    let mut command = coxswain(launched, arguments)?;
    Ok(command.stdout(Stdio::null()).stderr(Stdio::null()).spawn()?)
}

/// Ends the launch as a user would, and returns its record.
pub(crate) fn end(launched: Launched) -> Result<Record, Box<dyn Error>> {
    signal(launched.pid(), Signal::TERM)?;
    let (_, home) = launched.end()?;
    Ok(Record::read(&home.path().join("run"))?)
}

/// Id and phase of every change of the goals.
fn phases(record: &Record) -> Vec<(u64, String)> {
    let mut phases: Vec<(u64, String)> =
        record.of("goal").map(|goal| (goal.count("id"), goal.word("phase").to_owned())).collect();
    phases.dedup();
    phases
}

fn expected(phases: &[(u64, &str)]) -> Vec<(u64, String)> {
    phases.iter().map(|&(id, phase)| (id, phase.to_owned())).collect()
}

/// `coxswain status --json` of the launch.
pub(crate) fn status(launched: &Launched) -> Result<serde_json::Value, Box<dyn Error>> {
    let (code, text) = tell(launched, &["status", "--json"])?;
    assert_eq!(code, Some(0), "{text}");
    Ok(serde_json::from_str(&text)?)
}

/// Largest component of the velocity of the robot \[m/s, m/s, rad/s\].
pub(crate) fn fastest(status: &serde_json::Value) -> Option<f64> {
    let velocity = status["robot"]["velocity"].as_array()?;
    Some(velocity.iter().filter_map(serde_json::Value::as_f64).map(f64::abs).fold(0.0, f64::max))
}

/// First reference of a plan: x, y, yaw, and the velocity in its own heading.
fn reference(plan: &Message) -> Result<[f64; 6], Box<dyn Error>> {
    let row = plan.fields["reference"][0].as_array().ok_or("no reference")?;
    let numbers: Vec<f64> = row.iter().filter_map(serde_json::Value::as_f64).collect();
    Ok(numbers.try_into().map_err(|_| "not six numbers")?)
}

#[test]
fn a_goal_in_motion_takes_over_without_a_jump_and_the_robot_stands_at_it() -> Outcome {
    let launched = launch()?;
    launched.wait_for_controller(1)?;
    let (code, text) = tell(&launched, &["go", "1.0", "0.5", "90deg"])?;
    assert_eq!(code, Some(0), "{text}");
    let mut first = begin(&launched, &["go", "9.0", "0.0", "0"])?;
    launched.wait_for_log("controller", "goal tick=", 3)?;
    std::thread::sleep(Duration::from_millis(700));
    let (code, text) = tell(&launched, &["go", "1.0", "-0.5", "-90deg"])?;
    assert_eq!(code, Some(0), "{text}");
    assert_eq!(first.wait()?.code(), Some(1), "a later goal has taken its place");
    let (code, text) = tell(&launched, &["status", "--json"])?;
    assert_eq!(code, Some(0), "{text}");
    let status: serde_json::Value = serde_json::from_str(&text)?;
    assert_eq!((&status["goal"]["id"], &status["goal"]["phase"]), (&3.into(), &"reached".into()));
    assert_eq!(status["robot"]["gate"], "driving");
    let record = end(launched)?;

    let changes = [
        (1, "active"),
        (1, "reached"),
        (2, "active"),
        (2, "preempted"),
        (3, "active"),
        (3, "reached"),
    ];
    assert_eq!(phases(&record), expected(&changes));
    let truth = record.of("truth").next_back().ok_or("no truth")?.numbers("pose");
    let off = (truth[0] - 1.0).hypot(truth[1] + 0.5);
    let turned = (truth[2] + std::f64::consts::FRAC_PI_2).abs();
    assert!(off < STANDS.0 && turned < STANDS.1, "{off} m, {turned} rad");
    // The first goal is reached from the side of smaller x: beyond it is overshoot.
    let reached = record.of("goal").find(|goal| goal.count("id") == 2).ok_or("no second goal")?;
    let until = reached.stamp("tick");
    let over = record.of("truth").filter(|truth| truth.stamp("tick") < until);
    let over = over.map(|truth| truth.numbers("pose")[0] - 1.0).fold(0.0, f64::max);
    writeln!(
        io::stdout(),
        "at the goal {:.2} mm and {:.3} deg off, overshoot {:.2} mm",
        1e3 * off,
        turned.to_degrees(),
        1e3 * over
    )?;
    assert!(over < STANDS.2, "overshoot {over} m");

    let references = record.of("plan").map(reference).collect::<Result<Vec<_>, _>>()?;
    assert!(references.len() > 200);
    for pair in references.windows(2) {
        let moved = (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]);
        let mean = 0.5 * (pair[0][3].hypot(pair[0][4]) + pair[1][3].hypot(pair[1][4]));
        assert!((moved - 0.02 * mean).abs() < 2e-3, "a jump of {moved} m at {mean} m/s");
    }
    Ok(())
}

#[test]
fn a_path_that_is_given_while_another_one_is_driven_is_joined_without_a_stop() -> Outcome {
    let launched = launch()?;
    launched.wait_for_controller(1)?;
    let speed = 0.6;
    let follow = |name: &str, points: &[[f64; 2]]| -> Result<Child, Box<dyn Error>> {
        let file = launched.home().join(name);
        let lines = points.iter().map(|[x, y]| format!("{x},{y}\n"));
        fs::write(&file, format!("x_m,y_m\n{}", lines.collect::<String>()))?;
        let file = file.to_string_lossy().into_owned();
        begin(&launched, &["follow", &file, "--speed", &speed.to_string()])
    };
    let mut first = follow("first.csv", &[[0.5, 0.0], [12.0, 0.0]])?;
    launched.wait_until("motion", || {
        status(&launched).is_ok_and(|status| fastest(&status).is_some_and(|is| is > 0.9 * speed))
    })?;
    let x = status(&launched)?["robot"]["pose"][0].as_f64().ok_or("no pose")?;
    // The first point may be 1 m away. A robot that passes it before it has the path slows down.
    let points = [[x + 0.9, 0.0], [x + 3.2, 1.0], [x + 5.0, 1.0]];
    let mut second = follow("second.csv", &points)?;
    assert!(second.wait()?.success(), "the robot has not arrived");
    assert_eq!(first.wait()?.code(), Some(1), "a later goal has taken its place");
    let record = end(launched)?;

    let changes = [(1, "active"), (1, "preempted"), (2, "active"), (2, "reached")];
    assert_eq!(phases(&record), expected(&changes));
    let tick = |phase: &str| {
        let mut goals = record.of("goal").filter(|goal| goal.count("id") == 2);
        goals.find(|goal| goal.word("phase") == phase).map(|goal| goal.stamp("tick"))
    };
    let (from, to) = (tick("active").ok_or("not active")?, tick("reached").ok_or("not there")?);
    // A busy machine misses periods. The gate brakes then, and a second later the robot is as fast
    // as before.
    let missed = record
        .of("state")
        .filter(|state| matches!(state.word("fallback_level"), "stored tail" | "brake"));
    let missed: Vec<u64> = missed.map(|state| state.stamp("tick")).collect();
    let is_disturbed =
        |tick: u64| missed.iter().any(|&missed| (missed..missed + 50).contains(&tick));
    // The last two seconds are for the stop at the end.
    let driven = record.of("truth").filter(|truth| {
        let tick = truth.stamp("tick");
        (from..to - 100).contains(&tick) && !is_disturbed(tick)
    });
    let speeds: Vec<f64> =
        driven.map(|truth| truth.numbers("velocity")).map(|v| v[0].hypot(v[1])).collect();
    assert!(speeds.len() > 50, "{} ticks without a missed period", speeds.len());
    let slowest = speeds.into_iter().fold(f64::MAX, f64::min);
    writeln!(io::stdout(), "on the second path the robot drives {slowest:.2} m/s or faster")?;
    assert!(slowest > 0.5 * speed, "{slowest} m/s");
    let truth = record.of("truth").next_back().ok_or("no truth")?.numbers("pose");
    assert!((truth[0] - x - 5.0).hypot(truth[1] - 1.0) < STANDS.0, "{truth:?}");
    Ok(())
}

#[test]
fn a_goal_waits_while_the_gate_is_stopped_and_goes_on_after_it() -> Outcome {
    let launched = launch()?;
    launched.wait_for_controller(1)?;
    // Without a limit, a stop that comes later finds a faster robot, which needs longer to brake.
    let mut going = begin(&launched, &["go", "3.0", "0.0", "0", "--speed", "1.0"])?;
    launched.wait_for_log("controller", "goal tick=", 1)?;
    std::thread::sleep(Duration::from_millis(500));
    assert_eq!(tell(&launched, &["stop"])?.0, Some(0));
    let (code, text) = tell(&launched, &["go", "1.0", "0.0", "0"])?;
    assert_eq!(code, Some(2), "a stopped robot takes no goal: {text}");
    std::thread::sleep(Duration::from_secs(2));
    assert_eq!(tell(&launched, &["resume"])?.0, Some(0));
    assert!(going.wait()?.success());
    let record = end(launched)?;
    assert_eq!(phases(&record), expected(&[(1, "active"), (1, "reached")]));
    let truth = record.of("truth").next_back().ok_or("no truth")?.numbers("pose");
    assert!((truth[0] - 3.0).hypot(truth[1]) < STANDS.0, "{truth:?}");
    // The robot does not hurry after a reference that went on without it.
    let error = |plan: &Message| -> Option<f64> {
        let [x, y, ..] = reference(plan).ok()?;
        let at = |index: usize| plan.fields["predicted"][0][index].as_f64();
        Some((x - at(0)?).hypot(y - at(1)?))
    };
    let worst = record.of("plan").filter_map(error).fold(0.0, f64::max);
    assert!(worst < 0.3, "{worst} m from its reference");
    Ok(())
}

#[test]
fn a_restarted_controller_takes_the_goal_up_again() -> Outcome {
    let launched = launch()?;
    launched.wait_for_controller(1)?;
    let mut going = begin(&launched, &["go", "4.0", "1.0", "180deg", "--speed", "0.8"])?;
    launched.wait_for_log("controller", "goal tick=", 1)?;
    std::thread::sleep(Duration::from_millis(1500));
    let pid = launched.process("controller", None)?;
    signal(pid, Signal::KILL)?;
    assert!(going.wait()?.success(), "the robot has not arrived");
    let record = end(launched)?;
    let truth = record.of("truth").next_back().ok_or("no truth")?.numbers("pose");
    assert!((truth[0] - 4.0).hypot(truth[1] - 1.0) < STANDS.0, "{truth:?}");
    let fast = record.of("truth").map(|truth| truth.numbers("velocity"));
    let fastest = fast.map(|velocity| velocity[0].hypot(velocity[1])).fold(0.0, f64::max);
    assert!(fastest < 1.0, "{fastest} m/s with a limit of 0.8");
    Ok(())
}

#[test]
fn paths_and_velocities_are_driven_and_impossible_ones_change_nothing() -> Outcome {
    let launched = launch()?;
    launched.wait_for_controller(1)?;
    let file = launched.home().join("path.csv");
    let follow = |launched: &Launched, text: &str, more: &[&str]| {
        fs::write(&file, text)?;
        let name = file.to_string_lossy().into_owned();
        tell(launched, &[&["follow", &name], more].concat())
    };
    let (code, text) =
        follow(&launched, "x_m,y_m\n0.5,0\n1.5,0\n1.5,1\n", &["--heading", "tangent"])?;
    assert_eq!(code, Some(0), "{text}");
    let (code, text) = tell(&launched, &["drive", "-0.3", "0.2", "0.5", "--for", "1.5"])?;
    assert_eq!(code, Some(0), "{text}");
    assert_eq!(tell(&launched, &["hold"])?.0, Some(0));
    for (text, more) in [
        ("x_m,y_m\n50,0\n", vec![]),
        ("x_m,y_m\n", vec![]),
        ("x_m,y_m\n1,nan\n", vec![]),
        ("x,y\n1,2\n", vec![]),
        ("x_m,y_m\n1,1\n", vec!["--heading", "sideways"]),
        ("x_m,y_m\n1,1\n", vec!["--speed", "-1"]),
    ] {
        let (code, told) = follow(&launched, text, &more)?;
        assert_eq!(code, Some(2), "{text}: {told}");
    }
    for wrong in [["go", "1", "2", "north"], ["go", "1e9", "0", "0"], ["drive", "1", "0", "nan"]] {
        let (code, told) = tell(&launched, &wrong)?;
        assert_eq!(code, Some(2), "{wrong:?}: {told}");
    }
    let record = end(launched)?;
    let reached = phases(&record).into_iter().filter(|(_, phase)| phase == "reached");
    assert_eq!(reached.map(|(id, _)| id).collect::<Vec<_>>(), [1, 2, 3]);
    let ended = record.of("truth").next_back().ok_or("no truth")?;
    assert!(ended.numbers("velocity").iter().all(|velocity| velocity.abs() < 0.05));
    Ok(())
}

/// The examples that send a goal and wait for it, without arguments.
fn programs() -> Result<[Command; 2], Box<dyn Error>> {
    let mut script = Command::new(python()?);
    script.arg("-B").arg(repository().join("deploy/clients/python/go.py"));
    Ok([Command::new(binaries()?.join("examples/go")), script])
}

#[test]
fn short_programs_in_rust_and_python_send_a_goal_and_wait_until_it_is_reached() -> Outcome {
    for file in ["services/coxswain/examples/go.rs", "deploy/clients/python/go.py"] {
        assert!(fs::read_to_string(repository().join(file))?.lines().count() <= 35, "{file}");
    }
    let launched = launch()?;
    launched.gateway_endpoint()?;
    launched.wait_for_controller(1)?;
    let places = [["0.5", "0.2"], ["-0.2", "0.1"]];
    for (number, (mut program, to)) in (1..).zip(programs()?.into_iter().zip(places)) {
        let output = program.args(to).env("TMPDIR", launched.home()).output()?;
        let errors = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(0), "{program:?}: {errors}");
        let status = status(&launched)?;
        let goal = (&status["goal"]["id"], &status["goal"]["phase"]);
        assert_eq!(goal, (&number.into(), &"reached".into()));
        for (axis, to) in to.into_iter().enumerate() {
            let is = status["robot"]["pose"][axis].as_f64().ok_or("no pose")?;
            assert!((is - to.parse::<f64>()?).abs() < 0.02, "{program:?}: {status}");
        }
    }
    // The controller rejects it.
    for mut program in programs()? {
        let output = program.args(["1e9", "0"]).env("TMPDIR", launched.home()).output()?;
        assert_eq!((output.status.code(), output.stderr.is_empty()), (Some(1), false));
    }
    end(launched)?;
    Ok(())
}

#[test]
fn the_programs_report_a_wrong_argument_and_a_missing_launch() -> Outcome {
    let home = tempfile::tempdir()?;
    for (arguments, code) in
        [(&["1"][..], 2), (&["1", "north"], 2), (&["1", "2", "3", "4"], 2), (&["1", "2"], 1)]
    {
        for mut program in programs()? {
            let output = program.args(arguments).env("TMPDIR", home.path()).output()?;
            let is = (output.status.code(), output.stderr.is_empty());
            assert_eq!(is, (Some(code), false), "{program:?}");
        }
    }
    Ok(())
}
