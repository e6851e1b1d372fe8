//! Every peer at the gateway's telemetry × every key × every operation of a zenoh client: watchers
//! receive, and nothing else passes.

use super::session::{
    Certificates, Failure, HOSTS, ROBOT, Shows, connect, failed, host, print, router, strangers,
};
use access::{Credentials, Role, of_telemetry};
use bytemuck::Zeroable;
use network::telemetry::{Publisher, TelemetrySettings, Watcher};
use promises::{Outcome, wait_until};
use protocol::VERSION;
use protocol::message::{Message, PlantState};
use protocol::topic::{TOPIC_COUNT, Topic};
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};
use zenoh::query::{ConsolidationMode, Query, QueryTarget, Reply};
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Session, Wait};

/// Time for a message or an answer to arrive, after the permitted ones have arrived.
const GRACE: Duration = Duration::from_secs(1);
/// Least number of rounds in which every peer tries every operation.
const ROUNDS: usize = 3;
/// Time for permitted messages to arrive. Far longer than it takes on any machine.
const GIVES_UP_AFTER: Duration = Duration::from_secs(90);

/// An operation tried on one key.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Deed {
    /// Publish a value.
    Put,
    /// Delete a published value.
    Delete,
    /// Subscribe.
    Receive,
    /// Query.
    Ask,
    /// Declare a queryable.
    BeAsked,
    /// Reply to a query.
    Answer,
    /// Declare a liveliness token.
    Show,
    /// Query the liveliness tokens.
    Look,
    /// Subscribe to liveliness tokens.
    Watch,
}

impl Deed {
    const ALL: [Self; 9] = [
        Self::Put,
        Self::Delete,
        Self::Receive,
        Self::Ask,
        Self::BeAsked,
        Self::Answer,
        Self::Show,
        Self::Look,
        Self::Watch,
    ];
}

/// Peer, operation and key.
type Cell = (String, Deed, String);

/// The operations that took effect.
#[derive(Debug, Clone, Default)]
struct Book(Arc<Mutex<BTreeSet<Cell>>>);

impl Book {
    fn write(&self, name: &str, deed: Deed, key: &str) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).insert((
            name.to_owned(),
            deed,
            key.to_owned(),
        ));
    }

    fn read(&self) -> BTreeSet<Cell> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// A peer that tries everything, by name: one session in which it publishes, and one in which it
/// subscribes.
#[derive(Clone)]
struct Try {
    name: String,
    sends: Session,
    receives: Session,
}

/// The peers that get a session, among all roles and unauthenticated peers; `open` connects each of
/// them.
fn tries(
    certificates: &Certificates,
    open: &dyn Fn(&Shows) -> Result<Session, Failure>,
) -> Result<Vec<Try>, Failure> {
    let roles = HOSTS.map(host).into_iter().chain([Role::Driver, Role::Watcher]);
    let mut peers: Vec<(String, Shows)> =
        roles.map(|role| (role.to_string(), Shows::Certificate(certificates.of(&role)))).collect();
    let strangers = strangers(certificates, "control")?;
    peers.extend(strangers.into_iter().map(|(name, shows)| (name.to_owned(), shows)));
    let mut tries = Vec::new();
    for (name, shows) in peers {
        if let Ok(sends) = open(&shows) {
            tries.push(Try { name, sends, receives: open(&shows)? });
        }
    }
    Ok(tries)
}

/// Keys of the telemetry.
fn keys() -> Vec<String> {
    Topic::ALL
        .into_iter()
        .flat_map(|topic| {
            ["", "/json"].map(|kind| format!("coxswain/{ROBOT}/{}{kind}", topic.name()))
        })
        .collect()
}

/// The peer named in an attachment or an answer.
fn named(attachment: Option<&zenoh::bytes::ZBytes>) -> Option<String> {
    attachment.and_then(|attachment| Some(attachment.try_to_string().ok()?.into_owned()))
}

/// Declarations of an authorised peer or of an attacker. They end when they are dropped.
type Declared = Vec<Box<dyn std::any::Any>>;

