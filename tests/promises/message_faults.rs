//! Promise: with any fault in the messages of a link the wheels do nothing unsafe, and the robot
//! drives on afterwards.

use experiment::in_process;
use graph::assembly::Assembly;
use graph::options::Options;
use process::Pace;
use promises::oracle::{Limits, Rule, Violation, judge};
use promises::{Launched, Outcome, Record, repository};
use std::collections::BTreeMap;
use std::error::Error;
use std::fmt::Write;
use std::fs;
use std::path::Path;

/// The kinds, in the order of their windows, with their keys in real time and in lock step. The
/// last is for a learner that has all its points: a stuck model has as many numbers as the one that
/// it replaces.
const KINDS: [(&str, &str, &str); 10] = [
    ("drop", "", ""),
    ("duplicate", "", ""),
    ("delay", "millis = 60", "messages = 2"),
    ("jitter", "millis = 150", "messages = 3"),
    ("reorder", "", ""),
    ("corrupt", "", ""),
    ("truncate", "", ""),
    ("replay", "messages = 3", "messages = 3"),
    ("nan", "field = ", "field = "),
    ("freeze", "", ""),
];

/// First tick of a kind's window, and its length \[ticks\].
const WINDOW: (u64, u64) = (10, 10);
/// From window to window \[ticks\].
const STRIDE: u64 = 15;
/// Length of a run \[s\]: the last window ends 1.5 s before.
const DURATION: &str = "17";

/// A link, the end and the process where it is disturbed, and a field for NaN there.
type Place = (&'static str, &'static str, &'static str, &'static str);

/// Faults where a link is read.
const READERS: [Place; 4] = [
    ("command", "reader", "plant", "input"),
    ("state", "reader", "controller", "velocity"),
    ("residual", "reader", "learner", "velocity"),
    ("snapshot", "reader", "controller", "points"),
];

/// Faults where a link is written: all its readers receive the result, the recorder too.
const WRITERS: [Place; 2] =
    [("command", "writer", "controller", "input"), ("state", "writer", "plant", "velocity")];

/// Every kind in a window of its own.
fn faults_of(
    (topic, at, participant, field): Place,
    lock_step: bool,
) -> Result<String, std::fmt::Error> {
    let mut text = "seed = 7\n".to_owned();
    for ((kind, real_time_keys, lock_step_keys), index) in KINDS.into_iter().zip(0..) {
        let from = WINDOW.0 + STRIDE * index;
        let keys = if lock_step { lock_step_keys } else { real_time_keys };
        let keys = if kind == "nan" { format!("{keys}{field:?}") } else { keys.to_owned() };
        writeln!(
            text,
            "[[fault]]\ntopic = {topic:?}\nat = {at:?}\nparticipant = {participant:?}\n\
            kind = {kind:?}"
        )?;
        writeln!(
            text,
            "from_tick = {from}\nuntil_tick = {}\nprobability = 0.8\n{keys}",
            from + WINDOW.1
        )?;
    }
    Ok(text)
}

/// How often each fault was injected, by its place in the file, from the log of the process that
/// injected it.
fn injected(log: &Path) -> Result<BTreeMap<usize, u64>, Box<dyn Error>> {
    let mut injected = BTreeMap::new();
    for line in fs::read_to_string(log)?.lines().filter(|line| line.contains(" injected=")) {
        let number = |key: &str| {
            line.split_whitespace().find_map(|word| word.strip_prefix(key)?.parse::<u64>().ok())
        };
        *injected.entry(number("fault=").ok_or("no number")? as usize).or_default() +=
            number("injected=").ok_or("no count")?;
    }
    Ok(injected)
}

