//! A whole graph in one process, in lock step:
//! `cargo run --release -p experiment --example in_process GRAPH.toml NEW_FOLDER [SCENARIO]`.
//!
//! Simulator, learner, controller and recorder run as threads, as fast as the machine can. The
//! results are the same bits as those of the processes.

use experiment::in_process;
use graph::assembly::Assembly;
use graph::options::Options;
use std::error::Error;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::{env, fs};

fn main() -> Result<ExitCode, Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [graph, folder, scenario @ ..] = arguments.as_slice() else {
        writeln!(io::stderr(), "in_process: expected a graph file and a new folder")?;
        return Ok(ExitCode::from(2));
    };
    let options = Options {
        scenario: scenario.first().map(PathBuf::from),
        duration: Some(10.0),
        ..Options::of_graph(Path::new(graph))
    };
    let assembly = Assembly::read(&options)?;
    fs::create_dir(folder)?;
    let summary = in_process::run(&assembly, Path::new(folder))?;
    let rmse = summary.position_rmse_m.unwrap_or(f64::NAN);
    writeln!(
        io::stdout(),
        "{}: periods {} position_rmse_m {rmse} snapshots {}",
        assembly.scenario_name,
        summary.periods,
        summary.snapshots_adopted
    )?;
    Ok(ExitCode::SUCCESS)
}
