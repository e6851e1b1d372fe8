//! Dead time: the time from a command to the first response of the robot.
//!
//! ```text
//! δ = (n + w) T,  0 ≤ w < 1        in period k:  c_{k−n−1} acts until w T, then c_{k−n}
//! ```
//! c is the output of the gate to the wheels in each period. An axis that decays by A = e^{−T/τ} in
//! a period reaches the same velocity as with one input α. Its mean velocity is another one:
//!
//! ```text
//! α = β c_{k−n−1} + (1 − β) c_{k−n}                         β = (A^{1−w} − A)/(1 − A)
//! v̄ = (1 − e) v + e v⁺ + ε K (c_{k−n−1} − c_{k−n})          ε = w − (τ/T + e) (A^{1−w} − A)
//! ```
//! K = B/(1 − A) is the gain, and e the weight of the end velocity in the mean of a period with one
//! input. For a slow axis β = w and ε = 0; short periods use this for every axis. An axis that
//! responds at once has β = 0 and ε = w.
//!
//! Reference: Åström, Wittenmark, *Computer-Controlled Systems*, 3rd ed., section 2.3.

use crate::main_model::MainModel;
use crate::{AXES, Velocity};

/// Shortest long period \[s\]. In shorter ones β = w measures as well (decision 53).
pub const LONG_PERIOD_S: f64 = 0.05;

/// Longest dead time that is compensated \[periods\].
pub const DELAY_MAX: usize = 8;

/// Input that acts in one period.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Acting {
    /// α \[m/s, m/s, rad/s\].
    pub input: Velocity,
    /// Part of v̄ that comes from a change of the input within the period \[m/s, m/s, rad/s\].
    pub drift: Velocity,
}

impl From<&Velocity> for Acting {
    /// An input that acts for the whole period.
    fn from(input: &Velocity) -> Self {
        Self { input: *input, drift: [0.0; AXES] }
    }
}

/// Effect of a command that is replaced by the next one within the period, per axis.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Split {
    /// β: share of the command before in the input \[–\].
    pub before: Velocity,
    /// ε K: drift per difference of the command before and the next one \[–\].
    pub drift: Velocity,
}

impl Split {
    /// A period of `main` in which the command before acts until w T.
    fn new(main: &MainModel, w: f64) -> Self {
        let mut split = Self { before: [w; AXES], drift: [0.0; AXES] };
        if w == 0.0 || main.period < LONG_PERIOD_S {
            return split;
        }
        for axis in 0..AXES {
            let (decay, end_share) = (main.decay[axis], main.end_share[axis]);
            let rate = -decay.ln();
            if rate > 1e-4 {
                let left = decay.powf(1.0 - w) - decay;
                let gain = main.gain[axis] / (1.0 - decay);
                split.before[axis] = left / (1.0 - decay);
                split.drift[axis] = gain * (w - (1.0 / rate + end_share) * left);
            }
        }
        split
    }

    /// What acts when `next` replaces `before`.
    pub fn acting(&self, before: &Velocity, next: &Velocity) -> Acting {
        let mut acting = Acting::from(next);
        for axis in 0..AXES {
            let difference = before[axis] - next[axis];
            acting.input[axis] = self.before[axis].mul_add(difference, next[axis]);
            acting.drift[axis] = self.drift[axis] * difference;
        }
        acting
    }
}

/// δ in periods, from 0 to [`DELAY_MAX`], with its effect on the axes of a robot.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Delay {
    periods: f64,
    split: Split,
}

impl Delay {
    /// The valid dead time nearest to `periods`, of the robot of `main`.
    pub fn of_periods(periods: f64, main: &MainModel) -> Self {
        let periods = periods.max(0.0).min(DELAY_MAX as f64);
        Self { periods, split: Split::new(main, periods.fract()) }
    }

    /// δ/T.
    pub fn periods(self) -> f64 {
        self.periods
    }

    /// n: number of periods that a new command cannot change any more.
    pub fn whole(self) -> usize {
        self.periods as usize
    }

    /// The effect of w.
    pub fn split(self) -> Split {
        self.split
    }
}

/// The commands of the last periods. Does not allocate.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sent {
    /// Newest first: that of the period which has just ended.
    commands: [Velocity; DELAY_MAX + 2],
}

