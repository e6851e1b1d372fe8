//! The kinds of fields: each treats a value in memory, on the network and in JSON in its own way.

use super::Reason;
use super::codes::Coded;
use super::field::{Allowed, Kind, Shape, Wire};
use super::sequence::Bounded;
use crate::topic::{TOPIC_COUNT, Topic};
use postcard::take_from_bytes;
use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use std::marker::PhantomData;

/// A type whose values are sent and shown as they are.
pub(crate) trait Value: Serialize + for<'de> Deserialize<'de> {
    const WIRE: Wire;
    const SHAPE: Shape;

    fn numbers(&mut self) -> &mut [f64] {
        &mut []
    }
}

macro_rules! values {
    ($(
        $type:ty $(, const $size:ident)*: $wire:expr, $shape:expr, |$this:ident| $numbers:expr;
    )+) => {
        $(impl<$(const $size: usize),*> Value for $type
        where
            $type: Serialize + for<'de> Deserialize<'de>,
        {
            const WIRE: Wire = $wire;
            const SHAPE: Shape = $shape;

            fn numbers(&mut self) -> &mut [f64] {
                let $this = self;
                $numbers
            }
        })+
    };
}

values! {
    u32: Wire::U32, Shape::Integer, |_this| &mut [];
    u64: Wire::U64, Shape::Integer, |_this| &mut [];
    f64: Wire::Real, Shape::Number, |this| std::slice::from_mut(this);
    [f64; N], const N: Wire::Reals(N), Shape::Numbers, |this| this;
    [[f64; N]; R], const R, const N: Wire::Grid(R, N), Shape::Rows, |this| this.as_flattened_mut();
}

/// A value as it is.
pub(crate) struct Plain;

impl<T: Value + 'static> Kind<T> for Plain {
    const WIRE: Wire = T::WIRE;
    const SHAPE: Option<Shape> = Some(T::SHAPE);
    type Sent<'a> = &'a T;
    type Shown<'a> = &'a T;

    fn sent(value: &T, _count: usize) -> &T {
        value
    }

    fn shown(value: &T, _count: usize) -> &T {
        value
    }

    fn receive(value: &mut T, rest: &mut &[u8]) -> postcard::Result<usize> {
        take(value, rest)
    }

    fn numbers(value: &mut T) -> &mut [f64] {
        value.numbers()
    }
}

/// A field that is not sent and not shown.
pub(crate) struct Unused;

impl Kind<u32> for Unused {
    const WIRE: Wire = Wire::Nothing;
    const SHAPE: Option<Shape> = None;
    type Sent<'a> = ();
    type Shown<'a> = ();

    fn sent(_value: &u32, _count: usize) {}

    fn shown(_value: &u32, _count: usize) {}

    fn receive(_value: &mut u32, _rest: &mut &[u8]) -> postcard::Result<usize> {
        Ok(0)
    }
}

/// The number of rows or bytes of other fields that count. It is not sent: their lengths give it.
pub(crate) struct Count<const MAX: u32, const SHOWN: bool = false>;

/// A count that no received field gives.
pub(crate) const UNKNOWN: u32 = u32::MAX;

impl<const MAX: u32, const SHOWN: bool> Kind<u32> for Count<MAX, SHOWN> {
    const WIRE: Wire = Wire::Nothing;
    const SHAPE: Option<Shape> = if SHOWN { Some(Shape::Integer) } else { None };
    type Sent<'a> = ();
    type Shown<'a> = u32;

    fn sent(_value: &u32, _count: usize) {}

    fn shown(value: &u32, _count: usize) -> u32 {
        *value
    }

    fn blank(value: &mut u32) {
        *value = UNKNOWN;
    }

    fn receive(_value: &mut u32, _rest: &mut &[u8]) -> postcard::Result<usize> {
        Ok(0)
    }

    fn check(value: &u32) -> Result<(), u64> {
        up_to(*value, MAX)
    }
}

/// A whole number up to `MAX`, in JSON only if it is `SHOWN`.
pub(crate) struct AtMost<const MAX: u32, const SHOWN: bool = true>;

impl<const MAX: u32, const SHOWN: bool> Kind<u32> for AtMost<MAX, SHOWN> {
    const WIRE: Wire = Wire::U32;
    const ALLOWED: Allowed = Allowed::UpTo(MAX);
    const SHAPE: Option<Shape> = if SHOWN { Some(Shape::Integer) } else { None };
    type Sent<'a> = u32;
    type Shown<'a> = u32;

    fn sent(value: &u32, _count: usize) -> u32 {
        *value
    }

