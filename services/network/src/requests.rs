//! operator or planner → bridge: requests to a process of the bridge's host.
//!
//! A request is a zenoh query over TLS, with a certificate at both ends:
//!
//! | part        | contents                                                                |
//! |-------------|-------------------------------------------------------------------------|
//! | key         | `coxswain-request/<robot>/<role>/<process>`                             |
//! | payload     | text: the `change` of a request file (`process::requests`), or a list   |
//! |             | of obstacles (`process::lists`)                                         |
//! | attachment  | of a goal: when it was made by the clock of the bridge \[ns\], a u64 in |
//! |             | little-endian; without it, the request counts as made when it arrives   |
//! | reply       | the outcome as JSON, as in the file of the reply or on the socket       |
//! | error reply | text: why the bridge rejects the request                                |
//!
//! Access control lets a role use its own key alone ([`access::of_requests`]).
//!
//! The clocks of two machines differ. So a client asks the process `bridge` for its clock, and adds
//! the time since the reply:
//!
//! ```text
//!  client   ──"clock"──┐           ┌──▶ received ─────── goal made ──▶
//!  bridge              └▶ clock n ─┘                     n + (made − received)
//! ```
//! The way of that reply makes a goal older than it is, never younger.

use crate::reason::first_line;
use crate::threads::Client;
use crate::{guarded, over_tls, quiet};
use access::{AccessError, Certificate, Credentials, Role, of_requests};
use protocol::clock::monotonic_nanos;
use protocol::message::Participant;
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};
use zenoh::Wait;
use zenoh::handlers::FifoChannel;
use zenoh::query::Query;

/// The roles that may send requests.
pub const ROLES: [Role; 2] = [Role::Operator, Role::Planner];

/// Longest message, with all that zenoh adds \[bytes\]: a path of 10 000 points is shorter.
const BYTES_MAX: u64 = 2 << 20;
/// Most clients at one time.
const CLIENTS_MAX: usize = 16;
/// How long a client waits for a reply.
const REPLY_WITHIN: Duration = Duration::from_secs(20);
/// How long a new session may take to know who replies.
const KNOWN_WITHIN: Duration = Duration::from_secs(3);
/// Interval between two looks in that time.
const PAUSE: Duration = Duration::from_millis(20);
/// The request for the clock of the bridge.
const CLOCK: &str = "clock";
/// How long the reply to it is used: two clocks drift apart.
const CLOCK_VALID: Duration = Duration::from_mins(1);
/// The same for a reply that took longer than [`CLOCK_QUICK`].
const CLOCK_SLOW_VALID: Duration = Duration::from_secs(1);
/// A reply within this time is precise.
const CLOCK_QUICK: Duration = Duration::from_millis(100);

/// A request has no outcome.
#[derive(Debug, thiserror::Error)]
pub enum RequestError {
    /// The certificate cannot be used.
    #[error(transparent)]
    Access(#[from] AccessError),
    /// The certificate is for a role that sends no requests.
    #[error("{role} sends no requests: expected the certificate of an operator or a planner")]
    Role {
        /// The role of the certificate.
        role: Role,
    },
    /// No bridge accepts the session.
    #[error("no session at {endpoint}: {reason}")]
    Connect {
        /// The endpoint.
        endpoint: String,
        /// zenoh's error.
        reason: String,
    },
    /// The bridge rejects the request.
    #[error("{0}")]
    Rejected(String),
    /// No reply arrived.
    #[error("no reply from {endpoint}; {role} may have no access to {to}")]
    NoReply {
        /// The endpoint.
        endpoint: String,
        /// The role of the certificate.
        role: Role,
        /// The process of the request.
        to: Participant,
    },
}

/// A session of an operator or a planner with the bridge of one host.
pub struct Requester {
    endpoint: String,
    robot: String,
    role: Role,
    session: Client,
    clock: Mutex<Option<Clock>>,
}

/// The clock of the bridge when its reply was received.
#[derive(Debug, Clone, Copy)]
struct Clock {
    nanos: u64,
    received: Instant,
    /// How long the last reply is used.
    valid: Duration,
}

/// Reply to a request for the clock.
#[derive(Serialize, Deserialize)]
struct ClockReply {
    monotonic_nanos: u64,
}

impl Requester {
    /// Connects to the bridge at `endpoint`, in the role that `credentials` name.
    ///
    /// # Errors
    /// [`RequestError`], within seconds.
    pub fn open(endpoint: &str, credentials: &Credentials) -> Result<Self, RequestError> {
        let Certificate { role, robot, .. } = credentials.read()?;
        if !ROLES.contains(&role) {
            return Err(RequestError::Role { role });
        }
        let endpoint = over_tls(endpoint);
        let open = || {
            let mut config = quiet("client", BYTES_MAX)?;
            for (key, value) in
                [("connect/endpoints", json!([endpoint])), ("connect/timeout_ms", json!(0))]
            {
                config.insert_json5(key, &value.to_string())?;
            }
            Client::open(guarded(config, credentials, &[])?)
        };
        let session = open().map_err(|error| connect_error(&endpoint, &error))?;
        Ok(Self { endpoint, robot, role, session, clock: Mutex::default() })
    }

