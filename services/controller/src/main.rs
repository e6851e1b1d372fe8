//! The controller process.

use controller::{Settings, run};
use process::{Pace, go_first};
use protocol::message::Participant;
use protocol::port::Ports;
use std::process::ExitCode;

fn main() -> ExitCode {
    process::main::<Settings>(Participant::Controller, |settings, stop| {
        if settings.run.pace == Pace::RealTime {
            go_first();
        }
        run::run(&settings, |identity| Ports::open(&settings.run.links, identity), stop)?;
        Ok(())
    })
}