/// An authorised session that receives whatever passes, and answers and queries on `key`.
fn witness(own: &Session, key: &str, tries: &[Try], book: &Book) -> Result<Declared, Failure> {
    let names: Vec<String> = tries.iter().map(|one| one.name.clone()).collect();
    let (received, asked, seen) = (book.clone(), book.clone(), book.clone());
    let receive = move |sample: Sample| {
        let deed = if sample.kind() == SampleKind::Put { Deed::Put } else { Deed::Delete };
        if let Some(name) = named(sample.attachment()) {
            received.write(&name, deed, sample.key_expr().as_str());
        }
    };
    let answer = move |query: Query| {
        // A query names its sender; the authorised session queries itself too.
        if !query.parameters().is_empty() {
            asked.write(
                &query.parameters().as_str().replace('_', " "),
                Deed::Ask,
                query.key_expr().as_str(),
            );
        }
    };
    let see = move |sample: Sample| {
        let (key, id) = sample.key_expr().as_str().rsplit_once('/').unwrap_or_default();
        // The tokens of authorised sessions have no number.
        if let Some(name) = id.parse::<usize>().ok().and_then(|number| names.get(number)) {
            seen.write(name, Deed::Show, key);
        }
    };
    Ok(vec![
        Box::new(own.declare_subscriber(key).callback(receive).wait().map_err(failed)?),
        Box::new(own.declare_queryable(key).callback(answer).wait().map_err(failed)?),
        Box::new(own.liveliness().declare_token(format!("{key}/honest")).wait().map_err(failed)?),
        Box::new(
            own.liveliness()
                .declare_subscriber(format!("{key}/*"))
                .history(true)
                .callback(see)
                .wait()
                .map_err(failed)?,
        ),
    ])
}

/// Declarations of an attacker on `key`.
fn trial(number: usize, one: &Try, key: &str, book: &Book) -> Result<Declared, Failure> {
    let note = |deed| {
        let (book, name, key) = (book.clone(), one.name.clone(), key.to_owned());
        move || book.write(&name, deed, &key)
    };
    let (receive, be_asked, watch) = (note(Deed::Receive), note(Deed::BeAsked), note(Deed::Watch));
    let (answer, name) = (key.to_owned(), one.name.clone());
    let asked = move |query: Query| {
        // Queries of other attackers name their sender.
        if query.parameters().is_empty() {
            be_asked();
            let _ = query.reply(&answer, name.clone()).wait();
        }
    };
    let honest = format!("{key}/honest");
    Ok(vec![
        Box::new(
            one.receives
                .declare_subscriber(key)
                .callback(move |_| receive())
                .wait()
                .map_err(failed)?,
        ),
        Box::new(one.receives.declare_queryable(key).callback(asked).wait().map_err(failed)?),
        Box::new(
            one.sends
                .liveliness()
                .declare_token(format!("{key}/{number}"))
                .wait()
                .map_err(failed)?,
        ),
        Box::new(
            one.receives
                .liveliness()
                .declare_subscriber(honest)
                .history(true)
                .callback(move |_| watch())
                .wait()
                .map_err(failed)?,
        ),
    ])
}

/// Publications and queries of every peer on `key`, once.
fn round(own: &Session, key: &str, tries: &[Try], book: &Book) -> Result<(), Failure> {
    for Try { name, sends, receives } in tries {
        sends.put(key, "forged").attachment(name).wait().map_err(failed)?;
        sends.delete(key).attachment(name).wait().map_err(failed)?;
        let question = sends
            .get(format!("{key}?{}", name.replace(' ', "_")))
            .target(QueryTarget::All)
            .timeout(GRACE);
        question.callback(drop).wait().map_err(failed)?;
        let (book, name, known) = (book.clone(), name.clone(), key.to_owned());
        let see = move |reply: Reply| {
            if reply.result().is_ok() {
                book.write(&name, Deed::Look, &known);
            }
        };
        receives
            .liveliness()
            .get(format!("{key}/honest"))
            .timeout(GRACE)
            .callback(see)
            .wait()
            .map_err(failed)?;
    }
    let (book, known) = (book.clone(), key.to_owned());
    let receive = move |reply: Reply| {
        if let Some(name) = reply.result().ok().and_then(|sample| named(Some(sample.payload()))) {
            book.write(&name, Deed::Answer, &known);
        }
    };
    let question =
        own.get(key).target(QueryTarget::All).consolidation(ConsolidationMode::None).timeout(GRACE);
    question.callback(receive).wait().map_err(failed)
}

/// The operations of all peers that took effect, at `own` and at the peers themselves, while the
/// gateway `shows` the robot. Ends when all of `expected` has arrived, but not before everything
/// has been tried several times.
fn tried(
    own: &Session,
    shows: &mut dyn FnMut() -> Result<(), Failure>,
    tries: &[Try],
    expected: &BTreeSet<Cell>,
) -> Result<BTreeSet<Cell>, Failure> {
    let book = Book::default();
    let mut declared = Vec::new();
    for key in keys() {
        declared.extend(witness(own, &key, tries, &book)?);
        for (number, one) in tries.iter().enumerate() {
            declared.extend(trial(number, one, &key, &book)?);
        }
    }
    let begin = Instant::now();
    for number in 0.. {
        if number >= ROUNDS
            && (expected.is_subset(&book.read()) || begin.elapsed() > GIVES_UP_AFTER)
        {
            break;
        }
        keys().iter().try_for_each(|key| round(own, key, tries, &book))?;
        shows()?;
        thread::sleep(GRACE / 2);
    }
    // Messages that are still on their way.
    thread::sleep(GRACE);
    drop(declared);
    Ok(book.read())
}

