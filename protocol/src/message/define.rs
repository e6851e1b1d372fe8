//! `message!`: the one definition of a message. Layout, checks, encoding, JSON and its schema, and
//! the tables of WIRE.md come from it.

use super::field::Field;
use super::{Message, Stamp};
use crate::frame::DecodeError;
use crate::wire;
use serde::Serialize;
use serde::ser::SerializeMap;

/// A struct that `message!` has defined: plain data without padding, behind a stamp.
pub trait Fields: bytemuck::Pod + Send + Serialize {
    /// Name of the message that it is, or is a part of.
    const NAME: &'static str;
    /// Its documentation.
    const ABOUT: &'static str;
    /// Its fields behind the stamp, in their order.
    const FIELDS: &'static [Field];

    /// See [`Message::stamp`].
    fn stamp(&self) -> &Stamp;

    /// See [`Message::stamp_mut`].
    fn stamp_mut(&mut self) -> &mut Stamp;

    /// See [`Message::visit_numbers`].
    fn visit_numbers(&mut self, visit: &mut dyn FnMut(&'static str, &mut [f64]));

    /// Whether every coded field holds a known code and every count fits its array.
    ///
    /// Numbers are not checked here: the receiver judges whether a velocity is plausible.
    ///
    /// # Errors
    /// [`DecodeError::Value`] names the first field that fails.
    fn check(&self) -> Result<(), DecodeError>;

    /// See [`Message::show`].
    ///
    /// # Errors
    /// Those of `map`.
    fn show<M: SerializeMap>(&self, map: &mut M) -> Result<(), M::Error>;

    /// Reads the fields from the front of a body of the network, and checks them.
    ///
    /// # Errors
    /// [`DecodeError`] if a value does not fit, or the body ends too early.
    fn receive(rest: &mut &[u8]) -> Result<Self, DecodeError>;
}

/// A message of fixed size: its memory is its encoding.
pub trait Fixed: Fields {
    /// See [`Message::KIND`].
    const KIND: u16;
}

impl<T: Fixed> Message for T {
    const NAME: &'static str = <T as Fields>::NAME;
    const ABOUT: &'static str = <T as Fields>::ABOUT;
    const KIND: u16 = <T as Fixed>::KIND;
    const BYTES_MAX: usize = size_of::<T>();

    fn fields() -> Vec<Field> {
        T::FIELDS.to_vec()
    }

    fn visit_numbers(&mut self, visit: &mut dyn FnMut(&'static str, &mut [f64])) {
        Fields::visit_numbers(self, visit);
    }

    fn stamp(&self) -> &Stamp {
        Fields::stamp(self)
    }

    fn stamp_mut(&mut self) -> &mut Stamp {
        Fields::stamp_mut(self)
    }

    fn show<M: SerializeMap>(&self, map: &mut M) -> Result<(), M::Error> {
        Fields::show(self, map)
    }

    fn byte_len(&self) -> usize {
        size_of::<T>()
    }

    fn write(&self, out: &mut [u8]) {
        out.copy_from_slice(bytemuck::bytes_of(self));
    }

    fn read(bytes: &[u8]) -> Result<Self, DecodeError> {
        let message: T = bytemuck::try_pod_read_unaligned(bytes).map_err(|_| {
            DecodeError::Length { message: T::NAME, expected: size_of::<T>(), got: bytes.len() }
        })?;
        message.check()?;
        Ok(message)
    }

    fn write_wire(&self, out: &mut Vec<u8>) {
        wire::write_postcard(self, out);
    }

    fn read_wire(body: &[u8]) -> Result<Self, DecodeError> {
        let mut rest = body;
        let message = T::receive(&mut rest)?;
        if rest.is_empty() {
            Ok(message)
        } else {
            Err(DecodeError::Length {
                message: T::NAME,
                expected: body.len() - rest.len() + wire::HEADER_BYTES,
                got: body.len() + wire::HEADER_BYTES,
            })
        }
    }
}

/// The rows of one message give different counts.
pub(crate) const ROWS_DIFFER: &str = "its rows do not belong to one horizon";

/// Defines a message. Behind the type of a field stands its treatment:
///
/// - nothing: numbers and counters as they are
/// - `code(E)`: a code of the enum `E`
/// - `at_most(MAX)`, `flag`: a whole number with a limit
/// - `size(MAX)`: the same, not in JSON
/// - `stop_request`: a reason for a stop of the gate
/// - `leading(count)`, `leading(count if valid)`: numbers, all sent, of which JSON has as many as
///   the field `count` says; none if the field `valid` is 0
/// - `count(MAX)`: how much of other fields counts; `length(MAX)`: the same, in JSON
/// - `rows(count)`, `rows(count + 1)`, `text(count)`: an array of which the field `count` gives the
///   used part
/// - `by_topic`: counters of topics
/// - `unused`: padding
macro_rules! message {
    (
        $(#[doc = $about:literal])+
        $name:ident $(= $number:literal)? $(of $whole:ident)? {
            $(
                $(#[doc = $doc:literal])+
                $field:ident: $type:ty $(= $kind:ident $(($($argument:tt)+))?)?,
            )+
        }
    ) => {
        $(#[doc = $about])+
        #[repr(C)]
        #[derive(Debug, Clone, Copy, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
        pub struct $name {
            /// Writer and time.
            pub stamp: $crate::message::Stamp,
            $($(#[doc = $doc])+ pub $field: $type,)+
        }

        impl $crate::message::Fields for $name {
            const NAME: &'static str = $crate::message::define::name!($name $(, $whole)?);
            const ABOUT: &'static str = concat!($($about),+);
            const FIELDS: &'static [$crate::message::field::Field] = &[$({
                use $crate::message::field::Kind;
                type How = $crate::message::define::kind!($($kind $(($($argument)+))?)?);
                $crate::message::field::Field {
                    name: stringify!($field),
                    about: concat!($($doc),+),
                    wire: <How as Kind<$type>>::WIRE,
                    allowed: <How as Kind<$type>>::ALLOWED,
                    shape: <How as Kind<$type>>::SHAPE,
                    offset: std::mem::offset_of!($name, $field),
                }
            }),+];

            fn stamp(&self) -> &$crate::message::Stamp {
                &self.stamp
            }

            fn stamp_mut(&mut self) -> &mut $crate::message::Stamp {
                &mut self.stamp
            }

            fn visit_numbers(&mut self, visit: &mut dyn FnMut(&'static str, &mut [f64])) {
                use $crate::message::field::Kind;
                $({
                    type How = $crate::message::define::kind!($($kind $(($($argument)+))?)?);
                    if <How as Kind<$type>>::WIRE.is_real() {
                        visit(stringify!($field), How::numbers(&mut self.$field));
                    }
                })+
            }

            fn check(&self) -> Result<(), $crate::frame::DecodeError> {
                use $crate::message::field::Kind;
                $({
                    type How = $crate::message::define::kind!($($kind $(($($argument)+))?)?);
                    <How as Kind<$type>>::check(&self.$field).map_err(|value| {
                        $crate::frame::DecodeError::Value {
                            message: <Self as $crate::message::Fields>::NAME,
                            field: stringify!($field),
                            value,
                        }
                    })?;
                })+
                Ok(())
            }

            fn show<M: serde::ser::SerializeMap>(&self, map: &mut M) -> Result<(), M::Error> {
                use $crate::message::field::Kind;
                $({
                    type How = $crate::message::define::kind!($($kind $(($($argument)+))?)?);
                    let count =
                        $crate::message::define::count!(self, $($kind $(($($argument)+))?)?);
                    if <How as Kind<$type>>::SHAPE.is_some() {
                        map.serialize_entry(
                            stringify!($field),
                            &How::shown(&self.$field, count),
                        )?;
                    }
                })+
                Ok(())
            }

            fn receive(rest: &mut &[u8]) -> Result<Self, $crate::frame::DecodeError> {
                use $crate::message::field::Kind;
                let refused = |reason| $crate::frame::DecodeError::Body {
                    message: <Self as $crate::message::Fields>::NAME,
                    reason,
                };
                let failed = |error| refused($crate::wire::why(&error));
                let mut message = <Self as bytemuck::Zeroable>::zeroed();
                (message.stamp, *rest) = postcard::take_from_bytes(rest).map_err(failed)?;
                $({
                    type How = $crate::message::define::kind!($($kind $(($($argument)+))?)?);
                    <How as Kind<$type>>::blank(&mut message.$field);
                })+
                $({
                    type How = $crate::message::define::kind!($($kind $(($($argument)+))?)?);
                    let _count = How::receive(&mut message.$field, rest).map_err(failed)?;
                    $crate::message::define::counted!(
                        message, _count, refused, $($kind $(($($argument)+))?)?
                    );
                })+
                $crate::message::Fields::check(&message)?;
                Ok(message)
            }
        }

        $(impl $crate::message::Fixed for $name {
            const KIND: u16 = $number;
        })?

        /// The fields that are sent.
        impl serde::Serialize for $name {
            fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                use serde::ser::SerializeStruct;
                use $crate::message::field::{Kind, Wire};
                let fields = [$(stringify!($field)),+].len() + 1;
                let mut sent = serializer.serialize_struct(stringify!($name), fields)?;
                sent.serialize_field("stamp", &self.stamp)?;
                $({
                    type How = $crate::message::define::kind!($($kind $(($($argument)+))?)?);
                    let count =
                        $crate::message::define::count!(self, $($kind $(($($argument)+))?)?);
                    if <How as Kind<$type>>::WIRE != Wire::Nothing {
                        sent.serialize_field(stringify!($field), &How::sent(&self.$field, count))?;
                    }
                })+
                sent.end()
            }
        }
    };
}

/// Name of the message that a struct is, or is a part of.
macro_rules! name {
    ($name:ident) => {
        stringify!($name)
    };
    ($name:ident, $whole:ident) => {
        stringify!($whole)
    };
}

/// The type that treats a field.
macro_rules! kind {
    () => { $crate::message::kinds::Plain };
    (code($enum:ty)) => { $crate::message::kinds::Code<$enum> };
    (at_most($max:expr)) => { $crate::message::kinds::AtMost<{ $max as u32 }> };
    (size($max:expr)) => { $crate::message::kinds::AtMost<{ $max as u32 }, false> };
    (flag) => { $crate::message::kinds::AtMost<1> };
    (stop_request) => { $crate::message::kinds::StopRequest };
    (leading($($count:tt)+)) => { $crate::message::kinds::Leading };
    (length($max:expr)) => { $crate::message::kinds::Count<{ $max as u32 }, true> };
    (count($max:expr)) => { $crate::message::kinds::Count<{ $max as u32 }> };
    (rows($($count:tt)+)) => { $crate::message::kinds::Rows };
    (text($count:ident)) => { $crate::message::kinds::Text };
    (by_topic) => { $crate::message::kinds::ByTopic };
    (unused) => { $crate::message::kinds::Unused };
}

/// How much of a field counts.
macro_rules! count {
    ($this:ident, leading($count:ident)) => {
        $this.$count as usize
    };
    ($this:ident, leading($count:ident if $valid:ident)) => {
        if $this.$valid == 1 { $this.$count as usize } else { 0 }
    };
    ($this:ident, rows($count:ident + $more:literal)) => {
        $this.$count as usize + $more
    };
    ($this:ident, rows($count:ident)) => {
        $this.$count as usize
    };
    ($this:ident, text($count:ident)) => {
        $this.$count as usize
    };
    ($this:ident, $($other:tt)*) => {
        usize::MAX
    };
}

/// Sets the field that holds the count of a received one.
macro_rules! counted {
    ($message:ident, $count:ident, $refused:ident, rows($field:ident $(+ $more:literal)?)) => {
        let count = $count
            .checked_sub(0 $(+ $more)?)
            .and_then(|count| u32::try_from(count).ok())
            .filter(|count| [$crate::message::kinds::UNKNOWN, *count].contains(&$message.$field))
            .ok_or_else(|| $refused($crate::message::define::ROWS_DIFFER))?;
        $message.$field = count;
    };
    ($message:ident, $count:ident, $refused:ident, text($field:ident)) => {
        $message.$field = $count as u32;
    };
    ($message:ident, $count:ident, $refused:ident, $($other:tt)*) => {};
}

pub(crate) use {count, counted, kind};
pub(super) use {message, name};
