//! `coxswain set`: a change to the settings of a robot that drives.
//!
//! What is to be changed is said as on a command line, and asked of the process that it belongs to; whether it can be, that process alone
//! decides, and says ([`process::requests`]).

use crate::fleet::settings_file;
use crate::registry::{self, GraphEntry};
use crate::terminal;
use clap::Args;
use process::requests::{AskError, Outcome, Request, Settled, ask};
use protocol::message::Participant;
use settings::change::{Change, ChangeError};
use std::env;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};
use toml::Value;

/// How long an answer may take. A process that is started again meanwhile answers when it is back.
const PATIENCE: Duration = Duration::from_secs(15);

/// What to change, and of which run.
#[derive(Debug, Clone, Args)]
pub struct SetOptions {
    /// Dotted keys as in the scenario file, with their new values: one change, of which everything is applied or nothing.
    ///
    /// `none` takes a limit away. A word needs no quotes; anything else is written as in the file.
    #[arg(required = true, value_name = "KEY=VALUE")]
    pub changes: Vec<String>,
    /// The folder of the run; by default that of the launch that runs on this machine.
    #[arg(long, value_name = "DIR")]
    pub run: Option<PathBuf>,
}

/// Nothing was set.
#[derive(Debug, thiserror::Error)]
pub enum SetError {
    /// No key, or no value.
    #[error("{said:?}: expected KEY=VALUE, as in mpc.weights.position=20")]
    NoPair {
        /// What was said.
        said: String,
    },
    /// It cannot be understood.
    #[error(transparent)]
    Change(#[from] ChangeError),
    /// Two processes would have to change at once.
    #[error("learner.* and other keys belong to different processes: set them one after the other")]
    TwoProcesses,
    /// There is no launch.
    #[error("no launch runs on this machine")]
    NothingRuns,
    /// There are several launches.
    #[error("several launches run on this machine; say which: {}", alternatives(runs))]
    SeveralRun {
        /// Their folders.
        runs: Vec<PathBuf>,
    },
    /// There is no such launch.
    #[error("--run {}: no launch runs there", run.display())]
    NotRunning {
        /// What was said.
        run: PathBuf,
    },
    /// The process is not one of this launch.
    #[error("this launch has no {role}: it takes orders on the machine where it runs")]
    Elsewhere {
        /// Who.
        role: Participant,
    },
    /// The request could not be written.
    #[error(transparent)]
    Ask(#[from] AskError),
    /// The process looked at it, and did not do it.
    #[error("the {role} refuses: {reason}")]
    Refused {
        /// Who.
        role: Participant,
        /// Why.
        reason: String,
    },
    /// The launch has ended meanwhile.
    #[error("the launch has ended, and nothing was changed")]
    Ended,
    /// Nobody said anything.
    #[error("the {role} has not answered for {PATIENCE:?}; it takes the change up when it is back")]
    NoAnswer {
        /// Who.
        role: Participant,
    },
}

impl SetError {
    /// 2 if what a person said cannot be, else 1.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::NothingRuns
            | Self::Elsewhere { .. }
            | Self::Ask(_)
            | Self::Ended
            | Self::NoAnswer { .. } => 1,
            _ => 2,
        }
    }
}

/// Sets what `options` say in the launch that they name, with the graphs of this machine in `base`, and prints from when on it acts.
///
/// # Errors
/// [`SetError`]; nothing of it is in use then.
pub fn run(options: &SetOptions, base: &Path) -> Result<(), SetError> {
    let (lines, role) = understand(&options.changes)?;
    let settled = set(options.run.as_deref(), base, role, &lines)?;
    if let Outcome::Applied { taken_at_tick, acts_from_tick, .. } = settled.answer.outcome {
        let keys = lines.trim_end().replace('\n', ", ");
        terminal::print(format_args!(
            "{keys}: in use from tick {acts_from_tick} on, taken up at tick {taken_at_tick}"
        ));
    }
    Ok(())
}

/// Asks the process of `role` for `lines`, and waits for its answer. What it did is in it.
///
/// # Errors
/// [`SetError`]; nothing of it is in use then.
pub fn set(
    run: Option<&Path>,
    base: &Path,
    role: Participant,
    lines: &str,
) -> Result<Settled, SetError> {
    let (entry, folder) = launch(run, base)?;
    if !settings_file(&folder, role).exists() {
        return Err(SetError::Elsewhere { role });
    }
    let asked_unix_nanos = SystemTime::now()
        .duration_since(SystemTime::UNIX_EPOCH)
        .map_or(0, |since| since.as_nanos() as u64);
    let asked =
        ask(&folder, role, &Request { who: who(), asked_unix_nanos, change: lines.to_owned() })?;
    let Some(settled) = asked.wait(PATIENCE, || entry.is_living()) else {
        return Err(if entry.is_living() { SetError::NoAnswer { role } } else { SetError::Ended });
    };
    match &settled.answer.outcome {
        Outcome::Applied { .. } => Ok(settled),
        Outcome::Refused { reason } => Err(SetError::Refused { role, reason: reason.clone() }),
    }
}

