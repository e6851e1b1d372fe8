//! The folder of an exercise, and what it launches there.

use super::{Session, Trouble};
use crate::catalogue::{Carrier, Driven, Launch};
use crate::firmware::{self, DRIVER};
use crate::ground::Ground;
use crate::hosts::Hosts;
use crate::oracle::Limits;
use crate::tracking::Course;
use graph::assembly::Assembly;
use graph::options::Options;
use graph::role::START_ORDER;
use graph::scenario::Scenario;
use protocol::clock::monotonic_nanos;
use protocol::message::Participant;
use rustix::process::geteuid;
use std::ffi::OsStr;
use std::fmt::Write;
use std::fs::{self, File};
use std::io;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use tempfile::TempDir;

/// The scenario of most drill graphs: it covers every direction, and lasts as long as necessary.
const SCENARIO: &str = "figure-eight";

/// The scenario of graphs that wait for goals, with the same period.
const GOALS: &str = "goals";

/// A sensor for obstacles in that scenario.
const SENSOR: &str = "\n[obstacles]\nrange_m = 5.0\n";

/// T = 20 ms.
const PROFILE: &str = "agile";

/// Settings of processes that may die often. The drill measures how they restart, not when the
/// launcher gives up.
const PATIENT: &str =
    "restarts_per_minute = 1000000\nback_off_millis = 0\nback_off_max_millis = 0\n";

/// The folder in which the files of the graphs are written, and from which they are launched.
#[derive(Debug)]
pub(crate) struct Home<'a> {
    ground: &'a Ground,
    folder: TempDir,
    graph: PathBuf,
    carrier: Carrier,
    /// Size of the shared memory, if it is limited \[MiB\].
    shared_memory: Option<u64>,
}

impl<'a> Home<'a> {
    /// Writes graph, scenario and faults, with the robot of `ground`.
    ///
    /// # Errors
    /// A sentence.
    pub(crate) fn new(
        ground: &'a Ground,
        carrier: Carrier,
        launch: &Launch,
        seed: u64,
    ) -> Result<Self, Trouble> {
        let folder = tempfile::Builder::new().prefix("cx").tempdir()?;
        let deploy = ground.deploy();
        let scenarios = deploy.join("scenarios");
        let scenario = if launch.driven == Driven::WaitingForGoals {
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
        if launch.driven == Driven::SerialBase {
            let port = firmware::port(folder.path());
            let _ = write!(
                text,
                "[driver]\nprogram = \"{DRIVER}\"\n[driver.settings]\nport = \"{}\"\n",
                port.display()
            );
        }
        let graph = folder.path().join("graph.toml");
        fs::write(&graph, text)?;
        Ok(Self { ground, folder, graph, carrier, shared_memory: launch.shared_memory_mebibytes })
    }

    /// Limits of the robot and the period.
    ///
    /// # Errors
    /// If a setting in a file is impossible.
    pub(crate) fn limits(&self) -> Result<Limits, Trouble> {
        Ok(Limits::of(&Assembly::read(&Options::of_graph(&self.graph))?))
    }

    /// The course of its robot.
    ///
    /// # Errors
    /// If a twin does not finish.
    pub(crate) fn course(&self) -> Result<&Course, Trouble> {
        self.ground.course()
    }

    /// The whole graph with its faults.
    ///
    /// # Errors
    /// If a setting in a file is impossible.
    pub(crate) fn assembly(&self) -> Result<Assembly, Trouble> {
        let faults = Some(self.folder.path().join("faults.toml"));
        Ok(Assembly::read(&Options { faults, ..Options::of_graph(&self.graph) })?)
    }

    /// Carrier of its links.
    pub(crate) fn carrier(&self) -> Carrier {
        self.carrier
    }

    /// The folder of its files.
    pub(crate) fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Launches the graph for `duration_s`, with the run directory `run`.
    ///
    /// # Errors
    /// If it cannot be started.
    pub(crate) fn launch(&self, run: &str, duration_s: f64) -> Result<Session, Trouble> {
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
    pub(crate) fn launch_beside(
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
    pub(crate) fn launch_on(
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
    pub(crate) fn output(&self, name: &str) -> String {
        fs::read_to_string(self.folder.path().join(format!("{name}.txt"))).unwrap_or_default()
    }

    /// What graphs have left behind after their end: files of the graphs in this folder, and shared
    /// memory of the graphs `names`.
    pub(crate) fn left_behind(&self, names: &[String]) -> Vec<String> {
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
    pub(crate) fn keep(self, folder: &Path) -> Result<(), Trouble> {
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
        let port = crate::port::free()?;
        let _ = writeln!(
            text,
            "[[connections]]\nhosts = [{one:?}, {other:?}]\naddress = \"127.0.0.1:{port}\""
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
pub(crate) fn permits_little_shared_memory() -> bool {
    let mut look = unshared();
    look.args(["mount", "-t", "tmpfs", "tmpfs", "/dev/shm"])
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    look.status().is_ok_and(|status| status.success())
}
