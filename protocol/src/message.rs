//! One file per message. Every message is plain data that begins with a [`Stamp`].
//!
//! Sizes are multiples of 8 bytes without padding, so that a message is written straight into
//! loaned shared memory.

mod codes;
mod command;
mod credit;
mod define;
pub mod field;
mod goal;
mod health;
mod kinds;
mod model_snapshot;
mod obstacles;
mod plan;
mod plant_state;
mod residual_sample;
mod sequence;
mod stamp;
mod truth;

pub use codes::{
    Coded, Exposure, FallbackLevel, GateState, GoalKind, GoalPhase, ObstacleSource, Participant,
    Phase, Reason, SolverStatus, UnknownCode,
};
pub use command::{Command, TAIL_MAX};
pub use credit::Credit;
pub use define::{Fields, Fixed};
pub use goal::Goal;
pub use health::{ERROR_TEXT_MAX, Health};
pub use model_snapshot::{INPUTS_MAX, ModelSnapshot, SnapshotHead, SnapshotRow};
pub use obstacles::{OBSTACLE_NUMBERS, OBSTACLES_MAX, Obstacles};
pub use plan::{HORIZON_MAX, Plan};
pub use plant_state::{PlantState, WHEELS_MAX};
pub use residual_sample::ResidualSample;
pub use stamp::Stamp;
pub use truth::Truth;

use crate::frame::DecodeError;
use field::Field;
use serde::ser::SerializeMap;

/// A kind of message: its name, its number, its fields, and its bytes.
pub trait Message: Clone + Send + 'static {
    /// Name in logs, records and errors.
    const NAME: &'static str;
    /// Its documentation.
    const ABOUT: &'static str;
    /// Number on the wire; never reused.
    const KIND: u16;
    /// Longest possible message \[bytes\].
    const BYTES_MAX: usize;

    /// Its fields behind the stamp, in their order.
    fn fields() -> Vec<Field>;

    /// Names of its fields that consist of numbers.
    fn numbers() -> Vec<&'static str> {
        Self::fields().iter().filter(|field| field.wire.is_real()).map(|field| field.name).collect()
    }

    /// Passes every field of [`numbers`](Self::numbers) to `visit`, by its name and as one row, in
    /// their order.
    fn visit_numbers(&mut self, visit: &mut dyn FnMut(&'static str, &mut [f64]));

    /// Writer and time of the message.
    fn stamp(&self) -> &Stamp;

    /// The stamp, for the sink that fills it in.
    fn stamp_mut(&mut self) -> &mut Stamp;

    /// Adds each field that JSON has to `map`, in their order. Of an array only the entries that
    /// count.
    ///
    /// # Errors
    /// Those of `map`.
    fn show<M: SerializeMap>(&self, map: &mut M) -> Result<(), M::Error>;

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
