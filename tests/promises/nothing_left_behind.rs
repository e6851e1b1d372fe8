//! Promise: after any end of a graph nothing of it remains: no process, no shared memory, no
//! socket.

use promises::{Launched, Outcome, Reader, binaries, lives, shared_memory_of, signal, wait_until};
use rustix::process::Signal;
use std::fs;
use std::path::Path;
use std::process::Command;

/// Files in a launch's home beside the run's own folder.
fn left_in(home: &Path) -> Vec<String> {
    let entries = fs::read_dir(home).into_iter().flatten().flatten();
    entries
        .filter_map(|entry| entry.file_name().into_string().ok())
        .filter(|name| name != "run")
        .collect()
}

#[test]
fn a_run_that_is_interrupted_ends_cleanly_with_a_summary() -> Outcome {
    for (interruption, code) in [(Signal::INT, 130), (Signal::TERM, 143)] {
        let launched = Launched::new(&[])?;
        launched.wait_for_controller(1)?;
        let (name, processes) = (launched.graph_name()?, launched.processes());
        assert_eq!(processes.len(), 5);
        signal(launched.pid(), interruption)?;
        let (ended, home) = launched.end()?;
        assert_eq!(ended.status.code(), Some(code), "{}", ended.text);
        assert!(home.path().join("run/summary.json").is_file(), "{}", ended.text);
        assert!(processes.iter().all(|&pid| !lives(pid)));
        assert_eq!(shared_memory_of(&[name]), Vec::<String>::new());
        assert_eq!(left_in(home.path()), Vec::<String>::new());
    }
    Ok(())
}

#[test]
fn a_command_that_waits_for_a_goal_ends_with_the_launch_and_leaves_nothing() -> Outcome {
    let launched = Launched::new(&["--scenario", "goals"])?;
    launched.wait_for_controller(1)?;
    let name = launched.graph_name()?;
    let mut go = Command::new(binaries()?.join("coxswain"));
    go.args(["go", "50", "0", "0"]).env("TMPDIR", launched.home());
    let mut go = Reader::start(&mut go)?;
    go.lines(1)?; // it has been accepted
    signal(launched.pid(), Signal::TERM)?;
    let (ended, home) = launched.end()?;
    assert_eq!(ended.status.code(), Some(143), "{}", ended.text);
    assert_eq!(go.end()?.code(), Some(1), "{}", go.errors());
    assert_eq!(shared_memory_of(&[name]), Vec::<String>::new());
    assert_eq!(left_in(home.path()), Vec::<String>::new());
    Ok(())
}

#[test]
fn two_graphs_run_at_the_same_time_without_exchanging_messages() -> Outcome {
    let options = |seed| ["--pace", "lock-step", "--duration", "5", "--seed", seed];
    let (one, other) = (Launched::new(&options("1"))?, Launched::new(&options("2"))?);
    for launched in [one, other] {
        let (ended, home) = launched.end()?;
        assert!(ended.status.success(), "{}", ended.text);
        let record = promises::Record::read(&home.path().join("run"))?;
        let mut writers: Vec<u64> = record.of("state").map(|state| state.stamp("writer")).collect();
        writers.dedup();
        assert_eq!(writers.len(), 1, "states of two plants in one record");
        assert_eq!(record.of("state").count(), 51);
    }
    Ok(())
}

#[test]
fn a_launcher_that_is_killed_leaves_no_orphans_and_the_next_one_sweeps() -> Outcome {
    let launched = Launched::new(&[])?;
    launched.wait_for_controller(1)?;
    let (name, processes) = (launched.graph_name()?, launched.processes());
    signal(launched.pid(), Signal::KILL)?;
    wait_until("the end of the orphans", || processes.iter().all(|&pid| !lives(pid)))?;
    let (_, home) = launched.end()?;
    fs::rename(home.path().join("run"), home.path().join("first"))?;
    let (ended, home) =
        Launched::at_home(home, &["--pace", "lock-step", "--duration", "1"])?.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    assert_eq!(shared_memory_of(&[name]), Vec::<String>::new());
    assert_eq!(left_in(home.path()), ["first"]);
    Ok(())
}

#[test]
fn after_everything_was_killed_at_once_the_next_launch_drives() -> Outcome {
    let launched = Launched::new(&[])?;
    launched.wait_for_controller(1)?;
    let (name, processes) = (launched.graph_name()?, launched.processes());
    signal(launched.pid(), Signal::KILL)?;
    for &pid in &processes {
        let _ = signal(pid, Signal::KILL);
    }
    wait_until("the end of all", || processes.iter().all(|&pid| !lives(pid)))?;
    assert_ne!(
        shared_memory_of(std::slice::from_ref(&name)),
        Vec::<String>::new(),
        "killed processes cannot have cleaned up"
    );
    let (_, home) = launched.end()?;
    fs::rename(home.path().join("run"), home.path().join("first"))?;
    let (ended, home) =
        Launched::at_home(home, &["--pace", "lock-step", "--duration", "1"])?.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    assert_eq!(shared_memory_of(&[name]), Vec::<String>::new());
    assert_eq!(left_in(home.path()), ["first"]);
    Ok(())
}
