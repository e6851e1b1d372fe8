//! Where a process finds its certificate, and whether the certificate can be used.

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
/// The certificate of the authority that issued all certificates of the graph.
pub const AUTHORITY_FILE: &str = "authority.pem";

/// Permissions of all users but the owner, in a mode.
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
        /// The system's error.
        source: io::Error,
    },
    /// Another user could read the key.
    #[error(
        "{} has mode {mode:o}, so other users can read it: expected mode 0600 (chmod \
        600), as `deploy/certificates` makes it",
        file.display()
    )]
    NotPrivate {
        /// The key.
        file: PathBuf,
        /// Its permissions.
        mode: u32,
    },
    /// Another user could write another authority or key into it.
    #[error(
        "{0}: expected to be owned by this user or root, and not writable by others, as \
        `deploy/certificates` makes it: folders of mode 700, files of 600"
    )]
    Changeable(Changeable),
    /// Another user could put other certificates in its place.
    #[error("{}: expected a path that other users cannot replace, but {above}", file.display())]
    Replaceable {
        /// The file.
        file: PathBuf,
        /// The folder or file above it that another user can change.
        above: Changeable,
    },
    /// The file is no usable certificate.
    #[error("{}: {reason}", file.display())]
    Certificate {
        /// The file.
        file: PathBuf,
        /// The reason.
        reason: String,
    },
    /// The certificate is for another role.
    #[error("{} is for the role {found}, expected one for {expected}", file.display())]
    Role {
        /// The file.
        file: PathBuf,
        /// Role of the certificate.
        found: Role,
        /// The expected role.
        expected: Role,
    },
    /// The certificate has expired.
    #[error(
        "{} is expired since {:.1} h: `deploy/certificates` makes a new one; \
         or check this machine's clock",
        file.display(), hours(*since_s)
    )]
    Expired {
        /// The file.
        file: PathBuf,
        /// Time since the end of its validity \[s\].
        since_s: i64,
    },
    /// The certificate is not valid yet.
    #[error(
        "{} is valid only in {:.1} h: `deploy/certificates` makes a new one; \
         or check this machine's clock",
        file.display(), hours(*in_s)
    )]
    TooEarly {
        /// The file.
        file: PathBuf,
        /// Time until the begin of its validity \[s\].
        in_s: i64,
    },
}

fn hours(seconds: i64) -> f64 {
    seconds as f64 / 3600.0
}

/// The system's error about `file`.
fn failed(file: &Path) -> impl FnOnce(io::Error) -> AccessError {
    let file = file.to_path_buf();
    move |source| AccessError::File { file, source }
}

impl Credentials {
    /// The credentials in `folder`. Reads nothing yet.
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

    /// Reads the certificate. Fails if a file is missing or is no certificate, or if other users
    /// can read the key. Also fails if other users could have replaced a file that is to be
    /// trusted.
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

    /// Fails if a user other than this one and root could change `files`, their folder or the
    /// folder above it, or could replace any of them.
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

    /// As [`read`](Self::read); also fails unless the certificate is for `role` and valid at
    /// `now_s`, Unix time \[s\].
    ///
    /// # Errors
    /// [`AccessError`].
    pub fn check(&self, role: &Role, now_s: i64) -> Result<Certificate, AccessError> {
        let certificate = self.read()?;
        let file = || self.file(CERTIFICATE_FILE);
        if certificate.role != *role {
            return Err(AccessError::Role {
                file: file(),
                found: certificate.role,
                expected: role.clone(),
            });
        }
        if now_s >= certificate.until_s {
            let since_s = now_s - certificate.until_s;
            return Err(AccessError::Expired { file: file(), since_s });
        }
        if now_s < certificate.from_s {
            let in_s = certificate.from_s - now_s;
            return Err(AccessError::TooEarly { file: file(), in_s });
        }
        Ok(certificate)
    }
}
