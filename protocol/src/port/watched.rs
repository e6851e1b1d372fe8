//! One writer of a lossless link, and those who only look on.
//!
//! In lock step a writer waits for its readers. One who only looks on shall not be waited for, and a link on shared memory is lossless
//! for all of its readers or for none. So the writer has a second outlet, where the newest wins, beside the first.

use super::SendError;
use super::carrier::Outlet;
use crate::topic::{Delivery, Quality, Topic};

/// Who reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Audience {
    /// Those whom the result of a run depends on.
    Members,
    /// Those who only look on.
    Watchers,
}

impl Audience {
    /// Whether members and watchers of `topic` are served apart.
    pub(super) fn is_split(topic: Topic, lock_step: bool) -> bool {
        topic.quality(lock_step).delivery == Delivery::Lossless
    }

    /// Quality of service for this audience.
    pub(super) fn quality(self, topic: Topic, lock_step: bool) -> Quality {
        match self {
            Self::Watchers if Self::is_split(topic, lock_step) => topic.watched_quality(),
            Self::Members | Self::Watchers => topic.quality(lock_step),
        }
    }
}

/// Says everything twice: first to the members, then to the watchers.
pub(super) struct Watched<O> {
    pub(super) members: O,
    pub(super) watchers: O,
}

impl<O: Outlet> Outlet for Watched<O> {
    fn send(&mut self, length: usize, fill: &mut dyn FnMut(&mut [u8])) -> Result<(), SendError> {
        let sent = self.members.send(length, fill);
        // That somebody could not look on is nobody's failure.
        let _ = self.watchers.send(length, fill);
        sent
    }

    fn refresh(&mut self) -> Result<(), SendError> {
        let _ = self.watchers.refresh();
        self.members.refresh()
    }

    fn dropped(&self) -> u64 {
        self.members.dropped()
    }
}
