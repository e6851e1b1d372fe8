//! The interface of a carrier: it moves bytes from one sender to every receiver of its topic. It
//! does not know messages, which are encoded as in memory ([`frame`](protocol::frame)): their
//! lengths are multiples of 8 bytes.

use super::{ReceiveError, SendError};
use std::time::Duration;

/// Sends the bytes of one writer.
pub(super) trait Sender {
    /// Lets `fill` write `length` bytes in place, then hands them to every reader.
    fn send(&mut self, length: usize, fill: &mut dyn FnMut(&mut [u8])) -> Result<(), SendError>;

    /// Sends the history to readers that have joined since the last call.
    fn refresh(&mut self) -> Result<(), SendError>;
}

/// Receives the bytes for one reader.
pub(super) trait Receiver {
    /// Passes the oldest waiting bytes to `visit`; false if nothing waits.
    fn receive(&mut self, visit: &mut dyn FnMut(&[u8])) -> Result<bool, ReceiveError>;

    /// Sleeps until a message waits, which gives true. Gives false if `timeout` is over or a signal
    /// came.
    fn wait(&mut self, timeout: Duration) -> Result<bool, ReceiveError>;
}
