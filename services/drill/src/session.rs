//! A graph that the drill launches as a user would, with this same program and in a folder of its
//! own.

use super::catalogue::{Carrier, Launch};
use super::ground::Ground;
use super::hosts::Hosts;
use super::oracle::Limits;
use super::record::Record;
use super::tracking::Course;
use graph::assembly::Assembly;
use graph::options::Options;
use graph::role::{START_ORDER, program};
use graph::scenario::Scenario;
use process::{Stop, give_way};
use protocol::clock::monotonic_nanos;
use protocol::message::Participant;
use rustix::process::{Pid, Signal, geteuid, kill_process};
use std::error::Error;
use std::ffi::OsStr;
use std::fmt::Write;
use std::fs::{self, File};
use std::io;
use std::net::TcpListener;
use std::os::unix::process::CommandExt;
use std::panic::resume_unwind;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Why an exercise could not be done.
pub(super) type Trouble = Box<dyn Error + Send + Sync>;

/// Error of an interrupted exercise.
pub(super) const INTERRUPTED: &str = "interrupted by a signal";

/// The scenario of most drill graphs: it covers every direction, and lasts as long as necessary.
const SCENARIO: &str = "figure-eight";
/// The scenario of graphs that wait for goals, with the same period.
const GOALS: &str = "goals";
/// A sensor for obstacles in that scenario.
const SENSOR: &str = "\n[obstacles]\nrange_m = 5.0\n";
/// T = 20 ms.
const PROFILE: &str = "agile";
/// Timeout for what must happen at some time. It is far longer than that takes.
const GIVES_UP_AFTER: Duration = Duration::from_mins(2);
/// Settings of processes that may die often. The drill measures how they restart, not when the
/// launcher gives up.
const PATIENT: &str =
    "restarts_per_minute = 1000000\nback_off_millis = 0\nback_off_max_millis = 0\n";

/// The folder in which the files of the graphs are written, and from which they are launched.
#[derive(Debug)]
pub(super) struct Home<'a> {
    ground: &'a Ground,
    folder: TempDir,
    graph: PathBuf,
    carrier: Carrier,
    /// Size of the shared memory, if it is limited \[MiB\].
    shared_memory: Option<u64>,
}

/// A launched graph; it does not outlive this value.
#[derive(Debug)]
pub(super) struct Session {
    child: Child,
    run: PathBuf,
    /// Time of the launch, on the monotonic clock \[ns\].
    pub(super) begun_nanos: u64,
}

impl<'a> Home<'a> {
    /// Writes graph, scenario and faults, with the robot of `ground`.
    ///
    /// # Errors
    /// A sentence.
    pub(super) fn new(
        ground: &'a Ground,
        carrier: Carrier,
        launch: &Launch,
        seed: u64,
    ) -> Result<Self, Trouble> {
        let folder = tempfile::Builder::new().prefix("cx").tempdir()?;
        let deploy = ground.deploy();
        let scenarios = deploy.join("scenarios");
        let scenario = if launch.waits_for_goals {
            Scenario::merged(&scenarios, GOALS, None, &[])? + SENSOR
        } else {
            Scenario::merged(&scenarios, SCENARIO, Some(PROFILE), &[])?
        };
        fs::write(folder.path().join("scenario.toml"), scenario)?;
        fs::write(folder.path().join("faults.toml"), format!("seed = {seed}\n{}", launch.faults))?;
        let robot = deploy.join("robots/mecanum.toml").canonicalize()?;
        let pace = if launch.lock_step { "lock-step" } else { "real-time" };
        let mut text = format!(
            "name = \"drill\"\nrobot = \"{}\"\nscenario = \"scenario.toml\"\npace = \"{pace}\"\n\
             [telemetry]\nlisten = [\"tcp/127.0.0.1:0\"]\n",
            robot.display()
        );
        text += &hosts_of(carrier)?;
        let has_hosts = carrier != Carrier::SharedMemory;
        for role in START_ORDER {
            let exists = match role {
                Participant::Bridge => has_hosts,
                Participant::Gateway => !has_hosts,
                _ => true,
            };
            if exists {
                let _ = write!(text, "[processes.{}]\n{PATIENT}", role.text());
            }
        }
        let graph = folder.path().join("graph.toml");
        fs::write(&graph, text)?;
        Ok(Self { ground, folder, graph, carrier, shared_memory: launch.shared_memory_mebibytes })
    }

