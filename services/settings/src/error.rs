//! Why settings are rejected: file, line, key, value, and the expected value.

use std::path::PathBuf;

/// Settings that cannot be used. The message begins with `file:line: key = value`.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SettingsError {
    /// The file cannot be read.
    #[error("{}: expected a settings file, but {reason}", file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// Message of the operating system.
        reason: String,
    },
    /// It is not TOML.
    #[error("{}:{line}: `{text}` is not TOML: {expected}", file.display())]
    Syntax {
        /// The file.
        file: PathBuf,
        /// Line, from 1.
        line: usize,
        /// The line.
        text: String,
        /// Message of the parser.
        expected: String,
    },
    /// A key that no setting has.
    #[error(
        "{}:{line}: {key} = {value}: unknown key, expected {}",
        file.display(),
        alternatives(known)
    )]
    UnknownKey {
        /// The file.
        file: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Dotted path of the key.
        key: String,
        /// Its value, as written.
        value: String,
        /// The known keys.
        known: Vec<String>,
    },
    /// A key without a default is missing.
    #[error("{}:{line}: {key} is missing: expected it {}", file.display(), within(key))]
    MissingKey {
        /// The file.
        file: PathBuf,
        /// Line of its table, from 1.
        line: usize,
        /// Dotted path of the key.
        key: String,
    },
    /// A value of the wrong type, or an impossible one.
    #[error(
        "{}{}: {key}{}: expected {expected}",
        file.display(),
        colon(*line),
        equals(value.as_ref())
    )]
    Value {
        /// The file.
        file: PathBuf,
        /// Line, from 1; `None` if the value did not come from the file.
        line: Option<usize>,
        /// Dotted path of the key.
        key: String,
        /// Its value, as written; `None` if it is not in the file.
        value: Option<String>,
        /// Expected value.
        expected: String,
    },
}

/// Settings that cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// TOML cannot represent them.
    #[error("{}: {reason}", file.display())]
    Unsayable {
        /// The file.
        file: PathBuf,
        /// Message of the TOML writer.
        reason: String,
    },
    /// The file cannot be written.
    #[error("{}: {source}", file.display())]
    Unwritable {
        /// The file.
        file: PathBuf,
        /// Message of the operating system.
        source: std::io::Error,
    },
}

fn alternatives(known: &[String]) -> String {
    match known {
        [] => "none here".into(),
        [only] => only.clone(),
        several => format!("one of {}", several.join(", ")),
    }
}

/// Place where a missing key belongs.
fn within(key: &str) -> String {
    key.rsplit_once('.')
        .map_or_else(|| "at the top of the file".into(), |(table, _)| format!("in [{table}]"))
}

fn colon(line: Option<usize>) -> String {
    line.map(|line| format!(":{line}")).unwrap_or_default()
}

fn equals(value: Option<&String>) -> String {
    value.map(|value| format!(" = {value}")).unwrap_or_default()
}
