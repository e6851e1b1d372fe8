//! A planner, or an operator: a process of this same program that requests something of a launch.

use crate::session::{Home, Session, Trouble};
use process::Stop;
use process::requests::Settled;
use protocol::message::Participant;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use std::fs::{self, OpenOptions};
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

/// Timeout for what must happen at some time. It is far longer than that takes.
const GIVES_UP_AFTER: Duration = Duration::from_mins(2);
/// Interval between two looks.
const LOOK: Duration = Duration::from_millis(3);

/// The planner does not outlive this value.
pub(crate) struct Planner {
    child: Child,
    arguments: String,
}

impl Planner {
    /// Starts `coxswain ARGUMENTS` for the launch, as the user `name`.
    ///
    /// # Errors
    /// If it cannot be started.
    pub(crate) fn start(
        home: &Home<'_>,
        session: &Session,
        name: &str,
        arguments: &[&str],
    ) -> Result<Self, Trouble> {
        let mut command = command(home, session, arguments)?;
        let file = home.folder().join("planners.txt");
        let output = OpenOptions::new().create(true).append(true).open(file)?;
        command.env("SUDO_USER", name).stdout(output.try_clone()?).stderr(output);
        Ok(Self { child: command.spawn()?, arguments: arguments.join(" ") })
    }

    /// Waits until it has ended, and returns its exit code.
    ///
    /// # Errors
    /// If it does not end.
    pub(crate) fn exit_code(&mut self, stop: &Stop) -> Result<Option<i32>, Trouble> {
        let mut ended = None;
        wait_until(&self.arguments, stop, || {
            ended = self.child.try_wait()?;
            Ok(ended.is_some())
        })?;
        Ok(ended.and_then(|status| status.code()))
    }

    /// Sends it a signal.
    ///
    /// # Errors
    /// The error of the system.
    pub(crate) fn signal(&self, signal: Signal) -> Result<(), Trouble> {
        Ok(kill_process(Pid::from_child(&self.child), signal)?)
    }
}

impl Drop for Planner {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn command(home: &Home<'_>, session: &Session, arguments: &[&str]) -> Result<Command, Trouble> {
    let mut command = Command::new(std::env::current_exe()?);
    command.args(arguments).arg("--run").arg(session.run());
    command.env("TMPDIR", home.folder()).process_group(0).stdin(Stdio::null());
    Ok(command)
}

/// Exit code of `coxswain ARGUMENTS` for the launch.
///
/// # Errors
/// If it cannot be started, or does not end.
pub(crate) fn tell(
    home: &Home<'_>,
    session: &Session,
    arguments: &[&str],
    stop: &Stop,
) -> Result<Option<i32>, Trouble> {
    Planner::start(home, session, "planner", arguments)?.exit_code(stop)
}

/// `coxswain status --json` of the launch.
///
/// # Errors
/// If it has none.
pub(crate) fn status(home: &Home<'_>, session: &Session) -> Result<Value, Trouble> {
    let output = command(home, session, &["status", "--json"])?.stderr(Stdio::null()).output()?;
    Ok(serde_json::from_slice(&output.stdout)?)
}

/// All goals of a run with a reply, in the order of their numbers.
pub(crate) fn all_settled(run: &Path) -> Vec<Settled> {
    (1..).map_while(|number| Settled::read(run, Participant::Controller, number)).collect()
}

/// Number of requests to the controller, with and without a reply.
pub(crate) fn requested(run: &Path) -> u64 {
    let files = fs::read_dir(run.join("set")).into_iter().flatten().flatten();
    let names = files.filter_map(|file| file.file_name().into_string().ok());
    let is_request = |name: &String| {
        let number = name.strip_prefix("controller-").and_then(|rest| rest.strip_suffix(".json"));
        number.is_some_and(|number| number.parse::<u64>().is_ok())
    };
    names.filter(is_request).count() as u64
}

/// Waits until each request has a reply, and returns their number.
///
/// # Errors
/// If a reply never comes.
pub(crate) fn wait_for_replies(run: &Path, stop: &Stop) -> Result<u64, Trouble> {
    let mut replied = 0;
    wait_until("replies", stop, || {
        while Settled::read(run, Participant::Controller, replied + 1).is_some() {
            replied += 1;
        }
        Ok(replied >= requested(run))
    })?;
    Ok(replied)
}

/// Waits until `is_so`.
///
/// # Errors
/// If it never is, or an error of `is_so`.
pub(crate) fn wait_until(
    what: &str,
    stop: &Stop,
    mut is_so: impl FnMut() -> Result<bool, Trouble>,
) -> Result<(), Trouble> {
    let begin = Instant::now();
    while !is_so()? {
        if stop.requested() {
            return Err(crate::session::INTERRUPTED.into());
        }
        if begin.elapsed() > GIVES_UP_AFTER {
            return Err(format!("{what}: it does not end").into());
        }
        thread::sleep(LOOK);
    }
    Ok(())
}
