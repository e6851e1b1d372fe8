//! The links of one graph, as settings.

#[cfg(feature = "faults")]
use super::Faults;
use super::OpenError;
use serde::{Deserialize, Serialize};
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
    /// Faults that are injected on purpose; none by default.
    #[cfg(feature = "faults")]
    #[serde(default, skip_serializing_if = "Faults::is_empty")]
    pub faults: Faults,
}

impl Links {
    /// Everything over the shared memory of this machine.
    pub fn on_this_machine(
        graph: impl Into<String>,
        root: impl Into<PathBuf>,
        lock_step: bool,
        patience_millis: u64,
    ) -> Self {
        Self {
            graph: graph.into(),
            lock_step,
            root: root.into(),
            patience_millis,
            #[cfg(feature = "faults")]
            faults: Faults::default(),
        }
    }

    /// How long a lossless writer waits for room: a day at most.
    pub fn patience(&self) -> Duration {
        Duration::from_millis(self.patience_millis).min(PATIENCE_MAX)
    }

    /// Fails unless the name of the graph is valid.
    pub(super) fn check(&self) -> Result<(), OpenError> {
        if is_graph_name(&self.graph) {
            Ok(())
        } else {
            Err(OpenError::GraphName { graph: self.graph.clone() })
        }
    }
}

/// Whether a graph can have this name.
pub fn is_graph_name(name: &str) -> bool {
    let allowed = |byte: u8| {
        byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'_' || byte == b'-'
    };
    (1..=GRAPH_NAME_MAX).contains(&name.len()) && name.bytes().all(allowed)
}
