//! Operator ▶ a running process: changes of its settings and replies, as files in the run
//! directory.
//!
//! ```text
//! RUN/set/controller-000001.json           user, change and time             by `coxswain set`
//! RUN/set/controller-000001.answer.json    first tick, or the reason         by the process
//! ```
//! A request file is written atomically, and requests are numbered without a gap. A process handles
//! them in order, and replies to one before it reads the next. A restarted process first applies
//! the earlier changes again, then handles the requests without a reply.

mod answers;
mod ask;
mod inbox;

use protocol::message::Participant;
use serde::{Deserialize, Serialize};
use std::fmt::{self, Display, Formatter};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};
use std::{fs, io};

pub use answers::Answers;
pub use ask::{AskError, Asked, ask};
pub use inbox::{Inbox, NotAsked, changed_before, earlier_goal};

/// Directory of the requests in a run directory.
const FOLDER: &str = "set";

/// Longest request that is read \[bytes\].
const REQUEST_BYTES_MAX: u64 = 1 << 21;

/// First line of a request that is a goal for the controller, not a change of settings.
pub const GOAL_MARK: &str = "# goal";

/// Longest part of a request that is printed \[characters\].
const TOLD_MAX: usize = 200;

/// What a user requests of a process.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Request {
    /// Name of the person.
    pub who: String,
    /// Time of the request since 1970 \[ns\].
    pub asked_unix_nanos: u64,
    /// Keys with their new values, as lines of TOML; for the plant an order, `arm`, `resume` or
    /// `stop`; behind a line [`GOAL_MARK`] a goal.
    pub change: String,
}

/// Outcome of a request.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "outcome", rename_all = "kebab-case")]
pub enum Outcome {
    /// The whole change is in use.
    Applied {
        /// Epoch of the plant whose ticks these are.
        plant_epoch: u64,
        /// Tick at which the process read it.
        taken_at_tick: u64,
        /// Tick at which everything for it was checked and built.
        ready_at_tick: u64,
        /// First tick with the whole change in use; no part of it was in use before.
        acts_from_tick: u64,
    },
    /// No part of the change is in use.
    Refused {
        /// Kind of the reason, for programs. Replies of earlier versions have none.
        #[serde(default)]
        code: String,
        /// Why not.
        reason: String,
    },
}

impl Outcome {
    /// The refusal for `reason`, of the kind `code`.
    pub fn refused(code: &str, reason: &impl Display) -> Self {
        Self::Refused { code: code.to_owned(), reason: reason.to_string() }
    }
}

/// Reply of the process.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Answer {
    /// User id of the owner of the request's file.
    pub user: u32,
    /// Time of the reply on the monotonic clock \[ns\].
    pub answered_nanos: u64,
    /// Outcome.
    #[serde(flatten)]
    pub outcome: Outcome,
}

/// What the sender of a request learns.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Settlement {
    /// Number of the request, from 1, for each process apart.
    pub number: u64,
    /// The reply.
    #[serde(flatten)]
    pub answer: Answer,
}

/// A request with its answer.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Settled {
    /// Name of the process.
    pub process: String,
    /// Number of the request, from 1, for each process apart.
    pub number: u64,
    /// What was requested.
    #[serde(flatten)]
    pub request: Request,
    /// The reply.
    #[serde(flatten)]
    pub answer: Answer,
}

impl From<Settled> for Settlement {
    fn from(Settled { number, answer, .. }: Settled) -> Self {
        Self { number, answer }
    }
}

impl Settled {
    /// Request `number` of `role` in a run directory, if it has a reply. An unreadable request was
    /// rejected unread.
    pub fn read(folder: &Path, role: Participant, number: u64) -> Option<Self> {
        let answer: Answer =
            serde_json::from_slice(&fs::read(answer_file(folder, role, number)).ok()?).ok()?;
        let unread = Request { who: String::new(), asked_unix_nanos: 0, change: String::new() };
        let request = Request::read(&request_file(folder, role, number))
            .map_or(unread, |(request, _)| request);
        Some(Self { process: role.text().to_owned(), number, request, answer })
    }
}

