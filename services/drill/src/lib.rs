//! `coxswain drill`: injects real faults into every part, and judges their effect at the wheels.
//!
//! | file        | what it holds                                                     |
//! |-------------|-------------------------------------------------------------------|
//! | `catalogue` | the exercises: which faults, in which process, and what must hold |
//! | `turns`     | when each exercise runs, and beside which others                  |
//! | `exercise`  | runs one exercise and judges it                                   |
//! | `rivals`    | two controllers of one robot                                      |
//! | `launchers` | two launches of one robot                                         |
//! | `goals`     | planners, and the goals that they give                            |
//! | `emergency_stop` | an emergency stop that is pressed while the robot drives     |
//! | `appearing` | obstacles that appear on and around the robot                     |
//! | `serial_base` | a base at a serial port: driver, firmware and cable fail        |
//! | `firmware`  | its simulated firmware, and the judge of its motors               |
//! | `between`   | hosts between which something fails for a time                    |
//! | `ground`    | what all exercises share, and the twin runs without faults        |
//! | `tracking`  | record → how far the robot was from its reference                 |
//! | `session`   | a graph that the drill launches                                   |
//! | `hosts`     | two hosts and a cable                                             |
//! | `damage`    | damaged messages for the readers of all topics and the gate       |
//! | `record`    | what a run recorded                                               |
//! | `oracle`    | record → what was unsafe                                          |
//! | `refusals`  | what was injected ↔ what was rejected                             |
//! | `measure`   | record → reaction times, restart times, and other violations      |
//! | `table`     | rows → the table that is printed                                  |

mod appearing;
mod between;
pub mod catalogue;
pub mod damage;
mod emergency_stop;
mod exercise;
pub mod firmware;
mod goals;
mod ground;
pub mod hosts;
mod launchers;
pub mod measure;
pub mod oracle;
pub mod port;
pub mod record;
mod refusals;
mod rivals;
mod serial_base;
mod session;
mod table;
pub mod tracking;
mod turns;

use catalogue::{Carrier, Exercise, Extent, Task, exercises};
use clap::builder::PossibleValuesParser;
use graph::assembly::missing_programs;
use graph::role::{START_ORDER, program};
use ground::Ground;
use measure::Measured;
use process::{Stop, may_go_first};
use runs::utc::utc;
use serde::Serialize;
use session::INTERRUPTED;
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::mpsc;
use std::thread;
use std::time::{Instant, SystemTime};
use terminal::Terminal;
use turns::Turns;

/// Options of `coxswain drill`.
#[derive(Debug, Clone, clap::Args)]
pub struct DrillOptions {
    /// Run a short form of every exercise.
    #[arg(long)]
    pub quick: bool,
    /// Run only the exercises of this fault; may be repeated.
    #[arg(long = "fault", value_name = "NAME", value_parser = PossibleValuesParser::new(known()))]
    pub faults: Vec<String>,
    /// Seed of phases, choices and damage; the same seed repeats the same drill.
    #[arg(
        long,
        value_name = "N",
        default_value_t = 1,
        value_parser = clap::value_parser!(u64).range(0..=i64::MAX as u64)
    )]
    pub seed: u64,
    /// Write one JSON row per exercise to this file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Keep all files of each exercise that found a violation here, one folder per drill.
    #[arg(long, value_name = "DIR", default_value = "runs/drill")]
    pub keep: PathBuf,
    /// Folder with robots and scenarios.
    #[arg(long, value_name = "DIR", default_value = "deploy")]
    pub deploy: PathBuf,
    /// Number of exercises that run at the same time.
    #[arg(
        long,
        value_name = "N",
        default_value_t = 6,
        value_parser = clap::value_parser!(u64).range(1..=64)
    )]
    pub jobs: u64,
}

