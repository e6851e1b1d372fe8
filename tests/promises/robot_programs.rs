//! Promise: the programs that run on a robot contain no fault injection, no certificate authority,
//! no terminal viewer and no experiments.

use promises::{Outcome, repository};
use std::collections::BTreeMap;
use std::error::Error;
use std::process::Command;

/// The programs, as in `deploy/systemd/README.md`.
const PROGRAMS: [&str; 7] =
    ["coxswain", "controller", "learner", "recorder", "gateway", "bridge", "plant-sim"];

/// Crates that only a workbench needs, of ours and of others.
const WORKBENCH: [&str; 6] = ["drill", "experiment", "certificates", "viewer", "rcgen", "ratatui"];

/// Each package that is linked into the programs, with its features.
fn packages(options: &[&str]) -> Result<BTreeMap<String, String>, Box<dyn Error>> {
    let programs = PROGRAMS.iter().flat_map(|program| ["--package", program]);
    let tree = Command::new(env!("CARGO"))
        .current_dir(repository())
        .args(["tree", "--locked", "--offline", "--edges", "normal", "--prefix", "none"])
        .args(["--format", "{p}|{f}"])
        .args(programs)
        .args(options)
        .output()?;
    if !tree.status.success() {
        return Err(String::from_utf8_lossy(&tree.stderr).into());
    }
    let line = |line: &str| {
        let (package, features) = line.split_once('|')?;
        Some((package.split(' ').next()?.to_owned(), features.to_owned()))
    };
    Ok(String::from_utf8(tree.stdout)?.lines().filter_map(line).collect())
}

/// What of it belongs to a workbench alone.
fn of_the_workbench(packages: &BTreeMap<String, String>) -> Vec<&str> {
    packages
        .iter()
        .filter(|(name, features)| {
            WORKBENCH.contains(&name.as_str())
                || features.split([',', ' ']).any(|feature| feature == "faults")
        })
        .map(|(name, _)| name.as_str())
        .collect()
}

#[test]
fn no_program_of_a_robot_contains_what_only_a_workbench_needs() -> Outcome {
    let packages = packages(&["--no-default-features"])?;
    assert!(PROGRAMS.iter().all(|&program| packages.contains_key(program)), "{packages:?}");
    assert_eq!(of_the_workbench(&packages), Vec::<&str>::new());
    Ok(())
}

/// So that the test above can fail.
#[test]
fn the_programs_of_a_workbench_contain_all_of_it() -> Outcome {
    let packages = packages(&[])?;
    let found = of_the_workbench(&packages);
    for name in WORKBENCH.into_iter().chain(["controller", "learner", "supervisor", "transport"]) {
        assert!(found.contains(&name), "{name} is not in {found:?}");
    }
    Ok(())
}
