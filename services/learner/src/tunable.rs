//! The request of a person ▶ how often a model is made and for how long it is fitted, and an answer.

use crate::settings::Settings;
use process::requests::{Inbox, NotAsked, Outcome, Request, changed_before};
use protocol::message::Participant;
use settings::change::{Change, ChangeError, Rules, changed};

/// What can be changed while the robot drives.
pub const RULES: Rules<'static> =
    Rules { tunable: &["learner.every_ticks", "learner.evaluations_max"], choices: &[] };

/// Why a change is refused.
#[derive(Debug, thiserror::Error)]
enum Refusal {
    #[error(transparent)]
    NotAsked(#[from] NotAsked),
    #[error(transparent)]
    Change(#[from] ChangeError),
}

/// Takes requests up, one at a time, and holds what is set.
pub(crate) struct TunableSettings {
    inbox: Inbox,
    settings: Settings,
}

impl TunableSettings {
    /// With what was set before in this run.
    pub(crate) fn open(settings: &Settings) -> Self {
        let told = match changed_before(settings, Participant::Learner, &RULES) {
            Ok((settings, _)) => settings,
            Err(error) => {
                tracing::warn!("what was set before is forgotten: {error}");
                settings.clone()
            }
        };
        Self { inbox: Inbox::open(&settings.run, Participant::Learner), settings: told }
    }

    /// P: ticks between two cuts.
    pub(crate) fn every_ticks(&self) -> u64 {
        self.settings.learner.every_ticks
    }

    /// Budget of one fit, in evaluations per axis.
    pub(crate) fn evaluations_max(&self) -> usize {
        self.settings.learner.evaluations_max
    }

    /// Takes up the next request, if there is one, and says whether anything has changed: from the sample after `newest` on, which is that of
    /// (plant epoch, tick), or from the first.
    pub(crate) fn poll(&mut self, newest: Option<(u64, u64)>) -> bool {
        let Some(request) = self.inbox.take() else { return false };
        let (plant_epoch, taken_at_tick) = newest.unwrap_or_default();
        let acts_from_tick = newest.map_or(0, |(_, tick)| tick + 1);
        match self.with(request) {
            Ok(settings) => {
                self.settings = settings;
                self.inbox.answer(Outcome::Applied {
                    plant_epoch,
                    taken_at_tick,
                    ready_at_tick: taken_at_tick,
                    acts_from_tick,
                });
                true
            }
            Err(refusal) => {
                self.inbox.answer(Outcome::Refused { reason: refusal.to_string() });
                false
            }
        }
    }

    fn with(&self, request: Result<Request, NotAsked>) -> Result<Settings, Refusal> {
        Ok(changed(&self.settings, &[Change::parse(&request?.change)?], &RULES)?)
    }
}
