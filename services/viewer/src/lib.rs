//! `coxswain watch`: telemetry → the terminal view, or one line per period.
//!
//! With lines, each loss and each return of the robot is reported once, on the standard error.

pub mod dashboard;
mod presence;

use access::{Credentials, Role};
use clap::Args;
use network::telemetry::{Telemetry, TelemetryError, TelemetryMessage, Watcher};
use presence::Presence;
use process::Stop;
use protocol::message::{Exposure, Plan, PlantState, Reason};
use run_view::RunView;
use runs::registry;
use std::io::{self, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use teleop::steer::Join;
use terminal::Terminal;

/// Interval between checks of the stop request.
const PATIENCE: Duration = Duration::from_millis(100);

/// Wait before the next attempt to connect to a lost robot.
pub(crate) const RETRY: Duration = Duration::from_millis(200);

/// What to watch.
#[derive(Debug, Clone, Args)]
pub struct WatchOptions {
    /// Endpoint of a gateway, as tcp/127.0.0.1:7448; by default that of the graph that runs on this
    /// machine.
    pub endpoint: Option<String>,
    /// Only the robot of this name.
    #[arg(long, value_name = "NAME")]
    pub robot: Option<String>,
    /// Folder of certificates with a watcher's certificate, for a robot that requires one.
    #[arg(long, value_name = "DIR")]
    pub certificates: Option<PathBuf>,
    /// Print one line per period, for scripts, instead of the view on a terminal.
    #[arg(long)]
    pub plain: bool,
}

/// Why there is nothing to watch.
#[derive(Debug, thiserror::Error)]
pub enum WatchError {
    /// An option is invalid, or no gateway replies.
    #[error(transparent)]
    Telemetry(#[from] TelemetryError),
    /// No endpoint was given, and no gateway runs on this machine.
    #[error(
        "no graph with a gateway runs on this machine; \
         name an endpoint, as in `coxswain watch tcp/192.168.0.7:7448 --plain`"
    )]
    NothingRuns,
    /// No endpoint was given, and several gateways run on this machine.
    #[error("several graphs run on this machine; name one of {}", endpoints.join(", "))]
    SeveralRun {
        /// Their endpoints.
        endpoints: Vec<String>,
    },
    /// The output is a file or a pipe, or a terminal that cannot show the view.
    #[error(
        "the output is no terminal that could show the view; \
         `coxswain watch --plain` prints one line per period"
    )]
    NoTerminal,
    /// Reading from the terminal, writing to it or changing its mode failed.
    #[error(
        "the terminal cannot be used: {0}; `coxswain watch --plain` prints one line per period"
    )]
    Terminal(#[source] io::Error),
    /// The lines cannot be printed.
    #[error("the lines cannot be printed: {0}")]
    Print(#[from] io::Error),
}

impl WatchError {
    /// 2 if an option is invalid, else 1.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Telemetry(
                TelemetryError::Robot { .. }
                | TelemetryError::Endpoint { .. }
                | TelemetryError::Credentials { .. },
            )
            | Self::SeveralRun { .. }
            | Self::NoTerminal => 2,
            _ => 1,
        }
    }
}

/// The target: an endpoint, or any graph that runs on this machine.
#[derive(Debug, Clone)]
pub struct WatchTarget {
    endpoint: Option<String>,
    robot: Option<String>,
    credentials: Option<Credentials>,
    base: PathBuf,
}

impl WatchTarget {
    /// The target of `options`, with the graphs of this machine in `base`.
    pub fn new(options: &WatchOptions, base: &Path) -> Self {
        let credentials = options
            .certificates
            .as_ref()
            .map(|folder| Credentials::in_folder(folder.join(Role::Watcher.to_string())));
        Self {
            endpoint: options.endpoint.clone(),
            robot: options.robot.clone(),
            credentials,
            base: base.to_owned(),
        }
    }

    /// Connects to it; returns its endpoint too.
    ///
    /// # Errors
    /// [`WatchError`] if there is nothing to watch.
    pub fn open(&self) -> Result<(Watcher, String), WatchError> {
        let endpoint = self.endpoint.clone().map_or_else(|| find(&self.base), Ok)?;
        Ok((
            Watcher::open_as(&endpoint, self.robot.as_deref(), self.credentials.as_ref())?,
            endpoint,
        ))
    }

    /// Run directory of the graph on this machine whose gateway has `endpoint`.
    pub(crate) fn run_at(&self, endpoint: &str) -> Option<PathBuf> {
        let graphs = registry::living(&self.base);
        let is_there = |graph: &&registry::GraphEntry| {
            gateway::addresses::endpoints(&graph.root()).iter().any(|known| known == endpoint)
        };
        graphs.iter().find(is_there)?.run_folder()
    }
}

