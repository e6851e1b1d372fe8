//! Where the processes of a graph meet on the network.
//!
//! Routers join each other, and zenoh 1.10 takes a lost link up again by itself, at once. But it
//! works its routes out 100 ms after a change of neighbours: one that goes and comes back in
//! between, or is replaced by another, counts as one that was never away, and is not told what
//! there is to hear. So a router that has lost one that it had joined leaves for long enough to be
//! forgotten, and comes back as a new one. It does the same when those that it is joined to show no
//! token: a router that accepts a connection while it ends may forget to close it.

use super::config;
use super::guard::Guard;
use super::self_test::self_test;
use crate::OpenError;
use access::{Credentials, from_here};
use network::first_line;
use network::{Breach, over_tls};
use std::collections::BTreeSet;
use std::net::TcpListener;
use std::slice;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::sample::SampleKind;
use zenoh::{Session, Wait};

/// A free port that somebody else takes first is drawn again so often.
pub(super) const DRAWS: u32 = 20;

/// How long a router stays away that has lost one that it had joined.
const AWAY: Duration = Duration::from_millis(500);

/// How often a router looks which others it is joined to.
const LOOK: Duration = Duration::from_millis(20);

/// How long the tokens of those that it has joined may be missing.
const PATIENCE: Duration = Duration::from_secs(3);

/// Where a router that asks for certificates listens besides, for the processes of its own launch.
/// zenoh's listener waits 100 ms after each handshake that fails, and so whoever knocks at a door
/// ten times a second lets nobody in there: strangers on the network do not reach this one.
const DOOR: &str = "tls/127.0.0.1:0";

/// Keys of the routers' tokens: the last part is the router's zenoh id.
pub(super) const TOKENS: &str = "coxswain-router/*";

/// A router: the processes of one launch connect to it, and routers of other launches join. It ends
/// when it is dropped.
pub struct Router {
    endpoints: Vec<String>,
    /// Where the processes of this launch connect, if it is not there.
    door: Option<String>,
    guard: Option<Guard>,
    signs: Sender<Sign>,
    /// Holds the router until it is told to end.
    keeper: Option<JoinHandle<()>>,
}

/// What the keeper of a router is told.
enum Sign {
    /// The router of this zenoh id is to be seen.
    Seen(String),
    /// It is not to be seen any more.
    Gone(String),
    /// It shall end.
    End,
}

/// One life of a router.
struct Life {
    _seen: Option<Subscriber<()>>,
    _token: LivelinessToken,
    session: Session,
}

impl Router {
    /// Listens at `listen`, as `tcp/0.0.0.0:7447`, where port 0 stands for any free one, and joins
    /// the routers at `connect`.
    ///
    /// Joining is tried for ever in the background, also after a cut; opening does not wait for it.
    ///
    /// # Errors
    /// [`OpenError::Router`] if it cannot listen, or an endpoint is not one.
    pub fn open(listen: &[String], connect: &[String]) -> Result<Self, OpenError> {
        Self::begin(listen, connect.to_vec(), None)
    }

    /// The same over TLS, for those alone whose certificate is of the same robot and authority;
    /// each may do what its role in the graph called `graph` needs, and, unless the graph runs in
    /// lock step, say no more in a second than any does. Endpoints that name `tcp` are taken for
    /// `tls`.
    ///
    /// # Errors
    /// [`OpenError::Router`], also if the certificate cannot be read.
    pub fn guarded(
        listen: &[String],
        connect: &[String],
        graph: &str,
        credentials: &Credentials,
        lock_step: bool,
    ) -> Result<Self, OpenError> {
        let failed = |reason| OpenError::Router { endpoints: listen.join(", "), reason };
        let guard = Guard::new(credentials, graph).map_err(|error| failed(error.to_string()))?;
        let guard = Guard { real_time: !lock_step, ..guard };
        let over_tls = |endpoints: &[String]| -> Vec<String> {
            endpoints.iter().map(|endpoint| over_tls(endpoint)).collect()
        };
        Self::begin(&over_tls(listen), over_tls(connect), Some(guard))
    }

    fn begin(
        listen: &[String],
        connect: Vec<String>,
        guard: Option<Guard>,
    ) -> Result<Self, OpenError> {
        let draws = guard.is_some() || listen.iter().any(|endpoint| endpoint.ends_with(":0"));
        let (signs, told) = channel();
        let mut attempt = 1;
        loop {
            let endpoints =
                listen.iter().map(|endpoint| with_port(endpoint)).collect::<Result<Vec<_>, _>>()?;
            let door = guard.as_ref().map(|_| with_port(DOOR)).transpose()?;
            let all: Vec<String> = endpoints.iter().chain(&door).cloned().collect();
            let failed =
                |reason: String| OpenError::Router { endpoints: endpoints.join(", "), reason };
            match Life::begin(&all, &connect, guard.as_ref(), &signs) {
                Ok(life) => {
                    let keeper = Keeper {
                        listen: all,
                        connect,
                        guard: guard.clone(),
                        signs: signs.clone(),
                        told,
                    };
                    let keeper = thread::Builder::new()
                        .name("router".to_owned())
                        .spawn(move || keeper.keep(life));
                    let keeper =
                        Some(keeper.map_err(|error| failed(format!("no thread: {error}")))?);
                    return Ok(Self { endpoints, door, guard, signs, keeper });
                }
                Err(_) if draws && attempt < DRAWS => attempt += 1,
                Err(error) => return Err(failed(first_line(&error))),
            }
        }
    }

