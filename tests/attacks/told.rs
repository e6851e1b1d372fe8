//! Refused operations are logged: each refusal counts once, in few lines.

use crate::driven::launched;
use crate::session::{Certificates, Failure, Shows, connect, failed, print};
use crate::strangers::strangers;
use access::Role;
use promises::{Launched, Outcome, signal};
use rustix::process::Signal;
use std::collections::BTreeMap;
use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Instant;
use zenoh::qos::CongestionControl;
use zenoh::{Session, Wait};

/// How often each operation is tried.
const TIMES: usize = 12;
/// More than the length limit of a message, and less than twice that [bytes].
const LONG_BYTES: usize = 100_000;

/// Reasons of refusals, and how often each occurred, from a log.
fn told(log: &str) -> BTreeMap<String, (usize, usize)> {
    let mut refusals: BTreeMap<String, (usize, usize)> = BTreeMap::new();
    for line in log.lines() {
        let reason = line
            .split_once("rejected at the network: ")
            .and_then(|(_, said)| said.rsplit_once(" count="));
        if let Some((reason, count)) = reason {
            let (lines, times) = refusals.entry(reason.to_owned()).or_default();
            *lines += 1;
            *times += count.parse::<usize>().unwrap_or(0);
        }
    }
    refusals
}

/// Publishes a message as the writer or watcher that `key` names, and waits as long as needed:
/// behind a long message there may be no room at first.
fn say(session: &Session, key: &str, length: usize) -> Outcome {
    session
        .put(key, vec![0; length])
        .congestion_control(CongestionControl::Block)
        .wait()
        .map_err(failed)
}

/// Waits until a log contains that `role` may not publish on `topic`; `session` of that role then
/// tries it. So all earlier operations of the session are counted.
fn all_is_counted(
    launched: &Launched,
    log: &str,
    session: &Session,
    key: &str,
    role: Role,
    topic: &str,
) -> Outcome {
    say(session, key, 0)?;
    launched.wait_for_log(log, &format!("{}.mecanum may not Put on {topic}", role.name()), 1)
}

/// Operations of a watcher below the keys of a link; it may do none of them.
fn deeds(session: &Session, link: &str) -> Result<(), Failure> {
    let key = |place: &str| format!("{link}/command/{place}");
    say(session, &key("data/watcher.1"), 0)?;
    session.delete(key("data/watcher.1")).wait().map_err(failed)?;
    session.get(key("join/1")).callback(drop).wait().map_err(failed)?;
    session.liveliness().get(key("writer/*")).callback(drop).wait().map_err(failed)?;
    // Each of these is undone when it is dropped; undoing a refused operation is not refused again.
    session.declare_queryable(key("join/*")).callback(drop).wait().map_err(failed)?;
    drop(session.liveliness().declare_token(key("reader/watcher.1")).wait().map_err(failed)?);
    session
        .liveliness()
        .declare_subscriber(key("writer/*"))
        .callback(drop)
        .wait()
        .map_err(failed)?;
    session.declare_subscriber(key("data/*")).callback(drop).wait().map_err(failed)?;
    Ok(())
}

/// Compares the refusals in a log with the expected beginnings of the reasons and their counts.
fn are_told<'a>(
    door: &str,
    log: &str,
    begin: Instant,
    expected: impl Iterator<Item = (&'a str, usize)>,
) {
    let refusals = told(log);
    for (reason, (lines, times)) in &refusals {
        print(format_args!("{door}: {times} times in {lines} lines: {reason}"));
    }
    // The first line comes at once, then one every ten seconds, and the rest at the end.
    let most = 2 + begin.elapsed().as_secs() / 10;
    assert!(
        refusals.values().all(|(lines, _)| *lines as u64 <= most),
        "{door}: more than {most} lines: {refusals:?}"
    );
    for (begins, expected) in expected {
        let times: usize = refusals
            .iter()
            .filter(|(reason, _)| reason.starts_with(begins))
            .map(|(_, (_, times))| times)
            .sum();
        assert_eq!(times, expected, "{door}: {begins}");
    }
}

