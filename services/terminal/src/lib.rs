//! All printed output: messages and the live line on the standard error, results on the standard
//! output.
//!
//! The output may be closed, so errors of printing are ignored.

use std::fmt::Display;
use std::io::{self, IsTerminal, Write};
use std::time::{Duration, Instant};

/// Interval between updates of the live line on a terminal.
const REWRITE: Duration = Duration::from_millis(100);
/// Interval where lines cannot be rewritten.
const REPEAT: Duration = Duration::from_secs(5);

/// Clears from the cursor to the end of the line.
const CLEAR: &str = "\x1b[K";

/// The standard error, with a line that may change.
#[derive(Debug)]
pub struct Terminal {
    rewrites: bool,
    /// Whether the live line is printed, without a line end after it.
    live: bool,
    next: Option<Instant>,
}

impl Terminal {
    /// The standard error as it is.
    pub fn new() -> Self {
        Self { rewrites: io::stderr().is_terminal(), live: false, next: None }
    }

    /// Prints one line that stays.
    pub fn say(&mut self, what: impl Display) {
        let clear = if self.live { format!("\r{CLEAR}") } else { String::new() };
        self.live = false;
        // A terminal in raw mode does not return to the first column by itself.
        let end = if self.rewrites { "\r\n" } else { "\n" };
        let _ = write!(io::stderr().lock(), "{clear}{what}{end}");
    }

    /// Prints the live line at `now`, if it is due.
    pub fn progress(&mut self, now: Instant, line: impl FnOnce() -> Option<String>) {
        let interval = if self.rewrites { REWRITE } else { REPEAT };
        // On a terminal the first one is printed at once, elsewhere after an interval.
        let next = *self.next.get_or_insert(if self.rewrites { now } else { now + interval });
        if now < next {
            return;
        }
        let Some(line) = line() else { return };
        self.next = Some(now + interval);
        let mut stderr = io::stderr().lock();
        if self.rewrites {
            self.live = true;
            let _ = write!(stderr, "\r{line}{CLEAR}");
            let _ = stderr.flush();
        } else {
            let _ = writeln!(stderr, "{line}");
        }
    }
}

impl Default for Terminal {
    fn default() -> Self {
        Self::new()
    }
}

/// Prints a result.
pub fn print(what: impl Display) {
    let _ = writeln!(io::stdout().lock(), "{what}");
}
