//! recorder → plant, in lock step: how far the clock may run.

use super::Participant;
use super::define::message;

message! {
    /// Permission to run: the sender can receive everything up to and including `through_tick`.
    Credit = 4 {
        /// Last tick that the plant may publish.
        through_tick: u64,
        /// [`Participant`] that grants it.
        participant: u32 = code(Participant),
        /// Always zero; not sent over the network.
        reserved: u32 = unused,
    }
}