/// In one line of limited length.
impl Display for Settled {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let short = |text: &str| {
            let line: String = text
                .trim()
                .replace('\n', ", ")
                .chars()
                .filter(|letter| !letter.is_control())
                .collect();
            if line.chars().count() <= TOLD_MAX {
                line
            } else {
                line.chars().take(TOLD_MAX).chain(" …".chars()).collect()
            }
        };
        let (who, change) = (short(&self.request.who), short(&self.request.change));
        match &self.answer.outcome {
            Outcome::Applied { acts_from_tick, .. }
                if self.process == Participant::Plant.text() =>
            {
                write!(f, "{who} ordered {change} at tick {acts_from_tick}")
            }
            Outcome::Applied { acts_from_tick, .. } if self.request.is_goal() => {
                write!(f, "{who} gave goal {} from tick {acts_from_tick} on", self.number)
            }
            Outcome::Applied { acts_from_tick, .. } => {
                write!(f, "{who} set {change} from tick {acts_from_tick} on")
            }
            Outcome::Refused { reason, .. } => write!(f, "refused to {who}: {}", short(reason)),
        }
    }
}

impl Request {
    /// A request of now.
    pub fn new(who: impl Into<String>, change: impl Into<String>) -> Self {
        let since_1970 =
            SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        let asked_unix_nanos = since_1970.as_nanos() as u64;
        Self { who: who.into(), asked_unix_nanos, change: change.into() }
    }

    /// The same request, made earlier `by` this time.
    #[must_use]
    pub fn made_earlier(self, by: Duration) -> Self {
        let by = u64::try_from(by.as_nanos()).unwrap_or(u64::MAX);
        Self { asked_unix_nanos: self.asked_unix_nanos.saturating_sub(by), ..self }
    }

    /// Time since the request; 0 for one from the future, made before the clock was set back.
    pub fn age(&self) -> Duration {
        let asked = SystemTime::UNIX_EPOCH + Duration::from_nanos(self.asked_unix_nanos);
        SystemTime::now().duration_since(asked).unwrap_or_default()
    }

    /// Time by which it was made before the request of `present_unix_nanos`; `None` if it was not.
    /// A request from the future, made before the clock was set back, has no order.
    pub fn made_before(&self, present_unix_nanos: u64) -> Option<Duration> {
        let present = SystemTime::UNIX_EPOCH + Duration::from_nanos(present_unix_nanos);
        let by = present_unix_nanos.checked_sub(self.asked_unix_nanos)?;
        (by > 0 && present <= SystemTime::now()).then(|| Duration::from_nanos(by))
    }

    /// Whether it is a goal.
    pub fn is_goal(&self) -> bool {
        is_goal(&self.change)
    }

    /// Reads a request, and the owner of its file.
    fn read(file: &Path) -> io::Result<(Self, u32)> {
        use std::os::unix::fs::MetadataExt;
        let about = fs::metadata(file)?;
        if !about.is_file() || about.len() > REQUEST_BYTES_MAX {
            return Err(io::Error::other(format!(
                "expected a file of at most {REQUEST_BYTES_MAX} bytes"
            )));
        }
        Ok((serde_json::from_slice(&fs::read(file)?).map_err(io::Error::other)?, about.uid()))
    }
}

/// Whether the `change` of a request is a goal.
pub fn is_goal(change: &str) -> bool {
    change.starts_with(GOAL_MARK)
}

/// Creates the directory of the requests for the processes of the run in `folder`.
///
/// # Errors
/// Error of the file system.
pub fn welcome(folder: &Path) -> io::Result<()> {
    fs::create_dir_all(folder.join(FOLDER))
}

/// Whether the run in `folder` accepts requests.
pub fn are_welcome(folder: &Path) -> bool {
    folder.join(FOLDER).is_dir()
}

fn request_file(folder: &Path, role: Participant, number: u64) -> PathBuf {
    folder.join(FOLDER).join(format!("{}-{number:06}.json", role.text()))
}

fn answer_file(folder: &Path, role: Participant, number: u64) -> PathBuf {
    folder.join(FOLDER).join(format!("{}-{number:06}.answer.json", role.text()))
}

/// Number of requests of a process that have a reply.
fn answered(folder: &Path, role: Participant) -> u64 {
    let mut number = 0;
    while answer_file(folder, role, number + 1).exists() {
        number += 1;
    }
    number
}

#[cfg(test)]
mod tests;
