//! events → the lines of the page.

use run_view::{Event, Sort};
use serde::Serialize;

/// One line.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Entry {
    /// Number of the event.
    n: u64,
    /// Simulated time \[s\].
    t: f64,
    sort: Sort,
    who: &'static str,
    /// Kind of the event, for programs.
    code: &'static str,
    text: String,
}

impl Entry {
    /// The line of an event in a run with this period \[s\], if the page shows it.
    pub(super) fn of(event: &Event, period_s: f64) -> Option<Self> {
        let (code, sort) = event.what.kind();
        let t = super::round(event.tick as f64 * period_s);
        let (who, text) = (event.who.text(), event.what.to_string());
        (sort != Sort::Detail).then_some(Self { n: event.number, t, sort, who, code, text })
    }
}
