//! Transport delay: the time from a command to the wheels that follow it.
//!
//! ```text
//! δ = (n + w) T,  0 ≤ w < 1        acting in period k:  w c_{k−n−1} + (1 − w) c_{k−n}
//! ```
//! with c the commands of the periods. The driver reports the input that really acted; it is compared with what was sent. For every n,
//! with a = reported − c_{k−n} and b = c_{k−n−1} − c_{k−n}, least squares over the recent past give
//!
//! ```text
//! w = Σ a·b / Σ b·b        unexplained = Σ a·a − 2 w Σ a·b + w² Σ b·b
//! ```
//! and the n that leaves least unexplained is believed, once the commands have changed enough to tell.

use crate::Velocity;

/// Longest delay that is looked for \[periods\].
pub const DELAY_MAX: usize = 8;

/// Of the sums, what is left of a period after one more: a memory of about fifty periods.
const FORGETTING: f64 = 0.98;

/// Summed squared change of the commands from which on a delay can be told \[(m/s)²\].
const EVIDENCE: f64 = 1e-3;

/// Another delay is believed when it leaves less than this share of what the present one leaves unexplained.
const CONVINCING: f64 = 0.5;

/// δ in periods, from 0 to [`DELAY_MAX`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Delay(f64);

impl Delay {
    /// The nearest possible one to `periods`.
    pub fn of_periods(periods: f64) -> Self {
        Self(periods.max(0.0).min(DELAY_MAX as f64))
    }

    /// δ/T.
    pub fn periods(self) -> f64 {
        self.0
    }

    /// n: periods in which nothing can be changed any more.
    pub fn whole(self) -> usize {
        self.0 as usize
    }

    /// w: share of the command before in what acts.
    pub fn carry(self) -> f64 {
        self.0.fract()
    }
}

/// The commands of the last periods. Does not allocate.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sent {
    /// Newest first: that of the period which has just ended.
    commands: [Velocity; DELAY_MAX + 2],
}

impl Sent {
    /// As if `input` had always been sent.
    pub fn always(input: Velocity) -> Self {
        Self { commands: [input; DELAY_MAX + 2] }
    }

    /// One more period has ended, for which `command` was sent.
    pub fn push(&mut self, command: Velocity) {
        self.commands.rotate_right(1);
        self.commands[0] = command;
    }

    /// The command of the period that has just ended.
    pub fn last(&self) -> Velocity {
        self.commands[0]
    }

    /// What will act in the period that begins in `ahead` periods, for `ahead` < n: it is all under way.
    pub fn under_way(&self, delay: Delay, ahead: usize) -> Velocity {
        let (newer, w) = (delay.whole().saturating_sub(ahead + 1), delay.carry());
        std::array::from_fn(|axis| w * self.commands[newer + 1][axis] + (1.0 - w) * self.commands[newer][axis])
    }
}

/// What a delay of n whole periods, and a part of one more, would explain.
#[derive(Debug, Clone, Copy, Default)]
struct Candidate {
    aa: f64,
    ab: f64,
    bb: f64,
}

impl Candidate {
    fn update(&mut self, reported: &Velocity, newer: &Velocity, older: &Velocity) {
        let (mut aa, mut ab, mut bb) = (0.0, 0.0, 0.0);
        for axis in 0..3 {
            let (a, b) = (reported[axis] - newer[axis], older[axis] - newer[axis]);
            (aa, ab, bb) = (aa + a * a, ab + a * b, bb + b * b);
        }
        (self.aa, self.ab, self.bb) = (FORGETTING * self.aa + aa, FORGETTING * self.ab + ab, FORGETTING * self.bb + bb);
    }

    fn carry(&self) -> f64 {
        if self.bb > 0.0 { (self.ab / self.bb).clamp(0.0, 1.0) } else { 0.0 }
    }

    fn unexplained(&self, carry: f64) -> f64 {
        self.aa - 2.0 * carry * self.ab + carry * carry * self.bb
    }
}

/// Finds δ from what was sent and what acted. Does not allocate.
#[derive(Debug, Clone, Default)]
pub struct DelayEstimator {
    candidates: [Candidate; DELAY_MAX],
    delay: Delay,
}

