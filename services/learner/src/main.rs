//! The learner process.

use learner::{Settings, run};
use protocol::message::Participant;
use std::process::ExitCode;
use transport::{Identity, Ports};

fn main() -> ExitCode {
    process::main::<Settings>(Participant::Learner, |settings, stop| {
        let ports = Ports::open(&settings.run.links, Identity::new(settings.run.epoch_floor + 1))?;
        run::run(&settings, &ports, stop)?;
        Ok(())
    })
}
