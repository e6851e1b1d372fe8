//! The thread beside the control thread: prepares models and changed settings, frees old ones,
//! writes events to the log.

use super::change_requests::ChangeRequests;
use super::{PATIENCE, RunError};
use crate::adopt::{Arrival, Event, Examiner, Handover};
use crate::control::Controller;
use crate::settings::Settings;
use process::Stop;
use protocol::message::ModelSnapshot;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::Thread;
use std::time::Duration;
use transport::{Identity, OpenError, Ports, Since, Source};

/// Longest wait while a change request waits for its answer.
const PROMPT: Duration = Duration::from_millis(2);

/// Reports the end of the attendant thread, whatever its cause.
struct Gone<'a>(&'a AtomicBool);

impl Drop for Gone<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// The attendant: prepares models, frees old ones, writes events to the log.
pub(super) fn attend(
    settings: &Settings,
    connect: &(impl Fn(Identity) -> Result<Ports, OpenError> + Sync),
    identity: Identity,
    handover: &Handover,
    done: &Stop,
    control_thread: &Thread,
) -> Result<(), RunError> {
    let _gone = Gone(&handover.attendant_gone);
    let ports = connect(identity)?;
    let mut snapshots: Source<ModelSnapshot> = ports.source(Since::Joining)?;
    let mut change_requests = ChangeRequests::open(settings);
    let mut examiner = Examiner::new(Controller::expected(settings));
    while !done.requested() {
        snapshots.wait(if change_requests.waits() { PROMPT } else { PATIENCE })?;
        change_requests.poll(handover);
        while let Some(snapshot) = snapshots.next()? {
            let arrival = match examiner.examine(&snapshot) {
                Ok(candidate) => Arrival::Candidate(Box::new(candidate)),
                Err(refusal) => {
                    tracing::warn!("{refusal}");
                    handover.refused.fetch_add(1, Ordering::Relaxed);
                    Arrival::Refused { effective_tick: snapshot.head.effective_tick }
                }
            };
            // A model that was not fetched is replaced by a newer one.
            drop(handover.ready.force_push(arrival));
            control_thread.unpark();
        }
        let tally = snapshots.tally();
        for (slot, count) in
            handover.snapshots.iter().zip([tally.received, tally.lost, tally.refused])
        {
            slot.store(count, Ordering::Relaxed);
        }
        while handover.returned.pop().is_some() {}
        write_events(handover);
    }
    change_requests.close(handover);
    write_events(handover);
    Ok(())
}

fn write_events(handover: &Handover) {
    while let Some(event) = handover.events.pop() {
        match event {
            Event::Plant { epoch, controller_epoch } => {
                tracing::info!(plant_epoch = epoch, controller_epoch, "answering a plant");
            }
            Event::Adopted { version, tick } => tracing::info!(version, tick, "model adopted"),
            Event::FallbackLevel { tick, fallback_level, reason } => {
                tracing::info!(tick, %fallback_level, %reason, "fallback level");
            }
            Event::Sensors { tick, fault: Some(fault) } => tracing::warn!(tick, "{}", fault.text()),
            Event::Sensors { tick, fault: None } => {
                tracing::info!(tick, "the sensors work again");
            }
            Event::Ramp { tick, rate_mps2: Some(rate) } => tracing::info!(
                tick,
                "the drive ramps its commands: plans change rim speeds by {rate:.2} m/s2 at most"
            ),
            Event::Ramp { tick, rate_mps2: None } => {
                tracing::info!(tick, "the drive does not ramp its commands any more");
            }
            Event::List { tick, error } => {
                tracing::warn!(tick, "a list of obstacles is refused: {error}");
            }
            Event::Stop { tick, reason } => {
                tracing::warn!(tick, %reason, "requests a stop of the gate");
            }
            Event::Goal { tick, id, phase } => tracing::info!(tick, id, %phase, "goal"),
            Event::Complaint { tick, complaint } => tracing::warn!(tick, "{complaint}"),
            Event::OutOfTime { tick, nanos } => {
                tracing::warn!(tick, micros = nanos / 1000, "the optimiser ran out of time");
            }
            Event::Late { tick, nanos } => {
                tracing::warn!(tick, micros = nanos / 1000, "period missed");
            }
        }
    }
    let dropped = handover.events_dropped.swap(0, Ordering::Relaxed);
    if dropped > 0 {
        tracing::warn!(dropped, "the event buffer was full; these events are not logged");
    }
}