/// Result of one exercise.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Name of the fault.
    pub fault: &'static str,
    /// The process or the link that the fault affects.
    pub target: &'static str,
    /// Carrier of the links.
    pub carrier: Carrier,
    /// Number of injected faults.
    pub injections: u64,
    /// Number of violations.
    pub violations: usize,
    /// Age of the oldest state whose answer acted on the wheels \[T\].
    pub worst_reaction_periods: Option<f64>,
    /// Longest time from the end of a process to its successor in use \[s\].
    pub worst_restart_s: Option<f64>,
    /// Largest distance from the reference, as a share of its bound.
    pub tracking_share: Option<f64>,
    /// Seed that repeats this exercise.
    pub seed: u64,
    /// Periods below a fresh plan in which the machine let no process run.
    pub excused_periods: usize,
    /// Why the exercise cannot be done on this machine.
    pub impossible: Option<&'static str>,
    /// Other measurements, one sentence each.
    pub notes: Vec<String>,
    /// The violations, as text.
    pub found: Vec<String>,
    /// Folder with all files of the exercise; only if there was a violation.
    pub kept: Option<PathBuf>,
}

/// Why the drill was not done.
#[derive(Debug, thiserror::Error)]
pub enum DrillError {
    /// The quick drill, or the whole drill, has no exercise of this fault.
    #[error(
        "--fault {name:?} is only in the {} drill: expected it {} --quick",
        if *quick { "whole" } else { "quick" },
        if *quick { "without" } else { "with" }
    )]
    Elsewhere {
        /// The requested fault.
        name: String,
        /// Whether the fault is in the quick drill.
        quick: bool,
    },
    /// The file for the rows cannot be created.
    #[error("--json {}: {source}", path.display())]
    Json {
        /// Path of the file.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// The folder has no robots and scenarios.
    #[error(
        "--deploy {}: expected the folder deploy of the sources, with robots/ and scenarios/",
        folder.display()
    )]
    NoDeploy {
        /// The folder that was searched.
        folder: PathBuf,
    },
    /// A binary that the drill starts is missing.
    #[error(
        "{} not found in {}: build it with `cargo build --release --workspace`",
        programs.join(", "),
        folder.display()
    )]
    MissingPrograms {
        /// The missing programs.
        programs: Vec<String>,
        /// The folder that was searched.
        folder: PathBuf,
    },
    /// A file cannot be used.
    #[error("{}: {source}", path.display())]
    File {
        /// Path of the file.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// A signal interrupted the drill.
    #[error("{INTERRUPTED}; the rows contain the finished exercises")]
    Interrupted,
}

impl DrillError {
    /// 2 if a setting of the user prevented the start, else 1.
    pub fn exit_code(&self) -> ExitCode {
        match self {
            Self::Elsewhere { .. } | Self::Json { .. } | Self::NoDeploy { .. } => ExitCode::from(2),
            _ => ExitCode::FAILURE,
        }
    }
}

/// Runs the exercises, shows progress, writes the rows and prints the table.
///
/// Returns whether no exercise found a violation.
///
/// # Errors
/// [`DrillError`]; no exercise runs if a setting is impossible.
pub fn run(options: &DrillOptions) -> Result<bool, DrillError> {
    let chosen = chosen(options)?;
    check(&options.deploy, &chosen)?;
    let mut json =
        options.json.as_deref().map(|path| create(path).map(|file| (path, file))).transpose()?;
    let stop = Stop::new();
    stop.on_signals().map_err(|source| DrillError::File { path: "signals".into(), source })?;
    let mut terminal = Terminal::new();
    let kept = options.keep.join(format!("{}-seed-{}", utc(SystemTime::now()), options.seed));
    let ground = Ground::new(&options.deploy);
    let mut rows = Vec::new();
    let begin = Instant::now();
    let turns = Turns::new(&chosen);
    thread::scope(|scope| {
        let (done, finished) = mpsc::channel();
        for worker in 0..options.jobs {
            let (done, turns, chosen, kept, stop) = (done.clone(), &turns, &chosen, &kept, &stop);
            let ground = &ground;
            scope.spawn(move || {
                while let Some((index, _machine)) = turns.next(worker) {
                    let Some(exercise) = chosen.get(index) else { return };
                    let kept = kept.join(folder_name(index, exercise));
                    let row = (!stop.requested())
                        .then(|| do_one(exercise, ground, options.seed, &kept, stop));
                    // An interrupted exercise has no valid result.
                    let Some(row) = row.filter(|_| !stop.requested()) else { return };
                    if done.send((index, row)).is_err() {
                        return;
                    }
                }
            });
        }
        drop(done);
        for (index, row) in finished {
            for found in row.found.iter().take(5) {
                terminal.say(format_args!(
                    "{} of {} over {}: {found}",
                    row.fault,
                    row.target,
                    row.carrier.name()
                ));
            }
            if let Some((path, file)) = &mut json {
                let line = serde_json::to_string(&row).map_err(io::Error::other);
                line.and_then(|line| writeln!(file, "{line}"))
                    .map_err(|source| DrillError::File { path: path.to_path_buf(), source })?;
            }
            rows.push((index, row));
            let line = format!(
                "{} of {} exercises, {:.0} s",
                rows.len(),
                chosen.len(),
                begin.elapsed().as_secs_f64()
            );
            terminal.progress(Instant::now(), || Some(line));
        }
        Ok(())
    })?;
    rows.sort_by_key(|(index, _)| *index);
    let rows: Vec<Row> = rows.into_iter().map(|(_, row)| row).collect();
    terminal::print(table::render(&rows, may_go_first()));
    if stop.requested() {
        return Err(DrillError::Interrupted);
    }
    Ok(rows.iter().all(|row| row.violations == 0))
}

