//! A file or folder → the users other than this one and root that could change it or replace it.
//!
//! The owner of `/` counts as root. In a separate user namespace root has another number, and
//! nothing else identifies it.

use std::fs;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// The group may write.
const GROUP_WRITES: u32 = 0o020;
/// Others may write.
const OTHERS_WRITE: u32 = 0o002;
/// Only the owner of an entry can remove or rename it.
const STICKY: u32 = 0o1000;
/// Permission bits of a mode.
pub(super) const PERMISSIONS: u32 = 0o7777;

/// A file or folder that a user other than this one and root could change.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Changeable {
    /// Its owner could change it.
    #[error("{} is of user {owner}", path.display())]
    Foreign {
        /// File or folder.
        path: PathBuf,
        /// User id of its owner.
        owner: u32,
    },
    /// Its group, or all users, could change it.
    #[error("{} has mode {mode:o}", path.display())]
    Open {
        /// File or folder.
        path: PathBuf,
        /// Its permissions.
        mode: u32,
    },
}

/// Whether another user could change the file or folder at `path`.
///
/// # Errors
/// The error of the file system.
pub fn changeable(path: &Path) -> io::Result<Option<Changeable>> {
    let found = fs::metadata(path)?;
    if !is_trusted(found.uid())? {
        return Ok(Some(Changeable::Foreign { path: path.to_owned(), owner: found.uid() }));
    }
    let is_open = found.mode() & (GROUP_WRITES | OTHERS_WRITE) != 0;
    Ok(is_open
        .then(|| Changeable::Open { path: path.to_owned(), mode: found.mode() & PERMISSIONS }))
}

/// The file or folder above `path` through which another user could replace it. Checks the path as
/// written and the path with links resolved.
///
/// A folder with the sticky bit, as `/tmp`, is accepted: there only the owner renames an entry. So
/// is a folder writable by a group that has its owner as the only member. For root any owner is
/// accepted: if root runs programs in a folder of another user, as in a container, it trusts that
/// user already.
///
/// # Errors
/// The error of the file system.
pub fn replaceable(path: &Path) -> io::Result<Option<Changeable>> {
    let (written, real) = (std::path::absolute(path)?, path.canonicalize()?);
    for above in written.ancestors().chain(real.ancestors()) {
        let found = fs::symlink_metadata(above)?;
        let (owner, mode) = (found.uid(), found.mode() & PERMISSIONS);
        if !is_trusted(owner)? && !rustix::process::geteuid().is_root() {
            return Ok(Some(Changeable::Foreign { path: above.to_owned(), owner }));
        }
        // The mode of a link means nothing, and the permissions of the target itself are not judged
        // here.
        if found.is_symlink() || above == written || above == real || mode & STICKY != 0 {
            continue;
        }
        if mode & OTHERS_WRITE != 0 || (mode & GROUP_WRITES != 0 && !is_alone(owner, found.gid())) {
            return Ok(Some(Changeable::Open { path: above.to_owned(), mode }));
        }
    }
    Ok(None)
}

/// Whether `owner` is this user or root.
fn is_trusted(owner: u32) -> io::Result<bool> {
    Ok(owner == 0
        || owner == rustix::process::geteuid().as_raw()
        || owner == fs::metadata("/")?.uid())
}

/// Whether `owner` is the only user in `group`, by the files of this machine. False if these files
/// do not answer it.
fn is_alone(owner: u32, group: u32) -> bool {
    let read = |file| fs::read_to_string(file).unwrap_or_default();
    is_alone_by(&read("/etc/passwd"), &read("/etc/group"), owner, group)
}

