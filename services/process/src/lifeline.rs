//! process ▶ launcher: heartbeat and phase, on the socket that is the standard input of the
//! process.
//!
//! `Health` publishes the same to all subscribers. The launcher decides by the heartbeat whether a
//! process is alive, so it receives it from the process itself. On a network, another peer could
//! suppress or forge it.
//!
//! One byte, the code of its [`Phase`], is one heartbeat. The launcher sends nothing. The end of
//! the line means that the launcher has ended: end of file, or a connection reset if the launcher
//! had not read everything.

use protocol::message::Phase;
use rustix::net::{SendFlags, send};
use std::io::{self, Read};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicBool, Ordering};

/// Largest number of reads of a line at one time, of 64 heartbeats each. A process that sends more
/// does not block the launcher.
const READS_MOST: usize = 64;

/// Whether the standard input of this process is such a line.
static HELD: AtomicBool = AtomicBool::new(false);

/// Uses the standard input of this process as the line to its launcher.
pub(crate) fn hold() {
    HELD.store(true, Ordering::Relaxed);
}

/// Sends one heartbeat, if there is a launcher. Does not wait: if the socket buffer is full, the
/// heartbeat is lost.
pub(crate) fn beat(phase: u32) {
    if HELD.load(Ordering::Relaxed) {
        // Another kind of input, such as a pipe, has no launcher that reads.
        let _ = send(io::stdin(), &[phase as u8], SendFlags::DONTWAIT | SendFlags::NOSIGNAL);
    }
}

/// The launcher's end of the line to one process. When it is dropped that process ends.
#[derive(Debug)]
pub struct Lifeline {
    line: UnixStream,
    beats: u64,
    phase: Phase,
}

impl Lifeline {
    /// Creates a line, and the standard input of the process at its other end.
    ///
    /// # Errors
    /// Error of the operating system.
    pub fn new() -> io::Result<(Self, OwnedFd)> {
        let (line, other) = UnixStream::pair()?;
        line.set_nonblocking(true)?;
        Ok((Self { line, beats: 0, phase: Phase::Starting }, other.into()))
    }

    /// Reads all heartbeats that have arrived. Does not wait.
    pub fn listen(&mut self) {
        let mut codes = [0; 64];
        for _ in 0..READS_MOST {
            // No more data, or the other end is closed. The exit status shows how the process
            // ended.
            let Ok(count @ 1..) = self.line.read(&mut codes) else { return };
            self.beats += count as u64;
            let last = codes
                .iter()
                .take(count)
                .rev()
                .find_map(|&code| Phase::try_from(u32::from(code)).ok());
            self.phase = last.unwrap_or(self.phase);
        }
    }

    /// Number of received heartbeats.
    pub fn beats(&self) -> u64 {
        self.beats
    }

    /// Phase of the process in the last heartbeat.
    pub fn phase(&self) -> Phase {
        self.phase
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Stop;
    use std::io::Write;

    #[test]
    fn each_byte_is_a_heartbeat_and_the_last_gives_the_phase() -> io::Result<()> {
        let (mut lifeline, other) = Lifeline::new()?;
        lifeline.listen();
        assert_eq!((lifeline.beats(), lifeline.phase()), (0, Phase::Starting));
        let mut other = UnixStream::from(other);
        for _ in 0..100 {
            other.write_all(&[Phase::Ready.code() as u8])?;
        }
        other.write_all(&[Phase::Running.code() as u8, 99])?;
        lifeline.listen();
        assert_eq!(
            (lifeline.beats(), lifeline.phase()),
            (102, Phase::Running),
            "a byte that is not a phase changes no phase"
        );
        other.write_all(&[Phase::Running.code() as u8])?;
        drop(other);
        lifeline.listen();
        assert_eq!(
            (lifeline.beats(), lifeline.phase()),
            (103, Phase::Running),
            "heartbeats before the end count"
        );
        Ok(())
    }

    #[test]
    fn an_endless_writer_is_read_in_limited_steps() -> io::Result<()> {
        let (mut lifeline, other) = Lifeline::new()?;
        UnixStream::from(other).write_all(&[Phase::Running.code() as u8; 3 * 64 * READS_MOST])?;
        for time in 1..=3 {
            lifeline.listen();
            assert_eq!(lifeline.beats(), time * 64 * READS_MOST as u64);
        }
        Ok(())
    }

    #[test]
    fn a_line_that_is_dropped_ends_the_input_of_its_process() -> io::Result<()> {
        let (lifeline, other) = Lifeline::new()?;
        drop(lifeline);
        assert_eq!(UnixStream::from(other).read(&mut [0])?, 0);
        Ok(())
    }

    #[test]
    fn a_launcher_that_ends_with_unread_heartbeats_ends_its_processes() -> io::Result<()> {
        let unread = || -> io::Result<UnixStream> {
            let (_lifeline, other) = Lifeline::new()?;
            let mut other = UnixStream::from(other);
            other.write_all(&[Phase::Running.code() as u8; 100])?;
            Ok(other)
        };
        let how = unread()?.read(&mut [0]).map_err(|error| error.kind());
        assert_eq!(how, Err(io::ErrorKind::ConnectionReset), "not the end of a file");
        let stop = Stop::new();
        stop.at_end_of(unread()?);
        assert!(stop.requested());
        Ok(())
    }
}
