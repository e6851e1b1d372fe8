//! Settings of the recorder: none of its own. The figures of the summary are fixed.

use process::{HasRun, Run};
use serde::Deserialize;

/// Settings of the recorder.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Settings that the launcher gives to every process.
    pub run: Run,
}

impl settings::Check for Settings {}

impl HasRun for Settings {
    fn run(&self) -> &Run {
        &self.run
    }
}
