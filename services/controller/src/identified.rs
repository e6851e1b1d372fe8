//! Identified parameters of the robot: saved in a file at the end of a run, loaded by a later run.

use crate::control::Controller;
use crate::settings::{Identify, Method, Settings};
use model::physics::FoundPhysics;
use model::response::FoundResponse;
use process::atomic_file;
use serde::{Deserialize, Serialize};
use settings::{Check, Impossible, SettingsError};
use std::io;
use std::path::{Path, PathBuf};

/// Dead time, ramp, response and physics, of one main model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Identified {
    /// Name of the main model, as sixteen hexadecimal digits.
    pub main_model: String,
    /// Dead time, time constant, gain and offset of each axis.
    pub response: FoundResponse,
    /// Friction, drag and coupled axes, where these are identified too.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub physics: Option<FoundPhysics>,
}

impl Check for Identified {
    fn check(&self) -> Result<(), Impossible> {
        Ok(())
    }
}

/// Name of a main model in the file.
pub fn name_of(fingerprint: u64) -> String {
    format!("{fingerprint:016x}")
}

/// Path of the file of a run.
pub fn file_of(settings: &Settings) -> PathBuf {
    settings.run.folder.join("identified.toml")
}

/// The file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum IdentifiedError {
    /// It cannot be read.
    #[error(transparent)]
    Read(#[from] SettingsError),
    /// It belongs to another robot file or period.
    #[error(
        "{}: main_model = {got}: expected {expected}: identified for another robot file or period",
        file.display()
    )]
    Foreign {
        /// The file.
        file: PathBuf,
        /// Main model of this controller.
        expected: String,
        /// Main model in the file.
        got: String,
    },
    /// Its numbers belong to another version, or are not finite.
    #[error("{}: expected finite numbers for the dead times of this version", file.display())]
    Unusable {
        /// The file.
        file: PathBuf,
    },
}

/// Loads into `controller` the parameters that the settings name, if they do. A file that cannot be
/// used is logged, and the controller starts without them.
pub fn resume(controller: &mut Controller, settings: &Settings) {
    let Some(file) = &settings.identified else { return };
    match begin_with(controller, file) {
        Ok(()) => tracing::info!(file = %file.display(), "starts with an identified response"),
        Err(error) => tracing::warn!("{error}; starting without it"),
    }
}

fn begin_with(controller: &mut Controller, file: &Path) -> Result<(), IdentifiedError> {
    let identified: Identified = settings::read(file)?;
    let expected = controller.knowledge().main_model_name();
    if identified.main_model != expected {
        let (file, got) = (file.to_owned(), identified.main_model);
        return Err(IdentifiedError::Foreign { file, expected, got });
    }
    if controller.begin_with(&identified) {
        Ok(())
    } else {
        Err(IdentifiedError::Unusable { file: file.to_owned() })
    }
}

/// Writes the parameters that `controller` identified, as a whole or not at all. A failure is
/// logged.
pub fn save(controller: &Controller, settings: &Settings) {
    if settings.mpc.method != Method::Mpc || settings.mpc.identify == Identify::Off {
        return;
    }
    let file = file_of(settings);
    let written = atomic_file::replace(&file, |beside| {
        settings::write(beside, &controller.knowledge().identified()).map_err(io::Error::other)
    });
    if let Err(error) = written {
        tracing::warn!(file = %file.display(), "the identified response could not be saved: \
            {error}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::tests::told;
    use std::error::Error;
    use std::fs;

    #[test]
    fn a_controller_begins_with_the_file_of_another_controller() -> Result<(), Box<dyn Error>> {
        let folder = tempfile::tempdir()?;
        let mut settings = told();
        settings.run.folder = folder.path().to_owned();
        settings.mpc.identify = Identify::Physics;
        let mut controller = Controller::new(&settings)?;
        save(&controller, &settings);
        let file = file_of(&settings);
        begin_with(&mut controller, &file)?;
        assert_eq!(settings::read::<Identified>(&file)?, controller.knowledge().identified());
        assert_eq!(fs::read_dir(folder.path())?.count(), 1, "something was left beside it");
        Ok(())
    }

    #[test]
    fn a_file_of_another_robot_or_with_numbers_that_are_not_finite_is_refused()
    -> Result<(), Box<dyn Error>> {
        let folder = tempfile::tempdir()?;
        let file = folder.path().join("identified.toml");
        let mut controller = Controller::new(&told())?;
        let mut heavier = told();
        heavier.robot.body =
            heavier.robot.body.map(|body| robot::Body { mass_kg: 2.0 * body.mass_kg, ..body });
        settings::write(&file, &Controller::new(&heavier)?.knowledge().identified())?;
        let foreign = begin_with(&mut controller, &file);
        assert!(matches!(foreign, Err(IdentifiedError::Foreign { .. })), "{foreign:?}");
        settings::write(&file, &controller.knowledge().identified())?;
        let text = fs::read_to_string(&file)?.replacen("[100.0", "[nan", 1);
        fs::write(&file, text)?;
        let unusable = begin_with(&mut controller, &file);
        assert!(matches!(unusable, Err(IdentifiedError::Unusable { .. })), "{unusable:?}");
        fs::write(&file, "main_model = 3")?;
        let damaged = begin_with(&mut controller, &file);
        assert!(matches!(damaged, Err(IdentifiedError::Read(_))), "{damaged:?}");
        Ok(())
    }
}