/// Shows the received telemetry on the terminal, or prints it as lines, until `stop` is requested
/// or the output is closed. On the terminal, keys can drive a robot that `join` can join.
///
/// # Errors
/// [`WatchError`] if there is nothing to watch at the start. Later it waits for a lost robot.
pub fn run(
    options: &WatchOptions,
    base: &Path,
    terminal: &mut Terminal,
    stop: &Stop,
    join: &Join<'_>,
) -> Result<(), WatchError> {
    let target = WatchTarget::new(options, base);
    if options.plain {
        return print(&target, &mut io::stdout(), terminal, stop);
    }
    if !io::stdout().is_terminal() || std::env::var_os("TERM").is_some_and(|kind| kind == "dumb") {
        return Err(WatchError::NoTerminal);
    }
    dashboard::run(target, stop, join)
}

/// Prints the received telemetry on `out`.
fn print(
    target: &WatchTarget,
    out: &mut impl Write,
    terminal: &mut Terminal,
    stop: &Stop,
) -> Result<(), WatchError> {
    let (mut watcher, mut endpoint) = target.open()?;
    let mut lines = Lines::default();
    let mut presence = Presence::expected(Instant::now());
    while !stop.requested() {
        // A failed session is opened again below.
        if let Ok(Some(telemetry)) = watcher.next(PATIENCE) {
            let is_state = matches!(telemetry.message, TelemetryMessage::State(_));
            if is_state && presence.receive(Instant::now(), telemetry.period_nanos) {
                terminal.say(format_args!("the robot {} at {endpoint} is back", telemetry.robot));
            }
            if let Some(line) = lines.complete_line(telemetry) {
                match writeln!(out, "{line}").and_then(|()| out.flush()) {
                    Err(error) if error.kind() == io::ErrorKind::BrokenPipe => return Ok(()),
                    printed => printed?,
                }
            }
            continue;
        }
        if presence.falls_silent(Instant::now()) {
            terminal.say(format_args!("no message from the robot at {endpoint}; waiting for it"));
        }
        if !watcher.is_connected() {
            match target.open() {
                Ok(again) => (watcher, endpoint) = again,
                Err(_) => std::thread::sleep(RETRY),
            }
        }
    }
    Ok(())
}

/// The endpoint of the one graph that can be watched on this machine.
fn find(base: &Path) -> Result<String, WatchError> {
    let graphs = registry::living(base);
    let mut endpoints: Vec<String> = graphs
        .iter()
        .filter_map(|graph| gateway::addresses::endpoints(&graph.root()).into_iter().next())
        .collect();
    match (endpoints.pop(), endpoints.is_empty()) {
        (Some(endpoint), true) => Ok(endpoint),
        (Some(endpoint), false) => {
            endpoints.push(endpoint);
            Err(WatchError::SeveralRun { endpoints })
        }
        (None, _) => Err(WatchError::NothingRuns),
    }
}

/// States and plans → lines. A line waits for the plan that answers its state, at most until the
/// next state. If unauthenticated peers have access, every line contains that.
#[derive(Debug, Default)]
struct Lines {
    waiting: Option<(PlantState, f64)>,
    run: RunView,
}

impl Lines {
    /// The line that is complete now, if there is one.
    fn complete_line(&mut self, telemetry: Telemetry) -> Option<String> {
        let line = self.line_of(telemetry)?;
        Some(match self.run.exposure() {
            Exposure::Closed => line,
            exposure => format!("{line}  INSECURE: {exposure}"),
        })
    }

    fn line_of(&mut self, telemetry: Telemetry) -> Option<String> {
        match telemetry.message {
            TelemetryMessage::State(state) => {
                let seconds = state.stamp.tick as f64 * telemetry.period_nanos as f64 * 1e-9;
                let before = self.waiting.replace((*state, seconds));
                before.map(|(state, seconds)| line(&state, seconds, None))
            }
            TelemetryMessage::Plan(plan) => {
                let answered = |(state, _): &mut (PlantState, f64)| {
                    state.stamp.epoch == plan.plant_epoch && state.stamp.tick == plan.stamp.tick
                };
                self.waiting
                    .take_if(answered)
                    .map(|(state, seconds)| line(&state, seconds, Some(&plan)))
            }
            TelemetryMessage::Health(health) => {
                self.run.receive_health(&health, Instant::now());
                None
            }
            TelemetryMessage::Goal(_) | TelemetryMessage::Obstacles(_) => None,
        }
    }
}

