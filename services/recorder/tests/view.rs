//! Content of the record: JSON that fits its schema.

#[path = "said/graph.rs"]
#[expect(dead_code, reason = "shared with the test of the recorder itself")]
mod graph;

use protocol::message::{Health, ModelSnapshot, Plan};
use protocol::topic::OnTopic;
use protocol::view::{View, schema};
use serde_json::Value;

fn json<T: OnTopic>(message: &T) -> Value {
    serde_json::to_value(View(message)).unwrap_or_default()
}

/// Fails unless `value` fits `schema`. Null stands for a number that is not finite.
fn fits(value: &Value, schema: &Value, place: &str) {
    let words = schema["enum"].as_array();
    assert!(
        words.is_none_or(|words| words.contains(value)),
        "{place}: {value} is none of {words:?}"
    );
    match (schema["type"].as_str(), value) {
        (Some("object"), Value::Object(entries)) => {
            let properties = schema["properties"]
                .as_object()
                .map(|properties| properties.keys().collect::<Vec<_>>());
            assert_eq!(properties, Some(entries.keys().collect()), "{place}");
            for (key, value) in entries {
                fits(value, &schema["properties"][key], &format!("{place}.{key}"));
            }
        }
        (Some("array"), Value::Array(items)) => {
            for item in items {
                fits(item, &schema["items"], place);
            }
        }
        (Some("integer"), Value::Number(number)) => assert!(number.is_u64(), "{place}: {number}"),
        (Some("number"), Value::Number(_) | Value::Null) | (Some("string"), Value::String(_)) => {}
        (expected, found) => assert_eq!(expected, None, "{place}: {found}"),
    }
}

fn fits_its_schema<T: OnTopic>(message: &T) {
    fits(&json(message), &schema::<T>(), T::NAME);
}

#[test]
fn every_message_fits_its_schema() {
    fits_its_schema(&graph::state(3));
    fits_its_schema(&graph::truth(3));
    fits_its_schema(&graph::command(3));
    fits_its_schema(&graph::plan(3));
    fits_its_schema(&graph::snapshot(25));
    fits_its_schema(&graph::health(3));
}

#[test]
fn every_field_has_a_description() {
    for schema in [schema::<Plan>(), schema::<ModelSnapshot>(), schema::<Health>()] {
        let properties = schema["properties"].as_object();
        let silent = |(_, property): (&String, &Value)| {
            property["description"].as_str().is_none_or(str::is_empty)
        };
        assert!(properties.is_some_and(|properties| !properties.iter().any(silent)), "{schema}");
    }
}

#[test]
fn arrays_end_at_their_last_valid_entry() {
    let plan = json(&graph::plan(3));
    let rows = |key: &str| plan[key].as_array().map(Vec::len);
    assert_eq!(
        (rows("predicted"), rows("reference"), rows("variance"), rows("input")),
        (Some(6), Some(6), Some(6), Some(5))
    );
    let snapshot = json(&graph::snapshot(25));
    assert_eq!(snapshot["inputs"], serde_json::json!([[0.0, 0.5], [1.0, 0.5], [2.0, 0.5]]));
    assert_eq!(snapshot["length_scale"], serde_json::json!([[0.0, 0.0], [0.0, 0.0], [0.0, 0.0]]));
    assert_eq!(json(&graph::command(1))["tail"].as_array().map(Vec::len), Some(2));
}

#[test]
fn codes_and_counters_are_readable() {
    assert_eq!(json(&graph::state(3))["fallback_level"], "fresh plan");
    let health = json(&graph::health(40));
    assert_eq!(
        (&health["participant"], &health["phase"], &health["last_error"]),
        (&"controller".into(), &"starting".into(), &"a state was late".into())
    );
    assert_eq!(health["lost"]["state"], 4);
}

#[test]
fn a_number_that_is_not_finite_is_null() {
    let mut truth = graph::truth(0);
    truth.pose = [f64::NAN, f64::INFINITY, 1.0];
    fits_its_schema(&truth);
    assert_eq!(json(&truth)["pose"], serde_json::json!([null, null, 1.0]));
}
