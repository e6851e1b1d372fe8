//! Opens all parts of the bridge, watches them, and reports.

mod report;

use crate::hello::{self, Hello};
use crate::incoming::{Incoming, Target};
use crate::keys::{Keys, What};
use crate::link::{Arrivals, Change, Link, LinkError, Occupant, self_test};
use crate::outgoing::{Flow, Outgoing, Sent};
use crate::rate::Rate;
use crate::requests::Endpoint;
use crate::settings::{Remote, Settings};
use network::Breach;
use network::requests::RequestError;
use process::{Pulse, Stop};
use protocol::message::{
    Command, Credit, Goal, Health, ModelSnapshot, Obstacles, Participant, Phase, Plan, PlantState,
    ResidualSample, Truth,
};
use protocol::topic::{TOPIC_COUNT, Topic};
use report::Report;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::Receiver;
use std::thread::{self, ScopedJoinHandle};
use std::time::{Duration, Instant};
use transport::{Identity, Links, OpenError, Ports, ReceiveError, SendError, Since};
use zenoh::bytes::ZBytes;

/// Interval between two looks at the links.
const ROUND: Duration = Duration::from_millis(10);
/// How long the other host may take to connect before its absence is reported.
const STARTS_WITHIN: Duration = Duration::from_secs(5);

/// How long a session stays closed after a peer was sent away. A zenoh peer connects again at once,
/// and if that fails, not before a second has passed. The other host tries more often
/// ([`crate::config`]), so it comes first.
const CLOSED_FOR: Duration = Duration::from_millis(300);

/// `$body` for the message `$message` of a topic.
macro_rules! of_topic {
    ($topic:expr, $message:ident => $body:expr) => {
        of_topic!($topic, $message => $body,
            State PlantState, Command Command, Residual ResidualSample, Snapshot ModelSnapshot,
            Plan Plan, Health Health, Truth Truth, Credit Credit, Goal Goal,
            Obstacles Obstacles)
    };
    ($topic:expr, $message:ident => $body:expr, $($variant:ident $of:ident),+) => {
        match $topic {
            $(Topic::$variant => {
                type $message = $of;
                $body
            })+
        }
    };
}

