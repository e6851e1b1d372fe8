//! Model snapshots in: checked and prepared on a thread of their own, handed over through
//! preallocated slots.
//!
//! ```text
//!                    ready ─────▶
//!   attendant thread              control thread       never frees, locks or waits
//!                    ◀───── returned, events
//! ```
//! The attendant also writes the control thread's events to the log, and prepares changes of the
//! settings in the same way.

mod examine;
mod refusal;

use crate::complaints::Complaint;
use crate::control::tuning::Tuned;
use crate::goal::{Course, Outlook};
use crate::sensors::SensorFault;
use crossbeam_queue::ArrayQueue;
use gate::list::ImpossibleList;
use model::Velocity;
use model::gp::posterior::VarianceScratch;
use model::learned::{Layout, Uncertain};
use protocol::message::{FallbackLevel, GoalPhase, Reason};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

pub use examine::{Examiner, prepare};
pub use refusal::Refusal;

/// Requirements of this controller on a snapshot.
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

/// An arrival for the control thread.
#[derive(Debug)]
pub enum Arrival {
    /// A model to use.
    Candidate(Box<Candidate>),
    /// No model for this tick.
    Refused {
        /// Tick at which it would have taken effect.
        effective_tick: u64,
    },
}

/// An event of the control thread for the log.
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
    /// Another fault of the measurements, or the end of a fault.
    Sensors {
        /// At this tick.
        tick: u64,
        /// The fault.
        fault: Option<SensorFault>,
    },
    /// The identified ramp of the drive is another one.
    Ramp {
        /// At this tick.
        tick: u64,
        /// Its rate; none for a drive that follows its command at once \[m/s²\].
        rate_mps2: Option<f64>,
    },
    /// A list of obstacles is refused.
    List {
        /// At this tick.
        tick: u64,
        /// Why.
        error: ImpossibleList,
    },
    /// The gate is requested to stop the robot.
    Stop {
        /// At this tick.
        tick: u64,
        /// Why.
        reason: Reason,
    },
    /// A goal has got into another phase.
    Goal {
        /// At this tick.
        tick: u64,
        /// Number of the goal.
        id: u64,
        /// Its phase.
        phase: GoalPhase,
    },
    /// Driver or robot file has an error.
    Complaint {
        /// At this tick.
        tick: u64,
        /// The error.
        complaint: Complaint,
    },
    /// The optimiser was stopped because its time was used up. A lower fallback level has answered.
    OutOfTime {
        /// The tick.
        tick: u64,
        /// Time that the answer took \[ns\].
        nanos: u64,
    },
    /// A period ended before its answer was ready, or its state was never received.
    Late {
        /// The tick.
        tick: u64,
        /// Time that the answer took \[ns\].
        nanos: u64,
    },
}

/// The slots between the two threads.
pub struct Handover {
    /// Models for the control thread.
    pub ready: ArrayQueue<Arrival>,
    /// Models that are no longer in use, to be freed.
    pub returned: ArrayQueue<Box<Candidate>>,
    /// Changed settings for the control thread, one at a time.
    pub tuned: ArrayQueue<Box<Tuned>>,
    /// The same once they are in use, with the replaced parts, to be freed.
    pub exchanged: ArrayQueue<Box<Tuned>>,
    /// Memory for the way ahead, which the control thread fills.
    pub outlook_wanted: ArrayQueue<Box<Outlook>>,
    /// The way ahead.
    pub outlook: ArrayQueue<Box<Outlook>>,
    /// A goal for the control thread.
    pub course: ArrayQueue<Box<Course>>,
    /// The same with the tick from which on it is in use, if it is, and with what it has replaced.
    pub followed: ArrayQueue<(Box<Course>, Option<u64>)>,
    /// The tick of the newest answer.
    pub tick: AtomicU64,
    /// Events for the log. When it is full, the newest events are dropped and counted.
    pub events: ArrayQueue<Event>,
    /// Events that were dropped.
    pub events_dropped: AtomicU64,
    /// Number of refused snapshots.
    pub refused: AtomicU64,
    /// The attendant has ended.
    pub attendant_gone: AtomicBool,
    /// Snapshots received, lost and malformed on the way, as counted by the attendant's source.
    pub snapshots: [AtomicU64; 3],
}

impl Default for Handover {
    fn default() -> Self {
        Self {
            ready: ArrayQueue::new(4),
            returned: ArrayQueue::new(8),
            tuned: ArrayQueue::new(1),
            exchanged: ArrayQueue::new(1),
            outlook_wanted: ArrayQueue::new(1),
            outlook: ArrayQueue::new(1),
            course: ArrayQueue::new(1),
            followed: ArrayQueue::new(1),
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
    /// Records an event. Does not allocate, lock or wait.
    pub fn note(&self, event: Event) {
        if self.events.push(event).is_err() {
            self.events_dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests;
