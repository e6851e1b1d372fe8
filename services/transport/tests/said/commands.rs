//! Commands to send, and a wait for received messages.

use bytemuck::Zeroable;
use protocol::message::Command;
use protocol::topic::OnTopic;
use std::error::Error;
use std::time::Duration;
use transport::Source;

/// Longer than any test machine needs.
const LONG: Duration = Duration::from_mins(1);

/// A command that answers `tick`.
pub(crate) fn command(tick: u64) -> Command {
    let mut command = Command::zeroed();
    command.stamp.tick = tick;
    command
}

/// Reads until a message satisfies the condition.
pub(crate) fn until<T: OnTopic>(
    source: &mut Source<T>,
    wanted: impl Fn(&T) -> bool,
) -> Result<T, Box<dyn Error>> {
    loop {
        if !source.wait(LONG)? {
            return Err("nothing comes any more".into());
        }
        while let Some(message) = source.next()? {
            if wanted(&message) {
                return Ok(message);
            }
        }
    }
}
