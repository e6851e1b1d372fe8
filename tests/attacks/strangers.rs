//! Unauthenticated peers at the router of the links: no peer receives their messages, and they
//! receive none.

use crate::session::{
    Certificates, Failure, HOUR_S, ROBOT, Shows, connect, failed, of, print, router,
};
use access::Role;
use promises::{Outcome, wait_until};
use protocol::VERSION;
use protocol::message::PlantState;
use protocol::topic::Topic;
use serde_json::json;
use std::collections::BTreeSet;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Barrier, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use transport::{Carrier, Carriers, Identity, Links, OpenError, Ports, Router, Since, Source};
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Session, Wait};

/// Time for a message to arrive, after the permitted ones have arrived.
const GRACE: Duration = Duration::from_secs(1);
/// How often a stranger publishes everything.
const ROUNDS: usize = 3;
/// Time for permitted messages to arrive. Far longer than it takes on any machine.
const GIVES_UP_AFTER: Duration = Duration::from_secs(90);
/// Operations that a stranger tries on a topic: put, delete, subscribe, tokens of a writer and of a
/// reader.
const STRANGE_DEEDS: usize = 5;

/// All peers that must be refused, by name.
pub(crate) fn strangers(
    certificates: &Certificates,
) -> Result<Vec<(&'static str, Shows)>, Failure> {
    let foreign = certificates.issue("another-authority", "foreign", ROBOT, (-HOUR_S, HOUR_S))?;
    let expired = certificates.issue("authority", "expired", ROBOT, (-HOUR_S, -60))?;
    let future = certificates.issue("authority", "future", ROBOT, (HOUR_S, 2 * HOUR_S))?;
    let other = certificates.issue("authority", "other", "roomba", (-HOUR_S, HOUR_S))?;
    // A stranger with a foreign certificate trusts our authority; otherwise it would not even show
    // its certificate.
    let ours = certificates.of(Role::Controller);
    std::fs::copy(
        ours.file("authority.pem"),
        of(&foreign, Role::Controller).file("authority.pem"),
    )?;
    Ok(vec![
        ("TCP", Shows::Nothing),
        ("TLS without a certificate", Shows::NoCertificate(ours)),
        ("certificate of a foreign authority", Shows::Certificate(of(&foreign, Role::Controller))),
        ("expired certificate", Shows::Certificate(of(&expired, Role::Controller))),
        ("certificate of the future", Shows::Certificate(of(&future, Role::Controller))),
        ("certificate of another robot", Shows::Certificate(of(&other, Role::Controller))),
    ])
}

/// Received messages of all peers.
#[derive(Debug, Clone, Default)]
struct Ears(Arc<Mutex<BTreeSet<String>>>);

impl Ears {
    fn listen(
        &self,
        session: &Session,
        key: String,
    ) -> Result<zenoh::pubsub::Subscriber<()>, Failure> {
        let ears = self.clone();
        session
            .declare_subscriber(key)
            .callback(move |sample| ears.note(&sample))
            .wait()
            .map_err(failed)
    }

    /// Records the tokens that appear and disappear.
    fn see(
        &self,
        session: &Session,
        key: String,
    ) -> Result<zenoh::pubsub::Subscriber<()>, Failure> {
        let ears = self.clone();
        let see = move |sample: Sample| {
            // They disappear at the end of the test.
            if sample.kind() == SampleKind::Put {
                ears.note(&sample);
            }
        };
        session
            .liveliness()
            .declare_subscriber(key)
            .history(true)
            .callback(see)
            .wait()
            .map_err(failed)
    }

    /// Records the present tokens.
    fn look(&self, session: &Session, key: String) -> Result<(), Failure> {
        let ears = self.clone();
        let see = move |reply: zenoh::query::Reply| {
            if let Ok(sample) = reply.result() {
                ears.note(sample);
            }
        };
        session.liveliness().get(key).timeout(GRACE).callback(see).wait().map_err(failed)
    }

    /// Records that the stranger `name` receives a message on `topic`.
    fn stolen(&self, name: &str, topic: Topic) -> impl Fn(Sample) + Send + Sync + 'static {
        let (ears, theft) = (self.clone(), Self::theft(name, topic));
        move |_| ears.write(theft.clone())
    }

    fn theft(name: &str, topic: Topic) -> String {
        format!("{name} hears {}", topic.name())
    }

    fn note(&self, sample: &Sample) {
        self.write(format!("{} {}", sample.kind(), sample.key_expr()));
    }

    fn write(&self, what: String) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).insert(what);
    }

    fn heard(&self) -> BTreeSet<String> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// Name of the graph on the network.
