//! The table of topics: message, rate, queue depth, and what happens when a queue is full.

use crate::message::Participant::{self, Controller, Gateway, Learner, Plant, Recorder};
use crate::message::{
    Command, Credit, Goal, Health, Message, ModelSnapshot, Obstacles, Plan, PlantState,
    ResidualSample, Truth,
};
use serde::{Deserialize, Serialize};

/// What happens when a reader does not keep up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Delivery {
    /// The oldest waiting message is dropped; the writer never waits. The reader counts its losses.
    NewestWins,
    /// The writer waits, for a bounded time, until there is room. For lock step.
    Lossless,
}

/// How often a topic carries a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pace {
    /// Once in a control period.
    Periods,
    /// With the heartbeat of each process.
    Heartbeats,
    /// When a model has been fitted.
    Models,
}

/// What the messages of a topic wait for, where several wait for one link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Urgency {
    /// For nothing: the robot moves by them.
    Drive,
    /// For those: learning or lock step needs them.
    Serve,
    /// For those: people and records see them.
    Show,
    /// For all others: they are long.
    Bulk,
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
    /// Whether readers report their room to the writer.
    pub const fn is_paced(&self) -> bool {
        matches!(self.delivery, Delivery::Lossless)
    }
}

/// One row of the table.
struct Row {
    name: &'static str,
    message: &'static str,
    numbers: fn() -> Vec<&'static str>,
    writers: &'static [Participant],
    readers: &'static [Participant],
    /// Depth, history, writers, readers.
    quality: (usize, usize, usize, usize),
    /// Whether the result of a run in lock step depends on it.
    lossless: bool,
    pace: Pace,
    urgency: Urgency,
    /// Whether a bridge sends each message at once, alone.
    alone: bool,
}

/// A message that has a topic of its own.
pub trait OnTopic: Message {
    /// The topic.
    const TOPIC: Topic;

    /// The process that it comes from; none if it names none.
    fn publisher(&self) -> Option<Participant>;
}

/// Something that is done with every kind of message.
pub trait Visit {
    /// Does it with `T`.
    fn visit<T: OnTopic>(&mut self);
}

/// The publisher of a message: what it says itself, or the one writer of its topic.
macro_rules! publisher {
    ($message:ident) => {
        Self::TOPIC.writers().first().copied()
    };
    ($message:ident, $publisher:ident) => {
        $message.$publisher()
    };
}

macro_rules! topics {
    ($(
        $(#[doc = $about:literal])+
        $topic:ident($name:literal, $message:ident $(by $publisher:ident)?):
            $writers:expr => $readers:expr, $quality:expr, lossless: $lossless:literal,
            $pace:ident, $urgency:ident, alone: $alone:literal;
    )+) => {
        /// A named stream of one kind of message.
        #[derive(
            Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize,
        )]
        #[serde(rename_all = "kebab-case")]
        pub enum Topic { $($(#[doc = $about])+ $topic,)+ }

        /// Number of topics.
        pub const TOPIC_COUNT: usize = Topic::ALL.len();

        impl Topic {
            /// Every topic, in the order of the counters of [`Health`].
            pub const ALL: [Self; [$(stringify!($topic)),+].len()] = [$(Self::$topic),+];

            const fn row(self) -> &'static Row {
                match self {
                    $(Self::$topic => &Row {
                        name: $name,
                        message: <$message as Message>::NAME,
                        numbers: <$message as Message>::numbers,
                        writers: $writers,
                        readers: $readers,
                        quality: $quality,
                        lossless: $lossless,
                        pace: Pace::$pace,
                        urgency: Urgency::$urgency,
                        alone: $alone,
                    },)+
                }
            }
        }

        $(impl OnTopic for $message {
            const TOPIC: Topic = Topic::$topic;

            fn publisher(&self) -> Option<Participant> {
                publisher!(self $(, $publisher)?)
            }
        })+

        /// Shows every kind of message to `visitor`, in the order of [`Topic::ALL`].
        pub fn visit_all(visitor: &mut impl Visit) {
            $(visitor.visit::<$message>();)+
        }
    };
}

topics! {
    /// plant → controller.
    State("state", PlantState): &[Plant] => &[Controller, Recorder, Gateway],
        (256, 1, 4, 16), lossless: true, Periods, Drive, alone: true;
    /// controller → plant.
    Command("command", Command): &[Controller] => &[Plant, Recorder],
        (256, 0, 4, 8), lossless: true, Periods, Drive, alone: true;
    /// controller → learner.
    Residual("residual", ResidualSample): &[Controller] => &[Learner, Recorder, Gateway],
        (256, 1, 4, 8), lossless: true, Periods, Serve, alone: false;
    /// learner → controller.
    Snapshot("snapshot", ModelSnapshot): &[Learner] => &[Controller, Recorder, Gateway],
        (8, 1, 4, 8), lossless: true, Models, Bulk, alone: true;
    /// controller → watchers.
    Plan("plan", Plan): &[Controller] => &[Recorder, Gateway],
        (64, 1, 4, 16), lossless: true, Periods, Show, alone: false;
    /// every process → launcher and watchers.
    Health("health", Health by participant): Participant::ALL => &[Recorder, Gateway],
        (256, 0, 16, 16), lossless: false, Heartbeats, Show, alone: false;
    /// plant-sim → recorder.
    Truth("truth", Truth): &[Plant] => &[Recorder, Gateway],
        (256, 0, 4, 8), lossless: true, Periods, Show, alone: false;
    /// recorder → plant, in lock step.
    Credit("credit", Credit): &[Recorder] => &[Plant],
        (64, 1, 4, 8), lossless: true, Periods, Serve, alone: true;
    /// controller → watchers.
    Goal("goal", Goal): &[Controller] => &[Recorder, Gateway],
        (64, 1, 4, 16), lossless: false, Heartbeats, Show, alone: false;
    /// plant → controller.
    Obstacles("obstacles", Obstacles): &[Plant] => &[Controller, Recorder, Gateway],
        (16, 1, 4, 8), lossless: true, Periods, Drive, alone: true;
}

impl Topic {
    /// Name in graph files, records and on the network.
    pub const fn name(self) -> &'static str {
        self.row().name
    }

    /// The message that it carries.
    pub const fn message(self) -> &'static str {
        self.row().message
    }

    /// Names of the number fields of its message.
    pub fn numbers(self) -> Vec<&'static str> {
        (self.row().numbers)()
    }

    /// The processes that publish it.
    pub const fn writers(self) -> &'static [Participant] {
        self.row().writers
    }

    /// The processes that subscribe to it.
    pub const fn readers(self) -> &'static [Participant] {
        self.row().readers
    }

    /// How often it carries a message.
    pub const fn pace(self) -> Pace {
        self.row().pace
    }

    /// Which messages go first where several wait for one link.
    pub const fn urgency(self) -> Urgency {
        self.row().urgency
    }

    /// Whether a bridge sends each message at once, without waiting for more.
    pub const fn goes_alone(self) -> bool {
        self.row().alone
    }

    /// Whether the launcher of each host subscribes to it as well.
    pub const fn is_read_by_launchers(self) -> bool {
        matches!(self, Self::Plan | Self::Health | Self::Goal)
    }

    /// Place in [`Topic::ALL`].
    pub const fn index(self) -> usize {
        self as usize
    }

    /// Quality of service. `lock_step` makes the links that a run's result depends on lossless.
    pub const fn quality(self, lock_step: bool) -> Quality {
        let Row { quality: (depth, history, writers, readers), lossless, .. } = *self.row();
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
