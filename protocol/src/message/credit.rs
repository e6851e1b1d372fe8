//! recorder → plant, in lock step: how far the clock may run.

use super::{Participant, Stamp, fixed_message};
use crate::frame::code;
use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};

/// Permission to run: the sender can receive everything up to and including `through_tick`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable, Serialize, Deserialize)]
pub struct Credit {
    /// Writer and time.
    pub stamp: Stamp,
    /// Last tick that the plant may publish.
    pub through_tick: u64,
    /// [`Participant`] that grants it.
    pub participant: u32,
    /// Always zero; not sent over the network.
    #[serde(skip)]
    pub reserved: u32,
}

fixed_message!(Credit, 4, [], |credit| code::<Participant>(
    "Credit",
    "participant",
    credit.participant
));
