//! The rows of the motor currents: which hold, and how much of the limit plans use.
//!
//! A speed loop sets the current k_p J (u − v)/r at the start of a period. It decays as the robot
//! follows, with the main model, and its mean over the period is what moves the robot. A stiff loop
//! needs only a part of a long period. A bound of i_max on its start would then leave most of what
//! the motor can do unused. So the start may have
//!
//! ```text
//! s i_max,  s = 0.6/φ from 1 to 2
//! φ = (1 − A)/(−ln A)   mean of the current over a period, as a share of its start
//! ```
//! With s above 1 the motor saturates at first, and the robot follows a little later than planned.
//! Where T is shorter than 1.1 time constants of the loop, s is 1.

use super::{Limits, dot};
use crate::currents::Foretold;
use crate::mpc::Stage;
use model::main_model::MainModel;
use model::{State, Velocity};
use robot::WHEELS_MAX;

/// Share of the limit on currents that plans use in the mean over a period, if a bound on its start
/// would leave more unused.
const MEAN_SHARE: f64 = 0.6;
/// Largest s. With more, a stiff loop swings while its dead time is known only roughly.
const START_MAX: f64 = 2.0;

/// s: largest share of the limit on currents at the start of a period.
pub(super) fn share_max(main: &MainModel) -> f64 {
    (MEAN_SHARE / mean(main)).clamp(1.0, START_MAX)
}

/// φ: mean of a current over a period, as a share of its start.
fn mean(main: &MainModel) -> f64 {
    1.0 - main.end_share[0] * (1.0 - main.decay[0])
}

impl Limits {
    /// From now on the current rows of these wheels are inactive.
    pub fn drop_current_rows(&mut self, wheels: [bool; WHEELS_MAX]) {
        self.dropped = wheels;
    }

    /// Wheels whose current rows are dropped.
    pub(in crate::mpc) fn dropped(&self) -> [bool; WHEELS_MAX] {
        self.dropped
    }

    /// From now on plans keep to a floor that can hold this share of the limit on currents, in the
    /// mean over a period. The rows bound the current at its start, from where it decays with the
    /// main model. Returns whether that is new.
    pub(in crate::mpc) fn keep_to_grip(&mut self, grip: f64) -> bool {
        self.use_current_share((grip / mean(&self.main)).min(self.current_share_max))
    }

    /// From now on plans use this share of the limit on currents. Returns whether that is new.
    pub(in crate::mpc) fn use_current_share(&mut self, share: f64) -> bool {
        let is_new = self.current_share != share;
        if is_new {
            let rows = self.inputs.current.unwrap_or_default();
            self.current = rows.map(|row| row.map(|value| value / share));
            self.current_share = share;
        }
        is_new
    }

    /// Share of the limit on currents that plans use.
    pub(in crate::mpc) fn current_share(&self) -> f64 {
        self.current_share
    }

    /// Motor currents that a plan predicts for its first period.
    pub(in crate::mpc) fn foretold_currents(&self, first: &Stage, after: &State) -> Foretold {
        let unmodelled = self.unmodelled(&first.state.velocity, after);
        let at = |velocity: &Velocity| {
            let beyond =
                std::array::from_fn(|axis| first.input[axis] - velocity[axis] + unmodelled[axis]);
            self.inputs.current.unwrap_or_default().map(|row| dot(&row, &beyond))
        };
        Foretold {
            start: at(&first.state.velocity),
            end: at(&after.velocity),
            most: self.current_share_max,
        }
    }

    /// The acceleration that the main model does not explain, as the u − v that would cause it:
    /// (g + d)/(1 − A), with g + d the difference between the prediction and the main model. A
    /// robot that slips, or whose speed loop has an integral part, drives steadily at u ≠ v without
    /// much current. The value belongs to the plan, and is constant while the program is solved.
    pub(super) fn unmodelled(&self, before: &Velocity, after: &State) -> Velocity {
        let expected = self.main.next_velocity(before, &after.acted);
        std::array::from_fn(|axis| {
            (after.velocity[axis] - expected[axis]) / (1.0 - self.main.decay[axis])
        })
    }
}
