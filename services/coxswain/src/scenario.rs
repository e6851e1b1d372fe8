//! The scenario file: what the robot shall follow, how it is controlled, and what is really the case.

use controller::reference::{Reference, ReferenceSettings};
use controller::settings::MpcSettings;
use learner::settings::LearnerSettings;
use plant_sim::truth::{Start, Truth};
use serde::Deserialize;
use settings::{Check, Impossible};

/// Longest run \[s\].
pub const DURATION_MAX_S: f64 = 1e4;

/// What a scenario file holds.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// In one sentence.
    pub description: String,
    /// Control period T \[ms\].
    pub period_millis: f64,
    /// Length of the run \[s\].
    pub duration_s: f64,
    /// Seed of noise and random forces.
    pub seed: u64,
    /// Where and how the robot starts.
    pub start: Start,
    /// What to follow.
    pub reference: ReferenceSettings,
    /// How to follow it.
    pub mpc: MpcSettings,
    /// How to learn.
    pub learner: LearnerSettings,
    /// What is really the case, which the controller does not know.
    pub truth: Truth,
}

impl Scenario {
    /// Control period \[ns\].
    pub fn period_nanos(&self) -> u64 {
        (self.period_millis * 1e6).round() as u64
    }
}

impl Check for Scenario {
    fn check(&self) -> Result<(), Impossible> {
        if !(1.0..=1000.0).contains(&self.period_millis) {
            return Err(Impossible::new("period_millis", "1 to 1000 ms"));
        }
        if !(self.duration_s > 0.0 && self.duration_s <= DURATION_MAX_S) {
            return Err(Impossible::new("duration_s", "more than 0 and at most 10000 s"));
        }
        if i64::try_from(self.seed).is_err() {
            return Err(Impossible::new("seed", "at most 9223372036854775807, the largest number of TOML"));
        }
        for (key, values) in [("start.pose", self.start.pose), ("start.velocity", self.start.velocity)] {
            if !values.iter().all(|value| value.is_finite()) {
                return Err(Impossible::new(key, "three finite numbers"));
            }
        }
        self.reference.check().map_err(|impossible| impossible.under("reference"))?;
        // Only a file of points can fail here; which file and why is in the error.
        Reference::new(&self.reference, &self.start.pose, self.period_millis * 1e-3, 0)
            .map_err(|error| Impossible::new("reference.path.points.file", format!("a usable file of points: {error}")))?;
        self.mpc.check().map_err(|impossible| impossible.under("mpc"))?;
        self.learner.check().map_err(|impossible| impossible.under("learner"))?;
        if self.learner.resume.as_ref().is_some_and(|file| !file.is_file()) {
            return Err(Impossible::new("learner.resume", "the snapshot of an earlier run, but there is no such file"));
        }
        self.truth.check().map_err(|impossible| Impossible::new(impossible.key, impossible.expected).under("truth"))
    }
}
