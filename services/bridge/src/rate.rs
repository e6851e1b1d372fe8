//! The largest number of pieces of one topic that is accepted per second, in real time.

use crate::piece::PIECE_BYTES_MAX;
use protocol::topic::{Pace, Topic};
use std::time::Instant;

/// Accepted pieces for each one that a graph without faults sends.
const MULTIPLE: f64 = 4.0;
/// Pieces that may come at once: what a link holds back while it is cut for a second.
const BURST: f64 = 64.0;
/// Heartbeats of a process per second, with the changes of its phase.
const HEARTBEATS_PER_S: f64 = 20.0;
/// Pieces of a snapshot per second: as many as a link of 250 Mbit/s takes.
const SNAPSHOT_PIECES_PER_S: f64 = 2.5e8 / 8.0 / PIECE_BYTES_MAX as f64;

/// A token bucket.
#[derive(Debug)]
pub(crate) struct Rate {
    per_second: f64,
    tokens: f64,
    last: Instant,
}

impl Rate {
    /// For `topic` in a graph with the period `period_s` \[s\], from a host with so many
    /// `processes`.
    pub(crate) fn of(topic: Topic, period_s: f64, processes: usize, now: Instant) -> Self {
        let per_second = match topic.pace() {
            Pace::Heartbeats => HEARTBEATS_PER_S * processes as f64,
            Pace::Models => SNAPSHOT_PIECES_PER_S / MULTIPLE,
            Pace::Periods => 1.0 / period_s,
        };
        Self { per_second: MULTIPLE * per_second, tokens: BURST, last: now }
    }

    /// Whether one more piece is accepted at `now`.
    pub(crate) fn accepts(&mut self, now: Instant) -> bool {
        let elapsed = now.saturating_duration_since(self.last).as_secs_f64();
        self.last = now;
        self.tokens = (self.tokens + elapsed * self.per_second).min(BURST);
        let accepted = self.tokens >= 1.0;
        if accepted {
            self.tokens -= 1.0;
        }
        accepted
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn accepted(topic: Topic, per_second: u64, seconds: u64) -> u64 {
        let begin = Instant::now();
        let mut rate = Rate::of(topic, 0.02, 4, begin);
        (0..per_second * seconds)
            .filter(|index| {
                rate.accepts(begin + Duration::from_nanos(index * 1_000_000_000 / per_second))
            })
            .count() as u64
    }

    #[test]
    fn the_rate_of_a_graph_is_accepted() {
        assert_eq!(accepted(Topic::State, 50, 10), 500);
        assert_eq!(accepted(Topic::Health, 80, 10), 800);
    }

    #[test]
    fn of_a_flood_a_multiple_of_the_rate_is_accepted() {
        let accepted = accepted(Topic::State, 1_000_000, 1);
        assert!((200..=265).contains(&accepted), "{accepted}");
    }
}
