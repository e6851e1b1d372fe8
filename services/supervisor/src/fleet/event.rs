//! What a round of supervision finds, and why a process cannot take part.

use super::READY_WITHIN;
use crate::child::Ending;
use protocol::message::Participant;
use settings::WriteError;
use std::io;
use std::time::Duration;

/// Why a process cannot take part.
#[derive(Debug, thiserror::Error)]
pub enum FleetError {
    /// Its settings cannot be written.
    #[error(transparent)]
    Settings(#[from] WriteError),
    /// It cannot be started, or the system does not report its state.
    #[error("{role}: {source}")]
    System {
        /// Role of the process.
        role: Participant,
        /// Error of the operating system.
        source: io::Error,
    },
    /// It ended before it was ready.
    #[error("{role} ended with {ending} before it was ready{last_words}")]
    NeverReady {
        /// Role of the process.
        role: Participant,
        /// How it ended.
        ending: Ending,
        /// The end of its log.
        last_words: String,
    },
    /// It runs, but does not become ready.
    #[error("{role} was not ready within {READY_WITHIN:?}{last_words}")]
    TooSlow {
        /// Role of the process.
        role: Participant,
        /// The end of its log.
        last_words: String,
    },
    /// It failed more often than its restart policy allows.
    #[error(
        "{role} ended with {ending}, \
         and {per_minute} restarts within a minute are the limit{last_words}"
    )]
    TooManyDeaths {
        /// Role of the process.
        role: Participant,
        /// How it ended.
        ending: Ending,
        /// Limit of the graph.
        per_minute: u32,
        /// The end of its log.
        last_words: String,
    },
}

/// Result of one round of supervision.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Event {
    /// The plant has finished.
    Finished,
    /// A process ended, and is restarted after a wait.
    Died {
        /// Role of the process.
        role: Participant,
        /// How it ended.
        ending: Ending,
        /// Time until the restart.
        wait: Duration,
    },
    /// A process runs but has sent no heartbeat for too long, and was killed. It is then restarted
    /// like any other that ended.
    Hung {
        /// Role of the process.
        role: Participant,
        /// Time without a heartbeat.
        silence: Duration,
    },
    /// A process that the robot does not need has failed too often, and is not restarted.
    GivenUp {
        /// Role of the process.
        role: Participant,
        /// How it ended.
        ending: Ending,
    },
    /// A process could not be restarted.
    NotStarted {
        /// Role of the process.
        role: Participant,
        /// Why not.
        trouble: String,
        /// Time until the next attempt; none if the process is not required.
        wait: Option<Duration>,
    },
    /// A process was restarted.
    Restarted {
        /// Role of the process.
        role: Participant,
        /// Its epoch is greater than this.
        epoch_floor: u64,
    },
}
