//! Floods by unauthenticated peers and by peers with a certificate of the robot.

use crate::driven::{acted, genuine, launched};
use crate::session::{Certificates, Failure, Shows, connect, failed, print};
use access::Role;
use promises::{Message, Outcome, Record, signal};
use protocol::clock::monotonic_nanos;
use rustix::process::Signal;
use std::fmt::{self, Display, Formatter};
use std::io::Write;
use std::net::TcpStream;
use std::ops::Range;
use std::thread;
use std::time::{Duration, Instant};
use zenoh::bytes::ZBytes;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::QueryTarget;
use zenoh::{Session, Wait};

/// Number of floods; each is followed by a calm of the same length.
const FLOODS: usize = 7;
/// Least length of each flood.
const FLOOD_LASTS: Duration = Duration::from_secs(1);

/// Messages or queries of one role in a flood that leaves processor time to others [1/s]: four
/// times what its router forwards.
const PACED_PER_SECOND: u32 = 20_000;
/// Pause of such a flood, repeated as needed.
const PACED_PAUSE: Duration = Duration::from_millis(1);

/// Largest ratio of the time from a state to its command: during floods to between them.
const SLOWER_MOST: f64 = 1.25;

/// Length of a long query [bytes]: the length limit.
const LONG_BYTES: usize = 60_000;
/// A port that does not appear within this time does not exist.
const PORT_SHOWS_WITHIN: Duration = Duration::from_secs(20);

/// Median time from a state to its command over these plans [ns].
fn middle(plans: &[&Message]) -> u64 {
    let mut nanos: Vec<u64> = plans.iter().map(|plan| plan.count("tick_nanos")).collect();
    nanos.sort_unstable();
    nanos.get(nanos.len() / 2).copied().unwrap_or(0)
}

/// Each refusal is in the log, in a few lines.
fn assert_floods_are_logged(log: &str, connections: usize, subscriptions: usize) {
    assert!(log.contains("rejected at the network: a message exceeds the size limit"), "{log}");
    let lines = log.lines().filter(|line| line.contains("rejected at the network")).count();
    let of_subscriptions =
        log.lines().filter(|line| line.contains("may not Declare Subscriber on command count="));
    let logged: usize =
        of_subscriptions.filter_map(|line| line.rsplit('=').next()?.parse::<usize>().ok()).sum();
    assert_eq!(logged, subscriptions, "each refused subscription is told once:\n{log}");
    assert!(
        log.contains("rejected at the network: received corrupt message"),
        "nothing is told of {connections} strangers:\n{log}"
    );
    assert!(lines <= 3 * 16, "{lines} lines for {connections} strangers");
    assert!(!log.contains("zenoh_link_tls"), "{log}");
}