fn chosen(options: &DrillOptions) -> Result<Vec<Exercise>, DrillError> {
    let extent = if options.quick { Extent::Quick } else { Extent::Whole };
    let together = exercises(extent, false);
    if options.faults.is_empty() {
        return Ok(together);
    }
    let mut chosen: Vec<Exercise> = Vec::new();
    for exercise in together.into_iter().chain(exercises(extent, true)) {
        if options.faults.iter().any(|name| name == exercise.fault) && !chosen.contains(&exercise) {
            chosen.push(exercise);
        }
    }
    match options
        .faults
        .iter()
        .find(|name| chosen.iter().all(|exercise| exercise.fault != name.as_str()))
    {
        Some(name) => Err(DrillError::Elsewhere { name: name.clone(), quick: options.quick }),
        None => Ok(chosen),
    }
}

/// The names of all faults.
fn known() -> BTreeSet<&'static str> {
    let all =
        [Extent::Quick, Extent::Whole].into_iter().flat_map(|extent| exercises(extent, false));
    all.map(|exercise| exercise.fault).collect()
}

/// Checks that the files and programs of an exercise are present.
fn check(deploy: &Path, chosen: &[Exercise]) -> Result<(), DrillError> {
    if !deploy.join("robots/mecanum.toml").is_file() || !deploy.join("scenarios").is_dir() {
        return Err(DrillError::NoDeploy { folder: deploy.to_path_buf() });
    }
    let own = std::env::current_exe().map_err(|source| DrillError::File {
        path: "the path of the drill program".into(),
        source,
    })?;
    let folder = own.parent().unwrap_or(Path::new("")).to_path_buf();
    let has_port = chosen.iter().any(|one| matches!(one.task, Task::SerialBase(..)));
    let at_port = [firmware::DRIVER, firmware::PROGRAM].into_iter().filter(|_| has_port);
    let needed = START_ORDER.into_iter().map(program).chain(at_port).map(Path::new);
    let programs = missing_programs(needed, &folder);
    if programs.is_empty() { Ok(()) } else { Err(DrillError::MissingPrograms { programs, folder }) }
}

fn create(path: &Path) -> Result<File, DrillError> {
    File::create(path).map_err(|source| DrillError::Json { path: path.to_path_buf(), source })
}

fn folder_name(index: usize, exercise: &Exercise) -> String {
    let Exercise { fault, target, carrier, .. } = exercise;
    format!("{index:02} {fault} {target} {}", carrier.name()).replace([' ', '/'], "-")
}

fn do_one(exercise: &Exercise, ground: &Ground, seed: u64, kept: &Path, stop: &Stop) -> Row {
    let measured = exercise::run(exercise, ground, seed, kept, stop);
    let Measured {
        injections,
        violations,
        worst_reaction,
        worst_restart,
        excused,
        tracking,
        impossible,
        notes,
    } = measured.unwrap_or_else(Measured::not_done);
    Row {
        fault: exercise.fault,
        target: exercise.target,
        carrier: exercise.carrier,
        injections,
        violations: violations.len(),
        worst_reaction_periods: worst_reaction,
        worst_restart_s: worst_restart,
        tracking_share: tracking,
        seed,
        excused_periods: excused,
        impossible,
        notes,
        kept: (!violations.is_empty()).then(|| kept.to_path_buf()).filter(|kept| kept.is_dir()),
        found: violations,
    }
}
