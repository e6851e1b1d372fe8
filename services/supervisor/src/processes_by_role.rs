//! The present process of each role, shared between the supervisor of the processes and the fault
//! injector.

use protocol::message::Participant;
use rustix::process::Pid;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Process ids by role. While it is locked no process is reaped, so that an id belongs to its
/// process and to no other.
#[derive(Debug, Clone, Default)]
pub struct ProcessesByRole(Arc<Mutex<BTreeMap<Participant, Pid>>>);

impl ProcessesByRole {
    /// Locks it for reading or changing.
    pub fn lock(&self) -> MutexGuard<'_, BTreeMap<Participant, Pid>> {
        // It is consistent even if its holder panicked, because it is changed entry by entry.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
