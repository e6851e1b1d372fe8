//! One figure: panels, legend, and missing data.

use super::axis::{Axis, Extent};
use super::panel::Detail;
use super::record::Record;
use protocol::topic::Topic;

/// Number of colours; records use them in turn.
const COLOURS: usize = 6;

/// Style of a line or mark.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Look {
    Line,
    Dashed,
    Faint,
    Band,
    Dot,
}

impl Look {
    /// Its class in the style sheet.
    pub(super) fn class(self) -> &'static str {
        match self {
            Self::Line => "plain",
            Self::Dashed => "dashed",
            Self::Faint => "faint",
            Self::Band => "area",
            Self::Dot => "dot",
        }
    }
}

/// One entry of a legend.
#[derive(Debug)]
pub(super) struct Key {
    /// Colour.
    pub(super) colour: String,
    pub(super) look: Look,
    pub(super) label: String,
}

/// One figure.
#[derive(Debug)]
pub(super) struct Figure {
    /// Its anchor in the page, and `data-figure`.
    pub(super) id: &'static str,
    pub(super) title: &'static str,
    /// Number of the paper's figure with the same content.
    pub(super) paper: Option<u32>,
    pub(super) about: String,
    pub(super) legend: Vec<Key>,
    /// Whether it has the width of the page.
    pub(super) wide: bool,
    /// One SVG each.
    pub(super) panels: Vec<String>,
    /// Data that the figure does not show, and why.
    pub(super) missing: Vec<String>,
}

impl Figure {
    pub(super) fn new(id: &'static str, title: &'static str, about: impl Into<String>) -> Self {
        let (about, legend, panels, missing) = (about.into(), Vec::new(), Vec::new(), Vec::new());
        Self { id, title, paper: None, about, legend, wide: false, panels, missing }
    }
}

/// All records, and the data that their figures share.
pub(super) struct Records<'a> {
    each: &'a [Record],
    pub(super) detail: Detail,
    /// Time axis of all records.
    pub(super) time: Axis,
}

impl<'a> Records<'a> {
    pub(super) fn new(records: &'a [Record]) -> Self {
        let end = Extent::of(records.iter().map(Record::end)).high;
        let end = if end > 0.0 { end } else { 1.0 };
        Self {
            each: records,
            detail: Detail::for_records(records.len()),
            time: Axis::linear(Extent { low: 0.0, high: end }),
        }
    }

    /// Each record with its colour.
    pub(super) fn coloured(&self) -> impl Iterator<Item = (String, &'a Record)> + use<'a> {
        self.each.iter().enumerate().map(|(index, record)| (colour(index), record))
    }

    pub(super) fn all(&self) -> &'a [Record] {
        self.each
    }

    /// Names of all records, for screen readers.
    pub(super) fn names(&self) -> String {
        self.each.iter().map(|record| record.name.as_str()).collect::<Vec<_>>().join(", ")
    }

    /// A legend entry for each record in which `drawn` holds.
    pub(super) fn legend(
        &self,
        look: Look,
        suffix: &str,
        drawn: impl Fn(&Record) -> bool,
    ) -> Vec<Key> {
        let drawn = self.coloured().filter(|(_, record)| drawn(record));
        drawn
            .map(|(colour, record)| Key { colour, look, label: format!("{}{suffix}", record.name) })
            .collect()
    }

    /// A note for each record that has no message of `topic`.
    pub(super) fn without(&self, topic: Topic) -> Vec<String> {
        let without = self.each.iter().filter(|record| !record.topics.contains(&topic));
        without
            .map(|record| {
                format!("{}: topic {:?} is not in this record", record.name, topic.name())
            })
            .collect()
    }
}

/// The colour of the record at `index`.
pub(super) fn colour(index: usize) -> String {
    format!("r{}", index % COLOURS)
}

/// Largest distance of two ticks that a line joins \[s\].
pub(super) fn gap(record: &Record) -> f64 {
    1.5 * record.period
}