    /// Limits of the robot and the period.
    ///
    /// # Errors
    /// If a setting in a file is impossible.
    pub(super) fn limits(&self) -> Result<Limits, Trouble> {
        Ok(Limits::of(&Assembly::read(&Options::of_graph(&self.graph))?))
    }

    /// The course of its robot.
    ///
    /// # Errors
    /// If a twin does not finish.
    pub(super) fn course(&self) -> Result<&Course, Trouble> {
        self.ground.course()
    }

    /// The whole graph with its faults.
    ///
    /// # Errors
    /// If a setting in a file is impossible.
    pub(super) fn assembly(&self) -> Result<Assembly, Trouble> {
        let faults = Some(self.folder.path().join("faults.toml"));
        Ok(Assembly::read(&Options { faults, ..Options::of_graph(&self.graph) })?)
    }

    /// Carrier of its links.
    pub(super) fn carrier(&self) -> Carrier {
        self.carrier
    }

    /// The folder of its files.
    pub(super) fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Launches the graph for `duration_s`, with the run directory `run`.
    ///
    /// # Errors
    /// If it cannot be started.
    pub(super) fn launch(&self, run: &str, duration_s: f64) -> Result<Session, Trouble> {
        let command = self.command(run, duration_s)?;
        // The record is that of the robot's host.
        let has_hosts = self.carrier != Carrier::SharedMemory;
        let directory = if has_hosts { format!("{run}/robot") } else { run.to_owned() };
        self.begin(
            run,
            &directory,
            match self.shared_memory {
                Some(mebibytes) => little_shared_memory(&command, mebibytes),
                None => command,
            },
        )
    }

    /// Launches the graph for `duration_s` as one of several.
    ///
    /// The launch writes its output to a file of `name`, and its run directory is `run`, which
    /// another launch may use as well.
    ///
    /// # Errors
    /// If it cannot be started.
    pub(super) fn launch_beside(
        &self,
        name: &str,
        run: &str,
        duration_s: f64,
    ) -> Result<Session, Trouble> {
        let command = self.command(run, duration_s)?;
        self.begin(name, run, command)
    }

    /// Launches the processes of the host `name` for `duration_s`, with the run directory `run`.
    /// Robot and controller meet on `hosts`, with the certificates in a folder if there is one.
    ///
    /// # Errors
    /// If it cannot be started.
    pub(super) fn launch_on(
        &self,
        hosts: &Hosts,
        (name, run): (&str, &str),
        certificates: Option<&Path>,
        duration_s: f64,
    ) -> Result<Session, Trouble> {
        let mut command = self.command(run, duration_s)?;
        command.args(["--host", name]);
        match certificates {
            Some(folder) => command.arg("--certificates").arg(folder),
            None => command.arg("--insecure"),
        };
        let (number, address) = match name {
            "robot" => (0, Some(format!("control={}", hosts.address()))),
            "control" => (1, Some(format!("robot={}", hosts.far_address()))),
            _ => (0, None),
        };
        if let Some(address) = address {
            command.args(["--address", &address]);
        }
        self.begin(run, run, hosts.on(number, command))
    }

    fn command(&self, run: &str, duration_s: f64) -> Result<Command, Trouble> {
        let home = self.folder.path();
        let mut command = Command::new(std::env::current_exe()?);
        command.arg("launch").arg(&self.graph).args(["--duration", &duration_s.to_string()]);
        command
            .arg("--faults")
            .arg(home.join("faults.toml"))
            .arg("--out")
            .arg(home.join(run))
            .arg("--stop-with-stdin");
        Ok(command)
    }

    fn begin(&self, name: &str, run: &str, mut command: Command) -> Result<Session, Trouble> {
        let home = self.folder.path();
        let output = File::create(home.join(format!("{name}.txt")))?;
        // A Ctrl-C on the terminal goes to the drill only, which ends its launches in order. If the
        // drill is killed, its launches end because their input ends.
        command
            .env("TMPDIR", home)
            .process_group(0)
            .stdin(Stdio::piped())
            .stdout(output.try_clone()?)
            .stderr(output);
        let begun_nanos = monotonic_nanos();
        Ok(Session { child: command.spawn()?, run: home.join(run), begun_nanos })
    }

