//! A change applies as a whole or not at all. The error names the key, its value and the expected
//! value.

use serde::{Deserialize, Serialize};
use settings::change::{Change, Rules, changed};
use settings::{Check, Impossible};

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Robot {
    name: String,
    steps: usize,
    free_steps: usize,
    weights: Weights,
    path: Route,
    heading: Heading,
    limits: Limits,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Weights {
    position: f64,
    heading: f64,
}

#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Limits {
    speed: Option<f64>,
    width: Option<f64>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
enum Route {
    Circle { radius: f64, speed: f64 },
    Line { speed: f64 },
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Heading {
    Tangent,
    FixedRad(f64),
}

impl Check for Robot {
    fn check(&self) -> Result<(), Impossible> {
        if self.free_steps <= self.steps {
            Ok(())
        } else {
            Err(Impossible::new("free_steps", format!("at most {}", self.steps)))
        }
    }
}

const RULES: Rules<'static> = Rules {
    tunable: &["steps", "free_steps", "weights", "path", "heading", "limits"],
    choices: &["path"],
};

fn robot() -> Robot {
    Robot {
        name: "a".into(),
        steps: 5,
        free_steps: 3,
        weights: Weights { position: 1.0, heading: 0.1 },
        path: Route::Circle { radius: 1.0, speed: 0.3 },
        heading: Heading::Tangent,
        limits: Limits { speed: Some(2.0), width: None },
    }
}

fn apply(lines: &str) -> Result<Robot, String> {
    Change::parse(lines)
        .and_then(|change| changed(&robot(), &[change], &RULES))
        .map_err(|error| error.to_string())
}

#[test]
fn a_change_affects_only_its_own_keys() {
    let expected = Robot {
        steps: 7,
        free_steps: 6,
        weights: Weights { position: 4.0, ..robot().weights },
        ..robot()
    };
    assert_eq!(apply("steps = 7\nfree_steps = 6\nweights.position = 4"), Ok(expected.clone()));
    assert_eq!(
        apply("[weights]\nposition = 4.0\n").map(|robot| robot.weights),
        Ok(expected.weights)
    );
    assert_eq!(apply("weights = { position = 1.0 }"), Ok(robot()), "a table is merged, key by key");
}

#[test]
fn another_kind_of_path_replaces_the_table_and_the_same_kind_is_merged() {
    assert_eq!(
        apply("path.circle.radius = 2.0").map(|robot| robot.path),
        Ok(Route::Circle { radius: 2.0, speed: 0.3 })
    );
    assert_eq!(
        apply("path.line.speed = 0.5").map(|robot| robot.path),
        Ok(Route::Line { speed: 0.5 })
    );
    assert_eq!(
        apply("heading = { fixed-rad = 0.5 }").map(|robot| robot.heading),
        Ok(Heading::FixedRad(0.5))
    );
    let nothing_left = apply("path.line.colour = 1");
    assert!(
        nothing_left
            .as_ref()
            .is_err_and(|message| message.contains("path.line.colour = 1: unknown key")),
        "{nothing_left:?}"
    );
}

#[test]
fn an_optional_limit_can_be_removed_and_a_required_key_cannot() {
    assert_eq!(apply("limits.speed = \"none\"").map(|robot| robot.limits), Ok(Limits::default()));
    assert_eq!(
        apply("limits.width = \"none\""),
        Ok(robot()),
        "removing an absent key changes nothing"
    );
    assert_eq!(
        apply("weights.position = \"none\""),
        Err("weights.position is missing: it has no default; expected a value".into())
    );
}

#[test]
fn every_error_names_the_key_its_value_and_the_expected_value() {
    let message = |lines: &str| apply(lines).err().unwrap_or_default();
    assert_eq!(message("free_steps = 6"), "free_steps = 6: expected at most 5");
    assert_eq!(
        message("steps = 2"),
        "free_steps = 3: expected at most 2",
        "the unchanged key contradicts the changed one"
    );
    assert_eq!(
        message("weights.position = 4.0\nfree_steps = 6"),
        "free_steps = 6: expected at most 5",
        "the other key of the change is valid"
    );
    assert_eq!(
        message("weights.position = \"much\""),
        "weights.position = \"much\": expected a number"
    );
    assert_eq!(
        message("weights.length = 1"),
        "weights.length = 1: unknown key, expected one of position, heading"
    );
    assert_eq!(
        message("name = \"b\""),
        "name = \"b\": cannot change during the run; \
         expected a key below steps, free_steps, weights, path, heading, limits"
    );
    assert_eq!(
        message("steps_of_mine = 1").split(';').next(),
        Some("steps_of_mine = 1: cannot change during the run")
    );
    assert_eq!(message(""), "nothing is changed: expected at least one KEY = VALUE");
    assert_eq!(message("# nothing"), "nothing is changed: expected at least one KEY = VALUE");
    assert!(
        message("steps = 7\nsteps 8").starts_with("`steps 8` is not TOML: "),
        "{}",
        message("steps = 7\nsteps 8")
    );
}

#[test]
fn several_changes_are_merged_in_their_order() -> Result<(), Box<dyn std::error::Error>> {
    let changes = ["steps = 2\nfree_steps = 1", "steps = 9", "free_steps = 8"]
        .map(Change::parse)
        .into_iter()
        .collect::<Result<Vec<_>, _>>()?;
    let robot = changed(&robot(), &changes, &RULES)?;
    assert_eq!((robot.steps, robot.free_steps), (9, 8));
    Ok(())
}
