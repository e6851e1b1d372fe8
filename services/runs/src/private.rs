//! Directories that only this user can enter.
//!
//! Another user with write access could drive the robot, or cause a file outside the run to be
//! overwritten. A directory with wrong permissions is rejected and not corrected, because another
//! process may have entered it already.

use access::{Changeable, replaceable};
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::{fs, io};

/// Mode bits of the permissions of group and others.
const GROUP_AND_OTHERS: u32 = 0o077;
/// Mode bits of all permissions.
const PERMISSIONS: u32 = 0o7777;

/// Why a directory is not private to this user.
#[derive(Debug, thiserror::Error)]
pub enum NotPrivate {
    /// It is a link, whose target another user may have chosen, or not a directory.
    #[error(
        "{}: expected a folder, this is {}",
        folder.display(),
        if *link { "a symbolic link" } else { "none" }
    )]
    NoFolder {
        /// The path.
        folder: PathBuf,
        /// Whether it is a symbolic link.
        link: bool,
    },
    /// It belongs to another user.
    #[error("{}: expected a folder of user {user}, this is one of user {owner}", folder.display())]
    Foreign {
        /// The directory.
        folder: PathBuf,
        /// User id of its owner.
        owner: u32,
        /// User id of this process.
        user: u32,
    },
    /// Other users can read or change its contents.
    #[error(
        "{0}: expected a folder without access for other users, mode 700, this has mode {mode:o}: \
         `chmod 700 {0}` if all in it is yours",
        folder.display()
    )]
    Open {
        /// The directory.
        folder: PathBuf,
        /// Its permissions.
        mode: u32,
    },
    /// Other users can replace it by another directory.
    #[error("{}: expected a path that other users cannot replace, but {above}", folder.display())]
    Replaceable {
        /// The directory.
        folder: PathBuf,
        /// A parent directory, at any level, that others can change.
        above: Changeable,
    },
    /// Error of the file system.
    #[error("{}: {source}", folder.display())]
    FileSystem {
        /// File or directory of the error.
        folder: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
}

/// Creates `folder` and its parents for this user only, or checks that `folder` is already private.
///
/// # Errors
/// [`NotPrivate`].
pub fn make(folder: &Path) -> Result<(), NotPrivate> {
    let made = fs::DirBuilder::new().recursive(true).mode(0o700).create(folder);
    match made {
        // What exists is checked below.
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

/// Checks that `folder` is a directory of this user that no other user can enter or replace.
///
/// # Errors
/// [`NotPrivate`].
pub fn check(folder: &Path) -> Result<(), NotPrivate> {
    // A slash at the end would follow a symbolic link.
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

    /// Error for a directory in `parent` that `prepare` has created.
    fn refusal(
        parent: &Path,
        prepare: impl FnOnce(&Path) -> io::Result<()>,
    ) -> Result<NotPrivate, Box<dyn Error>> {
        let folder = parent.join("folder");
        prepare(&folder)?;
        make(&folder).err().ok_or_else(|| "it was accepted".into())
    }

    fn with_mode(folder: &Path, mode: u32) -> io::Result<()> {
        fs::create_dir(folder)?;
        fs::set_permissions(folder, fs::Permissions::from_mode(mode))
    }

    #[test]
    fn a_created_directory_and_its_parents_are_private() -> Result<(), Box<dyn Error>> {
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
    fn a_directory_that_others_can_enter_is_rejected_with_its_mode() -> Result<(), Box<dyn Error>> {
        for mode in [0o755, 0o770, 0o707, 0o720, 0o702, 0o701, 0o1777] {
            let parent = tempfile::tempdir()?;
            let refused = refusal(parent.path(), |folder| with_mode(folder, mode))?;
            assert!(
                matches!(&refused, NotPrivate::Open { folder, mode: found }
                    if *found == mode && folder.ends_with("folder")),
                "{refused:?}"
            );
        }
        Ok(())
    }

    #[test]
    fn links_and_files_are_rejected() -> Result<(), Box<dyn Error>> {
        let (own, parent) = (tempfile::tempdir()?, tempfile::tempdir()?);
        let linked = refusal(parent.path(), |folder| symlink(own.path(), folder))?;
        assert!(matches!(linked, NotPrivate::NoFolder { link: true, .. }), "{linked:?}");
        let slash = check(&parent.path().join("folder/"));
        assert!(matches!(slash, Err(NotPrivate::NoFolder { link: true, .. })), "{slash:?}");
        let parent = tempfile::tempdir()?;
        let file = refusal(parent.path(), |folder| fs::write(folder, ""))?;
        assert!(matches!(file, NotPrivate::NoFolder { link: false, .. }), "{file:?}");
        Ok(())
    }

    #[test]
    fn a_directory_that_others_can_replace_is_rejected() -> Result<(), Box<dyn Error>> {
        let parent = tempfile::tempdir()?;
        fs::set_permissions(parent.path(), fs::Permissions::from_mode(0o777))?;
        let refused = refusal(parent.path(), |folder| with_mode(folder, 0o700))?;
        let expected = Changeable::Open { path: parent.path().canonicalize()?, mode: 0o777 };
        assert!(
            matches!(&refused, NotPrivate::Replaceable { above, .. } if *above == expected),
            "{refused:?}"
        );
        fs::set_permissions(parent.path(), fs::Permissions::from_mode(0o1777))?;
        make(&parent.path().join("folder"))?;
        Ok(())
    }

    #[test]
    fn a_directory_below_a_replaceable_parent_is_rejected() -> Result<(), Box<dyn Error>> {
        let home = tempfile::tempdir()?;
        let (open, parent) = (home.path().join("open"), home.path().join("open/deep/deeper"));
        make(&parent)?;
        make(&parent.join("folder"))?;
        for mode in [0o777, 0o757] {
            fs::set_permissions(&open, fs::Permissions::from_mode(mode))?;
            let refused = refusal(&parent, |_| Ok(()))?;
            let expected = Changeable::Open { path: open.clone(), mode };
            assert!(
                matches!(&refused, NotPrivate::Replaceable { above, .. } if *above == expected),
                "{refused:?}"
            );
        }
        Ok(())
    }

    #[test]
    fn a_directory_of_another_user_is_rejected() -> Result<(), Box<dyn Error>> {
        if !rustix::process::geteuid().is_root() {
            // Only root can give a directory to another user. Every user can test with one of
            // root's.
            assert!(matches!(check(Path::new("/usr")), Err(NotPrivate::Foreign { owner: 0, .. })));
            return Ok(());
        }
        let parent = tempfile::tempdir()?;
        let refused = refusal(parent.path(), |folder| {
            with_mode(folder, 0o700).and_then(|()| chown(folder, Some(65_534), None))
        })?;
        assert!(
            matches!(refused, NotPrivate::Foreign { owner: 65_534, user: 0, .. }),
            "{refused:?}"
        );
        Ok(())
    }
}
