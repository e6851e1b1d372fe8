//! What a carrier must do: move bytes from one outlet to every inlet of its topic. It knows nothing of messages.

use super::{ReceiveError, SendError};
use std::time::Duration;

/// How messages become bytes on a carrier.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    /// As in memory, see [`frame`](crate::frame). Lengths are multiples of 8 bytes.
    Words,
    /// Packed, see [`wire`](crate::wire).
    Wire,
}

/// Where the bytes of one writer leave.
pub(super) trait Outlet {
    /// How messages become bytes here.
    fn encoding(&self) -> Encoding {
        Encoding::Words
    }

    /// Lets `fill` write `length` bytes in place, then hands them to every reader.
    fn send(&mut self, length: usize, fill: &mut dyn FnMut(&mut [u8])) -> Result<(), SendError>;

    /// Hands the history to readers that have joined since the last call.
    fn refresh(&mut self) -> Result<(), SendError>;

    /// Messages so far that left this process for nobody: they gave way in a queue of the outlet's own.
    fn dropped(&self) -> u64 {
        0
    }
}

/// Where the bytes for one reader arrive.
pub(super) trait Inlet {
    /// How bytes become messages here.
    fn encoding(&self) -> Encoding {
        Encoding::Words
    }

    /// Shows `visit` the oldest waiting bytes; false if nothing waits.
    fn receive(&mut self, visit: &mut dyn FnMut(&[u8])) -> Result<bool, ReceiveError>;

    /// Sleeps until something waits, which is true, or `timeout` is over or a signal came, which is false.
    fn wait(&mut self, timeout: Duration) -> Result<bool, ReceiveError>;
}
