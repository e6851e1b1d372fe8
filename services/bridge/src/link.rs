//! The zenoh session with one other host.
//!
//! zenoh calls [`Arrivals::receive`] on the thread that reads the link. It never waits.

use crate::config::{ConfigError, config, endpoint, subject};
use crate::hello::Hello;
use crate::incoming::Incoming;
use crate::keys::{Keys, What};
use crate::piece::Label;
use crate::settings::{Meeting, Remote, Settings};
use network::{Breach, Client, first_line, keeps_strangers_out};
use protocol::topic::{TOPIC_COUNT, Topic, Urgency};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, OnceLock, PoisonError, RwLock};
use std::thread::{self, Thread};
use std::time::{Duration, Instant};
use zenoh::bytes::ZBytes;
use zenoh::key_expr::KeyExpr;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Config, Wait};

/// How long the router may take to answer at the start.
const ROUTER_ANSWERS_WITHIN: Duration = Duration::from_secs(10);
/// How often the probe is sent, and the pause after each.
const PROBES: usize = 10;
const PROBE_PAUSE: Duration = Duration::from_millis(50);

/// The session cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// There is no configuration for it.
    #[error("host {host}: {source}")]
    Config {
        /// The other host.
        host: String,
        /// The reason.
        source: ConfigError,
    },
    /// zenoh does not open it.
    #[error("host {host}: no session at {endpoint}: {reason}")]
    Open {
        /// The other host.
        host: String,
        /// Where the two hosts meet.
        endpoint: String,
        /// zenoh's error.
        reason: String,
    },
}

/// A connection came or went.
#[derive(Debug)]
pub(crate) struct Change {
    pub(crate) is_up: bool,
    /// Subject of the certificate at the other end.
    pub(crate) subject: Option<String>,
}

/// Who holds the one session that there is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Occupant {
    OtherHost,
    /// A peer with another certificate.
    Stranger,
}

/// Up to which piece the other host has acknowledged, and who waits for that.
#[derive(Debug, Default)]
pub(crate) struct Acknowledged {
    through: AtomicU64,
    waiting: OnceLock<Thread>,
}

impl Acknowledged {
    /// Wakes this thread from now on.
    pub(crate) fn wake_this_thread(&self) {
        let _ = self.waiting.set(thread::current());
    }

    pub(crate) fn through(&self) -> u64 {
        self.through.load(Ordering::Relaxed)
    }

    fn receive(&self, through: u64) {
        self.through.fetch_max(through, Ordering::Relaxed);
        if let Some(thread) = self.waiting.get() {
            thread.unpark();
        }
    }
}

/// What arrives from the other host.
pub(crate) struct Arrivals {
    keys: Keys,
    /// This bridge.
    instance: u64,
    pub(crate) incoming: [Option<Incoming>; TOPIC_COUNT],
    pub(crate) acknowledged: [Acknowledged; TOPIC_COUNT],
    hello: Mutex<Option<Hello>>,
    /// Whether the other host fits this one, by its last hello. Before that no message is taken in.
    pub(crate) fits: AtomicBool,
    /// Messages with a key that the other host may not use.
    pub(crate) not_permitted: AtomicU64,
    /// The thread that tends `incoming`.
    bridge: Thread,
}

impl Arrivals {
    /// For an other host that fits without a hello if `fits`, tended by this thread.
    pub(crate) fn new(
        keys: Keys,
        instance: u64,
        incoming: [Option<Incoming>; TOPIC_COUNT],
        fits: bool,
    ) -> Self {
        Self {
            keys,
            instance,
            incoming,
            acknowledged: Default::default(),
            hello: Mutex::new(None),
            fits: AtomicBool::new(fits),
            not_permitted: AtomicU64::new(0),
            bridge: thread::current(),
        }
    }

