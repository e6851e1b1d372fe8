//! A change to a controller that drives: built whole beside the control thread, put in use whole between two ticks.
//!
//! ```text
//!   attendant thread     request ▶ check ▶ build ── tuned ──▶     ┐ control thread: exchanges its parts for the new ones,
//!                        answer ◀ free ◀─── exchanged ───      ┘ and nothing else
//! ```

use super::{Controller, ControllerError};
use crate::mpc::Mpc;
use crate::reference::{Reference, ReferencePoint};
use crate::settings::Settings;
use model::delay::DELAY_MAX;
use model::main_model::MainModel;
use process::Pace;
use protocol::message::HORIZON_MAX;
use settings::change::Rules;

/// What can be changed while the robot drives. What the gate holds against commands, the robot's own limits, cannot.
pub const RULES: Rules<'static> = Rules {
    tunable: &[
        "mpc.weights",
        "mpc.state_limits",
        "mpc.horizon_steps",
        "mpc.control_horizon_steps",
        "mpc.budget_share",
        "mpc.solver",
        "reference",
    ],
    choices: &["reference.path"],
};

/// The parts of a controller that settings decide: those to put in use, then those that were.
pub struct Tuned {
    pub(super) mpc: Mpc,
    /// None if it stays as it is.
    pub(super) reference: Option<Reference>,
    /// Room for as many points as delay and horizon can need.
    pub(super) points: Vec<ReferencePoint>,
    /// Time that an answer may take; `None` in lock step \[ns\].
    pub(super) budget_nanos: Option<u64>,
    /// Once they are in use: epoch of the plant, and the first tick that is answered with them.
    pub since: Option<(u64, u64)>,
}

impl Tuned {
    /// The parts of a controller with these settings; with its reference only if it is not that of `before`. Allocates all that it needs.
    ///
    /// # Errors
    /// [`ControllerError`] if the weights, the solver or the reference refuse.
    pub fn new(settings: &Settings, before: Option<&Settings>) -> Result<Self, ControllerError> {
        let period = settings.run.period_nanos as f64 * 1e-9;
        let mut mpc =
            Mpc::new(&settings.mpc, &settings.robot, &MainModel::new(&settings.robot, period))?;
        mpc.inject(settings.solver_faults.clone());
        // Long enough for every horizon that may come.
        let ticks = (settings.duration_s / period).ceil() as usize + DELAY_MAX + HORIZON_MAX + 1;
        let build = || Reference::new(&settings.reference, &settings.start, period, ticks);
        let stays = before.is_some_and(|before| before.reference == settings.reference);
        let budget = (settings.mpc.budget_share * settings.run.period_nanos as f64) as u64;
        Ok(Self {
            reference: if stays { None } else { Some(build()?) },
            points: vec![ReferencePoint::default(); DELAY_MAX + mpc.horizon() + 1],
            budget_nanos: (settings.run.pace == Pace::RealTime).then_some(budget),
            mpc,
            since: None,
        })
    }
}

impl Controller {
    /// Exchanges the parts that settings decide, for the answer to the first tick from `tick` on: called between two ticks. What is planned
    /// goes on from the plan before. Does not allocate or free.
    pub fn tune(&mut self, tuned: &mut Tuned, tick: u64) {
        tuned.mpc.inherit(&self.mpc);
        std::mem::swap(&mut self.mpc, &mut tuned.mpc);
        std::mem::swap(&mut self.points, &mut tuned.points);
        std::mem::swap(&mut self.budget_nanos, &mut tuned.budget_nanos);
        if let Some(reference) = &mut tuned.reference {
            std::mem::swap(&mut self.reference, reference);
            self.tracking.reset();
            if let Some(judge) = &mut self.loop_judge {
                judge.reset();
            }
        }
        tuned.since = Some((self.plant_epoch.unwrap_or(0), tick));
        if let Some(prepared) = self.prepared_for {
            self.aim(prepared);
        }
    }
}
