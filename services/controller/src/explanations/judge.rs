//! Errors of the predictions → scores, and on each axis the explanation in use.

use super::{COUNT, Explanations, LASTING_S, Model, OBSERVERS, model, observer};
use crate::settings::Identify;

/// Time over which scores decay \[s\].
const MEMORY_S: f64 = 1.0;

/// Another explanation is chosen when its score is below this share of the present one's.
const BETTER: f64 = 0.9;

/// Weight of a score, by model: a model with more ways to be wrong must predict better. A snapshot
/// that has a successor must be clearly better.
const WEIGHTS: [f64; Model::ALL.len()] = [1.0, 1.0, 1.0, 1.3, 3.0];

/// Periods over which the spread of the innovations is averaged.
const SPREAD_PERIODS: f64 = 30.0;

impl Explanations {
    /// Updates the scores of one axis with each model's remaining residual, `left`, and the d at
    /// the time of the prediction.
    pub(super) fn judge(
        &mut self,
        axis: usize,
        left: &[f64; Model::ALL.len()],
        before: &[f64; COUNT],
        lead: usize,
    ) {
        let pass = self.period / (self.period + LASTING_S);
        // With a shorter past: the plain mean.
        let fading = (self.period / MEMORY_S).max(1.0 / (self.taken - lead) as f64);
        let record = &mut self.axes[axis];
        for explanation in (0..COUNT).filter(|&it| observer(it) < self.observers) {
            let before = before[explanation];
            let error = left[explanation / OBSERVERS] - before;
            // A prediction that is not finite is worse than any other.
            let error = if error.is_finite() { error } else { 1e3 };
            let lasting = &mut record.lasting[explanation];
            *lasting += pass * (error - *lasting);
            let score = &mut record.score[explanation];
            *score += fading * (*lasting * *lasting - *score);
        }
        self.choose(axis);
    }

    pub(super) fn correct(&mut self, axis: usize, left: &[f64; Model::ALL.len()]) {
        let (bound, decay, gains) = (self.bound[axis], self.decay[axis], &self.gains[axis]);
        let record = &mut self.axes[axis];
        for explanation in (0..COUNT).filter(|&it| observer(it) < self.observers) {
            let estimate = &mut record.observer[explanation];
            let gain = &gains[observer(explanation)];
            let innovation = estimate.update(gain, decay, left[explanation / OBSERVERS], bound);
            if explanation == record.chosen {
                record.innovation = innovation;
                record.spread += (innovation * innovation - record.spread) / SPREAD_PERIODS;
            }
        }
    }

    pub(super) fn choose(&mut self, axis: usize) {
        let record = &self.axes[axis];
        let score =
            |explanation: usize| WEIGHTS[explanation / OBSERVERS] * record.score[explanation];
        let best = (0..COUNT)
            .filter(|&explanation| self.usable(explanation))
            .min_by(|&a, &b| score(a).total_cmp(&score(b)));
        let (Some(best), chosen) = (best, record.chosen) else { return };
        if score(best) < BETTER * score(chosen) || !self.usable(chosen) {
            let leaves = match model(chosen) {
                Model::Learned => model(best) != Model::Learned,
                Model::LastGood => !model(best).is_learned(),
                Model::Main | Model::Response | Model::Physics => false,
            };
            self.left += u64::from(leaves);
            self.axes[axis].chosen = best;
        }
    }

    fn usable(&self, explanation: usize) -> bool {
        let (model, observer) = (model(explanation), observer(explanation));
        let seen = self.is_long(self.with_learned);
        let known = match model {
            Model::Main => true,
            Model::Response => self.choice.identify != Identify::Off,
            Model::Physics => self.choice.has_physics(),
            Model::Learned => self.active.is_some() && (seen || self.choice.blind),
            Model::LastGood => self.last_good.is_some() && seen,
        };
        let forced = self.choice.blind && self.active.is_some() && model != Model::Learned;
        let at_hand = observer == 0 || self.choice.observer_gain > 0.0 && observer < self.observers;
        known && !forced && at_hand
    }

    /// Whether this number of periods shows lasting errors.
    pub(super) fn is_long(&self, periods: usize) -> bool {
        periods as f64 * self.period > LASTING_S
    }
}
