//! Changes of settings ▶ interval of the models and budget of a fit, and a reply.

use crate::settings::Settings;
use process::requests::{Inbox, NotAsked, Outcome, Request, changed_before};
use protocol::message::Participant;
use settings::change::{Change, ChangeError, Rules, changed};

/// Settings that may change while the robot drives.
pub const RULES: Rules<'static> =
    Rules { tunable: &["learner.every_ticks", "learner.evaluations_max"], choices: &[] };

/// Why a change is rejected.
#[derive(Debug, thiserror::Error)]
enum Refusal {
    #[error(transparent)]
    NotAsked(#[from] NotAsked),
    #[error(transparent)]
    Change(#[from] ChangeError),
}

impl Refusal {
    /// Its kind, for programs.
    fn code(&self) -> &'static str {
        match self {
            Self::NotAsked(error) => error.code(),
            Self::Change(error) => error.code(),
        }
    }
}

/// Applies requested changes one at a time, and holds the settings in use.
pub(crate) struct TunableSettings {
    inbox: Inbox,
    settings: Settings,
}

impl TunableSettings {
    /// Begins with the changes made earlier in this run.
    pub(crate) fn open(settings: &Settings) -> Self {
        let told = match changed_before(settings, Participant::Learner, &RULES) {
            Ok((settings, _)) => settings,
            Err(error) => {
                tracing::warn!("the changes made earlier in this run are lost: {error}");
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

    /// Applies the next requested change, if there is one. Returns whether any setting has changed:
    /// from the sample after `newest`, a (plant epoch, tick), or from the first sample.
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
                self.inbox.answer(Outcome::refused(refusal.code(), &refusal));
                false
            }
        }
    }

    fn with(&self, request: Result<Request, NotAsked>) -> Result<Settings, Refusal> {
        Ok(changed(&self.settings, &[Change::parse(&request?.change)?], &RULES)?)
    }
}
