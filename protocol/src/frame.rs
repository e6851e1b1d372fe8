//! bytes ↔ message: version, kind, checksum and length are checked before a value is read.

use crate::VERSION;
use crate::message::{Message, Stamp};

/// Bytes that are not the expected message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// Shorter than a stamp.
    #[error("{got} bytes are too few for any message: a stamp alone has {expected}")]
    TooShort {
        /// Length of a stamp \[bytes\].
        expected: usize,
        /// Length received \[bytes\].
        got: usize,
    },
    /// The peer has another protocol version.
    #[error("protocol version {got} was received, this program supports version {expected}")]
    Version {
        /// Version of this program.
        expected: u16,
        /// Version of the peer.
        got: u16,
    },
    /// Another message than the topic carries.
    #[error("message kind {got} was received where {message} (kind {expected}) was expected")]
    Kind {
        /// Message of the topic.
        message: &'static str,
        /// Its kind.
        expected: u16,
        /// The received kind.
        got: u16,
    },
    /// Damaged on the way.
    #[error("{message} has checksum {got:#010x} where its bytes give {expected:#010x}")]
    Checksum {
        /// Message of the topic.
        message: &'static str,
        /// Checksum of the received bytes.
        expected: u32,
        /// Checksum in the stamp.
        got: u32,
    },
    /// Truncated or too long.
    #[error("{message} of {got} bytes where {expected} were expected")]
    Length {
        /// Message of the topic.
        message: &'static str,
        /// Length given by its header \[bytes\].
        expected: usize,
        /// Length received \[bytes\].
        got: usize,
    },
    /// A body without the fields of the message.
    #[error("{message} cannot be read: {reason}")]
    Body {
        /// Message of the topic.
        message: &'static str,
        /// The reason.
        reason: &'static str,
    },
    /// A code or count that does not exist.
    #[error("{message}.{field} is {value}, a value that no version defines")]
    Value {
        /// Message of the topic.
        message: &'static str,
        /// Its field.
        field: &'static str,
        /// The value received.
        value: u64,
    },
}

const CHECKSUM_BYTES: usize = size_of::<u32>();

/// Writes `message` into `out`, which is [`Message::byte_len`] long, and seals it with its
/// checksum. Does not allocate.
pub fn encode<T: Message>(message: &T, out: &mut [u8]) {
    message.write(out);
    if let Some((checksum, rest)) = out.split_at_mut_checked(CHECKSUM_BYTES) {
        checksum.copy_from_slice(&crc32c::crc32c(rest).to_ne_bytes());
    }
}

/// Reads the message in `bytes`. Allocates only for a message of variable size, and no more than
/// `bytes` is long.
///
/// # Errors
/// [`DecodeError`] names the first check that failed.
pub fn decode<T: Message>(bytes: &[u8]) -> Result<T, DecodeError> {
    let stamp = peek(bytes)?;
    if stamp.version != VERSION {
        return Err(DecodeError::Version { expected: VERSION, got: stamp.version });
    }
    if stamp.kind != T::KIND {
        return Err(DecodeError::Kind { message: T::NAME, expected: T::KIND, got: stamp.kind });
    }
    let expected = bytes.get(CHECKSUM_BYTES..).map_or(0, crc32c::crc32c);
    if stamp.checksum != expected {
        return Err(DecodeError::Checksum { message: T::NAME, expected, got: stamp.checksum });
    }
    T::read(bytes)
}

/// Reads the stamp alone, without checking the rest.
///
/// # Errors
/// [`DecodeError::TooShort`].
pub fn peek(bytes: &[u8]) -> Result<Stamp, DecodeError> {
    let too_short = DecodeError::TooShort { expected: size_of::<Stamp>(), got: bytes.len() };
    let stamp = bytes.get(..size_of::<Stamp>()).ok_or(too_short)?;
    bytemuck::try_pod_read_unaligned(stamp).map_err(|_| too_short)
}
