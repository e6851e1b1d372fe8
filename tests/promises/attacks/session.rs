//! zenoh sessions as a program without our code opens them.

use access::{AUTHORITY_FILE, CERTIFICATE_FILE, Credentials, KEY_FILE, Role};
use certificates::issue::{Order, issue};
use network::threads;
use serde_json::{Value, json};
use std::error::Error;
use std::fmt::Display;
use std::io::{self, Write};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};
use tempfile::TempDir;
use zenoh::{Config, Session, Wait};

/// Why an attempt was not possible.
pub(crate) type Failure = Box<dyn Error>;

/// The robot of all certificates, unless another is given.
pub(crate) const ROBOT: &str = "mecanum";

/// Hosts with certificates.
pub(crate) const HOSTS: [&str; 3] = ["robot", "control", "training"];

/// An hour [s].
pub(crate) const HOUR_S: i64 = 3_600;

/// Certificates made for one test.
pub(crate) struct Certificates {
    home: TempDir,
}

/// Authentication of a connecting peer.
#[derive(Debug, Clone)]
pub(crate) enum Shows {
    /// No TLS.
    Nothing,
    /// TLS, without a certificate of its own; it trusts the authority in this folder.
    NoCertificate(Credentials),
    /// TLS, with this certificate.
    Certificate(Credentials),
}

