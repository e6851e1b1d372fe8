//! The configuration of a zenoh session with explicit endpoints: no discovery, bounded times.

use serde_json::json;
use zenoh::Config;

/// How long the other end may take to identify itself \[ms\].
const OPEN_TIMEOUT_MILLIS: u64 = 3000;

/// A session ends after its other end has been silent for so long \[ms\].
const LEASE_MILLIS: u64 = 2000;

/// zenoh's defaults for `mode`, without endpoints. Messages have at most `bytes_max` bytes.
pub(crate) fn quiet(mode: &str, bytes_max: u64) -> Result<Config, zenoh::Error> {
    let mut config = Config::default();
    for (key, value) in [
        ("mode", json!(mode)),
        ("connect/endpoints", json!([])),
        ("listen/endpoints", json!([])),
        ("adminspace/enabled", json!(false)),
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/enabled", json!(false)),
        // Otherwise opening takes this long, to wait for peers that discovery might find.
        ("scouting/delay", json!(0)),
        ("transport/unicast/open_timeout", json!(OPEN_TIMEOUT_MILLIS)),
        ("transport/unicast/accept_timeout", json!(OPEN_TIMEOUT_MILLIS)),
        ("transport/link/tx/lease", json!(LEASE_MILLIS)),
        ("transport/link/rx/max_message_size", json!(bytes_max)),
    ] {
        config.insert_json5(key, &value.to_string())?;
    }
    Ok(config)
}
