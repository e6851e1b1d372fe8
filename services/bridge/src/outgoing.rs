//! Shared memory ▶ link: the messages of one topic, to one other host.

use crate::keys::What;
use crate::link::{Acknowledged, Link};
use crate::piece::{Label, ranges};
use crate::window::Window;
use process::Stop;
use protocol::message::Participant;
use protocol::topic::{OnTopic, Topic};
use protocol::wire;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};
use transport::{ReceiveError, Source};
use zenoh::bytes::ZBytes;

/// Longest sleep: interval between two looks at the window and the stop request.
const PATIENCE: Duration = Duration::from_millis(20);
/// How long messages are still sent after the stop request, if they go on coming.
const DRAINS_WITHIN: Duration = Duration::from_secs(1);
/// In lock step: pieces on their way.
pub(crate) const LOSSLESS_WINDOW: usize = 32;
/// In real time: pieces of a long message on their way. The link is free for a state after them.
const PACED_WINDOW: usize = 2;

/// How the pieces of a topic are sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Flow {
    /// Sent once. What the link does not take is lost.
    Free,
    /// A few pieces at a time, for long messages. A message whose pieces are not acknowledged is
    /// given up if a newer one has come, and else sent again from its begin.
    Paced,
    /// Sent until it is acknowledged. A full window stops the writer in shared memory.
    Lossless,
}

impl Flow {
    /// For `topic`. A robot's driver without a bridge acknowledges nothing: in lock step the plant
    /// and the controller repeat what stays without an answer.
    pub(crate) fn of(topic: Topic, lock_step: bool, to_driver: bool) -> Self {
        match (topic, lock_step) {
            _ if to_driver => Self::Free,
            (_, true) => Self::Lossless,
            (Topic::Snapshot, false) => Self::Paced,
            _ => Self::Free,
        }
    }

    /// Whether the other host acknowledges pieces.
    fn is_acknowledged(self) -> bool {
        self != Self::Free
    }

    fn window(self) -> usize {
        match self {
            Self::Free => usize::MAX,
            Self::Paced => PACED_WINDOW,
            Self::Lossless => LOSSLESS_WINDOW,
        }
    }
}

/// Counters of one topic to one host.
#[derive(Debug, Default)]
pub(crate) struct Sent {
    /// Messages.
    pub(crate) messages: AtomicU64,
    /// Messages that were given up on their way.
    pub(crate) given_up: AtomicU64,
}

/// The parts that the thread of a topic uses.
pub(crate) struct Outgoing<'a> {
    pub(crate) topic: Topic,
    pub(crate) flow: Flow,
    pub(crate) link: &'a Link,
    pub(crate) acknowledged: &'a Acknowledged,
    /// How often the other host has connected: it then gets the last message again.
    pub(crate) connections: &'a AtomicU64,
    pub(crate) sent: &'a Sent,
    pub(crate) stop: &'a Stop,
    /// This bridge.
    pub(crate) instance: u64,
    /// The processes of this host.
    pub(crate) processes: &'a [Participant],
}

impl Outgoing<'_> {
    /// Sends until the stop request. Of the messages that other hosts have sent, none goes out
    /// again.
    pub(crate) fn run<T: OnTopic>(&self, mut source: Source<T>) -> Result<(), ReceiveError> {
        self.acknowledged.wake_this_thread();
        let mut pieces = Pieces {
            outgoing: self,
            window: Window::new(self.flow.window(), Instant::now()),
            number: 0,
            message: Vec::new(),
            is_lost: false,
            stopped: None,
        };
        let has_history = self.topic.quality(false).history > 0 && self.flow != Flow::Lossless;
        let mut connections = self.connections.load(Ordering::Relaxed);
        loop {
            let again = self.connections.load(Ordering::Relaxed);
            if again != connections && has_history && !pieces.message.is_empty() {
                pieces.send();
            }
            connections = again;
            pieces.tend();
            let is_read = !pieces.window.is_full() && source.wait(PATIENCE)?;
            if is_read && let Some(message) = source.next()? {
                if self.is_of_this_host(&message) {
                    if pieces.is_lost {
                        self.sent.given_up.fetch_add(1, Ordering::Relaxed);
                    }
                    wire::encode(&message, &mut pieces.message);
                    pieces.send();
                    self.sent.messages.fetch_add(1, Ordering::Relaxed);
                }
            } else if pieces.is_lost {
                pieces.send();
            } else if pieces.window.is_full() {
                thread::park_timeout(PATIENCE);
            }
            let is_idle = !is_read && (pieces.window.is_empty() || self.flow != Flow::Lossless);
            if pieces.is_over() || is_idle && pieces.stopped.is_some() {
                return Ok(());
            }
        }
    }

    /// Whether a process of this host sent it. Each host has a bridge: of their heartbeats only the
    /// own one is.
    fn is_of_this_host<T: OnTopic>(&self, message: &T) -> bool {
        message.publisher().is_some_and(|from| match from {
            Participant::Bridge => message.stamp().writer == self.instance,
            from => self.processes.contains(&from),
        })
    }
}

/// The pieces of the messages of one topic.
struct Pieces<'a> {
    outgoing: &'a Outgoing<'a>,
    window: Window,
    /// Number of the last piece.
    number: u64,
    /// The last message, encoded.
    message: Vec<u8>,
    /// Whether not all of its pieces were acknowledged in time.
    is_lost: bool,
    /// Time of the stop request.
    stopped: Option<Instant>,
}

impl Pieces<'_> {
    /// Whether the stop request is so old that nothing is sent any more.
    fn is_over(&mut self) -> bool {
        if self.outgoing.stop.requested() {
            self.stopped.get_or_insert_with(Instant::now);
        }
        self.stopped.is_some_and(|since| since.elapsed() >= DRAINS_WITHIN)
    }

    /// Sends the message, piece by piece.
    fn send(&mut self) {
        self.is_lost = false;
        let length = u32::try_from(self.message.len()).unwrap_or(u32::MAX);
        for range in ranges(self.message.len()) {
            while self.window.is_full() {
                thread::park_timeout(PATIENCE);
                if self.tend() || self.is_over() {
                    return;
                }
            }
            self.number += 1;
            let offset = u32::try_from(range.start).unwrap_or(u32::MAX);
            let Outgoing { instance, link, flow, topic, .. } = *self.outgoing;
            let label = Label { instance, number: self.number, offset, length };
            let bytes = ZBytes::from(self.message.get(range).unwrap_or_default());
            if flow.is_acknowledged() {
                self.window.add(label, bytes.clone(), Instant::now());
            }
            link.put(What::Data(topic), bytes, Some(label));
        }
    }

    /// Drops what is acknowledged from the window, and handles what is lost. True if the message
    /// was.
    fn tend(&mut self) -> bool {
        let now = Instant::now();
        self.window.acknowledge(self.outgoing.acknowledged.through(), now);
        if !self.window.is_overdue(now) {
            return false;
        }
        if self.outgoing.flow == Flow::Paced {
            self.window.clear();
            self.is_lost = true;
            return true;
        }
        for (label, bytes) in self.window.again(now) {
            self.outgoing.link.put(What::Data(self.outgoing.topic), bytes.clone(), Some(*label));
        }
        false
    }
}
