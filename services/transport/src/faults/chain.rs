//! All faults of one end of one link, in sequence.

use super::anatomy::Anatomy;
use super::stage::Stage;
use std::collections::VecDeque;
use std::mem::take;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// On a lossless link: how long a reader waits in vain before it gets the withheld messages.
const QUIET: Duration = Duration::from_millis(100);

/// Takes messages in at one side and gives them out at the other.
pub(crate) struct Chain {
    stages: Vec<Stage>,
    anatomy: Anatomy,
    ready: VecDeque<Vec<u8>>,
    /// Since when the reader has found nothing; none if it has not looked since the last message.
    quiet_since: Option<Instant>,
    injected: Arc<[AtomicU64]>,
}

impl Chain {
    pub(super) fn new(stages: Vec<Stage>, anatomy: Anatomy, injected: Arc<[AtomicU64]>) -> Self {
        Self { stages, anatomy, ready: VecDeque::new(), quiet_since: None, injected }
    }

    /// Takes in one message.
    pub(super) fn take(&mut self, bytes: Vec<u8>, now: Instant) {
        self.quiet_since = None;
        self.pass(0, vec![bytes], now);
    }

    /// Releases the messages due at `now`.
    pub(super) fn release(&mut self, now: Instant) {
        self.let_out(now, false);
    }

    /// Releases the messages due at `now`, when no further message has arrived.
    pub(super) fn release_at_rest(&mut self, now: Instant) {
        let since = *self.quiet_since.get_or_insert(now);
        self.let_out(now, now.saturating_duration_since(since) >= QUIET);
    }

    fn let_out(&mut self, now: Instant, quiet: bool) {
        for index in 0..self.stages.len() {
            let mut out = Vec::new();
            if let Some(stage) = self.stages.get_mut(index) {
                if quiet && stage.withholds() {
                    stage.release_all(&mut out);
                } else {
                    stage.release(now, &mut out);
                }
            }
            self.pass(index + 1, out, now);
        }
    }

    /// Time at which a held message is due, if nothing else happens.
    pub(super) fn next_due(&self) -> Option<Instant> {
        let by_time = self.stages.iter().filter_map(Stage::next_due).min();
        let by_quiet = self
            .stages
            .iter()
            .any(Stage::withholds)
            .then_some(self.quiet_since)
            .flatten()
            .map(|since| since + QUIET);
        by_time.into_iter().chain(by_quiet).min()
    }

    /// The next released message.
    pub(super) fn pop(&mut self) -> Option<Vec<u8>> {
        self.ready.pop_front()
    }

    pub(super) fn is_ready(&self) -> bool {
        !self.ready.is_empty()
    }

    /// Sends `batch` through the stages from `first` on.
    fn pass(&mut self, first: usize, mut batch: Vec<Vec<u8>>, now: Instant) {
        for stage in self.stages.iter_mut().skip(first) {
            let before = stage.injected;
            for bytes in take(&mut batch) {
                stage.take(bytes, now, &self.anatomy, &mut batch);
            }
            if let Some(count) = self.injected.get(stage.index) {
                count.fetch_add(stage.injected - before, Ordering::Relaxed);
            }
        }
        self.ready.extend(batch);
    }
}

impl Drop for Chain {
    fn drop(&mut self) {
        for Stage { index, fault, seen, injected, .. } in &self.stages {
            tracing::info!(
                fault = index,
                topic = fault.topic.name(),
                at = ?fault.at,
                kind = fault.kind.name(),
                seen,
                injected,
                "faults were injected"
            );
        }
    }
}
