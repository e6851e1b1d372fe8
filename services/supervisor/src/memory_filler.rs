//! Fills the shared memory of the machine, except for a remainder, as long as the value exists.

use rustix::fs::{FallocateFlags, OFlags, fallocate, statvfs};
use std::fs::File;
use std::io;
use std::os::unix::fs::OpenOptionsExt;

/// Place of POSIX shared memory on Linux.
const FOLDER: &str = "/dev/shm";
/// Largest size to fill \[bytes\]. A larger one is the memory of a whole machine, which other users
/// need.
const LARGEST: u64 = 1 << 30;

/// Why the memory was not filled.
#[derive(Debug, thiserror::Error)]
pub(crate) enum MemoryFillerError {
    /// Other users would run out of memory.
    #[error(
        "{FOLDER} has {} MiB, expected at most {}: the machine needs it. \
         Make a small one: `unshare --mount`, then mount a tmpfs there",
        size >> 20,
        LARGEST >> 20
    )]
    TooLarge {
        /// Total size \[bytes\].
        size: u64,
    },
    /// Error of the file system.
    #[error("{FOLDER}: {0}")]
    File(#[from] io::Error),
}

/// A large file in shared memory without a name. The system removes it when this value is dropped
/// or its process ends for any reason.
#[derive(Debug)]
pub(crate) struct MemoryFiller(#[expect(dead_code, reason = "held, not used")] File);

impl MemoryFiller {
    /// Fills the free memory except for `left` bytes.
    ///
    /// # Errors
    /// [`MemoryFillerError`].
    pub(crate) fn taking_all_but(left: u64) -> Result<Self, MemoryFillerError> {
        let found = statvfs(FOLDER).map_err(io::Error::from)?;
        let size = found.f_blocks * found.f_frsize;
        if size > LARGEST {
            return Err(MemoryFillerError::TooLarge { size });
        }
        // No other process can have created a link or a file with this name.
        let file = File::options()
            .write(true)
            .custom_flags(OFlags::TMPFILE.bits().cast_signed())
            .open(FOLDER)?;
        let length = (found.f_bavail * found.f_frsize).saturating_sub(left);
        if length > 0 {
            fallocate(&file, FallocateFlags::empty(), 0, length).map_err(io::Error::from)?;
        }
        Ok(Self(file))
    }
}
