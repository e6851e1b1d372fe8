//! Options of the command line.

use crate::hosts::is_address;
use crate::scenario::DURATION_MAX_S;
use clap::Args;
use process::Pace;
use std::path::{Path, PathBuf};
use tracing_subscriber::EnvFilter;

/// What to launch, and changes to it.
#[derive(Debug, Clone, Args)]
pub struct Options {
    /// Graph file: processes, hosts, robot and scenario.
    pub graph: PathBuf,
    /// Another scenario: a file, or the name of one beside the graph's own.
    #[arg(long, value_name = "FILE|NAME")]
    pub scenario: Option<PathBuf>,
    /// Another robot file.
    #[arg(long, value_name = "FILE")]
    pub robot: Option<PathBuf>,
    /// Another duration of the run.
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    pub duration: Option<f64>,
    /// Source of the time: real-time, or lock-step as fast as the machine can.
    #[arg(long, value_name = "PACE", value_parser = pace)]
    pub pace: Option<Pace>,
    /// Whether the learner runs: on or off.
    #[arg(long, value_name = "on|off", value_parser = switch)]
    pub learner: Option<bool>,
    /// Begin with a learned model: the snapshot of an earlier run, or of `coxswain learn`.
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
    /// Launch only the processes of this host of the graph file. Without it, all hosts run on this
    /// machine, and meet on its loopback.
    #[arg(long, value_name = "NAME")]
    pub host: Option<String>,
    /// Host and port of the connection with another host, instead of those of the graph file, such
    /// as control=10.0.0.2:7447; may be given several times.
    #[arg(long = "address", value_name = "HOST=ADDRESS", value_parser = address)]
    pub addresses: Vec<(String, String)>,
    /// Run directory, new or empty; by default a new one under runs/.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Log filter: error, warn, info, debug, trace, or a list of module=level.
    #[arg(long, value_name = "LEVEL", default_value = "info", value_parser = filter)]
    pub log: String,
    /// Another seed of noise and random forces.
    #[arg(
        long,
        value_name = "N",
        value_parser = clap::value_parser!(u64).range(0..=i64::MAX as u64)
    )]
    pub seed: Option<u64>,
    /// Folder of certificates, as deploy/certificates creates it, instead of that of the graph
    /// file. All data on the network is then encrypted, and only peers with a certificate are
    /// accepted.
    #[arg(long, value_name = "DIR")]
    pub certificates: Option<PathBuf>,
    /// Use addresses that others on the network can reach, without authentication: every peer that
    /// reaches them can watch and drive the robot.
    #[arg(long)]
    pub insecure: bool,
    /// Faults to inject, in the format of deploy/faults/example.toml.
    #[cfg(feature = "faults")]
    #[arg(long, value_name = "FILE")]
    pub faults: Option<PathBuf>,
    /// Stop when the standard input ends, as it does when the parent process ends.
    #[arg(long, hide = true)]
    pub stop_with_stdin: bool,
}

impl Options {
    /// A graph as in its files, without changes.
    pub fn of_graph(graph: &Path) -> Self {
        Self {
            graph: graph.to_owned(),
            scenario: None,
            robot: None,
            duration: None,
            pace: None,
            learner: None,
            model: None,
            host: None,
            addresses: Vec::new(),
            out: None,
            log: "info".into(),
            seed: None,
            certificates: None,
            insecure: false,
            #[cfg(feature = "faults")]
            faults: None,
            stop_with_stdin: false,
        }
    }
}

fn seconds(text: &str) -> Result<f64, String> {
    let seconds =
        text.parse().ok().filter(|seconds: &f64| *seconds > 0.0 && *seconds <= DURATION_MAX_S);
    seconds.ok_or_else(|| format!("expected seconds: more than 0 and at most {DURATION_MAX_S}"))
}

/// A pace by its name.
///
/// # Errors
/// A sentence with the names that there are.
pub fn pace(text: &str) -> Result<Pace, String> {
    match text {
        "real-time" => Ok(Pace::RealTime),
        "lock-step" => Ok(Pace::LockStep),
        _ => Err("expected real-time or lock-step".into()),
    }
}

fn address(text: &str) -> Result<(String, String), String> {
    let parts = text.split_once('=').filter(|(_, address)| is_address(address));
    let (host, address) =
        parts.ok_or("expected a host, host name and port such as control=10.0.0.2:7447")?;
    Ok((host.to_owned(), address.to_owned()))
}

fn switch(text: &str) -> Result<bool, String> {
    match text {
        "on" => Ok(true),
        "off" => Ok(false),
        _ => Err("expected on or off".into()),
    }
}

fn filter(text: &str) -> Result<String, String> {
    match EnvFilter::try_new(text) {
        Ok(_) => Ok(text.to_owned()),
        Err(error) => Err(format!(
            "expected a level (error, warn, info, debug, trace) or a list of module=level: {error}"
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_positive_finite_time_is_a_duration() {
        assert_eq!(seconds("2.5"), Ok(2.5));
        for text in ["0", "-1", "nan", "inf", "1e300", "soon"] {
            assert!(seconds(text).is_err(), "{text}");
        }
    }
}
