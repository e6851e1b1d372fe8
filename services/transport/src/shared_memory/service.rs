//! The two services of a topic: the messages, and the events that wake their readers.

use super::SharedMemory;
use crate::{Audience, OpenError};
use iceoryx2::prelude::{
    AttributeVerifier, EventId, MessagingPattern, Node, Service, ServiceName, ipc_threadsafe,
};
use iceoryx2::service::attribute::{AttributeKey, AttributeSet, AttributeValue};
use iceoryx2::service::builder::event::{EventCreateError, EventOpenError, EventOpenOrCreateError};
use iceoryx2::service::builder::publish_subscribe::{
    PublishSubscribeCreateError, PublishSubscribeOpenError, PublishSubscribeOpenOrCreateError,
};
use iceoryx2::service::port_factory::{event, publish_subscribe};
use protocol::VERSION;
use protocol::topic::{Delivery, Quality, Topic};
use std::thread::sleep;
use std::time::Duration;

pub(super) type Messages = publish_subscribe::PortFactory<ipc_threadsafe::Service, [u64], ()>;
pub(super) type Events = event::PortFactory<ipc_threadsafe::Service>;

const MESSAGE_KEY: &str = "message";
const VERSION_KEY: &str = "version";

/// Attempts for a service that another process is just making or removing, and the pause between
/// two of them.
const ATTEMPTS: u32 = 200;
const ATTEMPT_PAUSE: Duration = Duration::from_millis(5);

/// The attributes of a service.
pub(super) struct Announcement {
    pub(super) message: String,
    pub(super) version: String,
}

impl Announcement {
    pub(super) fn of(topic: Topic) -> Self {
        Self { message: topic.message().to_owned(), version: VERSION.to_string() }
    }
}

impl SharedMemory {
    /// Opens or makes the services of `topic`.
    pub(super) fn services(
        &self,
        topic: Topic,
        audience: Audience,
        announcement: &Announcement,
    ) -> Result<(Messages, Events), OpenError> {
        let failed = |reason: String| OpenError::Carrier { topic, reason };
        let suffix = match audience {
            Audience::Members => "",
            Audience::Watchers => "/watched",
        };
        let name = format!("coxswain/{}/{}{suffix}", self.graph, topic.name());
        let name = ServiceName::new(&name).map_err(|error| failed(error.to_string()))?;
        let quality = self.quality(topic, audience);
        let attributes = announced(announcement)
            .ok_or_else(|| failed("its attributes are too long".to_owned()))?;

        let messages = retried(
            || open_messages(&self.node, &name, quality, &attributes),
            is_messages_transient,
        );
        let messages = messages.map_err(|error| match error {
            PublishSubscribeOpenOrCreateError::PublishSubscribeOpenError(error) => {
                self.refusal(topic, &name, error, announcement)
            }
            other => failed(other.to_string()),
        })?;
        let events = retried(|| open_events(&self.node, &name, quality), is_events_transient);
        Ok((messages, events.map_err(|error| failed(error.to_string()))?))
    }

    /// Finds the difference that prevented a service from being opened.
    fn refusal(
        &self,
        topic: Topic,
        name: &ServiceName,
        error: PublishSubscribeOpenError,
        ours: &Announcement,
    ) -> OpenError {
        match error {
            PublishSubscribeOpenError::IncompatibleAttributes => {
                let details = ipc_threadsafe::Service::details(
                    name,
                    self.node.config(),
                    MessagingPattern::PublishSubscribe,
                );
                let details = details.ok().flatten();
                let found = |key| {
                    let found = details
                        .as_ref()
                        .and_then(|details| value(details.static_details.attributes(), key));
                    found.unwrap_or_else(|| "unknown".to_owned())
                };
                OpenError::Incompatible {
                    topic,
                    message: ours.message.clone(),
                    version: ours.version.clone(),
                    found_message: found(MESSAGE_KEY),
                    found_version: found(VERSION_KEY),
                }
            }
            PublishSubscribeOpenError::IncompatibleOverflowBehavior => {
                OpenError::Delivery { topic, delivery: topic.quality(self.lock_step).delivery }
            }
            PublishSubscribeOpenError::IncompatibleTypes
            | PublishSubscribeOpenError::DoesNotSupportRequestedMinBufferSize
            | PublishSubscribeOpenError::DoesNotSupportRequestedMinHistorySize
            | PublishSubscribeOpenError::DoesNotSupportRequestedMinSubscriberBorrowedSamples
            | PublishSubscribeOpenError::DoesNotSupportRequestedAmountOfPublishers
            | PublishSubscribeOpenError::DoesNotSupportRequestedAmountOfSubscribers
            | PublishSubscribeOpenError::DoesNotSupportRequestedAmountOfNodes => {
                OpenError::Quality { topic, reason: error.to_string() }
            }
            other => OpenError::Carrier { topic, reason: other.to_string() },
        }
    }
}

