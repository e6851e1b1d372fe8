//! Settings of the learner.

#[cfg(feature = "faults")]
mod snapshot_fault;

use model::learned::Layout;
use robot::Robot;
use serde::{Deserialize, Serialize};
use settings::{Check, Impossible};
use std::path::PathBuf;

#[cfg(feature = "faults")]
pub use snapshot_fault::{SnapshotFault, SnapshotFaultKind, SnapshotFaults};

/// Largest number of data points in a snapshot.
const POINTS_MAX: usize = 2_000;

/// All settings of the learner process.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Settings that the launcher gives to every process.
    pub run: process::Run,
    /// The robot as believed.
    pub robot: Robot,
    /// Settings of the learning.
    pub learner: LearnerSettings,
    /// Faults that it injects into its snapshots.
    #[cfg(feature = "faults")]
    #[serde(default, skip_serializing_if = "SnapshotFaults::is_empty")]
    pub snapshot_faults: SnapshotFaults,
}

/// Kernel of the Gaussian processes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum KernelChoice {
    /// A smooth function, of which a sample reveals nothing far away.
    #[serde(rename = "squared-exponential")]
    SquaredExponential,
    /// A wrong gain and an offset, plus a smooth function.
    #[serde(rename = "linear+squared-exponential")]
    LinearPlusSquaredExponential,
}

/// Settings of the learning.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LearnerSettings {
    /// Layout of the inputs of the Gaussian processes.
    pub layout: Layout,
    /// Kernel of the Gaussian processes.
    pub kernel: KernelChoice,
    /// P: smallest number of ticks between two snapshots.
    pub every_ticks: u64,
    /// D: in lock step, ticks from the last training sample until the snapshot takes effect.
    pub delay_ticks: u64,
    /// Size of the data set.
    pub points_max: usize,
    /// Budget of one fit, in evaluations of the likelihood per axis.
    pub evaluations_max: usize,
    /// A snapshot of an earlier run of the same robot to begin with.
    #[serde(default)]
    pub resume: Option<PathBuf>,
}

impl LearnerSettings {
    /// Checks that the values are possible.
    ///
    /// # Errors
    /// [`Impossible`] names the first impossible setting.
    pub fn check(&self) -> Result<(), Impossible> {
        let impossible =
            |key: &str, expected: String| Err(Impossible { key: key.into(), expected });
        if self.layout.has_place() && self.kernel == KernelChoice::SquaredExponential {
            return impossible(
                "kernel",
                format!(
                    "\"linear+squared-exponential\": the layout \"{}\" needs it",
                    self.layout.name()
                ),
            );
        }
        if self.every_ticks == 0 {
            return impossible("every_ticks", "at least 1 period".into());
        }
        if !(2..=200).contains(&self.delay_ticks) {
            return impossible(
                "delay_ticks",
                "2 to 200 periods: at least one sample must score the snapshot".into(),
            );
        }
        if !(4..=POINTS_MAX).contains(&self.points_max) {
            return impossible("points_max", format!("4 to {POINTS_MAX} points"));
        }
        if !(1..=1000).contains(&self.evaluations_max) {
            return impossible("evaluations_max", "1 to 1000 evaluations".into());
        }
        Ok(())
    }
}

impl process::HasRun for Settings {
    fn run(&self) -> &process::Run {
        &self.run
    }
}

impl Check for Settings {
    fn check(&self) -> Result<(), Impossible> {
        self.robot.check().map_err(|e| Impossible {
            key: format!("robot.{}", e.key),
            expected: e.expected.into(),
        })?;
        #[cfg(feature = "faults")]
        self.snapshot_faults.check().map_err(|e| e.under("snapshot_faults"))?;
        self.learner.check().map_err(|e| e.under("learner"))
    }
}