    /// The last hello since the last call.
    pub(crate) fn hello(&self) -> Option<Hello> {
        self.hello.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    fn receive(&self, sample: &Sample) {
        match self.keys.what(sample.key_expr().as_str()) {
            Some(What::Data(topic)) => {
                if let Some(incoming) = &self.incoming[topic.index()] {
                    if self.fits.load(Ordering::Relaxed) && incoming.take(sample) {
                        self.bridge.unpark();
                    }
                    return;
                }
            }
            Some(What::Acknowledgements(topic)) => {
                let bytes = sample.payload().to_bytes();
                if let Some(label) = Label::of(&bytes)
                    && label.instance == self.instance
                {
                    self.acknowledged[topic.index()].receive(label.number);
                }
                return;
            }
            Some(What::Hello) => {
                if let Some(hello) = Hello::of(&sample.payload().to_bytes()) {
                    *self.hello.lock().unwrap_or_else(PoisonError::into_inner) = Some(hello);
                    return;
                }
            }
            None => {}
        }
        self.not_permitted.fetch_add(1, Ordering::Relaxed);
    }
}

/// The keys that this host sends with, in the order of [`What::index`]. zenoh looks the way of a
/// declared key up once, and not for each message.
type Declared = Vec<KeyExpr<'static>>;

/// The session with one other host.
pub(crate) struct Link {
    host: String,
    endpoint: String,
    keys: Keys,
    config: Config,
    arrivals: Arc<Arrivals>,
    session: RwLock<Option<(Client, Declared)>>,
    changes: Sender<Change>,
    lock_step: bool,
    subject: Option<String>,
}

impl Link {
    /// Listens or connects, and reports each change of the connection.
    pub(crate) fn open(
        settings: &Settings,
        remote: &Remote,
        arrivals: Arc<Arrivals>,
    ) -> Result<(Self, Receiver<Change>), LinkError> {
        let failed = |source| LinkError::Config { host: remote.host.clone(), source };
        let (changes, changed) = channel();
        let link = Self {
            host: remote.host.clone(),
            endpoint: endpoint(settings, remote),
            keys: Keys::new(&settings.graph, &settings.host, &remote.host),
            config: config(settings, remote).map_err(failed)?,
            arrivals,
            session: RwLock::new(None),
            changes,
            lock_step: settings.run.links.lock_step,
            subject: subject(settings, remote).map_err(|error| failed(error.into()))?,
        };
        link.reopen()?;
        Ok((link, changed))
    }

    /// Ends the session, and with it every connection.
    pub(crate) fn close(&self) {
        drop(self.session.write().unwrap_or_else(PoisonError::into_inner).take());
    }

    /// Opens a session in place of the one that was closed.
    pub(crate) fn reopen(&self) -> Result<(), LinkError> {
        let mut session = self.session.write().unwrap_or_else(PoisonError::into_inner);
        let opened = self.connect().map_err(|error| LinkError::Open {
            host: self.host.clone(),
            endpoint: self.endpoint.clone(),
            reason: first_line(&error),
        });
        *session = Some(opened?);
        Ok(())
    }

    fn connect(&self) -> Result<(Client, Declared), zenoh::Error> {
        let session = Client::open(self.config.clone())?;
        let arrivals = Arc::clone(&self.arrivals);
        session
            .declare_subscriber(self.keys.incoming())
            .callback(move |sample| arrivals.receive(&sample))
            .background()
            .wait()?;
        let changes = self.changes.clone();
        session
            .info()
            .link_events_listener()
            .history(true)
            .callback(move |event| {
                let subject = event.link().auth_identifier().map(str::to_owned);
                let is_up = event.kind() == SampleKind::Put;
                // The bridge is about to end if no receiver is left.
                let _ = changes.send(Change { is_up, subject });
            })
            .background()
            .wait()?;
        let keys = What::all().map(|what| session.declare_keyexpr(self.keys.outgoing(what)).wait());
        let keys = keys.collect::<Result<_, _>>()?;
        Ok((session, keys))
    }

    /// Whether a peer with this certificate is the other host.
    pub(crate) fn accepts(&self, subject: Option<&str>) -> bool {
        self.subject.as_deref().is_none_or(|expected| subject == Some(expected))
    }

