//! operator or planner → bridge: requests to a process of the bridge's host.
//!
//! A request is a zenoh query over TLS, with a certificate at both ends:
//!
//! | part        | contents                                                                |
//! |-------------|-------------------------------------------------------------------------|
//! | key         | `coxswain-request/<robot>/<role>/<process>`                             |
//! | payload     | text: the `change` of a request file (`process::requests`)              |
//! | reply       | the outcome as JSON, as in the file of the reply                        |
//! | error reply | text: why the bridge rejects the request                                |
//!
//! Access control lets a role use its own key alone ([`access::of_requests`]).

use crate::reason::first_line;
use crate::threads::Client;
use crate::{guarded, over_tls};
use access::{AccessError, Certificate, Credentials, Role, of_requests};
use protocol::message::Participant;
use serde_json::json;
use std::thread;
use std::time::{Duration, Instant};
use zenoh::handlers::FifoChannel;
use zenoh::query::Query;
use zenoh::{Config, Wait};

/// The roles that may send requests.
pub const ROLES: [Role; 2] = [Role::Operator, Role::Planner];

/// Longest message, with all that zenoh adds \[bytes\]: a path of 10 000 points is shorter.
const BYTES_MAX: usize = 2 << 20;
/// Most clients at one time.
const CLIENTS_MAX: usize = 16;
/// How long the other end may take to identify itself \[ms\].
const OPEN_TIMEOUT_MILLIS: u64 = 3000;
/// A session ends after its other end has been silent for so long \[ms\].
const LEASE_MILLIS: u64 = 2000;
/// How long a client waits for a reply.
const REPLY_WITHIN: Duration = Duration::from_secs(20);
/// How long a client waits until the bridge knows its session.
const KNOWN_WITHIN: Duration = Duration::from_secs(3);
/// Pause between two attempts in that time.
const PAUSE: Duration = Duration::from_millis(20);

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
            let mut config = config("client")?;
            for (key, value) in
                [("connect/endpoints", json!([endpoint])), ("connect/timeout_ms", json!(0))]
            {
                config.insert_json5(key, &value.to_string())?;
            }
            Client::open(guarded(config, credentials, &[])?)
        };
        let session = open().map_err(|error| connect_error(&endpoint, &error))?;
        Ok(Self { endpoint, robot, role, session })
    }

    /// Sends the request `text` for the process `to`, and waits for the reply. Returns the outcome
    /// as JSON.
    ///
    /// # Errors
    /// [`RequestError`]. Without a reply, it is not known whether the request was processed.
    pub fn ask(&self, to: Participant, text: &str) -> Result<Vec<u8>, RequestError> {
        let Self { endpoint, robot, role, session } = self;
        let key = format!("coxswain-request/{robot}/{role}/{}", to.text());
        let begin = Instant::now();
        loop {
            let replies = session
                .get(&key)
                .payload(text)
                .timeout(REPLY_WITHIN)
                .with(FifoChannel::new(1))
                .wait()
                .map_err(|error| connect_error(endpoint, &error))?;
            if let Ok(reply) = replies.recv() {
                return match reply.result() {
                    Ok(sample) => Ok(sample.payload().to_bytes().into_owned()),
                    Err(error) => {
                        let reason = error.payload().to_bytes();
                        let reason = String::from_utf8_lossy(&reason).into_owned();
                        Err(RequestError::Rejected(reason))
                    }
                };
            }
            // zenoh ends a query at once while it knows of nobody who replies.
            if begin.elapsed() >= KNOWN_WITHIN {
                let (endpoint, role) = (endpoint.clone(), role.clone());
                return Err(RequestError::NoReply { endpoint, role, to });
            }
            thread::sleep(PAUSE);
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
    query: Query,
}

impl Received {
    /// The request in `query`, of a sender with the role `from`; none if its key or its payload is
    /// no request.
    fn of(query: Query, from: &Role) -> Option<Self> {
        let name = query.key_expr().as_str().rsplit('/').next()?;
        let to = Participant::ALL.iter().copied().find(|to| to.text() == name)?;
        let text = query.payload()?.try_to_string().ok()?.into_owned();
        Some(Self { from: from.clone(), to, text, query })
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
    let mut config = config("router")?;
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
            if let Some(request) = Received::of(query, &role) {
                take(request);
            }
        };
        session.declare_queryable(key).callback(received).background().wait()?;
    }
    Ok(session)
}

fn config(mode: &str) -> Result<Config, zenoh::Error> {
    let mut config = Config::default();
    for (key, value) in [
        ("mode", json!(mode)),
        ("connect/endpoints", json!([])),
        ("listen/endpoints", json!([])),
        ("adminspace/enabled", json!(false)),
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/enabled", json!(false)),
        // Otherwise opening takes this long, to wait for peers that discovery might find.
        ("scouting/delay", json!(0)),
        ("transport/unicast/open_timeout", json!(OPEN_TIMEOUT_MILLIS)),
        ("transport/unicast/accept_timeout", json!(OPEN_TIMEOUT_MILLIS)),
        ("transport/link/tx/lease", json!(LEASE_MILLIS)),
        ("transport/link/rx/max_message_size", json!(BYTES_MAX)),
    ] {
        config.insert_json5(key, &value.to_string())?;
    }
    Ok(config)
}
