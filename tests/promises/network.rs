//! Promise: the graph drives across two and three hosts as it does on one, and through cuts.

use graph::assembly::Assembly;
use graph::options::Options;
use process::{Gap, Witness};
use promises::oracle::{Limits, acquit};
use promises::{Hosts, Launched, Outcome, Record, graph_file, launch_command, signal, sweep_after};
use rustix::process::Signal;
use std::error::Error;
use std::thread;
use std::time::Duration;

/// Longest time until a fresh plan, once the cable is connected again \[s\].
const BACK_WITHIN_S: f64 = 2.0;
/// How long the cable is disconnected.
const CUT: Duration = Duration::from_secs(3);

/// Good periods after which the gate ends a brake.
const ENDS_A_BRAKE: usize = 3;

/// Periods below a fresh plan in which, by `gaps`, the machine ran all threads that were ready.
/// Each with its fallback level.
fn unexplained(record: &Record, gaps: &[Gap]) -> Vec<String> {
    let states: Vec<_> = record.of("state").collect();
    let sent = |at: usize| states[at].stamp("sent_nanos");
    // The state with a fallback level follows its period, which began with the state before. The
    // process that should have answered that state may have been late already. A brake goes on in
    // the good periods before its end.
    let is_explained = |at: usize, level: &str| {
        let before = if level == "brake" { 2 + ENDS_A_BRAKE } else { 2 };
        let (begin, end) = (sent(at.saturating_sub(before)), sent(at));
        gaps.iter().any(|gap| gap.from_nanos < end && begin < gap.to_nanos)
    };
    (2..states.len())
        .map(|at| (at, states[at].word("fallback_level")))
        .filter(|&(at, level)| {
            !matches!(level, "fresh plan" | "waiting") && !is_explained(at, level)
        })
        .map(|(at, level)| format!("{level} at tick {}", states[at].stamp("tick")))
        .collect()
}

/// Drives in real time on fresh plans alone, except for periods in which the machine ran no thread.
fn drive(graph: &str, scenario: &str, duration: &str) -> Outcome {
    let witness = Witness::begin();
    let (ended, home) =
        Launched::graph(graph, &["--scenario", scenario, "--duration", duration])?.end()?;
    let gaps = witness.end();
    assert!(ended.status.success(), "{graph}: {}", ended.text);
    let record = Record::read(&home.path().join("run/robot"))?;
    let options =
        Options { scenario: Some(scenario.into()), ..Options::of_graph(&graph_file(graph)) };
    acquit(&record, &Limits::of(&Assembly::read(&options)?))?;
    let unexplained = unexplained(&record, &gaps);
    assert!(unexplained.is_empty(), "{graph} {scenario}: {unexplained:?} in {}", record.summary);
    assert!(record.summary["snapshots_adopted"].as_u64() > Some(0), "{graph}: {}", record.summary);
    Ok(())
}

#[test]
fn in_real_time_no_period_is_below_a_fresh_plan_but_by_the_machine_at_100_ms() -> Outcome {
    drive("two-hosts", "paper", "10")?;
    drive("three-hosts", "paper", "5")
}

#[test]
fn in_real_time_no_period_is_below_a_fresh_plan_but_by_the_machine_at_20_ms() -> Outcome {
    drive("two-hosts", "paper-20ms", "8")
}