/// One period: the measurement, the fallback level before it, and the answer.
fn line(state: &PlantState, seconds: f64, plan: Option<&Plan>) -> String {
    let [x, y, yaw] = state.pose;
    let measured = format!(
        "tick {:6}  {seconds:8.2} s  x {x:8.3}  y {y:8.3}  yaw {yaw:7.3}",
        state.stamp.tick
    );
    let line = match plan {
        Some(plan) => format!(
            "{measured}  error {:6.3} m  {:<12}  model {:4}  tick time {:6.0} us",
            plan.position_error(),
            state.fallback_level().text(),
            plan.model_version,
            plan.tick_nanos as f64 * 1e-3
        ),
        None => format!(
            "{measured}  error      -    {:<12}  model    -  tick time      -   ",
            state.fallback_level().text()
        )
        .trim_end()
        .to_owned(),
    };
    match state.stop() {
        Reason::None => line,
        reason => format!("{line}  STOPPED: {reason}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use protocol::message::Participant;

    #[derive(Debug, Parser)]
    struct Arguments {
        #[command(flatten)]
        options: WatchOptions,
    }

    fn telemetry(message: TelemetryMessage) -> Telemetry {
        Telemetry { robot: "r".into(), period_nanos: 100_000_000, message }
    }

    fn state(tick: u64) -> PlantState {
        let mut state: PlantState = bytemuck::Zeroable::zeroed();
        (state.stamp.tick, state.stamp.epoch, state.fallback_level) = (tick, 1, 1);
        state
    }

    fn plan(tick: u64) -> TelemetryMessage {
        let mut plan: Box<Plan> = Box::new(bytemuck::Zeroable::zeroed());
        (plan.stamp.tick, plan.plant_epoch, plan.tick_nanos, plan.model_version) =
            (tick, 1, 412_300, 7);
        TelemetryMessage::Plan(plan)
    }

    #[test]
    fn a_line_waits_for_its_plan_but_not_beyond_the_next_state() {
        let mut lines = Lines::default();
        assert_eq!(
            lines.complete_line(telemetry(TelemetryMessage::State(Box::new(state(12))))),
            None
        );
        assert_eq!(lines.complete_line(telemetry(plan(11))), None, "the answer to another state");
        let answered = "tick     12      1.20 s  x    0.000  y    0.000  yaw   0.000  \
         error  0.000 m  fresh plan    model    7  tick time    412 us";
        assert_eq!(lines.complete_line(telemetry(plan(12))).as_deref(), Some(answered));
        assert_eq!(
            lines.complete_line(telemetry(TelemetryMessage::State(Box::new(state(13))))),
            None
        );
        let unanswered = "tick     13      1.30 s  x    0.000  y    0.000  yaw   0.000  \
         error      -    fresh plan    model    -  tick time      -";
        assert_eq!(
            lines.complete_line(telemetry(TelemetryMessage::State(Box::new(state(14))))).as_deref(),
            Some(unanswered)
        );
    }

    #[test]
    fn every_line_shows_the_exposure_once_a_process_has_reported_it() {
        let mut lines = Lines::default();
        let health = |who: Participant, exposure: Exposure| {
            let mut health: Box<protocol::message::Health> = Box::new(bytemuck::Zeroable::zeroed());
            (health.participant, health.exposure) = (who.code(), exposure.code());
            TelemetryMessage::Health(health)
        };
        let mut end = |message: TelemetryMessage| {
            lines.complete_line(telemetry(message));
            lines.complete_line(telemetry(TelemetryMessage::State(Box::new(state(12)))));
            lines.complete_line(telemetry(plan(12))).unwrap_or_default()
        };
        assert!(end(health(Participant::Plant, Exposure::Closed)).ends_with(" us"));
        assert!(
            end(health(Participant::Learner, Exposure::Watched))
                .ends_with(" us  INSECURE: strangers can watch")
        );
        assert!(
            end(health(Participant::Plant, Exposure::Driven))
                .ends_with(" us  INSECURE: strangers can drive")
        );
        assert!(
            end(health(Participant::Recorder, Exposure::Closed)).ends_with("drive"),
            "the plant still says so"
        );
        assert!(
            end(health(Participant::Plant, Exposure::Closed)).ends_with("watch"),
            "another launch has taken its place"
        );
    }

    #[test]
    fn lines_are_printed_only_on_request() {
        assert!(
            Arguments::try_parse_from(["watch"]).is_ok_and(|arguments| !arguments.options.plain)
        );
        assert!(
            Arguments::try_parse_from(["watch", "--plain"])
                .is_ok_and(|arguments| arguments.options.plain)
        );
    }

    #[test]
    fn without_exactly_one_running_gateway_an_endpoint_is_required()
    -> Result<(), Box<dyn std::error::Error>> {
        let base = tempfile::tempdir()?;
        assert!(matches!(find(base.path()), Err(WatchError::NothingRuns)));
        let entry = registry::GraphEntry::register(&base.path().join("b"))?;
        assert!(
            matches!(find(&base.path().join("b")), Err(WatchError::NothingRuns)),
            "a graph without gateway"
        );
        gateway::addresses::note(&entry.root(), &["tcp/127.0.0.1:1".to_owned()])?;
        assert_eq!(find(&base.path().join("b"))?, "tcp/127.0.0.1:1");
        let options = Arguments::parse_from(["watch"]).options;
        let target = WatchTarget::new(&options, &base.path().join("b"));
        entry.note_run(Path::new("/runs/1"))?;
        assert_eq!(target.run_at("tcp/127.0.0.1:1"), Some(PathBuf::from("/runs/1")));
        assert_eq!(target.run_at("tcp/192.168.0.7:1"), None, "a robot elsewhere is not driven");
        let other = registry::GraphEntry::register(&base.path().join("b"))?;
        gateway::addresses::note(&other.root(), &["tcp/127.0.0.1:2".to_owned()])?;
        assert!(matches!(
            find(&base.path().join("b")),
            Err(WatchError::SeveralRun { endpoints }) if endpoints.len() == 2
        ));
        entry.remove()?;
        other.remove()?;
        Ok(())
    }
}
