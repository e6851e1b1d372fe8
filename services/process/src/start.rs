//! `main` of every process: arguments, settings, log, stop signals, body, exit code.

use crate::{HasRun, Run, Stop, keep_to_user, lifeline};
use anyhow::Context;
use clap::{CommandFactory, FromArgMatches, Parser};
use protocol::message::Participant;
use rustix::process::{Signal, set_parent_process_death_signal};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use settings::{Check, Impossible, SettingsError};
use std::fmt::Display;
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Mutex;
use std::thread;
use std::time::Duration;
use tracing_subscriber::filter::ParseError;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, Layer};

/// Longest time for a process to end by itself after its launcher has ended.
const LAST_WORDS: Duration = Duration::from_secs(15);

/// Exit code of a process whose body failed.
const FAILED: u8 = 1;

/// Exit code of a process that cannot use its settings.
const REFUSED: u8 = 2;

#[derive(Debug, Parser)]
#[command(version, about = "One process of a graph. `coxswain launch` starts it; see there.")]
struct Arguments {
    /// TOML file with all settings of this process.
    #[arg(long, value_name = "FILE")]
    settings: PathBuf,
    /// Stop at the end of the standard input, which is the end of the launcher. If the input is a
    /// socket, the process sends its heartbeat there.
    #[arg(long)]
    stop_with_stdin: bool,
}

/// The process's own settings, of which the table `[run]` is checked as well.
#[derive(Deserialize)]
#[serde(transparent)]
struct WithRun<S>(S);

impl<S: Check + HasRun> Check for WithRun<S> {
    fn check(&self) -> Result<(), Impossible> {
        self.0.run().check().map_err(|impossible| impossible.under("run"))?;
        self.0.check()
    }
}

/// Reads and checks the settings of a process, the table `[run]` included.
///
/// # Errors
/// [`SettingsError`] reports the first error and its line.
pub fn read_settings<S: DeserializeOwned + Check + HasRun>(
    file: &Path,
) -> Result<S, SettingsError> {
    settings::read(file).map(|WithRun(settings)| settings)
}

/// Main function of the process of role `participant`: reads the settings file of the arguments,
/// opens the log, turns signals into stop requests, and runs `body`.
///
/// Exit code 0 if `body` succeeded, 1 if it failed, 2 if the arguments or the settings are invalid
/// and `body` did not run. The error is logged, and written in one line to the standard error.
pub fn main<S>(
    participant: Participant,
    body: impl FnOnce(S, &Stop) -> anyhow::Result<()>,
) -> ExitCode
where
    S: DeserializeOwned + Check + HasRun,
{
    let name = participant.text();
    let matches = Arguments::command().name(name).get_matches();
    let arguments = match Arguments::from_arg_matches(&matches) {
        Ok(arguments) => arguments,
        Err(error) => error.exit(),
    };
    let settings: S = match read_settings(&arguments.settings) {
        Ok(settings) => settings,
        Err(error) => {
            say(name, &error);
            return ExitCode::from(REFUSED);
        }
    };
    let stop = Stop::new();
    if let Err(error) = prepare(name, settings.run(), &stop, arguments.stop_with_stdin) {
        say(name, format_args!("{error:#}"));
        return ExitCode::from(FAILED);
    }
    if let Err(error) = settings.run().scheduling.apply() {
        tracing::error!("{error}");
        say(name, &error);
        return ExitCode::from(REFUSED);
    }
    tracing::info!(pid = std::process::id(), settings = %arguments.settings.display(), "started");
    match body(settings, &stop) {
        Ok(()) => {
            tracing::info!(requested = stop.requested(), "ended");
            ExitCode::SUCCESS
        }
        Err(error) => {
            tracing::error!("{error:#}");
            say(name, format_args!("{error:#}"));
            ExitCode::from(FAILED)
        }
    }
}

