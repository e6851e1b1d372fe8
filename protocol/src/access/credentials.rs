//! Where a process finds its certificate, and whether it can be used.

use super::writers::PERMISSIONS;
use super::{Certificate, Changeable, Role, changeable, replaceable};
use serde::{Deserialize, Serialize};
use std::fs;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// The certificate of the role.
pub const CERTIFICATE_FILE: &str = "certificate.pem";
/// Its private key.
pub const KEY_FILE: &str = "key.pem";
/// The certificate of the authority that everybody in the graph has theirs from.
pub const AUTHORITY_FILE: &str = "authority.pem";

/// What others than the owner may do, in a mode.
const GROUP_AND_OTHERS: u32 = 0o077;

/// Certificate and key of one role: a folder with three files.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Credentials {
    folder: PathBuf,
}

/// A certificate cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum AccessError {
    /// A file is not there, or cannot be read.
    #[error("{}: {source}; `deploy/certificates` makes such a file", file.display())]
    File {
        /// The file.
        file: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// Somebody else could take the key.
    #[error(
        "{} has mode {mode:o} and can be read by others than its owner: expected mode 0600 (chmod 600), as `deploy/certificates` makes it",
        file.display()
    )]
    NotPrivate {
        /// The key.
        file: PathBuf,
        /// Its permissions.
        mode: u32,
    },
    /// Somebody else could write another authority or key into it.
    #[error(
        "{0}: expected what is of this user or root and nobody else can write, as `deploy/certificates` makes it: folders of mode 700, files of 600"
    )]
    Changeable(Changeable),
    /// Somebody else could put other certificates in its place.
    #[error("{}: expected to lie where others cannot replace it, but {above}", file.display())]
    Replaceable {
        /// The file.
        file: PathBuf,
        /// What is above it.
        above: Changeable,
    },
    /// Not what it should be.
    #[error("{}: {reason}", file.display())]
    Certificate {
        /// The file.
        file: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// It is for somebody else.
    #[error("{} is for the role {found}, expected one for {expected}", file.display())]
    Role {
        /// The file.
        file: PathBuf,
        /// Whom it is for.
        found: &'static str,
        /// Whom it should be for.
        expected: &'static str,
    },
    /// Its time is over, or has not come.
    #[error("{} is {what}: `deploy/certificates` makes a new one; else look at this machine's clock", file.display())]
    Time {
        /// The file.
        file: PathBuf,
        /// How far from now it is valid.
        what: String,
    },
}

/// What the system says of `file`.
fn failed(file: &Path) -> impl FnOnce(io::Error) -> AccessError {
    let file = file.to_path_buf();
    move |source| AccessError::File { file, source }
}

impl Credentials {
    /// Those in `folder`. Nothing is read yet.
    pub fn in_folder(folder: impl Into<PathBuf>) -> Self {
        Self { folder: folder.into() }
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// File of that name.
    pub fn file(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// What the certificate says. Fails if a file is missing or no certificate, if others can read the key, or if they could have put there what
    /// is to be believed.
    ///
    /// # Errors
    /// [`AccessError`].
    pub fn read(&self) -> Result<Certificate, AccessError> {
        let (certificate, key, authority) =
            (self.file(CERTIFICATE_FILE), self.file(KEY_FILE), self.file(AUTHORITY_FILE));
        let text = fs::read(&certificate).map_err(failed(&certificate))?;
        fs::metadata(&authority).map_err(failed(&authority))?;
        let mode = fs::metadata(&key).map_err(failed(&key))?.mode() & PERMISSIONS;
        if mode & GROUP_AND_OTHERS != 0 {
            return Err(AccessError::NotPrivate { file: key, mode });
        }
        self.check_writers([&certificate, &key, &authority])?;
        Certificate::parse(&text)
            .map_err(|reason| AccessError::Certificate { file: certificate, reason })
    }

    /// Fails if somebody beside this user and root could change `files`, their folder or the one that it is in, or replace any of them.
    fn check_writers(&self, files: [&PathBuf; 3]) -> Result<(), AccessError> {
        let folder = std::path::absolute(&self.folder).map_err(failed(&self.folder))?;
        for path in
            folder.parent().into_iter().chain([folder.as_path()]).chain(files.map(PathBuf::as_path))
        {
            if let Some(found) = changeable(path).map_err(failed(path))? {
                return Err(AccessError::Changeable(found));
            }
        }
        for file in files {
            if let Some(above) = replaceable(file).map_err(failed(file))? {
                return Err(AccessError::Replaceable { file: file.clone(), above });
            }
        }
        Ok(())
    }

    /// The same, and fails unless it is for `role` and valid at `now_s`, Unix time \[s\].
    ///
    /// # Errors
    /// [`AccessError`].
    pub fn check(&self, role: Role, now_s: i64) -> Result<Certificate, AccessError> {
        let certificate = self.read()?;
        let file = || self.file(CERTIFICATE_FILE);
        if certificate.role != role {
            return Err(AccessError::Role {
                file: file(),
                found: certificate.role.name(),
                expected: role.name(),
            });
        }
        let hours = |seconds: i64| format!("{:.1} h", seconds as f64 / 3600.0);
        if now_s >= certificate.until_s {
            return Err(AccessError::Time {
                file: file(),
                what: format!("expired since {}", hours(now_s - certificate.until_s)),
            });
        }
        if now_s < certificate.from_s {
            return Err(AccessError::Time {
                file: file(),
                what: format!("valid only in {}", hours(certificate.from_s - now_s)),
            });
        }
        Ok(certificate)
    }
}
