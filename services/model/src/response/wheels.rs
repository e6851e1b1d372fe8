//! The dead time of the drives, from the speeds of the wheels: that of the response which
//! [follows](super::follower) them best.

use super::PERIODS_LEAST;
use super::follower::{Errors, Follower};
use super::hypothesis::{Hypotheses, PerDeadTime, Period, better};
use crate::Velocity;
use crate::delay::Sent;
use crate::main_model::MainModel;

/// Proposes a dead time. Does not allocate.
#[derive(Debug, Clone)]
pub(super) struct ByWheels {
    followers: PerDeadTime<Follower>,
    /// Index of the proposed dead time.
    proposed: usize,
    taken: u32,
}

impl ByWheels {
    /// Begins with `main` and no dead time.
    pub(super) fn new(main: &MainModel) -> Self {
        Self { followers: Hypotheses::new(main).map(Follower::new), proposed: 0, taken: 0 }
    }

    /// Begins with these responses, and with this dead time.
    pub(super) fn begin_with(&mut self, hypotheses: &Hypotheses, proposed: usize) {
        self.followers = hypotheses.map(Follower::new);
        (self.proposed, self.taken) = (proposed, 0);
    }

    /// Errors of the best dead time.
    pub(super) fn errors(&self) -> Errors {
        Errors::least(&self.followers)
    }

    /// Whether the wheels follow the commands. Those that do not are not measured correctly.
    pub(super) fn follow_commands(&self) -> bool {
        self.taken >= PERIODS_LEAST && self.followers[self.proposed].hypothesis.believable()
    }

    /// The next period begins with `wheels`.
    pub(super) fn resume(&mut self, wheels: &Velocity) {
        self.followers.iter_mut().for_each(|follower| follower.resume(wheels));
    }

    /// Processes a period of the wheels; `sent` acted. Returns the proposed dead time, once there
    /// is one.
    pub(super) fn update(&mut self, period: &Period, sent: &Sent) -> Option<usize> {
        self.taken = self.taken.saturating_add(1);
        for follower in self.followers.iter_mut() {
            follower.update(period, &sent.acted(follower.hypothesis.delay).input);
        }
        let of = |index: usize| &self.followers[index];
        let present = of(self.proposed).hypothesis.cost();
        let usable = |index: usize| {
            of(index).hypothesis.believable() && of(index).hypothesis.cost() <= present
        };
        if self.taken >= PERIODS_LEAST {
            let best =
                better(self.followers.len(), self.proposed, usable, |index| of(index).cost());
            self.proposed = best.unwrap_or(self.proposed);
        }
        (self.taken >= PERIODS_LEAST).then_some(self.proposed)
    }
}
