//! The controller process.

use controller::{Settings, run};
use protocol::message::Participant;
use std::process::ExitCode;
use transport::Ports;

fn main() -> ExitCode {
    process::main::<Settings>(Participant::Controller, |settings, stop| {
        run::run(&settings, |identity| Ports::open(&settings.run.links, identity), stop)?;
        Ok(())
    })
}
