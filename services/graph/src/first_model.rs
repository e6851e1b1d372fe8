//! The learned model that a run begins with: a snapshot, checked before anything starts.

use crate::assembly::Assembly;
use controller::adopt;
use controller::control::Controller;
use learner::store::{self, StoreError};
use process::Run;
use protocol::message::ModelSnapshot;
use settings::SettingsError;
use std::path::Path;

/// A snapshot that this run cannot use.
fn unusable(file: &Path, key: &str, value: Option<String>, expected: String) -> SettingsError {
    let (file, key) = (file.to_owned(), key.to_owned());
    SettingsError::Value { file, line: None, key, value, expected }
}

/// The snapshot in `file`, if a run of `assembly` can begin with it: the controller would accept
/// it.
///
/// # Errors
/// [`SettingsError`] names the file, and what was found and expected.
pub fn read(file: &Path, assembly: &Assembly) -> Result<ModelSnapshot, SettingsError> {
    let links = assembly.links("none", Path::new(""));
    let run = Run::new("", assembly.scenario.period_nanos(), links);
    let expected = Controller::expected(&assembly.controller(run));
    let snapshot = store::load(file, expected.fingerprint).map_err(|error| match error {
        StoreError::Foreign { expected, got, .. } => unusable(
            file,
            "fingerprint",
            Some(format!("{got:#018x}")),
            format!("{expected:#018x}; it was learned for another robot, period or input layout"),
        ),
        StoreError::File { source, .. } => {
            unusable(file, "--model", None, format!("a snapshot, but {source}"))
        }
        StoreError::Damaged { source, .. } => {
            unusable(file, "--model", None, format!("a snapshot, but {source}"))
        }
    })?;
    adopt::prepare(&snapshot, &expected).map_err(|refusal| {
        unusable(
            file,
            "--model",
            None,
            format!("a snapshot that the controller accepts: {refusal}"),
        )
    })?;
    Ok(snapshot)
}
