//! Messages of one topic → the columns for all of them, and the cells of each.

use serde::de::{Deserialize, Deserializer, MapAccess, Visitor};
use serde_json::Value;
use std::fmt;

/// Columns of one topic, field by field in the order of the messages.
#[derive(Debug, Default)]
pub(super) struct Columns {
    fields: Vec<Column>,
    schema: Value,
}

#[derive(Debug)]
struct Column {
    name: String,
    shape: Shape,
}

/// Columns of a field.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Shape {
    /// No columns yet.
    Nothing,
    One,
    /// Largest number of values.
    Numbers(usize),
    /// Largest number of rows, and of values in a row.
    Rows(usize, usize),
    /// One column for each of these names.
    Named(Vec<String>),
}

impl Columns {
    /// Adds the columns that a message needs.
    pub(super) fn look(&mut self, schema: &[u8], json: &[u8]) -> Result<(), serde_json::Error> {
        if self.schema.is_null() {
            // Without a schema there are no units.
            self.schema = serde_json::from_slice(schema).unwrap_or(Value::Bool(false));
        }
        let Entries(entries) = serde_json::from_slice(json)?;
        for (name, value) in entries {
            if let Some(field) = self.fields.iter_mut().find(|field| field.name == name) {
                field.shape.widen(&value);
            } else {
                let mut shape = Shape::Nothing;
                shape.widen(&value);
                self.fields.push(Column { name, shape });
            }
        }
        Ok(())
    }

    /// Name and unit of every column.
    pub(super) fn header(&self) -> Vec<String> {
        let mut header = Vec::new();
        for Column { name, shape } in &self.fields {
            let schema = &self.schema["properties"][name];
            let units = units(schema);
            let unit = |index: usize| match units.as_slice() {
                [] => String::new(),
                [one] => format!(" [{one}]"),
                several => several.get(index).map_or_else(String::new, |unit| format!(" [{unit}]")),
            };
            match shape {
                Shape::Nothing => {}
                Shape::One => header.push(format!("{name}{}", unit(0))),
                Shape::Numbers(count) => {
                    header
                        .extend((0..*count).map(|index| format!("{name}_{index}{}", unit(index))));
                }
                Shape::Rows(rows, count) => {
                    header.extend(
                        cells(*rows, *count)
                            .map(|(row, index)| format!("{name}_{row}_{index}{}", unit(index))),
                    );
                }
                Shape::Named(keys) => {
                    let properties = &schema["properties"];
                    let unit = |key: &str| {
                        self::units(&properties[key])
                            .first()
                            .map_or_else(String::new, |unit| format!(" [{unit}]"))
                    };
                    header.extend(keys.iter().map(|key| format!("{name}_{key}{}", unit(key))));
                }
            }
        }
        header
    }

    /// The cells of a message, one per column.
    pub(super) fn row(&self, json: &[u8]) -> Result<Vec<String>, serde_json::Error> {
        let Entries(entries) = serde_json::from_slice(json)?;
        let mut row = Vec::new();
        for Column { name, shape } in &self.fields {
            let value = entries
                .iter()
                .find(|(key, _)| key == name)
                .map_or(&Value::Null, |(_, value)| value);
            match shape {
                Shape::Nothing => {}
                Shape::One => row.push(written(value)),
                Shape::Numbers(count) => {
                    row.extend((0..*count).map(|index| written(&value[index])));
                }
                Shape::Rows(rows, count) => {
                    row.extend(
                        cells(*rows, *count).map(|(row, index)| written(&value[row][index])),
                    );
                }
                Shape::Named(keys) => row.extend(keys.iter().map(|key| written(&value[key]))),
            }
        }
        Ok(row)
    }
}

