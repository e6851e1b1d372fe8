//! Every role × every topic × every operation of a zenoh client, each judged where it would arrive.

use crate::session::{Certificates, Failure, Shows, connect, failed, no_flood, print};
use access::Role;
use promises::Outcome;
use protocol::VERSION;
use protocol::topic::Topic;
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};
use transport::Router;
use zenoh::key_expr::KeyExpr;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::query::{QueryTarget, Queryable};
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Session, Wait};

/// Name of the graph on the network.
const GRAPH: &str = "maze";
/// Id of the ports of authorised peers.
const HONEST: &str = "honest";
/// Number of rounds, and the pause between them. A permitted operation gets several chances on a
/// busy machine, and so does a forbidden one.
const ROUNDS: u32 = 5;
const PAUSE: Duration = Duration::from_millis(300);
/// How long a permitted operation may take. Far longer than it does on any machine.
const GIVES_UP_AFTER: Duration = Duration::from_secs(90);

/// An operation tried on one topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Deed {
    /// Publish a message to all readers.
    Put,
    /// Publish it to one reader, as if that reader had joined late.
    PutHistory,
    /// Publish it in the name of another role.
    PutInAnotherName,
    /// Report room to a writer.
    PutRoom,
    /// Delete a message of a writer.
    Delete,
    /// Subscribe to the messages.
    Subscribe,
    /// Subscribe to all keys of the topic.
    SubscribeAll,
    /// Query whether a writer is there.
    Query,
    /// Declare a queryable for that.
    Queryable,
    /// Reply to a query with a value.
    Reply,
    /// Declare the token of a reader.
    ReaderToken,
    /// Declare the token of a writer.
    WriterToken,
    /// Query the tokens.
    TokenQuery,
    /// Subscribe to the tokens of readers.
    TokenSubscriber,
}

impl Deed {
    const ALL: [Self; 14] = [
        Self::Put,
        Self::PutHistory,
        Self::PutInAnotherName,
        Self::PutRoom,
        Self::Delete,
        Self::Subscribe,
        Self::SubscribeAll,
        Self::Query,
        Self::Queryable,
        Self::Reply,
        Self::ReaderToken,
        Self::WriterToken,
        Self::TokenQuery,
        Self::TokenSubscriber,
    ];

    /// Whether `role` may do this on `topic`.
    fn is_allowed(self, role: Role, topic: Topic, lock_step: bool) -> bool {
        let (says, hears) = (role.says().contains(&topic), role.hears().contains(&topic));
        match self {
            Self::Put | Self::WriterToken | Self::Queryable | Self::TokenSubscriber => says,
            Self::PutHistory => says && topic.quality(lock_step).says_again(),
            Self::PutRoom => hears && topic.quality(lock_step).is_paced(),
            Self::ReaderToken | Self::Subscribe => hears,
            Self::Query | Self::TokenQuery => says || hears,
            Self::PutInAnotherName | Self::Delete | Self::SubscribeAll | Self::Reply => false,
        }
    }
}

/// Role, topic and operation.
type Cell = (Role, Topic, Deed);

/// The operations that took effect.
#[derive(Debug, Clone, Default)]
struct Book(Arc<Mutex<BTreeSet<Cell>>>);

impl Book {
    /// Records an operation of the attacker named in the last part of `key`.
    fn note(&self, key: &str, topic: Topic, deed: Deed) {
        let Some((name, role)) = last(key).split_once('.') else { return };
        if let Some(role) = Role::named(role) {
            self.write((
                role,
                topic,
                if name == role.name() { deed } else { Deed::PutInAnotherName },
            ));
        }
    }

    fn write(&self, cell: Cell) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).insert(cell);
    }

    fn read(&self) -> BTreeSet<Cell> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

fn last(key: &str) -> &str {
    key.rsplit('/').next().unwrap_or(key)
}

/// Name of an attacker of `role` that publishes in the name of `name`.
fn named(name: Role, role: Role) -> String {
    format!("{}.{}", name.name(), role.name())
}

/// A role in whose name `role` must not publish on `topic`; if possible, one that may publish
/// there.
fn another(role: Role, topic: Topic) -> Result<Role, Failure> {
    let others =
        Role::ALL.into_iter().filter(|other| *other != role && !role.brings(topic).contains(other));
    Ok(others
        .max_by_key(|other| other.says().contains(&topic))
        .ok_or("it may speak for everybody")?)
}

