//! Promise: after kill -9 of any process in mid-run no stale command acts on the wheels, the others
//! continue, and the killed process returns and is used again.

use graph::assembly::Assembly;
use graph::options::Options;
use promises::oracle::{Limits, acquit};
use promises::{Launched, Message, Outcome, Record, repository, signal};
use rustix::process::Signal;
use std::collections::BTreeSet;

/// Runs 12 s of the scenario in real time, kills `program` after 3 s, and reads the record.
fn kill_in_real_time(
    program: &str,
    back: (&str, &str, usize),
) -> Result<Record, Box<dyn std::error::Error>> {
    let launched = Launched::new(&["--duration", "12"])?;
    launched.wait_for_controller(1)?;
    launched.wait_for_log("controller", "version=5 ", 1)?;
    let pid = launched.process(program, None)?;
    signal(pid, Signal::KILL)?;
    launched.process(program, Some(pid))?;
    let (log, text, times) = back;
    launched.wait_for_log(log, text, times)?;
    let (ended, home) = launched.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    let record = Record::read(&home.path().join("run"))?;
    the_oracle_finds_nothing(&record)?;
    Ok(record)
}

fn the_oracle_finds_nothing(record: &Record) -> Outcome {
    let assembly =
        Assembly::read(&Options::of_graph(&repository().join("deploy/graphs/local.toml")))?;
    Ok(acquit(record, &Limits::of(&assembly))?)
}

fn epochs(record: &Record, topic: &str) -> BTreeSet<u64> {
    record.of(topic).map(|message| message.stamp("epoch")).collect()
}

fn last<'a>(record: &'a Record, topic: &'a str) -> &'a Message {
    record.of(topic).next_back().unwrap_or_else(|| unreachable!("nothing of {topic} was recorded"))
}

/// Asserts that no tick is missing between the first and the last of the last plant epoch.
fn no_tick_is_missing(record: &Record) {
    let epoch = last(record, "state").stamp("epoch");
    let ticks: BTreeSet<u64> = record
        .of("state")
        .filter(|state| state.stamp("epoch") == epoch)
        .map(|state| state.stamp("tick"))
        .collect();
    assert_eq!(ticks.len() as u64, ticks.last().map_or(0, |last| last + 1));
}

#[test]
fn a_killed_learner_returns_and_its_models_are_adopted_while_the_robot_drives_on() -> Outcome {
    let record = kill_in_real_time("learner", ("learner", "published version", 8))?;
    assert_eq!(epochs(&record, "snapshot").len(), 2, "two instances have published");
    assert_eq!(
        (epochs(&record, "command").len(), epochs(&record, "state").len()),
        (1, 1),
        "nobody else was restarted"
    );
    let versions: Vec<u64> =
        record.of("snapshot").map(|snapshot| snapshot.count("version")).collect();
    assert!(versions.is_sorted(), "versions go on counting: {versions:?}");
    let in_use = last(&record, "command").count("model_version");
    let second = epochs(&record, "snapshot").into_iter().next_back().unwrap_or(0);
    let learnt_after: Vec<u64> = record
        .of("snapshot")
        .filter(|snapshot| snapshot.stamp("epoch") == second)
        .map(|snapshot| snapshot.count("version"))
        .collect();
    assert!(
        learnt_after.contains(&in_use),
        "version {in_use} in use, {learnt_after:?} of the second learner"
    );
    no_tick_is_missing(&record);
    Ok(())
}

#[test]
fn a_killed_recorder_returns_with_a_second_segment_while_the_robot_drives_on() -> Outcome {
    let record = kill_in_real_time("recorder", ("recorder", "started", 2))?;
    assert_eq!(record.summary["segments"], 2);
    assert_eq!(
        (epochs(&record, "command").len(), epochs(&record, "state").len()),
        (1, 1),
        "nobody else was restarted"
    );
    assert_eq!(last(&record, "state").stamp("tick"), 120, "recorded to the end");
    Ok(())
}

#[test]
fn a_killed_controller_is_succeeded_by_a_higher_epoch_and_the_gate_bridges_the_gap() -> Outcome {
    let record = kill_in_real_time("controller", ("controller", "controller_epoch=", 2))?;
    assert_eq!(epochs(&record, "state").len(), 1, "the plant goes on");
    assert_eq!(epochs(&record, "command").len(), 2);
    let mut acting: Vec<u64> = record
        .of("truth")
        .map(|truth| truth.count("acting_epoch"))
        .filter(|&epoch| epoch > 0)
        .collect();
    assert!(acting.is_sorted(), "an old epoch acted after a newer one");
    acting.dedup();
    assert_eq!(acting.len(), 2, "both controllers have driven: {acting:?}");
    assert_eq!(
        last(&record, "state").word("fallback_level"),
        "fresh plan",
        "the second one drives to the end"
    );
    assert!(last(&record, "command").count("model_version") > 0, "it has a learned model again");
    no_tick_is_missing(&record);
    Ok(())
}

#[test]
fn a_killed_plant_restarts_at_the_scenarios_start_and_is_driven_again() -> Outcome {
    let record = kill_in_real_time("plant-sim", ("controller", "controller_epoch=", 2))?;
    assert_eq!(epochs(&record, "state").len(), 2);
    assert_eq!(epochs(&record, "command").len(), 1, "the controller goes on");
    let second = last(&record, "state").stamp("epoch");
    for command in record.of("command").filter(|command| command.count("plant_epoch") == second) {
        assert!(command.stamp("tick") <= 120);
    }
    let first_of_second = record
        .of("truth")
        .find(|truth| truth.stamp("epoch") == second)
        .ok_or("no truth of the second plant")?;
    assert_eq!(
        (first_of_second.stamp("tick"), first_of_second.numbers("velocity")),
        (0, vec![0.0; 3])
    );
    assert_eq!(last(&record, "state").word("fallback_level"), "fresh plan");
    no_tick_is_missing(&record);
    Ok(())
}

#[test]
fn in_lock_step_the_clock_waits_for_a_killed_process() -> Outcome {
    for program in ["learner", "recorder", "controller", "plant-sim"] {
        let launched = Launched::new(&["--pace", "lock-step", "--duration", "100"])?;
        launched.wait_for_log("controller", "version=5 ", 1)?;
        let pid = launched.process(program, None)?;
        signal(pid, Signal::KILL)?;
        let (ended, home) = launched.end()?;
        assert!(ended.status.success(), "{program}: {}", ended.text);
        let record = Record::read(&home.path().join("run"))?;
        assert_eq!(last(&record, "state").stamp("tick"), 1000, "{program}");
        assert_eq!(
            record.summary["fallback_levels"]["fresh plan"], record.summary["periods"],
            "{program}: {}",
            record.summary
        );
        the_oracle_finds_nothing(&record)?;
    }
    Ok(())
}

#[test]
fn in_lock_step_a_learner_that_dies_before_its_first_model_does_not_stop_the_clock_for_good()
-> Outcome {
    let launched = Launched::new(&["--pace", "lock-step", "--duration", "20"])?;
    signal(launched.process("learner", None)?, Signal::KILL)?;
    let (ended, home) = launched.end()?;
    // Killed before it was ready, it ends the run with its name. Killed later, it is restarted and
    // the run goes to its end.
    if ended.status.success() {
        let record = Record::read(&home.path().join("run"))?;
        assert_eq!(last(&record, "state").stamp("tick"), 200);
    } else {
        assert!(ended.text.contains("learner"), "{}", ended.text);
    }
    Ok(())
}
