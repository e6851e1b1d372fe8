//! Whether a router keeps strangers out: tried from the inside, as one, before anything depends on
//! it.
//!
//! zenoh tells one who is refused nothing. So what must not arrive is said between two messages
//! that may, on the same way: when the first is there, the other would be passed on, and when the
//! last is there, it would have come.

use super::config;
use super::guard::Guard;
use super::presence::draw_id;
use access::{AccessError, Credentials, Role, TESTER};
use network::{ATTEMPT_MILLIS, Breach, first_line, keeps_strangers_out, over_tls};
use protocol::topic::Topic;
use serde_json::json;
use std::sync::mpsc::channel;
use std::thread;
use std::time::{Duration, Instant};
use zenoh::qos::CongestionControl;
use zenoh::{Session, Wait};

/// How long what may arrive may take.
const ARRIVES_WITHIN: Duration = Duration::from_secs(10);
/// More than a message may have.
const OVERSIZE_BYTES: usize = config::BYTES_MAX + 1;
/// What may pass, before and after \[bytes\].
const BEFORE_BYTES: usize = 1;
const AFTER_BYTES: usize = 2;
/// Pause before the next that passes, if it may: what comes right behind another the router lets go
/// of.
const NEXT_AFTER: Duration = Duration::from_millis(1);
/// Pause before what may pass is said, or tried, again.
const SAID_AGAIN_AFTER: Duration = Duration::from_millis(200);

/// Tries to get in at `endpoint`, the router of the graph called `graph`, as who should not: a
/// stranger, and a host that shows `credentials` and says what a host does not.
///
/// # Errors
/// The first [`Breach`].
pub fn self_test(endpoint: &str, graph: &str, credentials: &Credentials) -> Result<(), Breach> {
    let guard = Guard::new(credentials, graph);
    let guard = &guard.map_err(|error| Breach::Unknown {
        endpoint: endpoint.to_owned(),
        reason: error.to_string(),
    })?;
    keeps_strangers_out(endpoint, &guard.credentials)?;
    let tls = [over_tls(endpoint)];
    let endpoint = || endpoint.to_owned();
    let unknown = |reason: String| Breach::Unknown { endpoint: endpoint(), reason };
    let role =
        guard.credentials.read().map_err(|error: AccessError| unknown(error.to_string()))?.role;
    let attempt = || {
        let config = config::client(&tls, ATTEMPT_MILLIS, Some(guard)).and_then(|mut config| {
            // To hear what the router should not have passed on.
            config.insert_json5(
                "transport/link/rx/max_message_size",
                &json!(2 * OVERSIZE_BYTES).to_string(),
            )?;
            Ok(config)
        });
        config.and_then(|config| zenoh::open(config).wait())
    };
    let open = || {
        let deadline = Instant::now() + ARRIVES_WITHIN;
        loop {
            match attempt() {
                // After each stranger who was refused, nobody is let in for a moment.
                Err(_) if Instant::now() < deadline => thread::sleep(SAID_AGAIN_AFTER),
                opened => break opened.map_err(|error| unknown(first_line(&error))),
            }
        }
    };
    let arrived = as_another(&open()?, &open()?, &guard.graph, role)
        .map_err(|error| unknown(first_line(&error)))?;
    match arrived {
        None => {
            Err(unknown(format!("a permitted message did not arrive within {ARRIVES_WITHIN:?}")))
        }
        Some(Arrived::Nothing) => Ok(()),
        Some(Arrived::Forbidden(topic)) => {
            Err(Breach::WrongRole { endpoint: endpoint(), role: role.name(), topic })
        }
        Some(Arrived::Oversize) => Err(Breach::Oversize {
            endpoint: endpoint(),
            bytes: OVERSIZE_BYTES,
            most: config::BYTES_MAX,
        }),
    }
}

/// What came before what may.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Arrived {
    Nothing,
    Forbidden(&'static str),
    Oversize,
}

/// Says in `role` what it must not say, between two times what it may. None if not even that
/// arrives.
fn as_another(
    listener: &Session,
    speaker: &Session,
    graph: &str,
    role: Role,
) -> Result<Option<Arrived>, zenoh::Error> {
    // One on which it may hear what is said to one reader, in real time as well.
    let may_be_heard =
        |topic: &Topic| role.hears().contains(topic) && topic.quality(false).says_again();
    let forbidden =
        Topic::ALL.into_iter().find(|topic| may_be_heard(topic) && !role.says().contains(topic));
    let Some(forbidden) = forbidden else {
        return Err(
            format!("the role {} receives no topic that it may not write", role.name()).into()
        );
    };
    // Others may be testing themselves.
    let own = draw_id(Some(role));
    let key =
        |topic: Topic| format!("coxswain-link/{graph}/{}/history/{TESTER}/{own}", topic.name());
    let (tell, heard) = channel();
    let mut listening = Vec::new();
    for topic in [forbidden, Topic::Health] {
        let tell = tell.clone();
        // Nobody listens any more once all is known.
        let hear = move |sample: zenoh::sample::Sample| {
            tell.send((topic, sample.payload().len())).unwrap_or_default();
        };
        listening.push(listener.declare_subscriber(key(topic)).callback(hear).wait()?);
    }
    let say = |topic: Topic, bytes: usize| {
        speaker.put(key(topic), vec![0; bytes]).congestion_control(CongestionControl::Block).wait()
    };
    let deadline = Instant::now() + ARRIVES_WITHIN;
    // The router does not know the listener at once; it knows it for the other topic as well once
    // it passes this on, since that was declared before.
    loop {
        say(Topic::Health, BEFORE_BYTES)?;
        match heard.recv_timeout(SAID_AGAIN_AFTER) {
            Ok(_) => break,
            Err(_) if Instant::now() < deadline => {}
            Err(_) => return Ok(None),
        }
    }
    say(forbidden, BEFORE_BYTES)?;
    thread::sleep(NEXT_AFTER);
    say(Topic::Health, OVERSIZE_BYTES)?;
    loop {
        thread::sleep(NEXT_AFTER);
        say(Topic::Health, AFTER_BYTES)?;
        match heard.recv_timeout(SAID_AGAIN_AFTER) {
            Ok((Topic::Health, BEFORE_BYTES)) => {}
            Ok((Topic::Health, AFTER_BYTES)) => return Ok(Some(Arrived::Nothing)),
            Ok((Topic::Health, _)) => return Ok(Some(Arrived::Oversize)),
            Ok((topic, _)) => return Ok(Some(Arrived::Forbidden(topic.name()))),
            Err(_) if Instant::now() < deadline => {}
            Err(_) => return Ok(None),
        }
    }
}
