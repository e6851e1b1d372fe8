//! The stop request and its sources: a signal, the end of the launcher, or the process itself.

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGXFSZ};
use signal_hook::flag;
use std::io::{self, Read};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A shared stop request. Clones share the request; it cannot be withdrawn.
///
/// ```
/// let stop = process::Stop::new();
/// let elsewhere = stop.clone();
/// elsewhere.request();
/// assert!(stop.requested());
/// ```
#[derive(Clone, Debug, Default)]
pub struct Stop {
    requested: Arc<AtomicBool>,
}

impl Stop {
    /// No stop is requested yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Requests the stop.
    pub fn request(&self) {
        self.requested.store(true, Ordering::Release);
    }

    /// Whether a stop is requested. Does not wait.
    pub fn requested(&self) -> bool {
        self.requested.load(Ordering::Acquire)
    }

    /// Turns SIGINT, SIGTERM and SIGHUP into stop requests; they do not end the process any more.
    ///
    /// # Errors
    /// Error of the operating system.
    pub fn on_signals(&self) -> io::Result<()> {
        for signal in [SIGINT, SIGTERM, SIGHUP] {
            flag::register(signal, Arc::clone(&self.requested))?;
        }
        // A file beyond its size limit is then a write error, as on a full disk, and does not end
        // the process.
        flag::register(SIGXFSZ, Arc::default())?;
        Ok(())
    }

    /// Reads and ignores `input` until it ends; then requests the stop.
    pub(crate) fn at_end_of(&self, mut input: impl Read) {
        // An input that cannot be read counts as ended.
        let _ = io::copy(&mut input, &mut io::sink());
        self.request();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_end_of_the_input_requests_the_stop() {
        let stop = Stop::new();
        stop.at_end_of(io::Cursor::new(b"ignored"));
        assert!(stop.requested());
    }

    #[test]
    fn a_signal_requests_the_stop_and_does_not_kill() -> io::Result<()> {
        let stop = Stop::new();
        stop.on_signals()?;
        assert!(!stop.requested());
        signal_hook::low_level::raise(SIGTERM)?;
        assert!(stop.requested());
        Ok(())
    }
}
