//! What has been answered ▶ whoever only looks on.

use super::{Settled, answered};
use protocol::message::Participant;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// How often it is looked for more.
const LOOK: Duration = Duration::from_millis(100);

/// Who can be asked.
const ROLES: [Participant; 3] = [Participant::Controller, Participant::Learner, Participant::Plant];

/// The answers of all processes of a run: those of each in order, each once.
#[derive(Debug)]
pub struct Answers {
    folder: PathBuf,
    /// Of each role, how many have been read.
    read: [u64; ROLES.len()],
    look_at: Instant,
}

impl Answers {
    /// From the first of the run in `folder` on.
    pub fn all(folder: &Path) -> Self {
        Self { folder: folder.to_owned(), read: Default::default(), look_at: Instant::now() }
    }

    /// Those that are not there yet.
    pub fn from_now_on(folder: &Path) -> Self {
        Self { read: ROLES.map(|role| answered(folder, role)), ..Self::all(folder) }
    }

    /// What is new, not more often than ten times a second.
    pub fn look(&mut self) -> Vec<Settled> {
        let now = Instant::now();
        if now < self.look_at {
            return Vec::new();
        }
        self.look_at = now + LOOK;
        self.look_now()
    }

    /// What is new at this moment.
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
