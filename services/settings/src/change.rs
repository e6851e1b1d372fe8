//! A change to settings that are in use: a few keys, checked together with everything that stays as it is.
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
//! #         if self.load.mass_kg > 0.0 { Ok(()) } else { Err(Impossible::new("load.mass_kg", "a positive mass")) }
//! #     }
//! # }
//! let crane = Crane { load: Load { mass_kg: 3.0 }, height_m: 7.0 };
//! let rules = Rules { tunable: &["load"], choices: &[] };
//! let say = |line: &str| Change::parse(line).and_then(|change| changed(&crane, &[change], &rules)).map_err(|error| error.to_string());
//!
//! assert_eq!(say("load.mass_kg = 4.5").map(|crane| crane.load.mass_kg), Ok(4.5));
//! assert_eq!(say("load.mass_kg = -1.0"), Err("load.mass_kg = -1.0: expected a positive mass".into()));
//! assert_eq!(say("height_m = 8.0"), Err("height_m = 8.0: stays as it was at the start; expected a key below load".into()));
//! ```

use crate::{Check, SettingsError, place, read};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::path::Path;
use toml::{Table, Value};

/// Takes a key away, as if nobody had ever set it.
const NONE: &str = "none";

/// Longest value that is quoted in full \[characters\].
const QUOTED_MAX: usize = 60;

/// What may be changed.
#[derive(Debug, Clone, Copy)]
pub struct Rules<'a> {
    /// Dotted keys that may be changed, with everything below them.
    pub tunable: &'a [&'a str],
    /// Tables that hold one of several kinds: another kind takes the place of the whole table.
    pub choices: &'a [&'a str],
}

/// A change that is refused. Displayed, it begins `key = value`.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ChangeError {
    /// It is not TOML.
    #[error("`{text}` is not TOML: {expected}")]
    Syntax {
        /// The line.
        text: String,
        /// What the parser said.
        expected: String,
    },
    /// It changes nothing.
    #[error("nothing is changed: expected at least one KEY = VALUE")]
    Empty,
    /// A key that is fixed once and for all, or that nobody knows.
    #[error("{key} = {value}: stays as it was at the start; expected a key below {}", tunable.join(", "))]
    Fixed {
        /// Dotted path of the key.
        key: String,
        /// The value that it was to have.
        value: String,
        /// What may be changed.
        tunable: Vec<String>,
    },
    /// A key that no one reads.
    #[error("{key} = {value}: unknown key, expected one of {}", known.join(", "))]
    UnknownKey {
        /// Dotted path of the key.
        key: String,
        /// The value that it was to have.
        value: String,
        /// The keys that there are.
        known: Vec<String>,
    },
    /// Something that has no default would be gone.
    #[error("{key} is missing: expected it beside what is changed")]
    MissingKey {
        /// Dotted path of the key.
        key: String,
    },
    /// A value of the wrong type, or an impossible one: beside the others, if it is none of those that are changed.
    #[error("{key}{}: expected {expected}", value.as_ref().map(|value| format!(" = {value}")).unwrap_or_default())]
    Value {
        /// Dotted path of the key.
        key: String,
        /// Its value; none if it has none.
        value: Option<String>,
        /// What it would have to be.
        expected: String,
    },
    /// The settings themselves cannot be said in TOML.
    #[error("the settings cannot be written: {reason}")]
    Unsayable {
        /// What the writer said.
        reason: String,
    },
}

/// Keys with their new values.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    table: Table,
}

impl Change {
    /// Reads lines of TOML. The value `"none"` takes a key away.
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

    /// What is changed: dotted keys and their new values, tables taken apart.
    pub fn entries(&self) -> Vec<(String, &Value)> {
        let mut entries = Vec::new();
        leaves(&self.table, "", &mut entries);
        entries
    }

    /// Whether only what is tunable is changed.
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

/// `settings` with all of `changes`, one after the other: checked as a whole, and only that.
///
/// # Errors
/// [`ChangeError`] says what is wrong first.
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
    /// The same without a file and a line.
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

/// Puts `change` over what is there.
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

/// The value, shortened to one line.
fn quote(value: &Value) -> String {
    let written = value.to_string();
    let line: String =
        written.lines().next().unwrap_or_default().chars().take(QUOTED_MAX).collect();
    if line.len() == written.len() { line } else { format!("{line} …") }
}