    fn shown(value: &u32, _count: usize) -> u32 {
        *value
    }

    fn receive(value: &mut u32, rest: &mut &[u8]) -> postcard::Result<usize> {
        take(value, rest)
    }

    fn check(value: &u32) -> Result<(), u64> {
        up_to(*value, MAX)
    }
}

/// A code of `E`, in JSON its word.
pub(crate) struct Code<E>(PhantomData<E>);

impl<E: Coded> Kind<u32> for Code<E> {
    const WIRE: Wire = Wire::U32;
    const ALLOWED: Allowed = Allowed::UpTo(E::WORDS.len() as u32 - 1);
    const SHAPE: Option<Shape> = Some(Shape::Word(E::WORDS));
    type Sent<'a> = u32;
    type Shown<'a> = &'static str;

    fn sent(value: &u32, _count: usize) -> u32 {
        *value
    }

    fn shown(value: &u32, _count: usize) -> &'static str {
        E::word(*value)
    }

    fn receive(value: &mut u32, rest: &mut &[u8]) -> postcard::Result<usize> {
        take(value, rest)
    }

    fn check(value: &u32) -> Result<(), u64> {
        E::try_from(*value).map(drop).map_err(|_| u64::from(*value))
    }
}

/// A reason for which a controller may request a stop of the gate, or none.
pub(crate) struct StopRequest;

impl Kind<u32> for StopRequest {
    const WIRE: Wire = Wire::U32;
    const ALLOWED: Allowed = Allowed::OneOf(Reason::STOP_REQUESTS);
    const SHAPE: Option<Shape> = <Code<Reason> as Kind<u32>>::SHAPE;
    type Sent<'a> = u32;
    type Shown<'a> = &'static str;

    fn sent(value: &u32, _count: usize) -> u32 {
        *value
    }

    fn shown(value: &u32, _count: usize) -> &'static str {
        Reason::word(*value)
    }

    fn receive(value: &mut u32, rest: &mut &[u8]) -> postcard::Result<usize> {
        take(value, rest)
    }

    fn check(value: &u32) -> Result<(), u64> {
        if Reason::STOP_REQUESTS.contains(value) { Ok(()) } else { Err(u64::from(*value)) }
    }
}

/// Numbers, or columns of a table, that are all sent, and of which the first `count` are shown.
pub(crate) struct Leading;

impl<const N: usize> Kind<[f64; N]> for Leading
where
    [f64; N]: Serialize + for<'de> Deserialize<'de>,
{
    const WIRE: Wire = Wire::Reals(N);
    const SHAPE: Option<Shape> = Some(Shape::Numbers);
    type Sent<'a> = &'a [f64; N];
    type Shown<'a> = &'a [f64];

    fn sent(value: &[f64; N], _count: usize) -> &[f64; N] {
        value
    }

    fn shown(value: &[f64; N], count: usize) -> &[f64] {
        first(value, count)
    }

    fn receive(value: &mut [f64; N], rest: &mut &[u8]) -> postcard::Result<usize> {
        take(value, rest)
    }

    fn numbers(value: &mut [f64; N]) -> &mut [f64] {
        value
    }
}

impl<const N: usize, const R: usize> Kind<[[f64; N]; R]> for Leading
where
    [[f64; N]; R]: Serialize + for<'de> Deserialize<'de>,
{
    const WIRE: Wire = Wire::Grid(R, N);
    const SHAPE: Option<Shape> = Some(Shape::Rows);
    type Sent<'a> = &'a [[f64; N]; R];
    type Shown<'a> = Columns<'a, N>;

    fn sent(value: &[[f64; N]; R], _count: usize) -> &[[f64; N]; R] {
        value
    }

    fn shown(value: &[[f64; N]; R], count: usize) -> Columns<'_, N> {
        Columns { rows: value, count }
    }

    fn receive(value: &mut [[f64; N]; R], rest: &mut &[u8]) -> postcard::Result<usize> {
        take(value, rest)
    }

    fn numbers(value: &mut [[f64; N]; R]) -> &mut [f64] {
        value.as_flattened_mut()
    }
}

/// The first `count` columns of a table.
pub(crate) struct Columns<'a, const N: usize> {
    rows: &'a [[f64; N]],
    count: usize,
}

impl<const N: usize> Serialize for Columns<'_, N> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.rows.iter().map(|row| first(row, self.count)))
    }
}

/// Rows of numbers, of which the first `count` are sent and shown.
pub(crate) struct Rows;

