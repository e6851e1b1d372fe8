//! One dead time, with the response that explains past samples best for it.

use super::least_squares::Fit;
use super::{CONVINCING, EVIDENCE, FRAMES};
use crate::delay::{Delay, LONG_PERIOD_S};
use crate::main_model::MainModel;
use crate::{AXES, Velocity};
use serde::{Deserialize, Serialize};
use std::ops::{Deref, DerefMut};

/// Dead times that are compared \[periods\].
pub(super) const DEAD_TIMES: [f64; 14] =
    [0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0];

/// Those of a long period, of which a part is a long time too \[periods\].
pub(super) const DEAD_TIMES_LONG: [f64; 20] = [
    0.0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875, 1.0, 1.125, 1.25, 1.375, 1.5, 2.0, 2.5, 3.0,
    4.0, 5.0, 6.0, 7.0,
];

/// One value per compared dead time. Does not allocate.
#[derive(Debug, Clone, Copy)]
pub(super) struct PerDeadTime<T> {
    /// The first `count` are in use.
    all: [T; DEAD_TIMES_LONG.len()],
    count: usize,
}

/// One hypothesis per compared dead time.
pub(super) type Hypotheses = PerDeadTime<Hypothesis>;

impl Hypotheses {
    /// Every dead time with the response of `main`.
    pub(super) fn new(main: &MainModel) -> Self {
        let periods: &[f64] =
            if main.period < LONG_PERIOD_S { &DEAD_TIMES } else { &DEAD_TIMES_LONG };
        let of = |index: usize| periods.get(index).copied().unwrap_or_default();
        Self {
            all: std::array::from_fn(|index| Hypothesis::new(main, of(index))),
            count: periods.len(),
        }
    }
}

impl<T> PerDeadTime<T> {
    /// Another value of each dead time.
    pub(super) fn map<U>(&self, of: impl FnMut(&T) -> U) -> PerDeadTime<U> {
        PerDeadTime { all: self.all.each_ref().map(of), count: self.count }
    }
}

impl<T> Deref for PerDeadTime<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        &self.all[..self.count]
    }
}

impl<T> DerefMut for PerDeadTime<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.all[..self.count]
    }
}

/// One period of a velocity.
pub(super) struct Period {
    /// At its start \[m/s, m/s, rad/s\].
    pub(super) before: Velocity,
    /// At its end.
    pub(super) after: Velocity,
    /// t(v) of its start.
    pub(super) turning: Velocity,
    /// Factor that keeps past costs.
    pub(super) forgetting: f64,
    /// Converts a yaw rate to a speed \[–, –, m\].
    pub(super) scale: Velocity,
    /// e^{−T/τ} of a response that follows.
    pub(super) kept: f64,
    /// Weight of its errors; 1 if no wheel slides.
    pub(super) weight: f64,
}

impl Period {
    /// Its velocity at the end, as v and as v − t.
    fn targets(&self, axis: usize) -> [f64; FRAMES] {
        [self.after[axis], self.after[axis] - self.turning[axis]]
    }

    /// Adds the squares of errors to the faded costs.
    pub(super) fn add(&self, costs: &mut [f64; FRAMES], errors: &[Velocity; FRAMES]) {
        for (cost, errors) in costs.iter_mut().zip(errors) {
            let mut squared = 0.0;
            for (error, scale) in errors.iter().zip(self.scale) {
                squared += (scale * error).powi(2);
            }
            *cost = self.forgetting * *cost + self.weight * squared;
        }
    }
}

/// One hypothesis, as an earlier run has found it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct FoundHypothesis {
    /// Dead time \[periods\].
    pub(super) delay: f64,
    pub(super) fits: [Fit; AXES],
    pub(super) costs: [f64; FRAMES],
}

/// One hypothesis of the dead time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Hypothesis {
    pub(super) delay: Delay,
    pub(super) fits: [Fit; AXES],
    /// Sum of the squared errors with forgetting: without t, and with it \[(m/s)²\].
    pub(super) costs: [f64; FRAMES],
}

impl Hypothesis {
    /// A dead time with the response of `main` \[periods\].
    pub(super) fn new(main: &MainModel, periods: f64) -> Self {
        Self {
            delay: Delay::of_periods(periods, main),
            fits: std::array::from_fn(|axis| Fit::new(main.decay[axis], main.gain[axis])),
            costs: [0.0; FRAMES],
        }
    }

    /// What it found so far.
    pub(super) fn found(&self) -> FoundHypothesis {
        FoundHypothesis { delay: self.delay.periods(), fits: self.fits, costs: self.costs }
    }

    /// Continues from `found`, of the same dead time.
    pub(super) fn begin_with(&mut self, found: &FoundHypothesis) {
        (self.fits, self.costs) = (found.fits, found.costs);
    }

    /// Updates fits and costs with a period in which `acted` acted. Returns the errors of the fits
    /// before.
    pub(super) fn update(&mut self, period: &Period, acted: &Velocity) -> [Velocity; FRAMES] {
        let mut errors = [[0.0; AXES]; FRAMES];
        for axis in 0..AXES {
            let features = [period.before[axis], acted[axis], 1.0];
            let Period { forgetting, weight, .. } = *period;
            let of = self.fits[axis].update(&features, &period.targets(axis), forgetting, weight);
            for (errors, error) in errors.iter_mut().zip(of) {
                errors[axis] = error;
            }
        }
        period.add(&mut self.costs, &errors);
        errors
    }

    /// Whether t is used.
    pub(super) fn turns(&self) -> bool {
        self.costs[1] < CONVINCING * self.costs[0]
    }

    pub(super) fn frame(&self) -> usize {
        usize::from(self.turns())
    }

    pub(super) fn cost(&self) -> f64 {
        self.costs[self.frame()]
    }

    pub(super) fn believable(&self) -> bool {
        let frame = self.frame();
        self.cost().is_finite() && self.fits.iter().all(|fit| fit.first_order(frame).believable())
    }
}

/// The dead time with the least cost among the `usable` ones of `count`, if it is convincingly
/// better than the `present` one.
pub(super) fn better(
    count: usize,
    present: usize,
    usable: impl Fn(usize) -> bool,
    cost: impl Fn(usize) -> f64,
) -> Option<usize> {
    let best =
        (0..count).filter(|&index| usable(index)).min_by(|&a, &b| cost(a).total_cmp(&cost(b)))?;
    let (present, least) = (cost(present), cost(best));
    (least < CONVINCING * present && present - least > EVIDENCE).then_some(best)
}