/// The bridge failed.
#[derive(Debug, thiserror::Error)]
pub enum BridgeError {
    /// It could not join the graph.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// A session with another host could not be opened.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// This host accepts peers without a certificate.
    #[error("nothing is forwarded: {0}")]
    Breach(#[from] Breach),
    /// A topic cannot be sent.
    #[error("topic {}: {source}", topic.name())]
    Outgoing {
        /// The topic.
        topic: Topic,
        /// The reason.
        source: ReceiveError,
    },
    /// A topic cannot be delivered.
    #[error("topic {}: {source}", topic.name())]
    Incoming {
        /// The topic.
        topic: Topic,
        /// The reason.
        source: SendError,
    },
    /// Operators and planners cannot send requests.
    #[error(transparent)]
    Requests(#[from] RequestError),
    /// A thread ended, or did not begin.
    #[error("a thread {0}")]
    Thread(&'static str),
}

/// Carries messages between this host and the others until `stop` is requested.
///
/// # Errors
/// [`BridgeError`].
pub fn run(settings: &Settings, stop: &Stop) -> Result<(), BridgeError> {
    let identity = Identity::new(settings.run.epoch_floor + 1);
    // zenoh's thread writes shared memory, and must not wait for room.
    let links = Links { patience_millis: 0, ..settings.run.links.clone() };
    let ports = Ports::open(&links, identity)?;
    let pulse = Pulse::new(&ports, Participant::Bridge)?.exposed(settings.run.exposure);
    let own = Hello::new(identity.writer, settings.run.links.lock_step);
    let open = |remote| Connection::open(settings, remote, own, &ports);
    let mut connections = settings.remotes.iter().map(open).collect::<Result<Vec<_>, _>>()?;
    let ended = Stop::new();
    thread::scope(|scope| {
        let forwarded = forward(scope, settings, &ports, &mut connections, pulse, [stop, &ended]);
        ended.request();
        forwarded
    })
}

/// Runs all threads until the stop request.
fn forward<'scope, 'env>(
    scope: &'scope thread::Scope<'scope, 'env>,
    settings: &'env Settings,
    ports: &Ports,
    connections: &mut Vec<Connection<'env>>,
    mut pulse: Pulse,
    [stop, ended]: [&'env Stop; 2],
) -> Result<(), BridgeError> {
    let mut threads = Vec::new();
    for connection in &*connections {
        for topic in settings.outgoing(connection.remote) {
            let shared = Arc::clone(&connection.shared);
            threads.push(of_topic!(topic, T => {
                let mut source = ports.source::<T>(Since::Relaying)?;
                let failed = move |source| BridgeError::Outgoing { topic, source };
                // It connects to the writers that there are.
                source.wait(Duration::ZERO).map_err(failed)?;
                spawn(scope, format!("to {}", topic.name()), move || {
                    shared.outgoing(settings, topic, ended).run(source).map_err(failed)
                })?
            }));
        }
    }
    let requests = Endpoint::open(scope, settings, ended)?;
    pulse.phase(Phase::Ready);
    let mut report = Report::default();
    while !stop.requested() {
        let now = Instant::now();
        for connection in &mut *connections {
            connection.look(now)?;
        }
        let rejected = requests.as_ref().map_or(0, Endpoint::rejected);
        report.show(connections, rejected, &mut pulse, now);
        pulse.beat();
        if let Some(index) = threads.iter().position(ScopedJoinHandle::is_finished) {
            return join(threads.swap_remove(index));
        }
        while now.elapsed() < ROUND {
            for connection in &*connections {
                connection.shared.tend()?;
            }
            // A piece wakes this thread if it is to be acknowledged.
            thread::park_timeout(ROUND.saturating_sub(now.elapsed()));
        }
    }
    ended.request();
    threads.into_iter().try_for_each(join)?;
    pulse.last_words(Phase::Finished, settings.run.pace);
    report.rest();
    Ok(())
}

type BridgeThread<'scope> = ScopedJoinHandle<'scope, Result<(), BridgeError>>;

fn spawn<'scope, 'env>(
    scope: &'scope thread::Scope<'scope, 'env>,
    name: String,
    body: impl FnOnce() -> Result<(), BridgeError> + Send + 'scope,
) -> Result<BridgeThread<'scope>, BridgeError> {
    thread::Builder::new()
        .name(name)
        .spawn_scoped(scope, body)
        .map_err(|_| BridgeError::Thread("cannot be started"))
}

fn join(thread: BridgeThread<'_>) -> Result<(), BridgeError> {
    thread.join().unwrap_or(Err(BridgeError::Thread("panicked")))
}

/// One other host: the session, and what is known of it.
struct Connection<'a> {
    remote: &'a Remote,
    shared: Arc<Shared<'a>>,
    changes: Receiver<Change>,
    /// What this bridge tells about itself, and when it told it last.
    own: Hello,
    told: Option<Instant>,
    /// What the other bridge told about itself, and when.
    received: Option<(Hello, Instant)>,
    /// Connections with the right certificate.
    links: usize,
    /// Peers with another certificate that were sent away.
    sent_away: u64,
    /// When it was last searched who holds the session, and whether that was a silent link.
    searched: Instant,
    was_silent: bool,
    /// When a closed session opens again.
    opens_again: Option<Instant>,
    was_connected: bool,
    begun: Instant,
}

/// What the threads of one other host share.
struct Shared<'a> {
    remote: &'a Remote,
    link: Link,
    arrivals: Arc<Arrivals>,
    /// How often the other host has connected.
    connections: AtomicU64,
    sent: [Sent; TOPIC_COUNT],
    instance: u64,
}

impl<'a> Connection<'a> {
    fn open(
        settings: &'a Settings,
        remote: &'a Remote,
        own: Hello,
        ports: &Ports,
    ) -> Result<Self, BridgeError> {
        let now = Instant::now();
        let mut incoming = [const { None }; TOPIC_COUNT];
        for topic in settings.incoming(remote) {
            let target: Box<dyn Target> = of_topic!(topic, T => Box::new(ports.sink::<T>()?));
            let period_s = settings.run.period_nanos as f64 * 1e-9;
            let rate = Rate::of(topic, period_s, remote.processes.len(), now);
            incoming[topic.index()] = Some(Incoming::new(
                target,
                Flow::of(topic, own.lock_step, remote.driver),
                (!own.lock_step).then_some(rate),
                remote.processes.clone(),
                settings.run.links.patience(),
            ));
        }
        let keys = Keys::new(&settings.graph, &settings.host, &remote.host);
        let arrivals = Arc::new(Arrivals::new(keys, own.instance, incoming, remote.driver));
        let (link, changes) = Link::open(settings, remote, Arc::clone(&arrivals))?;
        // A restarted bridge skips this test: its endpoint has been tested, and the robot waits.
        if !settings.run.restarted {
            self_test(settings, remote, &link)?;
        }
        tracing::info!(host = remote.host, endpoint = link.endpoint(), "carrying messages");
        let shared = Shared {
            remote,
            link,
            arrivals,
            connections: AtomicU64::new(0),
            sent: Default::default(),
            instance: own.instance,
        };
        Ok(Self {
            remote,
            shared: Arc::new(shared),
            changes,
            own,
            told: None,
            received: None,
            links: 0,
            sent_away: 0,
            searched: now,
            was_silent: false,
            opens_again: None,
            was_connected: false,
            begun: now,
        })
    }

    /// Whether the other host is there, and fits.
    fn is_connected(&self, now: Instant) -> bool {
        if self.remote.driver {
            return self.links > 0;
        }
        self.receives(now) && self.received.is_some_and(|(hello, _)| self.own.check(hello).is_ok())
    }

    /// Whether the other bridge has told lately that it is here.
    fn receives(&self, now: Instant) -> bool {
        self.received.is_some_and(|(_, at)| now.saturating_duration_since(at) < hello::LOST_AFTER)
    }

