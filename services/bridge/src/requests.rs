//! Requests of operators and planners ▶ files in the run directory, and the replies back.
//!
//! | role     | plant              | controller |
//! |----------|--------------------|------------|
//! | operator | arm, resume, stop  | goals      |
//! | planner  | lists of obstacles | goals      |
//!
//! Each cell of the table has its own queue and thread, so that a flood of goals delays no stop. A
//! request takes the same way as one on this machine. Orders and goals are files: the process
//! decides, and replies in a file ([`process::requests`]). Lists go to the socket of the plant
//! ([`process::lists`]), or to that of a driver outside the graph.

use crate::run::BridgeError;
use crate::settings::Settings;
use access::Role;
use network::keeps_strangers_out;
use network::requests::{Received, Requests};
use process::Stop;
use process::lists::{Lists, Verdict, socket};
use process::requests::{Request, Settlement, ask, is_goal};
use protocol::message::Participant;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::thread::{self, Scope};
use std::time::{Duration, Instant};

/// The cells of the table.
const PERMITTED: [(Role, Participant); 4] = [
    (Role::Operator, Participant::Plant),
    (Role::Operator, Participant::Controller),
    (Role::Planner, Participant::Plant),
    (Role::Planner, Participant::Controller),
];
/// Number of requests that may wait in a queue.
const WAITING_MAX: usize = 4;
/// Shortest time between two goals of a queue: each is a file that stays until the end of the run.
/// Orders to the plant do not wait.
const PAUSE: Duration = Duration::from_millis(50);
/// Longest wait for the reply of a process. A process that is restarted replies after its start.
const REPLIES_WITHIN: Duration = Duration::from_secs(15);
/// Interval between two looks at the stop request.
const LOOK: Duration = Duration::from_millis(100);

/// The open endpoint, and what the log has to tell of it.
pub(crate) struct Endpoint {
    rejected: Arc<AtomicU64>,
    _requests: Requests,
}

impl Endpoint {
    /// Listens for requests, if the settings say so, and starts a thread for each queue.
    pub(crate) fn open<'scope>(
        scope: &'scope Scope<'scope, '_>,
        settings: &'scope Settings,
        stop: &'scope Stop,
    ) -> Result<Option<Self>, BridgeError> {
        let (Some(endpoint), Some(credentials)) = (&settings.requests, &settings.credentials)
        else {
            return Ok(None);
        };
        let folder = settings.run.folder.as_path();
        let mut queues = Vec::new();
        for (role, to) in PERMITTED {
            let has_lists = role == Role::Planner && to == Participant::Plant;
            let socket = lists_socket(settings).filter(|_| has_lists);
            if socket.is_none() && !settings.processes.contains(&to) {
                continue;
            }
            let (sender, waiting) = sync_channel(WAITING_MAX);
            thread::Builder::new()
                .name(format!("{role} to {to}"))
                .spawn_scoped(scope, move || match socket {
                    Some(socket) => forward_all(socket, &waiting, stop),
                    None => process_all(folder, &waiting, stop),
                })
                .map_err(|_| BridgeError::Thread("cannot be started"))?;
            queues.push(Queue { role, to, sender });
        }
        let rejected = Arc::<AtomicU64>::default();
        let counted = Arc::clone(&rejected);
        let requests = Requests::open(endpoint, credentials, move |request| {
            let outcome = match admitted(&queues, &request) {
                Ok(queue) => queue.sender.try_send(request).map_err(|error| {
                    let (TrySendError::Full(request) | TrySendError::Disconnected(request)) = error;
                    request.reject(&format!("{WAITING_MAX} requests wait already"));
                }),
                Err(reason) => {
                    request.reject(&reason);
                    Err(())
                }
            };
            counted.fetch_add(u64::from(outcome.is_err()), Ordering::Relaxed);
        })?;
        // A restarted bridge skips this test: its endpoint has been tested, and the robot waits.
        if !settings.run.restarted {
            keeps_strangers_out(&access::from_here(endpoint), credentials)?;
        }
        tracing::info!(endpoint, "operators and planners can send requests");
        Ok(Some(Self { rejected, _requests: requests }))
    }

    /// Number of rejected requests so far.
    pub(crate) fn rejected(&self) -> u64 {
        self.rejected.load(Ordering::Relaxed)
    }
}

/// The socket where the plant takes lists of planners: that of this host's plant, or of a driver
/// outside the graph.
fn lists_socket(settings: &Settings) -> Option<PathBuf> {
    let own = settings.processes.contains(&Participant::Plant);
    let of_driver = || settings.remotes.iter().find_map(|remote| remote.lists.clone());
    own.then(|| socket(&settings.run.links.root)).or_else(of_driver)
}

/// Requests of one role to one process.
#[derive(Clone)]
struct Queue {
    role: Role,
    to: Participant,
    sender: SyncSender<Received>,
}

/// The queue for `request`.
///
/// # Errors
/// Why the request is rejected.
fn admitted<'a>(queues: &'a [Queue], request: &Received) -> Result<&'a Queue, String> {
    let Received { from, to, text, .. } = request;
    if !PERMITTED.contains(&(from.clone(), *to)) {
        return Err(format!("{from} may request nothing of the {to}"));
    }
    if *to == Participant::Controller && !is_goal(text) {
        return Err(format!("{from} may give goals to the controller, not change settings"));
    }
    let queue = queues.iter().find(|queue| queue.role == *from && queue.to == *to);
    queue.ok_or_else(|| format!("the {to} runs on another host: send the request there"))
}

/// Processes the requests of one queue until the end.
fn process_all(folder: &Path, waiting: &Receiver<Received>, stop: &Stop) {
    let mut last: Option<Instant> = None;
    while !stop.requested() {
        match waiting.recv_timeout(LOOK) {
            Ok(request) => {
                let rest = last.and_then(|last| PAUSE.checked_sub(last.elapsed()));
                if let Some(rest) = rest.filter(|_| request.to == Participant::Controller) {
                    thread::sleep(rest);
                }
                last = Some(Instant::now());
                process_one(folder, request, stop);
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}

/// Passes the lists of one queue to the plant, which listens at `socket`, until the end.
fn forward_all(socket: PathBuf, waiting: &Receiver<Received>, stop: &Stop) {
    let mut lists = Lists::at(socket);
    while !stop.requested() {
        match waiting.recv_timeout(LOOK) {
            Ok(received) => match lists.send(&received.text) {
                Ok(Verdict::Rejected { reason }) => received.reject(&reason),
                Ok(accepted) => match serde_json::to_vec(&accepted) {
                    Ok(reply) => received.reply(&reply),
                    Err(error) => received.reject(&error.to_string()),
                },
                Err(error) => received.reject(&format!("the plant cannot be reached: {error}")),
            },
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}

fn process_one(folder: &Path, received: Received, stop: &Stop) {
    let who = format!("{} over the network", received.from);
    let request = Request::new(who, received.text.as_str()).made_earlier(received.age());
    let settled = match ask(folder, received.to, &request) {
        Ok(asked) => asked.wait(REPLIES_WITHIN, || !stop.requested()),
        Err(error) => return received.reject(&format!("the request cannot be written: {error}")),
    };
    let outcome = settled.and_then(|settled| serde_json::to_vec(&Settlement::from(settled)).ok());
    if let Some(outcome) = outcome {
        received.reply(&outcome);
    } else {
        let to = received.to;
        received.reject(&format!("the {to} has not replied for {REPLIES_WITHIN:?}"));
    }
}
