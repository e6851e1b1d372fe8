//! The command `coxswain`.

#[cfg(feature = "workbench")]
use certificates::CertificatesOptions;
use clap::{Parser, Subcommand};
use coxswain::order::{self, OrderOptions};
use coxswain::records::{self, ExportOptions, RecordsError, ReportOptions};
use coxswain::router::RouterOptions;
use coxswain::set::{SetError, SetOptions};
#[cfg(feature = "workbench")]
use drill::DrillOptions;
#[cfg(feature = "workbench")]
use drill::damage::OfferOptions;
#[cfg(feature = "workbench")]
use experiment::CompareOptions;
#[cfg(feature = "workbench")]
use experiment::without_learning;
use gate::Order;
use graph::assembly::Assembly;
use graph::options::Options;
#[cfg(feature = "workbench")]
use network::threads;
#[cfg(feature = "workbench")]
use process::Stop;
use runs::registry;
use rustix::process::{Signal, getpid, kill_process, set_parent_process_death_signal};
use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::{io, thread};
use supervisor::launch::LaunchError;
use terminal::Terminal;
#[cfg(feature = "workbench")]
use viewer::{WatchError, WatchOptions};

/// Learning model predictive control for omnidirectional robots, as a graph of processes.
#[derive(Debug, Parser)]
#[command(version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Start the processes of a graph, supervise them, and stop them.
    ///
    /// Exit code 0 if the run has finished, 128 plus the signal's number if a signal ended it. Exit
    /// code 2 if a setting is invalid and nothing was started, 1 if anything failed.
    Launch(Options),
    #[cfg(feature = "workbench")]
    /// Show the state of a running robot, from any machine. It only reads and does not affect the
    /// robot.
    ///
    /// Exit code 0 if a key, a signal or closed output ended it, 2 if an option is invalid, 1 if
    /// there is nothing to watch.
    Watch(WatchOptions),
    #[cfg(feature = "workbench")]
    /// Create a private authority and one short-lived certificate per role, for links that leave
    /// the machine.
    ///
    /// Exit code 0 if they were created, 2 if an option is invalid or a file exists already, 1 if
    /// the file system reports an error.
    Certificates(CertificatesOptions),
    /// Print the configuration of a zenoh router at which the hosts of a graph meet.
    ///
    /// Exit code 2 if the graph file or the certificate cannot be used.
    Router(RouterOptions),
    #[cfg(feature = "workbench")]
    /// Inject real faults into every part, and print their effects at the wheels.
    ///
    /// Exit code 0 if every promise held, 1 if one was broken or the drill failed, 2 if an option
    /// is invalid.
    Drill(DrillOptions),
    #[cfg(feature = "workbench")]
    /// Offer damaged messages to decoders and gate, and print the results and this process's
    /// memory: a part of the drill.
    #[command(hide = true)]
    Offer(OfferOptions),
    /// Change settings while the robot drives, on its own machine. All changes of one command take
    /// effect at the same tick, or none does.
    ///
    /// Keys: mpc.weights, mpc.state_limits, mpc.horizon_steps, mpc.control_horizon_steps,
    /// mpc.budget_share, mpc.solver, reference, learner.every_ticks, learner.evaluations_max. The
    /// record contains each change with its user and time.
    ///
    /// Exit code 0 if the change is in use, 2 if it was rejected, 1 if there is no process to
    /// change.
    Set(SetOptions),
    /// Let a robot that the gate has stopped drive again, on its own machine. Look at the robot
    /// first.
    ///
    /// A stop is latched: it outlasts a restarted controller and ends only by this order. The
    /// launch, the live page and `coxswain watch` show its reason. The record contains the user and
    /// the time of the order.
    ///
    /// Exit code 0 if the gate is armed, 2 if the plant rejects the order, 1 if there is no run to
    /// order. The plant rejects the order if it has not stopped.
    Resume(OrderOptions),
    /// Arm the gate of a plant that started disarmed (`armed = false` in the graph file), on its
    /// own machine.
    ///
    /// Exit code 0 if the gate is armed, 2 if the plant rejects the order, 1 if there is no run to
    /// order.
    Arm(OrderOptions),
    /// Create one page with all figures of a run, or of several runs in the same figures.
    ///
    /// Exit code 2 if there is no record to read, 1 if the page cannot be written.
    Report(ReportOptions),
    /// Write a record as tables: one CSV file per topic.
    ///
    /// Exit code 2 if there is no record to read or the folder is not empty, 1 if a table cannot be
    /// written.
    Export(ExportOptions),
    #[cfg(feature = "workbench")]
    /// Compare controllers in closed loops, in lock step and in one process.
    #[command(subcommand)]
    Experiment(Experiment),
}

#[cfg(feature = "workbench")]
#[derive(Debug, Subcommand)]
enum Experiment {
    /// Run every controller in every scenario, for several seeds: a table, and one JSON row per
    /// trial.
    Compare(CompareOptions),
}

