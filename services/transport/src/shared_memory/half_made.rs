//! Removes shared memory that a killed process has left half-made, so that it does not block
//! others.
//!
//! Shared memory is made in two steps: first its name, then its size. A process that is killed in
//! between leaves a name without a size. iceoryx2 0.10 waits for that size without end: in every
//! process that joins, and in every process that communicates with the successor.

use super::prefix;
use super::room::FOLDER;
use crate::Links;
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

/// A living process sets the size of a new name long before this.
const DEAD_AFTER: Duration = Duration::from_millis(40);
/// How often a joining process checks whether it still waits.
const LOOK: Duration = Duration::from_millis(5);

/// Watches the shared memory of one graph.
#[derive(Debug)]
pub struct HalfMade {
    prefix: String,
    /// Names without a size, with their inode, and the time when each was first seen.
    seen: BTreeMap<(OsString, u64), Instant>,
}

impl HalfMade {
    /// For the graph of `links`.
    pub fn new(links: &Links) -> Self {
        Self { prefix: prefix(links), seen: BTreeMap::new() }
    }

    /// Removes each file that has had no size for too long. Returns how many files without a size
    /// are left.
    pub fn remove(&mut self) -> usize {
        let now = Instant::now();
        let before = std::mem::take(&mut self.seen);
        for entry in fs::read_dir(FOLDER).into_iter().flatten().flatten() {
            let name = entry.file_name();
            let ours = name.to_str().is_some_and(|name| name.starts_with(&self.prefix));
            let Some(found) = ours
                .then(|| entry.metadata().ok())
                .flatten()
                .filter(|found| found.is_file() && found.len() == 0)
            else {
                continue;
            };
            let key = (name, found.ino());
            let since = before.get(&key).copied().unwrap_or(now);
            if now.saturating_duration_since(since) < DEAD_AFTER {
                self.seen.insert(key, since);
            } else if fs::remove_file(Path::new(FOLDER).join(&key.0)).is_ok() {
                tracing::warn!(
                    name = %key.0.display(),
                    "removed the incomplete shared memory of a killed process"
                );
            }
        }
        self.seen.len()
    }

    /// Repeats [`remove`](Self::remove) until no half-made file is left.
    pub(super) fn clear(&mut self) {
        while self.remove() > 0 {
            thread::sleep(LOOK);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::File;
    use std::path::PathBuf;

    #[test]
    fn a_name_that_gets_no_size_is_removed_and_one_that_gets_one_in_time_stays()
    -> std::io::Result<()> {
        let links = Links::on_this_machine(format!("half{}", std::process::id()), "/tmp", false, 0);
        let place = |name: &str| PathBuf::from(FOLDER).join(format!("{}{name}", prefix(&links)));
        let (dead, slow, strange) = (
            place("dead"),
            place("slow"),
            PathBuf::from(FOLDER).join(format!("cx.halves{}.x", std::process::id())),
        );
        for file in [&dead, &slow, &strange] {
            File::create(file)?;
        }
        let mut half_made = HalfMade::new(&links);
        assert_eq!(half_made.remove(), 2);
        fs::write(&slow, [1])?;
        half_made.clear();
        let there = [&dead, &slow, &strange].map(|file| file.exists());
        for file in [&slow, &strange] {
            fs::remove_file(file)?;
        }
        assert_eq!(there, [false, true, true], "the dead one, the slow one, another graph's");
        Ok(())
    }
}
