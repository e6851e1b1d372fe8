//! Ownership of the files of a graph.

use rustix::fs::Mode;
use rustix::process::umask;

/// Makes all new files and directories of this process and its children private to their user,
/// unless their mode is changed later.
pub fn keep_to_user() {
    let _ = umask(Mode::RWXG | Mode::RWXO);
}
