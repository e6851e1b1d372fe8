//! One file per message. Every message is plain data that begins with a [`Stamp`].
//!
//! Sizes are multiples of 8 bytes without padding, so that a message is written straight into
//! loaned shared memory.

mod codes;
mod command;
mod credit;
mod health;
mod model_snapshot;
mod plan;
mod plant_state;
mod residual_sample;
mod sequence;
mod stamp;
mod truth;

pub use codes::{
    Exposure, FallbackLevel, GateState, Participant, Phase, Reason, SolverStatus, UnknownCode,
};
pub use command::{Command, TAIL_MAX};
pub use credit::Credit;
pub use health::{ERROR_TEXT_MAX, Health};
pub use model_snapshot::{INPUTS_MAX, ModelSnapshot, SnapshotHead, SnapshotRow};
pub use plan::{HORIZON_MAX, Plan};
pub use plant_state::{PlantState, WHEELS_MAX};
pub use residual_sample::ResidualSample;
pub use stamp::Stamp;
pub use truth::Truth;

use crate::frame::DecodeError;
use crate::wire;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// A kind of message: its name, its number, and its bytes.
pub trait Message: Clone + Send + 'static {
    /// Name in logs, records and errors.
    const NAME: &'static str;
    /// Number on the wire; never reused.
    const KIND: u16;
    /// Longest possible message \[bytes\].
    const BYTES_MAX: usize;
    /// Names of its fields that consist of numbers.
    const NUMBERS: &'static [&'static str];

    /// Passes every field of [`NUMBERS`](Self::NUMBERS) to `visit`, by its name and as one row, in
    /// their order.
    fn visit_numbers(&mut self, visit: &mut dyn FnMut(&'static str, &mut [f64]));

    /// Writer and time of the message.
    fn stamp(&self) -> &Stamp;

    /// The stamp, for the sink that fills it in.
    fn stamp_mut(&mut self) -> &mut Stamp;

    /// Length of this message \[bytes\], a multiple of 8.
    fn byte_len(&self) -> usize;

    /// Writes the message into `out`, which is exactly [`byte_len`](Self::byte_len) long. Does not
    /// allocate.
    fn write(&self, out: &mut [u8]);

    /// Reads a message from bytes whose version, kind and checksum have been checked.
    ///
    /// # Errors
    /// [`DecodeError`] if the length or a value does not fit.
    fn read(bytes: &[u8]) -> Result<Self, DecodeError>;

    /// Appends the message's body as it is on the network. Does not allocate once `out` has grown.
    fn write_wire(&self, out: &mut Vec<u8>);

    /// Reads the body of a message whose version, kind and checksum have been checked. The body
    /// does not contain them.
    ///
    /// # Errors
    /// [`DecodeError`] if the length or a value does not fit.
    fn read_wire(body: &[u8]) -> Result<Self, DecodeError>;
}

/// A message of fixed size, all of whose bytes are data: its memory is its encoding. On the network
/// it is its serde serialisation.
pub trait Fixed: bytemuck::Pod + Send + Serialize + DeserializeOwned {
    /// See [`Message::NAME`].
    const NAME: &'static str;
    /// See [`Message::KIND`].
    const KIND: u16;
    /// See [`Message::NUMBERS`].
    const NUMBERS: &'static [&'static str];

    /// See [`Message::visit_numbers`].
    fn visit_numbers(&mut self, visit: &mut dyn FnMut(&'static str, &mut [f64]));

    /// See [`Message::stamp`].
    fn stamp(&self) -> &Stamp;

    /// See [`Message::stamp_mut`].
    fn stamp_mut(&mut self) -> &mut Stamp;

    /// Whether every coded field holds a known code and every count fits its array.
    ///
    /// Numbers are not checked here: the receiver judges whether a velocity is plausible.
    ///
    /// # Errors
    /// [`DecodeError::Value`] names the first field that fails.
    fn check(&self) -> Result<(), DecodeError>;
}

impl<T: Fixed> Message for T {
    const NAME: &'static str = <T as Fixed>::NAME;
    const KIND: u16 = <T as Fixed>::KIND;
    const BYTES_MAX: usize = size_of::<T>();
    const NUMBERS: &'static [&'static str] = <T as Fixed>::NUMBERS;

    fn visit_numbers(&mut self, visit: &mut dyn FnMut(&'static str, &mut [f64])) {
        Fixed::visit_numbers(self, visit);
    }

    fn stamp(&self) -> &Stamp {
        Fixed::stamp(self)
    }

    fn stamp_mut(&mut self) -> &mut Stamp {
        Fixed::stamp_mut(self)
    }

    fn byte_len(&self) -> usize {
        size_of::<T>()
    }

    fn write(&self, out: &mut [u8]) {
        out.copy_from_slice(bytemuck::bytes_of(self));
    }

    fn read(bytes: &[u8]) -> Result<Self, DecodeError> {
        let message: T =
            bytemuck::try_pod_read_unaligned(bytes).map_err(|_| DecodeError::Length {
                message: <T as Fixed>::NAME,
                expected: size_of::<T>(),
                got: bytes.len(),
            })?;
        message.check()?;
        Ok(message)
    }

    fn write_wire(&self, out: &mut Vec<u8>) {
        wire::write_postcard(self, out);
    }

    fn read_wire(body: &[u8]) -> Result<Self, DecodeError> {
        let message: T = wire::read_postcard(<T as Fixed>::NAME, body)?;
        message.check()?;
        Ok(message)
    }
}

/// Makes a struct a [`Fixed`] message. The listed fields are its numbers; the closure-like last
/// argument checks its coded fields.
macro_rules! fixed_message {
    ($type:ident, $kind:expr, [$($number:ident),*], |$this:ident| $check:expr) => {
        impl $crate::message::Fixed for $type {
            const NAME: &'static str = stringify!($type);
            const KIND: u16 = $kind;
            const NUMBERS: &'static [&'static str] = &[$(stringify!($number)),*];

            fn visit_numbers(&mut self, _visit: &mut dyn FnMut(&'static str, &mut [f64])) {
                $(_visit(
                    stringify!($number),
                    bytemuck::cast_slice_mut(std::slice::from_mut(&mut self.$number)),
                );)*
            }

            fn stamp(&self) -> &$crate::message::Stamp {
                &self.stamp
            }

            fn stamp_mut(&mut self) -> &mut $crate::message::Stamp {
                &mut self.stamp
            }

            fn check(&self) -> Result<(), $crate::frame::DecodeError> {
                let $this = self;
                $check
            }
        }
    };
}
use fixed_message;

/// Fails with the field's name unless `count` is at most `limit`.
fn check_count(
    message: &'static str,
    field: &'static str,
    count: u32,
    limit: usize,
) -> Result<(), DecodeError> {
    if count as usize <= limit {
        Ok(())
    } else {
        Err(DecodeError::Value { message, field, value: u64::from(count) })
    }
}

#[cfg(test)]
mod tests {
    use super::{
        Command, Credit, Health, Message, ModelSnapshot, Plan, PlantState, ResidualSample,
        SnapshotHead, Stamp, Truth,
    };
    use std::mem::offset_of;

    /// A change here is a change of the protocol: it needs another [`VERSION`](crate::VERSION).
    #[test]
    fn the_layout_of_messages_is_pinned() {
        let sizes = [
            (Command::NAME, size_of::<Command>(), 200),
            (Credit::NAME, size_of::<Credit>(), 64),
            (Health::NAME, size_of::<Health>(), 584),
            (Plan::NAME, size_of::<Plan>(), 6064),
            (PlantState::NAME, size_of::<PlantState>(), 320),
            (ResidualSample::NAME, size_of::<ResidualSample>(), 192),
            (Truth::NAME, size_of::<Truth>(), 232),
            ("SnapshotHead", size_of::<SnapshotHead>(), 768),
            ("Stamp", size_of::<Stamp>(), 48),
        ];
        for (name, size, pinned) in sizes {
            assert_eq!(size, pinned, "{name}");
            assert_eq!(size % 8, 0, "{name} is not made of whole words");
        }
        let offsets = [
            (offset_of!(Stamp, version), 4),
            (offset_of!(Stamp, kind), 6),
            (offset_of!(Stamp, sequence), 24),
            (offset_of!(Command, input), 64),
            (offset_of!(Command, fallback_level), 188),
            (offset_of!(Command, stop), 192),
            (offset_of!(PlantState, current), 160),
            (offset_of!(PlantState, input), 224),
            (offset_of!(PlantState, accepted_tick), 272),
            (offset_of!(PlantState, gate), 312),
            (offset_of!(SnapshotHead, points), 80),
            (offset_of!(SnapshotHead, length_scale), 288),
        ];
        for (index, (offset, pinned)) in offsets.into_iter().enumerate() {
            assert_eq!(offset, pinned, "row {index}");
        }
    }

    #[test]
    fn every_kind_is_used_once() {
        let mut kinds = [
            PlantState::KIND,
            Command::KIND,
            ResidualSample::KIND,
            Credit::KIND,
            Truth::KIND,
            Plan::KIND,
            Health::KIND,
            ModelSnapshot::KIND,
        ];
        kinds.sort_unstable();
        assert_eq!(kinds, [1, 2, 3, 4, 5, 6, 7, 8]);
    }
}
