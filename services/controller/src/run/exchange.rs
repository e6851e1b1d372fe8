//! What the control thread exchanges with the attendant thread: models, settings and goals.

use super::{Loop, PATIENCE, RunError};
use crate::adopt::{Arrival, Candidate, Event};
use process::Stop;
use std::thread;

impl Loop<'_> {
    /// Real time: adopts the newest model that is ready, if there is one.
    pub(super) fn take_newest(&mut self, tick: u64) {
        while let Some(arrival) = self.handover.ready.pop() {
            if let Arrival::Candidate(candidate) = arrival {
                self.adopt(candidate, tick + 1);
            }
        }
    }

    /// Puts changed settings in use, if they are ready. Called between two ticks, and not shortly
    /// before a state is expected.
    pub(super) fn tune(&mut self) {
        self.take_goal();
        let Some(mut tuned) = self.handover.tuned.pop() else { return };
        self.controller.tune(&mut tuned, self.answered.map_or(0, |(_, tick)| tick + 1));
        // The attendant has one change under way at a time. If the slot were full, a leak is better
        // than freeing it here.
        if let Err(before) = self.handover.exchanged.push(tuned) {
            Box::leak(before);
        }
    }

    /// Gives the attendant the way ahead, if it wants it, and takes the goal that it has prepared.
    fn take_goal(&mut self) {
        if let Some(mut outlook) = self.handover.outlook_wanted.pop() {
            let slot = if self.controller.look_out(&mut outlook) {
                &self.handover.outlook
            } else {
                &self.handover.outlook_wanted
            };
            if let Err(outlook) = slot.push(outlook) {
                Box::leak(outlook);
            }
        }
        let next = self.answered.map_or(0, |(_, tick)| tick + 1);
        if let Some(mut course) = self.handover.course.pop() {
            let from = self.controller.follow(&mut course, next).then_some(next);
            if let Err((course, _)) = self.handover.followed.push((course, from)) {
                Box::leak(course);
            }
        }
    }

    /// Publishes what is new of the goal. It is logged when its phase changes.
    pub(super) fn tell_goal(&mut self, tick: u64) -> Result<(), RunError> {
        while let Some(mut goal) = self.controller.told_goal(tick) {
            let (id, phase) = (goal.id, goal.phase());
            if self.goal_told.replace((id, phase)) != Some((id, phase)) {
                self.handover.note(Event::Goal { tick, id, phase });
            }
            let sent = self.goals.send(&mut goal);
            self.beside_control(sent)?;
        }
        Ok(())
    }

    /// Lock step: waits for the model that takes effect at `tick`, if the schedule has one there.
    pub(super) fn take_due(&mut self, tick: u64, stop: &Stop) -> Result<(), RunError> {
        let learned = &self.settings.learned;
        let first = learned.delay_ticks + if learned.resumed { 0 } else { learned.every_ticks };
        let due = learned.enabled
            && tick >= first
            && (tick - learned.delay_ticks).is_multiple_of(learned.every_ticks);
        while due && !stop.requested() {
            match self.handover.ready.pop() {
                Some(Arrival::Candidate(candidate)) => {
                    let effective = candidate.effective_tick;
                    self.adopt(candidate, tick);
                    if effective >= tick {
                        return Ok(());
                    }
                }
                Some(Arrival::Refused { effective_tick }) if effective_tick >= tick => {
                    return Ok(());
                }
                Some(Arrival::Refused { .. }) => {}
                None => {
                    self.watch_attendant()?;
                    thread::park_timeout(PATIENCE);
                    // A restarted learner needs the last sample to know the present tick.
                    self.residuals.refresh()?;
                    self.report();
                }
            }
        }
        Ok(())
    }

    fn adopt(&mut self, candidate: Box<Candidate>, tick: u64) {
        self.handover.note(Event::Adopted { version: candidate.version, tick });
        self.pulse.health().snapshots += 1;
        if let Some(before) = self.controller.adopt(candidate) {
            // The attendant empties the slots far more often than models arrive. If they were full,
            // a leak is better than freeing the model here.
            if let Err(before) = self.handover.returned.push(before) {
                Box::leak(before);
            }
        }
    }
}
