//! A client's connection with the routers of its graph, and everything that is declared on it.
//!
//! When a router ends, zenoh 1.10 connects to another one by itself, but not in every case:
//!
//! - A router that accepts a connection while it ends does not close it. As long as its process
//!   lives, the client has a router without other peers.
//! - zenoh does not detect the loss of a connection that closes in the moment in which it opens.
//!
//! So a keeper checks that its router shows its token. Without the token for a while, the keeper
//! ends the session, opens another one, and declares everything again.

use super::guard::Guard;
use super::{ANSWER_TIMEOUT, config, keys, router};
use network::Client;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, TryRecvError, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::query::Queryable;
use zenoh::sample::SampleKind;
use zenoh::{Session, Wait};

/// How often the keeper looks whether there is a router.
const LOOK: Duration = Duration::from_millis(200);

/// How long zenoh is given to find a router by itself: more than twice what one of its attempts
/// takes, with the pause behind it.
const PATIENCE: Duration = Duration::from_secs(3);

/// How long an opening tries to reach a router \[ms\]; and how long each one does that follows it,
/// so that the end does not wait for it long.
const OPEN_MILLIS: u64 = 5_000;
const OPEN_AGAIN_MILLIS: u64 = 1_000;

/// What one port has declared in a session. Its token is taken back first.
pub(super) struct Declared {
    pub(super) _token: Option<LivelinessToken>,
    pub(super) _subscribers: Vec<Subscriber<()>>,
    pub(super) _queryable: Option<Queryable<()>>,
}

/// Declares all that a port says and hears.
pub(super) type Declare = Box<dyn Fn(&Session) -> Result<Declared, zenoh::Error> + Send>;

/// The connection.
pub(super) struct Line {
    shared: Arc<Shared>,
    /// Hung up to end the keeper.
    end: Option<Sender<()>>,
    keeper: Option<JoinHandle<()>>,
}

struct Shared {
    connect: Vec<String>,
    guard: Option<Guard>,
    state: Mutex<State>,
}

/// Zenoh ids of the routers whose tokens one session sees, however far away they are.
type Sight = Arc<Mutex<BTreeSet<String>>>;

struct State {
    session: Arc<Client>,
    sight: Sight,
    seen: Subscriber<()>,
    ports: BTreeMap<u64, Port>,
    /// Ports ever held.
    held: u64,
}

struct Port {
    declare: Declare,
    /// Nothing while there is no session to declare it in.
    declared: Option<Declared>,
}

/// A port is declared as long as this lives.
pub(super) struct Held {
    line: Arc<Line>,
    number: u64,
}

impl Line {
    /// Connects to one of the routers at `connect`, with a certificate if there is a `guard`.
    pub(super) fn open(
        connect: &[String],
        guard: Option<Guard>,
    ) -> Result<Arc<Self>, zenoh::Error> {
        let session =
            Arc::new(Client::open(config::client(connect, OPEN_MILLIS, guard.as_ref())?)?);
        // Asked at once: a router that goes before the keeper's first look has shown its token all
        // the same.
        let ours = !neighbours(&session).is_disjoint(&ask_for_tokens(&session)?);
        let (sight, seen) = look_out(&session)?;
        let state = Mutex::new(State { session, sight, seen, ports: BTreeMap::new(), held: 0 });
        let shared = Arc::new(Shared { connect: connect.to_vec(), guard, state });
        let (end, ended) = channel();
        let kept = Arc::clone(&shared);
        let keeper = thread::Builder::new()
            .name("net line".to_owned())
            .spawn(move || kept.keep(&ended, ours))?;
        Ok(Arc::new(Self { shared, end: Some(end), keeper: Some(keeper) }))
    }

    /// The present session. What is said in it while there is no router is lost.
    pub(super) fn session(&self) -> Arc<Client> {
        Arc::clone(&self.shared.state().session)
    }

    /// Declares a port, now and in each session that follows.
    pub(super) fn hold(self: &Arc<Self>, declare: Declare) -> Result<Held, zenoh::Error> {
        let mut state = self.shared.state();
        let declared = declare(&state.session)?;
        state.held += 1;
        let number = state.held;
        state.ports.insert(number, Port { declare, declared: Some(declared) });
        drop(state);
        Ok(Held { line: Arc::clone(self), number })
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        drop(self.end.take());
        if let Some(keeper) = self.keeper.take() {
            let _ = keeper.join();
        }
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        let port = self.line.shared.state().ports.remove(&self.number);
        drop(port);
    }
}

