//! Decodes a message and seals it again: the only part of the faults that knows the encoding.

use protocol::frame;
use protocol::message::Message;

/// The changed message, if the change was possible.
type Changed = Option<Vec<u8>>;

/// The change to the numbers of a field.
pub(super) type Change<'a> = &'a mut dyn FnMut(&mut [f64]);

/// What the faults need of one kind of message.
#[derive(Clone, Copy)]
pub(super) struct Anatomy {
    tick: fn(&[u8]) -> Option<u64>,
    numbers: fn(&[u8]) -> Option<Vec<f64>>,
    with_numbers: fn(&[u8], &[f64]) -> Changed,
    with_field: fn(&[u8], &str, Change<'_>) -> Changed,
    with_version: fn(&[u8], u16) -> Changed,
}

impl Anatomy {
    pub(super) fn of<T: Message>() -> Self {
        Self {
            tick,
            numbers: numbers::<T>,
            with_numbers: with_numbers::<T>,
            with_field: with_field::<T>,
            with_version: with_version::<T>,
        }
    }

    /// Tick of its stamp; none if it is no valid message.
    pub(super) fn tick(&self, bytes: &[u8]) -> Option<u64> {
        (self.tick)(bytes)
    }

    /// All its numbers, in order; none if it is no valid message.
    pub(super) fn numbers(&self, bytes: &[u8]) -> Option<Vec<f64>> {
        (self.numbers)(bytes)
    }

    /// The same message with other numbers; none if it is no valid message, or has another count of
    /// numbers.
    pub(super) fn with_numbers(&self, bytes: &[u8], numbers: &[f64]) -> Option<Vec<u8>> {
        (self.with_numbers)(bytes, numbers)
    }

    /// The same message with the numbers of `field` changed; none if it is no valid message, or has
    /// no number there.
    pub(super) fn with_field(
        &self,
        bytes: &[u8],
        field: &str,
        change: Change<'_>,
    ) -> Option<Vec<u8>> {
        (self.with_field)(bytes, field, change)
    }

    /// The same message as a program of another `version` would send it; none if it is no valid
    /// message.
    pub(super) fn with_version(&self, bytes: &[u8], version: u16) -> Option<Vec<u8>> {
        (self.with_version)(bytes, version)
    }
}

fn opened<T: Message>(bytes: &[u8]) -> Option<T> {
    frame::decode(bytes).ok()
}

fn sealed<T: Message>(message: &T) -> Vec<u8> {
    let mut bytes = vec![0; message.byte_len()];
    frame::encode(message, &mut bytes);
    bytes
}

fn tick(bytes: &[u8]) -> Option<u64> {
    // The stamp is in its place, whatever the rest is.
    frame::peek(bytes).ok().map(|stamp| stamp.tick)
}

fn numbers<T: Message>(bytes: &[u8]) -> Option<Vec<f64>> {
    let mut message: T = opened(bytes)?;
    let mut numbers = Vec::new();
    message.visit_numbers(&mut |_, values| numbers.extend_from_slice(values));
    Some(numbers)
}

fn with_numbers<T: Message>(bytes: &[u8], numbers: &[f64]) -> Option<Vec<u8>> {
    let mut message: T = opened(bytes)?;
    let mut rest = numbers;
    let mut fits = true;
    message.visit_numbers(&mut |_, values| match rest.split_at_checked(values.len()) {
        Some((these, others)) => {
            values.copy_from_slice(these);
            rest = others;
        }
        None => fits = false,
    });
    (fits && rest.is_empty()).then(|| sealed(&message))
}

fn with_field<T: Message>(bytes: &[u8], field: &str, change: Change<'_>) -> Option<Vec<u8>> {
    let mut message: T = opened(bytes)?;
    let mut found = false;
    message.visit_numbers(&mut |name, values| {
        if name == field && !values.is_empty() {
            change(values);
            found = true;
        }
    });
    found.then(|| sealed(&message))
}

fn with_version<T: Message>(bytes: &[u8], version: u16) -> Option<Vec<u8>> {
    let mut message: T = opened(bytes)?;
    message.stamp_mut().version = version;
    Some(sealed(&message))
}
