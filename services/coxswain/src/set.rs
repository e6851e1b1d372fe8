//! `coxswain set`: a change of settings while the robot drives.
//!
//! The command line names the changes. The request goes to the process with these settings. Only
//! that process decides whether the change is possible, and replies ([`process::requests`]).

use access::Credentials;
use clap::Args;
use graph::hosts::is_address;
use network::requests::{ROLES, RequestError, Requester};
use network::threads;
use process::requests::{AskError, Asked, Outcome, Request, Settlement, ask};
use protocol::message::Participant;
use runs::registry::{self, GraphEntry};
use settings::change::{Change, ChangeError};
use std::env;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;
use supervisor::fleet::settings_file;
use toml::Value;

/// Longest time until the reply. A process that is restarted in the meantime replies after its
/// start.
const PATIENCE: Duration = Duration::from_secs(15);

/// The changes, and the run that they are for.
#[derive(Debug, Clone, Args)]
pub struct SetOptions {
    /// Dotted keys as in the scenario file, with their new values: one change, which is applied as
    /// a whole or not at all.
    ///
    /// `none` removes a limit. A word needs no quotes; any other value is written as in the file.
    #[arg(required = true, value_name = "KEY=VALUE")]
    pub changes: Vec<String>,
    /// The run directory; by default that of the launch that runs on this machine.
    #[arg(long, value_name = "DIR")]
    pub run: Option<PathBuf>,
}

/// Why nothing was set.
#[derive(Debug, thiserror::Error)]
pub enum SetError {
    /// The key or the value is missing.
    #[error("{given:?}: expected KEY=VALUE, as in mpc.weights.position=20")]
    NoPair {
        /// The argument.
        given: String,
    },
    /// The change cannot be parsed.
    #[error(transparent)]
    Change(#[from] ChangeError),
    /// Two processes would have to change at the same time.
    #[error("learner.* and other keys belong to different processes: set them one after the other")]
    TwoProcesses,
    /// No launch runs.
    #[error("no launch runs on this machine")]
    NothingRuns,
    /// Several launches run.
    #[error("several launches run on this machine; name one with --run: {}", alternatives(runs))]
    SeveralRun {
        /// Their run directories.
        runs: Vec<PathBuf>,
    },
    /// No launch runs in this directory.
    #[error("--run {}: no launch runs there", run.display())]
    NotRunning {
        /// The directory of the argument.
        run: PathBuf,
    },
    /// The process is not part of this launch.
    #[error("this launch has no {role}: run this command on the machine of that process")]
    Elsewhere {
        /// Role of the process.
        role: Participant,
    },
    /// The request could not be written.
    #[error(transparent)]
    Ask(#[from] AskError),
    /// The process rejected the change.
    #[error("rejected by the {role} ({code}): {reason}")]
    Refused {
        /// Role of the process.
        role: Participant,
        /// Kind of the rejection, for programs.
        code: String,
        /// Why not.
        reason: String,
    },
    /// The launch ended before a reply.
    #[error("the launch has ended, and nothing was changed")]
    Ended,
    /// The command cannot restart with the setting of zenoh's threads.
    #[error("the command cannot restart with another environment: {0}")]
    Restart(#[source] io::Error),
    /// No thread can wait for the network.
    #[error("no thread can be started: {0}")]
    Thread(#[source] io::Error),
    /// The bridge of another machine did not deliver it.
    #[error(transparent)]
    Network(#[from] RequestError),
    /// The reply from another machine is none.
    #[error("the reply of {at} cannot be read: {source}")]
    Reply {
        /// Its address.
        at: String,
        /// The cause.
        source: serde_json::Error,
    },
    /// The process sent no reply in time.
    #[error(
        "the {role} has not replied for {PATIENCE:?}; it processes the request when it is back"
    )]
    NoAnswer {
        /// Role of the process.
        role: Participant,
    },
}

impl SetError {
    /// 2 if an argument is invalid, else 1.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::NothingRuns
            | Self::Elsewhere { .. }
            | Self::Ask(_)
            | Self::Ended
            | Self::Reply { .. }
            | Self::Restart(_)
            | Self::Thread(_)
            | Self::Network(RequestError::Connect { .. } | RequestError::NoReply { .. })
            | Self::NoAnswer { .. } => 1,
            _ => 2,
        }
    }
}

/// Sets the values of `options` in the launch that they name. The graphs of this machine are in
/// `base`. Prints the first tick with the new values.
///
/// # Errors
/// [`SetError`]; no part of the change is in use then.
pub fn run(options: &SetOptions, base: &Path) -> Result<(), SetError> {
    let (lines, role) = understand(&options.changes)?;
    let settled = set(options.run.as_deref(), base, role, &lines)?;
    if let Outcome::Applied { taken_at_tick, acts_from_tick, .. } = settled.answer.outcome {
        let keys = lines.trim_end().replace('\n', ", ");
        terminal::print(format_args!(
            "{keys}: in use from tick {acts_from_tick} on, read at tick {taken_at_tick}"
        ));
    }
    Ok(())
}

/// Where orders and goals go: to a launch on this machine, or to the bridge of another one.
#[derive(Debug, Clone, Args)]
pub struct Recipient {
    /// The run directory; by default that of the launch that runs on this machine.
    #[arg(long, value_name = "DIR")]
    pub run: Option<PathBuf>,
    /// Host and port where another machine accepts requests (`[requests]` of its graph file).
    #[arg(
        long,
        value_name = "HOST:PORT",
        conflicts_with = "run",
        requires = "certificates",
        value_parser = address
    )]
    pub at: Option<String>,
    /// Folder of certificates with that of an operator or of a planner.
    #[arg(long, value_name = "DIR", requires = "at")]
    pub certificates: Option<PathBuf>,
}

