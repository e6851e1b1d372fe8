//! Strangers at both doors, the router of the links and the gateway's telemetry: what they say is heard by nobody, and they hear nothing.

use crate::session::{Certificates, Failure, HOUR_S, ROBOT, Shows, connect, failed, of, print};
use bytemuck::Zeroable;
use promises::{Outcome, wait_until};
use protocol::VERSION;
use protocol::access::{Credentials, Role};
use protocol::message::{Message, PlantState};
use protocol::port::Router;
use protocol::telemetry::{Publisher, TelemetrySettings};
use protocol::topic::Topic;
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;
use zenoh::sample::Sample;
use zenoh::{Session, Wait};

/// What is said is given so long to arrive, after what may arrive has.
const GRACE: Duration = Duration::from_secs(1);
/// How often a stranger says everything.
const ROUNDS: usize = 3;

/// Everybody who should not get in, by name.
fn strangers(certificates: &Certificates) -> Result<Vec<(&'static str, Shows)>, Failure> {
    let foreign = certificates.issue("another-authority", "foreign", ROBOT, (-HOUR_S, HOUR_S))?;
    let expired = certificates.issue("authority", "expired", ROBOT, (-HOUR_S, -60))?;
    let future = certificates.issue("authority", "future", ROBOT, (HOUR_S, 2 * HOUR_S))?;
    let other = certificates.issue("authority", "other", "roomba", (-HOUR_S, HOUR_S))?;
    // Whoever is foreign believes our authority, else it would not even show what it has.
    let ours = certificates.of(Role::Controller);
    std::fs::copy(ours.file("authority.pem"), of(&foreign, Role::Controller).file("authority.pem"))?;
    Ok(vec![
        ("TCP", Shows::Nothing),
        ("TLS without a certificate", Shows::NoCertificate(ours)),
        ("certificate of a foreign authority", Shows::Certificate(of(&foreign, Role::Controller))),
        ("expired certificate", Shows::Certificate(of(&expired, Role::Controller))),
        ("certificate of the future", Shows::Certificate(of(&future, Role::Controller))),
        ("certificate of another robot", Shows::Certificate(of(&other, Role::Controller))),
    ])
}

/// What is heard, of whomever.
#[derive(Debug, Clone, Default)]
struct Ears(Arc<Mutex<BTreeSet<String>>>);

impl Ears {
    fn listen(&self, session: &Session, key: String) -> Result<zenoh::pubsub::Subscriber<()>, Failure> {
        let ears = self.clone();
        let hear = move |sample: Sample| {
            ears.0.lock().unwrap_or_else(PoisonError::into_inner).insert(format!("{} {}", sample.kind(), sample.key_expr()));
        };
        session.declare_subscriber(key).callback(hear).wait().map_err(failed)
    }

