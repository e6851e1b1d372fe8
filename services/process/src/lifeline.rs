//! process ▶ launcher: that its loop turns, and how far it has come, on the socket that is its standard input.
//!
//! The same goes out as `Health` for everybody who wants to know. But who decides by it whether a process lives hears that from the process
//! itself: on a network somebody else could keep it from being heard, or say it in its place.
//!
//! One byte, the code of its [`Phase`], is one heartbeat. The other way nothing is said, and the end is the launcher's death: end of file, or, if
//! there was something that the launcher had not read, a connection that is reset.

use protocol::message::Phase;
use rustix::net::{SendFlags, send};
use std::io::{self, Read};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::sync::atomic::{AtomicBool, Ordering};

/// How often a line is read at one time, by 64 heartbeats: who says more than anybody needs to keeps no launcher.
const READS_MOST: usize = 64;

/// Whether the standard input of this process is such a line.
static HELD: AtomicBool = AtomicBool::new(false);

/// From now on the standard input of this process is a line to its launcher.
pub(crate) fn hold() {
    HELD.store(true, Ordering::Relaxed);
}

/// One heartbeat, if there is a launcher. Does not wait: one that has not listened for long misses it.
pub(crate) fn beat(phase: u32) {
    if HELD.load(Ordering::Relaxed) {
        // Who has another input, as a pipe, has no launcher that listens.
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
    /// A line, and the standard input of the process that is to hold its other end.
    ///
    /// # Errors
    /// What the system says.
    pub fn new() -> io::Result<(Self, OwnedFd)> {
        let (line, other) = UnixStream::pair()?;
        line.set_nonblocking(true)?;
        Ok((Self { line, beats: 0, phase: Phase::Starting }, other.into()))
    }

    /// Takes in what has been said by now. Does not wait.
    pub fn listen(&mut self) {
        let mut said = [0; 64];
        for _ in 0..READS_MOST {
            // Nothing more to be heard, or nobody there any more: the system says how he ended.
            let Ok(count @ 1..) = self.line.read(&mut said) else { return };
            self.beats += count as u64;
            let last = said
                .iter()
                .take(count)
                .rev()
                .find_map(|&code| Phase::try_from(u32::from(code)).ok());
            self.phase = last.unwrap_or(self.phase);
        }
    }

    /// Heartbeats heard.
    pub fn beats(&self) -> u64 {
        self.beats
    }

    /// How far the process has come, by the last of them.
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
    fn each_byte_is_a_heartbeat_and_the_last_says_how_far_it_has_come() -> io::Result<()> {
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
            "what is no phase says nothing of it"
        );
        other.write_all(&[Phase::Running.code() as u8])?;
        drop(other);
        lifeline.listen();
        assert_eq!(
            (lifeline.beats(), lifeline.phase()),
            (103, Phase::Running),
            "what was said before the end counts"
        );
        Ok(())
    }

    #[test]
    fn who_writes_without_end_is_heard_a_bit_at_a_time() -> io::Result<()> {
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
    fn a_launcher_that_dies_with_heartbeats_unread_ends_its_processes_as_well() -> io::Result<()> {
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