fn survives(place: Place, pace: &str) -> Outcome {
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("faults.toml");
    fs::write(&file, faults_of(place, pace == "lock-step")?)?;
    let launched = Launched::new(&[
        "--pace",
        pace,
        "--duration",
        DURATION,
        "--faults",
        &file.to_string_lossy(),
    ])?;
    let (ended, home) = launched.end()?;
    let (topic, _, participant, _) = place;
    assert!(ended.status.success(), "{topic} in {pace}: {}", ended.text);
    assert!(ended.text.contains("FAULTS ARE INJECTED"), "{}", ended.text);
    let run = home.path().join("run");
    let record = Record::read(&run)?;
    let limits = Limits::of(&Assembly::read(&Options::of_graph(
        &repository().join("deploy/graphs/local.toml"),
    ))?);
    // A stuck command acts at the plant, and differs from the published one that the recorder
    // received.
    let misquoted = place == READERS[0] && KINDS.last().is_some_and(|(kind, ..)| *kind == "freeze");
    let window = WINDOW.0 + STRIDE * (KINDS.len() as u64 - 1);
    let known = |found: &Violation| {
        misquoted
            && found.rule == Rule::AsCommanded
            && (window..=window + WINDOW.1 + 3).contains(&found.tick)
    };
    let violations: Vec<Violation> =
        judge(&record, &limits).into_iter().filter(|found| !known(found)).collect();
    assert_eq!(violations, [], "{topic} in {pace}");

    let injected = injected(&run.join(participant).with_extension("log"))?;
    for (index, (kind, ..)) in KINDS.iter().enumerate() {
        // In real time models arrive when they are ready, so that a window may end without two of
        // them.
        let rare = topic == "snapshot" && pace == "real-time";
        assert!(
            rare || injected.get(&index).is_some_and(|&count| count > 0),
            "{kind} of {topic} in {pace}: {injected:?}"
        );
    }
    assert!(injected.values().sum::<u64>() > 0, "{topic} in {pace}");

    if matches!(topic, "command" | "state") {
        // The gate has refused a command, or the robot has braked, and the oracle has found it.
        let braked = record.of("state").any(|state| state.word("fallback_level") == "brake");
        assert!(braked, "{topic} in {pace}: {}", record.summary);
    }
    let last = record.of("state").next_back().ok_or("no state")?;
    assert_eq!(
        (last.stamp("tick"), last.word("fallback_level")),
        (170, "fresh plan"),
        "{topic} in {pace}"
    );
    let versions: Vec<u64> =
        record.of("command").map(|command| command.count("model_version")).collect();
    assert!(
        versions.last() > versions.get(versions.len() / 2),
        "{topic} in {pace}: models go on being learnt and adopted"
    );
    Ok(())
}

#[test]
fn in_real_time_disturbed_commands_are_survived() -> Outcome {
    survives(READERS[0], "real-time")
}

#[test]
fn in_real_time_disturbed_states_are_survived() -> Outcome {
    survives(READERS[1], "real-time")
}

#[test]
fn in_real_time_disturbed_samples_and_models_are_survived() -> Outcome {
    survives(READERS[2], "real-time")?;
    survives(READERS[3], "real-time")
}

#[test]
fn in_real_time_links_that_are_disturbed_where_they_are_written_are_survived() -> Outcome {
    WRITERS.into_iter().try_for_each(|place| survives(place, "real-time"))
}

#[test]
fn in_lock_step_every_disturbed_link_is_survived() -> Outcome {
    READERS.into_iter().try_for_each(|link| survives(link, "lock-step"))
}

/// What a run commanded, by tick.
fn commands(run: &Path) -> Result<Vec<String>, Box<dyn Error>> {
    let record = Record::read(run)?;
    let commands = record
        .of("command")
        .map(|command| format!("{} {}", command.stamp("tick"), command.fields["input"]));
    Ok(commands.collect())
}

#[test]
fn in_lock_step_the_same_faults_give_the_same_bits_in_processes_and_in_one() -> Outcome {
    for place in READERS {
        let folder = tempfile::tempdir()?;
        let file = folder.path().join("faults.toml");
        fs::write(&file, faults_of(place, true)?)?;
        let options =
            ["--pace", "lock-step", "--duration", DURATION, "--faults", &file.to_string_lossy()];
        let (ended, home) = Launched::new(&options)?.end()?;
        assert!(ended.status.success(), "{}", ended.text);

        let mut options = Options::of_graph(&repository().join("deploy/graphs/local.toml"));
        (options.pace, options.faults, options.duration) =
            (Some(Pace::LockStep), Some(file), Some(DURATION.parse()?));
        let run = folder.path().join("run");
        fs::create_dir(&run)?;
        in_process::run(&Assembly::read(&options)?, &run)?;
        assert_eq!(commands(&home.path().join("run"))?, commands(&run)?, "{place:?}");
    }
    Ok(())
}