fn main() -> ExitCode {
    match Arguments::parse().command {
        Command::Launch(options) => launch(&options),
        #[cfg(feature = "workbench")]
        Command::Watch(options) => watch(&options),
        #[cfg(feature = "workbench")]
        Command::Certificates(options) => certificates(&options),
        Command::Router(options) => router(&options),
        #[cfg(feature = "workbench")]
        Command::Drill(options) => drill(&options),
        #[cfg(feature = "workbench")]
        Command::Offer(options) => offer(&options),
        Command::Set(options) => set(coxswain::set::run(&options, &registry::base())),
        Command::Resume(options) => set(order::run(Order::Resume, &options, &registry::base())),
        Command::Arm(options) => set(order::run(Order::Arm, &options, &registry::base())),
        Command::Report(options) => made(records::report(&options)),
        Command::Export(options) => made(records::export(&options)),
        #[cfg(feature = "workbench")]
        Command::Experiment(Experiment::Compare(options)) => compare(&options),
    }
}

#[cfg(feature = "workbench")]
fn certificates(options: &CertificatesOptions) -> ExitCode {
    match certificates::run(options) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            Terminal::new().say(format_args!("coxswain: {error}"));
            ExitCode::from(error.exit_code())
        }
    }
}

fn router(options: &RouterOptions) -> ExitCode {
    match coxswain::router::configuration(options) {
        Ok(configuration) => {
            terminal::print(format_args!("{configuration:#}"));
            ExitCode::SUCCESS
        }
        Err(error) => {
            Terminal::new().say(format_args!("coxswain: {error}"));
            ExitCode::from(2)
        }
    }
}

fn set(outcome: Result<(), SetError>) -> ExitCode {
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            Terminal::new().say(format_args!("coxswain: {error}"));
            ExitCode::from(error.exit_code())
        }
    }
}

fn made(outcome: Result<(), RecordsError>) -> ExitCode {
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            Terminal::new().say(format_args!("coxswain: {error}"));
            ExitCode::from(error.exit_code())
        }
    }
}

#[cfg(feature = "workbench")]
fn compare(options: &CompareOptions) -> ExitCode {
    match experiment::compare(options) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            Terminal::new().say(format_args!("coxswain: {error}"));
            ExitCode::from(error.exit_code())
        }
    }
}

#[cfg(feature = "workbench")]
fn offer(options: &OfferOptions) -> ExitCode {
    match drill::damage::print(options) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            Terminal::new().say(format_args!("coxswain: {error}"));
            ExitCode::FAILURE
        }
    }
}

#[cfg(feature = "workbench")]
fn drill(options: &DrillOptions) -> ExitCode {
    match drill::run(options) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            Terminal::new().say(format_args!("coxswain: {error}"));
            error.exit_code()
        }
    }
}

fn launch(options: &Options) -> ExitCode {
    let watched = if options.stop_with_stdin { end_with_stdin() } else { Ok(()) };
    let outcome = watched
        .map_err(|source| LaunchError::System { what: "the standard input", source })
        .and_then(|()| supervisor::launch::run(options, without_learning));
    match outcome {
        Ok(outcome) => outcome.exit_code(),
        Err(error) => {
            Terminal::new().say(format_args!("coxswain: {error}"));
            error.exit_code()
        }
    }
}

#[cfg(feature = "workbench")]
fn without_learning(assembly: &Assembly, run: &Path) -> Result<Option<PathBuf>, Box<dyn Error>> {
    let wanted = without_learning::is_wanted(assembly);
    Ok(wanted.then(|| without_learning::run(assembly, run)).transpose()?)
}

/// On a robot no run is simulated for comparison.
#[cfg(not(feature = "workbench"))]
#[expect(clippy::unnecessary_wraps, reason = "the supervisor takes a function that can fail")]
fn without_learning(_: &Assembly, _: &Path) -> Result<Option<PathBuf>, Box<dyn Error>> {
    Ok(None)
}

/// Requests the end of this process, as a signal does, when its standard input ends.
fn end_with_stdin() -> io::Result<()> {
    // A stopped (SIGSTOP) process would not see the end of its input: the signal at its parent's
    // end wakes it.
    set_parent_process_death_signal(Some(Signal::CONT))?;
    let watch = || {
        let _ = io::copy(&mut io::stdin().lock(), &mut io::sink());
        let _ = kill_process(getpid(), Signal::TERM);
    };
    thread::Builder::new().name("stdin".into()).spawn(watch).map(drop)
}

#[cfg(feature = "workbench")]
fn watch(options: &WatchOptions) -> ExitCode {
    if let Err(error) = threads::set() {
        Terminal::new().say(format_args!("coxswain: the program cannot restart itself: {error}"));
        return ExitCode::FAILURE;
    }
    let (stop, mut terminal) = (Stop::new(), Terminal::new());
    let watched = stop.on_signals().map_err(WatchError::from);
    let watched =
        watched.and_then(|()| viewer::run(options, &registry::base(), &mut terminal, &stop));
    match watched {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            terminal.say(format_args!("coxswain: {error}"));
            ExitCode::from(error.exit_code())
        }
    }
}
