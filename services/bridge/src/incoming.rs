//! Link ▶ shared memory: the messages of one topic, from one other host.
//!
//! zenoh's thread writes each message into shared memory itself. A thread in between would cost
//! 80 µs on the way of a command. zenoh's thread must not wait, or the link would starve of its
//! keepalives. So the bridge's own thread does the rest ([`Incoming::tend`]): it acknowledges
//! pieces, serves late joiners, and writes what has found no room.

use crate::outgoing::{Flow, LOSSLESS_WINDOW};
use crate::piece::{Assembly, Label};
use crate::rate::Rate;
use protocol::message::Participant;
use protocol::topic::OnTopic;
use protocol::wire;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use transport::{SendError, Sink};
use zenoh::sample::Sample;

/// In lock step: how long an acknowledgement waits for more pieces.
const TOGETHER_WITHIN: Duration = Duration::from_millis(20);
/// In lock step: pieces for one acknowledgement, a part of the window.
const ACKNOWLEDGED_TOGETHER: u32 = LOSSLESS_WINDOW as u32 / 4;
/// Time without a message after which late joiners get the last one.
const JOINS_AFTER: Duration = Duration::from_millis(100);
/// Messages that can wait for room.
const WAITING_MAX: usize = 256;

/// Why pieces were not delivered: counters of one topic from one host.
#[derive(Debug, Default)]
pub(crate) struct Received {
    /// Messages delivered.
    pub(crate) messages: AtomicU64,
    /// Pieces above the largest rate.
    pub(crate) too_many: AtomicU64,
    /// Messages that found no room, not even to wait.
    pub(crate) overflowed: AtomicU64,
    /// Messages that are none.
    pub(crate) malformed: AtomicU64,
    /// Messages in the name of a process that is not on that host.
    pub(crate) of_another_host: AtomicU64,
}

/// What became of a message.
pub(crate) enum Outcome {
    Written,
    Malformed,
    OfAnotherHost,
}

/// A topic in shared memory.
pub(crate) trait Target: Send {
    /// Writes one message, with its own stamp, if one of `processes` has sent it. Does not wait for
    /// room.
    fn write(&mut self, bytes: &[u8], processes: &[Participant]) -> Result<Outcome, SendError>;

    /// Sends the history to late joiners.
    fn refresh(&mut self) -> Result<(), SendError>;
}

impl<T: OnTopic + Send> Target for Sink<T> {
    fn write(&mut self, bytes: &[u8], processes: &[Participant]) -> Result<Outcome, SendError> {
        let Ok(message) = wire::decode::<T>(bytes) else { return Ok(Outcome::Malformed) };
        if !message.publisher().is_some_and(|from| processes.contains(&from)) {
            return Ok(Outcome::OfAnotherHost);
        }
        self.send_stamped(&message).map(|()| Outcome::Written)
    }

    fn refresh(&mut self) -> Result<(), SendError> {
        self.refresh()
    }
}

/// One topic from one other host.
pub(crate) struct Incoming {
    pub(crate) received: Received,
    flow: Flow,
    /// The processes of the other host.
    processes: Vec<Participant>,
    /// How long a message waits for room.
    patience: Duration,
    delivery: Mutex<Delivery>,
}

/// The messages of one topic on their way into shared memory.
struct Delivery {
    target: Box<dyn Target>,
    /// The largest rate; none in lock step.
    rate: Option<Rate>,
    assembly: Assembly,
    /// In lock step: the last piece.
    last: Option<Label>,
    /// Pieces since the last acknowledgement.
    unacknowledged: u32,
    /// Time of the last piece, or of the last look for late joiners.
    active: Instant,
    /// Messages that have found no room yet, in lock step. Pieces are not acknowledged before.
    waiting: VecDeque<Vec<u8>>,
    /// Since when the first one waits.
    full_since: Option<Instant>,
    failure: Option<SendError>,
}

impl Incoming {
    pub(crate) fn new(
        target: Box<dyn Target>,
        flow: Flow,
        rate: Option<Rate>,
        processes: Vec<Participant>,
        patience: Duration,
    ) -> Self {
        let delivery = Delivery {
            target,
            rate,
            assembly: Assembly::default(),
            last: None,
            unacknowledged: 0,
            active: Instant::now(),
            waiting: VecDeque::new(),
            full_since: None,
            failure: None,
        };
        Self {
            received: Received::default(),
            flow,
            processes,
            patience,
            delivery: Mutex::new(delivery),
        }
    }

