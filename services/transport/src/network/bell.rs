//! Wakes one sleeping reader. Ringing neither locks nor waits.

use rustix::event::{EventfdFlags, PollFd, PollFlags, Timespec, eventfd, poll};
use rustix::fd::OwnedFd;
use rustix::io::{Errno, read, write};
use std::sync::atomic::{AtomicBool, Ordering, fence};
use std::time::Duration;

/// How a sleep ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Slept {
    /// The bell rang, or the time is over.
    Awake,
    /// A signal came.
    Interrupted,
}

pub(super) struct Bell {
    event: OwnedFd,
    /// Whether the reader is about to sleep; else ringing is one look at memory.
    armed: AtomicBool,
}

impl Bell {
    pub(super) fn new() -> Result<Self, Errno> {
        let event = eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?;
        Ok(Self { event, armed: AtomicBool::new(false) })
    }

    /// To be called after what the reader looks for has been put in its place.
    pub(super) fn ring(&self) {
        fence(Ordering::SeqCst);
        if self.armed.swap(false, Ordering::SeqCst) {
            // It can only fail because it has been rung 2⁶⁴ times.
            let _ = write(&self.event, &1_u64.to_ne_bytes());
        }
    }

    /// To be called before the look for which the bell is rung, so that no message falls between
    /// look and sleep.
    pub(super) fn arm(&self) {
        let _ = read(&self.event, &mut [0; 8]);
        self.armed.store(true, Ordering::SeqCst);
        fence(Ordering::SeqCst);
    }

    /// Sleeps until the bell has been rung since it was armed, but no longer than `most`.
    pub(super) fn sleep(&self, most: Duration) -> Result<Slept, Errno> {
        // A time that the system cannot count is for ever.
        let most = Timespec::try_from(most).ok();
        match poll(&mut [PollFd::new(&self.event, PollFlags::IN)], most.as_ref()) {
            Ok(_) => Ok(Slept::Awake),
            Err(Errno::INTR) => Ok(Slept::Interrupted),
            Err(error) => Err(error),
        }
    }
}
