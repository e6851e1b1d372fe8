//! Transport of messages: [`Sink`] and [`Source`] over every carrier.
//!
//! | file             | what it holds                                                           |
//! |------------------|-------------------------------------------------------------------------|
//! | `links`          | [`Links`]: how the links of one graph run, as a setting                 |
//! | `error`          | one error enum per operation                                            |
//! | `sink`, `source` | stamping, sequence, decoding, counting: written once, for every carrier |
//! | `sequence`       | latest message of each writer: what is lost and what is stale           |
//! | `carrier`        | what a carrier must do: move bytes                                      |
//! | `memory`         | the carrier inside one process, for tests and experiments               |
//! | `shared_memory`  | the carrier between the processes of one machine, over iceoryx2         |
//! | `faults`         | what is lost, delayed and damaged on purpose, with the feature `faults` |
//! | `watched`        | in lock step, the second sender for those who only look on              |
//!
//! ```
//! use protocol::message::Credit;
//! use transport::{Exchange, Identity, Ports, Since};
//! use std::time::Duration;
//!
//! let exchange = Exchange::new(false, Duration::from_secs(1));
//! let ports = Ports::in_memory(&exchange, Identity::new(1));
//! let mut source = ports.source::<Credit>(Since::First)?;
//! let mut sink = ports.sink::<Credit>()?;
//!
//! let mut credit: Credit = bytemuck::Zeroable::zeroed();
//! credit.through_tick = 7;
//! sink.send(&mut credit)?;
//! assert!(source.wait(Duration::from_secs(1))?);
//! assert_eq!(source.next()?.map(|credit| credit.through_tick), Some(7));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod carrier;
mod error;
#[cfg(feature = "faults")]
mod faults;
mod links;
mod memory;
mod sequence;
mod shared_memory;
mod sink;
mod source;
mod watched;

pub use error::{OpenError, ReceiveError, SendError};
#[cfg(feature = "faults")]
pub use faults::{End, Fault, Faults, ImpossibleFault, Kind};
pub use links::{GRAPH_NAME_MAX, Links, is_graph_name};
pub use memory::Exchange;
pub use sequence::Since;
pub use shared_memory::{HalfMade, SweepReport, claim, sweep};
pub use sink::{RawSink, Sink};
pub use source::{Source, Tally};

use carrier::{Receiver, Sender};
#[cfg(feature = "faults")]
use faults::Injection;
use protocol::message::Message;
use protocol::topic::{OnTopic, Topic};
use shared_memory::SharedMemory;
use std::hash::{BuildHasher, Hasher, RandomState};
use watched::{Audience, Watched};

/// Longest first message that a shared-memory link reserves room for; longer ones make it grow
/// \[bytes\].
const RESERVED_BYTES_MAX: usize = 64 * 1024;

/// The identity of a writer: one process instance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Drawn at random when the process starts; never 0.
    pub writer: u64,
    /// How often its role has been started.
    pub epoch: u64,
}

impl Identity {
    /// A new process instance in `epoch`.
    pub fn new(epoch: u64) -> Self {
        let mut hasher = RandomState::new().build_hasher();
        hasher.write_u32(std::process::id());
        hasher.write_u64(protocol::clock::monotonic_nanos());
        Self { writer: hasher.finish().max(1), epoch }
    }
}

/// Opens ports. They can move to another thread.
pub struct Ports {
    place: Place,
    identity: Identity,
    /// The faults to inject, if any.
    #[cfg(feature = "faults")]
    injection: Option<Injection>,
}