    fn heard(&self) -> BTreeSet<String> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

#[test]
fn no_stranger_says_or_hears_anything_on_a_link() -> Outcome {
    let certificates = Certificates::new()?;
    let router = Router::guarded(&["tcp/127.0.0.1:0".to_owned()], &[], "maze", &certificates.of(Role::RobotHost))?;
    let endpoint = router.endpoints().first().ok_or("it listens nowhere")?.clone();
    let honest = |role| connect(&endpoint, &Shows::Certificate(certificates.of(role)));
    let (robot, controller, learner) = (honest(Role::Robot)?, honest(Role::Controller)?, honest(Role::Learner)?);
    let (recorder, host) = (honest(Role::Recorder)?, honest(Role::ControlHost)?);
    let data = |topic: Topic, id: &str| format!("coxswain-link/maze/{}/data/{id}", topic.name());
    let ears = Ears::default();
    let mut listening = Vec::new();
    for (topic, reader) in [
        (Topic::State, &controller),
        (Topic::Command, &robot),
        (Topic::Residual, &learner),
        (Topic::Snapshot, &controller),
        (Topic::Plan, &recorder),
        (Topic::Health, &recorder),
        (Topic::Truth, &recorder),
        (Topic::Credit, &robot),
    ] {
        listening.push(ears.listen(reader, data(topic, "*"))?);
    }
    let mut let_in = Vec::new();
    for (name, shows) in strangers(&certificates)? {
        // Some are told at once, some only find that nothing comes of what they do.
        if let Ok(session) = connect(&endpoint, &shows) {
            // In another session, since in its own one hears oneself.
            let (stolen, listener) = (Ears::default(), connect(&endpoint, &shows)?);
            let heard = Topic::ALL.into_iter().map(|topic| stolen.listen(&listener, data(topic, "*"))).collect::<Result<Vec<_>, _>>()?;
            let_in.push((name, session, stolen, (listener, heard)));
        }
    }
    for _ in 0..ROUNDS {
        for topic in Topic::ALL {
            for (number, (_, session, ..)) in let_in.iter().enumerate() {
                let key = data(topic, &format!("stranger-{number}"));
                session.put(&key, "x").wait().map_err(failed)?;
                session.delete(&key).wait().map_err(failed)?;
                let token = format!("coxswain-link/maze/{}/writer/{VERSION}/{}/newest-wins/x", topic.name(), topic.message());
                drop(session.liveliness().declare_token(token).wait().map_err(failed)?);
            }
        }
        robot.put(data(Topic::State, "honest"), "x").wait().map_err(failed)?;
        controller.put(data(Topic::Command, "honest"), "x").wait().map_err(failed)?;
        host.put(data(Topic::Snapshot, "honest"), "x").wait().map_err(failed)?;
        thread::sleep(GRACE / 4);
    }
    wait_until("what honest ones say", || ears.heard().len() >= 3)?;
    thread::sleep(GRACE);
    let expected: BTreeSet<String> =
        [Topic::State, Topic::Command, Topic::Snapshot].map(|topic| format!("PUT {}", data(topic, "honest"))).into_iter().collect();
    assert_eq!(ears.heard(), expected);
    for (name, _, stolen, _) in &let_in {
        assert_eq!(stolen.heard(), BTreeSet::new(), "{name}");
    }
    let names: Vec<&str> = let_in.iter().map(|(name, ..)| *name).collect();
    print(format_args!("strangers at the links: {} cells, 0 allowed, 0 arrived; a session, in which nothing passes: {names:?}", 6 * 8 * 4));
    assert!(names.iter().all(|name| *name == "certificate of another robot"), "{names:?}");
    Ok(())
}

#[test]
fn a_client_believes_no_router_that_is_none() -> Outcome {
    let certificates = Certificates::new()?;
    let other = certificates.issue("authority", "other", "roomba", (-HOUR_S, HOUR_S))?;
    // As who has stolen a certificate with which one only connects, and waits for others to connect to it.
    for role in [Role::Watcher, Role::Controller, Role::Robot] {
        let router = Router::guarded(&["tcp/127.0.0.1:0".to_owned()], &[], "maze", &certificates.of(role))?;
        let endpoint = router.endpoints().first().ok_or("it listens nowhere")?.clone();
        assert!(connect(&endpoint, &Shows::Certificate(certificates.of(Role::Robot))).is_err(), "{}", role.name());
    }
    // A certificate for this address is not one for another.
    let router = Router::guarded(&["tcp/127.0.0.2:0".to_owned()], &[], "maze", &certificates.of(Role::RobotHost))?;
    let endpoint = router.endpoints().first().ok_or("it listens nowhere")?.clone();
    assert!(connect(&endpoint, &Shows::Certificate(certificates.of(Role::Robot))).is_err(), "a name that is not in the certificate");
    drop(other);
    Ok(())
}

/// One who tries, by name, and the sessions in which it says and hears something.
type Try = (String, Session, Session);

/// What each role tries at the gateway: whether it is heard there, or hears.
fn at_the_gateway(publisher: &mut Publisher, tries: &[Try], witness: &Session) -> Result<BTreeSet<String>, Failure> {
    let book = Arc::new(Mutex::new(BTreeSet::new()));
    let note = |what: String| {
        let book = Arc::clone(&book);
        move || {
            book.lock().unwrap_or_else(PoisonError::into_inner).insert(what.clone());
        }
    };
    let mut declared = Vec::new();
    let mut rest = Vec::new();
    let keys: Vec<String> =
        Topic::ALL.into_iter().flat_map(|topic| ["", "/json"].map(|kind| format!("coxswain/{ROBOT}/{}{kind}", topic.name()))).collect();
    for key in &keys {
        let book = Arc::clone(&book);
        let key = key.clone();
        let hear = move |sample: Sample| {
            let said = sample.payload().try_to_string().map(std::borrow::Cow::into_owned).unwrap_or_default();
            if said.starts_with("forged") {
                book.lock().unwrap_or_else(PoisonError::into_inner).insert(format!("{said} put {}", sample.key_expr()));
            }
        };
        declared.push(witness.declare_subscriber(&key).callback(hear).wait().map_err(failed)?);
        for (name, _, session) in tries {
            let heard = note(format!("{name} hear {key}"));
            declared.push(session.declare_subscriber(&key).callback(move |_| heard()).wait().map_err(failed)?);
            let asked = note(format!("{name} be asked {key}"));
            rest.push(session.declare_queryable(&key).callback(move |_| asked()).wait().map_err(failed)?);
        }
    }
    let mut state: PlantState = Zeroable::zeroed();
    (state.stamp.version, state.stamp.kind) = (VERSION, PlantState::KIND);
    for _ in 0..ROUNDS {
        for key in &keys {
            for (name, session, _) in tries {
                session.put(key, format!("forged by {name}")).wait().map_err(failed)?;
                session.delete(key).wait().map_err(failed)?;
            }
            witness.get(key).timeout(GRACE).callback(drop).wait().map_err(failed)?;
        }
        publisher.publish(&state)?;
        thread::sleep(GRACE / 2);
    }
    thread::sleep(GRACE);
    drop((declared, rest));
    let book = book.lock().unwrap_or_else(PoisonError::into_inner).clone();
    Ok(book)
}

fn gateway(certificates: &Certificates) -> Result<(Publisher, String), Failure> {
    let settings = TelemetrySettings {
        listen: vec!["tcp/127.0.0.1:0".into()],
        robot: ROBOT.into(),
        credentials: Some(certificates.of(Role::Gateway)),
    };
    let publisher = Publisher::open(&settings, 100_000_000)?;
    let endpoint = publisher.endpoints().first().ok_or("it listens nowhere")?.clone();
    Ok((publisher, endpoint))
}

#[test]
fn at_the_gateway_watchers_hear_and_nobody_says_anything() -> Outcome {
    let certificates = Certificates::new()?;
    let (mut publisher, endpoint) = gateway(&certificates)?;
    let mut tries = Vec::new();
    for role in Role::ALL {
        let open = || connect(&endpoint, &Shows::Certificate(certificates.of(role)));
        tries.push((role.name().to_owned(), open()?, open()?));
    }
    for (name, shows) in strangers(&certificates)? {
        if let Ok(session) = connect(&endpoint, &shows) {
            tries.push((name.to_owned(), session, connect(&endpoint, &shows)?));
        }
    }
    let let_in = tries.len();
    let witness = connect(&endpoint, &Shows::Certificate(certificates.of(Role::Watcher)))?;
    let heard = at_the_gateway(&mut publisher, &tries, &witness)?;
    let expected: BTreeSet<String> = ["", "/json"].map(|kind| format!("watcher hear coxswain/{ROBOT}/state{kind}")).into_iter().collect();
    print(format_args!("telemetry: {} cells, {} allowed, {} arrived", let_in * 16 * 4, 2, heard.len()));
    assert_eq!(heard, expected);
    assert_eq!(let_in, 9, "of the strangers one is of the same authority, and may nothing");
    Ok(())
}

#[test]
fn a_watcher_sees_the_robot_with_its_certificate_and_not_without() -> Outcome {
    use protocol::telemetry::Watcher;
    let certificates = Certificates::new()?;
    let (mut publisher, endpoint) = gateway(&certificates)?;
    let mut state: PlantState = Zeroable::zeroed();
    (state.stamp.version, state.stamp.kind) = (VERSION, PlantState::KIND);
    let watch = |credentials: Option<Credentials>| Watcher::open_as(&endpoint, None, credentials.as_ref());
    assert!(watch(None).is_err());
    let mut watcher = watch(Some(certificates.of(Role::Watcher)))?;
    wait_until("a state", || publisher.publish(&state).is_ok() && watcher.next(Duration::from_millis(50)).is_ok_and(|word| word.is_some()))
}

#[test]
fn a_link_ends_when_the_certificate_of_either_end_does() -> Outcome {
    /// How long a certificate is valid that ends while it is in use [s]; doubled while the machine takes longer to connect.
    const SHORT_S: i64 = 4;
    let certificates = Certificates::new()?;
    let long = certificates.of(Role::Robot);
    let is_connected = |session: &Session| session.info().routers_zid().wait().next().is_some();
    let mut ended = 0;
    for server_is_short in [false, true] {
        for round in 0..6 {
            let short = certificates.issue("authority", &format!("short-{server_is_short}-{round}"), ROBOT, (-HOUR_S, SHORT_S << round))?;
            let host = if server_is_short { of(&short, Role::RobotHost) } else { certificates.of(Role::RobotHost) };
            let router = Router::guarded(&["tcp/127.0.0.1:0".to_owned()], &[], "maze", &host)?;
            let endpoint = router.endpoints().first().ok_or("it listens nowhere")?.clone();
            let client = Shows::Certificate(if server_is_short { long.clone() } else { of(&short, Role::Robot) });
            let connected = connect(&endpoint, &client).ok().filter(is_connected);
            let Some(session) = connected else { continue };
            let stays = (!server_is_short).then(|| connect(&endpoint, &Shows::Certificate(long.clone()))).transpose()?;
            wait_until("the end of the link", || !is_connected(&session))?;
            assert!(connect(&endpoint, &client).is_err(), "it is taken up again");
            assert!(stays.as_ref().is_none_or(is_connected), "another one's certificate is still valid");
            ended += 1;
            break;
        }
    }
    assert_eq!(ended, 2, "it never connected in time");
    Ok(())
}