fn base(topic: Topic) -> String {
    format!("coxswain-link/{GRAPH}/{}", topic.name())
}

fn token(topic: Topic, end: &str, id: &str) -> String {
    format!("{}/{end}/{VERSION}/{}/newest-wins/{id}", base(topic), topic.message())
}

/// Declarations of one session.
#[derive(Default)]
struct Declared {
    subscribers: Vec<Subscriber<()>>,
    queryables: Vec<Queryable<()>>,
    tokens: Vec<LivelinessToken>,
}

impl Declared {
    fn hear(
        &mut self,
        session: &Session,
        key: String,
        callback: impl Fn(Sample) + Send + Sync + 'static,
    ) -> Result<(), Failure> {
        self.subscribers
            .push(session.declare_subscriber(key).callback(callback).wait().map_err(failed)?);
        Ok(())
    }

    fn see(
        &mut self,
        session: &Session,
        key: String,
        callback: impl Fn(Sample) + Send + Sync + 'static,
    ) -> Result<(), Failure> {
        let subscriber =
            session.liveliness().declare_subscriber(key).history(true).callback(callback);
        self.subscribers.push(subscriber.wait().map_err(failed)?);
        Ok(())
    }

    fn show(&mut self, session: &Session, key: String) -> Result<(), Failure> {
        self.tokens.push(session.liveliness().declare_token(key).wait().map_err(failed)?);
        Ok(())
    }
}

/// Both ends of every topic, as authorised peers.
struct Honest {
    /// Writer, with its role, and reader of each topic.
    ends: Vec<(Topic, Role, Session, Session)>,
    declared: Declared,
    book: Book,
}

impl Honest {
    fn begin(
        open: &dyn Fn(Role) -> Result<Session, Failure>,
        book: &Book,
    ) -> Result<Self, Failure> {
        let (robot, controller) = (open(Role::Robot)?, open(Role::Controller)?);
        let (learner, recorder) = (open(Role::Learner)?, open(Role::Recorder)?);
        let of = |topic| match topic {
            Topic::State => (Role::Robot, &robot, &controller),
            Topic::Command => (Role::Controller, &controller, &robot),
            Topic::Residual => (Role::Controller, &controller, &learner),
            Topic::Snapshot => (Role::Learner, &learner, &controller),
            Topic::Plan => (Role::Controller, &controller, &recorder),
            Topic::Health | Topic::Truth => (Role::Robot, &robot, &recorder),
            Topic::Credit => (Role::Recorder, &recorder, &robot),
        };
        let ends = Topic::ALL.map(|topic| {
            let (role, writer, reader) = of(topic);
            (topic, role, writer.clone(), reader.clone())
        });
        let ends = ends.to_vec();
        let mut honest = Self { ends, declared: Declared::default(), book: book.clone() };
        for (topic, _, writer, reader) in honest.ends.clone() {
            honest.listen(topic, &writer, &reader)?;
        }
        Ok(honest)
    }

    fn listen(&mut self, topic: Topic, writer: &Session, reader: &Session) -> Result<(), Failure> {
        let Self { declared, book, .. } = self;
        let to = |deed: Deed| {
            let book = book.clone();
            move |sample: Sample| book.note(sample.key_expr().as_str(), topic, deed)
        };
        let data = book.clone();
        let hear = move |sample: Sample| {
            let deed = if sample.kind() == SampleKind::Put { Deed::Put } else { Deed::Delete };
            data.note(sample.key_expr().as_str(), topic, deed);
        };
        declared.hear(reader, format!("{}/data/*", base(topic)), hear)?;
        declared.hear(
            reader,
            format!("{}/history/{HONEST}/*", base(topic)),
            to(Deed::PutHistory),
        )?;
        declared.hear(writer, format!("{}/room/{HONEST}/*", base(topic)), to(Deed::PutRoom))?;
        declared.see(writer, format!("{}/reader/**", base(topic)), to(Deed::ReaderToken))?;
        let asked = book.clone();
        let join = writer.declare_queryable(format!("{}/join/{HONEST}", base(topic)));
        let join =
            join.callback(move |query| asked.note(query.parameters().as_str(), topic, Deed::Query));
        declared.queryables.push(join.wait().map_err(failed)?);
        declared.show(writer, token(topic, "writer", HONEST))?;
        declared.show(reader, token(topic, "reader", HONEST))
    }