fn open_messages(
    node: &Node<ipc_threadsafe::Service>,
    name: &ServiceName,
    quality: Quality,
    attributes: &AttributeVerifier,
) -> Result<Messages, PublishSubscribeOpenOrCreateError> {
    node.service_builder(name)
        .publish_subscribe::<[u64]>()
        .subscriber_max_buffer_size(quality.depth)
        .subscriber_max_borrowed_samples(1)
        .history_size(quality.history)
        .max_publishers(quality.writers)
        .max_subscribers(quality.readers)
        .max_nodes(nodes_max(quality))
        .enable_safe_overflow(quality.delivery == Delivery::NewestWins)
        .open_or_create_with_attributes(attributes)
}

fn open_events(
    node: &Node<ipc_threadsafe::Service>,
    name: &ServiceName,
    quality: Quality,
) -> Result<Events, EventOpenOrCreateError> {
    node.service_builder(name)
        .event()
        .max_notifiers(quality.writers)
        .max_listeners(quality.readers)
        .max_nodes(nodes_max(quality))
        .event_id_max_value(0)
        // A new writer wakes its readers too, so that they connect before it sends much.
        .notifier_created_event(EventId::new(0))
        .open_or_create()
}

/// Every port may be in a process of its own, and some processes may be dead and not yet cleaned
/// up.
fn nodes_max(quality: Quality) -> usize {
    2 * (quality.writers + quality.readers)
}

fn announced(announcement: &Announcement) -> Option<AttributeVerifier> {
    let key = |name: &str| AttributeKey::try_from(name).ok();
    let value = |text: &str| AttributeValue::try_from(text).ok();
    AttributeVerifier::new()
        .require(&key(MESSAGE_KEY)?, &value(&announcement.message)?)
        .ok()?
        .require(&key(VERSION_KEY)?, &value(&announcement.version)?)
        .ok()
}

fn value(attributes: &AttributeSet, key: &str) -> Option<String> {
    let key = AttributeKey::try_from(key).ok()?;
    attributes.key_value(&key, 0).map(ToString::to_string)
}

/// Repeats `open` while its failure is temporary.
fn retried<S, E: Copy>(
    open: impl Fn() -> Result<S, E>,
    passes: impl Fn(E) -> bool,
) -> Result<S, E> {
    for _ in 1..ATTEMPTS {
        match open() {
            Err(error) if passes(error) => sleep(ATTEMPT_PAUSE),
            result => return result,
        }
    }
    open()
}

fn is_messages_transient(error: PublishSubscribeOpenOrCreateError) -> bool {
    use PublishSubscribeOpenOrCreateError as E;
    matches!(
        error,
        E::SystemInFlux
            | E::PublishSubscribeOpenError(
                PublishSubscribeOpenError::IsMarkedForDestruction
                    | PublishSubscribeOpenError::DoesNotExist
                    | PublishSubscribeOpenError::HangsInCreation
                    | PublishSubscribeOpenError::Interrupt
            )
            | E::PublishSubscribeCreateError(
                PublishSubscribeCreateError::AlreadyExists
                    | PublishSubscribeCreateError::IsBeingCreatedByAnotherInstance
                    | PublishSubscribeCreateError::Interrupt
            )
    )
}

fn is_events_transient(error: EventOpenOrCreateError) -> bool {
    use EventOpenOrCreateError as E;
    matches!(
        error,
        E::SystemInFlux
            | E::EventOpenError(
                EventOpenError::IsMarkedForDestruction
                    | EventOpenError::DoesNotExist
                    | EventOpenError::HangsInCreation
                    | EventOpenError::Interrupt
            )
            | E::EventCreateError(
                EventCreateError::AlreadyExists
                    | EventCreateError::IsBeingCreatedByAnotherInstance
                    | EventCreateError::Interrupt
            )
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Links, sweep};
    use std::error::Error;

    #[test]
    fn a_program_of_another_version_or_message_is_refused_with_both_named()
    -> Result<(), Box<dyn Error>> {
        let folder = tempfile::tempdir()?;
        let links = Links::on_this_machine(
            format!("v{}", std::process::id()),
            folder.path().join("r"),
            false,
            100,
        );
        let shared = SharedMemory::open(&links)?;
        let services = shared.services(
            Topic::Command,
            Audience::Members,
            &Announcement::of(Topic::Command),
        )?;
        let newer = Announcement { version: "7001".to_owned(), ..Announcement::of(Topic::Command) };
        let other =
            Announcement { message: "Sonnet".to_owned(), ..Announcement::of(Topic::Command) };
        let sonnet = format!("Sonnet in version {VERSION}");
        for (announcement, ours) in [(newer, "Command in version 7001"), (other, sonnet.as_str())] {
            let refused = shared
                .services(Topic::Command, Audience::Members, &announcement)
                .map(drop)
                .map_err(|error| error.to_string());
            let expected = format!(
                "topic command carries Command in protocol version {VERSION}, this program expects \
                {ours}"
            );
            assert_eq!(refused, Err(expected));
        }
        drop((services, shared));
        sweep(&links)?;
        Ok(())
    }
}
