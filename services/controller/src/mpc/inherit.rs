//! The plan of one optimiser → that of the next, whose horizons and weights may differ.

use super::{Mpc, Stage};

impl Mpc {
    /// Continues from the plan of `before`, whose horizons may differ: periods beyond them repeat
    /// their last values. Does not allocate.
    pub fn inherit(&mut self, before: &Self) {
        let (stages, deviations) = (before.stages.iter(), before.deviation.iter());
        let end = before
            .stages
            .last()
            .map(|stage| Stage { state: before.terminal, ..*stage })
            .unwrap_or_default();
        for (stage, old) in self.stages.iter_mut().zip(stages.chain(std::iter::repeat(&end))) {
            *stage = *old;
        }
        let last = before.deviation.last().copied().unwrap_or_default();
        for (deviation, old) in
            self.deviation.iter_mut().zip(deviations.chain(std::iter::repeat(&last)))
        {
            *deviation = *old;
        }
        self.terminal =
            before.stages.get(self.horizon).map_or(before.terminal, |stage| stage.state);
        self.limits.drop_current_rows(before.limits.dropped());
        self.limits.use_current_share(before.limits.current_share());
        self.limits.keep_to_ramp(before.limits.ramp());
        (self.target_disturbance, self.turn) = (before.target_disturbance, before.turn);
    }
}
