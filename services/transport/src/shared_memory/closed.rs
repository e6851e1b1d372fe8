//! Restricts shared memory that iceoryx2 leaves open to every user of the machine to the user that
//! made it.
//!
//! iceoryx2 0.10 gives the counter of a graph's nodes mode 666, whatever the umask. The counter
//! carries no message, but a user that truncates it ends every process that joins later. iceoryx2
//! makes all other files for its user alone.

use super::prefix;
use super::room::FOLDER;
use crate::Links;
use rustix::process::geteuid;
use std::fs::{self, Permissions};
use std::os::unix::fs::{MetadataExt, PermissionsExt};

/// Permissions of all users but the owner, in a mode.
const GROUP_AND_OTHERS: u32 = 0o077;
/// Permissions that the owner needs.
const OWNER_READ_WRITE: u32 = 0o600;

/// Restricts the files that this user has made for the graph of `links` and that other users could
/// open.
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
        // A file whose process has just ended is restricted as well.
        if ours
            && let Err(error) =
                fs::set_permissions(entry.path(), Permissions::from_mode(OWNER_READ_WRITE))
        {
            tracing::debug!(
                %error,
                name = %entry.file_name().display(),
                "the permissions of shared memory remain as iceoryx2 has set them"
            );
        }
    }
}