fn is_alone_by(users: &str, groups: &str, owner: u32, group: u32) -> bool {
    let is = |field: Option<&&str>, number: u32| {
        field.and_then(|text| text.parse().ok()) == Some(number)
    };
    let fields = |line| str::split(line, ':').collect::<Vec<&str>>();
    let users: Vec<Vec<&str>> = users.lines().map(fields).collect();
    let names: Vec<&str> = users
        .iter()
        .filter(|user| is(user.get(2), owner))
        .filter_map(|user| user.first().copied())
        .collect();
    let another = users.iter().any(|user| is(user.get(3), group) && !is(user.get(2), owner));
    let mut same = groups.lines().map(fields).filter(|line| is(line.get(2), group)).peekable();
    let is_known = !names.is_empty() && same.peek().is_some();
    let members = same
        .flat_map(|line| line.get(3).map_or_else(Vec::new, |members| members.split(',').collect()));
    let mut others = members.filter(|member| !member.is_empty() && !names.contains(member));
    is_known && !another && others.next().is_none()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::error::Error;
    use std::os::unix::fs::{PermissionsExt, chown, symlink};

    type Outcome = Result<(), Box<dyn Error>>;

    fn set(path: &Path, mode: u32) -> io::Result<()> {
        fs::set_permissions(path, fs::Permissions::from_mode(mode))
    }

    #[test]
    fn no_other_user_changes_or_replaces_a_private_file() -> Outcome {
        let home = tempfile::tempdir()?;
        let file = home.path().join("file");
        fs::write(&file, "")?;
        for mode in [0o600, 0o644, 0o755] {
            set(&file, mode)?;
            assert_eq!((changeable(&file)?, replaceable(&file)?), (None, None), "{mode:o}");
        }
        for mode in [0o620, 0o602, 0o666] {
            set(&file, mode)?;
            assert_eq!(changeable(&file)?, Some(Changeable::Open { path: file.clone(), mode }));
        }
        assert!(changeable(&home.path().join("none")).is_err());
        Ok(())
    }

    #[test]
    fn a_folder_that_others_can_write_is_found_however_far_above_it_is() -> Outcome {
        let home = tempfile::tempdir()?;
        let (open, deep) = (home.path().join("open"), home.path().join("open/deep/deeper"));
        fs::create_dir_all(&deep)?;
        set(&open.join("deep"), 0o755)?;
        for (mode, is_found) in
            [(0o777, true), (0o757, true), (0o1777, false), (0o755, false), (0o700, false)]
        {
            set(&open, mode)?;
            let expected = is_found.then(|| Changeable::Open { path: open.clone(), mode });
            assert_eq!(replaceable(&deep)?, expected, "{mode:o}");
        }
        assert_eq!(replaceable(Path::new("/"))?, None);
        Ok(())
    }

    #[test]
    fn a_link_is_no_way_around() -> Outcome {
        let (home, elsewhere) = (tempfile::tempdir()?, tempfile::tempdir()?);
        let (open, private) =
            (elsewhere.path().join("open"), elsewhere.path().join("open/private"));
        fs::create_dir_all(&private)?;
        let link = home.path().join("link");
        symlink(&private, &link)?;
        set(&open, 0o777)?;
        assert_eq!(
            replaceable(&link)?,
            Some(Changeable::Open { path: open.canonicalize()?, mode: 0o777 }),
            "where it leads"
        );
        set(&open, 0o755)?;
        assert_eq!(replaceable(&link)?, None);
        set(home.path(), 0o777)?;
        assert_eq!(
            replaceable(&link)?,
            Some(Changeable::Open { path: home.path().to_owned(), mode: 0o777 }),
            "where it is"
        );
        Ok(())
    }

    #[test]
    fn a_file_of_another_user_can_be_changed_by_that_user() -> Outcome {
        if !rustix::process::geteuid().is_root() {
            // Only root can change the owner of a file.
            return Ok(());
        }
        let home = tempfile::tempdir()?;
        let inner = home.path().join("inner");
        fs::create_dir(&inner)?;
        chown(&inner, Some(65_534), None)?;
        assert_eq!(
            changeable(&inner)?,
            Some(Changeable::Foreign { path: inner.clone(), owner: 65_534 })
        );
        fs::create_dir(inner.join("own"))?;
        assert_eq!(
            replaceable(&inner.join("own"))?,
            None,
            "root trusts in whose folder it runs programs"
        );
        Ok(())
    }

    #[test]
    fn a_group_is_private_only_if_its_owner_is_the_only_known_member() {
        let users = "root:x:0:0::/root:/bin/sh\nann:x:1000:1000::/home/ann:/bin/sh\n\
        bob:x:1001:1001::/home/bob:/bin/sh\ncid:x:1002:50::/:/bin/sh";
        let groups = "root:x:0:\nann:x:1000:\nbob:x:1001:bob,ann\nstaff:x:50:\nown:x:60:ann";
        let alone = |owner, group| is_alone_by(users, groups, owner, group);
        assert!(alone(1000, 1000) && alone(0, 0) && alone(1000, 60));
        assert!(!alone(1001, 1001), "another one is a member");
        assert!(!alone(1000, 50), "it is another one's first group");
        assert!(!alone(1000, 70) && !alone(7, 1000), "who is not known");
        assert!(!is_alone_by("", "", 1000, 1000));
    }
}