    /// Publications and queries of the authorised peers.
    fn round(&self) -> Result<(), Failure> {
        for (topic, role, writer, reader) in &self.ends {
            writer
                .put(format!("{}/data/{}.{HONEST}", base(*topic), role.name()), "true")
                .wait()
                .map_err(failed)?;
            let question = reader
                .get(format!("{}/join/*", base(*topic)))
                .target(QueryTarget::All)
                .timeout(PAUSE);
            let book = self.book.clone();
            let topic = *topic;
            let hear = move |reply: zenoh::query::Reply| {
                if let Ok(sample) = reply.result() {
                    book.note(sample.key_expr().as_str(), topic, Deed::Reply);
                }
            };
            question.callback(hear).wait().map_err(failed)?;
            let book = self.book.clone();
            let see = move |reply: zenoh::query::Reply| {
                if let Ok(sample) = reply.result()
                    && sample.key_expr().as_str().contains("/writer/")
                {
                    book.note(sample.key_expr().as_str(), topic, Deed::WriterToken);
                }
            };
            reader
                .liveliness()
                .get(format!("{}/**", base(topic)))
                .timeout(PAUSE)
                .callback(see)
                .wait()
                .map_err(failed)?;
        }
        Ok(())
    }
}

/// A peer that tries every operation in one role.
struct Attacker {
    role: Role,
    session: Session,
    /// Apart from the first session: in one session, every matching subscriber receives what one of
    /// them receives.
    wide: Session,
    declared: Declared,
    book: Book,
}

impl Attacker {
    fn begin(
        role: Role,
        open: &dyn Fn(Role) -> Result<Session, Failure>,
        book: &Book,
    ) -> Result<Self, Failure> {
        let (session, wide) = (open(role)?, open(role)?);
        let mut attacker =
            Self { role, session, wide, declared: Declared::default(), book: book.clone() };
        Topic::ALL.into_iter().try_for_each(|topic| attacker.declare(topic))?;
        Ok(attacker)
    }

    fn declare(&mut self, topic: Topic) -> Result<(), Failure> {
        let Self { role, session, wide, declared, book } = self;
        let (role, own) = (*role, named(*role, *role));
        let honest = |deed: Deed| {
            let book = book.clone();
            move |sample: Sample| {
                if last(sample.key_expr().as_str()).ends_with(HONEST) {
                    book.write((role, topic, deed));
                }
            }
        };
        declared.hear(session, format!("{}/data/*", base(topic)), honest(Deed::Subscribe))?;
        declared.hear(wide, format!("{}/**", base(topic)), honest(Deed::SubscribeAll))?;
        declared.see(
            session,
            format!("{}/reader/**", base(topic)),
            honest(Deed::TokenSubscriber),
        )?;
        declared.show(session, token(topic, "reader", &own))?;
        declared.show(session, token(topic, "writer", &own))?;
        let asked = book.clone();
        let key = format!("{}/join/{own}", base(topic));
        let name: KeyExpr<'static> = KeyExpr::try_from(key.clone()).map_err(failed)?;
        let join = session.declare_queryable(key).callback(move |query| {
            // Queries of attackers name their sender.
            if query.parameters().as_str().is_empty() {
                asked.write((role, topic, Deed::Queryable));
                let _ = query.reply(name.clone(), "false").wait();
            }
        });
        declared.queryables.push(join.wait().map_err(failed)?);
        Ok(())
    }

    fn round(&self) -> Result<(), Failure> {
        let (role, own) = (self.role, named(self.role, self.role));
        for topic in Topic::ALL {
            let (base, others) = (base(topic), named(another(role, topic)?, role));
            let ways = [
                format!("data/{own}"),
                format!("data/{others}"),
                format!("history/{HONEST}/{own}"),
                format!("room/{HONEST}/{own}"),
            ];
            for key in ways.map(|way| format!("{base}/{way}")) {
                self.session.put(key, "false").wait().map_err(failed)?;
            }
            self.session.delete(format!("{base}/data/{own}")).wait().map_err(failed)?;
            let ask = self.session.get(format!("{base}/join/{HONEST}?{own}")).timeout(PAUSE);
            ask.callback(drop).wait().map_err(failed)?;
            let book = self.book.clone();
            let see = move |reply: zenoh::query::Reply| {
                if reply.result().is_ok_and(|sample| last(sample.key_expr().as_str()) == HONEST) {
                    book.write((role, topic, Deed::TokenQuery));
                }
            };
            self.session
                .liveliness()
                .get(format!("{base}/**"))
                .timeout(PAUSE)
                .callback(see)
                .wait()
                .map_err(failed)?;
        }
        Ok(())
    }
}