    /// The peer at the other end of the link, if there is a link.
    pub(crate) fn occupant(&self) -> Option<Occupant> {
        let session = self.session.read().unwrap_or_else(PoisonError::into_inner);
        let (session, _) = session.as_ref()?;
        let occupant = |link: Option<&str>| {
            if self.accepts(link) { Occupant::OtherHost } else { Occupant::Stranger }
        };
        session.info().links().wait().map(|link| occupant(link.auth_identifier())).max()
    }

    /// Where the two hosts meet.
    pub(crate) fn endpoint(&self) -> &str {
        &self.endpoint
    }

    /// Sends bytes to the other host, if it is connected; else they are lost.
    pub(crate) fn put(&self, what: What, bytes: ZBytes, label: Option<Label>) {
        let session = self.session.read().unwrap_or_else(PoisonError::into_inner);
        let Some((session, keys)) = session.as_ref() else { return };
        let Some(key) = keys.get(what.index()) else { return };
        // In lock step a message waits for room.
        let congestion = match what {
            What::Data(_) if self.lock_step => CongestionControl::Block,
            _ => CongestionControl::Drop,
        };
        let put = session
            .put(key, bytes)
            .attachment(label.map(Label::to_bytes))
            .priority(priority(what))
            .congestion_control(congestion)
            .express(is_express(what));
        let _ = put.wait();
    }

    /// Behind a router the certificate of the link is the router's own. So the router must reject
    /// what a host publishes in the name of another one. A second session of this host tries it.
    fn is_alone_behind_router(&self) -> Result<(), Breach> {
        let unknown = |reason: String| Breach::Unknown { endpoint: self.endpoint.clone(), reason };
        let probe = Client::open(self.config.clone());
        let probe = probe.map_err(|error| unknown(first_line(&error)))?;
        let begin = Instant::now();
        while probe.info().peers_zid().wait().chain(probe.info().routers_zid().wait()).count() == 0
        {
            if begin.elapsed() > ROUTER_ANSWERS_WITHIN {
                return Err(unknown("the router does not answer".to_owned()));
            }
            thread::sleep(PROBE_PAUSE);
        }
        for _ in 0..PROBES {
            let put = probe.put(self.keys.probe(), "probe").wait();
            put.map_err(|error| unknown(first_line(&error)))?;
            thread::sleep(PROBE_PAUSE);
        }
        if self.arrivals.not_permitted.load(Ordering::Relaxed) > 0 {
            let endpoint = self.endpoint.clone();
            return Err(Breach::Name { endpoint, host: self.host.clone() });
        }
        Ok(())
    }

    /// Acknowledges the pieces of `topic` up to that of `label`.
    pub(crate) fn acknowledge(&self, topic: Topic, label: Label) {
        let bytes = label.to_bytes();
        self.put(What::Acknowledgements(topic), ZBytes::from(bytes.as_slice()), None);
    }
}

/// Fails if a peer that is not the other host can send messages in its name.
///
/// # Errors
/// [`Breach`].
pub(crate) fn self_test(settings: &Settings, remote: &Remote, link: &Link) -> Result<(), Breach> {
    match (&remote.meeting, &settings.credentials) {
        (Meeting::Listen(_), Some(credentials)) => {
            keeps_strangers_out(&access::from_here(link.endpoint()), credentials)
        }
        (Meeting::Router(_), Some(_)) => link.is_alone_behind_router(),
        _ => Ok(()),
    }
}

/// Whether zenoh sends it at once. Otherwise zenoh waits up to a millisecond for more.
const fn is_express(what: What) -> bool {
    match what {
        What::Data(topic) | What::Acknowledgements(topic) => topic.goes_alone(),
        What::Hello => true,
    }
}

/// Which messages go first where several wait for one link.
const fn priority(what: What) -> Priority {
    match what {
        What::Acknowledgements(_) | What::Hello => Priority::InteractiveHigh,
        What::Data(topic) => match topic.urgency() {
            Urgency::Drive => Priority::RealTime,
            Urgency::Serve => Priority::DataHigh,
            Urgency::Show => Priority::DataLow,
            Urgency::Bulk => Priority::Background,
        },
    }
}
