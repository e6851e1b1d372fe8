//! A program that prints lines, read while it runs.

use crate::{Outcome, wait_until};
use std::error::Error;
use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;

/// The lines printed so far.
type Collected = Arc<Mutex<Vec<String>>>;

/// The program; it ends with this value.
pub struct Reader {
    child: Child,
    output: Collected,
    errors: Collected,
    read: usize,
}

impl Reader {
    /// Starts it.
    ///
    /// # Errors
    /// If it cannot be started.
    pub fn start(command: &mut Command) -> Result<Self, Box<dyn Error>> {
        let mut child =
            command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn()?;
        let output = collect(child.stdout.take().ok_or("no output")?);
        let errors = collect(child.stderr.take().ok_or("no errors")?);
        Ok(Self { child, output, errors, read: 0 })
    }

    /// Its process id.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// The next `count` lines.
    ///
    /// # Errors
    /// If they do not arrive in time; the error contains its standard error.
    pub fn lines(&mut self, count: usize) -> Result<Vec<String>, Box<dyn Error>> {
        let end = self.read + count;
        wait_until(&format!("{count} lines"), || lock(&self.output).len() >= end)
            .map_err(|error| format!("{error}; {}", self.errors()))?;
        let lines = lock(&self.output).get(self.read..end).unwrap_or_default().to_vec();
        self.read = end;
        Ok(lines)
    }

    /// Its standard error so far.
    pub fn errors(&self) -> String {
        lock(&self.errors).join("\n")
    }

    /// Waits until its standard error contains `text` at least `times` times.
    ///
    /// # Errors
    /// If it does not in time.
    pub fn wait_for_error(&self, text: &str, times: usize) -> Outcome {
        wait_until(&format!("{text:?}"), || self.errors().matches(text).count() >= times)
    }

    /// Waits until it has ended by itself.
    ///
    /// # Errors
    /// If it does not end in time.
    pub fn end(&mut self) -> Result<ExitStatus, Box<dyn Error>> {
        let mut status = None;
        wait_until("its end", || {
            status = self.child.try_wait().ok().flatten();
            status.is_some()
        })?;
        status.ok_or_else(|| "no status".into())
    }
}

impl Drop for Reader {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn collect(stream: impl Read + Send + 'static) -> Collected {
    let collected = Collected::default();
    let lines = Arc::clone(&collected);
    thread::spawn(move || {
        BufReader::new(stream)
            .lines()
            .map_while(Result::ok)
            .for_each(|line| lock(&lines).push(line));
    });
    collected
}

fn lock(collected: &Collected) -> std::sync::MutexGuard<'_, Vec<String>> {
    collected.lock().unwrap_or_else(PoisonError::into_inner)
}
