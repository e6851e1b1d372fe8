//! The process's side: requests in order, and the replies.

use super::{Answer, Outcome, Request, Settled, answer_file, answered, are_welcome, request_file};
use crate::{HasRun, Pace, Run, atomic_file};
use protocol::clock::monotonic_nanos;
use protocol::message::Participant;
use serde::Serialize;
use serde::de::DeserializeOwned;
use settings::Check;
use settings::change::{Change, ChangeError, Rules, changed};
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Shortest interval between two checks.
const LOOK: Duration = Duration::from_millis(2);

/// Why a request is rejected before its change is examined.
#[derive(Debug, thiserror::Error)]
pub enum NotAsked {
    /// In lock step, the same settings must give the same bits at every speed of the clock.
    #[error(
        "in lock step settings cannot change during the run: the same settings give the same bits"
    )]
    LockStep,
    /// The file is not a request.
    #[error("this is not a request: {0}")]
    NotARequest(#[source] io::Error),
}

impl NotAsked {
    /// Its kind, for programs.
    pub fn code(&self) -> &'static str {
        match self {
            Self::LockStep => "lock-step",
            Self::NotARequest(_) => "syntax",
        }
    }
}

/// The requests to one process.
#[derive(Debug)]
pub struct Inbox {
    folder: PathBuf,
    role: Participant,
    pace: Pace,
    /// Whether the run accepts requests.
    open: bool,
    /// Number of the next request.
    next: u64,
    /// User id of the owner of the last request's file.
    user: u32,
    look_at: Instant,
}

impl Inbox {
    /// Requests to the process of `role` in a run, after the last one with a reply.
    pub fn open(run: &Run, role: Participant) -> Self {
        let folder = run.folder.clone();
        let open = are_welcome(&folder);
        let next = answered(&folder, role) + 1;
        Self { folder, role, pace: run.pace, open, next, user: 0, look_at: Instant::now() }
    }

    /// Whether the run accepts requests.
    pub fn is_open(&self) -> bool {
        self.open
    }

    /// Number of the request that is taken now.
    pub fn number(&self) -> u64 {
        self.next
    }

    /// The next request, if there is one. Without one, it only checks for one file name, at most
    /// every 2 ms. [Answer](Self::answer) the request before the next call.
    pub fn take(&mut self) -> Option<Result<Request, NotAsked>> {
        let now = Instant::now();
        if !self.open || now < self.look_at {
            return None;
        }
        self.look_at = now + LOOK;
        let (request, user) = match Request::read(&request_file(&self.folder, self.role, self.next))
        {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return None,
            Err(error) => return Some(Err(NotAsked::NotARequest(error))),
            Ok(read) => read,
        };
        self.user = user;
        Some(if self.pace == Pace::LockStep { Err(NotAsked::LockStep) } else { Ok(request) })
    }

    /// Replies to the last request. It is not returned again.
    pub fn answer(&mut self, outcome: Outcome) {
        let number = self.next;
        match &outcome {
            Outcome::Applied { acts_from_tick, .. } => {
                tracing::info!(number, acts_from_tick, "set");
            }
            Outcome::Refused { reason, .. } => tracing::info!(number, %reason, "not set"),
        }
        let file = answer_file(&self.folder, self.role, number);
        let answer = Answer { user: self.user, answered_nanos: monotonic_nanos(), outcome };
        if let Err(error) = write(&file, &answer) {
            tracing::warn!(%error, file = %file.display(), "the reply cannot be written");
        }
        self.next += 1;
        self.look_at = Instant::now();
    }
}

/// Writes the file atomically.
fn write(file: &Path, answer: &Answer) -> io::Result<()> {
    atomic_file::write(file, &serde_json::to_vec(answer).map_err(io::Error::other)?)
}

/// The last goal that was applied earlier in this run, and its number: for a restarted process.
pub fn earlier_goal(run: &Run, role: Participant) -> Option<(u64, Request)> {
    let settled = (1..).map_while(|number| Settled::read(&run.folder, role, number));
    let goals = settled.filter(|settled| {
        settled.request.is_goal() && matches!(settled.answer.outcome, Outcome::Applied { .. })
    });
    goals.last().map(|settled| (settled.number, settled.request))
}

/// `settings` with all changes applied earlier in this run, and their number: for a restarted
/// process.
///
/// # Errors
/// [`ChangeError`] if a change contradicts the settings. That means that the settings were edited
/// in between.
pub fn changed_before<S>(
    settings: &S,
    role: Participant,
    rules: &Rules<'_>,
) -> Result<(S, usize), ChangeError>
where
    S: Serialize + DeserializeOwned + Check + HasRun + Clone,
{
    let settled = (1..).map_while(|number| Settled::read(&settings.run().folder, role, number));
    let applied =
        settled.filter(|settled| matches!(settled.answer.outcome, Outcome::Applied { .. }));
    let applied = applied.filter(|settled| !settled.request.is_goal());
    let changes = applied
        .map(|settled| Change::parse(&settled.request.change))
        .collect::<Result<Vec<_>, _>>()?;
    // Most runs have no changes.
    let settings =
        if changes.is_empty() { settings.clone() } else { changed(settings, &changes, rules)? };
    Ok((settings, changes.len()))
}
