//! All of the machine's shared memory but some, taken for as long as it is held.

use rustix::fs::{FallocateFlags, fallocate, statvfs};
use std::fs::{self, File};
use std::io;
use std::path::PathBuf;

/// Where POSIX shared memory lies on Linux.
const FOLDER: &str = "/dev/shm";
/// More of it is the memory of a whole machine, whose other users would starve \[bytes\].
const LARGEST: u64 = 1 << 30;

/// Why it was not taken.
#[derive(Debug, thiserror::Error)]
pub(crate) enum BallastError {
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

/// A file in shared memory that fills it; goes when dropped.
#[derive(Debug)]
pub(crate) struct Ballast {
    path: PathBuf,
}

impl Ballast {
    /// Takes what there is but for `left` bytes.
    ///
    /// # Errors
    /// [`BallastError`].
    pub(crate) fn taking_all_but(left: u64) -> Result<Self, BallastError> {
        let found = statvfs(FOLDER).map_err(io::Error::from)?;
        let size = found.f_blocks * found.f_frsize;
        if size > LARGEST {
            return Err(BallastError::TooLarge { size });
        }
        let path = PathBuf::from(FOLDER).join(format!("coxswain-ballast-{}", std::process::id()));
        let file = File::create(&path)?;
        let ballast = Self { path };
        let length = (found.f_bavail * found.f_frsize).saturating_sub(left);
        if length > 0 {
            fallocate(&file, FallocateFlags::empty(), 0, length).map_err(io::Error::from)?;
        }
        Ok(ballast)
    }
}

impl Drop for Ballast {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.path);
    }
}
