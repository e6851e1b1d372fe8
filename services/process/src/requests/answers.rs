//! Replies of the processes ▶ observers.

use super::{Settled, answered};
use protocol::message::Participant;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Shortest interval between two checks.
const LOOK: Duration = Duration::from_millis(100);

/// Roles that accept requests.
const ROLES: [Participant; 3] = [Participant::Controller, Participant::Learner, Participant::Plant];

/// Reads the replies of all processes of a run: those of each process in order, each once.
#[derive(Debug)]
pub struct Answers {
    folder: PathBuf,
    /// Number of replies read, per role.
    read: [u64; ROLES.len()],
    look_at: Instant,
}

impl Answers {
    /// Reads from the first reply of the run in `folder` on.
    pub fn all(folder: &Path) -> Self {
        Self { folder: folder.to_owned(), read: Default::default(), look_at: Instant::now() }
    }

    /// Reads only replies that do not exist yet.
    pub fn from_now_on(folder: &Path) -> Self {
        Self { read: ROLES.map(|role| answered(folder, role)), ..Self::all(folder) }
    }

    /// New replies, at most ten checks per second.
    pub fn look(&mut self) -> Vec<Settled> {
        let now = Instant::now();
        if now < self.look_at {
            return Vec::new();
        }
        self.look_at = now + LOOK;
        self.look_now()
    }

    /// New replies, without the limit.
    pub fn look_now(&mut self) -> Vec<Settled> {
        let mut new = Vec::new();
        for (role, read) in ROLES.into_iter().zip(&mut self.read) {
            while let Some(settled) = Settled::read(&self.folder, role, *read + 1) {
                *read += 1;
                new.push(settled);
            }
        }
        new
    }
}