#[test]
fn each_refusal_at_a_router_is_logged_once_in_few_lines() -> Outcome {
    let certificates = Certificates::new()?;
    let begin = Instant::now();
    let (launched, endpoint, graph) = launched(&certificates, &["--duration", "600"])?;
    let link = format!("coxswain-link/{graph}");
    let watcher = connect(&endpoint, &Shows::Certificate(certificates.of(Role::Watcher)))?;
    for _ in 0..TIMES {
        deeds(&watcher, &link)?;
    }
    all_is_counted(
        &launched,
        "coxswain",
        &watcher,
        &format!("{link}/state/data/watcher.1"),
        Role::Watcher,
        "state",
    )?;
    let gateway = connect(&endpoint, &Shows::Certificate(certificates.of(Role::Gateway)))?;
    for _ in 0..TIMES {
        say(&gateway, &format!("{link}/health/data/gateway.1"), LONG_BYTES)?;
    }
    all_is_counted(
        &launched,
        "coxswain",
        &gateway,
        &format!("{link}/state/data/gateway.1"),
        Role::Gateway,
        "state",
    )?;
    let address = endpoint.split_once('/').ok_or("no endpoint")?.1;
    for _ in 0..TIMES {
        let mut stranger = TcpStream::connect(address)?;
        stranger.write_all(b"let me in, let me in")?;
        // Until it has been refused.
        let _ = stranger.read_to_end(&mut Vec::new());
    }
    for (name, shows) in strangers(&certificates)? {
        for _ in 0..TIMES {
            let session = connect(&endpoint, &shows);
            assert_eq!(session.is_ok(), name == "certificate of another robot");
        }
    }
    // A client that connects after them gets its session after them.
    let recorder = connect(&endpoint, &Shows::Certificate(certificates.of(Role::Recorder)))?;
    all_is_counted(
        &launched,
        "coxswain",
        &recorder,
        &format!("{link}/state/data/recorder.1"),
        Role::Recorder,
        "state",
    )?;
    signal(launched.pid(), Signal::TERM)?;
    let (ended, home) = launched.end()?;
    let log = fs::read_to_string(home.path().join("run/coxswain.log"))?;
    let kinds = [
        "Put",
        "Delete",
        "Query",
        "Liveliness Query",
        "Declare Queryable",
        "Liveliness Token",
        "Declare Liveliness Subscriber",
        "Declare Subscriber",
    ];
    let of_watcher = kinds.map(|kind| format!("watcher.mecanum may not {kind} on command"));
    let once = [
        "a certificate without a role in this graph",
        "a message exceeds the size limit",
        "invalid peer certificate: BadSignature",
        "invalid peer certificate: certificate expired",
        "invalid peer certificate: certificate not valid yet",
        "peer sent no certificates",
    ];
    let expected = of_watcher.iter().map(String::as_str).chain(once).map(|reason| (reason, TIMES));
    // Peers without TLS, whether they use zenoh's protocol or not.
    are_told("router", &log, begin, expected.chain([("received corrupt message", 2 * TIMES)]));
    assert!(!ended.text.contains("is started again"), "{}", ended.text);
    Ok(())
}

#[test]
fn each_refusal_at_a_gateway_is_logged_once_in_few_lines() -> Outcome {
    let certificates = Certificates::new()?;
    let folder = certificates.folder();
    let begin = Instant::now();
    let launched = Launched::graph(
        "local",
        &["--certificates", folder.to_str().ok_or("no text")?, "--duration", "600"],
    )?;
    let endpoint = launched.gateway_endpoint()?;
    let watcher = connect(&endpoint, &Shows::Certificate(certificates.of(Role::Watcher)))?;
    let learner = connect(&endpoint, &Shows::Certificate(certificates.of(Role::Learner)))?;
    for _ in 0..TIMES {
        say(&watcher, "coxswain/mecanum/command", LONG_BYTES)?;
        say(&watcher, "coxswain/mecanum/command", 0)?;
        learner
            .declare_subscriber("coxswain/mecanum/command")
            .callback(drop)
            .wait()
            .map_err(failed)?;
    }
    for (session, role) in [(&watcher, Role::Watcher), (&learner, Role::Learner)] {
        all_is_counted(&launched, "gateway", session, "coxswain/mecanum/state", role, "state")?;
    }
    signal(launched.pid(), Signal::TERM)?;
    let (ended, home) = launched.end()?;
    let log = fs::read_to_string(home.path().join("run/gateway.log"))?;
    let at_gateway = [
        "a message exceeds the size limit",
        "watcher.mecanum may not Put on command",
        "learner.mecanum may not Declare Subscriber on command",
    ];
    are_told("gateway", &log, begin, at_gateway.into_iter().map(|reason| (reason, TIMES)));
    assert!(!ended.text.contains("is started again"), "{}", ended.text);
    Ok(())
}
