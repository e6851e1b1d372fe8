//! The messages of serde as errors of this crate.

use crate::place::Document;
use crate::{Impossible, SettingsError};
use std::path::Path;
use toml::de::Error;

/// The error for a document that is TOML, but not of the requested type.
pub(crate) fn refusal(document: &Document<'_>, file: &Path, error: &Error) -> SettingsError {
    let message = error.message();
    let file = file.to_path_buf();
    let span = error.span();
    let entry = span.as_ref().and_then(|span| document.at(span));
    if let Some(name) = message.strip_prefix("missing field ") {
        let name = unquote(name);
        let key = entry.map_or_else(|| name.to_owned(), |table| format!("{}.{name}", table.path));
        let line = entry.map_or(1, |table| document.line_of(table));
        return SettingsError::MissingKey { file, line, key };
    }
    // A type with a check of its own, as `Impossible` prints it.
    if let Some((key, expected)) = message.split_once(": expected ")
        && let Some(found) = entry.and_then(|entry| document.near(&entry.path, key))
    {
        return impossible(document, &file, Impossible::new(&*found.path, expected));
    }
    let line = entry
        .map(|entry| document.line_of(entry))
        .or_else(|| span.map(|span| document.line(span.start)));
    let key = entry.map_or_else(|| "(the whole file)".to_owned(), |entry| entry.path.clone());
    let value = entry.map(|entry| document.quote(entry));
    if let Some(known) = known_keys(message) {
        return SettingsError::UnknownKey {
            file,
            line: line.unwrap_or(1),
            key,
            value: value.unwrap_or_default(),
            known,
        };
    }
    SettingsError::Value { file, line, key, value, expected: expected(message) }
}

/// The error for a document of the right type with an impossible value.
pub(crate) fn impossible(
    document: &Document<'_>,
    file: &Path,
    impossible: Impossible,
) -> SettingsError {
    let entry = document.find(&impossible.key);
    let line = entry
        .map_or_else(|| document.line_around(&impossible.key), |entry| document.line_of(entry));
    SettingsError::Value {
        file: file.to_path_buf(),
        line: Some(line),
        value: entry.map(|entry| document.quote(entry)),
        key: impossible.key,
        expected: impossible.expected,
    }
}

/// The expectation in serde's "invalid type: …, expected …" and similar messages.
fn expected(message: &str) -> String {
    let Some((before, expected)) = message.rsplit_once(", expected ") else {
        return format!("something else: {message}");
    };
    if before.starts_with("unknown variant ") {
        let known = quoted(expected);
        return if known.len() > 1 {
            format!("one of {}", known.join(", "))
        } else {
            known.concat()
        };
    }
    match expected {
        "f64" => "a number".into(),
        "u64" | "u32" | "u16" | "u8" | "usize" => "a whole number of at least 0".into(),
        "i64" | "i32" => "a whole number".into(),
        "a boolean" => "true or false".into(),
        other => {
            other.strip_prefix("struct ").map_or_else(|| other.to_owned(), |_| "a table".into())
        }
    }
}

/// The known keys, if the message reports an unknown key: in serde's words, or in those of toml for
/// the tables of an enum.
fn known_keys(message: &str) -> Option<Vec<String>> {
    if message.starts_with("unknown field ") {
        return Some(
            message.split_once(", expected ").map(|(_, list)| quoted(list)).unwrap_or_default(),
        );
    }
    let (_, list) =
        message.strip_prefix("unexpected keys in table: ")?.split_once(", available keys: ")?;
    Some(list.split(", ").map(str::to_owned).collect())
}

/// The words between backticks.
fn quoted(list: &str) -> Vec<String> {
    list.split('`').skip(1).step_by(2).map(str::to_owned).collect()
}

fn unquote(name: &str) -> &str {
    name.trim_matches('`')
}
