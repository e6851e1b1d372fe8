//! The links of one graph, as settings.

use super::{Faults, OpenError};
use access::Credentials;
use protocol::topic::Topic;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

/// Longest name of a graph \[bytes\].
pub const GRAPH_NAME_MAX: usize = 32;

/// Longest patience, so that deadlines can be computed without overflow.
pub(super) const PATIENCE_MAX: Duration = Duration::from_hours(24);

/// The links of one graph. Every process of the graph gets the same settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Links {
    /// Name of the graph: 1 to 32 of `a`–`z`, `0`–`9`, `_` and `-`. Two graphs of different names
    /// never exchange messages.
    pub graph: String,
    /// Whether the links that determine a run's result lose nothing.
    pub lock_step: bool,
    /// Folder for the carrier's files and sockets, private to the graph; made if missing. Keep it
    /// short: the system limits the path of a socket to 107 bytes, of which 50 and the graph's name
    /// are taken.
    pub root: PathBuf,
    /// How long a lossless writer waits for room \[ms\].
    pub patience_millis: u64,
    /// Carrier of each topic.
    pub carriers: Carriers,
    /// Endpoints of the graph's router, where the network is joined, as `tcp/127.0.0.1:7447`. Empty
    /// if no topic runs over the network.
    #[serde(default)]
    pub connect: Vec<String>,
    /// Name of the graph on the network, of the same form, for launches that share a network graph;
    /// by default that of the graph.
    #[serde(default)]
    pub network_graph: Option<String>,
    /// Certificate by which the others on the network authenticate this process. Without it no
    /// traffic there is encrypted, and every peer is trusted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub credentials: Option<Credentials>,
    /// Faults that are injected on purpose; none by default.
    #[serde(default, skip_serializing_if = "Faults::is_empty")]
    pub faults: Faults,
}

/// The carrier of a link. In-process memory is not a setting: see [`Exchange`](super::Exchange).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Carrier {
    /// The shared memory of one machine.
    SharedMemory,
    /// Zenoh, on one machine or across several.
    Network,
}

/// Carrier of each topic: `default`, and the exceptions by the topics' names.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Carriers {
    /// Carrier of all topics without an exception.
    pub default: Carrier,
    /// Topics with another carrier than the default, by name.
    #[serde(flatten)]
    pub exceptions: BTreeMap<String, Carrier>,
}

impl Carriers {
    /// Every topic over `carrier`.
    pub fn all(carrier: Carrier) -> Self {
        Self { default: carrier, exceptions: BTreeMap::new() }
    }

    /// Carrier of `topic`.
    pub fn of(&self, topic: Topic) -> Carrier {
        self.exceptions.get(topic.name()).copied().unwrap_or(self.default)
    }

    /// Whether any topic runs over `carrier`.
    pub fn uses(&self, carrier: Carrier) -> bool {
        Topic::ALL.into_iter().any(|topic| self.of(topic) == carrier)
    }
}

impl Links {
    /// Everything over the shared memory of this machine.
    pub fn on_this_machine(
        graph: impl Into<String>,
        root: impl Into<PathBuf>,
        lock_step: bool,
        patience_millis: u64,
    ) -> Self {
        let carriers = Carriers::all(Carrier::SharedMemory);
        Self {
            graph: graph.into(),
            lock_step,
            root: root.into(),
            patience_millis,
            carriers,
            connect: Vec::new(),
            network_graph: None,
            credentials: None,
            faults: Faults::default(),
        }
    }

    /// How long a lossless writer waits for room: a day at most.
    pub fn patience(&self) -> Duration {
        Duration::from_millis(self.patience_millis).min(PATIENCE_MAX)
    }

    /// Name of the graph on the network.
    pub fn network_graph(&self) -> &str {
        self.network_graph.as_deref().unwrap_or(&self.graph)
    }

    /// Fails unless the names of the graph are valid.
    pub(super) fn check(&self) -> Result<(), OpenError> {
        for name in [self.graph.as_str(), self.network_graph()] {
            if !is_graph_name(name) {
                return Err(OpenError::GraphName { graph: name.to_owned() });
            }
        }
        Ok(())
    }
}

/// Whether a graph can have this name.
pub fn is_graph_name(name: &str) -> bool {
    let allowed = |byte: u8| {
        byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'_' || byte == b'-'
    };
    (1..=GRAPH_NAME_MAX).contains(&name.len()) && name.bytes().all(allowed)
}
