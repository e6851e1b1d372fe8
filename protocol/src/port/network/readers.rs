//! The readers that one writer knows of: who has just come, and of those that it must not outrun, how far each has come.

use super::keys::last;
use super::presence::Presence;
use std::collections::BTreeMap;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;
use zenoh::sample::{Sample, SampleKind};

#[derive(Default)]
pub(super) struct Readers {
    known: Mutex<Known>,
    moved: Condvar,
}

#[derive(Default)]
struct Known {
    /// Number of the last message that a paced reader has made room for, by its id.
    taken: BTreeMap<String, u64>,
    /// Those that have not been given the history.
    newcomers: Vec<String>,
    /// Number of the last message that was sent.
    sent: u64,
}

impl Readers {
    /// Takes in that a token has come or gone.
    pub(super) fn presence_changed(&self, sample: &Sample) {
        let Some(presence) = Presence::of(sample.key_expr().as_str()) else { return };
        match sample.kind() {
            SampleKind::Put => self.came(&presence),
            SampleKind::Delete => {
                let mut known = self.lock();
                known.taken.remove(presence.id);
                known.newcomers.retain(|id| id != presence.id);
                drop(known);
                self.moved.notify_all();
            }
        }
    }

    /// Takes in a reader, unless it is known.
    pub(super) fn came(&self, presence: &Presence<'_>) {
        let mut known = self.lock();
        let sent = known.sent;
        if presence.is_paced() && !known.taken.contains_key(presence.id) {
            known.taken.insert(presence.id.to_owned(), sent);
        }
        if !known.newcomers.iter().any(|id| id == presence.id) {
            known.newcomers.push(presence.id.to_owned());
        }
    }

    /// Takes in a room report.
    pub(super) fn room_made(&self, sample: &Sample) {
        let Ok(number) = <[u8; 8]>::try_from(&*sample.payload().to_bytes()) else { return };
        if let Some(taken) = self.lock().taken.get_mut(last(sample.key_expr().as_str())) {
            *taken = u64::from_le_bytes(number);
        }
        self.moved.notify_all();
    }

    /// Waits until every paced reader has room for message `number`, or it is `deadline`, which is false.
    pub(super) fn wait_for_room(&self, number: u64, depth: u64, deadline: Instant) -> bool {
        let mut known = self.lock();
        known.sent = number;
        while known.taken.values().any(|taken| number.saturating_sub(*taken) > depth) {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return false;
            }
            known = self.moved.wait_timeout(known, left).unwrap_or_else(PoisonError::into_inner).0;
        }
        true
    }

    pub(super) fn take_newcomers(&self) -> Vec<String> {
        std::mem::take(&mut self.lock().newcomers)
    }

    fn lock(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
