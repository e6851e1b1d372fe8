//! A graph with several hosts on this machine: one launch per host, as on separate machines. Their
//! bridges meet on the loopback.

use crate::child::Ending;
use crate::launch::{LaunchError, Outcome};
use graph::file::Graph;
use graph::options::Options;
use protocol::message::Participant;
use runs::{folder, utc};
use rustix::process::{Pid, Signal, kill_process};
use settings::SettingsError;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use std::env;
use std::io::{self, BufRead, BufReader, Read};
use std::net::TcpListener;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;
use std::time::{Duration, Instant, SystemTime};
use terminal::Terminal;

/// Interval between two looks at the launches.
const ROUND: Duration = Duration::from_millis(20);

/// Time for the other hosts to end by themselves after that of the plant.
const ENDS_WITHIN: Duration = Duration::from_secs(10);

/// The launch of one host. It does not outlive this value.
struct HostLaunch {
    host: String,
    has_plant: bool,
    child: Child,
    ending: Option<Ending>,
    is_asked: bool,
}

/// Launches all hosts of `graph`, prints what they print, and ends them together.
///
/// # Errors
/// [`LaunchError`] of the first host that did not end correctly.
pub fn run(options: &Options, graph: &Graph) -> Result<Outcome, LaunchError> {
    let system = |what| move |source| LaunchError::System { what, source };
    if let Some((host, _)) = options.addresses.first() {
        return Err(LaunchError::Settings(SettingsError::Value {
            file: options.graph.clone(),
            line: None,
            key: "--address".to_owned(),
            value: Some(format!("\"{host}\"")),
            expected: "--host NAME beside it: without it all hosts meet on the loopback".to_owned(),
        }));
    }
    let mut signals = Signals::new([SIGINT, SIGTERM, SIGHUP]).map_err(system("signals"))?;
    let name = utc::utc(SystemTime::now());
    let out = options.out.clone().unwrap_or_else(|| {
        Path::new("runs").join(format!("{name}-{}-{}", graph.name, std::process::id()))
    });
    folder::check(&out)?;
    let ports = free_ports(graph.connections.len()).map_err(system("a free port"))?;
    let (print, printed) = channel();
    let mut launches = Vec::new();
    for (host, table) in graph.hosts.iter().filter(|(_, table)| !table.driver) {
        let mut command = command(options, host, &out).map_err(system("the launcher program"))?;
        for (connection, port) in graph.connections.iter().zip(&ports) {
            // A router is where the graph file says.
            if let Some(other) = connection.other(host).filter(|_| connection.router.is_none()) {
                command.arg("--address").arg(format!("{other}=127.0.0.1:{port}"));
            }
        }
        let mut child = command.spawn().map_err(system("the launch of a host"))?;
        follow(host, child.stdout.take(), &print);
        follow(host, child.stderr.take(), &print);
        let has_plant = table.participants().contains(&Participant::Plant);
        launches.push(HostLaunch {
            host: host.clone(),
            has_plant,
            child,
            ending: None,
            is_asked: false,
        });
    }
    drop(print);
    supervise(&mut launches, &mut signals, &printed)
}

