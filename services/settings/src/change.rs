//! A change to settings in use: a few keys, checked together with all keys that stay.
//!
//! ```
//! # use serde::{Deserialize, Serialize};
//! # use settings::{Check, Impossible};
//! use settings::change::{Change, Rules, changed};
//!
//! #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
//! #[serde(deny_unknown_fields)]
//! struct Crane {
//!     load: Load,
//!     height_m: f64,
//! }
//! # #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
//! # struct Load { mass_kg: f64 }
//! # impl Check for Crane {
//! #     fn check(&self) -> Result<(), Impossible> {
//! #         if self.load.mass_kg > 0.0 { return Ok(()) }
//! #         Err(Impossible::new("load.mass_kg", "a positive mass"))
//! #     }
//! # }
//! let crane = Crane { load: Load { mass_kg: 3.0 }, height_m: 7.0 };
//! let rules = Rules { tunable: &["load"], choices: &[] };
//! let apply = |line: &str| {
//!     let change = Change::parse(line).map_err(|error| error.to_string())?;
//!     changed(&crane, &[change], &rules).map_err(|error| error.to_string())
//! };
//!
//! assert_eq!(apply("load.mass_kg = 4.5").map(|crane| crane.load.mass_kg), Ok(4.5));
//!
//! let impossible = "load.mass_kg = -1.0: expected a positive mass";
//! assert_eq!(apply("load.mass_kg = -1.0"), Err(impossible.into()));
//!
//! let fixed = "height_m = 8.0: cannot change during the run; expected a key below load";
//! assert_eq!(apply("height_m = 8.0"), Err(fixed.into()));
//! ```

use crate::{Check, SettingsError, place, read};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::path::Path;
use toml::{Table, Value};

/// Value that removes a key, so that its default applies.
const NONE: &str = "none";

/// Longest quoted value \[characters\]; the rest is cut.
const QUOTED_MAX: usize = 60;

/// Rules for changes.
#[derive(Debug, Clone, Copy)]
pub struct Rules<'a> {
    /// Dotted keys that may change, with all keys below them.
    pub tunable: &'a [&'a str],
    /// Tables that hold one of several kinds. Another kind replaces the whole table.
    pub choices: &'a [&'a str],
}

/// A rejected change. Its message begins with `key = value`.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ChangeError {
    /// It is not TOML.
    #[error("`{text}` is not TOML: {expected}")]
    Syntax {
        /// The line.
        text: String,
        /// Message of the parser.
        expected: String,
    },
    /// It contains no key.
    #[error("nothing is changed: expected at least one KEY = VALUE")]
    Empty,
    /// A key that is fixed during the run, or unknown.
    #[error(
        "{key} = {value}: cannot change during the run; expected a key below {}",
        tunable.join(", ")
    )]
    Fixed {
        /// Dotted path of the key.
        key: String,
        /// The rejected value.
        value: String,
        /// The keys that may change.
        tunable: Vec<String>,
    },
    /// A key that no setting has.
    #[error("{key} = {value}: unknown key, expected one of {}", known.join(", "))]
    UnknownKey {
        /// Dotted path of the key.
        key: String,
        /// The rejected value.
        value: String,
        /// The known keys.
        known: Vec<String>,
    },
    /// The change removes a key without a default.
    #[error("{key} is missing: it has no default; expected a value")]
    MissingKey {
        /// Dotted path of the key.
        key: String,
    },
    /// A value of the wrong type, or an impossible one. The key may be one that does not change,
    /// but contradicts one that does.
    #[error("{key}{}: expected {expected}", equals(value.as_ref()))]
    Value {
        /// Dotted path of the key.
        key: String,
        /// Its value, if it has one.
        value: Option<String>,
        /// Expected value.
        expected: String,
    },
    /// The settings cannot be represented in TOML.
    #[error("the settings have no TOML form: {reason}")]
    Unsayable {
        /// Message of the TOML writer.
        reason: String,
    },
}

impl ChangeError {
    /// Its kind, for programs.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Syntax { .. } | Self::Empty => "syntax",
            Self::Fixed { .. } => "fixed-key",
            Self::UnknownKey { .. } => "unknown-key",
            Self::MissingKey { .. } => "missing-key",
            Self::Value { .. } | Self::Unsayable { .. } => "value",
        }
    }
}

/// Keys with their new values.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    table: Table,
}

