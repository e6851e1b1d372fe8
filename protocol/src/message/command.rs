//! controller → plant: what the wheels do now, and what they do if no further command arrives.

use super::sequence::Bounded;
use super::{FallbackLevel, Reason, Stamp, check_count, fixed_message};
use crate::frame::{DecodeError, code};
use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Longest tail \[periods\]. The gate brakes from 3 periods on, so a longer one would never be
/// played.
pub const TAIL_MAX: usize = 4;

/// Answer to one [`PlantState`](super::PlantState). Its `stamp.epoch` is the controller's, its
/// `stamp.tick` the tick that it answers.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
pub struct Command {
    /// Writer and time.
    pub stamp: Stamp,
    /// Epoch of the plant whose state is answered.
    pub plant_epoch: u64,
    /// Version of the learned model in use; 0 is the main model alone.
    pub model_version: u64,
    /// Body velocity for the period that the answered state began \[m/s, m/s, rad/s\].
    pub input: [f64; 3],
    /// The plan's next inputs, one per period, of which the first `tail_len` count
    /// \[m/s, m/s, rad/s\].
    pub tail: [[f64; 3]; TAIL_MAX],
    /// How many entries of `tail` count.
    pub tail_len: u32,
    /// [`FallbackLevel`] of the controller.
    pub fallback_level: u32,
    /// [`Reason`] of a request to the gate to stop and latch: a position or a heading error, or
    /// none.
    pub stop: u32,
    /// Zero.
    pub reserved: u32,
}

impl Command {
    /// Reason of a request to the gate to stop; [`Reason::None`] without a request.
    pub fn stop(&self) -> Reason {
        Reason::try_from(self.stop).unwrap_or(Reason::None)
    }

    /// Fallback level of the controller.
    pub fn fallback_level(&self) -> FallbackLevel {
        FallbackLevel::try_from(self.fallback_level).unwrap_or(FallbackLevel::LatchedStop)
    }

    /// The inputs planned for the following periods.
    pub fn tail(&self) -> &[[f64; 3]] {
        self.tail.get(..self.tail_len as usize).unwrap_or(&self.tail)
    }
}

fixed_message!(Command, 2, [input, tail], |command| {
    check_count("Command", "tail_len", command.tail_len, TAIL_MAX)?;
    code::<FallbackLevel>("Command", "fallback_level", command.fallback_level)?;
    match Reason::try_from(command.stop) {
        Ok(reason) if reason == Reason::None || reason.is_stop_request() => Ok(()),
        _ => Err(DecodeError::Value {
            message: "Command",
            field: "stop",
            value: u64::from(command.stop),
        }),
    }
});

/// The serialised part of a command: of the tail only the inputs that count.
#[derive(Serialize)]
#[serde(rename = "Command")]
struct Said<'a> {
    stamp: Stamp,
    plant_epoch: u64,
    model_version: u64,
    input: [f64; 3],
    tail: &'a [[f64; 3]],
    fallback_level: u32,
    stop: u32,
}

#[derive(Deserialize)]
#[serde(rename = "Command")]
struct Heard {
    stamp: Stamp,
    plant_epoch: u64,
    model_version: u64,
    input: [f64; 3],
    tail: Bounded<[f64; 3], TAIL_MAX>,
    fallback_level: u32,
    stop: u32,
}

impl Serialize for Command {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Self { stamp, plant_epoch, model_version, input, fallback_level, stop, .. } = *self;
        Said { stamp, plant_epoch, model_version, input, tail: self.tail(), fallback_level, stop }
            .serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Command {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let Heard { stamp, plant_epoch, model_version, input, tail, fallback_level, stop } =
            Heard::deserialize(deserializer)?;
        Ok(Self {
            stamp,
            plant_epoch,
            model_version,
            input,
            tail: tail.items,
            tail_len: tail.len as u32,
            fallback_level,
            stop,
            reserved: 0,
        })
    }
}
