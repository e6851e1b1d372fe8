//! A change of the settings while the controller drives: built beside the control thread, put in
//! use between two ticks.
//!
//! ```text
//!   attendant thread     request ▶ check ▶ build ── tuned ──▶     ┐ control thread: exchanges its
//!                        answer ◀ free ◀─── exchanged ───         ┘ parts for the new ones only
//! ```

use super::ControllerError;
use crate::mpc::Mpc;
use crate::reference::{Reference, ReferencePoint};
use crate::settings::Settings;
use model::delay::DELAY_MAX;
use model::main_model::MainModel;
use process::Pace;
use protocol::message::HORIZON_MAX;
use settings::change::Rules;

/// Settings that can be changed while the robot drives. The robot's own limits, which the gate
/// enforces, are not among them.
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

/// The parts of a controller that depend on settings: first the new ones, then the replaced ones.
pub struct Tuned {
    pub(super) mpc: Mpc,
    /// None if it is unchanged.
    pub(super) reference: Option<Reference>,
    /// Room for as many points as delay and horizon can need.
    pub(super) points: Vec<ReferencePoint>,
    /// Time budget of an answer; `None` in lock step \[ns\].
    pub(super) budget_nanos: Option<u64>,
    /// Once they are in use: epoch of the plant, and the first tick that is answered with them.
    pub since: Option<(u64, u64)>,
}

impl Tuned {
    /// The parts of a controller with these settings. The reference is included only if it differs
    /// from that of `before`. Allocates all memory that the parts need.
    ///
    /// # Errors
    /// [`ControllerError`] if the weights, the solver or the reference are invalid.
    pub fn new(settings: &Settings, before: Option<&Settings>) -> Result<Self, ControllerError> {
        let period = settings.run.period_nanos as f64 * 1e-9;
        let main = MainModel::new(&settings.robot, period);
        let mpc = if settings.sees_obstacles || settings.map.is_some() {
            let map = settings.surroundings();
            Mpc::among_obstacles(&settings.mpc, &settings.robot, &main, &map)?
        } else {
            Mpc::new(&settings.mpc, &settings.robot, &main)?
        };
        #[cfg(feature = "faults")]
        let mpc = mpc.with_faults(settings.solver_faults.clone());
        // Long enough for every horizon that can be set later.
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
