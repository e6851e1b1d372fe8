//! Sleeps until a writer notifies: the event part of one reader.

use super::service::Events;
use iceoryx2::port::listener::Listener;
use iceoryx2::prelude::{
    CallbackProgression, SignalHandlingMode, WaitSet, WaitSetBuilder, ipc_threadsafe,
};
use iceoryx2::waitset::WaitSetRunResult;
use std::mem;
use std::thread;
use std::time::Duration;

/// The system's wait for events counts whole milliseconds.
const TICK: Duration = Duration::from_millis(1);

/// A shorter sleep is divided into pieces; the caller polls between them.
const PIECE: Duration = Duration::from_micros(100);

/// Longest single wait for events; its number of milliseconds must fit an `i32`.
const SLEEP_MAX: Duration = Duration::from_hours(1);

/// How a sleep ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Slept {
    /// A writer notified, or some time has passed.
    Awake,
    /// A signal came.
    Interrupted,
}

/// A listener, and what sleeps on it.
///
/// The listener alone could sleep too, but it counts its timeout in the kernel's scheduling ticks:
/// 100 µs then take up to 12 ms.
pub(super) struct Alarm {
    /// Declared before the listener, whose socket it watches: fields are dropped in order.
    waitset: WaitSet<ipc_threadsafe::Service>,
    listener: Listener<ipc_threadsafe::Service>,
}

impl Alarm {
    pub(super) fn new(events: &Events) -> Result<Self, &'static str> {
        let listener =
            events.listener_builder().create().map_err(|_| "the limit of listeners is reached")?;
        let waitset = WaitSetBuilder::new().signal_handling_mode(SignalHandlingMode::Disabled);
        let waitset = waitset.create().map_err(|_| "the system provides no event queue")?;
        let guard = waitset
            .attach_notification(&listener)
            .map_err(|_| "its events cannot be waited for")?;
        // The listener is watched as long as both live. The guard would borrow from them. The
        // system removes a closed socket from the set by itself.
        mem::forget(guard);
        Ok(Self { waitset, listener })
    }

    /// Discards the notifications so far. Call it before each check for waiting messages; otherwise
    /// a sleep could miss one.
    pub(super) fn reset(&self) -> Result<(), &'static str> {
        self.listener.try_wait(|_| {}).map(drop).map_err(|_| "its events cannot be taken")
    }

    /// Sleeps until a writer has notified since the last [`reset`](Self::reset), or until `most` is
    /// over. `most` is rounded up to whole milliseconds; of less than one, only a part is slept.
    pub(super) fn sleep(&self, most: Duration) -> Result<Slept, &'static str> {
        if most < TICK {
            thread::sleep(most.min(PIECE));
            return Ok(Slept::Awake);
        }
        match self
            .waitset
            .wait_and_process_once_with_timeout(|_| CallbackProgression::Stop, most.min(SLEEP_MAX))
        {
            Ok(WaitSetRunResult::Interrupt | WaitSetRunResult::TerminationRequest) => {
                Ok(Slept::Interrupted)
            }
            Ok(WaitSetRunResult::StopRequest | WaitSetRunResult::AllEventsHandled) => {
                Ok(Slept::Awake)
            }
            Err(_) => Err("its events cannot be waited for"),
        }
    }
}