/// Links that exist as long as this value, while processes join and leave.
pub struct HeldLinks(#[expect(dead_code, reason = "held, not used")] Vec<shared_memory::Held>);

/// Where the ports meet.
enum Place {
    /// In this process.
    Here(Exchange),
    /// In the shared memory of this machine.
    Machine { lock_step: bool, shared: SharedMemory },
}

impl Ports {
    /// Joins the graph that `links` names, in the shared memory of this machine.
    ///
    /// Nothing outside the graph's own prefix and root is read or written, and no signal handler is
    /// installed.
    ///
    /// # Errors
    /// [`OpenError`] if the name or the root cannot be used, or a carrier is not available.
    pub fn open(links: &Links, identity: Identity) -> Result<Self, OpenError> {
        links.check()?;
        let lock_step = links.lock_step;
        Ok(Self {
            place: Place::Machine { lock_step, shared: SharedMemory::open(links)? },
            identity,
            #[cfg(feature = "faults")]
            injection: Injection::new(&links.faults, lock_step),
        })
    }

    /// Ports between the threads of one process.
    pub fn in_memory(exchange: &Exchange, identity: Identity) -> Self {
        Self {
            place: Place::Here(exchange.clone()),
            identity,
            #[cfg(feature = "faults")]
            injection: None,
        }
    }

    /// Ports between the threads of one process, on which `faults` are injected. A fault that
    /// [`Faults::check`] refuses may have no effect.
    #[cfg(feature = "faults")]
    pub fn in_memory_with(exchange: &Exchange, identity: Identity, faults: &Faults) -> Self {
        Self {
            injection: Injection::new(faults, exchange.lock_step()),
            ..Self::in_memory(exchange, identity)
        }
    }

    /// How often each fault has been injected so far on the open ports, in the order of the
    /// settings.
    #[cfg(feature = "faults")]
    pub fn injected(&self) -> Vec<u64> {
        self.injection.as_ref().map_or_else(Vec::new, Injection::injected)
    }

    /// Makes every missing link of shared memory, and holds all of them until the returned value is
    /// dropped.
    ///
    /// A process that is killed while it makes a link leaves a link that no process can open or
    /// make again. So a process that outlives the others makes all links before any other process
    /// joins.
    ///
    /// # Errors
    /// [`OpenError`] if a link cannot be made, or exists with another message, version or quality.
    pub fn hold_links(&self) -> Result<HeldLinks, OpenError> {
        let Place::Machine { lock_step, shared } = &self.place else {
            return Ok(HeldLinks(Vec::new()));
        };
        let services = Topic::ALL.into_iter().flat_map(|topic| {
            let watchers =
                Audience::is_split(topic, *lock_step).then_some((topic, Audience::Watchers));
            std::iter::once((topic, Audience::Members)).chain(watchers)
        });
        services
            .map(|(topic, audience)| shared.hold(topic, audience))
            .collect::<Result<_, _>>()
            .map(HeldLinks)
    }

    /// Opens a writer of `T` on its topic.
    ///
    /// # Errors
    /// [`OpenError`] if the link exists with another message, version or quality, or has no place
    /// for one more writer.
    pub fn sink<T: OnTopic>(&self) -> Result<Sink<T>, OpenError> {
        let sender = self.sender(T::TOPIC, Reservation::of::<T>())?;
        #[cfg(feature = "faults")]
        let sender = match &self.injection {
            Some(injection) => injection.around_sender::<T>(sender),
            None => sender,
        };
        Ok(Sink::new(sender, self.identity))
    }

    /// Opens a reader of `T` on its topic.
    ///
    /// # Errors
    /// [`OpenError`] if the link exists with another message, version or quality, or has no place
    /// for one more reader.
    pub fn source<T: OnTopic>(&self, since: Since) -> Result<Source<T>, OpenError> {
        let receiver = self.receiver(T::TOPIC, Audience::Members)?;
        #[cfg(feature = "faults")]
        let receiver = match &self.injection {
            Some(injection) => injection.around_receiver::<T>(receiver),
            None => receiver,
        };
        Ok(Source::new(receiver, since))
    }

    /// Opens a reader of `T` for a watcher, which no writer waits for: the newest messages win, in
    /// lock step too.
    ///
    /// # Errors
    /// As for [`source`](Self::source).
    pub fn watcher<T: OnTopic>(&self) -> Result<Source<T>, OpenError> {
        Ok(Source::new(self.receiver(T::TOPIC, Audience::Watchers)?, Since::Joining))
    }

    /// Opens a writer of arbitrary bytes, to test how readers handle them.
    ///
    /// # Errors
    /// As for [`sink`](Self::sink).
    pub fn raw_sink(&self, topic: Topic) -> Result<RawSink, OpenError> {
        Ok(RawSink::new(self.sender(topic, Reservation::Growing)?))
    }

    fn sender(
        &self,
        topic: Topic,
        reservation: Reservation,
    ) -> Result<Box<dyn Sender + Send>, OpenError> {
        match &self.place {
            Place::Here(exchange) => Ok(Box::new(exchange.sender(topic)?)),
            Place::Machine { lock_step, shared } if Audience::is_split(topic, *lock_step) => {
                Ok(Box::new(Watched {
                    members: shared.sender(topic, Audience::Members, reservation)?,
                    watchers: shared.sender(topic, Audience::Watchers, reservation)?,
                }))
            }
            Place::Machine { shared, .. } => {
                Ok(Box::new(shared.sender(topic, Audience::Members, reservation)?))
            }
        }
    }

    fn receiver(
        &self,
        topic: Topic,
        audience: Audience,
    ) -> Result<Box<dyn Receiver + Send>, OpenError> {
        match &self.place {
            Place::Here(exchange) => Ok(Box::new(exchange.receiver(topic, audience)?)),
            Place::Machine { lock_step, shared } => {
                let audience = if Audience::is_split(topic, *lock_step) {
                    audience
                } else {
                    Audience::Members
                };
                Ok(Box::new(shared.receiver(topic, audience)?))
            }
        }
    }
}

/// What a link holds ready for each message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Reservation {
    /// Room for the longest possible message, reserved once \[bytes\].
    Whole(usize),
    /// [`RESERVED_BYTES_MAX`], doubled whenever a longer message is sent.
    Growing,
}

impl Reservation {
    fn of<T: Message>() -> Self {
        if T::BYTES_MAX <= RESERVED_BYTES_MAX { Self::Whole(T::BYTES_MAX) } else { Self::Growing }
    }
}
