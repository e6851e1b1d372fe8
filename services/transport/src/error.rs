//! Errors of links: one enum per operation.

use protocol::topic::{Delivery, Topic};
use std::path::PathBuf;
use std::time::Duration;

/// A port, or the graph that it belongs to, cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The name does not keep graphs apart on every carrier.
    #[error("graph name {graph:?} must be 1 to 32 characters out of a-z, 0-9, _ and -")]
    GraphName {
        /// The name.
        graph: String,
    },
    /// The path is too long for a socket; a shorter path helps.
    #[error(
        "root {} is {length} bytes long, at most {limit} are possible with graph name \
        {graph:?}",
        root.display()
    )]
    RootTooLong {
        /// Folder of the graph.
        root: PathBuf,
        /// Name of the graph.
        graph: String,
        /// Its length \[bytes\].
        length: usize,
        /// Longest possible \[bytes\].
        limit: usize,
    },
    /// The folder of the graph cannot be used.
    #[error("root {}: {reason}", root.display())]
    Root {
        /// Folder of the graph.
        root: PathBuf,
        /// The reason.
        reason: String,
    },
    /// Shared memory is nearly used up, by this graph or by other processes.
    #[error(
        "{} has {free} bytes left, expected at least {least}: a process that joins a graph there \
         would terminate others",
        folder.display()
    )]
    NoRoom {
        /// Folder of shared memory.
        folder: PathBuf,
        /// Free room \[bytes\].
        free: u64,
        /// Least room required \[bytes\].
        least: u64,
    },
    /// Shared memory is not available at all.
    #[error("graph {graph:?} cannot be joined: {reason}")]
    Join {
        /// Name of the graph.
        graph: String,
        /// Error of the carrier.
        reason: String,
    },
    /// The other processes of the graph use another message or another version on this topic.
    #[error(
        "topic {} carries {found_message} in protocol version {found_version}, this program \
         expects {message} in version {version}",
        topic.name()
    )]
    Incompatible {
        /// The topic.
        topic: Topic,
        /// Message of this program.
        message: String,
        /// Protocol version of this program.
        version: String,
        /// Message of the others.
        found_message: String,
        /// Protocol version of the others.
        found_version: String,
    },
    /// All processes of a graph must agree on `lock_step`.
    #[error(
        "topic {} is {delivery:?} for this program, and not for the other processes of the graph: \
         lock_step differs",
        topic.name()
    )]
    Delivery {
        /// The topic.
        topic: Topic,
        /// Delivery that this program expects.
        delivery: Delivery,
    },
    /// The other processes of the graph have another table of topics.
    #[error("topic {} exists with another quality of service: {reason}", topic.name())]
    Quality {
        /// The topic.
        topic: Topic,
        /// Error of the carrier.
        reason: String,
    },
    /// The topic has no place left. A dead process that has not been cleaned up may hold one.
    #[error("topic {} accepts at most {limit} {role}", topic.name())]
    Full {
        /// The topic.
        topic: Topic,
        /// Writers or readers.
        role: &'static str,
        /// The limit.
        limit: usize,
    },
    /// The carrier failed.
    #[error("topic {} cannot be opened: {reason}", topic.name())]
    Carrier {
        /// The topic.
        topic: Topic,
        /// Error of the carrier.
        reason: String,
    },
    /// The remains of dead processes cannot be removed.
    #[error("remains of graph {graph:?} cannot be removed: {reason}")]
    Sweep {
        /// Name of the graph.
        graph: String,
        /// Error of the carrier or the file system.
        reason: String,
    },
}

/// A message did not reach every reader. It keeps its sequence number, so that a reader without it
/// counts a loss.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum SendError {
    /// A reader of a lossless link did not make room in time. The others have received the message.
    #[error("a reader of topic {} has made no room for {waited:?}", topic.name())]
    NoRoom {
        /// The topic.
        topic: Topic,
        /// How long the writer waited.
        waited: Duration,
    },
    /// The carrier failed.
    #[error("topic {} cannot be written: {reason}", topic.name())]
    Carrier {
        /// Operation of the carrier that failed.
        topic: Topic,
        /// What the carrier was doing.
        reason: &'static str,
    },
}

/// A link cannot be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ReceiveError {
    /// The carrier failed.
    #[error("topic {} cannot be read: {reason}", topic.name())]
    Carrier {
        /// The topic.
        topic: Topic,
        /// Operation of the carrier that failed.
        reason: &'static str,
    },
}
