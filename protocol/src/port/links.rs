//! How the links of one graph run, as a setting.

use super::OpenError;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::time::Duration;

/// Longest name of a graph \[bytes\].
pub const GRAPH_NAME_MAX: usize = 32;

/// Longest patience, so that deadlines can be computed without overflow.
pub(super) const PATIENCE_MAX: Duration = Duration::from_hours(24);

/// How the links of one graph run. Every process of the graph gets the same.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Links {
    /// Name of the graph: 1 to 32 of `a`–`z`, `0`–`9`, `_` and `-`. Two graphs of different names never hear each other.
    pub graph: String,
    /// Whether the links that a run's result depends on lose nothing.
    pub lock_step: bool,
    /// Folder for the carrier's files and sockets, private to the graph; made if missing. Keep it short: the system allows a socket a path of
    /// 107 bytes, of which 50 and the graph's name are taken.
    pub root: PathBuf,
    /// How long a lossless writer waits for room \[ms\].
    pub patience_millis: u64,
    /// What the links run over.
    pub carrier: Carrier,
}

/// What a link runs over. In-process memory is not a setting: see [`Exchange`](super::Exchange). The network gets its place here.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Carrier {
    /// The shared memory of one machine.
    SharedMemory,
}

impl Links {
    /// How long a lossless writer waits for room: a day at most.
    pub fn patience(&self) -> Duration {
        Duration::from_millis(self.patience_millis).min(PATIENCE_MAX)
    }

    /// Fails unless the name of the graph can be used.
    pub(super) fn check(&self) -> Result<(), OpenError> {
        let allowed = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'_' || byte == b'-';
        if (1..=GRAPH_NAME_MAX).contains(&self.graph.len()) && self.graph.bytes().all(allowed) {
            Ok(())
        } else {
            Err(OpenError::GraphName { graph: self.graph.clone() })
        }
    }
}