impl Shared {
    /// The keeper's thread. `ours` is whether a router that the client was connected to has ever
    /// shown a token: those of others have none.
    fn keep(&self, ended: &Receiver<()>, mut ours: bool) {
        let mut seen = Instant::now();
        while ended.recv_timeout(LOOK) == Err(RecvTimeoutError::Timeout) {
            if self.is_connected(&mut ours) {
                seen = Instant::now();
            } else if seen.elapsed() > PATIENCE {
                self.end_session();
                if ended.try_recv() == Err(TryRecvError::Disconnected) {
                    return;
                }
                match self.begin_session() {
                    Ok(()) => {
                        tracing::info!(
                            "the router was not reachable for {:.1} s; reconnected",
                            seen.elapsed().as_secs_f64()
                        );
                        seen = Instant::now();
                    }
                    Err(error) => tracing::debug!(%error, "no router yet"),
                }
            }
        }
    }

    /// Whether there is a router, which shows its token if one ever did, and everything is
    /// declared.
    fn is_connected(&self, ours: &mut bool) -> bool {
        let state = self.state();
        let declared = state.ports.values().all(|port| port.declared.is_some());
        let (session, sight) = (Arc::clone(&state.session), Arc::clone(&state.sight));
        drop(state);
        let neighbours = neighbours(&session);
        let shown = !neighbours.is_disjoint(&lock(&sight));
        *ours |= shown;
        declared && if *ours { shown } else { !neighbours.is_empty() }
    }

    /// Undeclares all tokens first. A token that is declared again before its end looks to other
    /// peers as if it had never been missing.
    fn end_session(&self) {
        let mut state = self.state();
        let old = Arc::clone(&state.session);
        let gone: Vec<_> =
            state.ports.values_mut().filter_map(|port| port.declared.take()).collect();
        drop(state);
        drop(gone);
        if let Err(error) = old.close() {
            tracing::debug!(%error, "the session has ended already");
        }
    }

    fn begin_session(&self) -> Result<(), zenoh::Error> {
        let session = Arc::new(Client::open(config::client(
            &self.connect,
            OPEN_AGAIN_MILLIS,
            self.guard.as_ref(),
        )?)?);
        let (sight, seen) = look_out(&session)?;
        let mut state = self.state();
        (state.session, state.sight, state.seen) = (Arc::clone(&session), sight, seen);
        for port in state.ports.values_mut() {
            port.declared = Some((port.declare)(&session)?);
        }
        Ok(())
    }

    fn state(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }
}

/// Zenoh ids of the routers that a session is connected to: of a client it is one, or none.
fn neighbours(session: &Session) -> BTreeSet<String> {
    if session.is_closed() {
        return BTreeSet::new();
    }
    session.info().routers_zid().wait().map(|id| id.to_string()).collect()
}

/// Zenoh ids of the routers that have tokens at this moment.
fn ask_for_tokens(session: &Session) -> Result<BTreeSet<String>, zenoh::Error> {
    let replies = session.liveliness().get(router::TOKENS).timeout(ANSWER_TIMEOUT).wait()?;
    Ok(replies
        .iter()
        .filter_map(|reply| Some(keys::last(reply.result().ok()?.key_expr().as_str()).to_owned()))
        .collect())
}

