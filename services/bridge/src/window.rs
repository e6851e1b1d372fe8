//! Pieces that the other host has not acknowledged yet.

use std::collections::VecDeque;
use std::time::{Duration, Instant};
use zenoh::bytes::ZBytes;

use crate::piece::Label;

/// Time without an acknowledgement after which a piece counts as lost. A full window in real time
/// takes that long at half a megabit per second.
pub(crate) const LOST_AFTER: Duration = Duration::from_millis(500);

/// Pieces on their way, in order.
#[derive(Debug)]
pub(crate) struct Window {
    capacity: usize,
    pieces: VecDeque<(Label, ZBytes)>,
    /// Time of the last progress: of the first piece on its way, or of the last acknowledgement.
    since: Instant,
}

impl Window {
    /// At most `capacity` pieces may be on their way.
    pub(crate) fn new(capacity: usize, now: Instant) -> Self {
        Self { capacity, pieces: VecDeque::new(), since: now }
    }

    pub(crate) fn is_full(&self) -> bool {
        self.pieces.len() >= self.capacity
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.pieces.is_empty()
    }

    /// Adds a piece that is sent now.
    pub(crate) fn add(&mut self, label: Label, bytes: ZBytes, now: Instant) {
        if self.pieces.is_empty() {
            self.since = now;
        }
        self.pieces.push_back((label, bytes));
    }

    /// The other host has all pieces up to the number `through`.
    pub(crate) fn acknowledge(&mut self, through: u64, now: Instant) {
        while self.pieces.front().is_some_and(|(label, _)| label.number <= through) {
            self.pieces.pop_front();
            self.since = now;
        }
    }

    /// Whether the first piece counts as lost.
    pub(crate) fn is_overdue(&self, now: Instant) -> bool {
        !self.pieces.is_empty() && now.saturating_duration_since(self.since) >= LOST_AFTER
    }

    /// All pieces, to be sent again now.
    pub(crate) fn again(&mut self, now: Instant) -> impl Iterator<Item = &(Label, ZBytes)> {
        self.since = now;
        self.pieces.iter()
    }

    /// Gives all pieces up.
    pub(crate) fn clear(&mut self) {
        self.pieces.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn label(number: u64) -> Label {
        Label { instance: 1, number, offset: 0, length: 1 }
    }

    #[test]
    fn a_full_window_takes_pieces_again_after_an_acknowledgement() {
        let now = Instant::now();
        let mut window = Window::new(2, now);
        for number in 1..=2 {
            window.add(label(number), ZBytes::new(), now);
        }
        assert!(window.is_full());
        window.acknowledge(1, now);
        assert!(!window.is_full() && !window.is_empty());
        window.acknowledge(2, now);
        assert!(window.is_empty());
    }

    #[test]
    fn what_is_not_acknowledged_in_time_is_sent_again_in_order() {
        let now = Instant::now();
        let mut window = Window::new(8, now);
        for number in 1..=3 {
            window.add(label(number), ZBytes::new(), now);
        }
        assert!(!window.is_overdue(now));
        window.acknowledge(1, now + LOST_AFTER / 2);
        assert!(!window.is_overdue(now + LOST_AFTER));
        let late = now + 2 * LOST_AFTER;
        assert!(window.is_overdue(late));
        let again: Vec<u64> = window.again(late).map(|(label, _)| label.number).collect();
        assert_eq!(again, [2, 3]);
        assert!(!window.is_overdue(late));
    }
}