    /// Whether the session is held by a peer that is not the other host, or by a link that carries
    /// nothing. Searched for while the other host is away: a link that came up while the session
    /// was opened may have had no event, and zenoh leaves a link half open whose opening takes
    /// longer than the time that an attempt has. Neither ends by itself.
    fn occupant_is_useless(&mut self, now: Instant) -> bool {
        let is_due = now.saturating_duration_since(self.searched) >= hello::LOST_AFTER;
        if !is_due || self.is_connected(now) {
            return false;
        }
        self.searched = now;
        let host = &self.remote.host;
        let occupant = self.shared.link.occupant();
        let is_silent =
            occupant == Some(Occupant::OtherHost) && !self.remote.driver && !self.receives(now);
        let was_silent = std::mem::replace(&mut self.was_silent, is_silent);
        if occupant == Some(Occupant::Stranger) {
            tracing::warn!(host, "a peer with another certificate: refused");
            self.sent_away += 1;
            return true;
        }
        if is_silent && was_silent {
            tracing::warn!(host, "a link without a word: opened again");
            self.was_silent = false;
            return true;
        }
        false
    }

    /// Takes in what has changed, and tells the other bridge that this one is here.
    fn look(&mut self, now: Instant) -> Result<(), BridgeError> {
        let shared = Arc::clone(&self.shared);
        let link = &shared.link;
        let mut is_evicted = false;
        while let Ok(Change { is_up, subject }) = self.changes.try_recv() {
            if !link.accepts(subject.as_deref()) {
                let peer = subject.as_deref().unwrap_or("none");
                if is_up {
                    tracing::warn!(host = self.remote.host, peer, "another certificate: refused");
                    self.sent_away += 1;
                    is_evicted = true;
                }
            } else if is_up {
                self.links += 1;
                // It gets the last messages again as soon as it has told that it is here.
                (self.received, self.told) = (None, None);
            } else {
                self.links = self.links.saturating_sub(1);
            }
        }
        is_evicted |= self.occupant_is_useless(now);
        if is_evicted {
            // The peer holds the one session that there is. zenoh closes no single one.
            self.links = 0;
            link.close();
            self.opens_again = Some(now + CLOSED_FOR);
        }
        if self.opens_again.is_some_and(|at| now >= at) {
            self.opens_again = None;
            link.reopen()?;
        }
        if let Some(hello) = self.shared.arrivals.hello() {
            let before = self.received.replace((hello, now));
            let is_new = before.is_none_or(|(before, at)| {
                before.instance != hello.instance
                    || now.saturating_duration_since(at) >= hello::LOST_AFTER
            });
            let fit = self.own.check(hello);
            self.shared.arrivals.fits.store(fit.is_ok(), Ordering::Relaxed);
            if is_new {
                self.shared.connections.fetch_add(1, Ordering::Relaxed);
                // It may have connected too late for the last hello.
                self.told = None;
                if let Err(mismatch) = fit {
                    tracing::error!(host = self.remote.host, "{mismatch}");
                }
            }
        }
        if self.told.is_none_or(|told| now.saturating_duration_since(told) >= hello::EVERY) {
            self.told = Some(now);
            link.put(What::Hello, ZBytes::from(self.own.to_bytes()), None);
        }
        let is_connected = self.is_connected(now);
        if is_connected != self.was_connected {
            let what = if is_connected { "connected" } else { "connection lost" };
            tracing::info!(host = self.remote.host, "{what}");
            self.was_connected = is_connected;
        }
        Ok(())
    }

    /// What is wrong; none if all is well.
    fn trouble(&self, now: Instant) -> Option<String> {
        let host = &self.remote.host;
        if let Some((hello, _)) = self.received
            && let Err(mismatch) = self.own.check(hello)
        {
            return Some(format!("host {host}: {mismatch}"));
        }
        // At the start the other host may be slower.
        let is_due = self.shared.connections.load(Ordering::Relaxed) > 0
            || now.saturating_duration_since(self.begun) >= STARTS_WITHIN;
        (is_due && !self.is_connected(now)).then(|| format!("host {host}: not connected"))
    }
}

impl Shared<'_> {
    fn outgoing<'a>(
        &'a self,
        settings: &'a Settings,
        topic: Topic,
        stop: &'a Stop,
    ) -> Outgoing<'a> {
        Outgoing {
            topic,
            flow: Flow::of(topic, settings.run.links.lock_step, self.remote.driver),
            link: &self.link,
            acknowledged: &self.arrivals.acknowledged[topic.index()],
            connections: &self.connections,
            sent: &self.sent[topic.index()],
            stop,
            instance: self.instance,
            processes: &settings.processes,
        }
    }

    /// Does what the thread that reads the link leaves.
    fn tend(&self) -> Result<(), BridgeError> {
        for topic in Topic::ALL {
            let Some(incoming) = &self.arrivals.incoming[topic.index()] else { continue };
            let tended = incoming.tend();
            if let Some(last) = tended.map_err(|source| BridgeError::Incoming { topic, source })? {
                self.link.acknowledge(topic, last);
            }
        }
        Ok(())
    }
}
