//! What to command when the optimiser has no answer: the previous plan shifted, then the LQR on the main model.

use crate::mpc::{Mpc, Outcome, Status, TrackingError};
use crate::reference::ReferencePoint;
use model::{State, Velocity};
use protocol::message::Rung;

/// How many periods in a row a shifted plan is believed.
const SHIFTS_MAX: u32 = 2;

/// Input of the LQR on the main model, which trusts nothing that was learnt: `main_target` holds the reference `point` by that model alone.
/// Does not allocate.
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

/// Chooses the rung, and remembers for how long the plan has not been renewed.
#[derive(Debug, Default)]
pub struct Ladder {
    /// Periods since the plan was fresh; `None` if there never was one.
    shifts: Option<u32>,
}

impl Ladder {
    /// The rung and the input for this period. Does not allocate.
    ///
    /// `point` and `main_target` are for the [`lqr`].
    pub fn choose(
        &mut self,
        outcome: Outcome,
        mpc: &Mpc,
        state: &State,
        point: &ReferencePoint,
        main_target: &Velocity,
        last_input: &Velocity,
    ) -> (Rung, Velocity) {
        let planned = mpc.stages().first().copied().unwrap_or_default();
        if outcome.status == Status::Unpredictable {
            self.reset();
        }
        if outcome.usable() {
            self.shifts = Some(0);
            return (Rung::FreshPlan, planned.input);
        }
        match &mut self.shifts {
            Some(shifts) if *shifts < SHIFTS_MAX => {
                *shifts += 1;
                (Rung::ShiftedPlan, mpc.limits().reach(&planned.input, last_input))
            }
            _ => (Rung::Lqr, lqr(mpc, state, point, main_target, last_input)),
        }
    }

    /// Forgets the last plan.
    pub fn reset(&mut self) {
        self.shifts = None;
    }
}
