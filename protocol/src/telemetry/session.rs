//! zenoh sessions for telemetry: explicit endpoints, no discovery, bounded times.

use super::TelemetryError;
use crate::reason::first_line;
use serde_json::json;
use std::net::TcpListener;
use zenoh::config::EndPoint;
use zenoh::{Config, Session, Wait};

/// How long the other end may take to say who it is \[ms\].
const OPEN_TIMEOUT_MILLIS: u64 = 3000;

/// A session whose other end has been silent for so long is over \[ms\].
const LEASE_MILLIS: u64 = 2000;

/// How long a value may wait for room on its way to one slow watcher before that watcher misses it \[µs\].
const WAIT_BEFORE_DROP_MICROS: u64 = 100;

/// Longest message that is taken in: a publishing session expects no more than declarations, a watcher no more than a snapshot \[bytes\].
const MESSAGE_MAX_BYTES: u64 = 16 * 1024 * 1024;

/// Ports that are tried where any will do: another process may take one between the choice and its use.
const PORT_ATTEMPTS: u32 = 8;

/// Fails unless `endpoint` is well-formed.
pub(super) fn check_endpoint(endpoint: &str) -> Result<(), TelemetryError> {
    let bad = |reason: String| TelemetryError::Endpoint { endpoint: endpoint.to_owned(), reason };
    let parsed: EndPoint = endpoint.parse().map_err(|error: zenoh::Error| bad(first_line(&error)))?;
    if parsed.protocol().as_str() != "tcp" {
        return Err(bad("only tcp is spoken".to_owned()));
    }
    let address = parsed.address().to_string();
    let port = address.rsplit_once(':').filter(|(host, _)| !host.is_empty()).map(|(_, port)| port.parse::<u16>());
    if matches!(port, Some(Ok(_))) { Ok(()) } else { Err(bad("a host and a port are missing".to_owned())) }
}

/// A session that others connect to, and the endpoints that it listens on, each with its true port.
pub(super) fn listen(endpoints: &[String]) -> Result<(Session, Vec<String>), TelemetryError> {
    let mut attempt = 1;
    loop {
        let chosen = endpoints.iter().map(|endpoint| with_port(endpoint)).collect::<Result<Vec<_>, _>>()?;
        let by_choice = chosen != endpoints;
        match open_listening(&chosen) {
            Err(_) if by_choice && attempt < PORT_ATTEMPTS => attempt += 1,
            opened => return opened.map(|session| (session, chosen)),
        }
    }
}

fn open_listening(endpoints: &[String]) -> Result<Session, TelemetryError> {
    let mut config = config("router")?;
    set(&mut config, "listen/endpoints", &json!(endpoints))?;
    // What arrives here is declarations of interest. Everything that says something is dropped, so that no watcher hears it either.
    set(
        &mut config,
        "access_control",
        &json!({
            "enabled": true,
            "default_permission": "allow",
            "rules": [{
                "id": "look, do not touch",
                "messages": ["put", "delete", "query", "reply", "declare_queryable", "liveliness_token"],
                "flows": ["ingress"],
                "permission": "deny",
                "key_exprs": ["**"],
            }],
            "subjects": [{ "id": "anyone" }],
            "policies": [{ "rules": ["look, do not touch"], "subjects": ["anyone"] }],
        }),
    )?;
    let failed = |error| TelemetryError::Listen { endpoints: endpoints.join(", "), reason: first_line(&error) };
    zenoh::open(config).wait().map_err(failed)
}

/// A session with the gateway at `endpoint`. Fails within seconds if nobody answers.
pub(super) fn connect(endpoint: &str) -> Result<Session, TelemetryError> {
    check_endpoint(endpoint)?;
    let mut config = config("client")?;
    set(&mut config, "connect/endpoints", &json!([endpoint]))?;
    set(&mut config, "connect/timeout_ms", &json!(0))?;
    let failed = |error| TelemetryError::Connect { endpoint: endpoint.to_owned(), reason: first_line(&error) };
    zenoh::open(config).wait().map_err(failed)
}

fn config(mode: &str) -> Result<Config, TelemetryError> {
    let mut config = Config::default();
    for (key, value) in [
        ("mode", json!(mode)),
        ("connect/endpoints", json!([])),
        ("listen/endpoints", json!([])),
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/enabled", json!(false)),
        ("transport/unicast/open_timeout", json!(OPEN_TIMEOUT_MILLIS)),
        ("transport/unicast/accept_timeout", json!(OPEN_TIMEOUT_MILLIS)),
        ("transport/link/tx/lease", json!(LEASE_MILLIS)),
        ("transport/link/tx/queue/congestion_control/drop/wait_before_drop", json!(WAIT_BEFORE_DROP_MICROS)),
        ("transport/link/rx/max_message_size", json!(MESSAGE_MAX_BYTES)),
    ] {
        set(&mut config, key, &value)?;
    }
    Ok(config)
}

fn set(config: &mut Config, key: &str, value: &serde_json::Value) -> Result<(), TelemetryError> {
    let failed = |error| TelemetryError::Session { reason: format!("{key}: {error}") };
    config.insert_json5(key, &value.to_string()).map_err(failed)
}

/// The same endpoint, with a free port in place of port 0.
fn with_port(endpoint: &str) -> Result<String, TelemetryError> {
    check_endpoint(endpoint)?;
    let Some(address) = endpoint.strip_suffix(":0").and_then(|endpoint| endpoint.strip_prefix("tcp/")) else {
        return Ok(endpoint.to_owned());
    };
    let failed = |error: std::io::Error| TelemetryError::Listen { endpoints: endpoint.to_owned(), reason: error.to_string() };
    let listener = TcpListener::bind(format!("{address}:0")).map_err(failed)?;
    let port = listener.local_addr().map_err(failed)?.port();
    Ok(format!("tcp/{address}:{port}"))
}