#[test]
fn two_hosts_drive_together_and_survive_a_cable_that_is_pulled() -> Outcome {
    let hosts = Hosts::new()?;
    let home = || tempfile::Builder::new().prefix("cx").tempdir_in("/tmp");
    let graph = graph_file("two-hosts");
    let launch = |name: &str, address: &str, host| -> Result<Launched, Box<dyn Error>> {
        let home = home()?;
        let options = ["--insecure", "--host", name, "--address", address, "--duration", "20"];
        let command = launch_command(&graph, &home.path().join("run"), &options)?;
        Launched::by(hosts.on(host, command), home)
    };
    let control = launch("control", &format!("robot={}", hosts.far_address()), 1)?;
    control.wait_for_log("controller", "settings=", 1)?;
    let plant = launch("robot", &format!("control={}", hosts.address()), 0)?;
    control.wait_for_log("controller", "version=5 ", 1)?;

    hosts.pull_cable()?;
    thread::sleep(CUT);
    hosts.plug_cable()?;

    let (plant_ended, home) = plant.end()?;
    assert!(plant_ended.status.success(), "{}", plant_ended.text);
    let (ended, _) = control.end()?;
    assert!(ended.status.success(), "the controllers' launch ends with the plant: {}", ended.text);

    let record = Record::read(&home.path().join("run"))?;
    acquit(&record, &Limits::of(&Assembly::read(&Options::of_graph(&graph))?))?;
    let fallback_levels: Vec<(u64, &str)> = record
        .of("state")
        .map(|state| (state.stamp("tick"), state.word("fallback_level")))
        .collect();
    let driving = fallback_levels
        .iter()
        .position(|(_, fallback_level)| *fallback_level == "fresh plan")
        .ok_or("no period is on a fresh plan")?;
    let cut = driving
        + fallback_levels
            .iter()
            .skip(driving)
            .position(|(_, fallback_level)| *fallback_level != "fresh plan")
            .ok_or("the cut was not felt")?;
    let back = cut
        + fallback_levels
            .iter()
            .skip(cut)
            .position(|(_, fallback_level)| *fallback_level == "fresh plan")
            .ok_or("no fresh plan after the cut")?;
    let out: Vec<&str> = fallback_levels
        .iter()
        .take(back)
        .skip(cut)
        .map(|(_, fallback_level)| *fallback_level)
        .collect();
    assert!(
        out.iter().take_while(|fallback_level| **fallback_level == "stored tail").count() <= 3,
        "the tail is short: {out:?}"
    );
    assert!(
        out.iter().filter(|fallback_level| **fallback_level == "brake").count() >= 20,
        "most of the cut is spent on the brake: {out:?}"
    );
    let silent = (back - cut) as f64 * 0.1;
    assert!(
        silent <= CUT.as_secs_f64() + BACK_WITHIN_S,
        "driving again after {silent:.1} s: {out:?}"
    );
    assert!(
        fallback_levels
            .iter()
            .skip(back)
            .all(|(_, fallback_level)| *fallback_level == "fresh plan"),
        "{fallback_levels:?}\n{}",
        plant_ended.text
    );
    assert_eq!(fallback_levels.last().map(|(tick, _)| *tick), Some(200));
    Ok(())
}

/// Launches of the three hosts, as on machines of their own.
fn three_hosts() -> Result<[Launched; 3], Box<dyn Error>> {
    let ports = [(); 3].map(|()| std::net::TcpListener::bind("127.0.0.1:0"));
    let mut addresses = Vec::new();
    for port in &ports {
        let port = port.as_ref().map_err(ToString::to_string)?.local_addr()?.port();
        addresses.push(format!("127.0.0.1:{port}"));
    }
    // Another program may take one of them first; then the test fails.
    drop(ports);
    let launch = |host: &str, others: [(&str, usize); 2]| -> Result<Launched, Box<dyn Error>> {
        let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
        let addresses = others.map(|(other, index)| format!("{other}={}", addresses[index]));
        let [first, second] = &addresses;
        let options = ["--host", host, "--address", first, "--address", second, "--duration", "20"];
        let graph = graph_file("three-hosts");
        Launched::by(launch_command(&graph, &home.path().join("run"), &options)?, home)
    };
    Ok([
        launch("robot", [("control", 0), ("training", 2)])?,
        launch("control", [("robot", 0), ("training", 1)])?,
        launch("training", [("control", 1), ("robot", 2)])?,
    ])
}

#[test]
fn of_three_hosts_the_one_that_learns_can_disappear() -> Outcome {
    let [robot, control, training] = three_hosts()?;
    control.wait_for_log("controller", "version=3 ", 1)?;
    signal(training.pid(), Signal::KILL)?;
    let (ended, home) = robot.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    let record = Record::read(&home.path().join("run"))?;
    let options = Options::of_graph(&graph_file("three-hosts"));
    acquit(&record, &Limits::of(&Assembly::read(&options)?))?;
    let levels: Vec<&str> = record.of("state").map(|state| state.word("fallback_level")).collect();
    let fresh = levels.iter().filter(|level| **level == "fresh plan").count();
    assert!(
        fresh * 10 >= levels.len() * 8,
        "{fresh} of {} periods on fresh plans\n{}",
        levels.len(),
        ended.text
    );
    assert_eq!(levels.last(), Some(&"fresh plan"));
    let (ended, _) = control.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    sweep_after(training.home())
}
