//! Everybody at the gateway's telemetry × every key × everything that zenoh lets a client do: watchers hear, and nothing else passes.

use crate::session::{Certificates, Failure, ROBOT, Shows, connect, failed, print, router};
use crate::strangers::strangers;
use bytemuck::Zeroable;
use promises::{Outcome, wait_until};
use protocol::VERSION;
use protocol::access::{Credentials, Role, of_telemetry};
use protocol::message::{Message, PlantState};
use protocol::telemetry::{Publisher, TelemetrySettings, Watcher};
use protocol::topic::Topic;
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};
use zenoh::query::{ConsolidationMode, Query, QueryTarget, Reply};
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Session, Wait};

/// What is said is given so long to arrive, after what may arrive has; and an answer.
const GRACE: Duration = Duration::from_secs(1);
/// How often everybody tries everything, at least.
const ROUNDS: usize = 3;
/// How long what may arrive has to arrive. Far longer than it takes on any machine.
const GIVES_UP_AFTER: Duration = Duration::from_secs(90);

/// What is tried on one key.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Deed {
    /// Say something.
    Put,
    /// Delete what was said.
    Delete,
    /// Hear what is said.
    Hear,
    /// Ask.
    Ask,
    /// Be asked.
    BeAsked,
    /// Answer.
    Answer,
    /// Count as somebody who is there.
    Show,
    /// See who is there.
    Look,
    /// See who comes.
    Watch,
}

impl Deed {
    const ALL: [Self; 9] = [
        Self::Put,
        Self::Delete,
        Self::Hear,
        Self::Ask,
        Self::BeAsked,
        Self::Answer,
        Self::Show,
        Self::Look,
        Self::Watch,
    ];
}

/// Who did what to which key.
type Cell = (String, Deed, String);

/// What has arrived.
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

/// One who tries everything, by name: a session in which it says, and one in which it hears.
#[derive(Clone)]
struct Try {
    name: String,
    says: Session,
    hears: Session,
}

