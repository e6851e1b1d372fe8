//! A person ▶ a running process: changes to its settings, asked for and answered by files in the folder of the run.
//!
//! ```text
//! RUN/set/controller-000001.json           who requests what, since when     by `coxswain set`
//! RUN/set/controller-000001.answer.json    applied from which tick on, or why not     by the process itself
//! ```
//! A request is there whole or not at all, and requests are numbered without a gap: a process takes them up one after the other, and answers one
//! before it looks at the next. Who has been started again first does what was applied before it, then what nobody has answered.

mod answers;
mod ask;
mod inbox;

use protocol::message::Participant;
use serde::{Deserialize, Serialize};
use std::fmt::{self, Display, Formatter};
use std::path::{Path, PathBuf};
use std::{fs, io};

pub use answers::Answers;
pub use ask::{AskError, Asked, ask};
pub use inbox::{Inbox, NotAsked, changed_before};

/// The folder of the requests in that of a run.
const FOLDER: &str = "set";

/// Longest request that is read \[bytes\].
const REQUEST_BYTES_MAX: u64 = 1 << 16;

/// Longest part of a request that is told in words \[characters\].
const TOLD_MAX: usize = 200;

/// What a user requests of a process.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Request {
    /// Name of the person.
    pub who: String,
    /// When it was asked for, since 1970 \[ns\].
    pub asked_unix_nanos: u64,
    /// The keys with their new values, as lines of TOML; of the plant an order, `arm` or `resume`.
    pub change: String,
}

/// What the process made of it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "outcome", rename_all = "kebab-case")]
pub enum Outcome {
    /// All of it is in use.
    Applied {
        /// Epoch of the plant whose ticks these are.
        plant_epoch: u64,
        /// The period in which the process took it up.
        taken_at_tick: u64,
        /// The period in which all that it needs had been checked and built.
        ready_at_tick: u64,
        /// The first period for which all of it is in use; nothing of it was before.
        acts_from_tick: u64,
    },
    /// Nothing of it is in use.
    Refused {
        /// Why not.
        reason: String,
    },
}

/// Its answer.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Answer {
    /// User id of the owner of the request's file.
    pub user: u32,
    /// When it was answered, on the monotonic clock \[ns\].
    pub answered_nanos: u64,
    /// What came of it.
    #[serde(flatten)]
    pub outcome: Outcome,
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
    /// What came of it.
    #[serde(flatten)]
    pub answer: Answer,
}

impl Settled {
    /// Request `number` of `role` in the folder of a run, if it has been answered. One that could not be read was refused unread.
    pub fn read(folder: &Path, role: Participant, number: u64) -> Option<Self> {
        let answer: Answer =
            serde_json::from_slice(&fs::read(answer_file(folder, role, number)).ok()?).ok()?;
        let unread = Request { who: String::new(), asked_unix_nanos: 0, change: String::new() };
        let request = Request::read(&request_file(folder, role, number))
            .map_or(unread, |(request, _)| request);
        Some(Self { process: role.text().to_owned(), number, request, answer })
    }
}

/// In one line, not longer than a person reads.
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
            Outcome::Applied { acts_from_tick, .. } => {
                write!(f, "{who} set {change} from tick {acts_from_tick} on")
            }
            Outcome::Refused { reason } => write!(f, "refused to {who}: {}", short(reason)),
        }
    }
}

impl Request {
    /// Reads a request, and who owns its file.
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

/// Lets the processes of the run in `folder` be asked.
///
/// # Errors
/// What the file system says.
pub fn welcome(folder: &Path) -> io::Result<()> {
    fs::create_dir_all(folder.join(FOLDER))
}

fn request_file(folder: &Path, role: Participant, number: u64) -> PathBuf {
    folder.join(FOLDER).join(format!("{}-{number:06}.json", role.text()))
}

fn answer_file(folder: &Path, role: Participant, number: u64) -> PathBuf {
    folder.join(FOLDER).join(format!("{}-{number:06}.answer.json", role.text()))
}

/// How many requests of a process have been answered.
fn answered(folder: &Path, role: Participant) -> u64 {
    let mut number = 0;
    while answer_file(folder, role, number + 1).exists() {
        number += 1;
    }
    number
}

#[cfg(test)]
mod tests;
