//! Every error names file, line, key, value and the expected value.

use serde::{Deserialize, Serialize};
use settings::{Check, Impossible, SettingsError};
use std::path::Path;

#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Scenario {
    seed: u64,
    #[serde(default)]
    pace: Pace,
    truth: Truth,
    path: Route,
    #[serde(default)]
    pushes: Vec<Push>,
}

#[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Pace {
    #[default]
    RealTime,
    LockStep,
}

#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Truth {
    mass_kg: f64,
    #[serde(default = "all_well")]
    motor_gain: [f64; 4],
}

fn all_well() -> [f64; 4] {
    [1.0; 4]
}

#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
enum Route {
    Circle { radius_m: f64 },
    Line { length_m: f64 },
}

#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Push {
    force_n: f64,
}

impl Check for Scenario {
    fn check(&self) -> Result<(), Impossible> {
        if self.truth.mass_kg <= 0.0 {
            return Err(Impossible::new("mass_kg", "a positive mass").under("truth"));
        }
        for (wheel, gain) in self.truth.motor_gain.into_iter().enumerate() {
            if gain < 0.0 {
                return Err(Impossible::new(format!("motor_gain.{wheel}"), "a gain of at least 0")
                    .under("truth"));
            }
        }
        if self.seed == 13 {
            return Err(Impossible::new("truth.absent.key", "another seed"));
        }
        if self.pushes.iter().any(|push| push.force_n > 100.0) {
            return Err(Impossible::new("pushes.1.force_n", "at most 100 N"));
        }
        Ok(())
    }
}

const GOOD: &str = r"# a scenario
seed = 7

[truth]
mass_kg = 22
motor_gain = [0.85, 1, 1, 1]

[path.circle]
radius_m = 2.0

[[pushes]]
force_n = 1.0
[[pushes]]
force_n = 2.0
";

fn refusal(text: &str) -> String {
    match settings::parse::<Scenario>(text, Path::new("deploy/paper.toml")) {
        Ok(scenario) => format!("accepted: {scenario:?}"),
        Err(error) => error.to_string(),
    }
}

fn refusal_with(from: &str, to: &str) -> String {
    assert!(GOOD.contains(from), "{from} is not in the good scenario");
    refusal(&GOOD.replacen(from, to, 1))
}

#[test]
fn valid_settings_are_read_completely() {
    let scenario = settings::parse::<Scenario>(GOOD, Path::new("good.toml"));
    let expected = Scenario {
        seed: 7,
        pace: Pace::RealTime,
        truth: Truth { mass_kg: 22.0, motor_gain: [0.85, 1.0, 1.0, 1.0] },
        path: Route::Circle { radius_m: 2.0 },
        pushes: vec![Push { force_n: 1.0 }, Push { force_n: 2.0 }],
    };
    assert_eq!(scenario, Ok(expected));
}

#[test]
fn written_settings_read_back_the_same() -> Result<(), Box<dyn std::error::Error>> {
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("scenario.toml");
    let scenario: Scenario = settings::parse(GOOD, Path::new("good.toml"))?;
    settings::write(&file, &scenario)?;
    assert_eq!(settings::read::<Scenario>(&file)?, scenario);
    Ok(())
}

#[test]
fn the_error_names_a_missing_file() {
    let refused = settings::read::<Scenario>(Path::new("/nowhere/paper.toml"))
        .map_err(|error| error.to_string());
    let message =
        "/nowhere/paper.toml: expected a settings file, but No such file or directory (os error 2)";
    assert_eq!(refused, Err(message.to_owned()));
}

#[test]
fn a_byte_that_is_not_utf_8_is_shown_with_its_line() -> Result<(), Box<dyn std::error::Error>> {
    let file = tempfile::NamedTempFile::new()?;
    std::fs::write(file.path(), b"seed = 7\n# \xff of the crate\n")?;
    let refused = settings::read::<Scenario>(file.path()).map_err(|error| error.to_string());
    let message = format!(
        "{}:2: `# \u{fffd} of the crate` is not TOML: expected text in UTF-8",
        file.path().display()
    );
    assert_eq!(refused, Err(message));
    Ok(())
}

#[test]
fn a_line_that_is_not_toml_is_shown_with_its_number() {
    assert_eq!(
        refusal_with("mass_kg = 22", "mass_kg = = 22"),
        "deploy/paper.toml:5: `mass_kg = = 22` is not TOML: extra `=`, expected nothing"
    );
    assert_eq!(
        refusal_with("mass_kg = 22", "mass_kg = 22\nmass_kg = 23"),
        "deploy/paper.toml:6: `mass_kg = 23` is not TOML: duplicate key"
    );
}

