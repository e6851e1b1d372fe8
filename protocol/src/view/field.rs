//! message → JSON: the description of one field in a record, and the JSON Schema made of it.

use super::words::Words;
use serde_json::{Map, Value, json};

/// One entry of a recorded message.
#[derive(Debug, Clone, Copy)]
pub struct Field {
    /// Its key.
    pub name: &'static str,
    /// The form of its value.
    pub shape: Shape,
    /// Its meaning, with units.
    pub about: &'static str,
}

/// The form of a value in JSON. A number that is not finite is written as null.
#[derive(Debug, Clone, Copy)]
pub enum Shape {
    /// A whole number.
    Integer,
    /// One number.
    Number,
    /// Any number of numbers.
    Numbers,
    /// Any number of rows of numbers.
    Rows,
    /// Free text.
    Text,
    /// One of a few words.
    Word(Words),
    /// A whole number for each topic.
    ByTopic,
}

const STAMP: &[(&str, &str)] = &[
    ("writer", "one process instance, drawn at random when it started"),
    ("epoch", "how often this role has been started"),
    ("sequence", "counts the messages of one writer and epoch on this topic, from 1"),
    ("tick", "control period that the message is about"),
    ("sent_nanos", "writer's monotonic clock when it was sent [ns]"),
];

/// JSON Schema of a message with these fields behind its stamp.
pub fn schema(title: &str, about: &str, fields: &[Field]) -> Value {
    let stamp = object(
        "The writer, and the time.",
        STAMP.iter().map(|&(name, about)| (name, described(json!({"type": "integer"}), about))),
    );
    let fields =
        fields.iter().map(|field| (field.name, described(field.shape.schema(), field.about)));
    let mut schema = object(about, std::iter::once(("stamp", stamp)).chain(fields));
    if let Value::Object(entries) = &mut schema {
        entries.insert("$schema".to_owned(), json!("https://json-schema.org/draft/2020-12/schema"));
        entries.insert("title".to_owned(), json!(title));
    }
    schema
}

impl Shape {
    fn schema(self) -> Value {
        match self {
            Self::Integer => json!({"type": "integer"}),
            Self::Number => json!({"type": "number"}),
            Self::Numbers => json!({"type": "array", "items": {"type": "number"}}),
            Self::Rows => {
                json!({"type": "array", "items": {"type": "array", "items": {"type": "number"}}})
            }
            Self::Text => json!({"type": "string"}),
            Self::Word(words) => json!({"type": "string", "enum": words()}),
            Self::ByTopic => {
                let topics = crate::topic::Topic::ALL
                    .iter()
                    .map(|topic| (topic.name(), json!({"type": "integer"})));
                object("", topics)
            }
        }
    }
}

fn object(about: &str, properties: impl Iterator<Item = (&'static str, Value)>) -> Value {
    let properties: Map<String, Value> =
        properties.map(|(name, schema)| (name.to_owned(), schema)).collect();
    let required: Vec<&String> = properties.keys().collect();
    json!({"type": "object", "description": about, "required": required, "properties": properties})
}

fn described(mut schema: Value, about: &str) -> Value {
    if let Value::Object(entries) = &mut schema {
        entries.insert("description".to_owned(), json!(about));
    }
    schema
}
