//! Model snapshots in: checked and prepared on a thread of their own, handed over through preallocated slots.
//!
//! ```text
//!                    ready ─────▶
//!   attendant thread              control thread       nothing is freed, locked or waited for on the right
//!                    ◀───── returned, events
//! ```
//! The attendant also writes the control thread's events to the log, and has what a person changes ready in the same way.

mod examine;
mod refusal;

use crate::complaints::Complaint;
use crate::control::tuning::Tuned;
use crate::sensors::SensorFault;
use crossbeam_queue::ArrayQueue;
use model::Velocity;
use model::gp::posterior::VarianceScratch;
use model::learned::{Layout, Uncertain};
use protocol::message::{FallbackLevel, Reason};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

pub use examine::{Examiner, prepare};
pub use refusal::Refusal;

/// What this controller can use.
#[derive(Debug, Clone, Copy)]
pub struct Expected {
    /// Fingerprint of its main model and layout.
    pub fingerprint: u64,
    /// Layout of the inputs.
    pub layout: Layout,
    /// Largest |g| that physics allows, per period \[m/s, m/s, rad/s\].
    pub bound: Velocity,
}

/// A snapshot ready for use.
#[derive(Debug)]
pub struct Candidate {
    /// Version of the snapshot.
    pub version: u64,
    /// Epoch of the plant that it was learnt from.
    pub plant_epoch: u64,
    /// In lock step: tick at which it takes effect.
    pub effective_tick: u64,
    /// The model.
    pub learned: Box<dyn Uncertain + Send>,
    /// For its variance.
    pub scratch: VarianceScratch,
}

/// What comes to the control thread.
#[derive(Debug)]
pub enum Arrival {
    /// A model to use.
    Candidate(Box<Candidate>),
    /// There will be none for this tick.
    Refused {
        /// Tick at which it would have taken effect.
        effective_tick: u64,
    },
}

/// Something that the control thread wants written down.
#[derive(Debug, Clone, Copy)]
pub enum Event {
    /// First state of a plant epoch.
    Plant {
        /// The plant's epoch.
        epoch: u64,
        /// The controller's own.
        controller_epoch: u64,
    },
    /// Another model is in use.
    Adopted {
        /// Its version.
        version: u64,
        /// From this tick on.
        tick: u64,
    },
    /// Another fallback level than the one before.
    FallbackLevel {
        /// At this tick.
        tick: u64,
        /// The fallback level.
        fallback_level: FallbackLevel,
        /// Why.
        reason: Reason,
    },
    /// Something else is wrong with what is measured, or nothing any more.
    Sensors {
        /// At this tick.
        tick: u64,
        /// What.
        fault: Option<SensorFault>,
    },
    /// The gate is asked to stop.
    Stop {
        /// At this tick.
        tick: u64,
        /// Why.
        reason: Reason,
    },
    /// Something is wrong with driver or robot file.
    Complaint {
        /// At this tick.
        tick: u64,
        /// What.
        complaint: Complaint,
    },
    /// The optimiser was stopped because its time was used up: a lower fallback level has answered.
    OutOfTime {
        /// The tick.
        tick: u64,
        /// Time that the answer took \[ns\].
        nanos: u64,
    },
    /// A period was over before its answer was ready, or its state was never seen.
    Late {
        /// The tick.
        tick: u64,
        /// Time that the answer took \[ns\].
        nanos: u64,
    },
}

/// The slots between the two threads.
pub struct Handover {
    /// To the control thread.
    pub ready: ArrayQueue<Arrival>,
    /// Models that are no longer in use, to be freed.
    pub returned: ArrayQueue<Box<Candidate>>,
    /// What a person has changed: to the control thread, one at a time.
    pub tuned: ArrayQueue<Box<Tuned>>,
    /// The same once it is in use, with what was before, to be freed.
    pub exchanged: ArrayQueue<Box<Tuned>>,
    /// The tick of the newest answer.
    pub tick: AtomicU64,
    /// To the log; when it is full the newest are dropped and counted.
    pub events: ArrayQueue<Event>,
    /// Events that were dropped.
    pub events_dropped: AtomicU64,
    /// Snapshots refused.
    pub refused: AtomicU64,
    /// The attendant has ended.
    pub attendant_gone: AtomicBool,
    /// Snapshots received, lost and malformed on the way, as the attendant's source counted them.
    pub snapshots: [AtomicU64; 3],
}

impl Default for Handover {
    fn default() -> Self {
        Self {
            ready: ArrayQueue::new(4),
            returned: ArrayQueue::new(8),
            tuned: ArrayQueue::new(1),
            exchanged: ArrayQueue::new(1),
            tick: AtomicU64::new(0),
            events: ArrayQueue::new(256),
            events_dropped: AtomicU64::new(0),
            refused: AtomicU64::new(0),
            attendant_gone: AtomicBool::new(false),
            snapshots: Default::default(),
        }
    }
}

impl Handover {
    /// Notes an event. Does not allocate, lock or wait.
    pub fn note(&self, event: Event) {
        if self.events.push(event).is_err() {
            self.events_dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests;