impl<const N: usize, const MAX: usize> Kind<[[f64; N]; MAX]> for Rows
where
    [f64; N]: Serialize + for<'de> Deserialize<'de>,
{
    const WIRE: Wire = Wire::Rows(MAX, N);
    const SHAPE: Option<Shape> = Some(Shape::Rows);
    type Sent<'a> = &'a [[f64; N]];
    type Shown<'a> = &'a [[f64; N]];

    fn sent(value: &[[f64; N]; MAX], count: usize) -> &[[f64; N]] {
        first(value, count)
    }

    fn shown(value: &[[f64; N]; MAX], count: usize) -> &[[f64; N]] {
        first(value, count)
    }

    fn receive(value: &mut [[f64; N]; MAX], rest: &mut &[u8]) -> postcard::Result<usize> {
        let rows: Bounded<[f64; N], MAX>;
        (rows, *rest) = take_from_bytes(rest)?;
        *value = rows.items;
        Ok(rows.len)
    }

    fn numbers(value: &mut [[f64; N]; MAX]) -> &mut [f64] {
        value.as_flattened_mut()
    }
}

/// A text of UTF-8, of which the first `count` bytes are sent and shown.
pub(crate) struct Text;

impl<const MAX: usize> Kind<[u8; MAX]> for Text {
    const WIRE: Wire = Wire::Text(MAX);
    const SHAPE: Option<Shape> = Some(Shape::Text);
    type Sent<'a> = &'a str;
    type Shown<'a> = &'a str;

    fn sent(value: &[u8; MAX], count: usize) -> &str {
        text(value, count)
    }

    fn shown(value: &[u8; MAX], count: usize) -> &str {
        text(value, count)
    }

    fn receive(value: &mut [u8; MAX], rest: &mut &[u8]) -> postcard::Result<usize> {
        let received: Characters<MAX>;
        (received, *rest) = take_from_bytes(rest)?;
        *value = received.bytes;
        Ok(received.len)
    }
}

/// The first `count` bytes as text.
pub(crate) fn text(bytes: &[u8], count: usize) -> &str {
    std::str::from_utf8(bytes.get(..count).unwrap_or_default()).unwrap_or("(not UTF-8)")
}

/// A text in a fixed place, read without allocating.
struct Characters<const MAX: usize> {
    bytes: [u8; MAX],
    len: usize,
}

impl<'de, const MAX: usize> Deserialize<'de> for Characters<MAX> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Place<const MAX: usize>;
        impl<const MAX: usize> Visitor<'_> for Place<MAX> {
            type Value = Characters<MAX>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "a text of at most {MAX} bytes")
            }

            fn visit_str<E: Error>(self, text: &str) -> Result<Characters<MAX>, E> {
                let mut bytes = [0; MAX];
                let place = bytes
                    .get_mut(..text.len())
                    .ok_or_else(|| E::invalid_length(text.len(), &self))?;
                place.copy_from_slice(text.as_bytes());
                Ok(Characters { bytes, len: text.len() })
            }
        }
        deserializer.deserialize_str(Place)
    }
}

/// Counters in the order of [`Topic::ALL`], in JSON under the names of the topics.
pub(crate) struct ByTopic;

impl Kind<[u64; TOPIC_COUNT]> for ByTopic {
    const WIRE: Wire = Wire::Counts(TOPIC_COUNT);
    const SHAPE: Option<Shape> = Some(Shape::ByTopic);
    type Sent<'a> = &'a [u64; TOPIC_COUNT];
    type Shown<'a> = Counters<'a>;

    fn sent(value: &[u64; TOPIC_COUNT], _count: usize) -> &[u64; TOPIC_COUNT] {
        value
    }

    fn shown(value: &[u64; TOPIC_COUNT], _count: usize) -> Counters<'_> {
        Counters(value)
    }

    fn receive(value: &mut [u64; TOPIC_COUNT], rest: &mut &[u8]) -> postcard::Result<usize> {
        take(value, rest)
    }
}

pub(crate) struct Counters<'a>(&'a [u64; TOPIC_COUNT]);

impl Serialize for Counters<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(Topic::ALL.iter().map(|topic| topic.name()).zip(self.0))
    }
}

fn take<T: for<'de> Deserialize<'de>>(value: &mut T, rest: &mut &[u8]) -> postcard::Result<usize> {
    (*value, *rest) = take_from_bytes(rest)?;
    Ok(0)
}

fn up_to(value: u32, limit: u32) -> Result<(), u64> {
    if value <= limit { Ok(()) } else { Err(u64::from(value)) }
}

/// The first `count` values; all of them if there are fewer.
pub(crate) fn first<T>(values: &[T], count: usize) -> &[T] {
    values.get(..count).unwrap_or(values)
}
