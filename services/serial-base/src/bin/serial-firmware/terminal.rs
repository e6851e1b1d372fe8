//! The pseudo-terminal that stands for the serial port.

use anyhow::Context;
use rustix::fd::OwnedFd;
use rustix::fs::{Mode, OFlags, fcntl_setfl, open};
use rustix::io::{Errno, read, write};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;

/// Both ends of the cable: that of the firmware, and that of the driver, which stays open so that
/// drivers can come and go.
#[derive(Debug)]
pub(crate) struct Terminal {
    ours: OwnedFd,
    _theirs: OwnedFd,
}

impl Terminal {
    /// A new terminal, to which `link` leads.
    pub(crate) fn open(link: &Path) -> anyhow::Result<Self> {
        let ours = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        grantpt(&ours)?;
        unlockpt(&ours)?;
        fcntl_setfl(&ours, OFlags::NONBLOCK)?;
        let name = ptsname(&ours, Vec::new())?;
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
        let theirs = open(&name, flags, Mode::empty())?;
        // No echo before the driver opens it.
        let mut modes = tcgetattr(&theirs)?;
        modes.make_raw();
        tcsetattr(&theirs, OptionalActions::Now, &modes)?;
        // A firmware that was killed has left its link behind.
        let _ = fs::remove_file(link);
        symlink(name.to_str()?, link)
            .with_context(|| format!("the link {} cannot be created", link.display()))?;
        Ok(Self { ours, _theirs: theirs })
    }

    /// The bytes that have arrived.
    pub(crate) fn receive(&self) -> anyhow::Result<Vec<u8>> {
        let mut bytes = vec![0; 4096];
        match read(&self.ours, &mut bytes) {
            Ok(count) => bytes.truncate(count),
            Err(Errno::AGAIN | Errno::INTR) => bytes.clear(),
            Err(error) => return Err(error.into()),
        }
        Ok(bytes)
    }

    /// Sends `line`; without a driver that reads, it is lost.
    pub(crate) fn send(&self, line: &[u8]) -> anyhow::Result<()> {
        match write(&self.ours, line) {
            Ok(_) | Err(Errno::AGAIN | Errno::INTR) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }
}