impl Certificates {
    /// Certificates of [`ROBOT`], valid for an hour.
    pub(crate) fn new() -> Result<Self, Box<dyn Error>> {
        let certificates = Self { home: tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")? };
        certificates.issue("authority", "certificates", ROBOT, (-HOUR_S, HOUR_S))?;
        Ok(certificates)
    }

    /// Issues more certificates. Their validity begins and ends at these times from now [s].
    pub(crate) fn issue(
        &self,
        authority: &str,
        out: &str,
        robot: &str,
        (from_s, until_s): (i64, i64),
    ) -> Result<PathBuf, Box<dyn Error>> {
        let now_s = i64::try_from(SystemTime::now().duration_since(UNIX_EPOCH)?.as_secs())?;
        let order = Order {
            robot: robot.to_owned(),
            hosts: HOSTS.map(|host| (host.to_owned(), Vec::new())).into(),
            from_s: now_s + from_s,
            until_s: now_s + until_s,
        };
        let folder = self.home.path().join(out);
        issue(&self.home.path().join(authority), &folder, &order)?;
        Ok(folder)
    }

    /// The folder with one folder per role.
    pub(crate) fn folder(&self) -> PathBuf {
        self.home.path().join("certificates")
    }

    /// The certificate of `role`.
    pub(crate) fn of(&self, role: &Role) -> Credentials {
        of(&self.folder(), role)
    }
}

/// The certificate of `role` in `folder`.
pub(crate) fn of(folder: &Path, role: &Role) -> Credentials {
    Credentials::in_folder(folder.join(role.to_string()))
}

/// A client of the router that listens at `endpoint`. Fails within seconds if there is no answer or
/// the client is refused.
pub(crate) fn connect(endpoint: &str, shows: &Shows) -> Result<Session, Box<dyn Error>> {
    assert!(
        threads::are_set(),
        "{}={} is missing in the environment",
        threads::VARIABLE,
        threads::THREADS
    );
    let (_, address) = endpoint.split_once('/').ok_or("no endpoint")?;
    let protocol = if matches!(shows, Shows::Nothing) { "tcp" } else { "tls" };
    let mut settings = vec![
        ("mode", json!("client")),
        ("connect/endpoints", json!([format!("{protocol}/{address}")])),
        ("connect/timeout_ms", json!(0)),
        ("connect/exit_on_failure", json!(true)),
        ("listen/endpoints", json!([])),
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/enabled", json!(false)),
    ];
    if let Shows::NoCertificate(credentials) | Shows::Certificate(credentials) = shows {
        settings.extend(tls(credentials, matches!(shows, Shows::Certificate(_))));
    }
    let mut config = Config::default();
    for (key, value) in settings {
        config.insert_json5(key, &value.to_string()).map_err(|error| error.to_string())?;
    }
    zenoh::open(config).wait().map_err(|error| error.to_string().into())
}

/// A router of a test, and its endpoint.
pub(crate) fn router(
    shows: &Shows,
    more: &[(&str, Value)],
) -> Result<(Session, String), Box<dyn Error>> {
    assert!(
        threads::are_set(),
        "{}={} is missing in the environment",
        threads::VARIABLE,
        threads::THREADS
    );
    let protocol = if matches!(shows, Shows::Nothing) { "tcp" } else { "tls" };
    // Another process may take the port between its choice and its use.
    for _ in 0..20 {
        let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
        let endpoint = format!("{protocol}/127.0.0.1:{port}");
        let mut settings = vec![
            ("mode", json!("router")),
            ("listen/endpoints", json!([endpoint])),
            ("scouting/multicast/enabled", json!(false)),
            // Room for messages that are too long: the forwarding thread would also have to make
            // the room.
            ("transport/link/tx/queue/size/data", json!(16)),
        ];
        if let Shows::NoCertificate(credentials) | Shows::Certificate(credentials) = shows {
            settings.extend(tls(credentials, matches!(shows, Shows::Certificate(_))));
            settings
                .push(("transport/link/tls/listen_private_key", json!(credentials.file(KEY_FILE))));
            settings.push((
                "transport/link/tls/listen_certificate",
                json!(credentials.file(CERTIFICATE_FILE)),
            ));
        }
        let mut config = Config::default();
        for (key, value) in settings.iter().chain(more) {
            config.insert_json5(key, &value.to_string()).map_err(|error| error.to_string())?;
        }
        if let Ok(session) = zenoh::open(config).wait() {
            return Ok((session, endpoint));
        }
    }
    Err("no port is free".into())
}

/// The certificate of the host `name`.
pub(crate) fn host(name: &str) -> Role {
    Role::Host(name.to_owned())
}

/// All peers that must be refused, by name. Their certificates are for the host `name`.
pub(crate) fn strangers(
    certificates: &Certificates,
    name: &str,
) -> Result<Vec<(&'static str, Shows)>, Failure> {
    let role = host(name);
    let foreign = certificates.issue("another-authority", "foreign", ROBOT, (-HOUR_S, HOUR_S))?;
    let expired = certificates.issue("authority", "expired", ROBOT, (-HOUR_S, -60))?;
    let future = certificates.issue("authority", "future", ROBOT, (HOUR_S, 2 * HOUR_S))?;
    let other = certificates.issue("authority", "other", "roomba", (-HOUR_S, HOUR_S))?;
    // A stranger with a foreign certificate trusts our authority; otherwise it would not even show
    // its certificate.
    let ours = certificates.of(&role);
    std::fs::copy(ours.file(AUTHORITY_FILE), of(&foreign, &role).file(AUTHORITY_FILE))?;
    Ok(vec![
        ("TCP", Shows::Nothing),
        ("TLS without a certificate", Shows::NoCertificate(ours)),
        ("certificate of a foreign authority", Shows::Certificate(of(&foreign, &role))),
        ("expired certificate", Shows::Certificate(of(&expired, &role))),
        ("certificate of the future", Shows::Certificate(of(&future, &role))),
        ("certificate of another robot", Shows::Certificate(of(&other, &role))),
    ])
}

fn tls(credentials: &Credentials, with_certificate: bool) -> Vec<(&'static str, Value)> {
    let file = |name| json!(credentials.file(name));
    let mut settings = vec![
        ("transport/link/tls/root_ca_certificate", file(AUTHORITY_FILE)),
        ("transport/link/tls/verify_name_on_connect", json!(true)),
        ("transport/link/tls/close_link_on_expiration", json!(true)),
        ("transport/link/tls/enable_mtls", json!(with_certificate)),
    ];
    if with_certificate {
        settings.push(("transport/link/tls/connect_private_key", file(KEY_FILE)));
        settings.push(("transport/link/tls/connect_certificate", file(CERTIFICATE_FILE)));
    }
    settings
}

/// zenoh's own error type; zenoh offers no other.
#[expect(clippy::needless_pass_by_value, reason = "for `map_err`")]
pub(crate) fn failed(error: zenoh::Error) -> Failure {
    error.to_string().into()
}

/// Prints the counts.
pub(crate) fn print(counted: impl Display) {
    // The standard error may be closed.
    let _ = writeln!(io::stderr().lock(), "{counted}");
}