impl DelayEstimator {
    /// What is believed now; at first, that there is none.
    pub fn delay(&self) -> Delay {
        self.delay
    }

    /// Takes in the period that has just ended: the newest of `sent`, and the input that acted in it.
    pub fn update(&mut self, sent: &Sent, reported: &Velocity) {
        if !reported.iter().chain(sent.commands.iter().flatten()).all(|value| value.is_finite()) {
            return;
        }
        for (candidate, pair) in self.candidates.iter_mut().zip(sent.commands.windows(2)) {
            if let [newer, older] = pair {
                candidate.update(reported, newer, older);
            }
        }
        let moved = self.candidates.iter().map(|candidate| candidate.bb).fold(0.0, f64::max);
        if moved < EVIDENCE {
            return;
        }
        let present = self.candidates[self.delay.whole().min(DELAY_MAX - 1)].unexplained(self.delay.carry());
        let unexplained = |n: usize| self.candidates[n].unexplained(self.candidates[n].carry());
        let best = (0..DELAY_MAX).min_by(|&a, &b| unexplained(a).total_cmp(&unexplained(b))).unwrap_or(0);
        if unexplained(best) < CONVINCING * present && present > 1e-3 * moved {
            self.delay = Delay::of_periods(best as f64 + self.candidates[best].carry());
        }
    }

    /// Forgets everything: another driver.
    pub fn reset(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Commands that change from period to period, and what acts of them after a delay.
    fn found(periods: f64, noise: f64, count: usize) -> DelayEstimator {
        let delay = Delay::of_periods(periods);
        let wave = |k: usize, axis: usize| (0.31 * (k + 7 * axis) as f64).sin() + 0.2 * (1.3 * k as f64).cos();
        // Standing still before the beginning.
        let command = |k: usize, age: usize| -> Velocity { std::array::from_fn(|axis| if k < age { 0.0 } else { wave(k - age, axis) }) };
        let (mut sent, mut estimator) = (Sent::default(), DelayEstimator::default());
        for k in 0..count {
            sent.push(command(k, 0));
            let (newer, older) = (command(k, delay.whole()), command(k, delay.whole() + 1));
            let error = noise * (12.9 * k as f64).sin();
            let acting = std::array::from_fn(|axis| delay.carry() * older[axis] + (1.0 - delay.carry()) * newer[axis] + error);
            estimator.update(&sent, &acting);
        }
        estimator
    }

    proptest! {
        #[test]
        fn a_delay_is_found_to_a_hundredth_of_a_period(periods in 0.0..7.9_f64) {
            let delay = found(periods, 0.0, 40).delay().periods();
            prop_assert!((delay - periods).abs() < 0.04, "{} is not {}", delay, periods);
        }

        #[test]
        fn a_little_noise_moves_it_little(periods in 0.0..7.9_f64) {
            let delay = found(periods, 0.01, 60).delay().periods();
            prop_assert!((delay - periods).abs() < 0.15, "{} is not {}", delay, periods);
        }
    }

    #[test]
    fn who_stands_still_learns_nothing_of_a_delay() {
        let mut estimator = DelayEstimator::default();
        for _ in 0..1000 {
            estimator.update(&Sent::always([0.3, 0.0, 0.0]), &[0.3, 0.0, 0.0]);
        }
        assert_eq!(estimator.delay(), Delay::default());
        estimator.update(&Sent::always([f64::NAN; 3]), &[0.0; 3]);
        assert_eq!(estimator.delay(), Delay::default());
    }

    #[test]
    fn what_is_under_way_acts_in_the_order_in_which_it_was_sent() {
        let mut sent = Sent::default();
        for k in 1..=4 {
            sent.push([f64::from(k), 0.0, 0.0]);
        }
        let delay = Delay::of_periods(2.25);
        // Next period: c_{−2} and a quarter of the one before; then c_{−1}.
        let acting: Vec<f64> = (0..2).map(|ahead| sent.under_way(delay, ahead)[0]).collect();
        assert_eq!(acting, [0.75 * 3.0 + 0.25 * 2.0, 0.75 * 4.0 + 0.25 * 3.0]);
    }
}
