//! Bytes of a serial port ↔ lines. Nothing here waits, except [`Port::wait`] for a stated time.

use crate::line::LINE_MAX;
use driver::BaseError;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{FlockOperation, Mode, OFlags, flock, open};
use rustix::io::Errno;
use rustix::termios::{
    ControlModes, OptionalActions, QueueSelector, Termios, tcflush, tcgetattr, tcsetattr,
};
use std::fmt::Display;
use std::os::fd::OwnedFd;
use std::path::Path;
use std::time::Duration;

/// Bytes that one call of [`Port::receive`] reads at most.
const READ_MAX: usize = 16 * 1024;
/// Bits on the wire per byte: a start bit, 8 data bits, a stop bit.
const BITS_PER_BYTE: u64 = 10;

/// An open serial port: raw, 8N1, without flow control.
#[derive(Debug)]
pub struct Port {
    name: String,
    file: OwnedFd,
    baud: u32,
    lines: Lines,
    /// What is still to be sent of the last line.
    unsent: Vec<u8>,
}

impl Port {
    /// Opens the device file `path` for this process alone, and drops what it has received before.
    ///
    /// # Errors
    /// [`BaseError::Device`] names what the file should be.
    pub fn open(path: &Path, baud: u32) -> Result<Self, BaseError> {
        let name = path.display().to_string();
        let refused = |expected| {
            let device = name.clone();
            move |error: Errno| BaseError::Device { device, expected, source: error.into() }
        };
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let file = open(path, flags, Mode::empty())
            .map_err(refused("the device file of a connected base"))?;
        let mut modes = tcgetattr(&file).map_err(refused("a serial port"))?;
        flock(&file, FlockOperation::NonBlockingLockExclusive)
            .map_err(refused("a port that no other driver uses"))?;
        make_raw(&mut modes, baud).map_err(refused("a serial port of this baud rate"))?;
        tcsetattr(&file, OptionalActions::Now, &modes)
            .and_then(|()| tcflush(&file, QueueSelector::IOFlush))
            .map_err(refused("a serial port of this baud rate"))?;
        Ok(Self { name, file, baud, lines: Lines::default(), unsent: Vec::new() })
    }

    /// Device file.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Passes each line that has arrived to `each`, without its end, and returns the number of
    /// those that were too long.
    ///
    /// # Errors
    /// [`BaseError::Ended`] if the device is gone.
    pub fn receive(&mut self, mut each: impl FnMut(&[u8])) -> Result<u64, BaseError> {
        let (mut bytes, mut read) = ([0; 1024], 0);
        while read < READ_MAX {
            match rustix::io::read(&self.file, &mut bytes) {
                Ok(0) => return Err(self.ended(&"the device is gone")),
                Ok(count) => {
                    read += count;
                    self.lines.take(bytes.get(..count).unwrap_or_default(), &mut each);
                }
                Err(Errno::AGAIN | Errno::INTR) => break,
                Err(error) => return Err(self.ended(&error)),
            }
        }
        Ok(std::mem::take(&mut self.lines.too_long))
    }

    /// Sends `line`, unless a part of the last one is still to be sent: then it sends more of that
    /// one. Returns whether it took `line`.
    ///
    /// # Errors
    /// [`BaseError::Ended`] if the device is gone.
    pub fn send(&mut self, line: &str) -> Result<bool, BaseError> {
        self.send_rest()?;
        let is_free = self.unsent.is_empty();
        if is_free {
            self.unsent.extend_from_slice(line.as_bytes());
            self.send_rest()?;
        }
        Ok(is_free)
    }

    /// Time in which the port transmits `bytes`.
    pub fn time_of(&self, bytes: usize) -> Duration {
        let bits = bytes as u64 * BITS_PER_BYTE;
        Duration::from_nanos(bits * 1_000_000_000 / u64::from(self.baud))
    }

    /// Waits until bytes have arrived, but not longer than `time`.
    pub fn wait(&self, time: Duration) {
        let mut files = [PollFd::new(&self.file, PollFlags::IN)];
        // An interrupted wait is a short one.
        let _ = poll(&mut files, Timespec::try_from(time).ok().as_ref());
    }

    /// The error of a device that is gone.
    pub fn ended(&self, reason: &dyn Display) -> BaseError {
        BaseError::Ended { program: self.name.clone(), reason: reason.to_string() }
    }

    fn send_rest(&mut self) -> Result<(), BaseError> {
        if self.unsent.is_empty() {
            return Ok(());
        }
        match rustix::io::write(&self.file, &self.unsent) {
            Ok(count) => drop(self.unsent.drain(..count)),
            Err(Errno::AGAIN | Errno::INTR) => {}
            Err(error) => return Err(self.ended(&error)),
        }
        Ok(())
    }
}

/// Sets the modes of a port for the protocol: every byte passes as it is.
fn make_raw(modes: &mut Termios, baud: u32) -> Result<(), Errno> {
    modes.make_raw();
    let more = ControlModes::CRTSCTS | ControlModes::CSTOPB | ControlModes::HUPCL;
    modes.control_modes.remove(more);
    modes.control_modes.insert(ControlModes::CLOCAL | ControlModes::CREAD);
    modes.set_speed(baud)
}

/// Bytes → lines.
#[derive(Debug, Default)]
pub struct Lines {
    /// Begin of the next line.
    partial: Vec<u8>,
    /// Number of lines that were longer than [`LINE_MAX`].
    too_long: u64,
    /// Whether the rest of such a line is still to come.
    skipping: bool,
}

impl Lines {
    /// Passes each line that ends in `bytes` to `each`, without its end.
    pub fn take(&mut self, bytes: &[u8], mut each: impl FnMut(&[u8])) {
        for &byte in bytes {
            if byte == b'\n' {
                if !self.skipping {
                    each(&self.partial);
                }
                self.partial.clear();
                self.skipping = false;
            } else if self.partial.len() < LINE_MAX {
                self.partial.push(byte);
            } else if !self.skipping {
                self.skipping = true;
                self.too_long += 1;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines_of(pieces: &[&[u8]]) -> (Vec<Vec<u8>>, u64) {
        let (mut lines, mut found) = (Lines::default(), Vec::new());
        for piece in pieces {
            lines.take(piece, |line| found.push(line.to_vec()));
        }
        (found, lines.too_long)
    }

    #[test]
    fn lines_are_found_however_their_bytes_arrive() {
        let (found, _) = lines_of(&[b"ab", b"", b"c\nd", b"\n\nrest"]);
        assert_eq!(found, [&b"abc"[..], b"d", b""]);
    }

    #[test]
    fn bytes_without_an_end_of_line_do_not_fill_the_memory() {
        let (noise, longest) = ([b'x'; 10_000], [b'y'; LINE_MAX]);
        let (found, too_long) = lines_of(&[&noise, &noise, b"\n", &longest, b"\nok\n"]);
        assert_eq!((found, too_long), (vec![longest.to_vec(), b"ok".to_vec()], 1));
    }

    #[test]
    fn a_file_that_is_no_serial_port_is_rejected_with_its_name() -> std::io::Result<()> {
        let folder = tempfile::tempdir()?;
        let file = folder.path().join("port");
        std::fs::write(&file, "")?;
        for path in [&file, &folder.path().join("missing"), Path::new("/dev/null")] {
            let error = Port::open(path, 115_200).err();
            assert!(
                matches!(&error, Some(BaseError::Device { device, .. })
                    if Path::new(device) == path),
                "{error:?}"
            );
        }
        Ok(())
    }
}
