//! every process → launcher, recorder, watchers: its condition.

use super::{Exposure, Participant, Phase, Stamp, check_count, fixed_message};
use crate::frame::code;
use crate::topic::TOPIC_COUNT;
use bytemuck::{Pod, Zeroable};
use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;

/// Longest text of [`Health::last_error`] \[bytes\].
pub const ERROR_TEXT_MAX: usize = 120;

/// Heartbeat and counters of one process instance. All counters start with the instance.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct Health {
    /// Writer and time.
    pub stamp: Stamp,
    /// [`Participant`] that reports.
    pub participant: u32,
    /// [`Phase`] it is in.
    pub phase: u32,
    /// Process id.
    pub pid: u32,
    /// Bytes of `error_text` that count; 0 if all is well.
    pub error_len: u32,
    /// What unauthenticated peers on the network can do: an [`Exposure`].
    pub exposure: u32,
    /// Zero.
    pub reserved: u32,
    /// Iterations of its loop.
    pub heartbeat: u64,
    /// Periods that it served in time.
    pub deadlines_met: u64,
    /// Periods that it did not serve in time, each counted once. The answer was missing, or late,
    /// or in time but without what was required.
    pub deadlines_missed: u64,
    /// Time in which the machine kept the process from running, and which it took out of its clock;
    /// only for the simulator \[ns\].
    pub stalled_nanos: u64,
    /// Version of the learned model in use, or last published; 0 is none.
    pub model_version: u64,
    /// Velocity axes on which the controller uses it: 1 forward, 2 left, 4 yaw, added up.
    pub learned_axes: u64,
    /// How often the controller has dropped a model on an axis, because it had become worse than
    /// none.
    pub models_left: u64,
    /// Model snapshots published (learner) or adopted (controller).
    pub snapshots: u64,
    /// Model snapshots refused.
    pub snapshots_refused: u64,
    /// Messages sent in the present epoch, by topic in the order of
    /// [`Topic::ALL`](crate::topic::Topic::ALL).
    pub sent: [u64; TOPIC_COUNT],
    /// Messages received, by topic.
    pub received: [u64; TOPIC_COUNT],
    /// Messages lost on the way to it, by topic.
    pub lost: [u64; TOPIC_COUNT],
    /// Messages refused as malformed, by topic.
    pub refused: [u64; TOPIC_COUNT],
    /// Messages sent and then dropped for newer ones in its own queue to the network, by topic.
    pub dropped: [u64; TOPIC_COUNT],
    /// The last error, UTF-8.
    pub error_text: [u8; ERROR_TEXT_MAX],
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
        let text = self.error_text.get(..self.error_len as usize).unwrap_or(&[]);
        std::str::from_utf8(text).unwrap_or("(not UTF-8)")
    }

    /// Keeps `text` as the last error, truncated to the space available.
    pub fn set_last_error(&mut self, text: &str) {
        let mut end = text.len().min(ERROR_TEXT_MAX);
        while !text.is_char_boundary(end) {
            end -= 1;
        }
        self.error_text = [0; ERROR_TEXT_MAX];
        for (slot, &byte) in self.error_text.iter_mut().zip(text.as_bytes().iter().take(end)) {
            *slot = byte;
        }
        self.error_len = end as u32;
    }
}

fixed_message!(Health, 7, [], |health| {
    code::<Participant>("Health", "participant", health.participant)?;
    code::<Phase>("Health", "phase", health.phase)?;
    code::<Exposure>("Health", "exposure", health.exposure)?;
    check_count("Health", "error_len", health.error_len, ERROR_TEXT_MAX)
});

/// The serialised part of a health message: its error as a string.
#[derive(Serialize)]
#[serde(rename = "Health")]
struct Said<'a> {
    stamp: Stamp,
    participant: u32,
    phase: u32,
    pid: u32,
    exposure: u32,
    heartbeat: u64,
    deadlines_met: u64,
    deadlines_missed: u64,
    stalled_nanos: u64,
    model_version: u64,
    learned_axes: u64,
    models_left: u64,
    snapshots: u64,
    snapshots_refused: u64,
    sent: [u64; TOPIC_COUNT],
    received: [u64; TOPIC_COUNT],
    lost: [u64; TOPIC_COUNT],
    refused: [u64; TOPIC_COUNT],
    dropped: [u64; TOPIC_COUNT],
    error: &'a str,
}

#[derive(Deserialize)]
#[serde(rename = "Health")]
struct Heard {
    stamp: Stamp,
    participant: u32,
    phase: u32,
    pid: u32,
    exposure: u32,
    heartbeat: u64,
    deadlines_met: u64,
    deadlines_missed: u64,
    stalled_nanos: u64,
    model_version: u64,
    learned_axes: u64,
    models_left: u64,
    snapshots: u64,
    snapshots_refused: u64,
    sent: [u64; TOPIC_COUNT],
    received: [u64; TOPIC_COUNT],
    lost: [u64; TOPIC_COUNT],
    refused: [u64; TOPIC_COUNT],
    dropped: [u64; TOPIC_COUNT],
    error: ErrorText,
}

/// The last error, read without allocating.
struct ErrorText {
    bytes: [u8; ERROR_TEXT_MAX],
    len: u32,
}

impl<'de> Deserialize<'de> for ErrorText {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Text;
        impl Visitor<'_> for Text {
            type Value = ErrorText;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "a text of at most {ERROR_TEXT_MAX} bytes")
            }

            fn visit_str<E: Error>(self, text: &str) -> Result<ErrorText, E> {
                let mut bytes = [0; ERROR_TEXT_MAX];
                let place = bytes
                    .get_mut(..text.len())
                    .ok_or_else(|| E::invalid_length(text.len(), &self))?;
                place.copy_from_slice(text.as_bytes());
                Ok(ErrorText { bytes, len: text.len() as u32 })
            }
        }
        deserializer.deserialize_str(Text)
    }
}

impl Serialize for Health {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let serialised = Said {
            stamp: self.stamp,
            participant: self.participant,
            phase: self.phase,
            pid: self.pid,
            exposure: self.exposure,
            heartbeat: self.heartbeat,
            deadlines_met: self.deadlines_met,
            deadlines_missed: self.deadlines_missed,
            stalled_nanos: self.stalled_nanos,
            model_version: self.model_version,
            learned_axes: self.learned_axes,
            models_left: self.models_left,
            snapshots: self.snapshots,
            snapshots_refused: self.snapshots_refused,
            sent: self.sent,
            received: self.received,
            lost: self.lost,
            refused: self.refused,
            dropped: self.dropped,
            error: self.last_error(),
        };
        serialised.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Health {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let decoded = Heard::deserialize(deserializer)?;
        Ok(Self {
            stamp: decoded.stamp,
            participant: decoded.participant,
            phase: decoded.phase,
            pid: decoded.pid,
            exposure: decoded.exposure,
            reserved: 0,
            heartbeat: decoded.heartbeat,
            deadlines_met: decoded.deadlines_met,
            deadlines_missed: decoded.deadlines_missed,
            stalled_nanos: decoded.stalled_nanos,
            model_version: decoded.model_version,
            learned_axes: decoded.learned_axes,
            models_left: decoded.models_left,
            snapshots: decoded.snapshots,
            snapshots_refused: decoded.snapshots_refused,
            sent: decoded.sent,
            received: decoded.received,
            lost: decoded.lost,
            refused: decoded.refused,
            dropped: decoded.dropped,
            error_len: decoded.error.len,
            error_text: decoded.error.bytes,
        })
    }
}
