//! Dotted key ↔ position in the document.

use std::ops::Range;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Longest quoted value \[characters\]; the rest is cut.
const QUOTED_MAX: usize = 60;

/// A TOML document with the positions of its entries.
pub(crate) struct Document<'i> {
    text: &'i str,
    entries: Vec<Entry>,
}

/// One key with its value.
#[derive(Debug, Clone)]
pub(crate) struct Entry {
    /// Dotted path of the key; elements of a list count from 0.
    pub(crate) path: String,
    /// Position of the key; elements of a list have none.
    key: Option<Range<usize>>,
    /// Position of the value.
    value: Range<usize>,
}

impl<'i> Document<'i> {
    /// Indexes every entry of `root`, which was parsed from `text`.
    pub(crate) fn new(text: &'i str, root: &DeTable<'_>) -> Self {
        let mut entries = Vec::new();
        visit_table(root, "", &mut entries);
        Self { text, entries }
    }

    /// Line of a byte, from 1.
    pub(crate) fn line(&self, offset: usize) -> usize {
        line(self.text.as_bytes(), offset)
    }

    /// The entry that an error at `span` is about: the one whose key or value has exactly this
    /// span, else the innermost one around it.
    pub(crate) fn at(&self, span: &Range<usize>) -> Option<&Entry> {
        let exactly = self.entries.iter().find(|entry| entry.key.as_ref() == Some(span));
        let exactly = exactly.or_else(|| self.entries.iter().rfind(|entry| entry.value == *span));
        exactly.or_else(|| {
            let around = self
                .entries
                .iter()
                .filter(|entry| entry.value.start <= span.start && span.end <= entry.value.end);
            around.min_by_key(|entry| entry.value.len())
        })
    }

    /// The entry with this dotted path.
    pub(crate) fn find(&self, path: &str) -> Option<&Entry> {
        self.entries.iter().find(|entry| entry.path == path)
    }

    /// The entry `key` of the nearest table around `path`, or of the table `path` itself.
    pub(crate) fn near(&self, path: &str, key: &str) -> Option<&Entry> {
        let within = self.find(&format!("{path}.{key}"));
        within.or_else(|| match path.rsplit_once('.') {
            Some((table, _)) => self.near(table, key),
            None => self.find(key),
        })
    }

    /// Line on which an entry begins, from 1.
    pub(crate) fn line_of(&self, entry: &Entry) -> usize {
        self.line(entry.key.as_ref().unwrap_or(&entry.value).start)
    }

    /// First line of the nearest table around `path` that is in the document, from 1. It is the
    /// first line of the file if there is no such table.
    pub(crate) fn line_around(&self, path: &str) -> usize {
        let Some((table, _)) = path.rsplit_once('.') else { return 1 };
        self.find(table).map_or_else(|| self.line_around(table), |entry| self.line_of(entry))
    }

    /// The value as written, shortened to one line.
    pub(crate) fn quote(&self, entry: &Entry) -> String {
        if entry.key.as_ref().is_some_and(|key| entry.value.start <= key.start) {
            return "a table".into();
        }
        let written = self.text.get(entry.value.clone()).unwrap_or_default().trim();
        let line = written.lines().next().unwrap_or_default();
        if line.len() == written.len() && line.chars().count() <= QUOTED_MAX {
            return line.into();
        }
        let cut: String = line.chars().take(QUOTED_MAX).collect();
        format!("{cut} …")
    }
}

/// Line of a byte of `text`, from 1.
pub(crate) fn line(text: &[u8], offset: usize) -> usize {
    1 + text.iter().take(offset).filter(|&&byte| byte == b'\n').count()
}

fn visit_table(table: &DeTable<'_>, prefix: &str, entries: &mut Vec<Entry>) {
    for (key, value) in table {
        let path = if prefix.is_empty() {
            key.get_ref().to_string()
        } else {
            format!("{prefix}.{}", key.get_ref())
        };
        visit_value(value, Some(key.span()), &path, entries);
    }
}

fn visit_value(
    value: &Spanned<DeValue<'_>>,
    key: Option<Range<usize>>,
    path: &str,
    entries: &mut Vec<Entry>,
) {
    entries.push(Entry { path: path.to_owned(), key, value: value.span() });
    match value.get_ref() {
        DeValue::Table(table) => visit_table(table, path, entries),
        DeValue::Array(array) => {
            for (index, element) in array.iter().enumerate() {
                visit_value(element, None, &format!("{path}.{index}"), entries);
            }
        }
        _ => {}
    }
}
