//! Link ▶ shared memory: the messages of one topic, from one other host.

use crate::link::Link;
use crate::outgoing::{Flow, LOSSLESS_WINDOW};
use crate::piece::{Assembly, Label};
use crate::rate::Rate;
use crossbeam_queue::ArrayQueue;
use process::Stop;
use protocol::message::Participant;
use protocol::topic::{OnTopic, Topic};
use protocol::wire;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::thread::{self, Thread};
use std::time::{Duration, Instant};
use transport::{OpenError, Ports, SendError, Sink};
use zenoh::bytes::ZBytes;
use zenoh::sample::Sample;

/// Longest sleep: interval between two looks at the stop request.
const PATIENCE: Duration = Duration::from_millis(20);
/// Interval between two looks for late joiners.
const JOINS_EVERY: Duration = Duration::from_millis(100);
/// In lock step: pieces for one acknowledgement, a part of the window. It comes earlier if no piece
/// follows.
const ACKNOWLEDGED_TOGETHER: u32 = LOSSLESS_WINDOW as u32 / 4;
/// Pieces that can wait.
const DEPTH: usize = 256;

/// Why pieces were not delivered: counters of one topic from one host.
#[derive(Debug, Default)]
pub(crate) struct Received {
    /// Messages delivered.
    pub(crate) messages: AtomicU64,
    /// Pieces above the largest rate.
    pub(crate) too_many: AtomicU64,
    /// Pieces for which the queue had no room.
    pub(crate) overflowed: AtomicU64,
    /// Messages that are none.
    pub(crate) malformed: AtomicU64,
    /// Messages in the name of a process that is not on that host.
    pub(crate) of_another_host: AtomicU64,
}

/// A piece, as it arrived. A message without a label is whole.
#[derive(Debug)]
struct Piece {
    label: Option<Label>,
    bytes: ZBytes,
}

/// Pieces that wait for the thread of their topic.
#[derive(Debug)]
pub(crate) struct Queue {
    pieces: ArrayQueue<Piece>,
    /// The largest rate; none in lock step.
    rate: Option<Mutex<Rate>>,
    pub(crate) received: Received,
    reader: OnceLock<Thread>,
}

impl Queue {
    pub(crate) fn new(rate: Option<Rate>) -> Self {
        Self {
            pieces: ArrayQueue::new(DEPTH),
            rate: rate.map(Mutex::new),
            received: Received::default(),
            reader: OnceLock::new(),
        }
    }

    /// Takes a piece in from the thread that reads the link. Never waits: above the largest rate it
    /// is counted and dropped, and if there is no room the oldest piece is.
    pub(crate) fn offer(&self, sample: &Sample) {
        if let Some(rate) = &self.rate {
            let mut rate = rate.lock().unwrap_or_else(PoisonError::into_inner);
            if !rate.accepts(Instant::now()) {
                self.received.too_many.fetch_add(1, Ordering::Relaxed);
                return;
            }
        }
        let label = match sample.attachment() {
            None => None,
            Some(bytes) => {
                let Some(label) = Label::of(&bytes.to_bytes()) else {
                    self.received.malformed.fetch_add(1, Ordering::Relaxed);
                    return;
                };
                Some(label)
            }
        };
        let piece = Piece { label, bytes: sample.payload().clone() };
        if self.pieces.force_push(piece).is_some() {
            self.received.overflowed.fetch_add(1, Ordering::Relaxed);
        }
        if let Some(reader) = self.reader.get() {
            reader.unpark();
        }
    }
}

/// The parts that the thread of a topic uses.
pub(crate) struct Incoming<'a> {
    pub(crate) topic: Topic,
    pub(crate) flow: Flow,
    pub(crate) link: &'a Link,
    pub(crate) queue: &'a Queue,
    pub(crate) stop: &'a Stop,
    /// The processes of the other host.
    pub(crate) processes: &'a [Participant],
}

