//! network bytes ↔ message: the encoding that programs in other languages read and write, described
//! in `WIRE.md`.
//!
//! ```text
//! version u16 │ kind u16 │ checksum u32 │ body
//! ```
//!
//! All little-endian. The checksum is the CRC-32C of the body. The body is postcard, followed in a
//! [`ModelSnapshot`](crate::message::ModelSnapshot) by the numbers of its data points. Unused parts
//! of a message are not sent.

use crate::VERSION;
use crate::frame::DecodeError;
use crate::message::{Message, Stamp};
use serde::Serialize;
use std::mem;

/// The header before the body of every message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Header {
    /// Protocol version of the sender.
    pub version: u16,
    /// [`Message::KIND`].
    pub kind: u16,
    /// CRC-32C of the body.
    pub checksum: u32,
}

/// Length of a [`Header`] \[bytes\].
pub const HEADER_BYTES: usize = 8;

/// Longest message of any kind on the network \[bytes\].
///
/// Only a snapshot comes near: it is as long as in memory but for its stamp and padding. In all
/// other messages no field grows to twice its size.
pub const BYTES_MAX: usize = crate::message::ModelSnapshot::BYTES_MAX + HEADER_BYTES;

/// Writes `message` into `out`, replaces its contents, and returns the checksum. Does not allocate
/// once `out` has grown.
///
/// Version and kind are those of the message's stamp.
pub fn encode<T: Message>(message: &T, out: &mut Vec<u8>) -> u32 {
    out.clear();
    out.extend_from_slice(&[0; HEADER_BYTES]);
    message.write_wire(out);
    let checksum = out.get(HEADER_BYTES..).map_or(0, crc32c::crc32c);
    let stamp = message.stamp();
    let header = Header { version: stamp.version, kind: stamp.kind, checksum };
    if let Some(place) = out.first_chunk_mut() {
        *place = header.bytes();
    }
    checksum
}

/// Reads the message in `bytes`. Allocates only for a message of variable size, and no more than
/// `bytes` is long.
///
/// # Errors
/// [`DecodeError`] names the first check that failed.
pub fn decode<T: Message>(bytes: &[u8]) -> Result<T, DecodeError> {
    let (header, body) = split(bytes)?;
    if header.version != VERSION {
        return Err(DecodeError::Version { expected: VERSION, got: header.version });
    }
    if header.kind != T::KIND {
        return Err(DecodeError::Kind { message: T::NAME, expected: T::KIND, got: header.kind });
    }
    let expected = crc32c::crc32c(body);
    if header.checksum != expected {
        return Err(DecodeError::Checksum { message: T::NAME, expected, got: header.checksum });
    }
    let mut message = T::read_wire(body)?;
    let stamp = *message.stamp();
    *message.stamp_mut() =
        Stamp { checksum: header.checksum, version: header.version, kind: header.kind, ..stamp };
    Ok(message)
}

/// Reads the header alone, and returns it with the body.
///
/// # Errors
/// [`DecodeError::TooShort`].
pub fn split(bytes: &[u8]) -> Result<(Header, &[u8]), DecodeError> {
    let (header, body) = bytes
        .split_first_chunk()
        .ok_or(DecodeError::TooShort { expected: HEADER_BYTES, got: bytes.len() })?;
    Ok((Header::of(*header), body))
}

impl Header {
    fn bytes(self) -> [u8; HEADER_BYTES] {
        let [v0, v1] = self.version.to_le_bytes();
        let [k0, k1] = self.kind.to_le_bytes();
        let [c0, c1, c2, c3] = self.checksum.to_le_bytes();
        [v0, v1, k0, k1, c0, c1, c2, c3]
    }

    fn of([v0, v1, k0, k1, c0, c1, c2, c3]: [u8; HEADER_BYTES]) -> Self {
        Self {
            version: u16::from_le_bytes([v0, v1]),
            kind: u16::from_le_bytes([k0, k1]),
            checksum: u32::from_le_bytes([c0, c1, c2, c3]),
        }
    }
}

/// Appends `body` as postcard.
pub(crate) fn write_postcard<T: Serialize>(body: &T, out: &mut Vec<u8>) {
    let start = out.len();
    match postcard::to_extend(body, mem::take(out)) {
        Ok(written) => *out = written,
        // postcard can encode every part of every message. Were there another part, its header
        // would stand alone and be refused.
        Err(_) => out.resize(start, 0),
    }
}

/// Why a body cannot be read.
pub(crate) fn why(error: &postcard::Error) -> &'static str {
    match error {
        postcard::Error::DeserializeUnexpectedEnd => "it ends too early",
        postcard::Error::DeserializeBadVarint => "a number is too large for its field",
        _ => "a part is longer than it can be, or not of its type",
    }
}
