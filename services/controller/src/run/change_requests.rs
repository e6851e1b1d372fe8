//! Change request of an operator ▶ parts for the control thread, and an answer.

use crate::adopt::Handover;
use crate::control::ControllerError;
use crate::control::tuning::{RULES, Tuned};
use crate::settings::Settings;
use process::requests::{Inbox, NotAsked, Outcome, Request};
use protocol::message::Participant;
use settings::change::{Change, ChangeError, changed};
use std::sync::atomic::Ordering;

/// A change is refused.
#[derive(Debug, thiserror::Error)]
enum Refusal {
    #[error(transparent)]
    NotAsked(#[from] NotAsked),
    #[error(transparent)]
    Change(#[from] ChangeError),
    #[error(transparent)]
    Controller(#[from] ControllerError),
    #[error("the run ended before the change could take effect")]
    Over,
}

/// A change that the control thread has not put in use yet.
struct UnderWay {
    settings: Settings,
    taken_at_tick: u64,
    ready_at_tick: u64,
}

/// Processes requests, one at a time.
pub(super) struct ChangeRequests {
    inbox: Inbox,
    /// Settings in use.
    settings: Settings,
    under_way: Option<UnderWay>,
}

impl ChangeRequests {
    pub(super) fn open(settings: &Settings) -> Self {
        Self {
            inbox: Inbox::open(&settings.run, Participant::Controller),
            settings: settings.clone(),
            under_way: None,
        }
    }

    /// Whether a change waits for the control thread, before it can be answered.
    pub(super) fn waits(&self) -> bool {
        self.under_way.is_some()
    }

    /// Answers the change that was put in use, and takes the next request.
    pub(super) fn poll(&mut self, handover: &Handover) {
        self.answer_exchanged(handover);
        if self.under_way.is_some() {
            return;
        }
        let Some(request) = self.inbox.take() else { return };
        let taken_at_tick = handover.tick.load(Ordering::Relaxed);
        match self.build(request) {
            Ok((settings, tuned)) => {
                self.under_way = Some(UnderWay {
                    settings,
                    taken_at_tick,
                    ready_at_tick: handover.tick.load(Ordering::Relaxed),
                });
                // The slot is free: nothing else is under way.
                drop(handover.tuned.push(Box::new(tuned)));
            }
            Err(refusal) => self.refuse(&refusal),
        }
    }

    /// Ends the service: the control thread puts no more changes in use.
    pub(super) fn close(&mut self, handover: &Handover) {
        self.answer_exchanged(handover);
        if self.under_way.take().is_some() {
            self.refuse(&Refusal::Over);
        }
    }

    fn build(&self, request: Result<Request, NotAsked>) -> Result<(Settings, Tuned), Refusal> {
        let change = Change::parse(&request?.change)?;
        let settings = changed(&self.settings, &[change], &RULES)?;
        let tuned = Tuned::new(&settings, Some(&self.settings))?;
        Ok((settings, tuned))
    }

    fn refuse(&mut self, refusal: &Refusal) {
        self.inbox.answer(Outcome::Refused { reason: refusal.to_string() });
    }

    fn answer_exchanged(&mut self, handover: &Handover) {
        let Some(tuned) = handover.exchanged.pop() else { return };
        let (
            Some(UnderWay { settings, taken_at_tick, ready_at_tick }),
            Some((plant_epoch, acts_from_tick)),
        ) = (self.under_way.take(), tuned.since)
        else {
            return;
        };
        self.settings = settings;
        // A plant that has restarted meanwhile counts its ticks from zero.
        let [taken_at_tick, ready_at_tick] =
            [taken_at_tick, ready_at_tick].map(|tick| tick.min(acts_from_tick));
        self.inbox.answer(Outcome::Applied {
            plant_epoch,
            taken_at_tick,
            ready_at_tick,
            acts_from_tick,
        });
    }
}