/// Those who get a session of all roles and strangers, each of whom `open`s one.
fn tries(
    certificates: &Certificates,
    open: &dyn Fn(&Shows) -> Result<Session, Failure>,
) -> Result<Vec<Try>, Failure> {
    let roles = Role::ALL.map(|role| (role.name(), Shows::Certificate(certificates.of(role))));
    let mut tries = Vec::new();
    for (name, shows) in roles.into_iter().chain(strangers(certificates)?) {
        if let Ok(says) = open(&shows) {
            tries.push(Try { name: name.to_owned(), says, hears: open(&shows)? });
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

/// Who is named in an attachment or an answer.
fn named(said: Option<&zenoh::bytes::ZBytes>) -> Option<String> {
    said.and_then(|said| Some(said.try_to_string().ok()?.into_owned()))
}

/// What an honest one has declared, and those who try. It ends when it is dropped.
type Declared = Vec<Box<dyn std::any::Any>>;

/// An honest session that hears and sees whatever passes, and answers and asks on `key`.
fn witness(own: &Session, key: &str, tries: &[Try], book: &Book) -> Result<Declared, Failure> {
    let names: Vec<String> = tries.iter().map(|one| one.name.clone()).collect();
    let (heard, asked, seen) = (book.clone(), book.clone(), book.clone());
    let hear = move |sample: Sample| {
        let deed = if sample.kind() == SampleKind::Put { Deed::Put } else { Deed::Delete };
        if let Some(name) = named(sample.attachment()) {
            heard.write(&name, deed, sample.key_expr().as_str());
        }
    };
    let answer = move |query: Query| {
        // Who asks says who he is; the honest one asks itself too.
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
        // The tokens of the honest ones have no number.
        if let Some(name) = id.parse::<usize>().ok().and_then(|number| names.get(number)) {
            seen.write(name, Deed::Show, key);
        }
    };
    Ok(vec![
        Box::new(own.declare_subscriber(key).callback(hear).wait().map_err(failed)?),
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

/// What one who tries declares on `key`.
fn trial(number: usize, one: &Try, key: &str, book: &Book) -> Result<Declared, Failure> {
    let note = |deed| {
        let (book, name, key) = (book.clone(), one.name.clone(), key.to_owned());
        move || book.write(&name, deed, &key)
    };
    let (hear, be_asked, watch) = (note(Deed::Hear), note(Deed::BeAsked), note(Deed::Watch));
    let (answer, name) = (key.to_owned(), one.name.clone());
    let asked = move |query: Query| {
        // Others who try say who asks.
        if query.parameters().is_empty() {
            be_asked();
            let _ = query.reply(&answer, name.clone()).wait();
        }
    };
    let honest = format!("{key}/honest");
    Ok(vec![
        Box::new(
            one.hears.declare_subscriber(key).callback(move |_| hear()).wait().map_err(failed)?,
        ),
        Box::new(one.hears.declare_queryable(key).callback(asked).wait().map_err(failed)?),
        Box::new(
            one.says
                .liveliness()
                .declare_token(format!("{key}/{number}"))
                .wait()
                .map_err(failed)?,
        ),
        Box::new(
            one.hears
                .liveliness()
                .declare_subscriber(honest)
                .history(true)
                .callback(move |_| watch())
                .wait()
                .map_err(failed)?,
        ),
    ])
}

/// What everybody says and asks on `key`, once.
fn round(own: &Session, key: &str, tries: &[Try], book: &Book) -> Result<(), Failure> {
    for Try { name, says, hears } in tries {
        says.put(key, "forged").attachment(name).wait().map_err(failed)?;
        says.delete(key).attachment(name).wait().map_err(failed)?;
        let question = says
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
        hears
            .liveliness()
            .get(format!("{key}/honest"))
            .timeout(GRACE)
            .callback(see)
            .wait()
            .map_err(failed)?;
    }
    let (book, known) = (book.clone(), key.to_owned());
    let hear = move |reply: Reply| {
        if let Some(name) = reply.result().ok().and_then(|sample| named(Some(sample.payload()))) {
            book.write(&name, Deed::Answer, &known);
        }
    };
    let question =
        own.get(key).target(QueryTarget::All).consolidation(ConsolidationMode::None).timeout(GRACE);
    question.callback(hear).wait().map_err(failed)
}

/// What arrives of what everybody tries, at `own` and at themselves, while the gateway `shows` the robot. Ends when all of `expected` has arrived, but
/// not before everything has been tried several times.
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
    // What is still under way.
    thread::sleep(GRACE);
    drop(declared);
    Ok(book.read())
}

fn watchers_hear(keys: impl IntoIterator<Item = String>) -> BTreeSet<Cell> {
    keys.into_iter().map(|key| (Role::Watcher.name().to_owned(), Deed::Hear, key)).collect()
}

/// Says something on every key.
fn on_all_keys(own: &Session) -> Result<(), Failure> {
    keys().into_iter().try_for_each(|key| own.put(key, "honest").wait().map_err(failed))
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

fn state() -> PlantState {
    let mut state: PlantState = Zeroable::zeroed();
    (state.stamp.version, state.stamp.kind) = (VERSION, PlantState::KIND);
    state
}

/// As another watcher finds.
#[test]
fn at_the_gateway_watchers_hear_and_nobody_says_anything() -> Outcome {
    let certificates = Certificates::new()?;
    let (mut publisher, endpoint) = gateway(&certificates)?;
    let tries = tries(&certificates, &|shows| connect(&endpoint, shows))?;
    let watcher = connect(&endpoint, &Shows::Certificate(certificates.of(Role::Watcher)))?;
    let expected = watchers_hear(["", "/json"].map(|kind| format!("coxswain/{ROBOT}/state{kind}")));
    let arrived = tried(&watcher, &mut || Ok(publisher.publish(&state())?), &tries, &expected)?;
    let cells = tries.len() * keys().len() * Deed::ALL.len();
    print(format_args!(
        "telemetry, at watchers: {cells} cells, {} allowed, {} arrived",
        expected.len(),
        arrived.len()
    ));
    assert_eq!(arrived, expected);
    assert_eq!(tries.len(), 9, "of the strangers one is of the same authority, and may nothing");
    Ok(())
}

/// As the gateway itself would find, which asks nobody and listens to nobody: its access control, and a session in its place that does.
#[test]
fn nothing_but_who_watches_reaches_the_gateway() -> Outcome {
    let certificates = Certificates::new()?;
    let control = [("access_control", of_telemetry(ROBOT))];
    let (own, endpoint) = router(&Shows::Certificate(certificates.of(Role::Gateway)), &control)?;
    let tries = tries(&certificates, &|shows| connect(&endpoint, shows))?;
    let expected = watchers_hear(keys());
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

/// Else the two above would hold whatever the access control did.
#[test]
fn without_access_control_everything_that_is_tried_at_a_gateway_arrives() -> Outcome {
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
    assert_eq!(all.len(), (8 + 6) * 16 * 9);
    Ok(())
}

#[test]
fn a_watcher_sees_the_robot_with_its_certificate_and_not_without() -> Outcome {
    let certificates = Certificates::new()?;
    let (mut publisher, endpoint) = gateway(&certificates)?;
    let watch =
        |credentials: Option<Credentials>| Watcher::open_as(&endpoint, None, credentials.as_ref());
    assert!(watch(None).is_err());
    let mut watcher = watch(Some(certificates.of(Role::Watcher)))?;
    wait_until("a state", || {
        publisher.publish(&state()).is_ok()
            && watcher.next(Duration::from_millis(50)).is_ok_and(|word| word.is_some())
    })
}
