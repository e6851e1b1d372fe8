//! Takes a message apart and seals it again: the one place of the faults that knows how messages are encoded.

use crate::frame;
use crate::message::Message;

/// What the faults must know of one kind of message.
#[derive(Clone, Copy)]
pub(super) struct Anatomy {
    numbers: fn(&[u8]) -> Option<Vec<f64>>,
    with_numbers: fn(&[u8], &[f64]) -> Option<Vec<u8>>,
    with_nan: fn(&[u8], &str, u64) -> Option<Vec<u8>>,
}

impl Anatomy {
    pub(super) fn of<T: Message>() -> Self {
        Self { numbers: numbers::<T>, with_numbers: with_numbers::<T>, with_nan: with_nan::<T> }
    }

    /// Tick of its stamp; none if it has no stamp.
    pub(super) fn tick(bytes: &[u8]) -> Option<u64> {
        frame::peek(bytes).ok().map(|stamp| stamp.tick)
    }

    /// All its numbers, in order; none if it is no valid message.
    pub(super) fn numbers(&self, bytes: &[u8]) -> Option<Vec<f64>> {
        (self.numbers)(bytes)
    }

    /// The same message with other numbers; none if it is no valid message, or has another number of numbers.
    pub(super) fn with_numbers(&self, bytes: &[u8], numbers: &[f64]) -> Option<Vec<u8>> {
        (self.with_numbers)(bytes, numbers)
    }

    /// The same message with NaN somewhere in `field`, where `choice` says; none if it is no valid message, or has no number there.
    pub(super) fn with_nan(&self, bytes: &[u8], field: &str, choice: u64) -> Option<Vec<u8>> {
        (self.with_nan)(bytes, field, choice)
    }
}

fn numbers<T: Message>(bytes: &[u8]) -> Option<Vec<f64>> {
    let mut message: T = frame::decode(bytes).ok()?;
    let mut numbers = Vec::new();
    message.visit_numbers(&mut |_, values| numbers.extend_from_slice(values));
    Some(numbers)
}

fn with_numbers<T: Message>(bytes: &[u8], numbers: &[f64]) -> Option<Vec<u8>> {
    let mut message: T = frame::decode(bytes).ok()?;
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

fn with_nan<T: Message>(bytes: &[u8], field: &str, choice: u64) -> Option<Vec<u8>> {
    let mut message: T = frame::decode(bytes).ok()?;
    let mut found = false;
    message.visit_numbers(&mut |name, values| {
        let count = values.len() as u64;
        if name == field
            && count > 0
            && let Some(value) = values.get_mut((choice % count) as usize)
        {
            *value = f64::NAN;
            found = true;
        }
    });
    found.then(|| sealed(&message))
}

fn sealed<T: Message>(message: &T) -> Vec<u8> {
    let mut bytes = vec![0; message.byte_len()];
    frame::encode(message, &mut bytes);
    bytes
}