    /// Takes a piece in from the thread that reads the link, and never waits. Above the largest
    /// rate the piece is dropped. True if [`tend`](Self::tend) has something to do.
    pub(crate) fn take(&self, sample: &Sample) -> bool {
        let now = Instant::now();
        let delivery = &mut *self.lock();
        if delivery.rate.as_mut().is_some_and(|rate| !rate.accepts(now)) {
            add_one(&self.received.too_many);
            return false;
        }
        delivery.active = now;
        let label = sample.attachment().map(|bytes| Label::of(&bytes.to_bytes()));
        let bytes = sample.payload().to_bytes();
        let taken = match label {
            None => self.deliver(delivery, &bytes),
            Some(Some(label)) => self.add(delivery, label, &bytes),
            Some(None) => {
                add_one(&self.received.malformed);
                Ok(())
            }
        };
        if let Err(error) = taken {
            delivery.failure = Some(error);
        }
        delivery.failure.is_some() || self.is_acknowledgement_due(delivery, now)
    }

    /// Does what the thread that reads the link leaves. Returns the label of the last piece if the
    /// pieces up to there are to be acknowledged.
    ///
    /// # Errors
    /// The topic cannot be delivered any longer.
    pub(crate) fn tend(&self) -> Result<Option<Label>, SendError> {
        let now = Instant::now();
        let delivery = &mut *self.lock();
        if let Some(failure) = delivery.failure.take() {
            return Err(failure);
        }
        while let Some(message) = delivery.waiting.pop_front() {
            let begun = *delivery.full_since.get_or_insert(now);
            match self.write(delivery, &message) {
                Err(SendError::NoRoom { topic, .. }) => {
                    let waited = now.saturating_duration_since(begun);
                    if waited >= self.patience {
                        return Err(SendError::NoRoom { topic, waited });
                    }
                    delivery.waiting.push_front(message);
                    break;
                }
                written => written?,
            }
            delivery.full_since = None;
        }
        let due = self.is_acknowledgement_due(delivery, now);
        if now.saturating_duration_since(delivery.active) >= JOINS_AFTER {
            delivery.active = now;
            delivery.target.refresh()?;
        }
        if due {
            delivery.unacknowledged = 0;
        }
        Ok(delivery.last.filter(|_| due))
    }

    fn lock(&self) -> MutexGuard<'_, Delivery> {
        self.delivery.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn is_acknowledgement_due(&self, delivery: &Delivery, now: Instant) -> bool {
        let count = delivery.unacknowledged;
        let is_due = match self.flow {
            Flow::Free => false,
            Flow::Paced => count > 0,
            Flow::Lossless => {
                count >= ACKNOWLEDGED_TOGETHER
                    || count > 0
                        && now.saturating_duration_since(delivery.active) >= TOGETHER_WITHIN
            }
        };
        is_due && delivery.waiting.is_empty()
    }

    /// Adds a piece, and delivers the message if this is its last one.
    fn add(&self, delivery: &mut Delivery, label: Label, bytes: &[u8]) -> Result<(), SendError> {
        let before = delivery.last.filter(|last| last.instance == label.instance);
        let next = before.map_or(0, |last| last.number).wrapping_add(1);
        if self.flow == Flow::Lossless && label.number != next {
            // What has been delivered is acknowledged again: the acknowledgement may be lost.
            delivery.unacknowledged += u32::from(before.is_some());
            return Ok(());
        }
        delivery.last = Some(label);
        delivery.unacknowledged += u32::from(self.flow != Flow::Free);
        let mut assembly = std::mem::take(&mut delivery.assembly);
        let whole = assembly.add(label, bytes);
        let delivered = whole.map_or(Ok(()), |message| self.deliver(delivery, message));
        delivery.assembly = assembly;
        delivered
    }

    /// Writes one message, or keeps it until there is room.
    fn deliver(&self, delivery: &mut Delivery, message: &[u8]) -> Result<(), SendError> {
        if delivery.waiting.is_empty() {
            let written = self.write(delivery, message);
            if !matches!(written, Err(SendError::NoRoom { .. })) {
                return written;
            }
        }
        if delivery.waiting.len() < WAITING_MAX {
            delivery.waiting.push_back(message.to_vec());
        } else {
            add_one(&self.received.overflowed);
        }
        Ok(())
    }

    fn write(&self, delivery: &mut Delivery, message: &[u8]) -> Result<(), SendError> {
        let counter = match delivery.target.write(message, &self.processes)? {
            Outcome::Written => &self.received.messages,
            Outcome::Malformed => &self.received.malformed,
            Outcome::OfAnotherHost => &self.received.of_another_host,
        };
        add_one(counter);
        Ok(())
    }
}

fn add_one(counter: &AtomicU64) {
    counter.fetch_add(1, Ordering::Relaxed);
}
