//! Promise: a robot that leaves its path brakes, and stands still until a person resumes it, for
//! any commands of any controller. A robot that was cut off catches up.

use promises::{
    Launched, Message, Outcome, Reader, Record, binaries, graph_file, launch_command, repository,
    signal,
};
use rustix::process::Signal;
use std::error::Error;
use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::Duration;
use tempfile::TempDir;

/// A force above the grip of all wheels together, from 4 s on for 0.8 s: it moves the robot by some
/// 3 m.
const PUSH: &str = "\n[truth.push]\nforce_n = [0.0, 450.0]\nfrom_s = 4.0\nuntil_s = 4.8\n";
/// Well below that, and well above the error at the start.
const LIMIT: &str = "tracking_error_m = 1.0\n";
/// Tick after the stop at which the ramp of the brake has ended for sure.
const STANDS_AFTER_TICKS: u64 = 10;

/// A folder for the files of a launch.
fn home() -> Result<TempDir, Box<dyn Error>> {
    Ok(tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?)
}

/// The scenario of a circle.
fn circle() -> Result<String, Box<dyn Error>> {
    Ok(fs::read_to_string(repository().join("deploy/scenarios/circle.toml"))?)
}

/// A robot that holds its place, and is pushed away from it.
fn pushed() -> Result<String, Box<dyn Error>> {
    let text = circle()?;
    let circle = "path.circle = { radius_m = 2.0, speed_mps = 1.5 }\nheading = \"tangent\"";
    assert!(text.contains(circle), "{text}");
    let place = "path.point-to-point = { to = [0.0, 0.0, 0.0], speed_mps = 1.0, \
                 acceleration_mps2 = 1.0 }\nheading = { fixed-rad = 0.0 }";
    Ok(format!("{}\n{PUSH}", text.replace(circle, place)))
}

/// Launches `graph` with this scenario, and a robot with these limits beside its others.
fn launch(
    graph: &Path,
    scenario: &str,
    limits: &str,
    options: &[&str],
) -> Result<Launched, Box<dyn Error>> {
    let home = home()?;
    let [scenario_file, robot_file] =
        ["scenario.toml", "robot.toml"].map(|name| home.path().join(name));
    fs::write(&scenario_file, scenario)?;
    let robot = fs::read_to_string(repository().join("deploy/robots/mecanum.toml"))?;
    fs::write(&robot_file, robot + limits)?;
    let mut command = launch_command(graph, &home.path().join("run"), options)?;
    command.arg("--scenario").arg(scenario_file).arg("--robot").arg(robot_file);
    Launched::by(command, home)
}

/// Exit code and output of `coxswain ORDER` for the launch.
fn order(launched: &Launched, order: &str) -> Result<(Option<i32>, String), Box<dyn Error>> {
    let output = Command::new(binaries()?.join("coxswain"))
        .arg(order)
        .env("TMPDIR", launched.home())
        .output()?;
    let text = [output.stdout, output.stderr].concat();
    Ok((output.status.code(), String::from_utf8_lossy(&text).into_owned()))
}

/// The first number in what an order reports: the tick from which it acts.
fn tick_of(text: &str) -> Option<u64> {
    text.split_whitespace().find_map(|word| word.parse().ok())
}

/// The word under `key` of what `coxswain status --json` reports of the robot; empty without one.
fn status(launched: &Launched, key: &str) -> String {
    let output = binaries().map(|folder| {
        let mut status = Command::new(folder.join("coxswain"));
        status.args(["status", "--json"]).env("TMPDIR", launched.home()).output()
    });
    let Ok(Ok(output)) = output else { return String::new() };
    let status: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap_or_default();
    status["robot"][key].as_str().unwrap_or_default().to_owned()
}

/// Ends the launch as a user would. Returns its output and the record.
fn end(launched: Launched) -> Result<(String, Record), Box<dyn Error>> {
    signal(launched.pid(), Signal::TERM)?;
    let (ended, home) = launched.end()?;
    Ok((ended.text, Record::read(&home.path().join("run"))?))
}

fn is_stopped(state: &Message) -> bool {
    state.word("gate") == "stopped"
}

/// Ticks of the first and the last state that report a stop.
fn stop_of(record: &Record) -> Result<(u64, u64), Box<dyn Error>> {
    let ticks: Vec<u64> = record
        .of("state")
        .filter(|state| is_stopped(state))
        .map(|state| state.stamp("tick"))
        .collect();
    let (first, last) = ticks.first().zip(ticks.last()).ok_or("the gate never stopped")?;
    assert_eq!(ticks.len() as u64, last - first + 1, "one stop, without a gap");
    Ok((*first, *last))
}