/// The topic cannot be delivered any longer.
#[derive(Debug, thiserror::Error)]
pub enum IncomingError {
    /// The link in shared memory cannot be opened.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// It cannot be written.
    #[error(transparent)]
    Send(#[from] SendError),
}

impl Incoming<'_> {
    /// Delivers until the stop request. Reports on `opened` when the link in shared memory is open.
    pub(crate) fn run<T: OnTopic>(
        &self,
        ports: &Ports,
        opened: impl FnOnce(),
    ) -> Result<(), IncomingError> {
        let _ = self.queue.reader.set(thread::current());
        let mut delivery = Delivery {
            lane: self,
            sink: ports.sink::<T>()?,
            assembly: Assembly::default(),
            last: None,
            unacknowledged: 0,
        };
        opened();
        let (mut refreshed, mut taken) = (Instant::now(), Instant::now());
        while !self.stop.requested() {
            while let Some(piece) = self.queue.pieces.pop() {
                delivery.take(&piece)?;
                taken = Instant::now();
            }
            if taken.elapsed() >= PATIENCE {
                delivery.acknowledge();
            }
            if refreshed.elapsed() >= JOINS_EVERY {
                delivery.sink.refresh()?;
                refreshed = Instant::now();
            }
            thread::park_timeout(PATIENCE);
        }
        Ok(())
    }
}

/// The messages of one topic on their way into shared memory.
struct Delivery<'a, T> {
    lane: &'a Incoming<'a>,
    sink: Sink<T>,
    assembly: Assembly,
    /// In lock step: the last piece that was delivered.
    last: Option<Label>,
    /// Pieces since the last acknowledgement.
    unacknowledged: u32,
}

impl<T: OnTopic> Delivery<'_, T> {
    fn take(&mut self, piece: &Piece) -> Result<(), SendError> {
        let bytes = piece.bytes.to_bytes();
        let Some(label) = piece.label else { return self.deliver(&bytes) };
        let flow = self.lane.flow;
        if flow == Flow::Lossless && !self.follows(label) {
            // What has been delivered is acknowledged again: the acknowledgement may be lost.
            if self.last.is_some_and(|last| last.instance == label.instance) {
                self.unacknowledged += 1;
            }
            return Ok(());
        }
        let mut assembly = std::mem::take(&mut self.assembly);
        let delivered = match assembly.add(label, &bytes) {
            Some(message) => self.deliver(message),
            None => Ok(()),
        };
        self.assembly = assembly;
        delivered?;
        self.last = Some(label);
        self.unacknowledged += 1;
        if flow == Flow::Paced || self.unacknowledged >= ACKNOWLEDGED_TOGETHER {
            self.acknowledge();
        }
        Ok(())
    }

    /// Acknowledges all pieces so far, unless they are already.
    fn acknowledge(&mut self) {
        let Incoming { flow, link, topic, .. } = *self.lane;
        let Some(last) = self.last.filter(|_| self.unacknowledged > 0) else { return };
        self.unacknowledged = 0;
        if flow.is_acknowledged() {
            link.acknowledge(topic, last);
        }
    }

    /// Whether it is the piece behind the last one.
    fn follows(&self, label: Label) -> bool {
        let before = self.last.filter(|last| last.instance == label.instance);
        label.number == before.map_or(0, |last| last.number) + 1
    }

    /// Writes one message into shared memory, with its own stamp, if it is one of the other host.
    fn deliver(&mut self, bytes: &[u8]) -> Result<(), SendError> {
        let received = &self.lane.queue.received;
        let Ok(message) = wire::decode::<T>(bytes) else {
            received.malformed.fetch_add(1, Ordering::Relaxed);
            return Ok(());
        };
        let is_there = message.publisher().is_some_and(|from| self.lane.processes.contains(&from));
        if !is_there {
            received.of_another_host.fetch_add(1, Ordering::Relaxed);
            return Ok(());
        }
        self.sink.send_stamped(&message)?;
        received.messages.fetch_add(1, Ordering::Relaxed);
        Ok(())
    }
}
