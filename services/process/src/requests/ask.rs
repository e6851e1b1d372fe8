//! An operator's request → a file, written atomically with its own number.

use super::{FOLDER, Request, Settled, request_file};
use protocol::message::Participant;
use std::fs::{self, Permissions};
use std::io::{self, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Interval between two checks for a reply.
const LOOK: Duration = Duration::from_millis(2);

/// A request could not be written.
#[derive(Debug, thiserror::Error)]
#[error("{}: {source}", path.display())]
pub struct AskError {
    /// Path of the failed operation.
    pub path: PathBuf,
    /// Error of the operating system.
    pub source: io::Error,
}

/// A request that was written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Asked {
    folder: PathBuf,
    role: Participant,
    /// Its number.
    pub number: u64,
}

/// Writes a request to the process of `role` in the run in `folder`.
///
/// # Errors
/// [`AskError`] if the directory cannot be written to, or does not belong to a run.
pub fn ask(folder: &Path, role: Participant, request: &Request) -> Result<Asked, AskError> {
    let inside = folder.join(FOLDER);
    let failed = |path: &Path| {
        let path = path.to_owned();
        move |source| AskError { path, source }
    };
    // The process may belong to another user.
    let readable = Permissions::from_mode(0o644);
    let mut whole = tempfile::Builder::new()
        .prefix(".request-")
        .permissions(readable)
        .tempfile_in(&inside)
        .map_err(failed(&inside))?;
    serde_json::to_writer(&mut whole, request)
        .map_err(io::Error::from)
        .and_then(|()| whole.flush())
        .map_err(failed(whole.path()))?;
    let mut number = last(&inside, role).map_err(failed(&inside))?;
    loop {
        number += 1;
        let file = request_file(folder, role, number);
        // Two simultaneous requests get different numbers: one of them fails here and takes the
        // next.
        match fs::hard_link(whole.path(), &file) {
            Ok(()) => return Ok(Asked { folder: folder.to_owned(), role, number }),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            Err(source) => return Err(AskError { path: file, source }),
        }
    }
}

/// Highest number in use.
fn last(inside: &Path, role: Participant) -> io::Result<u64> {
    let number = |name: &str| {
        name.strip_prefix(role.text())?.strip_prefix('-')?.strip_suffix(".json")?.parse().ok()
    };
    Ok(fs::read_dir(inside)?
        .flatten()
        .filter_map(|entry| number(entry.file_name().to_str()?))
        .max()
        .unwrap_or(0))
}

impl Asked {
    /// The reply, if there is one.
    pub fn answer(&self) -> Option<Settled> {
        Settled::read(&self.folder, self.role, self.number)
    }

    /// Waits for the reply, at most `patience`, and only while it `may` come.
    pub fn wait(&self, patience: Duration, mut may: impl FnMut() -> bool) -> Option<Settled> {
        let begin = Instant::now();
        while begin.elapsed() < patience && may() {
            if let Some(settled) = self.answer() {
                return Some(settled);
            }
            std::thread::sleep(LOOK);
        }
        self.answer()
    }
}
