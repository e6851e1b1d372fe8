//! A graph that the drill launches as a user would, with this same program and in a folder of its
//! own.

mod home;

pub(super) use home::{Home, permits_little_shared_memory};

use super::record::Record;
use graph::role::program;
use process::{Stop, give_way};
use protocol::message::Participant;
use rustix::process::{Pid, Signal, kill_process};
use std::error::Error;
use std::fs;
use std::panic::resume_unwind;
use std::path::{Path, PathBuf};
use std::process::{Child, ExitStatus};
use std::thread;
use std::time::{Duration, Instant};

/// Why an exercise could not be done.
pub(super) type Trouble = Box<dyn Error + Send + Sync>;

/// Error of an interrupted exercise.
pub(super) const INTERRUPTED: &str = "interrupted by a signal";

/// Timeout for what must happen at some time. It is far longer than that takes.
const GIVES_UP_AFTER: Duration = Duration::from_mins(2);

/// A launched graph; it does not outlive this value.
#[derive(Debug)]
pub(super) struct Session {
    child: Child,
    run: PathBuf,
    /// Time of the launch, on the monotonic clock \[ns\].
    pub(super) begun_nanos: u64,
}

impl Session {
    /// The run directory.
    pub(super) fn run(&self) -> &Path {
        &self.run
    }

    /// Its record, read while no exercise needs the machine.
    ///
    /// # Errors
    /// If there is none.
    pub(super) fn record(&self) -> Result<Record, Trouble> {
        let read = || {
            give_way();
            Record::read_without_rows(&self.run)
        };
        Ok(thread::scope(|scope| scope.spawn(read).join())
            .unwrap_or_else(|panic| resume_unwind(panic))?)
    }

    /// Name of the graph.
    ///
    /// # Errors
    /// If the launch never reported it.
    pub(super) fn graph_name(&self) -> Result<String, Trouble> {
        let log = fs::read_to_string(self.run.join("coxswain.log"))?;
        let name = log.lines().find_map(|line| line.split_once("graph=\"")?.1.split_once('"'));
        Ok(name.ok_or("the launcher did not report the graph's name")?.0.to_owned())
    }

    /// Waits until the log of `process` contains `text` this many times.
    ///
    /// # Errors
    /// If it never does.
    pub(super) fn wait_for_log(
        &mut self,
        process: &str,
        text: &str,
        times: usize,
    ) -> Result<(), Trouble> {
        wait_for_text(&mut self.child, &self.run.join(process).with_extension("log"), text, times)
            .map(drop)
    }

    /// Calls `work` with the process id of `role`, once the launcher has started it and before the
    /// launcher starts any later process. The launcher is stopped while `work` runs, and then
    /// continues.
    ///
    /// # Errors
    /// If the launcher never starts the process, or the error of `work`.
    pub(super) fn pausing_at<T>(
        &mut self,
        role: Participant,
        work: impl FnOnce(&Self) -> Result<T, Trouble>,
    ) -> Result<T, Trouble> {
        let begin = Instant::now();
        while self.pid_of(role).is_none() {
            if begin.elapsed() > GIVES_UP_AFTER || self.child.try_wait()?.is_some() {
                return Err(format!("the launcher never started the {role}").into());
            }
            thread::sleep(Duration::from_micros(500));
        }
        let launcher = Pid::from_child(&self.child);
        kill_process(launcher, Signal::STOP)?;
        let outcome = work(self);
        kill_process(launcher, Signal::CONT)?;
        outcome
    }

    /// The process of the launcher that plays `role`.
    pub(super) fn pid_of(&self, role: Participant) -> Option<Pid> {
        self.pid_named(program(role))
    }

    /// The process of the launcher that is called `program`.
    pub(super) fn pid_named(&self, program: &str) -> Option<Pid> {
        let plays = |pid: &i32| {
            fs::read_to_string(format!("/proc/{pid}/comm"))
                .is_ok_and(|name| name.trim_end() == program)
        };
        children(self.child.id()).into_iter().find(plays).and_then(Pid::from_raw)
    }

    /// Waits until it has ended by itself, at most for `duration_s` and the time that ending takes.
    ///
    /// # Errors
    /// If it does not end, or if the drill is interrupted.
    pub(super) fn wait(&mut self, duration_s: f64, stop: &Stop) -> Result<ExitStatus, Trouble> {
        let end = Instant::now() + Duration::from_secs_f64(3.0 * duration_s) + GIVES_UP_AFTER;
        loop {
            if let Some(status) = self.child.try_wait()? {
                return Ok(status);
            }
            if stop.requested() {
                return Err(INTERRUPTED.into());
            }
            if Instant::now() > end {
                return Err("the launch does not end".into());
            }
            thread::sleep(Duration::from_millis(10));
        }
    }

    /// Requests the end of the launcher, and waits.
    ///
    /// # Errors
    /// If it does not end.
    pub(super) fn end(&mut self) -> Result<ExitStatus, Trouble> {
        kill_process(Pid::from_child(&self.child), Signal::TERM)?;
        self.wait(0.0, &Stop::new())
    }

    /// Kills launcher and processes at once. No process is left to react to it.
    ///
    /// # Errors
    /// If there is no process.
    pub(super) fn kill_all(&mut self) -> Result<(), Trouble> {
        let launcher = self.child.id();
        let children = children(launcher);
        // The launcher first: it would start the others again.
        self.child.kill()?;
        for child in &children {
            let _ = Pid::from_raw(*child).map(|pid| kill_process(pid, Signal::KILL));
        }
        self.child.wait()?;
        let begin = Instant::now();
        while children.iter().any(|child| Path::new(&format!("/proc/{child}/fd/0")).exists()) {
            if begin.elapsed() > GIVES_UP_AFTER {
                return Err("a process that was killed does not end".into());
            }
            thread::sleep(Duration::from_millis(2));
        }
        Ok(())
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        if let Ok(None) = self.child.try_wait() {
            let _ = kill_process(Pid::from_child(&self.child), Signal::TERM);
            let _ = self.child.wait();
        }
    }
}

/// Waits until `file` contains `text` this many times, and returns its content.
///
/// # Errors
/// If `writer` ends before, or if the text never comes.
pub(super) fn wait_for_text(
    writer: &mut Child,
    file: &Path,
    text: &str,
    times: usize,
) -> Result<String, Trouble> {
    let begin = Instant::now();
    loop {
        let over = begin.elapsed() > GIVES_UP_AFTER || writer.try_wait()?.is_some();
        let content = fs::read_to_string(file).unwrap_or_default();
        if content.matches(text).count() >= times {
            return Ok(content);
        }
        if over {
            return Err(format!("{text:?} was not to be found in {}", file.display()).into());
        }
        thread::sleep(Duration::from_millis(5));
    }
}

fn children(pid: u32) -> Vec<i32> {
    let tasks = fs::read_dir(format!("/proc/{pid}/task")).into_iter().flatten().flatten();
    let lists = tasks.filter_map(|task| fs::read_to_string(task.path().join("children")).ok());
    lists
        .flat_map(|list| {
            list.split_whitespace().filter_map(|pid| pid.parse().ok()).collect::<Vec<i32>>()
        })
        .collect()
}