/// Waits for the end of all launches. A signal, or the failure of any of them, ends the others.
fn supervise(
    launches: &mut [HostLaunch],
    signals: &mut Signals,
    printed: &Receiver<String>,
) -> Result<Outcome, LaunchError> {
    let mut terminal = Terminal::new();
    let (mut outcome, mut failed, mut finished) = (Outcome::Finished, None, None::<Instant>);
    while launches.iter().any(|launch| launch.ending.is_none()) {
        if let Some(signal) = signals.pending().next() {
            outcome = Outcome::Signal(signal);
            // The second signal ends them at once.
            launches.iter_mut().for_each(HostLaunch::ask_to_end);
        }
        for index in 0..launches.len() {
            let Some(launch) = launches.get_mut(index) else { continue };
            if launch.ending.is_some() {
                continue;
            }
            let status = launch.child.try_wait();
            let status = status
                .map_err(|source| LaunchError::System { what: "the launch of a host", source })?;
            let Some(ending) = status.map(Ending::from) else { continue };
            launch.ending = Some(ending);
            let is_over = outcome != Outcome::Finished || failed.is_some() || launch.is_asked;
            if !ending.is_success() && !is_over {
                failed = Some(LaunchError::Host { host: launch.host.clone(), ending });
            }
            if ending.is_success() && launch.has_plant {
                finished = Some(Instant::now());
            }
            if !ending.is_success() {
                let others = launches.iter_mut().filter(|launch| !launch.is_asked);
                others.for_each(HostLaunch::ask_to_end);
            }
        }
        // The other hosts learn of the plant's end by themselves, and end in order.
        if finished.is_some_and(|since| since.elapsed() > ENDS_WITHIN) {
            let others = launches.iter_mut().filter(|launch| !launch.is_asked);
            others.for_each(HostLaunch::ask_to_end);
        }
        while let Ok(line) = printed.try_recv() {
            terminal.say(line);
        }
        thread::sleep(ROUND);
    }
    while let Ok(line) = printed.recv() {
        terminal.say(line);
    }
    failed.map_or(Ok(outcome), Err)
}

impl HostLaunch {
    fn ask_to_end(&mut self) {
        self.is_asked = true;
        if self.ending.is_none() {
            let _ = kill_process(Pid::from_child(&self.child), Signal::TERM);
        }
    }
}

impl Drop for HostLaunch {
    fn drop(&mut self) {
        // Its own end ends its processes as well: it sees the end of its input.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Loopback ports that are free at the moment, all different.
fn free_ports(count: usize) -> io::Result<Vec<u16>> {
    let listeners: Vec<TcpListener> =
        (0..count).map(|_| TcpListener::bind("127.0.0.1:0")).collect::<io::Result<_>>()?;
    listeners.iter().map(|listener| Ok(listener.local_addr()?.port())).collect()
}

/// This program for one host, with the same options.
fn command(options: &Options, host: &str, out: &Path) -> io::Result<Command> {
    let Options { graph, scenario, robot, duration, pace, learner, log, seed, .. } = options;
    let mut command = Command::new(env::current_exe()?);
    command.arg("launch").arg(graph).args(["--host", host, "--stop-with-stdin"]);
    command.arg("--out").arg(out.join(host)).arg("--log").arg(log);
    let files: &[(&str, &Option<PathBuf>)] = &[
        ("--scenario", scenario),
        ("--robot", robot),
        ("--model", &options.model),
        ("--certificates", &options.certificates),
        #[cfg(feature = "faults")]
        ("--faults", &options.faults),
    ];
    for (option, file) in files {
        if let Some(file) = file {
            command.arg(option).arg(file);
        }
    }
    let learner = learner.map(|learner| if learner { "on" } else { "off" }.to_owned());
    for (option, value) in [
        ("--duration", duration.map(|seconds| seconds.to_string())),
        ("--pace", pace.map(|pace| pace.name().to_owned())),
        ("--learner", learner),
        ("--seed", seed.map(|seed| seed.to_string())),
    ] {
        if let Some(value) = value {
            command.args([option, &value]);
        }
    }
    if options.insecure {
        command.arg("--insecure");
    }
    // Ctrl-C in a terminal reaches this program alone, which ends them in order.
    command.process_group(0).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    Ok(command)
}

/// Passes the lines of a launch on, with the name of its host.
fn follow(host: &str, output: Option<impl Read + Send + 'static>, print: &Sender<String>) {
    let Some(output) = output else { return };
    let (host, print) = (host.to_owned(), print.clone());
    thread::spawn(move || {
        for line in BufReader::new(output).lines().map_while(Result::ok) {
            if print.send(format!("{host}: {line}")).is_err() {
                return;
            }
        }
    });
}
