//! The receiver and the sender around the real ones. They allocate for every message.

use super::Chain;
use crate::carrier::{Receiver, Sender};
use crate::{ReceiveError, SendError};
use std::time::{Duration, Instant};

/// A sender that applies faults to messages before they leave.
pub(crate) struct FaultySender {
    inner: Box<dyn Sender + Send>,
    chain: Chain,
}

impl FaultySender {
    pub(crate) fn new(inner: Box<dyn Sender + Send>, chain: Chain) -> Self {
        Self { inner, chain }
    }

    /// Sends all released messages. It returns the first error, and still sends the rest.
    fn flush(&mut self) -> Result<(), SendError> {
        let mut outcome = Ok(());
        while let Some(bytes) = self.chain.pop() {
            let sent = self.inner.send(bytes.len(), &mut |out| out.copy_from_slice(&bytes));
            outcome = outcome.and(sent);
        }
        outcome
    }
}

impl Sender for FaultySender {
    fn send(&mut self, length: usize, fill: &mut dyn FnMut(&mut [u8])) -> Result<(), SendError> {
        let now = Instant::now();
        let mut bytes = vec![0; length];
        fill(&mut bytes);
        self.chain.release(now);
        self.chain.take(bytes, now);
        self.flush()
    }

    fn refresh(&mut self) -> Result<(), SendError> {
        self.chain.release(Instant::now());
        self.flush().and(self.inner.refresh())
    }
}

/// A receiver that applies faults to messages after they have arrived.
pub(crate) struct FaultyReceiver {
    inner: Box<dyn Receiver + Send>,
    chain: Chain,
}

impl FaultyReceiver {
    pub(crate) fn new(inner: Box<dyn Receiver + Send>, chain: Chain) -> Self {
        Self { inner, chain }
    }

    /// Receives from the real receiver until the faults release a message. True if they have.
    fn pull(&mut self) -> Result<bool, ReceiveError> {
        // A message that has already arrived can still release the messages held behind it.
        while !self.chain.is_ready() {
            let mut arrived = None;
            if !self.inner.receive(&mut |bytes| arrived = Some(bytes.to_vec()))? {
                self.chain.release_at_rest(Instant::now());
                break;
            }
            let now = Instant::now();
            self.chain.release(now);
            if let Some(bytes) = arrived {
                self.chain.take(bytes, now);
            }
        }
        Ok(self.chain.is_ready())
    }
}

impl Receiver for FaultyReceiver {
    fn receive(&mut self, visit: &mut dyn FnMut(&[u8])) -> Result<bool, ReceiveError> {
        self.pull()?;
        Ok(self.chain.pop().is_some_and(|bytes| {
            visit(&bytes);
            true
        }))
    }

    fn wait(&mut self, timeout: Duration) -> Result<bool, ReceiveError> {
        let deadline = Instant::now().checked_add(timeout);
        loop {
            if self.pull()? {
                return Ok(true);
            }
            let now = Instant::now();
            let wake = deadline.into_iter().chain(self.chain.next_due()).min();
            let left = wake.map_or(Duration::MAX, |wake| wake.saturating_duration_since(now));
            let arrived = self.inner.wait(left)?;
            let now = Instant::now();
            if !arrived
                && (deadline.is_some_and(|deadline| deadline <= now)
                    || wake.is_none_or(|wake| now < wake))
            {
                // The time is over, or a signal came.
                return self.pull();
            }
        }
    }
}
