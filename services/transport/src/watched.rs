//! One writer of a lossless link, and its watchers.
//!
//! In lock step a writer waits for its readers. It must not wait for a watcher, and a link on
//! shared memory is lossless for all of its readers or for none. So the writer has a second sender
//! beside the first, where the newest wins.

use super::SendError;
use super::carrier::Sender;
use protocol::topic::{Delivery, Quality, Topic};

/// The readers of a sender.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Audience {
    /// The readers that determine the result of a run.
    Members,
    /// The readers that only watch.
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

/// Sends each message twice: first to the members, then to the watchers.
pub(super) struct Watched<O> {
    pub(super) members: O,
    pub(super) watchers: O,
}

impl<O: Sender> Sender for Watched<O> {
    fn send(&mut self, length: usize, fill: &mut dyn FnMut(&mut [u8])) -> Result<(), SendError> {
        let sent = self.members.send(length, fill);
        // A failure to reach a watcher is no failure of the link.
        let _ = self.watchers.send(length, fill);
        sent
    }

    fn refresh(&mut self) -> Result<(), SendError> {
        let _ = self.watchers.refresh();
        self.members.refresh()
    }
}
