//! The last message of each writer: finds lost and stale messages.

use protocol::message::Stamp;

/// Most writers that are remembered at a time: twice as many as a topic can have at once, so that
/// each can be replaced.
const WRITERS_MAX: usize = 32;

/// From which message on losses count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Since {
    /// The reader was open before the writers: losses count from sequence 1.
    First,
    /// A late joiner: counting begins with the first message seen of each writer.
    Joining,
    /// A late joiner that passes messages on: one that its writer repeats is new, because it may
    /// have been lost behind the joiner.
    Relaying,
}

/// Result of a stamp, compared with the messages before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Place {
    /// New, with a number of messages lost before it.
    New {
        /// Messages between the last one and this one.
        lost: u64,
    },
    /// Not newer than an earlier message of the same writer in the same epoch.
    Stale,
}

#[derive(Debug, Clone, Copy)]
struct Latest {
    writer: u64,
    epoch: u64,
    sequence: u64,
}

/// The writers of one topic, the most recent first. Does not allocate after it is made.
#[derive(Debug)]
pub(super) struct Sequences {
    since: Since,
    latest: Vec<Latest>,
}

impl Sequences {
    pub(super) fn new(since: Since) -> Self {
        Self { since, latest: Vec::with_capacity(WRITERS_MAX) }
    }

    /// Judges the next message and remembers it. O(number of writers).
    pub(super) fn place(&mut self, stamp: &Stamp) -> Place {
        let known = self
            .latest
            .iter()
            .position(|latest| latest.writer == stamp.writer && latest.epoch == stamp.epoch);
        let last = known
            .and_then(|index| self.latest.get(index))
            .map_or_else(|| self.start(stamp), |latest| latest.sequence);
        if stamp.sequence <= last {
            let is_repeated = known.is_some() && stamp.sequence == last;
            return if is_repeated && self.since == Since::Relaying {
                Place::New { lost: 0 }
            } else {
                Place::Stale
            };
        }
        let latest = Latest { writer: stamp.writer, epoch: stamp.epoch, sequence: stamp.sequence };
        let end = if let Some(index) = known {
            index + 1
        } else {
            self.latest.truncate(WRITERS_MAX - 1);
            self.latest.push(latest);
            self.latest.len()
        };
        if let Some(fresh) = self.latest.get_mut(..end) {
            fresh.rotate_right(1);
        }
        if let Some(first) = self.latest.first_mut() {
            *first = latest;
        }
        Place::New { lost: stamp.sequence - last - 1 }
    }

    /// Sequence number before the first message of a new writer and epoch.
    fn start(&self, stamp: &Stamp) -> u64 {
        let new_epoch = self.latest.iter().any(|latest| latest.writer == stamp.writer);
        match self.since {
            Since::Joining | Since::Relaying if !new_epoch => stamp.sequence.saturating_sub(1),
            Since::First | Since::Joining | Since::Relaying => 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stamp(writer: u64, epoch: u64, sequence: u64) -> Stamp {
        Stamp { writer, epoch, sequence, ..Stamp::default() }
    }

    #[test]
    fn a_gap_is_as_long_as_what_is_missing() {
        let mut sequences = Sequences::new(Since::First);
        assert_eq!(sequences.place(&stamp(1, 1, 3)), Place::New { lost: 2 });
        assert_eq!(sequences.place(&stamp(1, 1, 4)), Place::New { lost: 0 });
        assert_eq!(sequences.place(&stamp(1, 1, u64::MAX)), Place::New { lost: u64::MAX - 5 });
    }

    #[test]
    fn a_relay_takes_the_last_message_again_and_no_older_one() {
        let mut sequences = Sequences::new(Since::Relaying);
        for (sequence, place) in [
            (3, Place::New { lost: 0 }),
            (4, Place::New { lost: 0 }),
            (4, Place::New { lost: 0 }),
            (3, Place::Stale),
        ] {
            assert_eq!(sequences.place(&stamp(1, 1, sequence)), place);
        }
    }

    #[test]
    fn a_late_joiner_counts_from_what_it_sees_first_of_each_writer() {
        let mut sequences = Sequences::new(Since::Joining);
        assert_eq!(sequences.place(&stamp(1, 1, 30)), Place::New { lost: 0 });
        assert_eq!(sequences.place(&stamp(2, 1, 40)), Place::New { lost: 0 });
        assert_eq!(
            sequences.place(&stamp(1, 2, 2)),
            Place::New { lost: 1 },
            "it was there when the epoch began"
        );
    }

    #[test]
    fn repeated_and_late_messages_are_stale() {
        let mut sequences = Sequences::new(Since::Joining);
        assert_eq!(sequences.place(&stamp(1, 1, 0)), Place::Stale, "sequences count from 1");
        assert_eq!(sequences.place(&stamp(1, 1, 5)), Place::New { lost: 0 });
        assert_eq!(sequences.place(&stamp(1, 1, 5)), Place::Stale);
        assert_eq!(sequences.place(&stamp(1, 1, 4)), Place::Stale);
    }

    #[test]
    fn of_too_many_writers_the_one_silent_longest_is_forgotten() {
        let mut sequences = Sequences::new(Since::First);
        for writer in 0..WRITERS_MAX as u64 {
            assert_eq!(sequences.place(&stamp(writer, 1, 1)), Place::New { lost: 0 });
        }
        assert_eq!(sequences.place(&stamp(0, 1, 2)), Place::New { lost: 0 });
        assert_eq!(sequences.place(&stamp(99, 1, 1)), Place::New { lost: 0 });
        assert_eq!(sequences.place(&stamp(0, 1, 2)), Place::Stale, "still known");
        assert_eq!(sequences.place(&stamp(1, 1, 1)), Place::New { lost: 0 }, "forgotten");
    }
}