const GRAPH: &str = "maze";

fn data(topic: Topic, writer: &str) -> String {
    format!("coxswain-link/{GRAPH}/{}/data/{writer}", topic.name())
}

/// Key of a message on `topic` in the name of the role that may publish it.
fn said(topic: Topic, id: &str) -> String {
    let writer = match topic {
        Topic::State | Topic::Health | Topic::Truth => Role::Robot,
        Topic::Command | Topic::Residual | Topic::Plan => Role::Controller,
        Topic::Snapshot => Role::Learner,
        Topic::Credit => Role::Recorder,
    };
    data(topic, &format!("{}.{id}", writer.name()))
}

fn token(topic: Topic, end: &str, id: &str) -> String {
    format!(
        "coxswain-link/{GRAPH}/{}/{end}/{VERSION}/{}/newest-wins/{id}",
        topic.name(),
        topic.message()
    )
}

/// A stranger with a session.
struct LetIn {
    name: &'static str,
    /// Its number among all strangers.
    number: usize,
    says: Session,
    /// A second session, because a session receives its own messages.
    hears: Session,
}

/// Strangers that get a session; each `connect`s in its own way.
fn let_in(
    strangers: &[(&'static str, Shows)],
    connect: &dyn Fn(&Shows) -> Result<Session, Failure>,
) -> Result<Vec<LetIn>, Failure> {
    let mut found = Vec::new();
    for (number, (name, shows)) in strangers.iter().enumerate() {
        // Some are refused at once; others only find that their operations have no effect.
        if let Ok(says) = connect(shows) {
            found.push(LetIn { name, number, says, hears: connect(shows)? });
        }
    }
    Ok(found)
}

/// The messages of `strangers` that authorised peers receive, the messages that strangers receive,
/// and those between authorised peers. Returns all of them once `is_all` accepts them.
fn on_the_links(
    honest: &dyn Fn(Role) -> Result<Session, Failure>,
    strangers: &[LetIn],
    is_all: &dyn Fn(&BTreeSet<String>) -> bool,
) -> Result<BTreeSet<String>, Failure> {
    let (robot, controller, learner, recorder) = (
        honest(Role::Robot)?,
        honest(Role::Controller)?,
        honest(Role::Learner)?,
        honest(Role::Recorder)?,
    );
    let ends = Topic::ALL.map(|topic| match topic {
        Topic::State => (topic, &robot, &controller),
        Topic::Command => (topic, &controller, &robot),
        Topic::Residual => (topic, &controller, &learner),
        Topic::Snapshot => (topic, &learner, &controller),
        Topic::Plan => (topic, &controller, &recorder),
        Topic::Health | Topic::Truth => (topic, &robot, &recorder),
        Topic::Credit => (topic, &recorder, &robot),
    });
    let ears = Ears::default();
    let (mut listening, mut tokens) = (Vec::new(), Vec::new());
    for (topic, writer, reader) in ends {
        listening.push(ears.listen(reader, data(topic, "*"))?);
        listening
            .push(ears.see(writer, format!("coxswain-link/{GRAPH}/{}/reader/**", topic.name()))?);
        for (session, end) in [(writer, "writer"), (reader, "reader")] {
            tokens.push(
                session
                    .liveliness()
                    .declare_token(token(topic, end, "honest"))
                    .wait()
                    .map_err(failed)?,
            );
        }
        for LetIn { name, number, says, hears } in strangers {
            for end in ["writer", "reader"] {
                tokens.push(
                    says.liveliness()
                        .declare_token(token(topic, end, &format!("stranger-{number}")))
                        .wait()
                        .map_err(failed)?,
                );
            }
            let stolen = ears.stolen(name, topic);
            listening.push(
                hears
                    .declare_subscriber(data(topic, "*"))
                    .callback(stolen)
                    .wait()
                    .map_err(failed)?,
            );
        }
    }
    let begin = Instant::now();
    for round in 0.. {
        if round >= ROUNDS && (is_all(&ears.heard()) || begin.elapsed() > GIVES_UP_AFTER) {
            break;
        }
        for (topic, writer, reader) in ends {
            for LetIn { number, says, .. } in strangers {
                let key = said(topic, &format!("stranger-{number}"));
                says.put(&key, "x").wait().map_err(failed)?;
                says.delete(&key).wait().map_err(failed)?;
            }
            writer.put(said(topic, "honest"), "x").wait().map_err(failed)?;
            ears.look(reader, format!("coxswain-link/{GRAPH}/{}/writer/**", topic.name()))?;
        }
        thread::sleep(GRACE / 4);
    }
    thread::sleep(GRACE);
    drop((listening, tokens));
    Ok(ears.heard())
}

/// Messages that authorised peers should receive on the links from `id`.
fn said_by(id: &str, kinds: &[&str]) -> BTreeSet<String> {
    let of = |topic| {
        let words = kinds.iter().map(move |kind| format!("{kind} {}", said(topic, id)));
        words.chain(["writer", "reader"].map(|end| format!("PUT {}", token(topic, end, id))))
    };
    Topic::ALL.into_iter().flat_map(of).collect()
}

#[test]
fn no_stranger_publishes_or_receives_anything_on_a_link() -> Outcome {
    let certificates = Certificates::new()?;
    let router = Router::guarded(
        &["tcp/127.0.0.1:0".to_owned()],
        &[],
        GRAPH,
        &certificates.of(Role::RobotHost),
        false,
    )?;
    let endpoint = router.endpoints().first().ok_or("it listens nowhere")?.clone();
    let honest = |role| connect(&endpoint, &Shows::Certificate(certificates.of(role)));
    let strangers = strangers(&certificates)?;
    let let_in = let_in(&strangers, &|shows| connect(&endpoint, shows))?;
    let expected = said_by("honest", &["PUT"]);
    let received = on_the_links(&honest, &let_in, &|received| expected.is_subset(received))?;
    let names: Vec<&str> = let_in.iter().map(|stranger| stranger.name).collect();
    let arrived = received.difference(&expected).count();
    let cells = strangers.len() * Topic::ALL.len() * STRANGE_DEEDS;
    print(format_args!(
        "strangers at the links: {cells} cells, 0 allowed, {arrived} arrived; a session, in which \
        nothing passes: {names:?}"
    ));
    assert_eq!(received, expected);
    assert!(names.iter().all(|name| *name == "certificate of another robot"), "{names:?}");
    Ok(())
}

/// Otherwise nothing would be received from strangers in any case.
#[test]
fn without_certificates_every_operation_of_strangers_on_a_link_takes_effect() -> Outcome {
    let certificates = Certificates::new()?;
    let router = Router::open(&["tcp/127.0.0.1:0".to_owned()], &[])?;
    let endpoint = router.endpoints().first().ok_or("it listens nowhere")?.clone();
    let open = || connect(&endpoint, &Shows::Nothing);
    let let_in = let_in(&strangers(&certificates)?, &|_| open())?;
    let mut expected = said_by("honest", &["PUT"]);
    for LetIn { name, number, .. } in &let_in {
        expected.extend(said_by(&format!("stranger-{number}"), &["PUT", "DELETE"]));
        expected.extend(Topic::ALL.map(|topic| Ears::theft(name, topic)));
    }
    let received = on_the_links(&|_| open(), &let_in, &|received| expected.is_subset(received))?;
    assert_eq!(received, expected);
    assert_eq!(expected.len(), 24 + 6 * Topic::ALL.len() * STRANGE_DEEDS);
    Ok(())
}

#[test]
fn a_client_refuses_a_router_without_a_matching_certificate() -> Outcome {
    let certificates = Certificates::new()?;
    let other = certificates.issue("authority", "other", "roomba", (-HOUR_S, HOUR_S))?;
    // With a stolen certificate that is meant for clients only, it listens for connections.
    for role in [Role::Watcher, Role::Controller, Role::Robot] {
        let router = Router::guarded(
            &["tcp/127.0.0.1:0".to_owned()],
            &[],
            "maze",
            &certificates.of(role),
            false,
        )?;
        let endpoint = router.endpoints().first().ok_or("it listens nowhere")?.clone();
        assert!(
            connect(&endpoint, &Shows::Certificate(certificates.of(Role::Robot))).is_err(),
            "{}",
            role.name()
        );
    }
    // A certificate for this address is not valid for another.
    let router = Router::guarded(
        &["tcp/127.0.0.2:0".to_owned()],
        &[],
        "maze",
        &certificates.of(Role::RobotHost),
        false,
    )?;
    let endpoint = router.endpoints().first().ok_or("it listens nowhere")?.clone();
    assert!(
        connect(&endpoint, &Shows::Certificate(certificates.of(Role::Robot))).is_err(),
        "a name that is not in the certificate"
    );
    drop(other);
    Ok(())
}

/// Validity of a certificate that expires while it is in use [s]; doubled while the machine takes
/// longer to connect.
const SHORT_S: i64 = 4;
/// How often this is tried.
const SHORTS: i64 = 6;

#[test]
fn a_router_ends_a_link_when_the_certificate_of_its_client_expires() -> Outcome {
    let certificates = Certificates::new()?;
    let router = Router::guarded(
        &["tcp/127.0.0.1:0".to_owned()],
        &[],
        GRAPH,
        &certificates.of(Role::RobotHost),
        false,
    )?;
    let endpoint = router.endpoints().first().ok_or("it listens nowhere")?.clone();
    let is_connected = |session: &Session| session.info().routers_zid().wait().next().is_some();
    for round in 0..SHORTS {
        let short = certificates.issue(
            "authority",
            &format!("short-{round}"),
            ROBOT,
            (-HOUR_S, SHORT_S << round),
        )?;
        let client = Shows::Certificate(of(&short, Role::Robot));
        let Some(session) = connect(&endpoint, &client).ok().filter(is_connected) else { continue };
        let stays = connect(&endpoint, &Shows::Certificate(certificates.of(Role::Robot)))?;
        wait_until("the end of the link", || !is_connected(&session))?;
        // The last second of a certificate is part of its validity: a peer that connects in it may
        // get a session, which is closed at once.
        if let Ok(late) = connect(&endpoint, &client) {
            wait_until("the end of a link that was made too late", || !is_connected(&late))?;
        }
        thread::sleep(Duration::from_millis(1_100));
        assert!(connect(&endpoint, &client).is_err(), "it is taken up again");
        assert!(is_connected(&stays), "another one's certificate is still valid");
        return Ok(());
    }
    Err("it never connected in time".into())
}

/// Opens a port as our processes do.
fn join(links: &Links) -> Result<(Ports, Source<PlantState>), OpenError> {
    let ports = Ports::open(links, Identity::new(1))?;
    let source = ports.source(Since::First)?;
    Ok((ports, source))
}

#[test]
fn a_client_ends_a_link_when_the_certificate_of_its_router_expires() -> Outcome {
    /// Each tries once or twice: a client whose link has ended searches for a router for a second.
    const AT_ONCE: usize = 24;
    let certificates = Certificates::new()?;
    for round in 0..SHORTS {
        let short = certificates.issue(
            "authority",
            &format!("short-{round}"),
            ROBOT,
            (-HOUR_S, SHORT_S << round),
        )?;
        let host = of(&short, Role::RobotHost);
        let end = UNIX_EPOCH + Duration::from_secs(host.read()?.until_s.try_into()?);
        let ended = || SystemTime::now().duration_since(end).ok();
        // This router keeps its links whatever happens: the clients must end them.
        let (router, endpoint) = router(
            &Shows::Certificate(host),
            &[("transport/link/tls/close_link_on_expiration", json!(false))],
        )?;
        let links = Links {
            carriers: Carriers::all(Carrier::Network),
            connect: vec![endpoint],
            credentials: Some(certificates.of(Role::Controller)),
            ..Links::on_this_machine(GRAPH, certificates.folder(), false, 60_000)
        };
        let linked = || {
            router
                .liveliness()
                .get("coxswain-link/**")
                .wait()
                .map_or(true, |tokens| tokens.iter().next().is_some())
        };
        let Ok(_early) = join(&links) else { continue };
        wait_until("the first link", || linked() || ended().is_some())?;
        if ended().is_some() {
            continue;
        }
        let tried = AtomicUsize::new(0);
        let all_known = Barrier::new(AT_ONCE + 1);
        thread::scope(|scope| {
            for _ in 0..AT_ONCE {
                scope.spawn(|| {
                    let mut joined = Vec::new();
                    // The last second of a certificate is part of its validity: a peer that
                    // connects in it may get a session.
                    while ended().is_none_or(|since| since < Duration::from_secs(1)) {
                        if ended().is_some() {
                            tried.fetch_add(1, Ordering::Relaxed);
                            // Most find at once that their link has ended.
                            joined.extend(join(&links));
                        } else {
                            thread::sleep(Duration::from_millis(1));
                        }
                    }
                    all_known.wait();
                    // They stay until their state has been checked.
                    all_known.wait();
                });
            }
            all_known.wait();
            let over = wait_until("the end of all links", || !linked());
            all_known.wait();
            over
        })?;
        let tried = tried.into_inner();
        print(format_args!(
            "tries to connect in the last second of a router's certificate: {tried}; no link has \
            outlasted it"
        ));
        assert!(join(&links).is_err(), "it is taken up again");
        if tried > 0 {
            return Ok(());
        }
    }
    Err("nobody ever connected in time".into())
}
