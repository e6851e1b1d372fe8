//! Room in shared memory: checked before a process joins, and claimed by the graph before a process
//! writes there.
//!
//! The system allocates a page of shared memory when it is first written. If none is left, it ends
//! the process that writes. A joining process makes the others map more memory, so no process joins
//! when little is left. Memory that has been made is claimed at once.

use super::{SharedMemory, prefix};
use crate::{Links, OpenError};
use rustix::fs::{FallocateFlags, fallocate, statvfs};
use rustix::io::Errno;
use std::fs::{self, File};
use std::path::Path;

/// Folder of POSIX shared memory on Linux.
pub(super) const FOLDER: &str = "/dev/shm";

/// Least free room for a process that joins: more than a whole graph takes in real time \[bytes\].
const LEAST_FREE: u64 = 8 << 20;

impl SharedMemory {
    /// Checks whether there is room for one more member of a graph.
    pub(super) fn check_room() -> Result<(), OpenError> {
        // Where the system gives no answer, joining is attempted.
        let Ok(found) = statvfs(FOLDER) else { return Ok(()) };
        let free = found.f_bavail * found.f_frsize;
        if free < LEAST_FREE {
            Err(OpenError::NoRoom { folder: FOLDER.into(), free, least: LEAST_FREE })
        } else {
            Ok(())
        }
    }
}

/// Claims all memory that the graph of `links` has on this machine. Claimed memory stays so until
/// it is freed. In lock step nothing is claimed: queues are many times as deep there, and no robot
/// moves.
///
/// # Errors
/// [`OpenError::NoRoom`] if there is not enough for it.
pub fn claim(links: &Links) -> Result<(), OpenError> {
    if links.lock_step {
        return Ok(());
    }
    let prefix = prefix(links);
    for entry in fs::read_dir(Path::new(FOLDER)).into_iter().flatten().flatten() {
        if !entry.file_name().to_str().is_some_and(|name| name.starts_with(&prefix)) {
            continue;
        }
        // A process that makes a file opens it for others last; a process that ends removes its
        // own.
        let Ok(file) = File::options().read(true).write(true).open(entry.path()) else { continue };
        let length = file.metadata().map_or(0, |found| found.len());
        if length > 0 && fallocate(&file, FallocateFlags::KEEP_SIZE, 0, length) == Err(Errno::NOSPC)
        {
            return Err(OpenError::NoRoom { folder: FOLDER.into(), free: 0, least: length });
        }
    }
    Ok(())
}
