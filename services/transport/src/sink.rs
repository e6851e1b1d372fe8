//! message → carrier: stamps, numbers and encodes.

use super::carrier::Sender;
use super::{Identity, SendError};
use protocol::topic::OnTopic;
use protocol::{VERSION, clock, frame};
use std::marker::PhantomData;

/// A writer of `T` on its topic.
///
/// Keep it until its readers have connected. On shared memory a reader connects to a writer at its
/// next read. It never receives the messages of a writer that is gone by then. A connected reader
/// keeps its waiting messages, even when the writer dies.
pub struct Sink<T> {
    sender: Box<dyn Sender + Send>,
    identity: Identity,
    sequence: u64,
    sent: u64,
    message: PhantomData<T>,
}

impl<T: OnTopic> Sink<T> {
    pub(super) fn new(sender: Box<dyn Sender + Send>, identity: Identity) -> Self {
        Self { sender, identity, sequence: 0, sent: 0, message: PhantomData }
    }

    /// Sends `message` to every reader, and fills in its stamp except for `tick`.
    ///
    /// Never waits on a link where the newest wins. On a lossless link it waits for room, at most
    /// as long as the graph's patience. On shared memory the message is written in place; iceoryx2
    /// allocates one piece of 48 bytes for the loan, and frees it.
    ///
    /// # Errors
    /// [`SendError`] if a reader did not receive it. The sequence number is used up all the same,
    /// so that this reader counts a loss.
    pub fn send(&mut self, message: &mut T) -> Result<(), SendError> {
        self.sequence += 1;
        let stamp = message.stamp_mut();
        stamp.version = VERSION;
        stamp.kind = T::KIND;
        stamp.writer = self.identity.writer;
        stamp.epoch = self.identity.epoch;
        stamp.sequence = self.sequence;
        stamp.sent_nanos = clock::monotonic_nanos();
        let (checksum, sent) = self.transmit(message);
        message.stamp_mut().checksum = checksum;
        self.sent += u64::from(sent.is_ok());
        sent
    }

    /// Sends `message` with the stamp that it has: one that [`send`](Self::send) has sent before,
    /// or one of another host. Readers that have received it already count it as stale.
    ///
    /// # Errors
    /// As for [`send`](Self::send).
    pub fn send_stamped(&mut self, message: &T) -> Result<(), SendError> {
        self.transmit(message).1
    }

    /// Passes a message to the carrier. Returns its checksum too.
    fn transmit(&mut self, message: &T) -> (u32, Result<(), SendError>) {
        let mut checksum = 0;
        let sent = self.sender.send(message.byte_len(), &mut |out| {
            frame::encode(message, out);
            checksum = frame::peek(out).map_or(0, |stamp| stamp.checksum);
        });
        (checksum, sent)
    }

    /// Changes the epoch of all further messages. Its sequence numbers start at 1 again.
    pub fn set_epoch(&mut self, epoch: u64) {
        self.identity.epoch = epoch;
        self.sequence = 0;
    }

    /// Messages that reached every reader, in all epochs.
    pub fn sent(&self) -> u64 {
        self.sent
    }

    /// Sends the history to late joiners while there is no new message. Otherwise they get it with
    /// the next message.
    ///
    /// # Errors
    /// [`SendError::Carrier`].
    pub fn refresh(&mut self) -> Result<(), SendError> {
        self.sender.refresh()
    }
}

/// A writer of arbitrary bytes without any check: for tests of how readers handle garbage.
pub struct RawSink {
    sender: Box<dyn Sender + Send>,
}

impl RawSink {
    pub(super) fn new(sender: Box<dyn Sender + Send>) -> Self {
        Self { sender }
    }

    /// Sends `bytes` as they are, with zeros appended up to a multiple of 8.
    ///
    /// # Errors
    /// As for [`Sink::send`].
    pub fn send_raw(&mut self, bytes: &[u8]) -> Result<(), SendError> {
        self.sender.send(bytes.len().next_multiple_of(8), &mut |out| {
            let (head, padding) = out.split_at_mut(bytes.len());
            head.copy_from_slice(bytes);
            padding.fill(0);
        })
    }
}