    /// What a launch printed.
    pub(super) fn said(&self, name: &str) -> String {
        fs::read_to_string(self.folder.path().join(format!("{name}.txt"))).unwrap_or_default()
    }

    /// What graphs have left behind after their end: files of the graphs in this folder, and shared
    /// memory of the graphs `names`.
    pub(super) fn left_behind(&self, names: &[String]) -> Vec<String> {
        let files = |folder: &Path| {
            fs::read_dir(folder).into_iter().flatten().flatten().map(|file| file.path())
        };
        let bases = files(self.folder.path()).filter(|path| {
            path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("coxswain-"))
        });
        let ours = |path: &PathBuf| {
            path.file_name()
                .and_then(OsStr::to_str)
                .is_some_and(|file| names.iter().any(|name| file.contains(name.as_str())))
        };
        bases
            .chain(files(Path::new("/dev/shm")).filter(ours))
            .map(|path| path.display().to_string())
            .collect()
    }

    /// Keeps all files in `folder`, for inspection.
    ///
    /// # Errors
    /// The error of the file system.
    pub(super) fn keep(self, folder: &Path) -> Result<(), Trouble> {
        fs::create_dir_all(folder)?;
        copy_all(self.folder.path(), folder)
    }
}

/// The part of a graph file about its hosts. The hosts meet on free ports of the loopback.
fn hosts_of(carrier: Carrier) -> io::Result<String> {
    type Pairs = &'static [(&'static str, &'static str)];
    let (hosts, connected): (Pairs, Pairs) = match carrier {
        Carrier::SharedMemory | Carrier::None => (&[], &[]),
        Carrier::Hosts => (
            &[("robot", "\"plant\", \"recorder\""), ("control", "\"controller\", \"learner\"")],
            &[("robot", "control")],
        ),
        Carrier::ThreeHosts => (
            &[
                ("robot", "\"plant\", \"recorder\""),
                ("control", "\"controller\""),
                ("training", "\"learner\""),
            ],
            &[("robot", "control"), ("control", "training"), ("robot", "training")],
        ),
    };
    let mut text = String::new();
    for (host, processes) in hosts {
        let _ = writeln!(text, "[hosts.{host}]\nprocesses = [{processes}]");
    }
    for (one, other) in connected {
        let address = TcpListener::bind("127.0.0.1:0")?.local_addr()?;
        let _ = writeln!(
            text,
            "[[connections]]\nhosts = [{one:?}, {other:?}]\naddress = \"{address}\""
        );
    }
    Ok(text)
}

fn copy_all(from: &Path, to: &Path) -> Result<(), Trouble> {
    for entry in fs::read_dir(from)? {
        let entry = entry?;
        let (kind, target) = (entry.file_type()?, to.join(entry.file_name()));
        if kind.is_dir() {
            fs::create_dir_all(&target)?;
            copy_all(&entry.path(), &target)?;
        } else if kind.is_file() {
            fs::copy(entry.path(), target)?;
        }
    }
    Ok(())
}

/// `command` on a machine with this much shared memory: in a mount namespace with its own file
/// system for it.
fn little_shared_memory(command: &Command, mebibytes: u64) -> Command {
    const MOUNT: &str = "mount -t tmpfs -o \"size=$1m\" tmpfs /dev/shm && shift && exec \"$@\"";
    let mut there = unshared();
    there
        .args(["sh", "-c", MOUNT, "sh", &mebibytes.to_string()])
        .arg(command.get_program())
        .args(command.get_args());
    there
}

/// The beginning of a command in a mount namespace, with the available rights.
fn unshared() -> Command {
    let mut unshare = Command::new("unshare");
    if !geteuid().is_root() {
        unshare.arg("--map-root-user");
    }
    unshare.arg("--mount");
    unshare
}

/// Whether the system permits machines with little shared memory.
pub(super) fn permits_little_shared_memory() -> bool {
    let mut look = unshared();
    look.args(["mount", "-t", "tmpfs", "tmpfs", "/dev/shm"])
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    look.status().is_ok_and(|status| status.success())
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
        let plays = |pid: &i32| {
            fs::read_to_string(format!("/proc/{pid}/comm"))
                .is_ok_and(|name| name.trim_end() == program(role))
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
