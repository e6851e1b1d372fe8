//! What two bridges tell each other about themselves, twice a second.

use protocol::VERSION;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Interval between two of them.
pub(crate) const EVERY: Duration = Duration::from_millis(500);
/// Time without one after which the other host counts as lost.
pub(crate) const LOST_AFTER: Duration = Duration::from_millis(2500);

/// A bridge, as JSON on the network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Hello {
    /// Version of the protocol.
    pub(crate) version: u16,
    /// Drawn at random when the bridge starts.
    pub(crate) instance: u64,
    /// Whether its graph runs in lock step.
    pub(crate) lock_step: bool,
}

/// Why two bridges do not fit together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(crate) enum Mismatch {
    /// One of them is of another build.
    #[error("protocol version {there} there, {VERSION} here: run the same version on both hosts")]
    Version {
        /// Version of the other bridge.
        there: u16,
    },
    /// The hosts were launched differently.
    #[error("lock step is {there} there and {here} here: launch both hosts with the same pace")]
    Pace {
        /// Whether the other graph runs in lock step.
        there: bool,
        /// Whether this graph does.
        here: bool,
    },
}

impl Hello {
    pub(crate) fn new(instance: u64, lock_step: bool) -> Self {
        Self { version: VERSION, instance, lock_step }
    }

    pub(crate) fn to_bytes(self) -> Vec<u8> {
        serde_json::to_vec(&self).unwrap_or_default()
    }

    /// None if the bytes are none.
    pub(crate) fn of(bytes: &[u8]) -> Option<Self> {
        serde_json::from_slice(bytes).ok()
    }

    /// Fails if this bridge and `other` cannot exchange messages.
    pub(crate) fn check(self, other: Self) -> Result<(), Mismatch> {
        if other.version != self.version {
            return Err(Mismatch::Version { there: other.version });
        }
        if other.lock_step != self.lock_step {
            return Err(Mismatch::Pace { there: other.lock_step, here: self.lock_step });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bridges_of_another_version_or_pace_do_not_fit() {
        let own = Hello::new(1, false);
        assert_eq!(Hello::of(&own.to_bytes()), Some(own));
        assert_eq!(Hello::of(b"{}"), None);
        assert_eq!(own.check(Hello::new(2, false)), Ok(()));
        assert_eq!(own.check(Hello { version: 1, ..own }), Err(Mismatch::Version { there: 1 }));
        assert_eq!(
            own.check(Hello::new(2, true)),
            Err(Mismatch::Pace { there: true, here: false })
        );
    }
}
