//! Folders of this user that nobody else can enter.
//!
//! Whoever could write there could drive the robot, or have a file written over that is none of the run's. A folder that is not as it must be
//! is refused and not mended: somebody has made it so, and may have been in it already.

use protocol::access::{Changeable, replaceable};
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::{fs, io};

/// What others than the owner may do, in a mode.
const GROUP_AND_OTHERS: u32 = 0o077;
/// What a mode says of permissions.
const PERMISSIONS: u32 = 0o7777;

/// A folder is not this user's alone.
#[derive(Debug, thiserror::Error)]
pub enum NotPrivate {
    /// It leads where somebody else may have chosen, or is no folder.
    #[error("{}: expected a folder, this is {}", folder.display(), if *link { "a symbolic link" } else { "none" })]
    NoFolder {
        /// What was found.
        folder: PathBuf,
        /// Whether it is a symbolic link.
        link: bool,
    },
    /// Another user's.
    #[error("{}: expected a folder of user {user}, this is one of user {owner}", folder.display())]
    Foreign {
        /// The folder.
        folder: PathBuf,
        /// Whose it is.
        owner: u32,
        /// Who launches.
        user: u32,
    },
    /// Others can read or change what is in it.
    #[error("{0}: expected a folder that nobody else can enter, mode 700, this has mode {mode:o}: `chmod 700 {0}` if all in it is yours", folder.display())]
    Open {
        /// The folder.
        folder: PathBuf,
        /// Its permissions.
        mode: u32,
    },
    /// Others can put another folder in its place.
    #[error("{}: expected to lie where others cannot replace it, but {above}", folder.display())]
    Replaceable {
        /// The folder.
        folder: PathBuf,
        /// What it lies in, however far above.
        above: Changeable,
    },
    /// The file system refuses.
    #[error("{}: {source}", folder.display())]
    FileSystem {
        /// What could not be used.
        folder: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}

/// Makes `folder`, and what it lies in, for this user alone; or finds that it is so already.
///
/// # Errors
/// [`NotPrivate`].
pub fn make(folder: &Path) -> Result<(), NotPrivate> {
    let made = fs::DirBuilder::new().recursive(true).mode(0o700).create(folder);
    match made {
        // What is there is judged below.
        Err(error)
            if !matches!(
                error.kind(),
                io::ErrorKind::AlreadyExists | io::ErrorKind::NotADirectory
            ) =>
        {
            Err(NotPrivate::FileSystem { folder: folder.to_owned(), source: error })
        }
        _ => check(folder),
    }
}

/// Whether `folder` is a folder of this user that nobody else can enter, or replace by another.
///
/// # Errors
/// [`NotPrivate`].
pub fn check(folder: &Path) -> Result<(), NotPrivate> {
    // A slash at the end would lead through a link.
    let folder: PathBuf = folder.components().collect();
    let failed = |source| NotPrivate::FileSystem { folder: folder.clone(), source };
    let found = fs::symlink_metadata(&folder).map_err(failed)?;
    if !found.is_dir() {
        return Err(NotPrivate::NoFolder { link: found.is_symlink(), folder });
    }
    let user = rustix::process::geteuid().as_raw();
    if found.uid() != user {
        return Err(NotPrivate::Foreign { folder, owner: found.uid(), user });
    }
    if found.mode() & GROUP_AND_OTHERS != 0 {
        return Err(NotPrivate::Open { mode: found.mode() & PERMISSIONS, folder });
    }
    match replaceable(&folder).map_err(failed)? {
        Some(above) => Err(NotPrivate::Replaceable { folder, above }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::error::Error;
    use std::os::unix::fs::{PermissionsExt, chown, symlink};

    /// What is said of a folder in `parent` that `prepare` has made.
    fn said(
        parent: &Path,
        prepare: impl FnOnce(&Path) -> io::Result<()>,
    ) -> Result<String, Box<dyn Error>> {
        let folder = parent.join("folder");
        prepare(&folder)?;
        let said = make(&folder).err().map_or_else(String::new, |error| error.to_string());
        Ok(said.replace(&folder.display().to_string(), "FOLDER"))
    }

    fn with_mode(folder: &Path, mode: u32) -> io::Result<()> {
        fs::create_dir(folder)?;
        fs::set_permissions(folder, fs::Permissions::from_mode(mode))
    }

    #[test]
    fn what_is_made_nobody_else_can_enter_nor_what_it_lies_in() -> Result<(), Box<dyn Error>> {
        let parent = tempfile::tempdir()?;
        make(&parent.path().join("deep/deeper"))?;
        for made in ["deep", "deep/deeper"] {
            assert_eq!(
                fs::metadata(parent.path().join(made))?.mode() & PERMISSIONS,
                0o700,
                "{made}"
            );
        }
        make(&parent.path().join("deep/deeper"))?;
        Ok(())
    }

    #[test]
    fn a_folder_that_others_can_enter_is_refused_with_its_mode() -> Result<(), Box<dyn Error>> {
        for mode in [0o755, 0o770, 0o707, 0o720, 0o702, 0o701, 0o1777] {
            let parent = tempfile::tempdir()?;
            let said = said(parent.path(), |folder| with_mode(folder, mode))?;
            let expected =
                "FOLDER: expected a folder that nobody else can enter, mode 700, this has mode";
            assert_eq!(
                said,
                format!("{expected} {mode:o}: `chmod 700 FOLDER` if all in it is yours")
            );
        }
        Ok(())
    }

    #[test]
    fn a_link_is_refused_wherever_it_leads_and_so_is_a_file() -> Result<(), Box<dyn Error>> {
        let (own, parent) = (tempfile::tempdir()?, tempfile::tempdir()?);
        let linked = said(parent.path(), |folder| symlink(own.path(), folder))?;
        assert_eq!(linked, "FOLDER: expected a folder, this is a symbolic link");
        let slash = check(&parent.path().join("folder/")).map_err(|error| error.to_string());
        assert!(slash.is_err_and(|said| said.ends_with("this is a symbolic link")));
        let parent = tempfile::tempdir()?;
        assert_eq!(
            said(parent.path(), |folder| fs::write(folder, ""))?,
            "FOLDER: expected a folder, this is none"
        );
        Ok(())
    }

    #[test]
    fn a_folder_that_others_can_replace_is_refused() -> Result<(), Box<dyn Error>> {
        let parent = tempfile::tempdir()?;
        fs::set_permissions(parent.path(), fs::Permissions::from_mode(0o777))?;
        let refused = said(parent.path(), |folder| with_mode(folder, 0o700))?;
        assert!(
            refused.starts_with("FOLDER: expected to lie where others cannot replace it, but ")
                && refused.ends_with("has mode 777")
        );
        fs::set_permissions(parent.path(), fs::Permissions::from_mode(0o1777))?;
        make(&parent.path().join("folder"))?;
        Ok(())
    }

    #[test]
    fn a_folder_is_refused_whose_way_others_can_replace_however_far_above()
    -> Result<(), Box<dyn Error>> {
        let home = tempfile::tempdir()?;
        let (open, parent) = (home.path().join("open"), home.path().join("open/deep/deeper"));
        make(&parent)?;
        make(&parent.join("folder"))?;
        for mode in [0o777, 0o757] {
            fs::set_permissions(&open, fs::Permissions::from_mode(mode))?;
            let refused = said(&parent, |_| Ok(()))?;
            assert_eq!(
                refused,
                format!(
                    "FOLDER: expected to lie where others cannot replace it, but {} has mode {mode:o}",
                    open.display()
                )
            );
        }
        Ok(())
    }

    #[test]
    fn another_users_folder_is_refused() -> Result<(), Box<dyn Error>> {
        if !rustix::process::geteuid().is_root() {
            // Only root can give a folder away; but every user has met one of root's.
            assert!(matches!(check(Path::new("/usr")), Err(NotPrivate::Foreign { owner: 0, .. })));
            return Ok(());
        }
        let parent = tempfile::tempdir()?;
        let said = said(parent.path(), |folder| {
            with_mode(folder, 0o700).and_then(|()| chown(folder, Some(65_534), None))
        })?;
        assert_eq!(said, "FOLDER: expected a folder of user 0, this is one of user 65534");
        Ok(())
    }
}
