//! The request to end, and who may make it: a signal, the launcher's death, or the process itself.

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGXFSZ};
use signal_hook::flag;
use std::io::{self, Read};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A shared request to end. Clones are the same request; it cannot be taken back.
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
    /// Not yet requested.
    pub fn new() -> Self {
        Self::default()
    }

    /// Asks for the end.
    pub fn request(&self) {
        self.requested.store(true, Ordering::Release);
    }

    /// Whether the end was asked for. Does not wait.
    pub fn requested(&self) -> bool {
        self.requested.load(Ordering::Acquire)
    }

    /// Lets SIGINT, SIGTERM and SIGHUP ask for the end from now on, instead of ending the process.
    ///
    /// # Errors
    /// What the system says.
    pub fn on_signals(&self) -> io::Result<()> {
        for signal in [SIGINT, SIGTERM, SIGHUP] {
            flag::register(signal, Arc::clone(&self.requested))?;
        }
        // A file that may not grow any more is an error where it is written, as on a full disk, and nobody's end.
        flag::register(SIGXFSZ, Arc::default())?;
        Ok(())
    }

    /// Reads `input`, in which nothing is said, until it ends; then asks for the end.
    pub(crate) fn at_end_of(&self, mut input: impl Read) {
        // An input that cannot be read is as good as ended.
        let _ = io::copy(&mut input, &mut io::sink());
        self.request();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_end_of_the_input_asks_for_the_end() {
        let stop = Stop::new();
        stop.at_end_of(io::Cursor::new(b"nothing that counts"));
        assert!(stop.requested());
    }

    #[test]
    fn a_signal_asks_for_the_end_and_does_not_kill() -> io::Result<()> {
        let stop = Stop::new();
        stop.on_signals()?;
        assert!(!stop.requested());
        signal_hook::low_level::raise(SIGTERM)?;
        assert!(stop.requested());
        Ok(())
    }
}
