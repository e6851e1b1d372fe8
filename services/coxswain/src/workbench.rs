//! The commands that no robot needs: watch, certificates, drill, experiment, identify, learn and
//! model.

use certificates::CertificatesOptions;
use clap::Subcommand;
use coxswain::drive;
use drill::DrillOptions;
use drill::damage::OfferOptions;
use experiment::worlds::{self, WorldsOptions};
use experiment::{CompareOptions, ExperimentError, without_learning};
use graph::assembly::Assembly;
use identify::command::{IdentifyError, IdentifyOptions, Plan, identify};
use network::threads;
use offline::command::LearnOptions;
use offline::show::ShowOptions;
use process::Stop;
use runs::registry;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use supervisor::launch::Outcome;
use terminal::Terminal;
use viewer::{WatchError, WatchOptions};

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Show the state of a running robot, from any machine. It only reads and does not affect the
    /// robot, unless its key `k` begins to drive the robot by keyboard, on the robot's own machine.
    ///
    /// Exit code 0 if a key, a signal or closed output ended it, 2 if an option is invalid, 1 if
    /// there is nothing to watch.
    Watch(WatchOptions),
    /// Create a private authority and one short-lived certificate per role, for links that leave
    /// the machine.
    ///
    /// Exit code 0 if they were created, 2 if an option is invalid or a file exists already, 1 if
    /// the file system reports an error.
    Certificates(CertificatesOptions),
    /// Inject real faults into every part, and print their effects at the wheels.
    ///
    /// Exit code 0 if every promise held, 1 if one was broken or the drill failed, 2 if an option
    /// is invalid.
    Drill(DrillOptions),
    /// Offer damaged messages to decoders and gate, and print the results and this process's
    /// memory: a part of the drill.
    #[command(hide = true)]
    Offer(OfferOptions),
    /// Identify a robot from what it did, or drive it first: gain, time constant, dead time and
    /// friction with intervals, noise of the sensors, and a robot file.
    ///
    /// Exit code 0 if the robot file was written, 2 if an option or a log cannot be used, 1 if the
    /// drive failed or a file cannot be written. If a signal ends the drive, 128 plus its number.
    Identify(IdentifyOptions),
    /// Train a model from logs, with the code of the learner, and judge it on motion that was held
    /// out: the snapshot with which `coxswain launch --model` starts.
    ///
    /// Exit code 0 if the snapshot was written, 2 if an option or a log cannot be used, 1 if the
    /// model is no better than none, or the file cannot be written.
    Learn(LearnOptions),
    /// Show what a model has learned.
    #[command(subcommand)]
    Model(Model),
    /// Compare controllers in closed loops, in lock step and in one process.
    #[command(subcommand)]
    Experiment(Experiment),
}

#[derive(Debug, Subcommand)]
pub(crate) enum Model {
    /// Print kernel, hyperparameters and scores of a snapshot, and draw slices through it.
    ///
    /// Exit code 0 if it was shown, 2 if it cannot be used with this graph, 1 if the page cannot be
    /// written.
    Show(ShowOptions),
}

#[derive(Debug, Subcommand)]
pub(crate) enum Experiment {
    /// Run every controller in every scenario, for several seeds: a table, and one JSON row per
    /// trial.
    Compare(CompareOptions),
    /// Drive to a goal in worlds with discs that stand or move, and count collisions.
    Worlds(WorldsOptions),
}

/// Runs a command. Returns its exit code.
pub(crate) fn run(command: &Command) -> ExitCode {
    match command {
        Command::Watch(options) => watch(options),
        Command::Certificates(options) => certificates(options),
        Command::Drill(options) => drill(options),
        Command::Offer(options) => offer(options),
        Command::Identify(options) => identified(options),
        Command::Learn(options) => learn(options),
        Command::Model(Model::Show(options)) => show(options),
        Command::Experiment(Experiment::Compare(options)) => {
            experimented(experiment::compare(options))
        }
        Command::Experiment(Experiment::Worlds(options)) => experimented(worlds::worlds(options)),
    }
}

/// Makes the same run without learning, if the live page wants it.
pub(crate) fn without_learning(
    assembly: &Assembly,
    run: &Path,
) -> Result<Option<PathBuf>, Box<dyn Error>> {
    let wanted = without_learning::is_wanted(assembly);
    Ok(wanted.then(|| without_learning::run(assembly, run)).transpose()?)
}

fn watch(options: &WatchOptions) -> ExitCode {
    if let Err(error) = threads::set() {
        Terminal::new().say(format_args!("coxswain: the program cannot restart itself: {error}"));
        return ExitCode::FAILURE;
    }
    let (stop, mut terminal) = (Stop::new(), Terminal::new());
    let watched = stop.on_signals().map_err(WatchError::from);
    let base = registry::base();
    let join = |run: &Path| drive::join(run, &base);
    let watched = watched.and_then(|()| viewer::run(options, &base, &mut terminal, &stop, &join));
    match watched {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            terminal.say(format_args!("coxswain: {error}"));
            ExitCode::from(error.exit_code())
        }
    }
}

fn certificates(options: &CertificatesOptions) -> ExitCode {
    match certificates::run(options) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            Terminal::new().say(format_args!("coxswain: {error}"));
            ExitCode::from(error.exit_code())
        }
    }
}

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

fn offer(options: &OfferOptions) -> ExitCode {
    match drill::damage::print(options) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            Terminal::new().say(format_args!("coxswain: {error}"));
            ExitCode::FAILURE
        }
    }
}

fn identified(options: &IdentifyOptions) -> ExitCode {
    let refused = |error: &IdentifyError| {
        Terminal::new().say(format_args!("coxswain: {error}"));
        ExitCode::from(error.exit_code())
    };
    let (logs, robot) = match options.plan() {
        Ok(Plan::Logs(logs, robot)) => (logs, *robot),
        Ok(Plan::Prepared(instructions)) => {
            terminal::print(instructions);
            return ExitCode::SUCCESS;
        }
        Ok(Plan::Drive(drive)) => match supervisor::launch::run(&drive.options, without_learning) {
            Ok(Outcome::Finished) => (vec![options.out.join("run")], drive.robot),
            Ok(outcome) => return outcome.exit_code(),
            Err(error) => {
                Terminal::new().say(format_args!("coxswain: {error}"));
                return error.exit_code();
            }
        },
        Err(error) => return refused(&error),
    };
    identify(&logs, &options.topics, &robot, &options.out, options.drive.is_some())
        .map_or_else(|error| refused(&error), |()| ExitCode::SUCCESS)
}

fn learn(options: &LearnOptions) -> ExitCode {
    match offline::command::learn(options) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            Terminal::new().say(format_args!("coxswain: {error}"));
            ExitCode::from(error.exit_code())
        }
    }
}

fn show(options: &ShowOptions) -> ExitCode {
    match offline::show::show(options) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            Terminal::new().say(format_args!("coxswain: {error}"));
            ExitCode::from(error.exit_code())
        }
    }
}

fn experimented(result: Result<(), ExperimentError>) -> ExitCode {
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            Terminal::new().say(format_args!("coxswain: {error}"));
            ExitCode::from(error.exit_code())
        }
    }
}
