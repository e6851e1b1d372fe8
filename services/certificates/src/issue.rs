//! The authority and the certificates that it signs, as files.
//!
//! ```text
//! <authority>/                 0700
//!     authority.pem            its certificate, which is public
//!     key.pem                  0600: its private key, which stays secret
//! <out>/<role>/                0700, one per role
//!     certificate.pem          contains role and robot
//!     key.pem                  0600
//!     authority.pem
//! ```
//! A directory is created atomically, and no file is ever overwritten.

mod authority;

use access::{AUTHORITY_FILE, CERTIFICATE_FILE, CLIENTS, KEY_FILE, Role};
use authority::{authority_in, make_authority};
use rcgen::{
    CertificateParams, DnType, ExtendedKeyUsagePurpose, Issuer, KeyPair, KeyUsagePurpose,
    date_time_ymd,
};
use std::collections::BTreeMap;
use std::fs::{self, DirBuilder, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::Duration;
use transport::is_graph_name;

/// Addresses for which every certificate of a server is valid.
const LOOPBACK: [&str; 3] = ["localhost", "127.0.0.1", "::1"];

/// Mode bits of the permissions of group and others.
const GROUP_AND_OTHERS: u32 = 0o077;

/// Contents of the certificates.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Order {
    /// Name of the robot.
    pub robot: String,
    /// Hosts, with their addresses in addition to the loopback's.
    pub hosts: BTreeMap<String, Vec<String>>,
    /// Begin of their validity: Unix time \[s\].
    pub from_s: i64,
    /// End of their validity: Unix time \[s\].
    pub until_s: i64,
}

/// Result of [`issue`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Made {
    /// Whether the authority is new too.
    pub new_authority: bool,
    /// One certificate per role, with the addresses for which it is valid.
    pub certificates: Vec<(Role, Vec<String>)>,
}

/// Why no certificates were created.
#[derive(Debug, thiserror::Error)]
pub enum IssueError {
    /// The robot's name cannot be a part of a certificate's subject.
    #[error("--robot {robot:?}: expected 1 to 32 characters out of a-z, 0-9, _ and -")]
    Robot {
        /// The name.
        robot: String,
    },
    /// It is not a name or address.
    #[error(
        "--host NAME={address:?}: expected a host's name or address, \
         as 10.0.0.1 or robot.example, without a port"
    )]
    Address {
        /// The value.
        address: String,
    },
    /// The directory is not empty, and no file is overwritten.
    #[error(
        "--out {}: expected a new or empty folder; \
         certificates that are there are not overwritten",
        out.display()
    )]
    NotEmpty {
        /// The directory.
        out: PathBuf,
    },
    /// The authority would be copied to the robot with the certificates.
    #[error(
        "--authority {}: expected a folder that is not in {}, which goes to the robot",
        authority.display(),
        out.display()
    )]
    Inside {
        /// The authority.
        authority: PathBuf,
        /// The certificates.
        out: PathBuf,
    },
    /// The existing authority cannot be used.
    #[error("the authority {}: {reason}", authority.display())]
    Authority {
        /// Its directory.
        authority: PathBuf,
        /// Reason.
        reason: String,
    },
    /// Error of the file system.
    #[error("{}: {source}", path.display())]
    FileSystem {
        /// File or directory of the error.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// A certificate cannot be signed.
    #[error("no certificate could be signed: {0}")]
    Sign(#[from] rcgen::Error),
}

impl IssueError {
    /// 2 if an option is invalid, else 1.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Sign(_) | Self::FileSystem { .. } => 1,
            _ => 2,
        }
    }
}

/// Creates one certificate per host, and one per other role, in the new directory
/// `out`. The authority in the directory
/// `authority` signs them; it is created if it does not exist.
///
/// # Errors
/// [`IssueError`].
pub fn issue(authority: &Path, out: &Path, order: &Order) -> Result<Made, IssueError> {
    if !is_graph_name(&order.robot) {
        return Err(IssueError::Robot { robot: order.robot.clone() });
    }
    if let Some(address) = order.hosts.values().flatten().find(|address| !is_host(address)) {
        return Err(IssueError::Address { address: address.clone() });
    }
    if place_of(authority)?.starts_with(place_of(out)?) {
        return Err(IssueError::Inside {
            authority: authority.to_path_buf(),
            out: out.to_path_buf(),
        });
    }
    check_new(out)?;
    let new_authority = !authority.exists();
    if new_authority {
        make_authority(authority, order.from_s)?;
    }
    let (issuer, certificate) = authority_in(authority, order)?;
    let mut certificates = Vec::new();
    whole(out, |half| {
        let hosts = order.hosts.keys().map(|host| Role::Host(host.clone()));
        for role in hosts.chain(CLIENTS) {
            let addresses = addresses_of(&role, order);
            let (signed, key) = sign(&issuer, &role, &addresses, order)?;
            let folder = half.join(role.to_string());
            make_folder(&folder)?;
            write(&folder.join(KEY_FILE), &key)?;
            write(&folder.join(CERTIFICATE_FILE), &signed)?;
            write(&folder.join(AUTHORITY_FILE), &certificate)?;
            certificates.push((role, addresses));
        }
        Ok(())
    })?;
    Ok(Made { new_authority, certificates })
}

