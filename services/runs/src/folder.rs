//! The run directory: settings, logs, record, summary.

use crate::private::{self, NotPrivate};
use crate::utc::utc;
use std::path::{Path, PathBuf};
use std::time::SystemTime;
use std::{fs, io};

/// Default parent of run directories.
const RUNS: &str = "runs";

/// Why a run directory cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum FolderError {
    /// It is not empty, and would contain two runs.
    #[error("--out {}: expected a new or empty folder", folder.display())]
    NotEmpty {
        /// The directory.
        folder: PathBuf,
    },
    /// Other users could read or change its contents.
    #[error("{0}; or name another folder with --out")]
    NotPrivate(#[from] NotPrivate),
    /// It cannot be created.
    #[error("the folder {} cannot be made: {source}", folder.display())]
    Unusable {
        /// The directory.
        folder: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
}

/// Creates the run directory and returns its absolute path. `out` must be new, or empty and private
/// to this user. Without `out` the name contains time, scenario and graph. No other user can enter
/// it.
///
/// # Errors
/// [`FolderError`].
pub fn create(out: Option<&Path>, scenario: &str, id: &str) -> Result<PathBuf, FolderError> {
    let folder = out.map_or_else(
        || Path::new(RUNS).join(format!("{}-{scenario}-{id}", utc(SystemTime::now()))),
        Path::to_path_buf,
    );
    let unusable = |source| FolderError::Unusable { folder: folder.clone(), source };
    check(&folder)?;
    private::make(&folder)?;
    // Two launches that start at the same time both find the directory empty. Only one creates
    // this.
    fs::create_dir(folder.join("settings")).map_err(|source| match source.kind() {
        io::ErrorKind::AlreadyExists => FolderError::NotEmpty { folder: folder.clone() },
        _ => unusable(source),
    })?;
    folder.canonicalize().map_err(unusable)
}

/// Checks that a run may use `folder`. Creates nothing.
///
/// # Errors
/// [`FolderError`] if it exists and is not empty, or not private to this user.
pub fn check(folder: &Path) -> Result<(), FolderError> {
    if fs::symlink_metadata(folder).is_err_and(|error| error.kind() == io::ErrorKind::NotFound) {
        return Ok(());
    }
    private::check(folder)?;
    match fs::read_dir(folder).map(|mut entries| entries.next()) {
        Ok(None) => Ok(()),
        Ok(Some(_)) => Err(FolderError::NotEmpty { folder: folder.to_path_buf() }),
        Err(source) => Err(FolderError::Unusable { folder: folder.to_path_buf(), source }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_one_of_several_simultaneous_runs_gets_the_directory()
    -> Result<(), Box<dyn std::error::Error>> {
        for _ in 0..20 {
            let parent = tempfile::tempdir()?;
            let (out, start) = (parent.path().join("run"), std::sync::Barrier::new(8));
            let begin = || {
                start.wait();
                create(Some(&out), "paper", "a").is_ok()
            };
            let got = std::thread::scope(|scope| {
                let beginners: Vec<_> = (0..8).map(|_| scope.spawn(begin)).collect();
                beginners
                    .into_iter()
                    .filter_map(|beginner| beginner.join().ok())
                    .filter(|&got| got)
                    .count()
            });
            assert_eq!(got, 1);
        }
        Ok(())
    }

    #[test]
    fn two_runs_never_share_a_folder() -> Result<(), Box<dyn std::error::Error>> {
        let parent = tempfile::tempdir()?;
        let out = parent.path().join("deep/run");
        let folder = create(Some(&out), "paper", "a")?;
        assert!(folder.join("settings").is_dir());
        let refused = create(Some(&out), "paper", "b");
        assert!(
            matches!(&refused, Err(FolderError::NotEmpty { folder }) if *folder == out),
            "{refused:?}"
        );
        Ok(())
    }
}
