//! Tests whether peers without a certificate are refused. Before anything depends on an endpoint of
//! this process, the process tries to connect to it as such a peer.

use crate::reason::first_line;
use access::{AUTHORITY_FILE, Credentials};
use serde_json::{Value, json};
use std::thread;
use std::time::{Duration, Instant};
use zenoh::{Config, Wait};

/// Longest time of one attempt \[ms\]. A refused attempt ends far sooner.
pub const ATTEMPT_MILLIS: u64 = 2_000;
/// Number of attempts, if each takes that long.
const ATTEMPTS: u32 = 3;

/// An endpoint of this process does not protect it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Breach {
    /// Any peer can connect without TLS.
    #[error("a peer without TLS was accepted at {endpoint}")]
    Plain {
        /// The endpoint.
        endpoint: String,
    },
    /// The endpoint does not require certificates.
    #[error("a peer without a certificate was accepted at {endpoint}")]
    NoCertificate {
        /// The endpoint.
        endpoint: String,
    },
    /// The access control does not restrict which roles watch.
    #[error("the role {role} receives at {endpoint} data that only watchers may receive")]
    NoWatcher {
        /// The endpoint.
        endpoint: String,
        /// The role that was tried.
        role: String,
    },
    /// A router does not restrict what a host publishes.
    #[error(
        "the router at {endpoint} delivers what this host publishes in the name of host {host}: \
         run it with the configuration that `coxswain router` prints"
    )]
    Name {
        /// The endpoint.
        endpoint: String,
        /// The host whose name was used.
        host: String,
    },
    /// The test gave no result.
    #[error("the access check at {endpoint} could not be completed: {reason}")]
    Unknown {
        /// The endpoint.
        endpoint: String,
        /// The error.
        reason: String,
    },
}

/// Tries to get a session at `endpoint`: without TLS, and over TLS without a certificate. It trusts
/// the authority of `credentials`.
///
/// # Errors
/// The first [`Breach`].
pub fn keeps_strangers_out(endpoint: &str, credentials: &Credentials) -> Result<(), Breach> {
    let address = endpoint.split_once('/').map_or(endpoint, |(_, address)| address);
    let endpoint = || endpoint.to_owned();
    let unknown = |reason: String| Breach::Unknown { endpoint: endpoint(), reason };
    let plain = stranger(&format!("tcp/{address}"), &[]);
    let without = [
        ("transport/link/tls/root_ca_certificate", json!(credentials.file(AUTHORITY_FILE))),
        ("transport/link/tls/enable_mtls", json!(false)),
    ];
    let without = stranger(&format!("tls/{address}"), &without);
    let [plain, without] =
        [plain, without].map(|config| config.map_err(|error| unknown(first_line(&error))));
    let (plain, without) = (plain?, without?);
    let (plain, without) = thread::scope(|scope| {
        let attempts = [&plain, &without].map(|config| scope.spawn(|| gets_in(config)));
        let [plain, without] = attempts.map(|attempt| {
            attempt.join().unwrap_or_else(|_| Err("the attempt panicked".to_owned()))
        });
        (plain, without)
    });
    // An endpoint that accepts plain connections does not answer TLS.
    if plain == Ok(true) {
        return Err(Breach::Plain { endpoint: endpoint() });
    }
    if without.map_err(unknown)? {
        return Err(Breach::NoCertificate { endpoint: endpoint() });
    }
    plain.map(|_| ()).map_err(unknown)
}

/// The configuration of a peer that knows only zenoh's documentation.
fn stranger(endpoint: &str, more: &[(&str, Value)]) -> Result<Config, zenoh::Error> {
    let mut config = Config::default();
    let own = [
        ("mode", json!("client")),
        ("connect/endpoints", json!([endpoint])),
        ("connect/timeout_ms", json!(0)),
        ("connect/exit_on_failure", json!(true)),
        ("scouting/multicast/enabled", json!(false)),
        ("transport/unicast/open_timeout", json!(ATTEMPT_MILLIS)),
    ];
    for (key, value) in own.iter().chain(more) {
        config.insert_json5(key, &value.to_string())?;
    }
    Ok(config)
}

/// Whether a peer with this configuration gets a session; the error if the test gave no result.
fn gets_in(config: &Config) -> Result<bool, String> {
    for _ in 0..ATTEMPTS {
        let begin = Instant::now();
        if zenoh::open(config.clone()).wait().is_ok() {
            return Ok(true);
        }
        if begin.elapsed() < Duration::from_millis(ATTEMPT_MILLIS) {
            return Ok(false);
        }
    }
    Err(format!(
        "an unauthenticated peer got no reply within {ATTEMPT_MILLIS} ms, {ATTEMPTS} times"
    ))
}