impl Recipient {
    /// Sends the request `lines` to the process of `role`, and waits for the reply. The graphs of
    /// this machine are in `base`.
    ///
    /// # Errors
    /// [`SetError`]; nothing was changed then, unless no reply arrived.
    pub fn send(
        &self,
        base: &Path,
        role: Participant,
        lines: &str,
    ) -> Result<Settlement, SetError> {
        let Some(requester) = self.requester(None)? else {
            return set(self.run.as_deref(), base, role, lines);
        };
        let reply = requester.ask(role, lines)?;
        let settled = serde_json::from_slice(&reply)
            .map_err(|source| SetError::Reply { at: requester.endpoint().to_owned(), source })?;
        accepted(settled, role)
    }

    /// A session with the bridge at the address, or at `other` with the same certificate; none
    /// without an address. The program may restart in place.
    ///
    /// # Errors
    /// [`SetError`] if the bridge accepts no session.
    pub(crate) fn requester(&self, other: Option<&str>) -> Result<Option<Requester>, SetError> {
        let (Some(at), Some(folder)) = (&self.at, &self.certificates) else { return Ok(None) };
        threads::set().map_err(SetError::Restart)?;
        let endpoint = format!("tls/{}", other.unwrap_or(at));
        Ok(Some(Requester::open(&endpoint, &credentials_in(folder))?))
    }
}

/// The credentials in a folder of certificates: those of the operator, else of the planner. A
/// folder without either counts as that of one role.
fn credentials_in(folder: &Path) -> Credentials {
    let of_role = ROLES.map(|role| folder.join(role.to_string()));
    let found = of_role.into_iter().find(|folder| folder.is_dir());
    Credentials::in_folder(found.unwrap_or_else(|| folder.to_owned()))
}

pub(crate) fn address(text: &str) -> Result<String, String> {
    let expected = || "expected a host and a port, as in 10.0.0.1:7451".to_owned();
    is_address(text).then(|| text.to_owned()).ok_or_else(expected)
}

/// What `settled` says, if the request was applied.
fn accepted(settled: Settlement, role: Participant) -> Result<Settlement, SetError> {
    match &settled.answer.outcome {
        Outcome::Applied { .. } => Ok(settled),
        Outcome::Refused { code, reason } => {
            Err(SetError::Refused { role, code: code.clone(), reason: reason.clone() })
        }
    }
}

/// Requests the change `lines` from the process of `role`, and waits for the reply.
///
/// # Errors
/// [`SetError`]; no part of the change is in use then.
pub fn set(
    run: Option<&Path>,
    base: &Path,
    role: Participant,
    lines: &str,
) -> Result<Settlement, SetError> {
    let (entry, folder) = launch(run, base)?;
    let asked = request(&folder, role, lines)?;
    let Some(settled) = asked.wait(PATIENCE, || entry.is_living()) else {
        return Err(if entry.is_living() { SetError::NoAnswer { role } } else { SetError::Ended });
    };
    accepted(settled.into(), role)
}

/// Requests the change `lines` from the process of `role` in the run directory `folder`, without a
/// wait for the reply.
///
/// # Errors
/// [`SetError`] if the launch has no such process, or the request cannot be written.
pub(crate) fn request(folder: &Path, role: Participant, lines: &str) -> Result<Asked, SetError> {
    if !settings_file(folder, role).exists() {
        return Err(SetError::Elsewhere { role });
    }
    Ok(ask(folder, role, &Request::new(who(), lines))?)
}

