//! carrier → message: decodes, drops stale messages, and counts.

use super::carrier::Receiver;
use super::sequence::{Place, Sequences};
use super::{ReceiveError, Since};
use protocol::frame::{self, DecodeError};
use protocol::topic::OnTopic;
use std::marker::PhantomData;
use std::time::Duration;

/// Counters of a reader since it was opened.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Tally {
    /// Messages received and valid, including those that [`Source::latest`] skipped.
    pub received: u64,
    /// Messages that their writer sent and that never arrived, or arrived damaged: gaps in the
    /// sequence.
    pub lost: u64,
    /// Bytes that were no valid message.
    pub refused: u64,
    /// Messages that arrived again or too late.
    pub stale: u64,
}

/// A reader of `T` on its topic.
pub struct Source<T> {
    receiver: Box<dyn Receiver + Send>,
    sequences: Sequences,
    tally: Tally,
    last_refusal: Option<DecodeError>,
    message: PhantomData<T>,
}

impl<T: OnTopic> Source<T> {
    pub(super) fn new(receiver: Box<dyn Receiver + Send>, since: Since) -> Self {
        Self {
            receiver,
            sequences: Sequences::new(since),
            tally: Tally::default(),
            last_refusal: None,
            message: PhantomData,
        }
    }

    /// Takes the oldest waiting message, if there is one. Never waits. The messages of one writer
    /// keep their order.
    ///
    /// Bytes that are no valid message are skipped, counted as `refused`, and their error is kept
    /// as [`last_refusal`](Self::last_refusal).
    ///
    /// # Errors
    /// [`ReceiveError`] if the carrier fails.
    #[expect(
        clippy::should_implement_trait,
        reason = "an iterator would end where a source only has nothing yet"
    )]
    pub fn next(&mut self) -> Result<Option<T>, ReceiveError> {
        loop {
            let mut taken = None;
            if !self.receiver.receive(&mut |bytes| taken = Some(frame::decode::<T>(bytes)))? {
                return Ok(None);
            }
            match taken {
                Some(Ok(message)) if self.admit(&message) => return Ok(Some(message)),
                Some(Err(refusal)) => {
                    self.tally.refused += 1;
                    self.last_refusal = Some(refusal);
                }
                Some(Ok(_)) | None => {}
            }
        }
    }

    /// Takes all waiting messages and returns the newest: the last one, of the greatest epoch where
    /// there are several.
    ///
    /// Skipped messages count as received, not as lost.
    ///
    /// # Errors
    /// [`ReceiveError`] if the carrier fails.
    pub fn latest(&mut self) -> Result<Option<T>, ReceiveError> {
        let mut newest: Option<T> = None;
        while let Some(message) = self.next()? {
            if newest.as_ref().is_none_or(|newest| newest.stamp().epoch <= message.stamp().epoch) {
                newest = Some(message);
            }
        }
        Ok(newest)
    }

    /// Sleeps until a message waits, and returns whether one does. True at once if one does
    /// already.
    ///
    /// A signal ends it early with false, so that a process can check its flags. A timeout may be
    /// rounded up to whole milliseconds; one of less than a millisecond is kept to 0.2 ms.
    ///
    /// # Errors
    /// [`ReceiveError`] if the carrier fails.
    pub fn wait(&mut self, timeout: Duration) -> Result<bool, ReceiveError> {
        self.receiver.wait(timeout)
    }

    /// The counters so far.
    pub fn tally(&self) -> Tally {
        self.tally
    }

    /// Why the last refused bytes were no valid message.
    pub fn last_refusal(&self) -> Option<DecodeError> {
        self.last_refusal
    }

    fn admit(&mut self, message: &T) -> bool {
        match self.sequences.place(message.stamp()) {
            Place::New { lost } => {
                self.tally.received += 1;
                self.tally.lost = self.tally.lost.saturating_add(lost);
                true
            }
            Place::Stale => {
                self.tally.stale += 1;
                false
            }
        }
    }
}
