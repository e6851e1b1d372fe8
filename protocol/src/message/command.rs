//! controller → plant: what the wheels do now, and what they do if no further command arrives.

use super::define::message;
use super::kinds::first;
use super::{FallbackLevel, Reason};

/// Longest tail \[periods\]. The gate brakes from 3 periods on, so a longer one would never be
/// played.
pub const TAIL_MAX: usize = 4;

message! {
    /// Answer to one [`PlantState`](super::PlantState). Its `stamp.epoch` is the controller's, its
    /// `stamp.tick` the tick that it answers.
    Command = 2 {
        /// Epoch of the plant whose state is answered.
        plant_epoch: u64,
        /// Version of the learned model in use; 0 is the main model alone.
        model_version: u64,
        /// Body velocity for the period that the answered state began \[m/s, m/s, rad/s\].
        input: [f64; 3],
        /// The plan's next inputs, one per period \[m/s, m/s, rad/s\].
        tail: [[f64; 3]; TAIL_MAX] = rows(tail_len),
        /// How many entries of `tail` count.
        tail_len: u32 = count(TAIL_MAX),
        /// [`FallbackLevel`] of the controller.
        fallback_level: u32 = code(FallbackLevel),
        /// [`Reason`] of a request to the gate to stop and latch: 17 or 18; 0 without a request.
        stop: u32 = stop_request,
        /// Zero.
        reserved: u32 = unused,
    }
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
        first(&self.tail, self.tail_len as usize)
    }
}
