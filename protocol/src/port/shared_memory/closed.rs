//! Shared memory that iceoryx2 leaves open to every user of the machine, closed to all but its own.
//!
//! iceoryx2 0.10 gives the counter of a graph's nodes mode 666, whatever the umask. It carries no message, but who cuts it off ends every process
//! that joins later. All else it makes for its user alone.

use super::prefix;
use super::room::FOLDER;
use crate::port::Links;
use rustix::process::geteuid;
use std::fs::{self, Permissions};
use std::os::unix::fs::{MetadataExt, PermissionsExt};

/// What others than the owner may do, in a mode.
const GROUP_AND_OTHERS: u32 = 0o077;
/// What the owner needs.
const OWNER_READ_WRITE: u32 = 0o600;

/// Closes what this user has made for the graph of `links` and others could open.
pub(super) fn close(links: &Links) {
    let prefix = prefix(links);
    for entry in fs::read_dir(FOLDER).into_iter().flatten().flatten() {
        if !entry.file_name().to_str().is_some_and(|name| name.starts_with(&prefix)) {
            continue;
        }
        let ours = entry.metadata().is_ok_and(|found| {
            found.is_file()
                && found.uid() == geteuid().as_raw()
                && found.mode() & GROUP_AND_OTHERS != 0
        });
        // One that has just gone is closed as well.
        if ours
            && let Err(error) =
                fs::set_permissions(entry.path(), Permissions::from_mode(OWNER_READ_WRITE))
        {
            tracing::debug!(%error, name = %entry.file_name().display(), "shared memory is as open as iceoryx2 has made it");
        }
    }
}
