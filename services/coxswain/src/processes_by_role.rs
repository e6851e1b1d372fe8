//! Who plays which role at this moment: shared by whoever starts and buries processes and whoever does something to them.

use protocol::message::Participant;
use rustix::process::Pid;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Process ids by role. While it is borrowed nobody is buried, so that an id in it is that of the process and of no other.
#[derive(Debug, Clone, Default)]
pub struct ProcessesByRole(Arc<Mutex<BTreeMap<Participant, Pid>>>);

impl ProcessesByRole {
    /// Looks at it, or changes it, while nobody else does.
    pub fn lock(&self) -> MutexGuard<'_, BTreeMap<Participant, Pid>> {
        // Whole even if its holder panicked: it is changed entry by entry.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
