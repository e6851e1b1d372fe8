//! Room in shared memory: enough of it before anybody joins, and what a graph has is its own before anybody writes there.
//!
//! The system gives a page of shared memory when it is first written, and ends the process that writes when there is none left. So
//! nobody joins where little is left, since whoever joins makes the others map more; and what has been made is claimed at once.

use super::{SharedMemory, prefix};
use crate::port::{Links, OpenError};
use rustix::fs::{FallocateFlags, fallocate, statvfs};
use rustix::io::Errno;
use std::fs::{self, File};
use std::path::Path;

/// Where POSIX shared memory lies on Linux.
pub(super) const FOLDER: &str = "/dev/shm";

/// What must be left for one who joins: more than a whole graph takes in real time \[bytes\].
const LEAST_FREE: u64 = 8 << 20;

impl SharedMemory {
    /// Whether there is room for one more member of a graph.
    pub(super) fn check_room() -> Result<(), OpenError> {
        // Where the system does not say, it is tried.
        let Ok(found) = statvfs(FOLDER) else { return Ok(()) };
        let free = found.f_bavail * found.f_frsize;
        if free < LEAST_FREE {
            Err(OpenError::NoRoom { folder: FOLDER.into(), free, least: LEAST_FREE })
        } else {
            Ok(())
        }
    }
}

/// Claims all memory that the graph of `links` has on this machine. What is claimed stays so until it is given back. In lock step, where queues are
/// many times as deep and no robot is moved, nothing is claimed.
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
        // Whoever has just made a file opens it for others last; whoever goes takes his with him.
        let Ok(file) = File::options().read(true).write(true).open(entry.path()) else { continue };
        let length = file.metadata().map_or(0, |found| found.len());
        if length > 0 && fallocate(&file, FallocateFlags::KEEP_SIZE, 0, length) == Err(Errno::NOSPC)
        {
            return Err(OpenError::NoRoom { folder: FOLDER.into(), free: 0, least: length });
        }
    }
    Ok(())
}
