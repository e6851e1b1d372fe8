//! The person's command.

use clap::{Parser, Subcommand};
use coxswain::experiment::{self, CompareOptions};
use coxswain::options::Options;
use coxswain::terminal::Terminal;
use std::process::ExitCode;

/// Learning model predictive control for omnidirectional robots, as a graph of processes.
#[derive(Debug, Parser)]
#[command(version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Start the processes of a graph, look after them, and end them.
    ///
    /// Exit code 0 if the run has come to its end, 128 and the signal's number if it was ended by one, 2 if something that was set is
    /// impossible and nothing was started, 1 if anything failed.
    Launch(Options),
    /// Compare controllers in closed loops, in lock step and in one process.
    #[command(subcommand)]
    Experiment(Experiment),
}

#[derive(Debug, Subcommand)]
enum Experiment {
    /// Every controller in every scenario, for several seeds: a table, and a JSON row per trial.
    Compare(CompareOptions),
}

fn main() -> ExitCode {
    match Arguments::parse().command {
        Command::Launch(options) => match coxswain::launch::run(&options) {
            Ok(outcome) => outcome.exit_code(),
            Err(error) => {
                Terminal::new().say(format_args!("coxswain: {error}"));
                error.exit_code()
            }
        },
        Command::Experiment(Experiment::Compare(options)) => match experiment::compare(&options) {
            Ok(()) => ExitCode::SUCCESS,
            Err(error) => {
                Terminal::new().say(format_args!("coxswain: {error}"));
                ExitCode::from(error.exit_code())
            }
        },
    }
}
