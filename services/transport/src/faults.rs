//! Fault injection: a carrier between [`Source`](super::Source) or [`Sink`](super::Sink) and the
//! real one. It loses, delays and damages messages as the settings specify.
//!
//! | file      | what it holds                                                    |
//! |-----------|------------------------------------------------------------------|
//! | `anatomy` | takes a message apart and seals it again                         |
//! | `stage`   | one fault on one link: what it makes of each message             |
//! | `chain`   | all faults of one link, one behind the other, and what they hold |
//! | `carrier` | the receiver and the sender around the real ones                 |
//! | `random`  | the seeded generator that every fault has of its own             |
//!
//! Every decision depends on the seed, the rule, the link and the messages alone, never on a clock.
//! Only the release of a message that is held back for a time depends on one. A reader releases
//! held messages while it waits; a writer releases them with its next message. So delay messages at
//! readers.
//!
//! On a lossless link, in lock step, no message is lost for ever. A withheld message is delivered
//! after the reader has waited in vain for 100 ms, as if the carrier had sent it again, unless a
//! later message has arrived meanwhile. Without that, a single lost command would stop the clock
//! for ever. Such faults must be injected at the reader there, and be counted in messages instead
//! of time.

mod anatomy;
mod carrier;
mod chain;
mod random;
mod stage;

use carrier::{FaultyReceiver, FaultySender};
pub(super) use chain::Chain;

use crate::carrier::{Receiver, Sender};
use protocol::message::Participant;
use protocol::topic::{Delivery, OnTopic, Topic};
use serde::{Deserialize, Serialize};
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Most messages that one fault holds back or remembers: the depth of the deepest link.
const HELD_MAX: usize = 256;
/// Largest count of messages in a setting.
const MESSAGES_MAX: u64 = 64;
/// Longest delay in a setting \[ms\].
const MILLIS_MAX: u64 = 10_000;

/// Which faults are injected, and where. By default there are none, at no cost.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Faults {
    /// Seed of all random choices.
    #[serde(default)]
    pub seed: u64,
    /// The process that these settings are for; set by the launcher. Without it, faults that name
    /// no process apply.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub process: Option<Participant>,
    /// The faults, in the order in which a message passes them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub fault: Vec<Fault>,
}

/// One fault on one link.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fault {
    /// The link.
    pub topic: Topic,
    /// Its end.
    pub at: End,
    /// Only in this process.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub participant: Option<Participant>,
    /// What happens to a message.
    pub kind: Kind,
    /// First tick, by the message's stamp, at which the fault applies.
    #[serde(default)]
    pub from_tick: u64,
    /// First tick at which the fault no longer applies; without it the fault applies to the end.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub until_tick: Option<u64>,
    /// Probability for each message, up to 1.
    #[serde(default = "certain")]
    pub probability: f64,
    /// For `delay` and `jitter`: the delay \[ms\].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub millis: Option<u64>,
    /// For `delay`, `jitter` and `reorder`: how many later messages pass first. For `replay`: how
    /// many messages ago the replayed one was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub messages: Option<u64>,
    /// For `nan`, `flip` and `outlier`: the field.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub field: Option<String>,
    /// For `flip` and `outlier`: which number of the field, from 0; every number if not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub number: Option<usize>,
    /// For `outlier`: the largest deviation of a number, either way, in its own unit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub amount: Option<f64>,
}

fn certain() -> f64 {
    1.0
}

/// The two ends of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum End {
    /// The end that writes.
    Writer,
    /// The end that reads.
    Reader,
}

/// What happens to a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// The message is lost.
    Drop,
    /// The same bytes arrive again at once.
    Duplicate,
    /// It arrives later, by a time or by a number of later messages.
    Delay,
    /// It arrives later by a random part of a time or of a number of later messages.
    Jitter,
    /// It arrives behind the next message, or behind a number of messages.
    Reorder,
    /// One random bit is flipped.
    Corrupt,
    /// It is cut to a random shorter length, in whole words.
    Truncate,
    /// A stuck sensor: the message repeats the numbers of the first message of the window, with its
    /// own stamp, sealed as valid.
    Freeze,
    /// The bytes of an earlier message arrive again behind it.
    Replay,
    /// One number of a field is not a number, sealed as valid.
    Nan,
    /// The numbers of a field have the other sign, sealed as valid.
    Flip,
    /// The numbers of a field are off by a random amount each, sealed as valid.
    Outlier,
    /// Another protocol version, sealed as valid.
    Version,
}

