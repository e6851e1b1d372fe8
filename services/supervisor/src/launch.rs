//! One run, from reading its files to removing its remains.
//!
//! Everything is read and checked before any file or process is created. From then on every run
//! ends in the same order: first the robot, last the recorder, then the graph is removed from the
//! machine.

mod outcome;
mod told;

use crate::all_hosts;
#[cfg(feature = "faults")]
use crate::fault_injector::FaultInjector;
use crate::fleet::{Event, Fleet, RunContext};
use crate::progress;
use crate::service_manager::ServiceManager;
use crate::watch::Watch;
use graph::assembly::{Assembly, missing_programs};
use graph::file::Graph;
use graph::options::Options;
use process::{Pace, keep_to_user, log_filter, requests};
use protocol::message::Participant;
use runs::folder;
use runs::registry::{self, GraphEntry};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use std::error::Error;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::thread;
use std::time::{Duration, Instant};
use std::{env, io};
use terminal::Terminal;
use told::{conclude, heading, invite, within_reach};
use tracing_subscriber::Layer;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;
use transport::{HalfMade, claim};

pub use outcome::{LaunchError, Outcome};

/// Interval between two rounds of supervision.
const ROUND: Duration = Duration::from_millis(20);
/// Interval between two claims of shared memory that the processes have created since.
const CLAIMS_EVERY: Duration = Duration::from_millis(200);
/// Longest time for a process to stop after the request.
const ENDS_WITHIN: Duration = Duration::from_secs(5);
/// Longest time for the recorder to stop: it reads the whole record.
const RECORDER_ENDS_WITHIN: Duration = Duration::from_mins(2);

/// Makes the same run without learning for the live page, and returns its file in the run
/// directory; none if the page needs none.
pub type WithoutLearning = fn(&Assembly, &Path) -> Result<Option<PathBuf>, Box<dyn Error>>;

/// Launches a graph, supervises it, and stops it.
///
/// # Errors
/// [`LaunchError`]. No process is then left running, and nothing is left in shared memory.
pub fn run(options: &Options, without_learning: WithoutLearning) -> Result<Outcome, LaunchError> {
    keep_to_user();
    let graph: Graph = settings::read(&options.graph)?;
    if options.host.is_none() && !graph.hosts.is_empty() {
        return all_hosts::run(options, &graph);
    }
    let assembly = Assembly::read(options)?;
    let programs = programs_folder()?;
    let missing = missing_programs(assembly.roles().map(|role| assembly.program(role)), &programs);
    if !missing.is_empty() {
        return Err(LaunchError::MissingPrograms { programs: missing, folder: programs });
    }
    if let Some(out) = &options.out {
        folder::check(out)?;
    }
    let signals = Signals::new([SIGINT, SIGTERM, SIGHUP])
        .map_err(|source| LaunchError::System { what: "signals", source })?;
    let roles: Vec<Participant> = assembly.roles().collect();
    let manager = ServiceManager::of_environment(&roles)
        .map_err(|source| LaunchError::System { what: "NOTIFY_SOCKET", source })?;
    let mut person = Person { signals, terminal: Terminal::new(), manager };
    let base = registry::base();
    let (swept, left) = registry::sweep_stale(&base);
    if swept > 0 {
        person.terminal.say(format_args!("removed what {swept} killed launch(es) had left behind"));
    }
    for complaint in left {
        person.terminal.say(format_args!("a killed launch has left something behind: {complaint}"));
    }
    let entry = GraphEntry::register(&base)?;
    let outcome =
        run_at(&entry, assembly, programs, options.out.as_deref(), without_learning, &mut person);
    if let Err(complaint) = entry.remove() {
        person.terminal.say(format_args!("shared memory could not be cleaned up: {complaint}"));
    }
    outcome
}

/// Connections to the operator: signals request the end; the terminal shows messages; a service
/// manager receives the state in its own protocol.
#[derive(Debug)]
struct Person {
    signals: Signals,
    terminal: Terminal,
    manager: ServiceManager,
}

impl Person {
    /// The signal that has requested the end since the last call.
    fn asks_to_end(&mut self) -> Option<i32> {
        self.signals.pending().next()
    }
}

/// How a run ended, with one sentence for each process that did not stop correctly.
#[derive(Debug)]
struct Ended {
    outcome: Result<Outcome, LaunchError>,
    complaints: Vec<String>,
}

