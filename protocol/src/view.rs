//! message → JSON, and its JSON Schema, for records and for telemetry.
//!
//! Of an array only the entries that count are written.

use crate::message::Message;
use crate::message::field::{Field, Shape};
use crate::topic::Topic;
use serde::ser::{Serialize, SerializeMap, Serializer};
use serde_json::{Map, Value, json};

/// A message as a JSON object.
pub struct View<'a, T>(pub &'a T);

impl<T: Message> Serialize for View<'_, T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("stamp", self.0.stamp())?;
        self.0.show(&mut map)?;
        map.end()
    }
}

/// Documentation as plain text: without the marks of links and code.
pub fn plain(about: &str) -> String {
    let mut plain = String::new();
    let mut rest = about.trim();
    while let Some((before, after)) = rest.split_once("[`") {
        plain.push_str(before);
        let Some((word, after)) = after.split_once("`]") else { break };
        plain.push('`');
        plain.push_str(word);
        plain.push('`');
        let target = after.strip_prefix('(').and_then(|target| target.split_once(')'));
        rest = target.map_or(after, |(_, after)| after);
    }
    plain.push_str(rest);
    plain.replace("\\[", "[").replace("\\]", "]")
}

const STAMP: &[(&str, &str)] = &[
    ("writer", "one process instance, drawn at random when it started"),
    ("epoch", "how often this role has been started"),
    ("sequence", "counts the messages of one writer and epoch on this topic, from 1"),
    ("tick", "control period that the message is about"),
    ("sent_nanos", "writer's monotonic clock when it was sent [ns]"),
];

/// JSON Schema of `T`'s view.
pub fn schema<T: Message>() -> Value {
    let stamp = object(
        "The writer, and the time.",
        STAMP.iter().map(|&(name, about)| (name, described(json!({"type": "integer"}), about))),
    );
    let fields = T::fields();
    let fields = fields.iter().filter_map(property);
    let mut schema = object(&plain(T::ABOUT), std::iter::once(("stamp", stamp)).chain(fields));
    if let Value::Object(entries) = &mut schema {
        entries.insert("$schema".to_owned(), json!("https://json-schema.org/draft/2020-12/schema"));
        entries.insert("title".to_owned(), json!(T::NAME));
    }
    schema
}

fn property(field: &Field) -> Option<(&'static str, Value)> {
    let form = match field.shape? {
        Shape::Integer => json!({"type": "integer"}),
        Shape::Number => json!({"type": "number"}),
        Shape::Numbers => json!({"type": "array", "items": {"type": "number"}}),
        Shape::Rows => {
            json!({"type": "array", "items": {"type": "array", "items": {"type": "number"}}})
        }
        Shape::Text => json!({"type": "string"}),
        Shape::Word(words) => json!({"type": "string", "enum": words}),
        Shape::ByTopic => {
            let topics = Topic::ALL.iter().map(|topic| (topic.name(), json!({"type": "integer"})));
            object("", topics)
        }
    };
    Some((field.name, described(form, &plain(field.about))))
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