#[test]
fn a_robot_thrown_off_its_path_stands_through_a_restart_until_a_person_resumes_it() -> Outcome {
    let launched = launch(&graph_file("local"), &pushed()?, LIMIT, &["--duration", "600"])?;
    let endpoint = launched.gateway_endpoint()?;
    let mut watch = Reader::start(
        Command::new(binaries()?.join("coxswain")).args(["watch", "--plain", &endpoint]),
    )?;
    launched.wait_for_controller(1)?;
    let (code, text) = order(&launched, "resume")?;
    assert_eq!(code, Some(2), "there is nothing to resume yet: {text}");
    launched.told_a_person("limits.tracking_error_m")?;
    while !watch.lines(1)?.iter().any(|line| line.ends_with("STOPPED: position error")) {}

    let pid = launched.process("controller", None)?;
    signal(pid, Signal::KILL)?;
    launched.process("controller", Some(pid))?;
    launched.wait_for_controller(2)?;
    std::thread::sleep(Duration::from_secs(1));
    let (code, text) = order(&launched, "arm")?;
    assert_eq!(code, Some(2), "{text}");
    assert!(text.contains("(gate)") && text.contains("disarmed"), "{text}");
    let (code, text) = order(&launched, "resume")?;
    assert_eq!(code, Some(0), "{text}");
    assert!(tick_of(&text).is_some(), "{text}");
    while !watch.lines(1)?.iter().any(|line| line.contains("fresh plan")) {}
    std::thread::sleep(Duration::from_secs(1));
    let (code, text) = order(&launched, "resume")?;
    assert!(code == Some(2) && text.contains("(gate)"), "{text}");
    let (told, record) = end(launched)?;

    let (first, last) = stop_of(&record)?;
    for state in record.of("state").filter(|state| is_stopped(state)) {
        let tick = state.stamp("tick");
        assert_eq!(state.word("stop"), "position error", "tick {tick}");
        assert_eq!(state.word("fallback_level"), "latched stop", "tick {tick}");
        if tick > first + STANDS_AFTER_TICKS {
            assert_eq!(state.numbers("input"), [0.0; 3], "tick {tick}");
        }
    }
    let epochs = |of: &Record| {
        let mut epochs: Vec<u64> = of.of("command").map(|command| command.stamp("epoch")).collect();
        epochs.dedup();
        epochs.len()
    };
    assert_eq!(epochs(&record), 2, "the second controller found the gate stopped");
    let mut after = record.of("state").filter(|state| state.stamp("tick") > last);
    assert!(after.any(|state| state.word("fallback_level") == "fresh plan"), "it drives again");
    let asked = record.of("command").find(|command| command.word("stop") == "position error");
    assert!(asked.is_some_and(|command| command.stamp("tick") < first));

    let stops = &record.summary["stops"];
    assert_eq!(
        (stops[0]["reason"].as_str(), stops.as_array().map(Vec::len)),
        (Some("position error"), Some(1))
    );
    assert!(stops[0]["resumed_s"].as_f64() > stops[0]["at_s"].as_f64(), "{stops}");
    let of_plant = record.of("set").filter(|settled| settled.fields["process"] == "plant");
    let outcomes: Vec<_> = of_plant.map(|settled| settled.fields["outcome"].as_str()).collect();
    assert_eq!(outcomes, ["refused", "refused", "applied", "refused"].map(Some));
    let is_about_it =
        |line: &&str| line.starts_with("controller: ") && line.contains("limits.tracking_error_m");
    let lines = told.lines().filter(is_about_it).count();
    assert!((1..=2).contains(&lines), "one line per controller: {told}");
    Ok(())
}

#[test]
fn an_operator_stops_the_robot_also_without_a_controller_and_for_a_restarted_plant() -> Outcome {
    let launched = launch(&graph_file("local"), &circle()?, "", &["--duration", "600"])?;
    launched.wait_for_controller(1)?;
    let controller = launched.process("controller", None)?;
    signal(controller, Signal::STOP)?;
    let (code, text) = order(&launched, "stop")?;
    assert_eq!(code, Some(0), "{text}");
    launched.process("controller", Some(controller))?;
    launched.wait_until("a stopped gate", || status(&launched, "stop") == "operator stop")?;

    std::thread::sleep(Duration::from_secs(2));
    let plant = launched.process("plant-sim", None)?;
    signal(plant, Signal::KILL)?;
    launched.process("plant-sim", Some(plant))?;
    launched.wait_for_controller(3)?;
    std::thread::sleep(Duration::from_secs(2));
    let (code, text) = order(&launched, "stop")?;
    assert_eq!(code, Some(0), "a stopped robot can be stopped: {text}");
    let (code, text) = order(&launched, "resume")?;
    assert_eq!(code, Some(0), "{text}");
    std::thread::sleep(Duration::from_secs(1));
    let (_, record) = end(launched)?;

    let epochs: Vec<u64> = {
        let mut epochs: Vec<u64> = record.of("state").map(|state| state.stamp("epoch")).collect();
        epochs.dedup();
        epochs
    };
    assert_eq!(epochs.len(), 2, "{epochs:?}");
    for epoch in epochs {
        let states = || record.of("state").filter(|state| state.stamp("epoch") == epoch);
        let stopped: Vec<_> = states().filter(|state| is_stopped(state)).collect();
        assert!(stopped.iter().all(|state| state.word("stop") == "operator stop"));
        let first = stopped.first().ok_or("never stopped")?.stamp("tick");
        let stands: Vec<_> = stopped
            .iter()
            .filter(|state| state.stamp("tick") > first + STANDS_AFTER_TICKS)
            .map(|state| state.numbers("input"))
            .collect();
        assert!(!stands.is_empty() && stands.iter().all(|input| *input == [0.0; 3]), "{stands:?}");
    }
    let last = record.of("state").next_back().ok_or("no state")?;
    assert_eq!(last.word("gate"), "driving", "after the order to resume");
    Ok(())
}