/// The arguments of the command line as lines of TOML, and the process with these keys.
///
/// # Errors
/// [`SetError`] if an argument is invalid.
pub fn understand(arguments: &[String]) -> Result<(String, Participant), SetError> {
    let lines = arguments.iter().map(|argument| line(argument)).collect::<Result<String, _>>()?;
    let change = Change::parse(&lines)?;
    let of_learner: Vec<bool> =
        change.entries().iter().map(|(key, _)| key.starts_with("learner.")).collect();
    match (of_learner.contains(&true), of_learner.contains(&false)) {
        (true, true) => Err(SetError::TwoProcesses),
        (true, false) => Ok((lines, Participant::Learner)),
        _ => Ok((lines, Participant::Controller)),
    }
}

/// `key=value` as a line of TOML. A value that is not valid TOML is a word without quotes.
fn line(argument: &str) -> Result<String, SetError> {
    let no_pair = || SetError::NoPair { given: argument.to_owned() };
    let (key, value) = argument
        .split_once('=')
        .map(|(key, value)| (key.trim(), value.trim()))
        .ok_or_else(no_pair)?;
    // One change is one line.
    if key.is_empty() || value.is_empty() || argument.contains('\n') {
        return Err(no_pair());
    }
    let is_toml = format!("value = {value}").parse::<toml::Table>().is_ok();
    let value =
        if is_toml { value.to_owned() } else { Value::String(value.to_owned()).to_string() };
    Ok(format!("{key} = {value}\n"))
}

/// The selected launch, and its run directory.
pub(crate) fn launch(run: Option<&Path>, base: &Path) -> Result<(GraphEntry, PathBuf), SetError> {
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

/// Name of the user, from the environment.
fn who() -> String {
    let named = ["SUDO_USER", "USER", "LOGNAME"]
        .into_iter()
        .find_map(|name| env::var(name).ok().filter(|name| !name.is_empty()));
    named.unwrap_or_else(|| format!("user {}", rustix::process::getuid().as_raw()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn understood(arguments: &[&str]) -> Result<(String, Participant), SetError> {
        understand(&arguments.iter().map(|&argument| argument.to_owned()).collect::<Vec<_>>())
    }

    #[test]
    fn arguments_become_toml_for_the_process_with_these_keys() {
        let is_understood = |arguments: &[&str], lines: &str, role| {
            let found = understood(arguments);
            assert!(
                matches!(&found, Ok((found, whose)) if found == lines && *whose == role),
                "{found:?}"
            );
        };
        is_understood(
            &["mpc.weights.position=20", "mpc.solver = clarabel"],
            "mpc.weights.position = 20\nmpc.solver = \"clarabel\"\n",
            Participant::Controller,
        );
        is_understood(
            &["learner.every_ticks=10"],
            "learner.every_ticks = 10\n",
            Participant::Learner,
        );
        is_understood(
            &[
                "reference.path.circle={ radius_m = 1.0, speed_mps = 0.5 }",
                "reference.heading={fixed-rad=0.5}",
            ],
            "reference.path.circle = { radius_m = 1.0, speed_mps = 0.5 }\n\
             reference.heading = {fixed-rad=0.5}\n",
            Participant::Controller,
        );
    }

    #[test]
    fn an_invalid_argument_is_named_in_the_error() {
        for argument in ["mpc.solver", "=3", "mpc.solver=", "a=1\nb=2"] {
            let refused = understood(&[argument]);
            assert!(
                matches!(&refused, Err(SetError::NoPair { given }) if given == argument),
                "{refused:?}"
            );
        }
        for arguments in
            [&["mpc.weights.position=1", "mpc.weights.position=2"][..], &["mpc weights=1"]]
        {
            let refused = understood(arguments);
            assert!(
                matches!(refused, Err(SetError::Change(ChangeError::Syntax { .. }))),
                "{refused:?}"
            );
        }
        let refused = understood(&["learner.every_ticks=5", "mpc.budget_share=0.4"]);
        assert!(matches!(refused, Err(SetError::TwoProcesses)), "{refused:?}");
    }

    #[test]
    fn without_a_running_launch_nothing_is_set() -> Result<(), Box<dyn std::error::Error>> {
        let folder = tempfile::tempdir()?;
        let say = |run| set(run, folder.path(), Participant::Controller, "a = 1");
        let refused = say(None);
        assert!(matches!(refused, Err(SetError::NothingRuns)), "{refused:?}");
        let refused = say(Some(folder.path()));
        assert!(
            matches!(&refused, Err(SetError::NotRunning { run }) if run == folder.path()),
            "{refused:?}"
        );
        assert_eq!(refused.err().map(|error| error.exit_code()), Some(2));
        Ok(())
    }
}
