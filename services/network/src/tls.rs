//! zenoh's configuration → the same over TLS, with certificates at both ends.

use crate::threads;
use access::{AUTHORITY_FILE, CERTIFICATE_FILE, Credentials, KEY_FILE};
use serde_json::{Value, json};
use zenoh::Config;

/// `config` over TLS alone: both ends show a certificate, the name of the connected peer is
/// verified, and a link ends when a certificate expires.
///
/// # Errors
/// If zenoh would read and write a link with two threads.
pub fn guarded(
    mut config: Config,
    credentials: &Credentials,
    more: &[(&str, Value)],
) -> Result<Config, zenoh::Error> {
    if !threads::are_set() {
        let (variable, threads) = (threads::VARIABLE, threads::THREADS);
        return Err(format!(
            "TLS needs {variable}={threads} in the environment from the start: zenoh would damage \
            its own memory"
        )
        .into());
    }
    let file = |name| json!(credentials.file(name));
    let tls = [
        ("transport/link/protocols", json!(["tls"])),
        ("transport/link/tls/root_ca_certificate", file(AUTHORITY_FILE)),
        ("transport/link/tls/listen_private_key", file(KEY_FILE)),
        ("transport/link/tls/listen_certificate", file(CERTIFICATE_FILE)),
        ("transport/link/tls/connect_private_key", file(KEY_FILE)),
        ("transport/link/tls/connect_certificate", file(CERTIFICATE_FILE)),
        ("transport/link/tls/enable_mtls", json!(true)),
        ("transport/link/tls/verify_name_on_connect", json!(true)),
        ("transport/link/tls/close_link_on_expiration", json!(true)),
    ];
    for (key, value) in tls.iter().chain(more) {
        config.insert_json5(key, &value.to_string())?;
    }
    Ok(config)
}

/// `endpoint`, over TLS.
pub fn over_tls(endpoint: &str) -> String {
    endpoint
        .strip_prefix("tcp/")
        .map_or_else(|| endpoint.to_owned(), |address| format!("tls/{address}"))
}