/// The absolute form of `path`. Links are resolved in the part that exists.
fn place_of(path: &Path) -> Result<PathBuf, IssueError> {
    let written = std::path::absolute(path)
        .map_err(|source| IssueError::FileSystem { path: path.to_path_buf(), source })?;
    let above = written
        .ancestors()
        .find_map(|above| Some((above.canonicalize().ok()?, written.strip_prefix(above).ok()?)));
    Ok(above.map_or_else(|| written.clone(), |(real, rest)| real.join(rest)))
}

fn is_host(text: &str) -> bool {
    let allowed = |byte: u8| byte.is_ascii_alphanumeric() || b".-:".contains(&byte);
    let is_name = !text.contains(':') && !text.starts_with(['.', '-']) && text != "0.0.0.0";
    !text.is_empty()
        && text.len() <= 253
        && text.bytes().all(allowed)
        && (is_name || text.parse::<std::net::Ipv6Addr>().is_ok())
}

fn addresses_of(role: &Role, order: &Order) -> Vec<String> {
    let Role::Host(host) = role else { return Vec::new() };
    let mut addresses: Vec<String> = LOOPBACK.map(str::to_owned).to_vec();
    for address in order.hosts.get(host).into_iter().flatten() {
        if !addresses.contains(address) {
            addresses.push(address.clone());
        }
    }
    addresses
}

/// Certificate and key of `role`, as PEM.
fn sign(
    issuer: &Issuer<'_, KeyPair>,
    role: &Role,
    addresses: &[String],
    order: &Order,
) -> Result<(String, String), IssueError> {
    let mut params = CertificateParams::new(addresses.to_vec())?;
    params.distinguished_name = rcgen::DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, role.subject(&order.robot));
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    // A certificate of a client cannot be used by a server.
    params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ClientAuth];
    if role.serves() {
        params.extended_key_usages.push(ExtendedKeyUsagePurpose::ServerAuth);
    }
    params.use_authority_key_identifier_extension = true;
    (params.not_before, params.not_after) = (at(order.from_s), at(order.until_s));
    let key = KeyPair::generate()?;
    Ok((params.signed_by(&key, issuer)?.pem(), key.serialize_pem()))
}

fn at(unix_s: i64) -> time::OffsetDateTime {
    date_time_ymd(1970, 1, 1) + Duration::from_secs(u64::try_from(unix_s).unwrap_or(0))
}

/// Fails unless `out` is new or empty.
fn check_new(out: &Path) -> Result<(), IssueError> {
    let is_new = match fs::read_dir(out) {
        Ok(mut entries) => entries.next().is_none(),
        Err(error) => error.kind() == io::ErrorKind::NotFound,
    };
    if is_new { Ok(()) } else { Err(IssueError::NotEmpty { out: out.to_path_buf() }) }
}

/// Creates `folder` atomically: `fill` writes into a temporary directory, which is then renamed.
fn whole(
    folder: &Path,
    fill: impl FnOnce(&Path) -> Result<(), IssueError>,
) -> Result<(), IssueError> {
    let failed = |path: &Path| {
        let path = path.to_path_buf();
        move |source| IssueError::FileSystem { path, source }
    };
    if let Some(parent) = folder.parent() {
        DirBuilder::new().recursive(true).mode(0o700).create(parent).map_err(failed(parent))?;
    }
    let mut half = folder.as_os_str().to_owned();
    half.push(format!(".half-{}", std::process::id()));
    let half = PathBuf::from(half);
    make_folder(&half)?;
    let made = fill(&half).and_then(|()| fs::rename(&half, folder).map_err(failed(folder)));
    if made.is_err() {
        // The name of a remaining directory shows its purpose.
        let _ = fs::remove_dir_all(&half);
    }
    made
}

fn make_folder(path: &Path) -> Result<(), IssueError> {
    DirBuilder::new()
        .mode(0o700)
        .create(path)
        .map_err(|source| IssueError::FileSystem { path: path.to_path_buf(), source })
}

fn write(path: &Path, text: &str) -> Result<(), IssueError> {
    let failed = |source| IssueError::FileSystem { path: path.to_path_buf(), source };
    let mut file =
        OpenOptions::new().write(true).create_new(true).mode(0o600).open(path).map_err(failed)?;
    file.write_all(text.as_bytes()).and_then(|()| file.sync_all()).map_err(failed)
}

#[cfg(test)]
mod tests;
