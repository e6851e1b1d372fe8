//! any → any: writer and time of a message. The first 48 bytes of every message.

use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};

/// Writer and time of a message. On the network the first three fields are in the header of the
/// message, not in its body. The sink that sends the message fills in every
/// field except `tick`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Pod, Zeroable, Serialize, Deserialize)]
pub struct Stamp {
    /// CRC-32C of every byte behind this field.
    #[serde(skip)]
    pub checksum: u32,
    /// Protocol version, [`VERSION`](crate::VERSION).
    #[serde(skip)]
    pub version: u16,
    /// Kind of message, [`Message::KIND`](super::Message::KIND).
    #[serde(skip)]
    pub kind: u16,
    /// One process instance: drawn at random when it starts.
    pub writer: u64,
    /// How often this role has been started: a later instance has a greater epoch.
    pub epoch: u64,
    /// Counts the messages of one writer on one topic, from 1.
    pub sequence: u64,
    /// Control period that the message is about.
    pub tick: u64,
    /// Writer's monotonic clock when the message was sent \[ns\]. It belongs to one machine: do not
    /// compare it across writers.
    pub sent_nanos: u64,
}
