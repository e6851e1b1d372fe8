//! The recorder's process: messages in, record and summary out.

use protocol::message::Participant;
use recorder::settings::Settings;
use std::process::ExitCode;
use transport::{Identity, Ports};

fn main() -> ExitCode {
    process::main(Participant::Recorder, |settings: Settings, stop| {
        let ports = Ports::open(&settings.run.links, Identity::new(settings.run.epoch_floor + 1))?;
        let summary = recorder::run::run(&ports, &settings, stop)?;
        tracing::info!(
            periods = summary.periods,
            missed = summary.periods_missed,
            segments = summary.segments,
            "recorded"
        );
        Ok(())
    })
}
