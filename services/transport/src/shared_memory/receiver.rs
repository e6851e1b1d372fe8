//! One reader on shared memory: reads messages in place, and sleeps until there is one.

use super::alarm::{Alarm, Slept};
use super::service::{Announcement, Events};
use super::{CLEANUP_TIMEOUT, SharedMemory};
use crate::carrier::Receiver;
use crate::{Audience, OpenError, ReceiveError};
use iceoryx2::port::subscriber::{Subscriber, SubscriberCreateError};
use iceoryx2::prelude::ipc_threadsafe;
use protocol::topic::Topic;
use std::time::{Duration, Instant};

pub(crate) struct SharedMemoryReceiver {
    topic: Topic,
    subscriber: Subscriber<ipc_threadsafe::Service, [u64], ()>,
    events: Events,
    /// Made by the first wait, so that a reader which never waits collects no events.
    alarm: Option<Alarm>,
}

impl SharedMemoryReceiver {
    pub(super) fn open(
        shared: &SharedMemory,
        topic: Topic,
        audience: Audience,
    ) -> Result<Self, OpenError> {
        let (messages, events) = shared.services(topic, audience, &Announcement::of(topic))?;
        let limit = shared.quality(topic, audience).readers;
        let create = || messages.subscriber_builder().create();
        // Dead members hold their places until a process removes them.
        let subscriber = create().or_else(|_| {
            shared.node.blocking_cleanup_dead_nodes(CLEANUP_TIMEOUT);
            create()
        });
        let subscriber = subscriber.map_err(|error| match error {
            SubscriberCreateError::ExceedsMaxSupportedSubscribers => {
                OpenError::Full { topic, role: "readers", limit }
            }
            other => OpenError::Carrier { topic, reason: other.to_string() },
        })?;
        Ok(Self { topic, subscriber, events, alarm: None })
    }

    fn failure(&self, reason: &'static str) -> ReceiveError {
        ReceiveError::Carrier { topic: self.topic, reason }
    }

    /// Sleeps from event to event until a message waits: an event may belong to a message that has
    /// been taken already.
    fn wait_for_message(
        &self,
        alarm: &Alarm,
        deadline: Option<Instant>,
    ) -> Result<bool, ReceiveError> {
        loop {
            // The reset comes before the check, and writers send before they notify: no message is
            // missed between the two.
            alarm.reset().map_err(|reason| self.failure(reason))?;
            if self.something_waits()? {
                return Ok(true);
            }
            let left = deadline.map_or(Duration::MAX, |deadline| {
                deadline.saturating_duration_since(Instant::now())
            });
            if left.is_zero() {
                return Ok(false);
            }
            if alarm.sleep(left).map_err(|reason| self.failure(reason))? == Slept::Interrupted {
                return self.something_waits();
            }
        }
    }

    fn something_waits(&self) -> Result<bool, ReceiveError> {
        self.subscriber.has_samples().map_err(|_| self.failure("a writer could not be connected"))
    }
}

impl Receiver for SharedMemoryReceiver {
    fn receive(&mut self, visit: &mut dyn FnMut(&[u8])) -> Result<bool, ReceiveError> {
        let received = self
            .subscriber
            .receive()
            .map_err(|_| self.failure("a writer could not be connected"))?;
        Ok(received.is_some_and(|sample| {
            visit(bytemuck::cast_slice(sample.payload()));
            true
        }))
    }

    fn wait(&mut self, timeout: Duration) -> Result<bool, ReceiveError> {
        if self.something_waits()? {
            return Ok(true);
        }
        let deadline = Instant::now().checked_add(timeout);
        let alarm = match self.alarm.take() {
            Some(alarm) => alarm,
            None => Alarm::new(&self.events).map_err(|reason| self.failure(reason))?,
        };
        let waited = self.wait_for_message(&alarm, deadline);
        self.alarm = Some(alarm);
        waited
    }
}