#[test]
fn without_a_limit_nothing_is_latched() -> Outcome {
    for (limits, stops) in [("tracking_error_m = \"none\"\n", false), (LIMIT, true)] {
        let options = ["--pace", "lock-step", "--duration", "15"];
        let launched = launch(&graph_file("local"), &pushed()?, limits, &options)?;
        let (ended, home) = launched.end()?;
        assert!(ended.status.success(), "{}", ended.text);
        let record = Record::read(&home.path().join("run"))?;
        assert_eq!(stop_of(&record).is_ok(), stops, "{limits}: {}", ended.text);
        let last = record.of("state").next_back().ok_or("no state")?;
        let fallback_level = if stops { "latched stop" } else { "fresh plan" };
        assert_eq!(last.word("fallback_level"), fallback_level, "{limits}: {}", ended.text);
    }
    Ok(())
}

#[test]
fn a_robot_that_was_cut_off_catches_up() -> Outcome {
    let faults = "[[fault]]\ntopic = \"command\"\nat = \"reader\"\nparticipant = \"plant\"\n\
                  kind = \"drop\"\nfrom_tick = 60\nuntil_tick = 90\n";
    let folder = home()?;
    let file = folder.path().join("faults.toml");
    fs::write(&file, faults)?;
    let options = ["--duration", "16", "--faults", &file.to_string_lossy()];
    let launched = launch(&graph_file("local"), &circle()?, LIMIT, &options)?;
    let (ended, home) = launched.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    let record = Record::read(&home.path().join("run"))?;
    assert!(stop_of(&record).is_err(), "it was latched: {}", ended.text);
    let error = |state: &Message| {
        let plan = record.of("plan").find(|plan| plan.stamp("tick") == state.stamp("tick"))?;
        let reference = plan.fields["reference"][0].as_array()?;
        let at = |axis: usize| Some(reference.get(axis)?.as_f64()? - state.numbers("pose")[axis]);
        Some(at(0)?.hypot(at(1)?))
    };
    let driving = record.of("state").filter(|state| state.word("fallback_level") == "fresh plan");
    let errors: Vec<f64> = driving.filter_map(error).collect();
    assert!(errors.iter().any(|&error| error > 1.0), "it was far behind while it drove");
    assert!(errors.last().is_some_and(|&error| error < 0.2), "{errors:?}");
    Ok(())
}

#[test]
fn a_disarmed_robot_stands_until_a_person_arms_it() -> Outcome {
    let folder = home()?;
    let text = fs::read_to_string(graph_file("local"))?;
    let deploy = format!("\"{}/", repository().join("deploy").display());
    let graph = folder.path().join("graph.toml");
    fs::write(&graph, text.replace("\"../", &deploy).replace("armed = true", "armed = false"))?;
    let launched = launch(&graph, &circle()?, "", &["--duration", "600"])?;
    launched.told_a_person("`coxswain arm`")?;
    std::thread::sleep(Duration::from_secs(1));
    let (code, text) = order(&launched, "resume")?;
    assert!(code == Some(2) && text.contains("(gate)"), "{text}");
    let (code, text) = order(&launched, "arm")?;
    assert_eq!(code, Some(0), "{text}");
    let armed = tick_of(&text).ok_or("no tick in what arm says")?;
    std::thread::sleep(Duration::from_secs(1));
    let (_, record) = end(launched)?;
    for state in record.of("state").filter(|state| state.stamp("tick") <= armed) {
        assert_eq!(state.numbers("input"), [0.0; 3], "tick {}", state.stamp("tick"));
    }
    let drives = |state: &Message| state.word("fallback_level") == "fresh plan";
    assert!(record.of("state").any(|state| state.word("gate") == "driving" && drives(state)));
    Ok(())
}
