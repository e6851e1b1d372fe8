//! Promise: in lock step the commands are the same bits, in any number of processes and hosts.

use graph::assembly::Assembly;
use graph::options::Options;
use promises::{Launched, Outcome, Record, repository};
use std::error::Error;
use std::path::Path;

/// All commands of a run: tick, input, tail, model.
fn commands(folder: &Path) -> Result<Vec<String>, Box<dyn Error>> {
    let record = Record::read(folder)?;
    let of = |message: &promises::Message| {
        format!(
            "{} {} {} {} {}",
            message.stamp("tick"),
            message.fields["input"],
            message.fields["tail"],
            message.fields["model_version"],
            message.fields["fallback_level"]
        )
    };
    Ok(record.of("command").map(of).collect())
}

#[test]
fn three_runs_of_the_processes_and_one_in_a_single_process_command_the_same_bits() -> Outcome {
    let mut runs = Vec::new();
    for _ in 0..3 {
        let (ended, home) = Launched::new(&["--pace", "lock-step"])?.end()?;
        assert!(ended.status.success(), "{}", ended.text);
        runs.push(commands(&home.path().join("run"))?);
    }
    let folder = tempfile::tempdir()?;
    let mut assembly =
        Assembly::read(&Options::of_graph(&repository().join("deploy/graphs/local.toml")))?;
    assembly.graph.pace = process::Pace::LockStep;
    experiment::in_process::run(&assembly, folder.path())?;
    runs.push(commands(folder.path())?);

    let [first, others @ ..] = runs.as_slice() else { return Err("no runs".into()) };
    assert_eq!(first.len(), 251, "one command per state of 25 s at 100 ms");
    for (number, other) in others.iter().enumerate() {
        for (ours, theirs) in first.iter().zip(other) {
            assert_eq!(ours, theirs, "run {} differs", number + 2);
        }
        assert_eq!(first.len(), other.len());
    }
    Ok(())
}

#[test]
fn a_graph_on_several_hosts_commands_the_same_bits_as_on_one() -> Outcome {
    let run = |graph: &str, recorder: &str| -> Result<Vec<String>, Box<dyn Error>> {
        let (ended, home) =
            Launched::graph(graph, &["--pace", "lock-step", "--duration", "10"])?.end()?;
        assert!(ended.status.success(), "{graph}: {}", ended.text);
        commands(&home.path().join("run").join(recorder))
    };
    let alone = run("local", "")?;
    assert_eq!(alone.len(), 101);
    for graph in ["two-hosts", "three-hosts"] {
        assert_eq!(run(graph, "robot")?, alone, "{graph}");
    }
    Ok(())
}

#[test]
fn another_seed_commands_other_bits() -> Outcome {
    let mut runs = Vec::new();
    for seed in ["1", "2"] {
        let (ended, home) =
            Launched::new(&["--pace", "lock-step", "--duration", "2", "--seed", seed])?.end()?;
        assert!(ended.status.success(), "{}", ended.text);
        runs.push(commands(&home.path().join("run"))?);
    }
    assert_ne!(runs.first(), runs.last());
    Ok(())
}
