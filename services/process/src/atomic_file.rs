//! Bytes → a file, atomically: a reader sees the old file or the new one, never a part.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::Path;

/// Replaces the file at `path` by `bytes`.
///
/// # Errors
/// Error of the operating system; the old file is then unchanged.
pub fn write(path: &Path, bytes: &[u8]) -> io::Result<()> {
    replace(path, |beside| {
        let mut file = File::create(beside)?;
        file.write_all(bytes)?;
        file.sync_all()
    })
}

/// Replaces the file at `path` by the one that `fill` writes to the path it gets, beside it.
///
/// # Errors
/// Error of `fill` or of the operating system; the old file is then unchanged.
pub fn replace(path: &Path, fill: impl FnOnce(&Path) -> io::Result<()>) -> io::Result<()> {
    let mut beside = OsString::from(path);
    beside.push(".tmp");
    let beside = Path::new(&beside);
    let replaced = fill(beside).and_then(|()| fs::rename(beside, path));
    if replaced.is_err() {
        let _ = fs::remove_file(beside);
    }
    replaced
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_cannot_be_filled_leaves_the_old_one_and_nothing_beside_it() -> io::Result<()> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("state");
        write(&path, b"old")?;
        let failed = replace(&path, |beside| {
            fs::write(beside, b"a part")?;
            Err(io::Error::other("no space"))
        });
        assert!(failed.is_err());
        assert_eq!(fs::read(&path)?, b"old");
        assert_eq!(fs::read_dir(folder.path())?.count(), 1);
        write(&path, b"new")?;
        assert_eq!(fs::read(&path)?, b"new");
        Ok(())
    }
}
