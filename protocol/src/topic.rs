//! The table of topics: message, rate, queue depth, and what happens when a queue is full.

use crate::message::{
    Command, Credit, Health, Message, ModelSnapshot, Participant, Plan, PlantState, ResidualSample,
    Truth,
};
use serde::{Deserialize, Serialize};

/// Number of topics.
pub const TOPIC_COUNT: usize = 8;

/// A named stream of one kind of message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Topic {
    /// plant → controller.
    State,
    /// controller → plant.
    Command,
    /// controller → learner.
    Residual,
    /// learner → controller.
    Snapshot,
    /// controller → watchers.
    Plan,
    /// every process → launcher and watchers.
    Health,
    /// plant-sim → recorder.
    Truth,
    /// recorder → plant, in lock step.
    Credit,
}

/// What happens when a reader does not keep up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Delivery {
    /// The oldest waiting message is dropped; the writer never waits. The reader counts its losses.
    NewestWins,
    /// The writer waits, for a bounded time, until there is room. For lock step.
    Lossless,
}

/// Quality of service of one topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Quality {
    /// Most messages that can wait for one reader.
    pub depth: usize,
    /// Last messages that a late joiner gets.
    pub history: usize,
    /// Most writers at one time, one about to replace another included.
    pub writers: usize,
    /// Most readers at one time.
    pub readers: usize,
    /// What happens when a reader does not keep up.
    pub delivery: Delivery,
}

impl Quality {
    /// Whether messages are repeated to a single reader: to one that joins late or, on a lossless
    /// link, to one that reconnects.
    pub const fn says_again(&self) -> bool {
        self.history > 0 || self.is_paced()
    }

    /// Whether readers report their room to the writer.
    pub const fn is_paced(&self) -> bool {
        matches!(self.delivery, Delivery::Lossless)
    }
}

impl Topic {
    /// Every topic, in the order of the counters of [`Health`].
    pub const ALL: [Self; TOPIC_COUNT] = [
        Self::State,
        Self::Command,
        Self::Residual,
        Self::Snapshot,
        Self::Plan,
        Self::Health,
        Self::Truth,
        Self::Credit,
    ];

    /// Name in graph files, records and on the network.
    pub const fn name(self) -> &'static str {
        match self {
            Self::State => "state",
            Self::Command => "command",
            Self::Residual => "residual",
            Self::Snapshot => "snapshot",
            Self::Plan => "plan",
            Self::Health => "health",
            Self::Truth => "truth",
            Self::Credit => "credit",
        }
    }

    /// The message that it carries.
    pub const fn message(self) -> &'static str {
        match self {
            Self::State => PlantState::NAME,
            Self::Command => Command::NAME,
            Self::Residual => ResidualSample::NAME,
            Self::Snapshot => ModelSnapshot::NAME,
            Self::Plan => Plan::NAME,
            Self::Health => Health::NAME,
            Self::Truth => Truth::NAME,
            Self::Credit => Credit::NAME,
        }
    }

    /// Names of the number fields of its message.
    pub const fn numbers(self) -> &'static [&'static str] {
        match self {
            Self::State => <PlantState as Message>::NUMBERS,
            Self::Command => <Command as Message>::NUMBERS,
            Self::Residual => <ResidualSample as Message>::NUMBERS,
            Self::Snapshot => ModelSnapshot::NUMBERS,
            Self::Plan => <Plan as Message>::NUMBERS,
            Self::Health => <Health as Message>::NUMBERS,
            Self::Truth => <Truth as Message>::NUMBERS,
            Self::Credit => <Credit as Message>::NUMBERS,
        }
    }

    /// The processes that publish it.
    pub const fn writers(self) -> &'static [Participant] {
        match self {
            Self::State | Self::Truth => &[Participant::Plant],
            Self::Command | Self::Residual | Self::Plan => &[Participant::Controller],
            Self::Snapshot => &[Participant::Learner],
            Self::Health => Participant::ALL,
            Self::Credit => &[Participant::Recorder],
        }
    }

    /// The processes that subscribe to it.
    pub const fn readers(self) -> &'static [Participant] {
        use Participant::{Controller, Gateway, Learner, Plant, Recorder};
        match self {
            Self::State | Self::Snapshot => &[Controller, Recorder, Gateway],
            Self::Command => &[Plant, Recorder],
            Self::Residual => &[Learner, Recorder, Gateway],
            Self::Plan | Self::Health | Self::Truth => &[Recorder, Gateway],
            Self::Credit => &[Plant],
        }
    }

    /// Whether the launcher of each host subscribes to it as well.
    pub const fn is_read_by_launchers(self) -> bool {
        matches!(self, Self::Plan | Self::Health)
    }

    /// Place in [`Topic::ALL`].
    pub const fn index(self) -> usize {
        self as usize
    }

    /// Quality of service. `lock_step` makes the links that a run's result depends on lossless.
    #[expect(clippy::match_same_arms, reason = "a table, one row per topic")]
    pub const fn quality(self, lock_step: bool) -> Quality {
        let (depth, history, writers, readers, lossless) = match self {
            Self::State => (256, 1, 4, 16, true),
            Self::Command => (256, 0, 4, 8, true),
            Self::Residual => (256, 1, 4, 8, true),
            Self::Snapshot => (8, 1, 4, 8, true),
            Self::Plan => (64, 1, 4, 16, true),
            Self::Health => (256, 0, 16, 16, false),
            Self::Truth => (256, 0, 4, 8, true),
            Self::Credit => (64, 1, 4, 8, true),
        };
        let delivery =
            if lossless && lock_step { Delivery::Lossless } else { Delivery::NewestWins };
        Quality { depth, history, writers, readers, delivery }
    }

    /// Quality of service for watchers, beside a link that is lossless for its own readers.
    pub const fn watched_quality(self) -> Quality {
        let Quality { writers, readers, .. } = self.quality(false);
        Quality {
            depth: WATCHED_DEPTH,
            history: 1,
            writers,
            readers,
            delivery: Delivery::NewestWins,
        }
    }
}

/// Messages that wait for a watcher of a lossless link: the newest message of each writer, and one
/// that has just arrived.
const WATCHED_DEPTH: usize = 2;

/// A message that has a topic of its own.
pub trait OnTopic: Message {
    /// The topic.
    const TOPIC: Topic;

    /// The process that it comes from; none if it names none.
    fn publisher(&self) -> Option<Participant> {
        Self::TOPIC.writers().first().copied()
    }
}

macro_rules! on_topic {
    ($($message:ident => $topic:ident,)+) => {
        $(impl OnTopic for $message { const TOPIC: Topic = Topic::$topic; })+
    };
}

on_topic! {
    PlantState => State,
    Command => Command,
    ResidualSample => Residual,
    ModelSnapshot => Snapshot,
    Plan => Plan,
    Truth => Truth,
    Credit => Credit,
}

impl OnTopic for Health {
    const TOPIC: Topic = Topic::Health;

    fn publisher(&self) -> Option<Participant> {
        self.participant()
    }
}
