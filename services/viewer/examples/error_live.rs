//! Draws how far a robot is from its reference, live: `error_live tcp/127.0.0.1:7448 [robot]`.

use anyhow::{Context, bail};
use network::telemetry::{TelemetryMessage, Watcher};
use process::Stop;
use std::env;
use std::io::{self, ErrorKind, Write};
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// After so long nobody is there.
const SILENCE: Duration = Duration::from_secs(5);
/// How often Ctrl-C is looked at.
const PATIENCE: Duration = Duration::from_millis(100);
/// Ends of the bar \[m\], which grows by the same length for every tenfold error.
const ENDS_M: [f64; 2] = [1e-4, 10.0];
const BAR: f64 = 40.0;

fn main() -> anyhow::Result<ExitCode> {
    let mut arguments = env::args().skip(1);
    let (Some(endpoint), robot) = (arguments.next(), arguments.next()) else {
        writeln!(
            io::stderr(),
            "no endpoint: expected one, as in error_live tcp/127.0.0.1:7448 [robot]"
        )?;
        return Ok(ExitCode::from(2));
    };
    let stop = Stop::new();
    stop.on_signals()?;
    let mut watcher = Watcher::open(&endpoint, robot.as_deref()).context("no router answers")?;
    let mut received = Instant::now();
    while !stop.requested() {
        let telemetry = watcher.next(PATIENCE)?;
        if let Some(TelemetryMessage::Plan(plan)) = telemetry.map(|telemetry| telemetry.message) {
            received = Instant::now();
            let error = plan.position_error();
            match writeln!(
                io::stdout(),
                "tick {:6}  error {error:8.4} m  {}",
                plan.stamp.tick,
                bar(error)
            ) {
                Err(error) if error.kind() == ErrorKind::BrokenPipe => {
                    return Ok(ExitCode::SUCCESS);
                }
                written => written?,
            }
        }
        if received.elapsed() > SILENCE {
            bail!("no plan from a robot at {endpoint} for {} s", SILENCE.as_secs());
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn bar(error: f64) -> String {
    let [least, most] = ENDS_M;
    let share = (error.max(least) / least).ln() / (most / least).ln();
    "█".repeat((share.min(1.0) * BAR).round() as usize)
}