    /// The endpoint of the bridge.
    pub fn endpoint(&self) -> &str {
        &self.endpoint
    }

    /// Sends the request `text` for the process `to`, and waits for the reply. Returns the outcome
    /// as JSON. A goal counts as made now, also if the network holds it up.
    ///
    /// # Errors
    /// [`RequestError`]. Without a reply, it is not known whether the request was processed.
    pub fn ask(&self, to: Participant, text: &str) -> Result<Vec<u8>, RequestError> {
        let made = Instant::now();
        if to != Participant::Controller {
            return self.query(to, text, None);
        }
        let Clock { nanos, received, .. } = self.clock()?;
        let difference = |long: Duration| u64::try_from(long.as_nanos()).unwrap_or(u64::MAX);
        let made_nanos = nanos
            .saturating_add(difference(made.saturating_duration_since(received)))
            .saturating_sub(difference(received.saturating_duration_since(made)));
        let outcome = self.query(to, text, Some(made_nanos));
        if outcome.is_err() {
            // A machine that was restarted has another clock.
            *self.clock.lock().unwrap_or_else(PoisonError::into_inner) = None;
        }
        outcome
    }

    fn clock(&self) -> Result<Clock, RequestError> {
        let known = *self.clock.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(clock) = known.filter(|clock| clock.received.elapsed() < clock.valid) {
            return Ok(clock);
        }
        let sent = Instant::now();
        let reply = self.query(Participant::Bridge, CLOCK, None)?;
        let received = Instant::now();
        let ClockReply { monotonic_nanos: nanos } = serde_json::from_slice(&reply)
            .map_err(|error| RequestError::Rejected(format!("no clock: {error}")))?;
        let is_quick = received.saturating_duration_since(sent) <= CLOCK_QUICK;
        let valid = if is_quick { CLOCK_VALID } else { CLOCK_SLOW_VALID };
        let clock = Clock { nanos, received, valid };
        *self.clock.lock().unwrap_or_else(PoisonError::into_inner) = Some(clock);
        Ok(clock)
    }

    fn query(
        &self,
        to: Participant,
        text: &str,
        made_nanos: Option<u64>,
    ) -> Result<Vec<u8>, RequestError> {
        let Self { endpoint, robot, role, session, .. } = self;
        let key = format!("coxswain-request/{robot}/{role}/{}", to.text());
        let failed = |error: zenoh::Error| connect_error(endpoint, &error);
        let querier = session.declare_querier(key).timeout(REPLY_WITHIN).wait().map_err(failed)?;
        let no_reply =
            || RequestError::NoReply { endpoint: endpoint.clone(), role: role.clone(), to };
        // A request is sent once: one without a reply may have been processed.
        let begin = Instant::now();
        while !querier.matching_status().wait().map_err(failed)?.matching() {
            if begin.elapsed() >= KNOWN_WITHIN {
                return Err(no_reply());
            }
            thread::sleep(PAUSE);
        }
        let asked = querier.get().payload(text).attachment(made_nanos.map(u64::to_le_bytes));
        let replies = asked.with(FifoChannel::new(1)).wait().map_err(failed)?;
        match replies.recv().map_err(|_| no_reply())?.result() {
            Ok(sample) => Ok(sample.payload().to_bytes().into_owned()),
            Err(error) => {
                let reason = error.payload().to_bytes();
                Err(RequestError::Rejected(String::from_utf8_lossy(&reason).into_owned()))
            }
        }
    }
}

fn connect_error(endpoint: &str, error: &zenoh::Error) -> RequestError {
    RequestError::Connect { endpoint: endpoint.to_owned(), reason: first_line(error) }
}

/// A request that a bridge received.
pub struct Received {
    /// Role of the sender.
    pub from: Role,
    /// The process that it is for.
    pub to: Participant,
    /// The request.
    pub text: String,
    /// When it was made, by the clock of this machine \[ns\].
    made_nanos: Option<u64>,
    query: Query,
}

impl Received {
    /// The request in `query`, of a sender with the role `from`; none if its key or its payload is
    /// no request.
    fn of(query: Query, from: &Role) -> Option<Self> {
        let name = query.key_expr().as_str().rsplit('/').next()?;
        let to = Participant::ALL.iter().copied().find(|to| to.text() == name)?;
        let text = query.payload()?.try_to_string().ok()?.into_owned();
        let made_nanos = match query.attachment() {
            Some(bytes) => Some(u64::from_le_bytes(bytes.to_bytes().as_ref().try_into().ok()?)),
            None => None,
        };
        Some(Self { from: from.clone(), to, text, made_nanos, query })
    }

