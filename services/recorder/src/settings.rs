//! What a person may set: nothing yet. The figures of the summary are defined once and for all.

use process::{HasRun, Run};
use serde::Deserialize;

/// Settings of the recorder.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// What the launcher tells every process.
    pub run: Run,
}

impl settings::Check for Settings {}

impl HasRun for Settings {
    fn run(&self) -> &Run {
        &self.run
    }
}
