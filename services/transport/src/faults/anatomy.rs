//! Decodes a message and seals it again: the only part of the faults that knows the encodings.

use crate::carrier::Encoding;
use protocol::message::Message;
use protocol::{frame, wire};

/// The changed message, if the change was possible.
type Changed = Option<Vec<u8>>;

/// The change to the numbers of a field.
pub(super) type Change<'a> = &'a mut dyn FnMut(&mut [f64]);

/// What the faults need of one kind of message in one encoding.
#[derive(Clone, Copy)]
pub(super) struct Anatomy {
    encoding: Encoding,
    tick: fn(Encoding, &[u8]) -> Option<u64>,
    numbers: fn(Encoding, &[u8]) -> Option<Vec<f64>>,
    with_numbers: fn(Encoding, &[u8], &[f64]) -> Changed,
    with_field: fn(Encoding, &[u8], &str, Change<'_>) -> Changed,
    with_version: fn(Encoding, &[u8], u16) -> Changed,
}

impl Anatomy {
    pub(super) fn of<T: Message>(encoding: Encoding) -> Self {
        Self {
            encoding,
            tick: tick::<T>,
            numbers: numbers::<T>,
            with_numbers: with_numbers::<T>,
            with_field: with_field::<T>,
            with_version: with_version::<T>,
        }
    }

    /// Tick of its stamp; none if it is no valid message.
    pub(super) fn tick(&self, bytes: &[u8]) -> Option<u64> {
        (self.tick)(self.encoding, bytes)
    }

    /// All its numbers, in order; none if it is no valid message.
    pub(super) fn numbers(&self, bytes: &[u8]) -> Option<Vec<f64>> {
        (self.numbers)(self.encoding, bytes)
    }

    /// The same message with other numbers; none if it is no valid message, or has another count of
    /// numbers.
    pub(super) fn with_numbers(&self, bytes: &[u8], numbers: &[f64]) -> Option<Vec<u8>> {
        (self.with_numbers)(self.encoding, bytes, numbers)
    }

    /// The same message with the numbers of `field` changed; none if it is no valid message, or has
    /// no number there.
    pub(super) fn with_field(
        &self,
        bytes: &[u8],
        field: &str,
        change: Change<'_>,
    ) -> Option<Vec<u8>> {
        (self.with_field)(self.encoding, bytes, field, change)
    }

    /// The same message as a program of another `version` would send it; none if it is no valid
    /// message.
    pub(super) fn with_version(&self, bytes: &[u8], version: u16) -> Option<Vec<u8>> {
        (self.with_version)(self.encoding, bytes, version)
    }
}

fn opened<T: Message>(encoding: Encoding, bytes: &[u8]) -> Option<T> {
    match encoding {
        Encoding::Words => frame::decode(bytes).ok(),
        Encoding::Wire => wire::decode(bytes).ok(),
    }
}

fn sealed<T: Message>(encoding: Encoding, message: &T) -> Vec<u8> {
    let mut bytes = Vec::new();
    match encoding {
        Encoding::Words => {
            bytes.resize(message.byte_len(), 0);
            frame::encode(message, &mut bytes);
        }
        Encoding::Wire => drop(wire::encode(message, &mut bytes)),
    }
    bytes
}

fn tick<T: Message>(encoding: Encoding, bytes: &[u8]) -> Option<u64> {
    match encoding {
        // The stamp is in its place, whatever the rest is.
        Encoding::Words => frame::peek(bytes).ok().map(|stamp| stamp.tick),
        Encoding::Wire => opened::<T>(encoding, bytes).map(|message| message.stamp().tick),
    }
}

fn numbers<T: Message>(encoding: Encoding, bytes: &[u8]) -> Option<Vec<f64>> {
    let mut message: T = opened(encoding, bytes)?;
    let mut numbers = Vec::new();
    message.visit_numbers(&mut |_, values| numbers.extend_from_slice(values));
    Some(numbers)
}

fn with_numbers<T: Message>(encoding: Encoding, bytes: &[u8], numbers: &[f64]) -> Option<Vec<u8>> {
    let mut message: T = opened(encoding, bytes)?;
    let mut rest = numbers;
    let mut fits = true;
    message.visit_numbers(&mut |_, values| match rest.split_at_checked(values.len()) {
        Some((these, others)) => {
            values.copy_from_slice(these);
            rest = others;
        }
        None => fits = false,
    });
    (fits && rest.is_empty()).then(|| sealed(encoding, &message))
}

fn with_field<T: Message>(
    encoding: Encoding,
    bytes: &[u8],
    field: &str,
    change: Change<'_>,
) -> Option<Vec<u8>> {
    let mut message: T = opened(encoding, bytes)?;
    let mut found = false;
    message.visit_numbers(&mut |name, values| {
        if name == field && !values.is_empty() {
            change(values);
            found = true;
        }
    });
    found.then(|| sealed(encoding, &message))
}

fn with_version<T: Message>(encoding: Encoding, bytes: &[u8], version: u16) -> Option<Vec<u8>> {
    let mut message: T = opened(encoding, bytes)?;
    message.stamp_mut().version = version;
    Some(sealed(encoding, &message))
}