#[test]
fn floods_of_connections_subscriptions_and_fragments_do_not_stop_the_robot() -> Outcome {
    let certificates = Certificates::for_a_flood()?;
    let (launched, endpoint, graph) = launched(&certificates, &["--duration", "18"])?;
    let door = launched.told_a_person("listening at ")?;
    let address = door.split_once('/').ok_or("no endpoint")?.1.to_owned();
    let open = |role| connect(&endpoint, &Shows::Certificate(certificates.of(role)));
    let (watcher, gateway) = (open(Role::Watcher)?, open(Role::Gateway)?);
    let (mut held, mut counts) = (Vec::new(), [0_usize; 3]);
    let base = format!("coxswain-link/{graph}");
    let long = vec![0_u8; 8 * 1024 * 1024];
    let mut wave = || {
        for _ in 0..20 {
            if let Ok(mut stream) = TcpStream::connect(&address) {
                let _ = stream.write_all(b"let me in");
                counts[0] += 1;
                if held.len() < 200 {
                    held.push(stream);
                }
            }
        }
        for _ in 0..100 {
            let key = format!("{base}/command/data/{}", counts[1]);
            counts[1] += usize::from(
                watcher.declare_subscriber(key).callback(drop).background().wait().is_ok(),
            );
        }
        counts[2] += usize::from(
            gateway.put(format!("{base}/health/data/gateway.flood"), long.clone()).wait().is_ok(),
        );
    };
    // Floods alternate with calms of the same length, so that other load on the machine affects
    // both.
    let mut floods = Vec::new();
    while floods.len() < FLOODS {
        thread::sleep(FLOOD_LASTS);
        let begin = Instant::now();
        let from = monotonic_nanos();
        while begin.elapsed() < FLOOD_LASTS {
            wave();
        }
        floods.push(from..monotonic_nanos());
    }
    drop((watcher, gateway, held));
    let (ended, home) = launched.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    let log = std::fs::read_to_string(home.path().join("run/coxswain.log"))?;
    let record = Record::read(&home.path().join("run"))?;
    assert_eq!(record.of("state").last().map(|state| state.stamp("tick")), Some(180));
    let genuine = genuine(&record)?;
    let acted = acted(&record);
    assert!(acted.keys().all(|writer| [0, genuine].contains(writer)), "{acted:?}: {}", ended.text);
    let long_messages =
        record.of("health").filter(|health| health.word("participant") == "?").count();
    assert_eq!(long_messages, 0);
    let flooded = |message: &&Message| {
        floods.iter().any(|flood| flood.contains(&message.stamp("sent_nanos")))
    };
    // Before the first plan there is nothing to compare, and after the last flood there is no calm.
    let last = floods.last().map_or(0, |flood| flood.end);
    let driving = |kind| {
        record.of(kind).filter(move |message| {
            message.stamp("tick") >= 10 && message.stamp("sent_nanos") < last
        })
    };
    let (during, before): (Vec<&Message>, Vec<&Message>) = driving("plan").partition(flooded);
    let states: Vec<&Message> = driving("state").filter(flooded).collect();
    let fresh = states.iter().filter(|state| state.word("fallback_level") == "fresh plan").count();
    let [connections, subscriptions, fragments] = counts;
    let (calm, flood) = (middle(&before), middle(&during));
    print(format_args!(
        "floods: {connections} connections, {subscriptions} subscriptions, {fragments} messages of \
        8 MiB; control tick p50 {} us in {} periods \
         between them, {} us in {} during, ratio {:.2}; {fresh} of {} periods on fresh plans",
        calm / 1000,
        before.len(),
        flood / 1000,
        during.len(),
        flood as f64 / calm as f64,
        states.len()
    ));
    assert!(
        states.len() > 30 && fresh * 10 >= states.len() * 9,
        "{fresh} of {} periods on fresh plans",
        states.len()
    );
    // Compared with the calm in the same run: a ratio that does not depend on other load of the
    // machine.
    assert!(
        flood as f64 <= SLOWER_MOST * calm as f64,
        "control tick p50 {flood} ns in the floods, {calm} ns between them"
    );
    assert_floods_are_logged(&log, connections, subscriptions);
    assert!(connections > 100 && subscriptions > 100 && fragments > 0, "{counts:?}");
    Ok(())
}

/// What a role floods within its permissions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Excess {
    /// The controller: commands, which move the robot.
    Commands,
    /// The learner: snapshots, which the controller uses.
    Snapshots,
    /// The learner, to the controller alone, as if the controller had joined late.
    History,
    /// The gateway: queries whether the robot is there.
    Questions,
    /// The same queries with a long payload.
    LongQuestions,
    /// The gateway: subscriptions to repetitions for a single reader.
    Subscriptions,
    /// The gateway: its room for states, which no role may report in real time.
    Room,
}

impl Excess {
    const ALL: [Self; 7] = [
        Self::Commands,
        Self::Snapshots,
        Self::History,
        Self::Questions,
        Self::LongQuestions,
        Self::Subscriptions,
        Self::Room,
    ];

    fn role(self) -> Role {
        match self {
            Self::Commands => Role::Controller,
            Self::Snapshots | Self::History => Role::Learner,
            Self::Questions | Self::LongQuestions | Self::Subscriptions | Self::Room => {
                Role::Gateway
            }
        }
    }

