//! Share of the measured residuals in the 95 % interval of the learned model, as far as a record
//! shows it.
//!
//! ```text
//! |residual − ĝ| ≤ 1.96 σ      σ² = variance of g + variance of a sample
//! residual − ĝ = innovation + d
//! ```
//! All figures come from the controller: the variance and the observer's d of one tick, and the
//! residual of the next. A period counts only if it is usable, and if the same learned model was in
//! use on that axis at both ticks. The observer has no part in the interval.

use super::record::Record;
use super::recorded::PlanTick;

/// Half width of the 95 % interval of a normal distribution, in standard deviations.
pub(super) const SPREAD: f64 = 1.96;

/// A learned model compared with one period.
#[derive(Debug, Clone, Copy)]
pub(super) struct Check {
    /// The tick that ended the period.
    pub(super) tick: u64,
    /// Residual minus the mean of the learned model.
    pub(super) error: f64,
    /// σ.
    pub(super) deviation: f64,
}

impl Check {
    pub(super) fn is_within(&self) -> bool {
        self.error.abs() <= SPREAD * self.deviation
    }
}

/// Share of periods in the interval, and their number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Coverage {
    pub(super) share: f64,
    pub(super) periods: usize,
}

/// Every period of `record` in which the learned model was in use on `axis`, in their order.
pub(super) fn checks(record: &Record, axis: usize) -> Vec<Check> {
    let pairs = record
        .plans
        .windows(2)
        .filter_map(|pair| if let [before, after] = pair { Some((before, after)) } else { None });
    let learned = |plan: &PlanTick| plan.version > 0 && plan.learned_axes >> axis & 1 == 1;
    let same = pairs.filter(|(before, after)| {
        before.tick.checked_add(1) == Some(after.tick)
            && before.version == after.version
            && learned(before)
            && learned(after)
    });
    let usable = same.filter(|(_, after)| record.usable.binary_search(&after.tick).is_ok());
    let checks = usable.map(|(before, after)| {
        let beside =
            record.sample_variance.get(&before.version).map_or(0.0, |variance| variance[axis]);
        let deviation = (before.variance[axis] + beside).sqrt();
        Check {
            tick: after.tick,
            error: after.innovation[axis] + before.disturbance[axis],
            deviation,
        }
    });
    checks.filter(|check| check.error.is_finite() && check.deviation.is_finite()).collect()
}

/// Share of `checks` in the interval; `None` if there are none.
pub(super) fn coverage(checks: &[Check]) -> Option<Coverage> {
    let within = checks.iter().filter(|check| check.is_within()).count();
    (!checks.is_empty())
        .then(|| Coverage { share: within as f64 / checks.len() as f64, periods: checks.len() })
}