impl Change {
    /// Reads lines of TOML. The value `"none"` removes a key.
    ///
    /// # Errors
    /// [`ChangeError::Syntax`] or [`ChangeError::Empty`].
    pub fn parse(lines: &str) -> Result<Self, ChangeError> {
        let table: Table = lines.parse().map_err(|error: toml::de::Error| {
            let line = place::line(lines.as_bytes(), error.span().map_or(0, |span| span.start));
            let text = lines.lines().nth(line - 1).unwrap_or_default().trim().to_owned();
            ChangeError::Syntax { text, expected: error.message().to_owned() }
        })?;
        let change = Self { table };
        if change.entries().is_empty() { Err(ChangeError::Empty) } else { Ok(change) }
    }

    /// Dotted keys and their new values; tables are flattened.
    pub fn entries(&self) -> Vec<(String, &Value)> {
        let mut entries = Vec::new();
        leaves(&self.table, "", &mut entries);
        entries
    }

    /// Checks that only tunable keys change.
    fn keeps_to(&self, rules: &Rules<'_>) -> Result<(), ChangeError> {
        let may = |key: &str| {
            rules.tunable.iter().any(|tunable| {
                key.strip_prefix(tunable)
                    .is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
            })
        };
        let tunable = || rules.tunable.iter().map(|&key| key.to_owned()).collect();
        match self.entries().into_iter().find(|(key, _)| !may(key)) {
            Some((key, value)) => {
                Err(ChangeError::Fixed { key, value: quote(value), tunable: tunable() })
            }
            None => Ok(()),
        }
    }
}

/// `settings` with all of `changes`, in their order. Only the final settings are checked.
///
/// # Errors
/// [`ChangeError`] reports the first error.
pub fn changed<T: Serialize + DeserializeOwned + Check>(
    settings: &T,
    changes: &[Change],
    rules: &Rules<'_>,
) -> Result<T, ChangeError> {
    let unsayable = |reason: String| ChangeError::Unsayable { reason };
    let mut whole = Table::try_from(settings).map_err(|error| unsayable(error.to_string()))?;
    for change in changes {
        change.keeps_to(rules)?;
        overlay(&mut whole, &change.table, "", rules);
    }
    let text = toml::to_string(&whole).map_err(|error| unsayable(error.to_string()))?;
    read::parse(&text, Path::new("")).map_err(ChangeError::from)
}

impl From<SettingsError> for ChangeError {
    /// The same error without a file and a line.
    fn from(error: SettingsError) -> Self {
        match error {
            SettingsError::Unreadable { reason, .. } => Self::Unsayable { reason },
            SettingsError::Syntax { text, expected, .. } => Self::Syntax { text, expected },
            SettingsError::UnknownKey { key, value, known, .. } => {
                Self::UnknownKey { key, value, known }
            }
            SettingsError::MissingKey { key, .. } => Self::MissingKey { key },
            SettingsError::Value { key, value, expected, .. } => {
                Self::Value { key, value, expected }
            }
        }
    }
}

fn joined(prefix: &str, key: &str) -> String {
    if prefix.is_empty() { key.to_owned() } else { format!("{prefix}.{key}") }
}

fn leaves<'a>(table: &'a Table, prefix: &str, entries: &mut Vec<(String, &'a Value)>) {
    for (key, value) in table {
        let path = joined(prefix, key);
        match value {
            Value::Table(below) if !below.is_empty() => leaves(below, &path, entries),
            _ => entries.push((path, value)),
        }
    }
}

/// Merges `change` into `table`.
fn overlay(table: &mut Table, change: &Table, path: &str, rules: &Rules<'_>) {
    if rules.choices.contains(&path) && change.keys().any(|kind| !table.contains_key(kind)) {
        table.clear();
    }
    for (key, value) in change {
        match (table.get_mut(key), value) {
            (_, Value::String(word)) if word == NONE => drop(table.remove(key)),
            (Some(Value::Table(there)), Value::Table(below)) => {
                overlay(there, below, &joined(path, key), rules);
            }
            _ => drop(table.insert(key.clone(), value.clone())),
        }
    }
}

fn equals(value: Option<&String>) -> String {
    value.map(|value| format!(" = {value}")).unwrap_or_default()
}

/// The value, shortened to one line.
fn quote(value: &Value) -> String {
    let written = value.to_string();
    let line: String =
        written.lines().next().unwrap_or_default().chars().take(QUOTED_MAX).collect();
    if line.len() == written.len() { line } else { format!("{line} …") }
}