impl Shape {
    fn widen(&mut self, value: &Value) {
        let needed = match value {
            Value::Array(items) if items.is_empty() => Self::Nothing,
            Value::Array(items) if items.iter().any(Value::is_array) => Self::Rows(
                items.len(),
                items.iter().filter_map(Value::as_array).map(Vec::len).max().unwrap_or(0),
            ),
            Value::Array(items) => Self::Numbers(items.len()),
            Value::Object(entries) => Self::Named(entries.keys().cloned().collect()),
            Value::Null | Value::Bool(_) | Value::Number(_) | Value::String(_) => Self::One,
        };
        match (self, needed) {
            (nothing @ Self::Nothing, needed) => *nothing = needed,
            (Self::Numbers(count), Self::Numbers(more)) => *count = (*count).max(more),
            (Self::Rows(rows, count), Self::Rows(more_rows, more)) => {
                (*rows, *count) = ((*rows).max(more_rows), (*count).max(more));
            }
            (Self::Named(keys), Self::Named(more)) => more.into_iter().for_each(|key| {
                if !keys.contains(&key) {
                    keys.push(key);
                }
            }),
            // No field of our messages changes its kind.
            _ => {}
        }
    }
}

/// Row and index of each number of `rows` rows.
fn cells(rows: usize, count: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..rows).flat_map(move |row| (0..count).map(move |index| (row, index)))
}

/// The units in the last brackets of a field's description.
fn units(schema: &Value) -> Vec<&str> {
    let inside = schema["description"]
        .as_str()
        .and_then(|about| about.rsplit_once('[')?.1.split_once(']'))
        .map(|(inside, _)| inside);
    inside.map_or_else(Vec::new, |inside| inside.split(", ").collect())
}

/// A number with the digits that reproduce it exactly; empty if it is not finite.
fn written(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

/// A JSON object with its entries in order.
struct Entries(Vec<(String, Value)>);

impl<'de> Deserialize<'de> for Entries {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(InOrder)
    }
}

struct InOrder;

impl<'de> Visitor<'de> for InOrder {
    type Value = Entries;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Entries, A::Error> {
        let mut entries = Vec::new();
        while let Some(entry) = map.next_entry()? {
            entries.push(entry);
        }
        Ok(Entries(entries))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::message::Plan;
    use protocol::view;
    use serde_json::json;

    #[test]
    fn columns_fit_the_longest_message_and_have_the_units_of_the_schema()
    -> Result<(), serde_json::Error> {
        let short = json!({
            "disturbance": [1.0, null, 3.0],
            "fallback_level": "simple controller",
            "variance": [[1, 2, 3]],
            "tick_nanos": 5,
        })
        .to_string();
        let long = json!({
            "disturbance": [1.0, 2.0, 0.1],
            "fallback_level": "a,b",
            "variance": [[1, 2, 3], [4, 5, 6]],
            "stamp": {"sent_nanos": u64::MAX},
        });
        let long = long.to_string();
        let schema = view::schema::<Plan>().to_string();
        let mut columns = Columns::default();
        columns.look(schema.as_bytes(), short.as_bytes())?;
        columns.look(schema.as_bytes(), long.as_bytes())?;
        let header = columns.header();
        let (first, second) = (columns.row(short.as_bytes())?, columns.row(long.as_bytes())?);
        assert_eq!((first.len(), second.len()), (header.len(), header.len()));
        let at = |row: &[String], name: &str| {
            header
                .iter()
                .position(|column| column == name)
                .and_then(|index| row.get(index).cloned())
        };
        for (name, in_first, in_second) in [
            ("variance_1_2 [(rad/s)²]", "", "6"),
            ("disturbance_1 [m/s]", "", "2.0"),
            ("disturbance_2 [rad/s]", "3.0", "0.1"),
            ("fallback_level", "simple controller", "a,b"),
            ("tick_nanos [ns]", "5", ""),
            ("stamp_sent_nanos [ns]", "", "18446744073709551615"),
        ] {
            assert_eq!(
                (at(&first, name).as_deref(), at(&second, name).as_deref()),
                (Some(in_first), Some(in_second)),
                "{name}: {header:?}"
            );
        }
        Ok(())
    }

    #[test]
    fn a_message_that_is_not_an_object_is_rejected() {
        assert!(Columns::default().look(b"", b"[1, 2]").is_err());
        assert!(Columns::default().look(b"", b"{\"a\":").is_err());
    }
}
