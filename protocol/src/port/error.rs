//! What can go wrong with a link: one enum per operation.

use crate::topic::{Delivery, Topic};
use std::path::PathBuf;
use std::time::Duration;

/// A port, or the graph that it belongs to, cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The name would not tell graphs apart on every carrier.
    #[error("graph name {graph:?} must be 1 to 32 characters out of a-z, 0-9, _ and -")]
    GraphName {
        /// The name.
        graph: String,
    },
    /// A shorter path helps.
    #[error("root {} is {length} bytes long, at most {limit} are possible with graph name {graph:?}", root.display())]
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
        /// Why not.
        reason: String,
    },
    /// Shared memory is nearly used up, by this graph or by somebody else.
    #[error("{} has {free} bytes left, expected at least {least}: whoever joins a graph there would end others", folder.display())]
    NoRoom {
        /// Where shared memory lies.
        folder: PathBuf,
        /// What is left \[bytes\].
        free: u64,
        /// What must be \[bytes\].
        least: u64,
    },
    /// Shared memory or the network is not to be had at all.
    #[error("graph {graph:?} cannot be joined: {reason}")]
    Join {
        /// Name of the graph.
        graph: String,
        /// What the carrier said.
        reason: String,
    },
    /// The graph's meeting place on the network cannot be made.
    #[error("a router at {endpoints} cannot be opened: {reason}")]
    Router {
        /// Where it was to listen.
        endpoints: String,
        /// What the carrier said.
        reason: String,
    },
    /// The other processes of the graph speak another message or another version on this topic.
    #[error(
        "topic {} carries {found_message} in protocol version {found_version}, this program wants {message} in version {version}",
        topic.name()
    )]
    Incompatible {
        /// The topic.
        topic: Topic,
        /// Our message.
        message: String,
        /// Our protocol version.
        version: String,
        /// Their message.
        found_message: String,
        /// Their protocol version.
        found_version: String,
    },
    /// All processes of a graph must agree on `lock_step`.
    #[error("topic {} is not {delivery:?} for the others of the graph, as it is for this program: lock_step differs", topic.name())]
    Delivery {
        /// The topic.
        topic: Topic,
        /// What this program wants.
        delivery: Delivery,
    },
    /// The other processes of the graph have another table of topics.
    #[error("topic {} exists with another quality of service: {reason}", topic.name())]
    Quality {
        /// The topic.
        topic: Topic,
        /// What the carrier said.
        reason: String,
    },
    /// A process that has not been cleaned up may hold a place.
    #[error("topic {} has no place for more than {limit} {role}", topic.name())]
    Full {
        /// The topic.
        topic: Topic,
        /// Writers or readers.
        role: &'static str,
        /// How many there can be.
        limit: usize,
    },
    /// The carrier failed.
    #[error("topic {} cannot be opened: {reason}", topic.name())]
    Carrier {
        /// The topic.
        topic: Topic,
        /// What the carrier said.
        reason: String,
    },
    /// What dead processes left cannot be removed.
    #[error("remains of graph {graph:?} cannot be removed: {reason}")]
    Sweep {
        /// Name of the graph.
        graph: String,
        /// What the carrier or the file system said.
        reason: String,
    },
}

/// A message did not reach every reader. It keeps its sequence number, so that those that did not get it count a loss.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum SendError {
    /// A reader of a lossless link did not make room in time. The others have got the message.
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
        /// The topic.
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
        /// What the carrier was doing.
        reason: &'static str,
    },
}
