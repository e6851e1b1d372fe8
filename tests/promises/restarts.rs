//! Promise: either end of the loop can be killed again and again, on one host and on two. Nothing
//! unsafe happens, and the loop recovers.

use graph::assembly::Assembly;
use graph::options::Options;
use promises::oracle::{Limits, acquit};
use promises::{
    Launched, Message, Outcome, Record, graph_file, graph_with, launch_command, signal,
};
use rustix::process::Signal;
use std::collections::{BTreeMap, BTreeSet};
use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Duration;

/// Kills of each end.
const KILLS: u32 = 20;
/// Most periods in a row in which a controller answers, and the robot is not on a fresh plan. The
/// time that a process needs to start depends on the load of the machine: the drill measures it.
const BACK_WITHIN: u64 = 10;

/// A graph like `name`, whose processes may die often.
fn patient(name: &str, home: &Path) -> Result<PathBuf, Box<dyn Error>> {
    let many = |role: &str| {
        format!(
            "[processes.{role}]\nrestarts_per_minute = 1000\n\
            back_off_millis = 0\nback_off_max_millis = 0\n"
        )
    };
    graph_with(name, &format!("{}{}", many("plant"), many("controller")), home)
}

/// `robot` and `control` are the directories of the hosts in the run's.
fn kill_both_ends_often(graph: &str, robot: &str, control: &str) -> Outcome {
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    let file = patient(graph, home.path())?;
    let command = launch_command(&file, &home.path().join("run"), &["--duration", "1000"])?;
    let launched = Launched::by(command, home)?;
    launched.wait_for_log(&format!("{control}controller"), "controller_epoch=", 1)?;
    // A seeded, even spread of moments within the periods.
    let mut random: u64 = 0x9e37_79b9_7f4a_7c15;
    for round in 0..2 * KILLS {
        random =
            random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        thread::sleep(Duration::from_millis(1_300 + (random >> 33) % 700));
        let program = if round % 2 == 0 { "controller" } else { "plant-sim" };
        let pid = launched.process(program, None)?;
        signal(pid, Signal::KILL)?;
        launched.process(program, Some(pid))?;
        let begun = 2 + round as usize / 2;
        launched.wait_for_log(&format!("{control}controller"), "controller_epoch=", begun)?;
    }
    thread::sleep(Duration::from_secs(2));
    signal(launched.pid(), Signal::TERM)?;
    let (ended, home) = launched.end()?;
    assert_eq!(ended.status.code(), Some(128 + 15), "{}", ended.text);
    let record = Record::read(&home.path().join("run").join(robot))?;
    acquit(&record, &Limits::of(&Assembly::read(&Options::of_graph(&graph_file(graph)))?))?;

    let mut fallback_levels: BTreeMap<u64, BTreeMap<u64, &str>> = BTreeMap::new();
    for state in record.of("state") {
        fallback_levels
            .entry(state.stamp("epoch"))
            .or_default()
            .insert(state.stamp("tick"), state.word("fallback_level"));
    }
    let controllers: BTreeSet<u64> =
        record.of("command").map(|command| command.stamp("epoch")).collect();
    assert_eq!(
        (fallback_levels.len() as u32, controllers.len() as u32),
        (KILLS + 1, KILLS + 1),
        "every kill was felt and mended"
    );
    let answered: BTreeSet<(u64, u64)> = record
        .of("command")
        .map(|command| (command.count("plant_epoch"), command.stamp("tick")))
        .collect();
    for (epoch, ticks) in &fallback_levels {
        assert!(ticks.values().any(|level| *level == "fresh plan"), "{graph}: epoch {epoch}");
        let mut below: u64 = 0;
        for (tick, fallback_level) in ticks {
            // The state of a tick reports the period before it.
            let is_answered = answered.contains(&(*epoch, tick.saturating_sub(1)));
            below =
                if *fallback_level == "fresh plan" { 0 } else { below + u64::from(is_answered) };
            assert!(
                below <= BACK_WITHIN,
                "{graph}: no fresh plan for {below} periods at tick {tick} of epoch {epoch}"
            );
        }
    }
    for controller in &controllers {
        let of = |command: &&Message| command.stamp("epoch") == *controller;
        let is_fresh = |command: &Message| command.word("fallback_level") == "fresh plan";
        assert!(record.of("command").filter(of).any(is_fresh), "{graph}: controller {controller}");
    }
    let last = fallback_levels.last_key_value().and_then(|(_, ticks)| ticks.last_key_value());
    assert_eq!(last.map(|(_, level)| *level), Some("fresh plan"), "{graph}: at the end");
    Ok(())
}

#[test]
fn over_shared_memory_both_ends_can_be_killed_again_and_again() -> Outcome {
    kill_both_ends_often("local", "", "")
}

#[test]
fn over_two_hosts_both_ends_can_be_killed_again_and_again() -> Outcome {
    kill_both_ends_often("two-hosts", "robot", "control/")
}

#[test]
fn a_process_killed_or_stopped_during_its_start_is_restarted_and_the_robot_drives() -> Outcome {
    for sent in [Signal::KILL, Signal::STOP] {
        let launched = Launched::new(&["--duration", "1000"])?;
        let mut struck = Vec::new();
        // In the order in which the launch waits for them.
        for program in ["recorder", "learner", "controller", "plant-sim"] {
            let pid = launched.process(program, None)?;
            signal(pid, sent)?;
            struck.push((program, pid));
            launched.process(program, Some(pid))?;
        }
        launched.wait_for_controller(1)?;
        thread::sleep(Duration::from_secs(2));
        signal(launched.pid(), Signal::TERM)?;
        let (ended, home) = launched.end()?;
        assert_eq!(ended.status.code(), Some(128 + 15), "{}", ended.text);
        let record = Record::read(&home.path().join("run"))?;
        assert_eq!(
            record.of("state").next_back().map(|state| state.word("fallback_level")),
            Some("fresh plan"),
            "{}",
            ended.text
        );
        let log = fs::read_to_string(home.path().join("run/coxswain.log"))?;
        // One that has been ready "died": the launcher logs the wait before its restart, too.
        let is_early = |line: &&str| {
            line.contains("WARN") && line.contains("ending=") && !line.contains("wait=")
        };
        let early = log.lines().filter(is_early).count();
        assert!(early > 0, "{sent:?}: nobody of {struck:?} was met before it was ready\n{log}");
    }
    Ok(())
}
