//! The readers that one writer knows of: who has just come, and of those that it must not outrun,
//! how far each has come.

use super::keys::last;
use super::presence::Presence;
use std::collections::BTreeMap;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;
use zenoh::sample::{Sample, SampleKind};

pub(super) struct Readers {
    known: Mutex<Known>,
    moved: Condvar,
    /// Most of them at one time.
    places: usize,
}

/// A reader that has just come, or come back.
pub(super) struct Newcomer {
    pub(super) id: String,
    /// Of one that comes back: number of the last message that it has surely had.
    pub(super) had: Option<u64>,
}

/// Paced readers that are remembered, and as many that are cut off: more than there are places for.
const REMEMBERED_MAX: usize = 64;

#[derive(Default)]
struct Known {
    /// Number of the last message that a paced reader has made room for, by its id.
    taken: BTreeMap<String, u64>,
    /// The same of those that are cut off, and may come back.
    left: BTreeMap<String, u64>,
    /// Those that have not been given what they missed.
    newcomers: Vec<Newcomer>,
    /// Number of the last message that was sent.
    sent: u64,
}

impl Readers {
    /// None yet; `places` of them may be there at one time.
    pub(super) fn of(places: usize) -> Self {
        Self { known: Mutex::default(), moved: Condvar::new(), places }
    }

    /// Takes in that a token has come or gone.
    pub(super) fn presence_changed(&self, sample: &Sample) {
        let Some(presence) = Presence::of(sample.key_expr().as_str()) else { return };
        match sample.kind() {
            SampleKind::Put => self.came(&presence),
            SampleKind::Delete => {
                let mut known = self.lock();
                known.newcomers.retain(|newcomer| newcomer.id != presence.id);
                if let Some(taken) = known.taken.remove(presence.id) {
                    if known.left.len() >= REMEMBERED_MAX {
                        known.left.pop_first();
                    }
                    known.left.insert(presence.id.to_owned(), taken);
                }
                drop(known);
                self.moved.notify_all();
            }
        }
    }

    /// Takes in a reader, unless it is known.
    pub(super) fn came(&self, presence: &Presence<'_>) {
        let mut known = self.lock();
        let mut had = known.left.remove(presence.id);
        // Whoever may hear a topic can show as many tokens as he likes.
        if presence.is_paced()
            && (known.taken.len() < REMEMBERED_MAX || known.taken.contains_key(presence.id))
        {
            // One that was never seen to go may have missed something all the same.
            had = had.or_else(|| known.taken.get(presence.id).copied());
            let taken = had.unwrap_or(known.sent);
            known.taken.entry(presence.id.to_owned()).or_insert(taken);
        }
        if known.newcomers.len() < self.places
            && !known.newcomers.iter().any(|newcomer| newcomer.id == presence.id)
        {
            known.newcomers.push(Newcomer { id: presence.id.to_owned(), had });
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

    /// Waits until every paced reader has room for message `number`, or it is `deadline`, which is
    /// false.
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

    pub(super) fn take_newcomers(&self) -> Vec<Newcomer> {
        std::mem::take(&mut self.lock().newcomers)
    }

    fn lock(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