    /// Tries as a stranger to get in, wherever it listens: over TCP, without a certificate, in a
    /// role that must not say what it says, and with a message that is too long. A router that asks
    /// for no certificates is not tried: everybody gets in there.
    ///
    /// # Errors
    /// The first [`Breach`].
    pub fn self_test(&self) -> Result<(), Breach> {
        let Some(guard) = &self.guard else { return Ok(()) };
        let endpoints = self.endpoints.iter().chain(&self.door);
        endpoints.into_iter().try_for_each(|endpoint| {
            self_test(&from_here(endpoint), &guard.graph, &guard.credentials)
        })
    }

    /// Where it listens, with the ports that were drawn.
    pub fn endpoints(&self) -> &[String] {
        &self.endpoints
    }

    /// Where the processes of its own launch connect: where nobody else on the network can, if
    /// there are certificates.
    pub fn own_endpoints(&self) -> &[String] {
        self.door.as_ref().map_or(&self.endpoints, slice::from_ref)
    }
}

impl Drop for Router {
    fn drop(&mut self) {
        // If nobody hears it, it has ended.
        let _ = self.signs.send(Sign::End);
        if let Some(keeper) = self.keeper.take() {
            let _ = keeper.join();
        }
    }
}

impl Life {
    /// Who joins others is told when one of them is not to be seen any more.
    fn begin(
        listen: &[String],
        connect: &[String],
        guard: Option<&Guard>,
        signs: &Sender<Sign>,
    ) -> Result<Self, zenoh::Error> {
        let session = zenoh::open(config::router(listen, connect, guard)?).wait()?;
        let token = session
            .liveliness()
            .declare_token(TOKENS.replace('*', &session.zid().to_string()))
            .wait()?;
        let signs = signs.clone();
        let tell = move |sample: zenoh::sample::Sample| {
            let id = super::keys::last(sample.key_expr().as_str()).to_owned();
            // If nobody hears it, the router has ended.
            let _ = signs.send(if sample.kind() == SampleKind::Put {
                Sign::Seen(id)
            } else {
                Sign::Gone(id)
            });
        };
        let seen = (!connect.is_empty())
            .then(|| {
                session.liveliness().declare_subscriber(TOKENS).history(true).callback(tell).wait()
            })
            .transpose()?;
        Ok(Self { _seen: seen, _token: token, session })
    }

    /// The zenoh ids of the routers that it is joined to.
    fn neighbours(&self) -> BTreeSet<String> {
        self.session.info().routers_zid().wait().map(|id| id.to_string()).collect()
    }
}

/// Looks after a router on a thread of its own.
struct Keeper {
    listen: Vec<String>,
    connect: Vec<String>,
    guard: Option<Guard>,
    signs: Sender<Sign>,
    told: Receiver<Sign>,
}

impl Keeper {
    fn keep(self, mut life: Life) {
        let (mut neighbours, mut seen) = (BTreeSet::new(), BTreeSet::new());
        // Routers of others have no tokens.
        let (mut ours, mut missing) = (false, Instant::now());
        loop {
            let mut lost = match self.told.recv_timeout(LOOK) {
                Ok(Sign::Seen(id)) => {
                    seen.insert(id);
                    false
                }
                Ok(Sign::Gone(id)) => {
                    seen.remove(&id);
                    neighbours.is_empty() || neighbours.contains(&id)
                }
                Ok(Sign::End) | Err(RecvTimeoutError::Disconnected) => return,
                Err(RecvTimeoutError::Timeout) => {
                    let before = std::mem::replace(&mut neighbours, life.neighbours());
                    !before.is_subset(&neighbours)
                }
            };
            let shown = !neighbours.is_disjoint(&seen);
            ours |= shown;
            if shown || neighbours.is_empty() {
                missing = Instant::now();
            }
            lost |= ours && missing.elapsed() > PATIENCE;
            if lost && !self.connect.is_empty() {
                tracing::info!("the router of another launch is gone; reconnecting");
                drop(life);
                let Some(next) = self.begin_anew() else { return };
                life = next;
                (neighbours, seen, missing) = (BTreeSet::new(), BTreeSet::new(), Instant::now());
            }
        }
    }

    /// The next life, after a while; none if it shall end.
    fn begin_anew(&self) -> Option<Life> {
        loop {
            let begin = Instant::now();
            while let Some(left) = AWAY.checked_sub(begin.elapsed()) {
                match self.told.recv_timeout(left) {
                    Ok(Sign::Seen(_) | Sign::Gone(_)) | Err(RecvTimeoutError::Timeout) => {}
                    Ok(Sign::End) | Err(RecvTimeoutError::Disconnected) => return None,
                }
            }
            match Life::begin(&self.listen, &self.connect, self.guard.as_ref(), &self.signs) {
                Ok(life) => return Some(life),
                Err(error) => tracing::warn!(%error, "the router cannot listen again yet"),
            }
        }
    }
}

/// `endpoint` with a free port in place of port 0. zenoh would take one too, but not say which.
pub(super) fn with_port(endpoint: &str) -> Result<String, OpenError> {
    let Some(host) = endpoint.strip_suffix(":0") else {
        return Ok(endpoint.to_owned());
    };
    let failed = |reason: String| OpenError::Router { endpoints: endpoint.to_owned(), reason };
    let address = host.strip_prefix("tcp/").or_else(|| host.strip_prefix("tls/"));
    let address =
        address.ok_or_else(|| failed("only tcp and tls have ports to choose from".to_owned()))?;
    let listener =
        TcpListener::bind(format!("{address}:0")).map_err(|error| failed(error.to_string()))?;
    let port = listener.local_addr().map_err(|error| failed(error.to_string()))?.port();
    Ok(format!("{host}:{port}"))
}