    /// The other end, if the message is for one end alone, below the keys of the graph.
    fn end(self) -> Option<(&'static str, Role)> {
        match self {
            Self::History => Some(("snapshot/reader", Role::Controller)),
            Self::Room => Some(("state/writer", Role::Robot)),
            Self::Commands
            | Self::Snapshots
            | Self::Questions
            | Self::LongQuestions
            | Self::Subscriptions => None,
        }
    }

    /// Sends the message or query once at the keys below `link`, as urgent and blocking; `other` is
    /// the id of the other end.
    fn once(self, session: &Session, link: &str, other: &str) -> bool {
        let key = match self {
            Self::Commands => format!("{link}/command/data/controller.flood"),
            Self::Snapshots => format!("{link}/snapshot/data/learner.flood"),
            Self::History => format!("{link}/snapshot/history/{other}/learner.flood"),
            Self::Questions | Self::LongQuestions => {
                let question = session
                    .get(format!("{link}/state/join/*"))
                    .target(QueryTarget::All)
                    .priority(Priority::RealTime);
                let question =
                    question.payload(vec![
                        0_u8;
                        if self == Self::LongQuestions { LONG_BYTES } else { 0 }
                    ]);
                return question
                    .congestion_control(CongestionControl::Block)
                    .callback(drop)
                    .wait()
                    .is_ok();
            }
            Self::Subscriptions => {
                let key = format!("{link}/state/history/gateway.{:x}/*", monotonic_nanos());
                return session.declare_subscriber(key).callback(drop).wait().is_ok();
            }
            Self::Room => format!("{link}/state/room/{other}/gateway.flood"),
        };
        let put =
            session.put(key, ZBytes::from([0_u8; 64].as_slice())).priority(Priority::RealTime);
        put.congestion_control(CongestionControl::Block).wait().is_ok()
    }
}

/// Id of the port of `role` at one end of a topic, below the keys of the graph. On a busy machine a
/// router may need a while to announce it to a new session.
pub(crate) fn port(
    session: &Session,
    link: &str,
    (end, role): (&str, Role),
) -> Result<String, Failure> {
    let begin = Instant::now();
    loop {
        let tokens = session.liveliness().get(format!("{link}/{end}/**")).wait().map_err(failed)?;
        let keys = tokens
            .iter()
            .filter_map(|token| Some(token.into_result().ok()?.key_expr().as_str().to_owned()));
        let ids: Vec<String> =
            keys.filter_map(|key| Some(key.rsplit('/').next()?.to_owned())).collect();
        if let Some(its) = ids.iter().find(|id| id.starts_with(role.name())) {
            return Ok(its.clone());
        }
        if begin.elapsed() > PORT_SHOWS_WITHIN {
            return Err(format!("no {} among {ids:?}", role.name()).into());
        }
    }
}

/// Rate of a flood.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Pace {
    /// [`PACED_PER_SECOND`].
    Fixed,
    /// As fast as one thread can.
    Full,
}

/// One flood, and its time [ns].
struct Flood {
    excess: Excess,
    pace: Pace,
    said: u32,
    time: Range<u64>,
}

/// Time after a flood until the robot must drive as before [ns].
const RECOVERS_WITHIN_NANOS: u64 = 2_000_000_000;

/// Number of periods, number of those on fresh plans, and median time from a state to its command
/// [ns].
struct Driven {
    fresh: usize,
    periods: usize,
    middle: u64,
}

impl Display for Driven {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let Self { fresh, periods, middle } = self;
        write!(f, "{fresh} of {periods} periods on fresh plans, p50 {} us", middle / 1000)
    }
}

/// The periods whose messages were sent at times that `within` accepts, from the start of the drive
/// on.
fn fresh_of(record: &Record, within: impl Fn(u64) -> bool) -> Driven {
    let of = |kind| {
        record
            .of(kind)
            .filter(|message| message.stamp("tick") >= 10 && within(message.stamp("sent_nanos")))
    };
    let plans: Vec<&Message> = of("plan").collect();
    let (mut fresh, mut periods) = (0, 0);
    for state in of("state") {
        periods += 1;
        fresh += usize::from(state.word("fallback_level") == "fresh plan");
    }
    Driven { fresh, periods, middle: middle(&plans) }
}