    /// Time since it was made; 0 if its sender does not tell that.
    pub fn age(&self) -> Duration {
        let made = self.made_nanos.unwrap_or(u64::MAX);
        Duration::from_nanos(monotonic_nanos().saturating_sub(made))
    }

    /// Replies with the clock of this machine if the request asks for it; else returns it.
    fn unless_clock(self) -> Option<Self> {
        if self.to != Participant::Bridge || self.text != CLOCK {
            return Some(self);
        }
        match serde_json::to_vec(&ClockReply { monotonic_nanos: monotonic_nanos() }) {
            Ok(reply) => self.reply(&reply),
            Err(error) => self.reject(&error.to_string()),
        }
        None
    }

    /// Replies with an outcome as JSON. A sender that has gone gets none.
    pub fn reply(self, outcome: &[u8]) {
        let key = self.query.key_expr().clone();
        if let Err(error) = self.query.reply(key, outcome).wait() {
            tracing::debug!(%error, "no reply to a request");
        }
    }

    /// Rejects the request.
    pub fn reject(self, reason: &str) {
        if let Err(error) = self.query.reply_err(reason).wait() {
            tracing::debug!(%error, "no reply to a request");
        }
    }
}

/// Accepts requests until it is dropped.
pub struct Requests {
    _session: Client,
}

impl Requests {
    /// Listens at `endpoint` for operators and planners of the robot that `credentials` name.
    /// `take` gets each request, on a thread of zenoh: it must not wait.
    ///
    /// # Errors
    /// [`RequestError`] if the certificate cannot be used, or the endpoint is not available.
    pub fn open(
        endpoint: &str,
        credentials: &Credentials,
        take: impl Fn(Received) + Clone + Send + Sync + 'static,
    ) -> Result<Self, RequestError> {
        let robot = credentials.read()?.robot;
        let endpoint = over_tls(endpoint);
        let session = serve(&endpoint, credentials, &robot, &take);
        Ok(Self { _session: session.map_err(|error| connect_error(&endpoint, &error))? })
    }
}

/// A session that listens at `endpoint`, and gives each request to `take`.
fn serve(
    endpoint: &str,
    credentials: &Credentials,
    robot: &str,
    take: &(impl Fn(Received) + Clone + Send + Sync + 'static),
) -> Result<Client, zenoh::Error> {
    let mut config = quiet("router", BYTES_MAX)?;
    for (key, value) in [
        ("listen/endpoints", json!([endpoint])),
        ("listen/exit_on_failure", json!(true)),
        ("listen/timeout_ms", json!(0)),
        ("transport/unicast/max_sessions", json!(CLIENTS_MAX)),
        ("transport/unicast/accept_pending", json!(CLIENTS_MAX)),
    ] {
        config.insert_json5(key, &value.to_string())?;
    }
    let control = [("access_control", of_requests(robot))];
    let session = Client::open(guarded(config, credentials, &control)?)?;
    for role in ROLES {
        let (key, take) = (format!("coxswain-request/{robot}/{role}/*"), take.clone());
        let received = move |query| {
            if let Some(request) = Received::of(query, &role).and_then(Received::unless_clock) {
                take(request);
            }
        };
        session.declare_queryable(key).callback(received).background().wait()?;
    }
    Ok(session)
}
