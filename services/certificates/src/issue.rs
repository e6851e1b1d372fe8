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

use access::{AUTHORITY_FILE, CERTIFICATE_FILE, CLIENTS, KEY_FILE, Role, changeable, valid_until};
use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose, date_time_ymd,
};
use std::collections::BTreeMap;
use std::fs::{self, DirBuilder, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::Duration;
use transport::is_graph_name;

/// Validity of an authority \[s\]: ten years.
const AUTHORITY_VALID_S: i64 = 3650 * 86_400;

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

/// Parameters of every authority.
fn authority_params() -> CertificateParams {
    let mut params = CertificateParams::default();
    params.distinguished_name = rcgen::DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, "Coxswain authority");
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::DigitalSignature];
    params
}

fn make_authority(folder: &Path, from_s: i64) -> Result<(), IssueError> {
    let mut params = authority_params();
    (params.not_before, params.not_after) = (at(from_s), at(from_s + AUTHORITY_VALID_S));
    let key = KeyPair::generate()?;
    let certificate = params.self_signed(&key)?.pem();
    whole(folder, |half| {
        write(&half.join(KEY_FILE), &key.serialize_pem())?;
        write(&half.join(AUTHORITY_FILE), &certificate)
    })
}

/// The issuer, and its certificate as PEM.
fn authority_in(
    folder: &Path,
    order: &Order,
) -> Result<(Issuer<'static, KeyPair>, String), IssueError> {
    let failed = |reason: String| IssueError::Authority { authority: folder.to_path_buf(), reason };
    let (key_file, certificate_file) = (folder.join(KEY_FILE), folder.join(AUTHORITY_FILE));
    let read = |path: &Path| {
        fs::read_to_string(path).map_err(|source| failed(format!("{}: {source}", path.display())))
    };
    let (key, certificate) = (read(&key_file)?, read(&certificate_file)?);
    if fs::metadata(&key_file).is_ok_and(|found| found.mode() & GROUP_AND_OTHERS != 0) {
        return Err(failed(format!(
            "{}: other users can read it; expected mode 0600",
            key_file.display()
        )));
    }
    // A file that other users may have written is not trusted.
    for path in [folder, &key_file, &certificate_file] {
        if let Some(found) =
            changeable(path).map_err(|error| failed(format!("{}: {error}", path.display())))?
        {
            return Err(failed(format!(
                "{found}: expected to be owned by this user or root, and not writable by others"
            )));
        }
    }
    let until_s = valid_until(certificate.as_bytes()).map_err(failed)?;
    if until_s < order.until_s {
        return Err(failed(
            "it expires before the certificates that it signs; make another one".to_owned(),
        ));
    }
    let key = KeyPair::from_pem(&key)
        .map_err(|error| failed(format!("its key cannot be used: {error}")))?;
    Ok((Issuer::new(authority_params(), key), certificate))
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
mod tests {
    use super::*;
    use access::{AccessError, Changeable, Credentials};
    use std::error::Error;

    fn order() -> Order {
        Order {
            robot: "mecanum".into(),
            hosts: [
                ("robot".to_owned(), vec!["10.0.0.1".into(), "robot.example".into()]),
                ("control".to_owned(), Vec::new()),
            ]
            .into(),
            from_s: 1_000,
            until_s: 2_000,
        }
    }

    #[test]
    fn every_role_gets_a_certificate_with_role_addresses_and_expiry() -> Result<(), Box<dyn Error>>
    {
        let folder = tempfile::tempdir()?;
        let (authority, out) = (folder.path().join("a"), folder.path().join("deep/out"));
        assert!(issue(&authority, &out, &order())?.new_authority);
        let host = |name: &str| Role::Host(name.to_owned());
        for role in CLIENTS.into_iter().chain([host("robot"), host("control")]) {
            let credentials = Credentials::in_folder(out.join(role.to_string()));
            let certificate = credentials.check(&role, 1_500)?;
            assert_eq!(
                (
                    certificate.role.clone(),
                    certificate.robot.as_str(),
                    certificate.from_s,
                    certificate.until_s
                ),
                (role.clone(), "mecanum", 1_000, 2_000)
            );
            let is_robot = role == host("robot");
            assert!(
                ["10.0.0.1", "robot.example"]
                    .into_iter()
                    .all(|address| certificate.covers(address) == is_robot)
            );
            assert!(
                ["127.0.0.1", "localhost"]
                    .into_iter()
                    .all(|address| certificate.covers(address) == role.serves())
            );
            let late = credentials.check(&role, 2_000);
            assert!(matches!(late, Err(AccessError::Expired { since_s: 0, .. })), "{late:?}");
            let early = credentials.check(&role, 999);
            assert!(matches!(early, Err(AccessError::TooEarly { in_s: 1, .. })), "{early:?}");
        }
        let wrong = Credentials::in_folder(out.join("watcher")).check(&Role::Driver, 1_500);
        let is_named = matches!(
            &wrong,
            Err(AccessError::Role { found: Role::Watcher, expected: Role::Driver, .. })
        );
        assert!(is_named, "{wrong:?}");
        Ok(())
    }

    #[test]
    fn keys_are_private_to_their_owner_and_rejected_if_not() -> Result<(), Box<dyn Error>> {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir()?;
        let (authority, out) = (folder.path().join("a"), folder.path().join("out"));
        issue(&authority, &out, &order())?;
        for path in [
            authority.clone(),
            out.clone(),
            out.join("robot-host"),
            authority.join(KEY_FILE),
            out.join("robot-host").join(KEY_FILE),
        ] {
            assert_eq!(fs::metadata(&path)?.mode() & GROUP_AND_OTHERS, 0, "{}", path.display());
        }
        assert!(
            !out.join("authority").exists() && !out.join(KEY_FILE).exists(),
            "the authority's key does not travel"
        );
        fs::set_permissions(
            out.join("robot-host").join(KEY_FILE),
            fs::Permissions::from_mode(0o640),
        )?;
        let read = Credentials::in_folder(out.join("robot-host")).read();
        assert!(matches!(read, Err(AccessError::NotPrivate { mode: 0o640, .. })), "{read:?}");
        fs::set_permissions(authority.join(KEY_FILE), fs::Permissions::from_mode(0o644))?;
        let refused = issue(&authority, &folder.path().join("more"), &order());
        let is_about_key = |error: IssueError| matches!(error, IssueError::Authority { reason, .. } if reason.contains(KEY_FILE));
        assert!(refused.is_err_and(is_about_key));
        Ok(())
    }

    #[test]
    fn a_file_that_others_can_write_is_rejected_with_its_mode() -> Result<(), Box<dyn Error>> {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir()?;
        let (authority, out) = (folder.path().join("a"), folder.path().join("out"));
        issue(&authority, &out, &order())?;
        let robot = Credentials::in_folder(out.join("robot-host"));
        let set = |path: &Path, mode| fs::set_permissions(path, fs::Permissions::from_mode(mode));
        for (path, open, closed) in [
            (out.clone(), 0o777, 0o755),
            (out.clone(), 0o775, 0o700),
            (out.join("robot-host"), 0o770, 0o700),
            (robot.file(AUTHORITY_FILE), 0o666, 0o644),
            (robot.file(AUTHORITY_FILE), 0o660, 0o600),
            (robot.file(CERTIFICATE_FILE), 0o606, 0o600),
        ] {
            set(&path, open)?;
            let refused = robot.read();
            let expected = Changeable::Open { path: path.clone(), mode: open };
            assert!(
                matches!(&refused, Err(AccessError::Changeable(found)) if *found == expected),
                "{refused:?}"
            );
            set(&path, closed)?;
            robot.read()?;
        }
        set(folder.path(), 0o777)?;
        let refused = robot.read();
        let is_replaceable = matches!(
            &refused,
            Err(AccessError::Replaceable { above: Changeable::Open { mode: 0o777, .. }, .. })
        );
        assert!(is_replaceable, "{refused:?}");
        set(&authority, 0o777)?;
        let refused = issue(&authority, &folder.path().join("more"), &order());
        let has_mode = |error: &IssueError| matches!(error, IssueError::Authority { reason, .. } if reason.contains("777"));
        assert!(refused.as_ref().is_err_and(has_mode), "{refused:?}");
        Ok(())
    }

    #[test]
    fn an_authority_inside_the_certificates_is_rejected_for_every_form_of_its_path()
    -> Result<(), Box<dyn Error>> {
        let folder = tempfile::tempdir()?;
        let out = folder.path().canonicalize()?.join("out");
        let up: PathBuf = std::env::current_dir()?.components().skip(1).map(|_| "..").collect();
        let relative = up.join(out.strip_prefix("/")?);
        let link = folder.path().join("link");
        std::os::unix::fs::symlink(folder.path(), &link)?;
        for (authority, out) in [
            (out.join("a"), relative.clone()),
            (relative.join("a"), out.clone()),
            (link.join("out/a"), out.clone()),
        ] {
            let refused = issue(&authority, &out, &order());
            assert!(
                matches!(refused, Err(IssueError::Inside { .. })),
                "{} in {}",
                authority.display(),
                out.display()
            );
        }
        assert!(!out.exists());
        issue(&up.join(link.strip_prefix("/")?).join("a"), &relative, &order())?;
        Ok(())
    }

    #[test]
    fn an_authority_signs_again_and_nothing_is_overwritten() -> Result<(), Box<dyn Error>> {
        let folder = tempfile::tempdir()?;
        let (authority, out) = (folder.path().join("a"), folder.path().join("out"));
        issue(&authority, &out, &order())?;
        assert!(matches!(issue(&authority, &out, &order()), Err(IssueError::NotEmpty { .. })));
        let next = folder.path().join("next");
        let later = Order { from_s: 1_800, until_s: 9_000, ..order() };
        assert!(!issue(&authority, &next, &later)?.new_authority);
        let authorities =
            [&out, &next].map(|out| fs::read(out.join("control-host").join(AUTHORITY_FILE)));
        assert_eq!(authorities[0].as_ref().ok(), authorities[1].as_ref().ok());
        let late = Order { until_s: 1_000 + AUTHORITY_VALID_S + 1, ..order() };
        assert!(matches!(
            issue(&authority, &folder.path().join("late"), &late),
            Err(IssueError::Authority { .. })
        ));
        Ok(())
    }

    #[test]
    fn invalid_options_are_rejected_and_leave_no_files() -> Result<(), Box<dyn Error>> {
        let folder = tempfile::tempdir()?;
        let (authority, out) = (folder.path().join("a"), folder.path().join("out"));
        for robot in ["", "A", "a b", "a.b", "*"] {
            assert!(matches!(
                issue(&authority, &out, &Order { robot: robot.into(), ..order() }),
                Err(IssueError::Robot { .. })
            ));
        }
        for address in ["", "10.0.0.1:7447", "tcp/10.0.0.1", "a b", "0.0.0.0", "*", "-x"] {
            let refused = issue(
                &authority,
                &out,
                &Order { hosts: [("robot".to_owned(), vec![address.into()])].into(), ..order() },
            );
            assert!(matches!(refused, Err(IssueError::Address { .. })), "{address}");
        }
        assert!(matches!(
            issue(&out.join("authority"), &out, &order()),
            Err(IssueError::Inside { .. })
        ));
        assert_eq!(fs::read_dir(folder.path())?.count(), 0);
        Ok(())
    }
}