#[test]
fn a_role_that_floods_within_its_permissions_silences_no_process() -> Outcome {
    let certificates = Certificates::for_a_flood()?;
    let (launched, endpoint, graph) = launched(&certificates, &["--duration", "300"])?;
    let link = format!("coxswain-link/{graph}");
    let mut floods = Vec::new();
    for (excess, pace) in Excess::ALL.map(|of| [(of, Pace::Fixed), (of, Pace::Full)]).concat() {
        let session = connect(&endpoint, &Shows::Certificate(certificates.of(excess.role())))?;
        let other =
            excess.end().map(|end| port(&session, &link, end)).transpose()?.unwrap_or_default();
        thread::sleep(FLOOD_LASTS);
        let (begin, from, mut said) = (Instant::now(), monotonic_nanos(), 0_u32);
        while begin.elapsed() < FLOOD_LASTS {
            if pace == Pace::Full
                || f64::from(said) < begin.elapsed().as_secs_f64() * f64::from(PACED_PER_SECOND)
            {
                said += u32::from(excess.once(&session, &link, &other));
            } else {
                thread::sleep(PACED_PAUSE);
            }
        }
        floods.push(Flood { excess, pace, said, time: from..monotonic_nanos() });
    }
    // All processes of the graph are still there after the last flood.
    thread::sleep(Duration::from_nanos(RECOVERS_WITHIN_NANOS) + 2 * FLOOD_LASTS);
    signal(launched.pid(), Signal::TERM)?;
    let (ended, home) = launched.end()?;
    assert_eq!(ended.status.code(), Some(128 + Signal::TERM.as_raw()), "{}", ended.text);
    let log = std::fs::read_to_string(home.path().join("run/coxswain.log"))?;
    let record = Record::read(&home.path().join("run"))?;
    let flooded = |pace: Pace| {
        floods.iter().filter(move |flood| flood.pace == pace).map(|flood| flood.time.clone())
    };
    let last = floods.last().map_or(0, |flood| flood.time.end);
    // As many seconds of calm as of flood, in turn.
    let calm = fresh_of(&record, |nanos| {
        nanos < last && !floods.iter().any(|flood| flood.time.contains(&nanos))
    });
    let paced = fresh_of(&record, |nanos| flooded(Pace::Fixed).any(|time| time.contains(&nanos)));
    // A while after the last flood, in which delayed processes recover.
    let after = fresh_of(&record, |nanos| nanos > last + RECOVERS_WITHIN_NANOS);
    for flood in &floods {
        let of = fresh_of(&record, |nanos| flood.time.contains(&nanos));
        let Flood { excess, pace, said, .. } = flood;
        print(format_args!("{excess:?}, {pace:?} pace, {said} said: {of}"));
        assert!(*said > 100, "{excess:?}: {said}");
    }
    print(format_args!(
        "within a role: {calm} between floods, {paced} in paced ones, {after} after"
    ));
    assert!(!ended.text.contains("is started again"), "{}", ended.text);
    let all = fresh_of(&record, |nanos| floods.iter().any(|flood| flood.time.contains(&nanos)));
    // Excess messages are dropped where they arrive, so that such a flood costs no plans. A flood
    // at full speed takes the processors that plant and controller need, and the robot may brake.
    // In all floods together nine tenths of the periods are on fresh plans.
    assert!(paced.periods > 50 && paced.fresh * 10 >= paced.periods * 9, "{paced} in paced floods");
    assert!(all.fresh * 10 >= all.periods * 9, "{all} in all floods");
    assert!(after.periods > 10 && after.fresh * 10 >= after.periods * 9, "{after} after the last");
    let genuine = genuine(&record)?;
    let acted = acted(&record);
    assert!(acted.keys().all(|writer| [0, genuine].contains(writer)), "{acted:?}: {}", ended.text);
    for who in [
        "controller.mecanum publishes on command above the rate limit",
        "learner.mecanum publishes on snapshot above the rate limit",
        "gateway.mecanum may not Put on state",
    ] {
        assert!(
            log.contains(&format!("rejected at the network: {who}")),
            "{who} is not told:\n{log}"
        );
    }
    Ok(())
}
