//! How long a robot waits for the answer to a state, end to end. Measures a real controller process
//! of a real launch, on this host and on another one, beside the bare library's round trip between
//! two processes. A state and a bare round alternate. The two hosts use certificates, and so does
//! the bare library.
//!
//! `cargo bench -p promises --bench state_to_command`
#![expect(clippy::print_stdout, reason = "figures are what a bench is for")]

#[path = "state_to_command/bare.rs"]
mod bare;
#[path = "../../services/transport/benches/round_trip/ends.rs"]
mod ends;
#[path = "state_to_command/lock_step.rs"]
mod lock_step;

use bare::Echo;
use bytemuck::Zeroable;
use network::threads;
use process::{PRIORITY, go_first, read_settings};
use promises::{Launched, Outcome, binaries, graph_with, launch_command};
use protocol::clock::monotonic_nanos;
use protocol::message::{Command, Message, Plan, PlantState};
use protocol::wire;
use std::collections::BTreeMap;
use std::error::Error;
use std::path::Path;
use std::thread;
use std::time::Duration;
use transport::{Identity, Links, Ports, Since, Sink, Source};

type Failure = Box<dyn Error + Send + Sync>;

/// Longer than any answer takes.
const LONG: Duration = Duration::from_secs(10);
/// Number of answered states, and of the first ones that do not count.
const TICKS: u64 = 1500;
const WARM_UP: u64 = 100;
/// T, and the delay of the bare round after the answer.
const PERIOD: Duration = Duration::from_millis(20);
const APART: Duration = Duration::from_millis(5);

fn main() -> Result<(), Failure> {
    threads::set()?;
    let arguments: Vec<String> = std::env::args().collect();
    if let Some(place) = arguments.iter().position(|argument| argument == "--echo") {
        return bare::answer(arguments.get(place + 1..).unwrap_or_default());
    }
    if let Some(place) = arguments.iter().position(|argument| argument == "--controller") {
        return lock_step::answer(Path::new(arguments.get(place + 1).ok_or("no settings")?));
    }
    for graph in [LOCAL, TWO_HOSTS] {
        measure(graph)?;
    }
    println!(
        "{TWO_HOSTS:9} lock step with nothing to compute: {:.0} ticks/s",
        lock_step::ticks_per_s()?
    );
    Ok(())
}

/// The graphs.
const LOCAL: &str = "local";
const TWO_HOSTS: &str = "two-hosts";

/// A launch without a robot: this bench is the robot. Returns the links of the robot's host. In
/// lock step there is no controller either.
fn launch(graph: &str, lock_step: bool) -> Result<(Launched, Links), Box<dyn Error>> {
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    let without = ["plant", "learner", "recorder", "controller"];
    let without = &without[..if lock_step { 4 } else { 3 }];
    let off = |role: &&str| format!("[processes.{role}]\nenabled = false\n");
    let alone = without.iter().map(off).collect::<Vec<_>>().concat();
    let file = graph_with(graph, &alone, home.path())?;
    let mut options = vec!["--scenario", "paper-20ms", "--duration", "600"];
    let certificates = home.path().join("certificates");
    let certificates = certificates.to_string_lossy();
    let (controller, robot) = if graph == TWO_HOSTS {
        issue(graph, &certificates)?;
        options.extend(["--certificates", &certificates]);
        ("control/controller", "robot/settings/bridge.toml")
    } else {
        ("controller", "settings/controller.toml")
    };
    if lock_step {
        options.extend(["--pace", "lock-step"]);
    }
    let command = launch_command(&file, &home.path().join("run"), &options)?;
    let launched = Launched::by(command, home)?;
    if graph == TWO_HOSTS {
        for host in ["robot", "control"] {
            launched.wait_for_log(&format!("{host}/bridge"), "connected", 1)?;
        }
    }
    if !lock_step {
        launched.wait_for_log(controller, "settings=", 1)?;
    }
    let robot = launched.folder().join(robot);
    let links = if graph == TWO_HOSTS {
        read_settings::<bridge::settings::Settings>(&robot)?.run.links
    } else {
        read_settings::<controller::Settings>(&robot)?.run.links
    };
    Ok((launched, links))
}

/// Certificates of the hosts of `graph`.
fn issue(graph: &str, folder: &str) -> Outcome {
    let coxswain = binaries()?.join("coxswain");
    let issued = std::process::Command::new(coxswain)
        .args(["certificates", "--robot", graph, "--out", folder])
        .output()?;
    if issued.status.success() { Ok(()) } else { Err(format!("{issued:?}").into()) }
}