/// Follows which routers' tokens come and go in one session.
fn look_out(session: &Session) -> Result<(Sight, Subscriber<()>), zenoh::Error> {
    let sight = Sight::default();
    let seen = Arc::clone(&sight);
    let tokens = session.liveliness().declare_subscriber(router::TOKENS).history(true).callback(
        move |sample| {
            let id = keys::last(sample.key_expr().as_str());
            if sample.kind() == SampleKind::Put {
                lock(&seen).insert(id.to_owned());
            } else {
                lock(&seen).remove(id);
            }
        },
    );
    Ok((sight, tokens.wait()?))
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Router;
    use std::error::Error;
    use std::slice;
    use std::sync::mpsc::channel;

    /// Far longer than anything here takes on any test machine.
    const GIVES_UP_AFTER: Duration = Duration::from_mins(1);

    fn wait_until(what: &str, holds: impl Fn() -> bool) -> Result<(), Box<dyn Error>> {
        let begin = Instant::now();
        while !holds() {
            if begin.elapsed() > GIVES_UP_AFTER {
                return Err(format!("waited {GIVES_UP_AFTER:?} for {what}, in vain").into());
            }
            thread::sleep(LOOK);
        }
        Ok(())
    }

    #[test]
    fn a_client_without_a_router_for_long_begins_a_new_session_in_which_it_hears_what_it_heard()
    -> Result<(), Box<dyn Error>> {
        let router = Router::open(&["tcp/127.0.0.1:0".to_owned()], &[])?;
        let endpoints = router.endpoints().to_vec();
        let line = Line::open(&endpoints, None).map_err(|error| error.to_string())?;
        let (tell, heard) = channel();
        let declare = move |session: &Session| {
            let tell = tell.clone();
            let callback = move |_| tell.send(()).unwrap_or_default();
            let subscriber = session.declare_subscriber("here").callback(callback).wait()?;
            Ok(Declared { _token: None, _subscribers: vec![subscriber], _queryable: None })
        };
        let held = line.hold(Box::new(declare)).map_err(|error| error.to_string())?;
        let first = line.session();
        drop(router);
        wait_until("the end of the session", || first.is_closed())?;
        let _router = Router::open(&endpoints, &[])?;
        let other = Line::open(&endpoints, None).map_err(|error| error.to_string())?;
        while heard.recv_timeout(LOOK).is_err() {
            other.session().put("here", "").wait().map_err(|error| error.to_string())?;
        }
        assert_ne!(line.session().zid(), first.zid());
        drop(held);
        while heard.recv_timeout(LOOK).is_ok() {}
        other.session().put("here", "").wait().map_err(|error| error.to_string())?;
        assert!(heard.recv_timeout(LOOK).is_err(), "it is not held any more");
        Ok(())
    }

    /// A router as zenohd is one: it shows no token.
    fn router_of_others() -> Result<(Session, String), Box<dyn Error>> {
        for _ in 0..router::DRAWS {
            let endpoint = router::with_port("tcp/127.0.0.1:0")?;
            let config = config::router(slice::from_ref(&endpoint), &[], None)
                .map_err(|error| error.to_string())?;
            if let Ok(session) = zenoh::open(config).wait() {
                return Ok((session, endpoint));
            }
        }
        Err("no port is free".into())
    }

    #[test]
    fn a_client_of_a_router_without_a_token_stays_with_it_when_the_router_of_another_launch_goes()
    -> Result<(), Box<dyn Error>> {
        let (_own, endpoint) = router_of_others()?;
        let line =
            Line::open(slice::from_ref(&endpoint), None).map_err(|error| error.to_string())?;
        let first = line.session();
        let another = Router::open(&["tcp/127.0.0.1:0".to_owned()], &[endpoint])?;
        let sees = || !lock(&line.shared.state().sight).is_empty();
        wait_until("the other launch's token", sees)?;
        // So that the keeper looks while there is something to see.
        thread::sleep(2 * LOOK);
        drop(another);
        wait_until("the end of that token", || !sees())?;
        thread::sleep(PATIENCE + 5 * LOOK);
        assert!(!first.is_closed(), "it has begun anew");
        assert_eq!(line.session().zid(), first.zid());
        Ok(())
    }

    #[test]
    fn a_client_whose_own_router_shows_no_token_any_more_begins_anew_whoever_else_shows_one()
    -> Result<(), Box<dyn Error>> {
        let (own, endpoint) = router_of_others()?;
        let token = own
            .liveliness()
            .declare_token(router::TOKENS.replace('*', &own.zid().to_string()))
            .wait();
        let line =
            Line::open(slice::from_ref(&endpoint), None).map_err(|error| error.to_string())?;
        let first = line.session();
        let _another = Router::open(&["tcp/127.0.0.1:0".to_owned()], &[endpoint])?;
        wait_until("both tokens", || lock(&line.shared.state().sight).len() == 2)?;
        // As of a router that ends, and forgets this client.
        token
            .map_err(|error| error.to_string())?
            .undeclare()
            .wait()
            .map_err(|error| error.to_string())?;
        wait_until("the end of the session", || first.is_closed())?;
        Ok(())
    }
}
