//! Python, with the packages that clients and tests require.

use crate::{binaries, repository};
use std::error::Error;
use std::fs;
use std::path::PathBuf;
use std::process::Command;
use std::sync::OnceLock;

/// The Python of a virtual environment with the requirements of clients and tests, made once per
/// target folder and list of requirements.
///
/// # Errors
/// A sentence, if it cannot be made.
pub fn python() -> Result<PathBuf, Box<dyn Error>> {
    static PYTHON: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    PYTHON.get_or_init(|| make().map_err(|error| error.to_string())).clone().map_err(Into::into)
}

fn make() -> Result<PathBuf, Box<dyn Error>> {
    let requirements = repository().join("tests/python/requirements.txt");
    let wanted = fs::read_to_string(&requirements)?
        + &fs::read_to_string(repository().join("deploy/clients/python/requirements.txt"))?;
    let folder = binaries()?.join("python-clients");
    let (python, installed) = (folder.join("bin/python"), folder.join("installed.txt"));
    if !fs::read_to_string(&installed).is_ok_and(|found| found == wanted) {
        text_of(Command::new("python3").args(["-m", "venv", "--clear"]).arg(&folder))?;
        text_of(
            Command::new(&python)
                .args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "-r"])
                .arg(&requirements),
        )?;
        fs::write(&installed, wanted)?;
    }
    Ok(python)
}

/// Standard output of `command`.
///
/// # Errors
/// Its standard error, if it fails.
pub fn text_of(command: &mut Command) -> Result<String, Box<dyn Error>> {
    let output = command.output()?;
    if !output.status.success() {
        return Err(format!(
            "{command:?}: {}: {}",
            output.status,
            String::from_utf8_lossy(&output.stderr)
        )
        .into());
    }
    Ok(String::from_utf8(output.stdout)?)
}
