//! The plant process: a simulated robot.

use plant_sim::Settings;
use protocol::message::Participant;
use std::process::ExitCode;
use transport::{Identity, Ports};

fn main() -> ExitCode {
    process::main::<Settings>(Participant::Plant, |settings, stop| {
        settings.run.go_first_to_open();
        let identity = Identity::new(settings.run.epoch_floor + 1);
        let ports = Ports::open(&settings.run.links, identity)?;
        plant_sim::run(&settings, &ports, identity, stop)?;
        Ok(())
    })
}
