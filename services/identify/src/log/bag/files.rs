//! The files of a bag → their topics and messages, whatever the container.

use super::{BagError, mcap_file, ros, sqlite_file};
use crate::log::LogError;
use recorder::reader::{self, SourceError};
use recorder::segment;
use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};

/// Largest message and largest MCAP record \[bytes\]: a damaged length does not make this process
/// allocate more.
pub(super) const BYTES_MAX: usize = reader::RECORD_BYTES_MAX;

/// What every sqlite3 file begins with.
const SQLITE_MAGIC: &[u8] = b"SQLite format 3\0";

/// Endings of a bag's files. The last is that of a compressed file.
const EXTENSIONS: [&str; 3] = ["db3", "mcap", "zstd"];

/// A topic of a bag.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Topic {
    pub(super) name: String,
    /// Type of its messages, such as `nav_msgs/msg/Odometry`.
    pub(super) kind: String,
    /// Their encoding: `cdr`.
    pub(super) encoding: String,
}

/// One message, with the time at which it was recorded \[ns\].
pub(super) struct Recorded<'bytes> {
    pub(super) topic: &'bytes str,
    pub(super) nanos: i64,
    pub(super) bytes: &'bytes [u8],
}

/// Takes a message, or refuses it.
pub(super) type Take<'take> = dyn FnMut(&Recorded<'_>) -> Result<(), LogError> + 'take;

#[derive(Debug, Clone, Copy)]
enum Container {
    Mcap,
    Sqlite,
}

/// Whether `path` is a bag, and not a record of ours.
pub(crate) fn is_bag(path: &Path) -> bool {
    if path.is_dir() {
        return path.join("metadata.yaml").exists()
            || (segment::paths(path).is_empty() && !in_folder(path).is_empty());
    }
    let begins = begin(path).unwrap_or_default();
    let is_mcap = begins.starts_with(mcap::MAGIC);
    let is_record = || reader::head(path).is_ok_and(|head| head.profile == segment::PROFILE);
    begins.starts_with(SQLITE_MAGIC)
        || begins.starts_with(&ros::ZSTD_MAGIC)
        || (is_mcap && !is_record())
}

/// The files of the bag at `path`, by name.
pub(super) fn files(path: &Path) -> Result<Vec<PathBuf>, LogError> {
    let files = if path.is_dir() { in_folder(path) } else { vec![path.to_owned()] };
    if files.is_empty() {
        Err(SourceError::NoFiles { path: path.to_owned() }.into())
    } else {
        Ok(files)
    }
}

fn in_folder(folder: &Path) -> Vec<PathBuf> {
    let is_part = |path: &PathBuf| {
        let extension = path.extension().and_then(|extension| extension.to_str());
        extension.is_some_and(|extension| EXTENSIONS.contains(&extension))
    };
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.path()).filter(is_part).collect();
    files.sort();
    files
}

/// The first bytes of a file.
fn begin(path: &Path) -> Result<Vec<u8>, SourceError> {
    let read = || {
        let mut bytes = Vec::new();
        File::open(path)?.take(SQLITE_MAGIC.len() as u64).read_to_end(&mut bytes)?;
        Ok(bytes)
    };
    read().map_err(|source| SourceError::Read { path: path.to_owned(), source })
}

fn container(file: &Path) -> Result<Container, LogError> {
    let begins = begin(file)?;
    if begins.starts_with(mcap::MAGIC) {
        return Ok(Container::Mcap);
    }
    if begins.starts_with(SQLITE_MAGIC) {
        return Ok(Container::Sqlite);
    }
    let path = file.to_owned();
    let is_compressed = begins.starts_with(&ros::ZSTD_MAGIC);
    Err(if is_compressed { BagError::Compressed(path) } else { BagError::Foreign(path) }.into())
}

/// The topics with messages in `files`, sorted.
pub(super) fn topics(files: &[PathBuf]) -> Result<Vec<Topic>, LogError> {
    let mut topics = BTreeSet::new();
    for file in files {
        topics.append(&mut match container(file)? {
            Container::Mcap => mcap_file::topics(file)?,
            Container::Sqlite => sqlite_file::topics(file)?,
        });
    }
    Ok(topics.into_iter().collect())
}

/// Passes each message of the topics `wanted` in `file` to `take`, in the order of the file.
/// Returns whether the file ends early.
pub(super) fn messages(
    file: &Path,
    wanted: &[&str],
    take: &mut Take<'_>,
) -> Result<bool, LogError> {
    match container(file)? {
        Container::Mcap => mcap_file::messages(file, wanted, take),
        Container::Sqlite => sqlite_file::messages(file, wanted, take).map(|()| false),
    }
}
