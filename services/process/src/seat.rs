//! The processor that a thread sits on.

use rustix::thread::{CpuSet, sched_getaffinity, sched_getcpu, sched_setaffinity};

/// Holds the thread that made it on one processor for a while, so that the caches it has filled there are the ones it works from.
///
/// A thread that sleeps may wake up on another processor, where all that it needs is still far away. Where the system does not let a
/// thread choose, nothing happens.
pub struct Seat {
    /// The processors that the thread may use otherwise.
    allowed: Option<CpuSet>,
    held: bool,
}

impl Seat {
    /// The calling thread's.
    pub fn new() -> Self {
        Self { allowed: sched_getaffinity(None).ok(), held: false }
    }

    /// Holds the calling thread on the processor that it runs on now.
    pub fn hold(&mut self) {
        let mut here = CpuSet::new();
        here.set(sched_getcpu());
        self.held = self.allowed.is_some() && sched_setaffinity(None, &here).is_ok();
    }

    /// Lets it go wherever it was allowed to before.
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
