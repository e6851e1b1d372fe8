//! Whose the files of a graph are.

use rustix::fs::Mode;
use rustix::process::umask;

/// Files and folders that this process and those that it starts make from now on are their user's alone, unless they are given away.
pub fn keep_to_user() {
    let _ = umask(Mode::RWXG | Mode::RWXO);
}
