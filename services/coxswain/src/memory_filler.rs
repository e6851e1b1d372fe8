//! All of the machine's shared memory but some, taken for as long as it is held.

use rustix::fs::{FallocateFlags, OFlags, fallocate, statvfs};
use std::fs::File;
use std::io;
use std::os::unix::fs::OpenOptionsExt;

/// Where POSIX shared memory lies on Linux.
const FOLDER: &str = "/dev/shm";
/// More of it is the memory of a whole machine, whose other users would starve \[bytes\].
const LARGEST: u64 = 1 << 30;

/// Why it was not taken.
#[derive(Debug, thiserror::Error)]
pub(crate) enum MemoryFillerError {
    /// It would hurt others.
    #[error("{FOLDER} has {} MiB, expected at most {}: the machine needs it. Make a small one: `unshare --mount`, then mount a tmpfs there", size >> 20, LARGEST >> 20)]
    TooLarge {
        /// Of all of it \[bytes\].
        size: u64,
    },
    /// The file system refuses.
    #[error("{FOLDER}: {0}")]
    File(#[from] io::Error),
}

/// A file in shared memory that fills it, without a name, so that it goes when this is dropped or its process ends, however that happens.
#[derive(Debug)]
pub(crate) struct MemoryFiller(#[expect(dead_code, reason = "held, not used")] File);

impl MemoryFiller {
    /// Takes what there is but for `left` bytes.
    ///
    /// # Errors
    /// [`MemoryFillerError`].
    pub(crate) fn taking_all_but(left: u64) -> Result<Self, MemoryFillerError> {
        let found = statvfs(FOLDER).map_err(io::Error::from)?;
        let size = found.f_blocks * found.f_frsize;
        if size > LARGEST {
            return Err(MemoryFillerError::TooLarge { size });
        }
        // Nobody else can have laid a link there, or a file of that name.
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