fn watchers_receive(keys: impl IntoIterator<Item = String>) -> BTreeSet<Cell> {
    keys.into_iter().map(|key| (Role::Watcher.to_string(), Deed::Receive, key)).collect()
}

/// Publishes a value on every key.
fn on_all_keys(own: &Session) -> Result<(), Failure> {
    keys().into_iter().try_for_each(|key| own.put(key, "honest").wait().map_err(failed))
}

fn gateway(certificates: &Certificates) -> Result<(Publisher, String), Failure> {
    let settings = TelemetrySettings {
        listen: vec!["tcp/127.0.0.1:0".into()],
        robot: ROBOT.into(),
        credentials: Some(certificates.of(&host("robot"))),
    };
    let publisher = Publisher::open(&settings, 100_000_000)?;
    let endpoint = publisher.endpoints().first().ok_or("it listens nowhere")?.clone();
    Ok((publisher, endpoint))
}

fn state() -> PlantState {
    let mut state: PlantState = Zeroable::zeroed();
    (state.stamp.version, state.stamp.kind) = (VERSION, PlantState::KIND);
    state
}

/// From the view of another watcher.
#[test]
fn at_the_gateway_watchers_receive_and_no_peer_publishes() -> Outcome {
    let certificates = Certificates::new()?;
    let (mut publisher, endpoint) = gateway(&certificates)?;
    let tries = tries(&certificates, &|shows| connect(&endpoint, shows))?;
    let watcher = connect(&endpoint, &Shows::Certificate(certificates.of(&Role::Watcher)))?;
    let expected =
        watchers_receive(["", "/json"].map(|kind| format!("coxswain/{ROBOT}/state{kind}")));
    let arrived = tried(&watcher, &mut || Ok(publisher.publish(&state())?), &tries, &expected)?;
    let cells = tries.len() * keys().len() * Deed::ALL.len();
    print(format_args!(
        "telemetry, at watchers: {cells} cells, {} allowed, {} arrived",
        expected.len(),
        arrived.len()
    ));
    assert_eq!(arrived, expected);
    assert_eq!(tries.len(), 6, "of the strangers one is of the same authority, and may nothing");
    Ok(())
}

/// From the view of the gateway, which sends no query and subscribes to nothing: a session in its
/// place, with its access control, does both.
#[test]
fn only_subscriptions_of_watchers_reach_the_gateway() -> Outcome {
    let certificates = Certificates::new()?;
    let control = [("access_control", of_telemetry(ROBOT))];
    let (own, endpoint) = router(&Shows::Certificate(certificates.of(&host("robot"))), &control)?;
    let tries = tries(&certificates, &|shows| connect(&endpoint, shows))?;
    let expected = watchers_receive(keys());
    let arrived = tried(&own, &mut || on_all_keys(&own), &tries, &expected)?;
    let cells = tries.len() * keys().len() * Deed::ALL.len();
    print(format_args!(
        "telemetry, at the gateway: {cells} cells, {} allowed, {} arrived",
        expected.len(),
        arrived.len()
    ));
    assert_eq!(arrived, expected);
    Ok(())
}

/// Otherwise the two tests above would pass with any access control.
#[test]
fn without_access_control_every_operation_at_a_gateway_takes_effect() -> Outcome {
    let certificates = Certificates::new()?;
    let (own, endpoint) = router(&Shows::Nothing, &[])?;
    let tries = tries(&certificates, &|_| connect(&endpoint, &Shows::Nothing))?;
    let cells = |one: &Try| {
        let name = one.name.clone();
        keys()
            .into_iter()
            .flat_map(move |key| Deed::ALL.map(|deed| (name.clone(), deed, key.clone())))
            .collect::<Vec<Cell>>()
    };
    let all: BTreeSet<Cell> = tries.iter().flat_map(cells).collect();
    let arrived = tried(&own, &mut || on_all_keys(&own), &tries, &all)?;
    let missing: Vec<&Cell> = all.difference(&arrived).collect();
    assert!(missing.is_empty(), "not seen: {missing:?}");
    assert_eq!(all.len(), (5 + 6) * 18 * TOPIC_COUNT);
    Ok(())
}

#[test]
fn a_watcher_sees_the_robot_with_its_certificate_and_not_without() -> Outcome {
    let certificates = Certificates::new()?;
    let (mut publisher, endpoint) = gateway(&certificates)?;
    let watch =
        |credentials: Option<Credentials>| Watcher::open_as(&endpoint, None, credentials.as_ref());
    assert!(watch(None).is_err());
    let mut watcher = watch(Some(certificates.of(&Role::Watcher)))?;
    wait_until("a state", || {
        publisher.publish(&state()).is_ok()
            && watcher.next(Duration::from_millis(50)).is_ok_and(|word| word.is_some())
    })
}
