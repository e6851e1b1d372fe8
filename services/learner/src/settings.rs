//! What a person may set of the learner.

mod snapshot_fault;

use model::learned::Layout;
use robot::Robot;
use serde::{Deserialize, Serialize};
use settings::{Check, Impossible};
use std::path::PathBuf;

pub use snapshot_fault::{SnapshotFault, SnapshotFaultKind, SnapshotFaults};

/// Most data points that a snapshot may carry.
const POINTS_MAX: usize = 2_000;

/// Everything the learner process is told.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// What the launcher tells every process.
    pub run: process::Run,
    /// The robot as believed.
    pub robot: Robot,
    /// How to learn.
    pub learner: LearnerSettings,
    /// Which bad snapshots it sends on purpose.
    #[serde(default, skip_serializing_if = "SnapshotFaults::is_empty")]
    pub snapshot_faults: SnapshotFaults,
}

/// What the Gaussian processes take for likely before they have seen anything.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum KernelChoice {
    /// A smooth function, of which a sample says nothing far away.
    #[serde(rename = "squared-exponential")]
    SquaredExponential,
    /// A wrong gain and an offset, and a smooth function beside them.
    #[serde(rename = "linear+squared-exponential")]
    LinearPlusSquaredExponential,
}

/// How to learn.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LearnerSettings {
    /// What the Gaussian processes see.
    pub layout: Layout,
    /// What they take for likely.
    pub kernel: KernelChoice,
    /// P: ticks between two snapshots, at least.
    pub every_ticks: u64,
    /// D: in lock step, ticks from the last sample learnt to taking effect.
    pub delay_ticks: u64,
    /// Size of the data set.
    pub points_max: usize,
    /// Budget of one fit, in evaluations of the likelihood per axis.
    pub evaluations_max: usize,
    /// A snapshot to begin with, from an earlier run of the same robot.
    #[serde(default)]
    pub resume: Option<PathBuf>,
}

impl LearnerSettings {
    /// Checks that such a learner can work.
    ///
    /// # Errors
    /// [`Impossible`] names the first setting that cannot be.
    pub fn check(&self) -> Result<(), Impossible> {
        let impossible =
            |key: &str, expected: String| Err(Impossible { key: key.into(), expected });
        if self.every_ticks == 0 {
            return impossible("every_ticks", "at least 1 period".into());
        }
        if !(2..=200).contains(&self.delay_ticks) {
            return impossible(
                "delay_ticks",
                "2 to 200 periods: one at least to score the snapshot on".into(),
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
        self.learner.check().map_err(|e| e.under("learner"))?;
        self.snapshot_faults.check().map_err(|e| e.under("snapshot_faults"))
    }
}
