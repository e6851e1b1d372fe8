//! every process → launcher, recorder, watchers: its condition.

use super::define::message;
use super::kinds::text;
use super::{Exposure, Participant, Phase};
use crate::topic::TOPIC_COUNT;

/// Longest text of [`Health::last_error`] \[bytes\].
pub const ERROR_TEXT_MAX: usize = 120;

message! {
    /// Heartbeat and counters of one process instance. All counters start with the instance.
    Health = 7 {
        /// [`Participant`] that reports.
        participant: u32 = code(Participant),
        /// [`Phase`] it is in.
        phase: u32 = code(Phase),
        /// Process id.
        pid: u32,
        /// Bytes of `last_error` that count; 0 if all is well.
        error_len: u32 = count(ERROR_TEXT_MAX),
        /// What unauthenticated peers on the network can do: an [`Exposure`].
        exposure: u32 = code(Exposure),
        /// Zero.
        reserved: u32 = unused,
        /// Iterations of its loop.
        heartbeat: u64,
        /// Periods that it served in time.
        deadlines_met: u64,
        /// Periods that it did not serve in time, each counted once. The answer was missing, or
        /// late, or in time but without what was required.
        deadlines_missed: u64,
        /// Time in which the machine kept the process from running, and which it took out of its
        /// clock; only for the simulator \[ns\].
        stalled_nanos: u64,
        /// Version of the learned model in use, or last published; 0 is none.
        model_version: u64,
        /// Velocity axes on which the controller uses it: 1 forward, 2 left, 4 yaw, added up.
        learned_axes: u64,
        /// How often the controller has dropped a model on an axis, because it had become worse
        /// than none.
        models_left: u64,
        /// Model snapshots published (learner) or adopted (controller).
        snapshots: u64,
        /// Model snapshots refused.
        snapshots_refused: u64,
        /// Messages sent in the present epoch, by topic in the order of
        /// [`Topic::ALL`](crate::topic::Topic::ALL).
        sent: [u64; TOPIC_COUNT] = by_topic,
        /// Messages received, by topic.
        received: [u64; TOPIC_COUNT] = by_topic,
        /// Messages lost on the way to it, by topic.
        lost: [u64; TOPIC_COUNT] = by_topic,
        /// Messages refused as malformed, by topic.
        refused: [u64; TOPIC_COUNT] = by_topic,
        /// Messages sent and then dropped for newer ones in its own queue to the network, by topic.
        dropped: [u64; TOPIC_COUNT] = by_topic,
        /// The last error, UTF-8.
        last_error: [u8; ERROR_TEXT_MAX] = text(error_len),
    }
}

impl Health {
    /// The reporting process.
    pub fn participant(&self) -> Option<Participant> {
        Participant::try_from(self.participant).ok()
    }

    /// Its phase.
    pub fn phase(&self) -> Phase {
        Phase::try_from(self.phase).unwrap_or(Phase::Degraded)
    }

    /// What unauthenticated peers on the network can do.
    pub fn exposure(&self) -> Exposure {
        Exposure::try_from(self.exposure).unwrap_or(Exposure::Driven)
    }

    /// The last error; empty if all is well.
    pub fn last_error(&self) -> &str {
        text(&self.last_error, self.error_len as usize)
    }

    /// Keeps `text` as the last error, truncated to the space available.
    pub fn set_last_error(&mut self, text: &str) {
        let mut end = text.len().min(ERROR_TEXT_MAX);
        while !text.is_char_boundary(end) {
            end -= 1;
        }
        self.last_error = [0; ERROR_TEXT_MAX];
        for (slot, &byte) in self.last_error.iter_mut().zip(text.as_bytes().iter().take(end)) {
            *slot = byte;
        }
        self.error_len = end as u32;
    }
}