impl Kind {
    /// Name in settings and logs.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Drop => "drop",
            Self::Duplicate => "duplicate",
            Self::Delay => "delay",
            Self::Jitter => "jitter",
            Self::Reorder => "reorder",
            Self::Corrupt => "corrupt",
            Self::Truncate => "truncate",
            Self::Freeze => "freeze",
            Self::Replay => "replay",
            Self::Nan => "nan",
            Self::Flip => "flip",
            Self::Outlier => "outlier",
            Self::Version => "version",
        }
    }

    /// Whether it changes the numbers of one field.
    const fn alters_a_field(self) -> bool {
        matches!(self, Self::Nan | Self::Flip | Self::Outlier)
    }

    /// Whether the message is missing where it is expected, for a while or for good.
    const fn withholds(self) -> bool {
        matches!(
            self,
            Self::Drop
                | Self::Delay
                | Self::Jitter
                | Self::Reorder
                | Self::Corrupt
                | Self::Truncate
                | Self::Version
        )
    }
}

/// A fault with settings that are not possible.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{key}: expected {expected}")]
pub struct ImpossibleFault {
    /// Dotted path of the key; faults count from 0.
    pub key: String,
    /// The expected value.
    pub expected: String,
}

impl Faults {
    /// Whether there are no faults.
    pub fn is_empty(&self) -> bool {
        self.fault.is_empty()
    }

    /// The same faults, in the process of `participant`.
    #[must_use]
    pub fn in_process(&self, participant: Participant) -> Self {
        Self { process: Some(participant), ..self.clone() }
    }

    /// Checks whether such faults are possible.
    ///
    /// # Errors
    /// [`ImpossibleFault`] names the first setting that is not possible.
    pub fn check(&self) -> Result<(), ImpossibleFault> {
        if i64::try_from(self.seed).is_err() {
            return Err(impossible(
                "seed",
                "at most 9223372036854775807, the largest number of TOML",
            ));
        }
        self.each(Fault::check)
    }

    /// Checks whether they are possible in lock step, where time does not count and every message
    /// does.
    ///
    /// # Errors
    /// [`ImpossibleFault`] names the first setting that is not possible.
    pub fn check_lock_step(&self) -> Result<(), ImpossibleFault> {
        self.each(Fault::check_lock_step)
    }

    fn each(
        &self,
        check: impl Fn(&Fault) -> Result<(), ImpossibleFault>,
    ) -> Result<(), ImpossibleFault> {
        self.fault.iter().enumerate().try_for_each(|(index, fault)| {
            check(fault).map_err(|error| ImpossibleFault {
                key: format!("fault.{index}.{}", error.key),
                expected: error.expected,
            })
        })
    }
}

fn impossible(key: &str, expected: impl Into<String>) -> ImpossibleFault {
    ImpossibleFault { key: key.to_owned(), expected: expected.into() }
}

impl Fault {
    fn check(&self) -> Result<(), ImpossibleFault> {
        let kind = self.kind.name();
        if !(self.probability > 0.0 && self.probability <= 1.0) {
            return Err(impossible("probability", "more than 0 and at most 1"));
        }
        if self.until_tick.is_some_and(|until| until <= self.from_tick) {
            return Err(impossible("until_tick", "more than from_tick"));
        }
        let timed = matches!(self.kind, Kind::Delay | Kind::Jitter);
        match self.millis {
            Some(_) if !timed => {
                return Err(impossible(
                    "millis",
                    format!("no such key for {kind}: only delay and jitter have it"),
                ));
            }
            Some(millis) if !(1..=MILLIS_MAX).contains(&millis) => {
                return Err(impossible("millis", format!("1 to {MILLIS_MAX} ms")));
            }
            _ => {}
        }
        match self.messages {
            Some(_) if !timed && !matches!(self.kind, Kind::Reorder | Kind::Replay) => {
                return Err(impossible(
                    "messages",
                    format!(
                        "no such key for {kind}: only delay, jitter, reorder and replay have it"
                    ),
                ));
            }
            Some(messages) if !(1..=MESSAGES_MAX).contains(&messages) => {
                return Err(impossible("messages", format!("1 to {MESSAGES_MAX}")));
            }
            Some(_) if self.millis.is_some() => {
                return Err(impossible("messages", "either millis or messages, not both"));
            }
            None if timed && self.millis.is_none() => {
                return Err(impossible("millis", format!("it, or messages, for {kind}")));
            }
            _ => {}
        }
        self.check_field()
    }

