//! The process of the bridge.

use bridge::settings::Settings;
use protocol::message::Participant;
use std::process::ExitCode;

fn main() -> ExitCode {
    process::main(Participant::Bridge, |settings: Settings, stop| {
        // zenoh's threads inherit it: they are on the path of a command.
        settings.run.go_first_to_run();
        bridge::run(&settings, stop)?;
        Ok(())
    })
}