fn measure(graph: &str) -> Result<(), Failure> {
    let (launched, links) = launch(graph, false).map_err(|error| error.to_string())?;
    go_first(PRIORITY);
    let ports = Ports::open(&links, Identity::new(1))?;
    let mut robot = Robot {
        states: ports.sink()?,
        commands: ports.source(Since::First)?,
        state: PlantState::zeroed(),
    };
    let mut plans: Source<Plan> = ports.watcher()?;
    let mut encoded = Vec::new();
    wire::encode(&Command::zeroed(), &mut encoded);
    let echo = if graph == TWO_HOSTS {
        Echo::of_zenoh(&launched.home().join("certificates"), encoded.len())?
    } else {
        Echo::of_iceoryx2(launched.home(), Command::zeroed().byte_len())?
    };
    let (mut waited, mut bare, mut computed) = (BTreeMap::new(), Vec::new(), BTreeMap::new());
    // A controller that is not connected yet receives nothing.
    while robot.drive(Duration::from_millis(100))?.is_none() {}
    for _ in 0..TICKS {
        let begin = monotonic_nanos();
        let nanos = robot.drive(LONG)?.ok_or("no answer")?;
        waited.insert(robot.state.stamp.tick, nanos);
        thread::sleep(APART);
        bare.push(echo.round()?);
        while let Some(plan) = plans.next()? {
            computed.insert(plan.stamp.tick, plan.tick_nanos);
        }
        thread::sleep(PERIOD.saturating_sub(Duration::from_nanos(monotonic_nanos() - begin)));
    }
    let counted = || waited.iter().skip(WARM_UP as usize);
    let solved: Vec<u64> = counted().filter_map(|(tick, _)| computed.get(tick).copied()).collect();
    let beyond: Vec<u64> = counted()
        .filter_map(|(tick, nanos)| Some(nanos.saturating_sub(*computed.get(tick)?)))
        .collect();
    let bare = percentiles(bare.into_iter().skip(WARM_UP as usize).collect());
    let beyond = percentiles(beyond);
    for (what, [p50, p99]) in [
        ("state to command", percentiles(counted().map(|(_, nanos)| *nanos).collect())),
        ("of it, the controller's tick", percentiles(solved)),
        ("of it, the way", beyond),
        ("bare round trip", bare),
    ] {
        println!("{graph:9} {what:30} p50 {p50:7.1} µs  p99 {p99:7.1} µs");
    }
    println!("{graph:9} way / bare round trip: {:.2}", beyond[0] / bare[0]);
    Ok(())
}

/// Median and 99th percentile \[µs\].
fn percentiles(mut nanos: Vec<u64>) -> [f64; 2] {
    nanos.sort_unstable();
    [50, 99].map(|percent| {
        nanos.get(nanos.len() * percent / 100).map_or(f64::NAN, |&nanos| nanos as f64 * 1e-3)
    })
}

/// A robot that follows each command at once.
struct Robot {
    states: Sink<PlantState>,
    commands: Source<Command>,
    state: PlantState,
}

impl Robot {
    /// Publishes the next state, and waits for its answer. Returns the waiting time \[ns\], if the
    /// answer arrived within `patience`.
    fn drive(&mut self, patience: Duration) -> Result<Option<u64>, Failure> {
        self.state.stamp.tick += 1;
        let tick = self.state.stamp.tick;
        self.state.fallback_level = protocol::message::FallbackLevel::FreshPlan.code();
        let begin = monotonic_nanos();
        self.states.send(&mut self.state)?;
        while self.commands.wait(patience)? {
            let Some(command) =
                self.commands.latest()?.filter(|command| command.stamp.tick == tick)
            else {
                continue;
            };
            let nanos = monotonic_nanos() - begin;
            self.obey(&command);
            return Ok(Some(nanos));
        }
        Ok(None)
    }

    fn obey(&mut self, command: &Command) {
        let seconds = PERIOD.as_secs_f64();
        let (sin, cos) = self.state.pose[2].sin_cos();
        let [forward, left, yaw] = command.input;
        for (pose, rate) in self.state.pose.iter_mut().zip([
            cos * forward - sin * left,
            sin * forward + cos * left,
            yaw,
        ]) {
            *pose += seconds * rate;
        }
        (self.state.velocity, self.state.input) = (command.input, command.input);
        let epoch = command.stamp.epoch;
        (self.state.controller_epoch, self.state.accepted_epoch, self.state.accepted_tick) =
            (epoch, epoch, command.stamp.tick);
    }
}

/// The folder of the bare library's files, below a launch's home.
fn bare_folder(home: &Path) -> std::path::PathBuf {
    home.join("bare")
}
