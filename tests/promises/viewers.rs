//! Promise: a record opens unchanged in public viewers: every drawing fits the standard type that
//! its schema names.

use promises::{Launched, Outcome, Record, python, repository, text_of};
use serde_json::Value;
use std::process::Command;

#[test]
fn a_record_opens_with_the_public_reader_and_its_drawings_fit_the_types_of_the_foxglove_sdk()
-> Outcome {
    let (ended, home) = Launched::graph("local", &["--pace", "lock-step"])?.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    let folder = home.path().join("run");
    let script = repository().join("tests/python/viewers.py");
    let text =
        text_of(Command::new(python()?).arg("-B").arg(script).arg(folder.join("record.mcap")))?;
    let value: Value = serde_json::from_str(&text)?;
    let record = Record::read(&folder)?;
    let count = |channel: &str| value["counts"][channel].as_u64().unwrap_or_default();
    for (channel, topic) in [
        ("tf", "state"),
        ("pose", "state"),
        ("tracking", "plan"),
        ("state", "state"),
        ("command", "command"),
    ] {
        assert_eq!(
            count(channel),
            record.of(topic).count() as u64,
            "{channel}: one for each {topic}"
        );
    }
    assert_eq!(
        (count("path"), count("horizon") > 100, count("reference") > 100),
        (26, true, true),
        "{}",
        value["counts"]
    );

    let last = record.of("state").next_back().ok_or("no state")?.numbers("pose");
    let pose = &value["last"]["pose"]["pose"];
    for (name, value) in [("x", last[0]), ("y", last[1])] {
        let drawn = pose["position"][name].as_f64().ok_or("no number")?;
        assert!((drawn - value).abs() < 1e-5, "{name}: {drawn} is drawn, {value} was measured");
    }
    let [sine, cosine] =
        ["z", "w"].map(|name| pose["orientation"][name].as_f64().unwrap_or(f64::NAN));
    assert!((2.0 * sine.atan2(cosine) - last[2]).sin().abs() < 1e-4, "yaw");
    let plan = record.of("plan").next_back().ok_or("no plan")?;
    assert_eq!(value["last"]["tracking"]["model_version"], plan.fields["model_version"]);
    let rows = plan.fields["predicted"].as_array().map(Vec::len);
    assert_eq!(value["last"]["horizon"]["poses"].as_array().map(Vec::len), rows);
    Ok(())
}