/// All operations that took effect; `open` connects in a role. Ends when all of `expected` has
/// arrived, but not before everything has been tried several times.
fn tried(
    open: &dyn Fn(Role) -> Result<Session, Failure>,
    expected: &BTreeSet<Cell>,
) -> Result<BTreeSet<Cell>, Failure> {
    let book = Book::default();
    let honest = Honest::begin(open, &book)?;
    let attackers = Role::ALL
        .into_iter()
        .map(|role| Attacker::begin(role, open, &book))
        .collect::<Result<Vec<_>, _>>()?;
    let begin = Instant::now();
    for round in 0.. {
        if round >= ROUNDS && (expected.is_subset(&book.read()) || begin.elapsed() > GIVES_UP_AFTER)
        {
            break;
        }
        attackers.iter().try_for_each(Attacker::round)?;
        honest.round()?;
        thread::sleep(PAUSE);
    }
    // Messages that are still on their way.
    thread::sleep(3 * PAUSE);
    Ok(book.read())
}

fn cells() -> impl Iterator<Item = Cell> {
    Role::ALL.into_iter().flat_map(|role| {
        Topic::ALL
            .into_iter()
            .flat_map(move |topic| Deed::ALL.into_iter().map(move |deed| (role, topic, deed)))
    })
}

#[test]
fn every_role_does_exactly_what_is_permitted_on_every_key_in_real_time() -> Outcome {
    does_exactly_what_it_may(false, 245)
}

#[test]
fn every_role_does_exactly_what_is_permitted_on_every_key_in_lock_step() -> Outcome {
    does_exactly_what_it_may(true, 274)
}

/// The permitted operations come from the product's own table. Their `count` is fixed here, so that
/// a change to the table cannot permit an operation unnoticed.
fn does_exactly_what_it_may(lock_step: bool, count: usize) -> Outcome {
    let certificates = Certificates::new()?;
    let router = Router::guarded(
        &["tcp/127.0.0.1:0".to_owned()],
        &[],
        GRAPH,
        &certificates.of(Role::RobotHost),
        lock_step,
    )?;
    let endpoint = router.endpoints().first().ok_or("it listens nowhere")?.clone();
    assert!(endpoint.starts_with("tls/"), "{endpoint}");
    let open = |role| connect(&endpoint, &Shows::Certificate(certificates.of(role)));
    let allowed: BTreeSet<Cell> =
        cells().filter(|&(role, topic, deed)| deed.is_allowed(role, topic, lock_step)).collect();
    assert_eq!(allowed.len(), count);
    assert!(Role::Watcher.says().is_empty() && Role::Watcher.hears().is_empty());
    let arrived = tried(&open, &allowed)?;
    let forbidden: Vec<&Cell> = arrived.difference(&allowed).collect();
    let missing: Vec<&Cell> = allowed.difference(&arrived).collect();
    let pace = if lock_step { "lock step" } else { "real time" };
    print(format_args!(
        "links in {pace}: {} cells, {} allowed, {} arrived",
        cells().count(),
        allowed.len(),
        arrived.len()
    ));
    assert!(forbidden.is_empty(), "arrived although they must not: {forbidden:?}");
    assert!(missing.is_empty(), "did not arrive although they may: {missing:?}");
    Ok(())
}

/// Otherwise the matrix would pass with any access control.
#[test]
fn without_certificates_every_operation_takes_effect() -> Outcome {
    let _calm = no_flood();
    let router = Router::open(&["tcp/127.0.0.1:0".to_owned()], &[])?;
    let endpoint = router.endpoints().first().ok_or("it listens nowhere")?.clone();
    let all: BTreeSet<Cell> = cells().collect();
    let arrived = tried(&|_| connect(&endpoint, &Shows::Nothing), &all)?;
    let missing: Vec<&Cell> = all.difference(&arrived).collect();
    assert!(missing.is_empty(), "not seen: {missing:?}");
    assert_eq!(all.len(), 896);
    Ok(())
}
