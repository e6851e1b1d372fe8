//! One field of a message: its form in memory, on the network and in JSON.

use serde::Serialize;
use std::fmt;

/// Description of one field.
#[derive(Debug, Clone, Copy)]
pub struct Field {
    /// Its name, in every form.
    pub name: &'static str,
    /// Its documentation, with units.
    pub about: &'static str,
    /// Its type on the network.
    pub wire: Wire,
    /// The values that it can have.
    pub allowed: Allowed,
    /// Its form in JSON; none if JSON does not have it.
    pub shape: Option<Shape>,
    /// Its place in the struct \[bytes\].
    pub offset: usize,
}

/// The type of a field on the network. Its display is the notation of WIRE.md.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wire {
    /// The field is not sent.
    Nothing,
    /// A varint.
    U32,
    /// A varint.
    U64,
    /// So many varints.
    Counts(usize),
    /// One number.
    Real,
    /// So many numbers.
    Reals(usize),
    /// So many rows of so many numbers.
    Grid(usize, usize),
    /// At most so many rows of so many numbers, behind their count.
    Rows(usize, usize),
    /// A text of at most so many bytes.
    Text(usize),
}

impl Wire {
    /// Whether the field consists of numbers that can be measured or computed.
    pub const fn is_real(self) -> bool {
        matches!(self, Self::Real | Self::Reals(_) | Self::Grid(..) | Self::Rows(..))
    }
}

impl fmt::Display for Wire {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Nothing => f.write_str("not sent"),
            Self::U32 => f.write_str("u32"),
            Self::U64 => f.write_str("u64"),
            Self::Counts(count) => write!(f, "[u64; {count}]"),
            Self::Real => f.write_str("f64"),
            Self::Reals(count) => write!(f, "[f64; {count}]"),
            Self::Grid(rows, count) => write!(f, "[[f64; {count}]; {rows}]"),
            Self::Rows(most, count) => write!(f, "seq of [f64; {count}], {most} at most"),
            Self::Text(most) => write!(f, "string, {most} bytes at most"),
        }
    }
}

/// The values that a field of whole numbers can have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Allowed {
    /// Any.
    Any,
    /// Any up to this one.
    UpTo(u32),
    /// One of these.
    OneOf(&'static [u32]),
}

/// The form of a value in JSON. A number that is not finite is written as null.
#[derive(Debug, Clone, Copy)]
pub enum Shape {
    /// A whole number.
    Integer,
    /// One number.
    Number,
    /// Any number of numbers.
    Numbers,
    /// Any number of rows of numbers.
    Rows,
    /// Free text.
    Text,
    /// One of a few words.
    Word(&'static [&'static str]),
    /// A whole number for each topic.
    ByTopic,
}

/// Treatment of a field whose type in memory is `T`. `count` is how much of an array counts.
pub(crate) trait Kind<T> {
    /// See [`Field::wire`].
    const WIRE: Wire;
    /// See [`Field::allowed`].
    const ALLOWED: Allowed = Allowed::Any;
    /// See [`Field::shape`].
    const SHAPE: Option<Shape>;
    /// The field on the network.
    type Sent<'a>: Serialize
    where
        T: 'a;
    /// The field in JSON.
    type Shown<'a>: Serialize
    where
        T: 'a;

    fn sent(value: &T, count: usize) -> Self::Sent<'_>;

    fn shown(value: &T, count: usize) -> Self::Shown<'_>;

    /// Sets a field that other fields give on receipt to a value that none of them can.
    fn blank(_value: &mut T) {}

    /// Reads the field from the front of `rest`, and returns how much of it counts.
    fn receive(value: &mut T, rest: &mut &[u8]) -> postcard::Result<usize>;

    /// The value, if it is none that a valid message has.
    fn check(_value: &T) -> Result<(), u64> {
        Ok(())
    }

    /// The numbers of the field; none if it has codes or counts.
    fn numbers(_value: &mut T) -> &mut [f64] {
        &mut []
    }
}