/// What was said on the command line, as lines of TOML, and whose keys these are.
///
/// # Errors
/// [`SetError`] if it cannot be understood.
pub fn understand(said: &[String]) -> Result<(String, Participant), SetError> {
    let lines = said.iter().map(|said| line(said)).collect::<Result<String, _>>()?;
    let change = Change::parse(&lines)?;
    let of_learner: Vec<bool> =
        change.entries().iter().map(|(key, _)| key.starts_with("learner.")).collect();
    match (of_learner.contains(&true), of_learner.contains(&false)) {
        (true, true) => Err(SetError::TwoProcesses),
        (true, false) => Ok((lines, Participant::Learner)),
        _ => Ok((lines, Participant::Controller)),
    }
}

/// `key=value` as a line of TOML: a value that is none is a word that lacks its quotes.
fn line(said: &str) -> Result<String, SetError> {
    let no_pair = || SetError::NoPair { said: said.to_owned() };
    let (key, value) =
        said.split_once('=').map(|(key, value)| (key.trim(), value.trim())).ok_or_else(no_pair)?;
    // One change has one line.
    if key.is_empty() || value.is_empty() || said.contains('\n') {
        return Err(no_pair());
    }
    let is_toml = format!("value = {value}").parse::<toml::Table>().is_ok();
    let value =
        if is_toml { value.to_owned() } else { Value::String(value.to_owned()).to_string() };
    Ok(format!("{key} = {value}\n"))
}

/// The launch that is meant, and the folder of its run.
fn launch(run: Option<&Path>, base: &Path) -> Result<(GraphEntry, PathBuf), SetError> {
    let mut running: Vec<(GraphEntry, PathBuf)> = registry::living(base)
        .into_iter()
        .filter_map(|entry| entry.run_folder().map(|folder| (entry, folder)))
        .collect();
    if let Some(run) = run {
        let not_running = || SetError::NotRunning { run: run.to_owned() };
        let meant = run.canonicalize().map_err(|_| not_running())?;
        return running.into_iter().find(|(_, folder)| *folder == meant).ok_or_else(not_running);
    }
    match (running.pop(), running.is_empty()) {
        (Some(only), true) => Ok(only),
        (Some((_, last)), false) => {
            let mut runs: Vec<PathBuf> =
                running.into_iter().map(|(_, folder)| folder).chain([last]).collect();
            runs.sort();
            Err(SetError::SeveralRun { runs })
        }
        (None, _) => Err(SetError::NothingRuns),
    }
}

fn alternatives(runs: &[PathBuf]) -> String {
    runs.iter().map(|run| format!("--run {}", run.display())).collect::<Vec<_>>().join(", or ")
}

/// The person's name, as the system has it.
fn who() -> String {
    let named = ["SUDO_USER", "USER", "LOGNAME"]
        .into_iter()
        .find_map(|name| env::var(name).ok().filter(|name| !name.is_empty()));
    named.unwrap_or_else(|| format!("user {}", rustix::process::getuid().as_raw()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn understood(said: &[&str]) -> Result<(String, Participant), String> {
        understand(&said.iter().map(|&said| said.to_owned()).collect::<Vec<_>>())
            .map_err(|error| error.to_string())
    }

    #[test]
    fn what_is_said_becomes_toml_and_goes_to_whom_it_belongs() {
        assert_eq!(
            understood(&["mpc.weights.position=20", "mpc.solver = clarabel"]),
            Ok((
                "mpc.weights.position = 20\nmpc.solver = \"clarabel\"\n".into(),
                Participant::Controller
            ))
        );
        assert_eq!(
            understood(&["learner.every_ticks=10"]),
            Ok(("learner.every_ticks = 10\n".into(), Participant::Learner))
        );
        assert_eq!(
            understood(&[
                "reference.path.circle={ radius_m = 1.0, speed_mps = 0.5 }",
                "reference.heading={fixed-rad=0.5}"
            ])
            .map(|(_, role)| role),
            Ok(Participant::Controller)
        );
    }

    #[test]
    fn what_cannot_be_understood_is_named() {
        let refused = |said: &[&str], part: &str| {
            let told = understood(said);
            assert!(told.as_ref().is_err_and(|told| told.contains(part)), "{said:?}: {told:?}");
        };
        refused(&["mpc.solver"], "\"mpc.solver\": expected KEY=VALUE");
        refused(&["=3"], "expected KEY=VALUE");
        refused(&["mpc.solver="], "expected KEY=VALUE");
        refused(&["a=1\nb=2"], "expected KEY=VALUE");
        refused(
            &["mpc.weights.position=1", "mpc.weights.position=2"],
            "is not TOML: duplicate key",
        );
        refused(&["mpc weights=1"], "is not TOML");
        refused(&["learner.every_ticks=5", "mpc.budget_share=0.4"], "one after the other");
    }

    #[test]
    fn where_nothing_runs_nothing_is_set() -> Result<(), Box<dyn std::error::Error>> {
        let folder = tempfile::tempdir()?;
        let say = |run| {
            set(run, folder.path(), Participant::Controller, "a = 1")
                .map_err(|error| (error.exit_code(), error.to_string()))
        };
        assert_eq!(say(None), Err((1, "no launch runs on this machine".into())));
        let run = folder.path();
        assert_eq!(
            say(Some(run)),
            Err((2, format!("--run {}: no launch runs there", run.display())))
        );
        Ok(())
    }
}
