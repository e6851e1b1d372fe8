//! Promise: a base may be a program in any language, and the driver names its errors.

use driver::base::per_wheel;
use driver::piped::{PipedBase, Program};
use driver::{Base, BaseError, Start};
use std::error::Error;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

type Outcome = Result<(), Box<dyn Error>>;

/// A robot that replies as its settings say. The program is a file of the tree: a file written by
/// the test could not be started while another test's new process still holds it open.
struct Script {
    settings: toml::Table,
    folder: TempDir,
}

impl Script {
    /// `first` is the reply to the first line, and `reading` that to each request. Without it the
    /// robot ends.
    fn new(first: &str, reading: Option<&str>) -> Result<Self, Box<dyn Error>> {
        let folder = tempfile::tempdir()?;
        let mut settings = toml::Table::new();
        settings.insert("mass_kg".into(), 12.5.into());
        settings.insert("first".into(), first.into());
        if let Some(reading) = reading {
            settings.insert("reading".into(), reading.into());
        }
        settings
            .insert("received".into(), folder.path().join("received").display().to_string().into());
        Ok(Self { settings, folder })
    }

    fn start(&self) -> Result<PipedBase, BaseError> {
        let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/robot");
        let program = Program { program, settings: self.settings.clone() };
        PipedBase::start(&program, 4, Start::default(), 7)
    }

    /// The lines that the program received.
    fn received(&self) -> Result<Vec<serde_json::Value>, Box<dyn Error>> {
        let text = fs::read_to_string(self.folder.path().join("received"))?;
        text.lines().map(|line| Ok(serde_json::from_str(line)?)).collect()
    }
}

const READY: &str = r#"{"ready": {"wheels": 4}}"#;

/// The error of a start that has to fail.
fn refusal(script: &Script) -> Result<BaseError, Box<dyn Error>> {
    match script.start() {
        Ok(_) => Err("it starts".into()),
        Err(error) => Ok(error),
    }
}

#[test]
fn a_program_receives_its_settings_and_is_driven_and_read() -> Outcome {
    let reading = r#"{"pose": [1, 2, 3], "velocity": [4, 5, 6], "wheel_speed": [1, 2, 3, 4],
        "current": [0.5, 0, 0, -0.5], "truth": {"pose": [1, 2, 2.5], "velocity": [4, 5, 5.5]}}"#;
    let script = Script::new(READY, Some(&reading.replace('\n', "")))?;
    let mut base = script.start()?;
    base.drive([0.5, 0.0, -0.25], 20_000_000)?;
    let sensors = base.read()?;
    assert_eq!((sensors.pose, sensors.velocity), ([1.0, 2.0, 3.0], [4.0, 5.0, 6.0]));
    assert_eq!(sensors.wheel_speed, Some(per_wheel(&[1.0, 2.0, 3.0, 4.0])));
    assert_eq!(sensors.current, Some(per_wheel(&[0.5, 0.0, 0.0, -0.5])));
    assert_eq!(base.truth().map(|truth| truth.pose), Some([1.0, 2.0, 2.5]));
    drop(base);
    let received = script.received()?;
    assert_eq!(received[0]["settings"]["mass_kg"], 12.5);
    assert_eq!(received[0]["seed"], 7);
    assert_eq!(received[1], serde_json::json!({ "drive": [0.5, 0.0, -0.25], "nanos": 20_000_000 }));
    assert_eq!(received[2], serde_json::json!({ "read": true }));
    Ok(())
}

#[test]
fn a_robot_without_truth_has_none() -> Outcome {
    let reading = r#"{"pose": [0, 0, 0], "velocity": [0, 0, 0],
        "wheel_speed": [0, 0, 0, 0], "current": [0, 0, 0, 0]}"#;
    let script = Script::new(READY, Some(&reading.replace('\n', "")))?;
    let mut base = script.start()?;
    base.read()?;
    assert_eq!(base.truth(), None);
    Ok(())
}

#[test]
fn values_that_a_robot_does_not_measure_are_absent_and_not_zero() -> Outcome {
    let reading = r#"{"pose": [0, 0, 0], "velocity": [0, 0, 0], "estop": true,
        "input_delay_s": 0.02}"#;
    let script = Script::new(READY, Some(&reading.replace('\n', "")))?;
    let sensors = script.start()?.read()?;
    assert_eq!((sensors.wheel_speed, sensors.current), (None, None));
    assert_eq!((sensors.estop, sensors.input_delay_s), (true, 0.02));
    Ok(())
}

#[test]
fn a_program_that_rejects_a_setting_names_it() -> Outcome {
    let first = r#"{"refused": {"key": "mass_kg", "expected": "a number below 10"}}"#;
    let error = refusal(&Script::new(first, None)?)?;
    assert!(
        matches!(&error, BaseError::Refused { key, expected }
            if key == "mass_kg" && expected == "a number below 10"),
        "{error:?}"
    );
    Ok(())
}

#[test]
fn a_program_that_is_missing_or_replies_wrongly_or_has_other_wheels_is_rejected() -> Outcome {
    let nowhere = Program { program: "/nowhere/robot".into(), settings: toml::Table::new() };
    assert!(matches!(
        PipedBase::start(&nowhere, 4, Start::default(), 1),
        Err(BaseError::Start { .. })
    ));
    for first in ["hello", r#"{"ready": {"wheels": 3}}"#] {
        let error = refusal(&Script::new(first, None)?)?;
        assert!(matches!(error, BaseError::Answer { .. }), "{error:?}");
    }
    Ok(())
}

#[test]
fn the_error_of_a_program_that_ends_has_its_exit_status() -> Outcome {
    let script = Script::new(READY, None)?;
    let mut base = script.start()?;
    let error = base.read().err().ok_or("it is read")?;
    assert!(matches!(&error, BaseError::Ended { reason, .. } if reason.contains('3')), "{error:?}");
    Ok(())
}
