//! zenoh's configuration: its defaults, never a file of the user's, and nothing found that was not
//! named.

use super::guard::Guard;
use super::outlet::priority;
use access::{gaps, of_client, of_links, qualities};
use network::guarded;
use serde_json::{Value, json};
use zenoh::Config;

/// Silence after which a link counts as dead \[ms\]. Each side says something four times as often.
/// A process that is gone is noticed at once; a shorter lease would take a machine that stands
/// still for a moment for a cut cable.
const LEASE_MILLIS: u64 = 2_000;

/// How long one attempt to connect may take \[ms\]. Short, so that an attempt that began during a
/// cut does not outlast it by much.
const ATTEMPT_MILLIS: u64 = 1_000;

/// Longest pause between two attempts to connect \[ms\].
const RETRY_MILLIS_MAX: u64 = 300;

/// Batches of 64 KiB that may wait on a link, of each priority: all that zenoh allows, since a
/// burst that finds none free is dropped.
const BATCHES: usize = 16;

/// How long a client's sender waits for a free batch before it drops a message \[µs\]. A router
/// must not: it has others to serve, and none gets free while it waits, since the thread that waits
/// is the one that writes.
const CLIENT_WAIT_MICROS: u64 = 100_000;
const ROUTER_WAIT_MICROS: u64 = 0;

/// Longest message, with all that zenoh adds \[bytes\]: one batch. Ours are shorter.
pub(super) const BYTES_MAX: usize = 64 * 1024;

/// Most sessions with a router that asks for certificates, and most that are just being opened.
/// Each process of a graph has a few.
const SESSIONS_MAX: usize = 128;

/// A client of the routers at `connect`, which are tried in turn for so long \[ms\].
pub(super) fn client(
    connect: &[String],
    open_millis: u64,
    guard: Option<&Guard>,
) -> Result<Config, zenoh::Error> {
    let config = configured(&[
        ("mode", json!("client")),
        ("connect/endpoints", json!(connect)),
        ("connect/timeout_ms", json!(open_millis)),
        ("connect/exit_on_failure", json!(true)),
        ("listen/endpoints", json!([])),
        (
            "transport/link/tx/queue/congestion_control/drop/wait_before_drop",
            json!(CLIENT_WAIT_MICROS),
        ),
        (
            "transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments",
            json!(CLIENT_WAIT_MICROS),
        ),
    ])?;
    let Some(guard) = guard else { return Ok(config) };
    guarded(config, &guard.credentials, &[("access_control", of_client(&guard.robot))])
}

/// A router at `listen`, which joins the routers at `connect` in the background, again and again.
pub(super) fn router(
    listen: &[String],
    connect: &[String],
    guard: Option<&Guard>,
) -> Result<Config, zenoh::Error> {
    let config = configured(&[
        ("mode", json!("router")),
        ("listen/endpoints", json!(listen)),
        ("connect/endpoints", json!(connect)),
        ("connect/timeout_ms", json!(-1)),
        ("connect/exit_on_failure", json!(false)),
        // Else opening takes this long, for routers that might be found.
        ("scouting/delay", json!(0)),
        (
            "transport/link/tx/queue/congestion_control/drop/wait_before_drop",
            json!(ROUTER_WAIT_MICROS),
        ),
        (
            "transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments",
            json!(ROUTER_WAIT_MICROS),
        ),
        // In lock step nothing is dropped: a link on which nothing moves any more ends instead.
        (
            "transport/link/tx/queue/congestion_control/block/wait_before_close",
            json!(ROUTER_WAIT_MICROS),
        ),
    ])?;
    let Some(guard) = guard else { return Ok(config) };
    let mut limits = vec![
        ("access_control", of_links(&guard.graph, &guard.robot, !guard.real_time)),
        ("transport/unicast/max_sessions", json!(SESSIONS_MAX)),
        ("transport/unicast/accept_pending", json!(SESSIONS_MAX)),
    ];
    if guard.real_time {
        limits.extend([
            ("downsampling", gaps(&guard.graph)),
            ("qos/network", qualities(&guard.graph, |topic| priority(topic).1)),
        ]);
    }
    guarded(config, &guard.credentials, &limits)
}

fn configured(settings: &[(&str, Value)]) -> Result<Config, zenoh::Error> {
    let common = [
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
        ("timestamping/enabled", json!(false)),
        ("adminspace/enabled", json!(false)),
        ("transport/unicast/open_timeout", json!(ATTEMPT_MILLIS)),
        ("transport/unicast/accept_timeout", json!(ATTEMPT_MILLIS)),
        ("transport/link/tx/lease", json!(LEASE_MILLIS)),
        ("transport/link/rx/max_message_size", json!(BYTES_MAX)),
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
        config.insert_json5(
            &format!("transport/link/tx/queue/size/{priority}"),
            &BATCHES.to_string(),
        )?;
    }
    for (key, value) in common.iter().chain(settings) {
        config.insert_json5(key, &value.to_string())?;
    }
    Ok(config)
}
