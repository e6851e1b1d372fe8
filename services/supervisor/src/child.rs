//! One process: start, signal, exit status.

use crate::service_manager::VARIABLES;
use network::threads;
use process::Lifeline;
use protocol::message::Participant;
use rustix::process::{Pid, Signal, kill_process};
use std::fs::{self, File};
use std::io;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child as SystemChild, Command, ExitStatus};

/// Number of log lines that are shown when a process has ended.
const LAST_LINES: usize = 5;

/// A started process. It does not outlive this value.
#[derive(Debug)]
pub struct Child {
    role: Participant,
    system: SystemChild,
    /// The line that is its standard input, which ends when the launcher ends.
    lifeline: Lifeline,
}

/// How a process ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ending(ExitStatus);

impl From<ExitStatus> for Ending {
    fn from(status: ExitStatus) -> Self {
        Self(status)
    }
}

impl Child {
    /// Starts `program`, which is that of `role`. It gets its own process group, so that Ctrl-C
    /// in a terminal reaches only the launcher.
    ///
    /// # Errors
    /// If it cannot be started.
    pub fn start(
        role: Participant,
        program: &Path,
        settings: &Path,
        run: &Path,
    ) -> io::Result<Self> {
        let output = File::options().create(true).append(true).open(output_file(run, role))?;
        let (lifeline, input) = Lifeline::new()?;
        let mut command = Command::new(program);
        for variable in VARIABLES {
            command.env_remove(variable);
        }
        let system = command
            .arg("--settings")
            .arg(settings)
            .arg("--stop-with-stdin")
            .stdin(input)
            .stdout(output.try_clone()?)
            .stderr(output)
            .process_group(0)
            // A process that runs out of memory while it prints a backtrace waits for itself, and
            // never ends.
            .env("RUST_BACKTRACE", "0")
            .env(threads::VARIABLE, threads::THREADS)
            .spawn()?;
        Ok(Self { role, system, lifeline })
    }

    /// Its role.
    pub fn role(&self) -> Participant {
        self.role
    }

    /// Its process id.
    pub fn pid(&self) -> u32 {
        self.system.id()
    }

    /// The same, in the type of rustix.
    pub fn id(&self) -> Pid {
        Pid::from_child(&self.system)
    }

    /// Its heartbeats so far. No other process can forge them.
    pub fn lifeline(&mut self) -> &Lifeline {
        self.lifeline.listen();
        &self.lifeline
    }

    /// How it ended, if it has.
    ///
    /// # Errors
    /// If the system does not report it.
    pub fn ended(&mut self) -> io::Result<Option<Ending>> {
        Ok(self.system.try_wait()?.map(Ending))
    }

    /// Waits until it has ended.
    ///
    /// # Errors
    /// If the system does not report it.
    pub fn wait(&mut self) -> io::Result<Ending> {
        self.system.wait().map(Ending)
    }

    /// Whether a signal or a debugger has stopped it, so that it does not run.
    pub fn is_stopped(&self) -> bool {
        let status = fs::read_to_string(format!("/proc/{}/stat", self.pid())).unwrap_or_default();
        // The name before it is in parentheses, and may contain any characters.
        status.rsplit(')').next().is_some_and(|rest| rest.trim_start().starts_with(['T', 't']))
    }

    /// Requests its end. A stopped process is continued, so that it receives the request.
    pub fn ask_to_end(&self) {
        self.signal(Signal::TERM);
        self.signal(Signal::CONT);
    }

    /// Kills it.
    pub fn kill(&self) {
        self.signal(Signal::KILL);
    }

    /// The process has not been reaped, so the id still belongs to it. It makes no difference if it
    /// has ended already.
    fn signal(&self, signal: Signal) {
        let _ = kill_process(self.id(), signal);
    }
}

/// No process is left running. For a process that has ended this does nothing.
impl Drop for Child {
    fn drop(&mut self) {
        let _ = self.system.kill();
        let _ = self.system.wait();
    }
}

impl Ending {
    /// Whether it ended correctly: by itself, or by SIGTERM before it installed its handler.
    pub fn is_clean(self) -> bool {
        self.0.success() || self.0.signal() == Some(Signal::TERM.as_raw())
    }

    /// Whether it was killed (SIGKILL).
    pub fn is_kill(self) -> bool {
        self.0.signal() == Some(Signal::KILL.as_raw())
    }

    /// Whether its exit code is 0.
    pub fn is_success(self) -> bool {
        self.0.success()
    }
}

impl std::fmt::Display for Ending {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match (self.0.code(), self.0.signal()) {
            (Some(code), _) => write!(f, "exit code {code}"),
            (None, Some(signal)) => write!(f, "signal {signal}"),
            (None, None) => write!(f, "{}", self.0),
        }
    }
}

/// File for the output of a process apart from its log.
pub fn output_file(run: &Path, role: Participant) -> PathBuf {
    run.join(format!("{}.out", role.text()))
}

/// Last output of a process: the end of its log and of its output, one line each, indented.
pub fn last_words(run: &Path, role: Participant) -> String {
    let files = [run.join(format!("{}.log", role.text())), output_file(run, role)];
    files
        .iter()
        .flat_map(|file| last_lines(file))
        .fold(String::new(), |words, line| words + "\n    " + &line)
}

fn last_lines(file: &Path) -> Vec<String> {
    let bytes = fs::read(file).unwrap_or_default();
    let text = String::from_utf8_lossy(&bytes);
    let lines: Vec<&str> = text.lines().collect();
    lines.iter().skip(lines.len().saturating_sub(LAST_LINES)).map(|&line| line.to_owned()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_exit_status_is_described_in_words() {
        assert_eq!(Ending(ExitStatus::from_raw(2 << 8)).to_string(), "exit code 2");
        assert_eq!(Ending(ExitStatus::from_raw(9)).to_string(), "signal 9");
        assert!(
            Ending(ExitStatus::from_raw(15)).is_clean()
                && !Ending(ExitStatus::from_raw(15)).is_success()
        );
    }

    #[test]
    fn the_last_words_are_the_last_lines_of_log_and_output() -> io::Result<()> {
        let run = tempfile::tempdir()?;
        fs::write(run.path().join("plant.log"), "1\n2\n3\n4\n5\n6\n")?;
        fs::write(run.path().join("plant.out"), "plant: lost\n")?;
        let words = last_words(run.path(), Participant::Plant);
        assert_eq!(
            words.split_whitespace().collect::<Vec<_>>(),
            ["2", "3", "4", "5", "6", "plant:", "lost"]
        );
        Ok(())
    }
}