    fn check_field(&self) -> Result<(), ImpossibleFault> {
        let (kind, numbers) = (self.kind.name(), self.topic.numbers());
        if (self.kind.alters_a_field() || self.kind == Kind::Freeze) && numbers.is_empty() {
            return Err(impossible("topic", "a topic whose messages have numbers, for this kind"));
        }
        match self.amount {
            Some(_) if self.kind != Kind::Outlier => {
                return Err(impossible(
                    "amount",
                    format!("no such key for {kind}: only outlier has it"),
                ));
            }
            Some(amount) if !(amount.is_finite() && amount > 0.0) => {
                return Err(impossible("amount", "a finite number greater than 0"));
            }
            None if self.kind == Kind::Outlier => {
                return Err(impossible("amount", "it for outlier: the largest error of a number"));
            }
            _ => {}
        }
        if self.number.is_some() && !matches!(self.kind, Kind::Flip | Kind::Outlier) {
            return Err(impossible(
                "number",
                format!("no such key for {kind}: only flip and outlier have it"),
            ));
        }
        match &self.field {
            None if self.kind.alters_a_field() => {
                Err(impossible("field", format!("it for {kind}: one of {}", numbers.join(", "))))
            }
            Some(_) if !self.kind.alters_a_field() => Err(impossible(
                "field",
                format!("no such key for {kind}: only nan, flip and outlier have it"),
            )),
            Some(field) if !numbers.contains(&field.as_str()) => {
                Err(impossible("field", format!("one of {}", numbers.join(", "))))
            }
            _ => Ok(()),
        }
    }

    fn check_lock_step(&self) -> Result<(), ImpossibleFault> {
        if self.millis.is_some() {
            return Err(impossible("millis", "messages instead: in lock step time does not count"));
        }
        if self.at == End::Writer
            && self.kind.withholds()
            && self.topic.quality(true).delivery == Delivery::Lossless
        {
            return Err(impossible(
                "at",
                format!(
                    "reader for {}: in lock step the clock waits for every message",
                    self.kind.name()
                ),
            ));
        }
        Ok(())
    }

    /// Ticks at which it applies.
    fn window(&self) -> Range<u64> {
        self.from_tick..self.until_tick.unwrap_or(u64::MAX)
    }
}

/// The faults of one [`Ports`](super::Ports), and how often each has been injected.
#[derive(Clone)]
pub(super) struct Injection {
    faults: Arc<Faults>,
    lock_step: bool,
    injected: Arc<[AtomicU64]>,
}

impl Injection {
    /// None if there is nothing to inject.
    pub(super) fn new(faults: &Faults, lock_step: bool) -> Option<Self> {
        let injected = faults.fault.iter().map(|_| AtomicU64::new(0)).collect();
        (!faults.is_empty()).then(|| Self { faults: Arc::new(faults.clone()), lock_step, injected })
    }

    /// `sender`, with the faults of `T`'s writers around it if there are any.
    pub(super) fn around_sender<T: OnTopic>(
        &self,
        sender: Box<dyn Sender + Send>,
    ) -> Box<dyn Sender + Send> {
        match self.chain::<T>(End::Writer) {
            Some(chain) => Box::new(FaultySender::new(sender, chain)),
            None => sender,
        }
    }

    /// `receiver`, with the faults of `T`'s readers around it if there are any.
    pub(super) fn around_receiver<T: OnTopic>(
        &self,
        receiver: Box<dyn Receiver + Send>,
    ) -> Box<dyn Receiver + Send> {
        match self.chain::<T>(End::Reader) {
            Some(chain) => Box::new(FaultyReceiver::new(receiver, chain)),
            None => receiver,
        }
    }

    /// The faults at this end of `T`'s link; none if there are none.
    fn chain<T: OnTopic>(&self, at: End) -> Option<Chain> {
        let delivery = T::TOPIC.quality(self.lock_step).delivery;
        let applies = |fault: &Fault| {
            let here = fault
                .participant
                .is_none_or(|participant| self.faults.process == Some(participant));
            fault.topic == T::TOPIC && fault.at == at && here
        };
        let numbered = self.faults.fault.iter().enumerate().zip(self.injected.iter().enumerate());
        let stages: Vec<_> = numbered
            .filter(|((_, fault), _)| applies(fault))
            .map(|((index, fault), _)| {
                let place = (index as u64) << 32
                    | (T::TOPIC.index() as u64) << 16
                    | self.faults.process.map_or(0xFFFF, |here| u64::from(here.code()));
                let withheld_returns = delivery == Delivery::Lossless && at == End::Reader;
                stage::Stage::new(
                    index,
                    fault.clone(),
                    random::SplitMix64::new(self.faults.seed, place),
                    withheld_returns,
                )
            })
            .collect();
        (!stages.is_empty())
            .then(|| Chain::new(stages, anatomy::Anatomy::of::<T>(), Arc::clone(&self.injected)))
    }

    /// How often each fault has been injected, in the order of the settings.
    pub(super) fn injected(&self) -> Vec<u64> {
        self.injected.iter().map(|count| count.load(Ordering::Relaxed)).collect()
    }
}
