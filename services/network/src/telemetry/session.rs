//! zenoh sessions for telemetry: explicit endpoints, no discovery, bounded times.

use super::{TelemetryError, TelemetrySettings};
use crate::reason::first_line;
use crate::threads::Client;
use crate::{guarded, over_tls, quiet};
use access::{Credentials, of_open_telemetry, of_telemetry};
use serde_json::json;
use std::net::TcpListener;
use zenoh::config::EndPoint;
use zenoh::{Config, Session, Wait};

/// How long a value may wait for room on its way to one slow watcher before that watcher misses it
/// \[µs\].
const WAIT_BEFORE_DROP_MICROS: u64 = 100;

/// Longest message that a watcher accepts: more than a snapshot has, as bytes or as JSON \[bytes\].
const RECEIVED_MAX_BYTES: u64 = 16 * 1024 * 1024;

/// Longest message that a publishing session accepts; it receives only declarations of interest
/// \[bytes\].
const ASKED_MAX_BYTES: u64 = 64 * 1024;

/// Most watchers at one time.
const WATCHERS_MAX: usize = 64;

/// Number of ports tried when any port will do: another process may take one between the choice and
/// its use.
const PORT_ATTEMPTS: u32 = 8;

/// Fails unless `endpoint` is well-formed.
pub(super) fn check_endpoint(endpoint: &str) -> Result<(), TelemetryError> {
    let bad = |reason: String| TelemetryError::Endpoint { endpoint: endpoint.to_owned(), reason };
    let parsed: EndPoint =
        endpoint.parse().map_err(|error: zenoh::Error| bad(first_line(&error)))?;
    if !["tcp", "tls"].contains(&parsed.protocol().as_str()) {
        return Err(bad("only tcp and tls are supported".to_owned()));
    }
    let address = parsed.address().to_string();
    // After the address, an endpoint could switch off the verification of certificates.
    if endpoint.contains(['?', '#']) {
        return Err(bad("nothing may follow host and port".to_owned()));
    }
    let port = address
        .rsplit_once(':')
        .filter(|(host, _)| !host.is_empty())
        .map(|(_, port)| port.parse::<u16>());
    if matches!(port, Some(Ok(_))) {
        Ok(())
    } else {
        Err(bad("a host and a port are missing".to_owned()))
    }
}

/// A session that accepts connections, and the endpoints where it listens, each with its actual
/// port.
pub(super) fn listen(
    settings: &TelemetrySettings,
) -> Result<(Session, Vec<String>), TelemetryError> {
    let credentials = settings.credentials.as_ref();
    let endpoints: Vec<String> =
        settings.listen.iter().map(|endpoint| spoken(endpoint, credentials)).collect();
    let mut attempt = 1;
    loop {
        let chosen =
            endpoints.iter().map(|endpoint| with_port(endpoint)).collect::<Result<Vec<_>, _>>()?;
        let by_choice = chosen != endpoints;
        match open_listening(&chosen, credentials) {
            Err(_) if by_choice && attempt < PORT_ATTEMPTS => attempt += 1,
            opened => return opened.map(|session| (session, chosen)),
        }
    }
}

/// The robot that a certificate names.
fn robot_of(credentials: &Credentials) -> Result<String, TelemetryError> {
    credentials
        .read()
        .map(|certificate| certificate.robot)
        .map_err(|error| TelemetryError::Credentials { reason: error.to_string() })
}

/// `endpoint`, over TLS if there is a certificate.
fn spoken(endpoint: &str, credentials: Option<&Credentials>) -> String {
    if credentials.is_some() { over_tls(endpoint) } else { endpoint.to_owned() }
}

fn open_listening(
    endpoints: &[String],
    credentials: Option<&Credentials>,
) -> Result<Session, TelemetryError> {
    let failed = |error| TelemetryError::Listen {
        endpoints: endpoints.join(", "),
        reason: first_line(&error),
    };
    let mut config = config("router", ASKED_MAX_BYTES)?;
    set(&mut config, "listen/endpoints", &json!(endpoints))?;
    set(&mut config, "transport/unicast/max_sessions", &json!(WATCHERS_MAX))?;
    set(&mut config, "transport/unicast/accept_pending", &json!(WATCHERS_MAX))?;
    if let Some(credentials) = credentials {
        let control = of_telemetry(&robot_of(credentials)?);
        return zenoh::open(
            guarded(config, credentials, &[("access_control", control)]).map_err(failed)?,
        )
        .wait()
        .map_err(failed);
    }
    set(&mut config, "access_control", &of_open_telemetry())?;
    zenoh::open(config).wait().map_err(failed)
}

/// A session with the gateway at `endpoint`. Fails within seconds if no gateway answers.
pub(super) fn connect(
    endpoint: &str,
    credentials: Option<&Credentials>,
) -> Result<Client, TelemetryError> {
    check_endpoint(endpoint)?;
    let endpoint = &spoken(endpoint, credentials);
    let failed = |error| TelemetryError::Connect {
        endpoint: endpoint.to_owned(),
        reason: first_line(&error),
    };
    let mut config = config("client", RECEIVED_MAX_BYTES)?;
    set(&mut config, "connect/endpoints", &json!([endpoint]))?;
    set(&mut config, "connect/timeout_ms", &json!(0))?;
    if let Some(credentials) = credentials {
        // That the other end is a host of this authority is in its certificate: no other role has
        // one to which others may connect.
        config = guarded(config, credentials, &[]).map_err(failed)?;
    }
    Client::open(config).map_err(failed)
}

/// Messages have at most `bytes_max` bytes.
fn config(mode: &str, bytes_max: u64) -> Result<Config, TelemetryError> {
    let mut config = quiet(mode, bytes_max)
        .map_err(|error| TelemetryError::Session { reason: first_line(&error) })?;
    let wait = "transport/link/tx/queue/congestion_control/drop/wait_before_drop";
    set(&mut config, wait, &json!(WAIT_BEFORE_DROP_MICROS))?;
    Ok(config)
}

fn set(config: &mut Config, key: &str, value: &serde_json::Value) -> Result<(), TelemetryError> {
    let failed = |error| TelemetryError::Session { reason: format!("{key}: {error}") };
    config.insert_json5(key, &value.to_string()).map_err(failed)
}

/// The same endpoint, with a free port in place of port 0.
fn with_port(endpoint: &str) -> Result<String, TelemetryError> {
    check_endpoint(endpoint)?;
    let Some((protocol, address)) =
        endpoint.strip_suffix(":0").and_then(|endpoint| endpoint.split_once('/'))
    else {
        return Ok(endpoint.to_owned());
    };
    let failed = |error: std::io::Error| TelemetryError::Listen {
        endpoints: endpoint.to_owned(),
        reason: error.to_string(),
    };
    let listener = TcpListener::bind(format!("{address}:0")).map_err(failed)?;
    let port = listener.local_addr().map_err(failed)?.port();
    Ok(format!("{protocol}/{address}:{port}"))
}