/// Opens the log and installs all sources of a stop request.
fn prepare(name: &str, run: &Run, stop: &Stop, stop_with_stdin: bool) -> anyhow::Result<()> {
    keep_to_user();
    let path = run.folder.join(format!("{name}.log"));
    let file = File::options().create(true).append(true).open(&path);
    let file = file.with_context(|| format!("the log {} cannot be opened", path.display()))?;
    let lines = tracing_subscriber::fmt::layer().with_ansi(false).with_writer(Mutex::new(file));
    tracing_subscriber::registry()
        .with(lines.with_filter(log_filter(&run.log)?))
        .try_init()
        .map_err(|error| anyhow::anyhow!("the log cannot be started: {error}"))?;
    log_panics();
    stop.on_signals().context("signals cannot be caught")?;
    if stop_with_stdin {
        // A stopped (SIGSTOP) process would not see the end of its input: the signal wakes it.
        set_parent_process_death_signal(Some(Signal::CONT))
            .context("the signal for the launcher's end cannot be set")?;
        lifeline::hold();
        let stop = stop.clone();
        let watch = move || {
            stop.at_end_of(io::stdin().lock());
            thread::sleep(LAST_WORDS);
            tracing::error!(
                "the launcher has ended, and this process has not ended within {LAST_WORDS:?}: \
                 it is terminated now"
            );
            std::process::exit(FAILED.into());
        };
        thread::Builder::new()
            .name("stdin".into())
            .spawn(watch)
            .context("the standard input cannot be watched")?;
    }
    Ok(())
}

/// Filter of a log for `directives`. Unless they name zenoh, its own lines are left out: any peer
/// on the network can cause them without end.
///
/// # Errors
/// If `directives` are invalid.
pub fn log_filter(directives: &str) -> Result<EnvFilter, ParseError> {
    if directives.contains("zenoh") {
        EnvFilter::try_new(directives)
    } else {
        EnvFilter::try_new(format!("{directives},zenoh=off"))
    }
}

/// Logs a panic of every thread.
fn log_panics() {
    let default = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        tracing::error!("{panic}");
        default(panic);
    }));
}

/// Writes one line to the standard error, which may be closed.
fn say(name: &str, what: impl Display) {
    let _ = writeln!(io::stderr().lock(), "{name}: {what}");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Plain {
        run: Run,
    }

    impl Check for Plain {}

    impl HasRun for Plain {
        fn run(&self) -> &Run {
            &self.run
        }
    }

    const GOOD: &str = r#"
[run]
folder = "runs/1"
log = "info,transport=debug"
epoch_floor = 3
restarted = true
period_nanos = 100_000_000
pace = "lock-step"
[run.links]
graph = "a"
lock_step = true
root = "/tmp/a"
patience_millis = 1000
"#;

    fn refusal(from: &str, to: &str) -> Option<String> {
        let text = GOOD.replacen(from, to, 1);
        settings::parse::<WithRun<Plain>>(&text, Path::new("plant.toml"))
            .err()
            .map(|error| error.to_string())
    }

    #[test]
    fn the_arguments_are_well_formed() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn the_table_run_is_checked_with_the_other_settings() {
        assert_eq!(refusal("", ""), None);
        let filter = "a level (error, warn, info, debug, trace) or a list of module=level";
        assert_eq!(
            refusal("info,transport=debug", "noise=["),
            Some(format!("plant.toml:4: run.log = \"noise=[\": expected {filter}"))
        );
        assert_eq!(
            refusal("lock_step = true", "lock_step = false").as_deref(),
            Some(
                "plant.toml:11: run.links.lock_step = false: expected true in lock step, else false"
            )
        );
        let late = "[[run.links.faults.fault]]\ntopic = \"state\"\nat = \"reader\"\n\
                    kind = \"delay\"\nmillis = 5\n";
        assert_eq!(
            settings::parse::<WithRun<Plain>>(&format!("{GOOD}{late}"), Path::new("plant.toml"))
                .err()
                .map(|error| error.to_string()),
            Some(
                "plant.toml:18: run.links.faults.fault.0.millis = 5: \
                 expected messages instead: in lock step time does not count"
                    .into()
            )
        );
        assert_eq!(
            refusal("100_000_000", "0").as_deref(),
            Some("plant.toml:7: run.period_nanos = 0: expected a period of 1 to 1000000000000 ns")
        );
    }
}
