//! Health → the present state of a process, and what has changed.

use crate::event::{Counter, What};
use protocol::message::{Health, Phase};
use std::time::{Duration, Instant};

/// Time without a Health after which a process counts as silent: ten heartbeats.
pub const SILENCE: Duration = Duration::from_secs(1);
/// Shortest time between two events of a counter that grows.
const COUNTS_EVERY: Duration = Duration::from_secs(1);

/// One process, as of its last Health.
#[derive(Debug, Clone, PartialEq)]
pub struct Process {
    /// Its last Health.
    pub health: Box<Health>,
    /// When the Health was received.
    pub received: Instant,
    /// Number of its instances so far.
    pub starts: u32,
    silent: bool,
    counted: [u64; Counter::ALL.len()],
    counts_next: Instant,
}

impl Process {
    /// A process after its first message.
    pub(crate) fn new(health: &Health, now: Instant) -> Self {
        Self {
            health: Box::new(*health),
            received: now,
            starts: 1,
            silent: false,
            counted: Counter::ALL.map(|counter| counter.of(health)),
            counts_next: now,
        }
    }

    /// Takes in its next message, and returns what has changed.
    pub(crate) fn update(&mut self, health: &Health, now: Instant) -> Vec<What> {
        let before = std::mem::replace(&mut *self.health, *health);
        let mut changes = Vec::new();
        let (pid, writer) = (health.pid, health.stamp.writer);
        let another = (before.pid, before.stamp.writer) != (pid, writer);
        if another {
            self.starts += 1;
            self.counted = [0; Counter::ALL.len()];
            changes.push(What::Restarted(pid));
        } else if self.silent {
            changes.push(What::SendsAgain);
        }
        (self.received, self.silent) = (now, false);
        let (from, to, error) = (before.phase(), health.phase(), health.last_error());
        if !error.is_empty() && (another || error != before.last_error()) {
            changes.push(What::Error(to, error.to_owned()));
        } else if from != to && !another {
            changes.push(What::Phase(from, to));
        }
        if now >= self.counts_next {
            self.count(now, &mut changes);
        }
        changes
    }

    fn count(&mut self, now: Instant, changes: &mut Vec<What>) {
        for (counter, told) in Counter::ALL.into_iter().zip(&mut self.counted) {
            let newest = counter.of(&self.health);
            let more = newest.saturating_sub(std::mem::replace(told, newest));
            if more > 0 {
                changes.push(What::Counted(counter, more));
                self.counts_next = now + COUNTS_EVERY;
            }
        }
    }

    /// Whether it is silent at `now`. A finished process may be silent.
    pub fn is_silent(&self, now: Instant) -> bool {
        now.saturating_duration_since(self.received) > SILENCE
            && self.health.phase() != Phase::Finished
    }

    /// Whether it has become silent since the last call.
    pub(crate) fn falls_silent(&mut self, now: Instant) -> bool {
        let silent = self.is_silent(now);
        !std::mem::replace(&mut self.silent, silent) && silent
    }
}
