//! The command `coxswain`.

#[cfg(feature = "workbench")]
mod workbench;

use clap::{Parser, Subcommand};
use coxswain::drive::{self, DriveError, DriveOptions};
use coxswain::goal::{self, FollowOptions, GoOptions, GoalError, GoalOptions};
use coxswain::joined::JoinError;
use coxswain::order::{self, OrderOptions};
use coxswain::records::{self, ExportOptions, RecordsError, ReportOptions};
use coxswain::router::RouterOptions;
use coxswain::set::{self, SetError, SetOptions};
use coxswain::status::{self, StatusOptions};
use gate::Order;
use graph::options::Options;
use runs::registry;
use rustix::process::{Signal, getpid, kill_process, set_parent_process_death_signal};
use std::fmt::Display;
use std::path::Path;
use std::process::ExitCode;
use std::{io, thread};
use supervisor::launch::{LaunchError, WithoutLearning};
use terminal::Terminal;

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
    /// Print the configuration of a zenoh router at which the hosts of a graph meet.
    ///
    /// Exit code 2 if the graph file or the certificate cannot be used.
    Router(RouterOptions),
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
    /// Stop the robot, on its own machine: it brakes along the ramp of its robot file, and stands
    /// until `coxswain resume`. The gate does it, also when the controller is dead.
    ///
    /// This is no emergency stop: that belongs between battery and wheels.
    ///
    /// Exit code 0 if the gate has stopped, 1 if there is no run to stop or the plant does not
    /// reply, 2 in lock step, which takes no orders.
    Stop(OrderOptions),
    /// Drive to a pose, by the shorter turn, and stand there.
    ///
    /// The motion begins from the present one without a jump; a later goal takes its place in the
    /// same way. While the gate is shut, the goal waits. Ctrl-C ends this command, not the goal.
    ///
    /// Exit code 0 if the robot stands there (with --no-wait: if the goal was accepted), 2 if the
    /// controller rejects it, 1 if the goal ended before, or there is no run.
    Go(GoOptions),
    /// Come to a standstill within the limits, and hold the place. Exit codes as for `go`.
    Hold(GoalOptions),
    /// Drive along a path from a CSV file, as fast as speeds and accelerations allow. Exit codes as
    /// for `go`.
    Follow(FollowOptions),
    /// Drive with a body velocity for a time, then stand still; or drive by keyboard.
    ///
    /// Without a velocity the keys of this terminal drive the robot: w, a, s, d or the arrows, q and
    /// e to turn, space to stand, x for a latched stop, + and - for the speed, Esc to end. A key
    /// acts for the dead-man time; hold it to drive on. Without a key the robot brakes, also if the
    /// terminal, this command or the network dies.
    ///
    /// Exit codes as for `go`. By keyboard: 0 if a key or a signal ended it, 2 if an argument is
    /// invalid or the input is no terminal, 1 if the launch ended, there is no run, or no session
    /// with --at.
    Drive(DriveOptions),
    /// Print what the robot does now: gate, pose, controller and goal.
    ///
    /// Exit code 0, or 1 if there is no run to ask.
    Status(StatusOptions),
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
    #[command(flatten)]
    Workbench(workbench::Command),
}

fn main() -> ExitCode {
    let base = registry::base();
    match Arguments::parse().command {
        Command::Launch(options) => launch(&options),
        Command::Router(options) => router(&options),
        Command::Set(options) => ended(set::run(&options, &base), SetError::exit_code),
        Command::Arm(options) => order(Order::Arm, &options, &base),
        Command::Resume(options) => order(Order::Resume, &options, &base),
        Command::Stop(options) => order(Order::Stop, &options, &base),
        Command::Go(options) => ended(goal::go(&options, &base), GoalError::exit_code),
        Command::Hold(options) => ended(goal::hold(&options, &base), GoalError::exit_code),
        Command::Follow(options) => ended(goal::follow(&options, &base), GoalError::exit_code),
        Command::Drive(options) => ended(drive::run(&options, &base), DriveError::exit_code),
        Command::Status(options) => ended(status::run(&options, &base), JoinError::exit_code),
        Command::Report(options) => ended(records::report(&options), RecordsError::exit_code),
        Command::Export(options) => ended(records::export(&options), RecordsError::exit_code),
        #[cfg(feature = "workbench")]
        Command::Workbench(command) => workbench::run(&command),
    }
}

fn router(options: &RouterOptions) -> ExitCode {
    let printed = coxswain::router::configuration(options)
        .map(|configuration| terminal::print(format_args!("{configuration:#}")));
    ended(printed, |_| 2)
}

fn order(order: Order, options: &OrderOptions, base: &Path) -> ExitCode {
    ended(order::run(order, options, base), SetError::exit_code)
}

/// Ends a command: says its error, and returns its exit code.
fn ended<E: Display>(outcome: Result<(), E>, code: impl Fn(&E) -> u8) -> ExitCode {
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            Terminal::new().say(format_args!("coxswain: {error}"));
            ExitCode::from(code(&error))
        }
    }
}

fn launch(options: &Options) -> ExitCode {
    let watched = if options.stop_with_stdin { end_with_stdin() } else { Ok(()) };
    let outcome = watched
        .map_err(|source| LaunchError::System { what: "the standard input", source })
        .and_then(|()| supervisor::launch::run(options, WITHOUT_LEARNING));
    match outcome {
        Ok(outcome) => outcome.exit_code(),
        Err(error) => {
            Terminal::new().say(format_args!("coxswain: {error}"));
            error.exit_code()
        }
    }
}

/// Makes the run without learning for the live page.
#[cfg(feature = "workbench")]
const WITHOUT_LEARNING: WithoutLearning = workbench::without_learning;
/// A robot simulates no run for comparison.
#[cfg(not(feature = "workbench"))]
const WITHOUT_LEARNING: WithoutLearning = |_, _| Ok(None);

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
