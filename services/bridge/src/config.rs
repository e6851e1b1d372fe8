//! The configuration of the zenoh session with one other host: zenoh's defaults, never a file of
//! the user's, and no peer that was not named.

use crate::settings::{Meeting, Remote, Settings};
use access::{AccessError, of_bridge};
use network::{guarded, over_tls};
use serde_json::{Value, json};
use zenoh::Config;

/// Silence after which a link counts as dead \[ms\]. Each end sends something four times as often.
/// An end that is gone is noticed at once.
const LEASE_MILLIS: u64 = 2_000;
/// How long one attempt to connect may take \[ms\]. Short, so that an attempt that began during a
/// cut does not outlast it by much.
const ATTEMPT_MILLIS: u64 = 1_000;
/// Longest pause between two attempts to connect \[ms\].
const RETRY_MILLIS_MAX: u64 = 300;
/// Batches of 64 KiB that may wait on a link, of each priority: all that zenoh allows.
const BATCHES: usize = 16;
/// How long a sender waits for a free batch before its message is dropped \[µs\].
const WAIT_MICROS: u64 = 20_000;
/// Longest message, with all that zenoh adds \[bytes\]. A piece is shorter.
const BYTES_MAX: usize = 64 * 1024;
/// Connections that may be half open.
const PENDING_MAX: usize = 16;

/// Why there is no configuration.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The certificate cannot be used.
    #[error(transparent)]
    Access(#[from] AccessError),
    /// zenoh rejects a setting.
    #[error("zenoh: {0}")]
    Zenoh(String),
}

impl From<zenoh::Error> for ConfigError {
    fn from(error: zenoh::Error) -> Self {
        Self::Zenoh(network::first_line(&error))
    }
}

/// The endpoint where this host meets `remote`, over TLS if there are certificates.
pub(crate) fn endpoint(settings: &Settings, remote: &Remote) -> String {
    let endpoint = remote.meeting.endpoint();
    if settings.credentials.is_some() { over_tls(endpoint) } else { endpoint.to_owned() }
}

/// Subject of the certificate that the other end of the link must present; none if it may be any.
///
/// # Errors
/// If the own certificate cannot be read.
pub(crate) fn subject(settings: &Settings, remote: &Remote) -> Result<Option<String>, AccessError> {
    let is_direct = !matches!(remote.meeting, Meeting::Router(_));
    let credentials = settings.credentials.as_ref().filter(|_| is_direct);
    credentials.map(|credentials| Ok(remote.role().subject(&credentials.read()?.robot))).transpose()
}

/// A session that listens or connects, again and again, and has one other end at most: a second one
/// is refused while the first lives.
pub(crate) fn config(settings: &Settings, remote: &Remote) -> Result<Config, ConfigError> {
    let endpoint = endpoint(settings, remote);
    let (listen, connect) = match remote.meeting {
        Meeting::Listen(_) => (vec![endpoint], Vec::new()),
        Meeting::Connect(_) | Meeting::Router(_) => (Vec::new(), vec![endpoint]),
    };
    // A zenoh router passes nothing on between two peers.
    let mode = if matches!(remote.meeting, Meeting::Router(_)) { "client" } else { "peer" };
    let settings_of_zenoh = [
        ("mode", json!(mode)),
        ("listen/endpoints", json!(listen)),
        ("listen/timeout_ms", json!(0)),
        ("listen/exit_on_failure", json!(true)),
        ("connect/endpoints", json!(connect)),
        ("connect/timeout_ms", json!(-1)),
        ("connect/exit_on_failure", json!(false)),
        (
            "connect/retry",
            json!({
                "period_init_ms": 50,
                "period_max_ms": RETRY_MILLIS_MAX,
                "period_increase_factor": 2.0,
            }),
        ),
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/enabled", json!(false)),
        // Else opening takes this long, for peers that might be found.
        ("scouting/delay", json!(0)),
        ("timestamping/enabled", json!(false)),
        ("adminspace/enabled", json!(false)),
        ("transport/unicast/open_timeout", json!(ATTEMPT_MILLIS)),
        ("transport/unicast/accept_timeout", json!(ATTEMPT_MILLIS)),
        ("transport/unicast/max_sessions", json!(1)),
        ("transport/unicast/accept_pending", json!(PENDING_MAX)),
        ("transport/link/tx/lease", json!(LEASE_MILLIS)),
        ("transport/link/rx/max_message_size", json!(BYTES_MAX)),
        ("transport/link/tx/queue/congestion_control/drop/wait_before_drop", json!(WAIT_MICROS)),
    ];
    let priorities = [
        "control",
        "real_time",
        "interactive_high",
        "interactive_low",
        "data_high",
        "data",
        "data_low",
        "background",
    ];
    let mut config = Config::default();
    for priority in priorities {
        let key = format!("transport/link/tx/queue/size/{priority}");
        insert(&mut config, &key, &json!(BATCHES))?;
    }
    for (key, value) in &settings_of_zenoh {
        insert(&mut config, key, value)?;
    }
    let Some(credentials) = &settings.credentials else { return Ok(config) };
    let control = subject(settings, remote)?
        .map(|subject| ("access_control", of_bridge(&settings.graph, &subject)));
    Ok(guarded(config, credentials, control.as_slice())?)
}

fn insert(config: &mut Config, key: &str, value: &Value) -> Result<(), ConfigError> {
    Ok(config.insert_json5(key, &value.to_string())?)
}
