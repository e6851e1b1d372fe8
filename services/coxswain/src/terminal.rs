//! Everything that is printed: messages and the live line on the standard error, results on the standard output.
//!
//! Nobody may be there to read it, so what cannot be printed is left out.

use std::fmt::Display;
use std::io::{self, IsTerminal, Write};
use std::time::{Duration, Instant};

/// How often the live line changes on a terminal.
const REWRITE: Duration = Duration::from_millis(100);
/// How often it is said where lines cannot be rewritten.
const REPEAT: Duration = Duration::from_secs(5);

/// Clears from the cursor to the end of the line.
const CLEAR: &str = "\x1b[K";

/// The standard error, with a line that may change.
#[derive(Debug)]
pub struct Terminal {
    rewrites: bool,
    /// The live line stands there, without a line end behind it.
    live: bool,
    next: Option<Instant>,
}

impl Terminal {
    /// The standard error as it is.
    pub fn new() -> Self {
        Self { rewrites: io::stderr().is_terminal(), live: false, next: None }
    }

    /// One line that stays.
    pub fn say(&mut self, what: impl Display) {
        let clear = if self.live { format!("\r{CLEAR}") } else { String::new() };
        self.live = false;
        let _ = writeln!(io::stderr().lock(), "{clear}{what}");
    }

    /// The live line as of `now`, if it is time for it.
    pub fn progress(&mut self, now: Instant, line: impl FnOnce() -> Option<String>) {
        let interval = if self.rewrites { REWRITE } else { REPEAT };
        // The first is said at once on a terminal, elsewhere after an interval.
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
