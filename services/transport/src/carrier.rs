//! The interface of a carrier: it moves bytes from one outlet to every inlet of its topic. It does
//! not know messages.

use super::{ReceiveError, SendError};
use std::time::Duration;

/// Encoding of messages on a carrier.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    /// As in memory, see [`frame`](protocol::frame). Lengths are multiples of 8 bytes.
    Words,
    /// Packed, see [`wire`](protocol::wire).
    Wire,
}

/// Sends the bytes of one writer.
pub(super) trait Outlet {
    /// Encoding of messages here.
    fn encoding(&self) -> Encoding {
        Encoding::Words
    }

    /// Lets `fill` write `length` bytes in place, then hands them to every reader.
    fn send(&mut self, length: usize, fill: &mut dyn FnMut(&mut [u8])) -> Result<(), SendError>;

    /// Sends the history to readers that have joined since the last call.
    fn refresh(&mut self) -> Result<(), SendError>;

    /// Number of messages that no reader received, because newer ones replaced them in a queue of
    /// the outlet.
    fn dropped(&self) -> u64 {
        0
    }
}

/// Receives the bytes for one reader.
pub(super) trait Inlet {
    /// Encoding of messages here.
    fn encoding(&self) -> Encoding {
        Encoding::Words
    }

    /// Passes the oldest waiting bytes to `visit`; false if nothing waits.
    fn receive(&mut self, visit: &mut dyn FnMut(&[u8])) -> Result<bool, ReceiveError>;

    /// Sleeps until a message waits, which gives true. Gives false if `timeout` is over or a signal
    /// came.
    fn wait(&mut self, timeout: Duration) -> Result<bool, ReceiveError>;
}