#[test]
fn an_unknown_key_is_named_with_the_known_keys() {
    assert_eq!(
        refusal_with("mass_kg = 22", "mass_kg = 22\nmas_kg = 3.0"),
        "deploy/paper.toml:6: truth.mas_kg = 3.0: unknown key, expected one of mass_kg, motor_gain"
    );
    assert_eq!(
        refusal_with("force_n = 2.0", "farce_n = 2.0"),
        "deploy/paper.toml:14: pushes.1.farce_n = 2.0: unknown key, expected force_n"
    );
    assert_eq!(
        refusal_with("[truth]", "[trooth]\n[truth]"),
        "deploy/paper.toml:4: trooth = a table: \
         unknown key, expected one of seed, pace, truth, path, pushes"
    );
    assert_eq!(
        refusal_with("radius_m = 2.0", "radius_mm = 2.0"),
        "deploy/paper.toml:9: path.circle.radius_mm = 2.0: unknown key, expected radius_m"
    );
}

#[test]
fn a_value_of_the_wrong_type_is_shown() {
    assert_eq!(
        refusal_with("mass_kg = 22", "mass_kg = \"heavy\""),
        "deploy/paper.toml:5: truth.mass_kg = \"heavy\": expected a number"
    );
    assert_eq!(
        refusal_with("seed = 7", "seed = -7"),
        "deploy/paper.toml:2: seed = -7: expected a whole number of at least 0"
    );
    assert_eq!(
        refusal_with("0.85, 1, 1, 1", "0.85, 1, 1"),
        "deploy/paper.toml:6: truth.motor_gain = [0.85, 1, 1]: expected an array of length 4"
    );
    assert_eq!(
        refusal_with("seed = 7", "seed = 7\npace = \"slow\""),
        "deploy/paper.toml:3: pace = \"slow\": expected one of real-time, lock-step"
    );
    assert_eq!(
        refusal("seed = 7\ntruth = 3\n"),
        "deploy/paper.toml:2: truth = 3: expected a table"
    );
}

#[test]
fn an_unknown_alternative_is_named_with_the_known_ones() {
    assert_eq!(
        refusal_with("path.circle", "path.cycle"),
        "deploy/paper.toml:8: path.cycle = a table: expected one of circle, line"
    );
}

#[test]
fn a_missing_key_is_named_with_its_table() {
    assert_eq!(
        refusal_with("mass_kg = 22\n", ""),
        "deploy/paper.toml:4: truth.mass_kg is missing: expected it in [truth]"
    );
    assert_eq!(
        refusal_with("seed = 7\n", ""),
        "deploy/paper.toml:1: seed is missing: expected it at the top of the file"
    );
    assert_eq!(
        refusal_with("force_n = 2.0\n", ""),
        "deploy/paper.toml:13: pushes.1.force_n is missing: expected it in [pushes.1]"
    );
    assert_eq!(
        refusal_with("radius_m = 2.0\n", ""),
        "deploy/paper.toml:8: path.circle.radius_m is missing: expected it in [path.circle]"
    );
}

#[test]
fn an_impossible_value_is_shown_with_its_line() {
    assert_eq!(
        refusal_with("mass_kg = 22", "mass_kg = -3.0"),
        "deploy/paper.toml:5: truth.mass_kg = -3.0: expected a positive mass"
    );
    assert_eq!(
        refusal_with("1, 1, 1", "1,\n  1,\n  -1"),
        "deploy/paper.toml:8: truth.motor_gain.3 = -1: expected a gain of at least 0"
    );
    assert_eq!(
        refusal_with("force_n = 2.0", "force_n = 200.0"),
        "deploy/paper.toml:14: pushes.1.force_n = 200.0: expected at most 100 N"
    );
}

#[test]
fn an_impossible_default_is_shown_with_the_line_of_its_table() {
    assert_eq!(
        refusal_with("seed = 7", "seed = 13"),
        "deploy/paper.toml:4: truth.absent.key: expected another seed"
    );
}

#[test]
fn the_kind_of_an_error_is_its_variant() {
    let unknown = settings::parse::<Scenario>("sead = 7\n", Path::new("a.toml"));
    assert!(
        matches!(unknown, Err(SettingsError::UnknownKey { line: 1, key, .. }) if key == "sead")
    );
}
