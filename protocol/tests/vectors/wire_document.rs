//! Definitions of the messages → the parts of WIRE.md that give version, fields and codes.

use protocol::VERSION;
use protocol::message::field::{Allowed, Field, Wire};
use protocol::message::{
    Coded, Credit, Exposure, FallbackLevel, GateState, Message, Participant, Phase, Reason,
    SolverStatus,
};
use protocol::topic::{OnTopic, Visit, visit_all};
use std::error::Error;
use std::fmt::Write;

/// `document` with its parts written anew. A part begins with `<!-- written: NAME -->` and ends
/// with `<!-- end -->`.
pub(crate) fn with_tables(document: &str) -> Result<String, Box<dyn Error>> {
    let mut parts = Parts(vec![
        ("version".to_owned(), version()),
        ("header of the example".to_owned(), header()),
        ("codes".to_owned(), codes()),
    ]);
    visit_all(&mut parts);
    let mut text = document.to_owned();
    for (name, part) in parts.0 {
        let (begin, end) = (format!("<!-- written: {name} -->\n"), "<!-- end -->");
        let start =
            text.find(&begin).ok_or_else(|| format!("WIRE.md has no {begin:?}"))? + begin.len();
        let rest = text.get(start..).unwrap_or_default();
        let length = rest.find(end).ok_or_else(|| format!("{begin:?} has no end"))?;
        text.replace_range(start..start + length, &format!("\n{part}\n"));
    }
    Ok(text)
}

struct Parts(Vec<(String, String)>);

impl Visit for Parts {
    fn visit<T: OnTopic>(&mut self) {
        let mut table =
            String::from("| field | type | content |\n|---|---|---|\n| `stamp` | | |\n");
        for field in T::fields() {
            if field.wire != Wire::Nothing {
                // Writing to a string does not fail.
                let _ = writeln!(table, "{}", row(&field));
            }
        }
        self.0.push((format!("fields of {}", T::NAME), table));
    }
}

fn row(field: &Field) -> String {
    let about = protocol::view::plain(field.about).replace('[', "\\[").replace(']', "\\]");
    let allowed = match field.allowed {
        Allowed::UpTo(limit) => format!(", {limit} at most"),
        Allowed::Any | Allowed::OneOf(_) => String::new(),
    };
    format!("| `{}` | {}{allowed} | {} |", field.name, field.wire, about.trim_end_matches('.'))
}

fn version() -> String {
    format!("This document describes protocol version {VERSION}.\n")
}

/// Version and kind of the example, a Credit.
fn header() -> String {
    let kind = Credit::KIND;
    let ([low, high], [first, second]) = (VERSION.to_le_bytes(), kind.to_le_bytes());
    let bytes = format!("{low:02x}{high:02x}{first:02x}{second:02x}");
    format!(
        "Example, a Credit message. It begins with `{bytes}`: version {VERSION}, kind {kind}.\n"
    )
}

fn codes() -> String {
    let rows = [
        ("fallback_level", FallbackLevel::WORDS),
        ("reason`, `stop", Reason::WORDS),
        ("gate", GateState::WORDS),
        ("status", SolverStatus::WORDS),
        ("participant", Participant::WORDS),
        ("phase", Phase::WORDS),
        ("exposure", Exposure::WORDS),
    ];
    let mut table = String::from("| field | codes |\n|---|---|\n");
    for (field, words) in rows {
        let words = words.iter().enumerate().map(|(code, word)| format!("{code} {word}"));
        let _ = writeln!(table, "| `{field}` | {} |", words.collect::<Vec<_>>().join(" · "));
    }
    table
}