/// The run, from creating its directory to its last process, for a registered graph.
fn run_at(
    entry: &GraphEntry,
    mut assembly: Assembly,
    programs: PathBuf,
    out: Option<&Path>,
    without_learning: WithoutLearning,
    person: &mut Person,
) -> Result<Outcome, LaunchError> {
    let folder = folder::create(out, &assembly.scenario_name, entry.id())?;
    person.terminal.say(heading(&assembly));
    match &assembly.certificates {
        Some(certificates) => person.terminal.say(certificates),
        None => {
            if let Some(within) = within_reach(&assembly).filter(|_| assembly.exposed.is_empty()) {
                person.terminal.say(within);
            }
        }
    }
    for exposed in &assembly.exposed {
        person.terminal.say(format_args!("INSECURE: {exposed}"));
    }
    // Before the log is opened: the log belongs to the run itself.
    match without_learning(&assembly, &folder) {
        Ok(file) => assembly.without_learning = file,
        Err(error) => person
            .terminal
            .say(format_args!("the live page cannot show the run without learning: {error}")),
    }
    open_log(&folder, &assembly.log)?;
    for exposed in &assembly.exposed {
        tracing::warn!("insecure: {exposed}");
    }
    tracing::info!(
        graph = entry.id(),
        scenario = %assembly.scenario_name,
        learner = assembly.learns(),
        "launching"
    );
    let links = assembly.links(entry.id(), &entry.root());
    let context = RunContext { assembly, links, programs, folder };
    // From here on the run accepts requests to change its settings.
    requests::welcome(&context.folder).and_then(|()| entry.note_run(&context.folder)).map_err(
        |source| {
            let what = "the folder for requests during the run";
            LaunchError::System { what, source }
        },
    )?;
    let Ended { outcome, complaints } = run_processes(&context, person)?;
    conclude(&context, &mut person.terminal);
    let outcome = outcome?;
    if complaints.is_empty() { Ok(outcome) } else { Err(LaunchError::Ending { complaints }) }
}

/// Starts, supervises, and stops the processes.
fn run_processes(context: &RunContext, person: &mut Person) -> Result<Ended, LaunchError> {
    let mut fleet = Fleet::new(context)
        .map_err(|source| LaunchError::System { what: "the epochs of the run", source })?;
    let watch = Watch::open(&context.links)?;
    let outcome = match start(&mut fleet, context, person) {
        Ok(None) => {
            invite(context, &mut person.terminal);
            person.manager.ready();
            look_after(&mut fleet, context, &watch, person)
        }
        Ok(Some(outcome)) => Ok(outcome),
        Err(error) => Err(error),
    };
    match &outcome {
        Ok(Outcome::Finished) => tracing::info!("the plant has finished"),
        Ok(Outcome::Signal(signal)) => tracing::info!(signal, "stop requested"),
        Err(error) => tracing::error!("{error}"),
    }
    person.manager.stopping();
    let patience =
        |role| if role == Participant::Recorder { RECORDER_ENDS_WITHIN } else { ENDS_WITHIN };
    let complaints = fleet.end(patience, || person.asks_to_end().is_some());
    for complaint in &complaints {
        tracing::error!("{complaint}");
    }
    Ok(Ended { outcome, complaints })
}

/// Starts all processes, each after the one before is ready. Returns an outcome only if the run
/// ends before the robot drives.
fn start(
    fleet: &mut Fleet<'_>,
    context: &RunContext,
    person: &mut Person,
) -> Result<Option<Outcome>, LaunchError> {
    // A gateway only reads. In real time it starts in parallel to the others, and the launcher
    // waits for it while the robot drives. With certificates the launcher waits for it before that:
    // a gateway is ready only after its test that unauthenticated peers are rejected.
    let real_time = context.assembly.graph.pace == Pace::RealTime;
    let (beside, mut order): (Vec<_>, Vec<_>) =
        context.assembly.roles().partition(|&role| real_time && role == Participant::Gateway);
    for &role in &beside {
        fleet.start(role)?;
    }
    let place_of = |last: Participant| {
        order
            .iter()
            .position(|&role| role == last)
            .filter(|_| context.assembly.certificates.is_some())
    };
    // If the robot is on another machine, it does not move without a controller.
    let place = place_of(Participant::Plant)
        .or_else(|| place_of(Participant::Controller))
        .unwrap_or(order.len());
    order.splice(place..place, beside.iter().copied());
    for role in order {
        if !beside.contains(&role) {
            fleet.start(role)?;
        }
        let since = Instant::now();
        while !fleet.is_ready(role, since)? {
            if let Some(signal) = person.asks_to_end() {
                return Ok(Some(Outcome::Signal(signal)));
            }
            thread::sleep(ROUND / 4);
        }
        // The robot starts last: if memory is short, it has not moved.
        claim(&context.links)?;
    }
    Ok(None)
}

