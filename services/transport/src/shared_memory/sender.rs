//! One writer on shared memory: loans a sample, lets the message be written in place, sends, and
//! wakes the readers.

use super::service::{Announcement, Messages};
use super::{CLEANUP_TIMEOUT, SharedMemory};
use crate::carrier::Sender;
use crate::{Audience, OpenError, RESERVED_BYTES_MAX, Reservation, SendError};
use iceoryx2::port::notifier::{Notifier, NotifierCreateError};
use iceoryx2::port::publisher::{Publisher, PublisherCreateError};
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::port::{BackpressureAction, SendError as CarrierError};
use iceoryx2::prelude::{AllocationStrategy, Node, PortFactory, ipc_threadsafe};
use protocol::clock::monotonic_nanos;
use protocol::topic::{Delivery, Topic};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::sleep;
use std::time::Duration;

/// How long a lossless writer sleeps before it checks again for room.
const ROOM_PAUSE: Duration = Duration::from_micros(50);

/// How long it sleeps before it tries a reader again that has not connected yet.
const LOOK_PAUSE: Duration = Duration::from_millis(5);

const WORD_BYTES: usize = size_of::<u64>();

pub(crate) struct SharedMemorySender {
    topic: Topic,
    delivery: Delivery,
    messages: Messages,
    publisher: Publisher<ipc_threadsafe::Service, [u64], ()>,
    notifier: Notifier<ipc_threadsafe::Service>,
    node: Arc<Node<ipc_threadsafe::Service>>,
    patience: Duration,
    /// When the present send gives up waiting, on the monotonic clock \[ns\]; one deadline for all
    /// readers together.
    deadline_nanos: Arc<AtomicU64>,
}

impl SharedMemorySender {
    pub(super) fn open(
        shared: &SharedMemory,
        topic: Topic,
        audience: Audience,
        reservation: Reservation,
    ) -> Result<Self, OpenError> {
        let (messages, events) = shared.services(topic, audience, &Announcement::of(topic))?;
        let quality = shared.quality(topic, audience);
        let (bytes, strategy) = match reservation {
            Reservation::Whole(bytes) => (bytes, AllocationStrategy::Static),
            Reservation::Growing => (RESERVED_BYTES_MAX, AllocationStrategy::PowerOfTwo),
        };
        let deadline_nanos = Arc::new(AtomicU64::new(0));
        let create = || {
            let mut builder = messages
                .publisher_builder()
                .max_loaned_samples(1)
                .initial_max_slice_len(bytes.div_ceil(WORD_BYTES))
                .allocation_strategy(strategy);
            if quality.delivery == Delivery::Lossless {
                let deadline_nanos = Arc::clone(&deadline_nanos);
                builder = builder.set_backpressure_handler(move |_| {
                    if monotonic_nanos() >= deadline_nanos.load(Ordering::Relaxed) {
                        return BackpressureAction::DiscardDataAndFail;
                    }
                    sleep(ROOM_PAUSE);
                    BackpressureAction::Retry
                });
            }
            builder.create()
        };
        // Dead members hold their places until a process removes them.
        let publisher = create().or_else(|_| {
            shared.node.blocking_cleanup_dead_nodes(CLEANUP_TIMEOUT);
            create()
        });
        let full = OpenError::Full { topic, role: "writers", limit: quality.writers };
        let publisher = publisher.map_err(|error| match error {
            PublisherCreateError::ExceedsMaxSupportedPublishers => full,
            other => OpenError::Carrier { topic, reason: other.to_string() },
        })?;
        let notifier = events.notifier_builder().create().map_err(|error| match error {
            NotifierCreateError::ExceedsMaxSupportedNotifiers => {
                OpenError::Full { topic, role: "notifiers", limit: quality.writers }
            }
            other => OpenError::Carrier { topic, reason: other.to_string() },
        })?;
        let node = Arc::clone(&shared.node);
        let (delivery, patience) = (quality.delivery, shared.patience);
        Ok(Self { topic, delivery, messages, publisher, notifier, node, patience, deadline_nanos })
    }

    /// Sends to all readers, and returns how many have received the message.
    fn send_once(
        &self,
        length: usize,
        fill: &mut dyn FnMut(&mut [u8]),
    ) -> Result<usize, SendError> {
        let loan = self.publisher.loan_slice(length.div_ceil(WORD_BYTES));
        let mut sample = loan.map_err(|error| self.failure(error.into()))?;
        if let Some(bytes) = bytemuck::cast_slice_mut(sample.payload_mut()).get_mut(..length) {
            fill(bytes);
        }
        let sent = sample.send();
        // Even if one reader had no room, the others have a message to wake up for.
        let woken = self.wake();
        let readers = sent.map_err(|error| self.failure(error))?;
        woken.map(|()| readers)
    }

    fn wake(&self) -> Result<(), SendError> {
        let failed = |_| SendError::Carrier {
            topic: self.topic,
            reason: "the readers could not be notified",
        };
        self.notifier.notify().map(drop).map_err(failed)
    }

    fn failure(&self, error: CarrierError) -> SendError {
        let carrier = |reason| SendError::Carrier { topic: self.topic, reason };
        match error {
            CarrierError::UnableToDeliver => {
                // Either a living reader is too slow, or a dead one holds its place: remove the
                // dead before the next message.
                self.node.blocking_cleanup_dead_nodes(CLEANUP_TIMEOUT);
                SendError::NoRoom { topic: self.topic, waited: self.patience }
            }
            CarrierError::LoanError(_) => carrier("no memory could be loaned"),
            CarrierError::ConnectionError(_) => carrier("a reader could not be connected"),
            CarrierError::ConnectionCorrupted => carrier("the connection to a reader is corrupted"),
            CarrierError::ConnectionBrokenSinceSenderNoLongerExists => {
                carrier("the writer is closed")
            }
            CarrierError::InternalError => carrier("an internal mechanism failed"),
        }
    }
}

impl Sender for SharedMemorySender {
    fn send(&mut self, length: usize, fill: &mut dyn FnMut(&mut [u8])) -> Result<(), SendError> {
        if self.delivery == Delivery::NewestWins {
            return self.send_once(length, fill).map(drop);
        }
        let patience = u64::try_from(self.patience.as_nanos()).unwrap_or(u64::MAX);
        let deadline_nanos = monotonic_nanos().saturating_add(patience);
        self.deadline_nanos.store(deadline_nanos, Ordering::Relaxed);
        // iceoryx2 skips a reader that is full and has not looked since this writer came. The
        // message is sent once more until such a reader has it. The other readers recognise the
        // sequence number, and drop the repetition.
        while self.send_once(length, fill)? < self.messages.dynamic_config().number_of_subscribers()
        {
            if monotonic_nanos() >= deadline_nanos {
                return Err(self.failure(CarrierError::UnableToDeliver));
            }
            sleep(LOOK_PAUSE);
        }
        Ok(())
    }

    fn refresh(&mut self) -> Result<(), SendError> {
        self.publisher.update_connections().map_err(|error| self.failure(error.into()))?;
        self.wake()
    }
}
