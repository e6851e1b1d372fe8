//! The command when the optimiser has no answer: the previous plan shifted, then the LQR on the
//! main model. If plans do not hold the robot: feedforward and proportional feedback of the pose.
//! The LQR and the feedback are on the same level, that of the simple controller (decision 34).

use crate::mpc::{Mpc, Outcome, Status, TrackingError};
use crate::reference::ReferencePoint;
use model::main_model::MainModel;
use model::{AXES, Pose, State, Velocity, wrap};
use protocol::message::FallbackLevel;

/// Proportional feedback gain of the pose \[1/s\].
pub const GAIN_PER_S: f64 = 2.0;

/// Largest number of consecutive periods with a shifted plan.
const SHIFTS_MAX: u32 = 2;

/// Input of the LQR on the main model, for use without a plan: `main_target` holds the reference
/// `point` by that model alone. Does not allocate.
pub fn lqr(
    mpc: &Mpc,
    state: &State,
    point: &ReferencePoint,
    main_target: &Velocity,
    last_input: &Velocity,
) -> Velocity {
    let error = TrackingError::new(state, point);
    mpc.limits().reach(&mpc.cost().lqr_input(&error, main_target), last_input)
}

/// The simple controller, which uses no learned model: the input that holds the reference `point`
/// by the main model, plus feedback of the robot's position error. It keeps the bounds on heading
/// and speed, as far as that is possible without prediction. Does not allocate.
pub fn simple(
    mpc: &Mpc,
    main: &MainModel,
    pose: &Pose,
    point: &ReferencePoint,
    last_input: &Velocity,
) -> Velocity {
    let point = &mpc.limits().admitted(point);
    let target = mpc.main_target(main, point, pose[2], &[0.0; AXES]);
    let (sin, cos) = pose[2].sin_cos();
    let [x, y] = [point.pose[0] - pose[0], point.pose[1] - pose[1]];
    let behind = [cos * x + sin * y, cos * y - sin * x, wrap(point.pose[2] - pose[2])];
    let desired = std::array::from_fn(|axis| target[axis] + GAIN_PER_S * behind[axis]);
    mpc.limits().reach(&mpc.limits().slowed(&desired), last_input)
}

/// Chooses the fallback level, and counts the periods since the plan was fresh.
#[derive(Debug, Default)]
pub struct FallbackChoice {
    /// Periods since the plan was fresh; `None` if there never was one.
    shifts: Option<u32>,
}

impl FallbackChoice {
    /// Records the `outcome` of the optimiser while another controller drives. A plan that was not
    /// renewed in such a period is not shifted later.
    pub fn look(&mut self, outcome: Outcome) {
        self.shifts = outcome.usable().then_some(0);
    }

    /// The fallback level and the input for this period; `None` if there is no plan. Does not
    /// allocate.
    pub fn choose(
        &mut self,
        outcome: Outcome,
        mpc: &Mpc,
        last_input: &Velocity,
    ) -> Option<(FallbackLevel, Velocity)> {
        let planned = mpc.stages().first().copied().unwrap_or_default();
        if outcome.status == Status::Unpredictable {
            self.reset();
        }
        if outcome.usable() {
            self.shifts = Some(0);
            return Some((FallbackLevel::FreshPlan, planned.input));
        }
        match &mut self.shifts {
            Some(shifts) if *shifts < SHIFTS_MAX => {
                *shifts += 1;
                Some((FallbackLevel::ShiftedPlan, mpc.limits().reach(&planned.input, last_input)))
            }
            _ => None,
        }
    }

    /// Drops the last plan.
    pub fn reset(&mut self) {
        self.shifts = None;
    }
}

#[cfg(test)]
mod tests;
