//! The gateway's process: messages in, telemetry out.

use gateway::settings::Settings;
use protocol::message::Participant;
use rustix::process::setpriority_process;
use std::process::ExitCode;
use transport::{Identity, Ports};

/// Nice value: the controller has precedence when processors are short.
const NICE: i32 = 10;

fn main() -> ExitCode {
    // If the system does not permit it, the process keeps its priority.
    let _ = setpriority_process(None, NICE);
    process::main(Participant::Gateway, |settings: Settings, stop| {
        let ports = Ports::open(&settings.run.links, Identity::new(settings.run.epoch_floor + 1))?;
        gateway::run::run(&ports, &settings, stop)?;
        Ok(())
    })
}
