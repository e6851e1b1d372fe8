//! File → text → table → type → checked type.

use crate::explain;
use crate::place::{self, Document};
use crate::{Check, SettingsError, WriteError};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fs;
use std::path::Path;
use toml::de::{DeTable, Deserializer, Error};

/// Reads and checks the settings in `file`.
///
/// # Errors
/// [`SettingsError`] reports the first error and its line.
pub fn read<T: DeserializeOwned + Check>(file: &Path) -> Result<T, SettingsError> {
    let bytes = fs::read(file).map_err(|error| SettingsError::Unreadable {
        file: file.to_path_buf(),
        reason: error.to_string(),
    })?;
    let text =
        std::str::from_utf8(&bytes).map_err(|error| not_text(&bytes, file, error.valid_up_to()))?;
    parse(text, file)
}

/// Reads and checks settings that were read from `file`. Only error messages use the file name.
///
/// # Errors
/// [`SettingsError`] reports the first error and its line.
pub fn parse<T: DeserializeOwned + Check>(text: &str, file: &Path) -> Result<T, SettingsError> {
    let root = DeTable::parse(text).map_err(|error| syntax(text, file, &error))?;
    let document = Document::new(text, root.get_ref());
    let settings = T::deserialize(Deserializer::from(root))
        .map_err(|error| explain::refusal(&document, file, &error))
        .map_err(|refusal| with_replacement(refusal, T::replaced()))?;
    settings.check().map_err(|impossible| explain::impossible(&document, file, impossible))?;
    Ok(settings)
}

/// Writes settings so that [`read`] returns the same ones.
///
/// # Errors
/// [`WriteError`] if TOML cannot represent them or the file cannot be written.
pub fn write<T: Serialize>(file: &Path, settings: &T) -> Result<(), WriteError> {
    let text = toml::to_string(settings).map_err(|error| WriteError::Unsayable {
        file: file.to_path_buf(),
        reason: error.to_string(),
    })?;
    fs::write(file, text)
        .map_err(|source| WriteError::Unwritable { file: file.to_path_buf(), source })
}

/// The same error; for a key of an earlier version, what has replaced it is expected.
fn with_replacement(mut refusal: SettingsError, replaced: &[(&str, &str)]) -> SettingsError {
    if let SettingsError::UnknownKey { key, known, .. } = &mut refusal
        && let Some((_, by)) = replaced.iter().find(|(old, _)| old == key)
    {
        *known = vec![(*by).to_owned()];
    }
    refusal
}

/// Bytes whose byte `place` is the first that is not UTF-8.
fn not_text(bytes: &[u8], file: &Path, place: usize) -> SettingsError {
    let text = String::from_utf8_lossy(bytes);
    let line = place::line(bytes, place);
    SettingsError::Syntax {
        file: file.to_path_buf(),
        line,
        text: text.split('\n').nth(line - 1).unwrap_or_default().trim().to_owned(),
        expected: "expected text in UTF-8".to_owned(),
    }
}

fn syntax(text: &str, file: &Path, error: &Error) -> SettingsError {
    let line = place::line(text.as_bytes(), error.span().map_or(0, |span| span.start));
    SettingsError::Syntax {
        file: file.to_path_buf(),
        line,
        text: text.lines().nth(line - 1).unwrap_or_default().trim().to_owned(),
        expected: error.message().to_owned(),
    }
}