/// Restarts processes that end and shows the progress, until the plant has finished or the end is
/// requested.
fn look_after(
    fleet: &mut Fleet<'_>,
    context: &RunContext,
    watch: &Watch,
    person: &mut Person,
) -> Result<Outcome, LaunchError> {
    let scenario = &context.assembly.scenario;
    let (period_nanos, duration_s) = (scenario.period_nanos(), scenario.duration_s);
    #[cfg(feature = "faults")]
    let mut fault_injector = None;
    let mut claimed = Instant::now();
    let mut short = false;
    let mut reported = 0;
    let mut half_made = HalfMade::new(&context.links);
    loop {
        half_made.remove();
        if let Some(signal) = person.asks_to_end() {
            return Ok(Outcome::Signal(signal));
        }
        let (now, view) = (Instant::now(), watch.view());
        #[cfg(feature = "faults")]
        if fault_injector.is_none() && view.plan().is_some() {
            fault_injector = begin_faults(fleet, context)?;
        }
        if now.saturating_duration_since(claimed) >= CLAIMS_EVERY {
            claimed = now;
            match claim(&context.links) {
                Err(error) if !short => {
                    tracing::error!("{error}");
                    person.terminal.say(error);
                    short = true;
                }
                outcome => short = outcome.is_err(),
            }
        }
        for complaint in view.complaints().iter().skip(reported) {
            person.terminal.say(format_args!("controller: {complaint}"));
        }
        reported = view.complaints().len();
        watch.goals().iter().for_each(|goal| person.terminal.say(goal));
        for event in fleet.tend(&view, now)? {
            match event {
                Event::Finished => return Ok(Outcome::Finished),
                Event::Died { role, ending, wait } => {
                    tracing::warn!(%role, %ending, ?wait, "died");
                    let when = if wait.is_zero() { "now".into() } else { format!("in {wait:?}") };
                    person.terminal.say(format_args!(
                        "{role} ended with {ending}; it is started again {when}"
                    ));
                }
                Event::Hung { role, silence } => {
                    tracing::warn!(%role, ?silence, "hangs, and was killed");
                    person.terminal.say(format_args!(
                        "{role} has been silent for {:.1} s, and was killed",
                        silence.as_secs_f64()
                    ));
                }
                Event::GivenUp { role, ending } => {
                    tracing::error!(%role, %ending, "given up");
                    person.terminal.say(format_args!(
                        "{role} ended with {ending} too often; the run goes on without it"
                    ));
                }
                Event::NotStarted { role, trouble, wait } => {
                    tracing::error!(%role, trouble, ?wait, "cannot be started again");
                    let next = wait.map_or_else(
                        || "the run goes on without it".to_owned(),
                        |wait| format!("the next attempt is in {wait:?}"),
                    );
                    person
                        .terminal
                        .say(format_args!("{role} cannot be started again: {trouble}; {next}"));
                }
                Event::Restarted { role, epoch_floor } => {
                    tracing::info!(%role, epoch_floor, "started again");
                }
            }
        }
        person.manager.feed(|role| fleet.heartbeats(role), now);
        let restarts = fleet.restarts();
        person.terminal.progress(now, || {
            view.plan().map(|plan| progress::line(&plan, period_nanos, duration_s, restarts))
        });
        thread::sleep(ROUND);
    }
}

/// Begins the faults of processes, if there are any.
#[cfg(feature = "faults")]
fn begin_faults(
    fleet: &Fleet<'_>,
    context: &RunContext,
) -> Result<Option<FaultInjector>, LaunchError> {
    let faults = &context.assembly.faults;
    if faults.process.is_empty() {
        return Ok(None);
    }
    let period = Duration::from_nanos(context.assembly.scenario.period_nanos());
    let (roles, folder) = (fleet.processes_by_role(), &context.folder);
    FaultInjector::begin(&faults.process, faults.seed, period, roles, folder)
        .map(Some)
        .map_err(|source| LaunchError::System { what: "the list of injected faults", source })
}

/// All binaries are in the same directory.
fn programs_folder() -> Result<PathBuf, LaunchError> {
    let own = env::current_exe().map_err(|source| LaunchError::System {
        what: "the path of the launcher program",
        source,
    })?;
    Ok(own.parent().unwrap_or(Path::new("")).to_path_buf())
}

fn open_log(folder: &Path, filter: &str) -> Result<(), LaunchError> {
    let failed = |source| LaunchError::System { what: "the launcher's log", source };
    let file = File::options()
        .create(true)
        .append(true)
        .open(folder.join("coxswain.log"))
        .map_err(failed)?;
    let filter = log_filter(filter).map_err(|error| failed(io::Error::other(error)))?;
    // If a process makes a second run, as a test does, it keeps the log of the first.
    let lines = tracing_subscriber::fmt::layer().with_ansi(false).with_writer(Mutex::new(file));
    let _ = tracing_subscriber::registry().with(lines.with_filter(filter)).try_init();
    Ok(())
}
