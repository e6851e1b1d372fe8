//! Pins a thread to its processor.

use rustix::thread::{CpuSet, sched_getaffinity, sched_getcpu, sched_setaffinity};

/// Pins the thread that created it to one processor for a while, so that it keeps its warm caches.
///
/// A sleeping thread may wake up on another processor, with cold caches. If the system does not
/// permit pinning, nothing happens.
pub struct Seat {
    /// Processors that the thread may use when it is not pinned.
    allowed: Option<CpuSet>,
    held: bool,
}

impl Seat {
    /// For the calling thread.
    pub fn new() -> Self {
        Self { allowed: sched_getaffinity(None).ok(), held: false }
    }

    /// Pins the calling thread to its present processor.
    pub fn hold(&mut self) {
        let mut here = CpuSet::new();
        here.set(sched_getcpu());
        self.held = self.allowed.is_some() && sched_setaffinity(None, &here).is_ok();
    }

    /// Removes the pinning.
    pub fn release(&mut self) {
        if let (true, Some(allowed)) = (self.held, &self.allowed) {
            self.held = sched_setaffinity(None, allowed).is_err();
        }
    }
}

impl Default for Seat {
    fn default() -> Self {
        Self::new()
    }
}
