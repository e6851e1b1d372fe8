//! Bounds of an input: box, wheel speeds and change per period; and the ramp of the brake.

use robot::{Robot, Velocity, WHEELS_MAX};

/// Rounding error of an optimiser at a bound, relative.
const SLACK: f64 = 1e-6;
/// A tenth is added to the change of one period, for the mean at which the optimiser starts.
const CHANGE_SLACK: f64 = 1.1;

/// Bounds of one robot for one period. Constant.
#[derive(Debug, Clone, Copy)]
pub struct Bounds {
    /// T \[ns\].
    pub period_nanos: u64,
    /// Known delay of the link, added to the allowed age \[ns\].
    pub link_delay_nanos: u64,
    input: Velocity,
    /// Change of one period.
    change: Velocity,
    brake: Velocity,
    /// Of J/(r `ω_max`); rows of no wheel are 0.
    wheel: [Velocity; WHEELS_MAX],
}

impl Bounds {
    /// The bounds of `robot`.
    pub fn new(robot: &Robot, period_nanos: u64, link_delay_nanos: u64) -> Self {
        let limits = &robot.limits;
        let period = period_nanos as f64 * 1e-9;
        let top_speed = robot.wheel_speed_limit_radps();
        Self {
            period_nanos,
            link_delay_nanos,
            input: [limits.input_mps, limits.input_mps, limits.yaw_input_radps],
            change: [limits.input_rate_mps2, limits.input_rate_mps2, limits.yaw_input_rate_radps2]
                .map(|rate| rate * period * CHANGE_SLACK),
            brake: [limits.brake_mps2, limits.brake_mps2, limits.yaw_brake_radps2],
            wheel: robot.wheels.scaled_rows(|radius| 1.0 / (radius * top_speed)),
        }
    }

    /// Whether an input is within the box and the wheel speeds.
    pub fn contain(&self, input: &Velocity) -> bool {
        let in_box = input
            .iter()
            .zip(&self.input)
            .all(|(value, bound)| value.abs() <= bound * (1.0 + SLACK));
        let turning = |row: &Velocity| {
            row.iter().zip(input).map(|(a, b)| a * b).sum::<f64>().abs() <= 1.0 + SLACK
        };
        in_box && self.wheel.iter().all(turning)
    }

    /// Whether the command `to` may follow where `from` acts. That may be a tail, one change from
    /// the last input on one side, while the command is one change from it on the other side.
    pub fn allow_change(&self, from: &Velocity, to: &Velocity) -> bool {
        from.iter()
            .zip(to)
            .zip(&self.change)
            .all(|((from, to), change)| (to - from).abs() <= 2.0 * change * (1.0 + SLACK))
    }

    /// The same where the robot is slowed: each axis of `to` may be that far outside of its range
    /// in `from`.
    pub(crate) fn allow_change_between(&self, from: [&Velocity; 3], to: &Velocity) -> bool {
        (0..3).all(|axis| {
            let values = || from.iter().map(|from| from[axis]);
            let least = values().fold(f64::INFINITY, f64::min);
            let most = values().fold(f64::NEG_INFINITY, f64::max);
            let change = 2.0 * self.change[axis] * (1.0 + SLACK);
            (least - change..=most + change).contains(&to[axis])
        })
    }

    /// The largest share of `twist` with which no axis gets faster than `from`, or turns back, by
    /// more than one change.
    pub(crate) fn share_in_reach(&self, from: &Velocity, twist: &Velocity) -> f64 {
        let shares = (0..3).map(|axis| {
            let along = if from[axis] * twist[axis] < 0.0 { -1.0 } else { 1.0 };
            (self.change[axis] + along * from[axis].abs()).max(0.0) / twist[axis].abs()
        });
        // An axis of which nothing is asked limits nothing, even if it is 0 / 0.
        shares.filter(|share| !share.is_nan()).fold(1.0, f64::min)
    }

    /// `twist`, each axis no farther than one change from `from`.
    pub(crate) fn in_reach(&self, from: &Velocity, twist: &Velocity) -> Velocity {
        std::array::from_fn(|axis| {
            let (from, change) = (from[axis], self.change[axis]);
            twist[axis].max(from - change).min(from + change)
        })
    }

    /// `input` after braking for `nanos`.
    pub fn braked(&self, input: &Velocity, nanos: u64) -> Velocity {
        let time = nanos as f64 * 1e-9;
        std::array::from_fn(|axis| {
            let step = self.brake[axis] * time;
            input[axis] - input[axis].clamp(-step, step)
        })
    }

    /// `goal`, a share of the command `asked`, as far as the ramp of the brake allows it `nanos`
    /// after the input `from`. An axis that the command itself slows faster follows the command.
    pub fn slowed(
        &self,
        from: &Velocity,
        asked: &Velocity,
        goal: &Velocity,
        nanos: u64,
    ) -> Velocity {
        let braked = self.braked(from, nanos);
        std::array::from_fn(|axis| {
            let (braked, asked, goal) = (braked[axis], asked[axis], goal[axis]);
            if from[axis] > 0.0 {
                goal.max(braked.min(asked))
            } else if from[axis] < 0.0 {
                goal.min(braked.max(asked))
            } else {
                goal
            }
        })
    }
}