impl Sent {
    /// A history in which `input` was always sent.
    pub fn always(input: Velocity) -> Self {
        Self { commands: [input; DELAY_MAX + 2] }
    }

    /// Appends the `command` of one more period.
    pub fn push(&mut self, command: Velocity) {
        self.commands.rotate_right(1);
        self.commands[0] = command;
    }

    /// The command of the period that has just ended.
    pub fn last(&self) -> Velocity {
        self.commands[0]
    }

    /// Input that acted in the period that has just ended.
    pub fn acted(&self, delay: Delay) -> Acting {
        self.acting(delay.whole(), delay)
    }

    /// Input that will act in the period that begins `ahead` periods from now, for `ahead` < n. It
    /// consists of commands that are already sent.
    pub fn under_way(&self, delay: Delay, ahead: usize) -> Acting {
        self.acting(delay.whole().saturating_sub(ahead + 1), delay)
    }

    /// The command of `age` periods ago, after the one before it.
    fn acting(&self, age: usize, delay: Delay) -> Acting {
        delay.split.acting(&self.commands[age + 1], &self.commands[age])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use robot::{Response, Robot};

    fn responding(time_constant_s: Velocity, period: f64) -> MainModel {
        let response =
            Some(Response { time_constant_s, gain: [1.1, 0.9, 1.0], ..Response::default() });
        let robot = Robot { body: None, drive: None, response, ..Robot::example() };
        MainModel::new(&robot, period)
    }

    fn slow() -> MainModel {
        responding([100.0; AXES], 0.1)
    }

    fn counted() -> Sent {
        let mut sent = Sent::default();
        for k in 1..=4 {
            sent.push([f64::from(k), 0.0, 0.0]);
        }
        sent
    }

    #[test]
    fn commands_under_way_act_in_the_order_in_which_they_were_sent() {
        let delay = Delay::of_periods(2.25, &slow());
        // Next period: c_{−2} and a quarter of the one before; then c_{−1}.
        let acting = |ahead| counted().under_way(delay, ahead).input[0];
        for (ahead, expected) in
            [0.75 * 3.0 + 0.25 * 2.0, 0.75 * 4.0 + 0.25 * 3.0].iter().enumerate()
        {
            assert!((acting(ahead) - expected).abs() < 1e-3);
        }
    }

    #[test]
    fn the_acting_input_is_the_command_of_one_dead_time_ago() {
        let acted = |periods| counted().acted(Delay::of_periods(periods, &slow())).input[0];
        assert_eq!(counted().acted(Delay::default()), Acting::from(&[4.0, 0.0, 0.0]));
        assert!((acted(2.25) - (0.75 * 2.0 + 0.25 * 1.0)).abs() < 1e-3);
        // The longest dead time: no command was sent that long ago.
        assert_eq!(acted(1e9), 0.0);
    }

    /// The exact velocities of a first-order axis, in many short periods without a dead time.
    #[test]
    fn a_dead_time_within_a_period_is_exact_for_slow_and_for_quick_axes() {
        let constants = [0.02, 0.1, 0.5];
        let (period, slices) = (0.1, 20_000_usize);
        let main = responding(constants, period);
        let slice = responding(constants, period / slices as f64);
        let (begin, before, next) = ([0.3, -0.2, 0.5], [1.0, -0.5, 0.8], [0.2, 0.4, -1.0]);
        for w in [0.0, 0.2, 0.5, 0.9] {
            let (mut velocity, mut sum) = (begin, [0.0; AXES]);
            for k in 0..slices {
                let input = if (k as f64) < w * slices as f64 { before } else { next };
                let after = slice.next_velocity(&velocity, &input);
                for axis in 0..AXES {
                    sum[axis] += 0.5 * (velocity[axis] + after[axis]) / slices as f64;
                }
                velocity = after;
            }
            let acting = Delay::of_periods(3.0 + w, &main).split().acting(&before, &next);
            let after = main.next_velocity(&begin, &acting.input);
            let mean = main.mean_velocity(&begin, &after);
            for axis in 0..AXES {
                assert!((after[axis] - velocity[axis]).abs() < 1e-9, "{w}: {after:?}");
                assert!(
                    (mean[axis] + acting.drift[axis] - sum[axis]).abs() < 1e-6,
                    "{w}: {mean:?}"
                );
            }
        }
    }
}
