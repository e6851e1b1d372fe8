//! Deviations → one number each. A deviation that is not finite is never within a band. It makes a
//! mean or a largest value null.

use crate::rows::PlanRow;
use std::f64::consts::{PI, TAU};

/// Deviation of the robot from the reference at one tick; no number is negative.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Deviation {
    /// Time since the plant's tick 0 \[ns\].
    pub(super) nanos: u64,
    /// Distance \[m\].
    pub(super) position: f64,
    /// Wrapped difference of the headings \[rad\].
    pub(super) heading: f64,
    /// Difference of speeds \[m/s\].
    pub(super) speed: f64,
}

impl Deviation {
    pub(super) fn of(
        &[x, y, yaw]: &[f64; 3],
        &[forward, left, _]: &[f64; 3],
        plan: &PlanRow,
        nanos: u64,
    ) -> Self {
        let [x_ref, y_ref, yaw_ref, forward_ref, left_ref, _] = plan.reference;
        Self {
            nanos,
            position: (x - x_ref).hypot(y - y_ref),
            heading: ((yaw - yaw_ref + PI).rem_euclid(TAU) - PI).abs(),
            speed: (forward.hypot(left) - forward_ref.hypot(left_ref)).abs(),
        }
    }
}

/// Deviations in the order of time, for figures over a part of them.
pub(super) struct Window<'a> {
    deviations: &'a [Deviation],
}

impl<'a> Window<'a> {
    pub(super) fn of(deviations: &'a [Deviation]) -> Self {
        Self { deviations }
    }

    /// From `start` on \[ns\].
    pub(super) fn from(&self, start: u64) -> impl Iterator<Item = &'a Deviation> {
        self.deviations.iter().filter(move |deviation| deviation.nanos >= start)
    }

    /// The last `length` \[ns\].
    pub(super) fn last(&self, length: u64) -> impl Iterator<Item = &'a Deviation> {
        let end = self.deviations.last().map_or(0, |deviation| deviation.nanos);
        self.from(end.saturating_sub(length))
    }
}

/// First time after which `value` stays within `band` to the end \[s\].
pub(super) fn settled_at(
    deviations: &[Deviation],
    value: impl Fn(&Deviation) -> f64,
    band: f64,
) -> Option<f64> {
    let settled = deviations.iter().rev().take_while(|deviation| value(deviation) <= band);
    settled.last().map(|deviation| deviation.nanos as f64 / 1e9)
}

/// The largest of `values`.
pub(super) fn largest(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut largest = None;
    for value in values {
        if !value.is_finite() {
            return None;
        }
        largest = Some(largest.map_or(value, |largest: f64| largest.max(value)));
    }
    largest
}

/// √(Σ x² / n).
pub(crate) fn root_mean_square(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (count, sum) =
        values.fold((0_u64, 0.0), |(count, sum), value| (count + 1, sum + value * value));
    let mean = sum / count as f64;
    mean.is_finite().then(|| mean.sqrt())
}

/// The smallest of `ascending` that at least `percent` per cent do not exceed (nearest rank).
pub(super) fn percentile(ascending: &[u64], percent: usize) -> Option<u64> {
    let rank = (ascending.len() * percent).div_ceil(100);
    ascending.get(rank.checked_sub(1)?).copied()
}
