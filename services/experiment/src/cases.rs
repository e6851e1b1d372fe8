//! The requested scenarios → one assembly for each: scenarios of a graph, or all of a world.

use super::{CompareOptions, ExperimentError, SCENARIOS};
use graph::assembly::Assembly;
use graph::options::Options;
use graph::scenario::Scenario;
use robot::Robot;
use serde::Deserialize;
use settings::{Check, Impossible, SettingsError};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The variant with the noise of every comparison.
const NOISE: &str = "noise";

/// The folder of the worlds.
const WORLDS: &str = "deploy/worlds";

/// The cases of a comparison, by name.
pub(super) struct Cases {
    /// The assembly of each case.
    pub(super) assemblies: BTreeMap<String, Assembly>,
    /// For a stale start: the scenario in which it has learned.
    pub(super) other: BTreeMap<String, String>,
}

/// A world's file of robots, references and conditions: each combination is a scenario.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Grid {
    robots: Vec<String>,
    references: Vec<String>,
    conditions: Vec<String>,
}

impl Check for Grid {
    fn check(&self) -> Result<(), Impossible> {
        let lists = [
            ("robots", &self.robots),
            ("references", &self.references),
            ("conditions", &self.conditions),
        ];
        match lists.iter().find(|(_, list)| list.is_empty()) {
            Some((key, _)) => Err(Impossible::new(*key, "at least one name")),
            None => Ok(()),
        }
    }
}

impl Cases {
    /// Reads and checks all that `options` request.
    ///
    /// # Errors
    /// [`ExperimentError`] names the first error.
    pub(super) fn read(options: &CompareOptions) -> Result<Self, ExperimentError> {
        let mut cases = Self { assemblies: BTreeMap::new(), other: BTreeMap::new() };
        match &options.world {
            Some(world) => cases.add_world(&Path::new(WORLDS).join(world), options)?,
            None => cases.add_graph(options)?,
        }
        for assembly in cases.assemblies.values_mut() {
            for belief in &options.beliefs {
                assembly.robot = belief.of(&assembly.robot)?;
            }
        }
        Ok(cases)
    }

    /// Adds scenarios from the folder of the graph's own scenario.
    fn add_graph(&mut self, options: &CompareOptions) -> Result<(), ExperimentError> {
        let base = Assembly::read(&Options::of_graph(&options.graph))?;
        let own = options.graph.parent().unwrap_or(Path::new("")).join(&base.graph.scenario);
        let folder = own.parent().unwrap_or(Path::new("")).to_path_buf();
        let mut variants = Scenario::variants(&folder);
        if !options.exact_sensors {
            variants.retain(|variant| variant != NOISE);
        }
        let defaults = SCENARIOS.map(str::to_owned);
        let asked = if options.scenarios.is_empty() { &defaults[..] } else { &options.scenarios };
        for asked in asked {
            let names = match asked.strip_suffix("+*") {
                Some(base) => std::iter::once(base.to_owned())
                    .chain(variants.iter().map(|variant| format!("{base}+{variant}")))
                    .collect(),
                None => vec![asked.clone()],
            };
            for name in names {
                self.add(&base, &folder, &name, &variants, options)?;
            }
        }
        Ok(())
    }

    /// Adds the combinations of a world's grid: the named ones, or all if none is named. A `*`
    /// stands for every name.
    fn add_world(&mut self, world: &Path, options: &CompareOptions) -> Result<(), ExperimentError> {
        let grid: Grid = settings::read(&world.join("grid.toml"))?;
        let asked: Vec<Vec<&str>> =
            options.scenarios.iter().map(|name| name.split('+').collect()).collect();
        let wanted = |names: [&String; 3]| {
            asked.is_empty()
                || asked.iter().any(|asked| {
                    asked.len() <= names.len()
                        && names
                            .iter()
                            .zip(asked)
                            .all(|(name, asked)| *asked == "*" || name == asked)
                })
        };
        for robot in &grid.robots {
            let graph = world.join("graphs").join(robot).with_extension("toml");
            let base = Assembly::read(&Options::of_graph(&graph))?;
            for (reference, condition) in grid
                .references
                .iter()
                .flat_map(|reference| grid.conditions.iter().map(move |it| (reference, it)))
            {
                if wanted([robot, reference, condition]) {
                    let name = format!("{robot}+{reference}+{condition}");
                    self.add(&base, world, &name, &grid.conditions, options)?;
                }
            }
        }
        if self.assemblies.is_empty() {
            return Err(ExperimentError::NothingToCompare {
                world: world.display().to_string(),
                asked: options.scenarios.join(","),
            });
        }
        Ok(())
    }

    fn add(
        &mut self,
        base: &Assembly,
        folder: &Path,
        name: &str,
        variants: &[String],
        options: &CompareOptions,
    ) -> Result<(), SettingsError> {
        self.read_one(base, folder, name, options)?;
        if options.start.contains(&super::trial::Start::Stale) {
            let elsewhere = elsewhere(name, variants);
            self.read_one(base, folder, &elsewhere, options)?;
            self.other.insert(name.to_owned(), elsewhere);
        }
        Ok(())
    }

    fn read_one(
        &mut self,
        base: &Assembly,
        folder: &Path,
        name: &str,
        options: &CompareOptions,
    ) -> Result<(), SettingsError> {
        let profile = (options.profile != "paper").then_some(options.profile.as_str());
        let is_noisy = options.world.is_none() && !options.exact_sensors;
        let is_named = |variant: &str| options.variants.iter().any(|name| name == variant);
        let whole: String = std::iter::once(name)
            .chain(options.variants.iter().map(String::as_str))
            .chain((is_noisy && !is_named(NOISE)).then_some(NOISE))
            .fold(String::new(), |whole, part| {
                if whole.is_empty() { part.to_owned() } else { whole + "+" + part }
            });
        let scenario = Scenario::named(folder, &whole, profile, &options.changes)?;
        self.assemblies.insert(name.to_owned(), Assembly { scenario, ..base.clone() });
        Ok(())
    }
}

/// Another variant of the same scenario: the next in the list.
fn elsewhere(name: &str, variants: &[String]) -> String {
    let (base, variant) = match name.rsplit_once('+') {
        Some((base, variant)) if variants.iter().any(|other| other == variant) => (base, variant),
        _ => (name, ""),
    };
    let place = variants.iter().position(|other| other == variant).map_or(0, |place| place + 1);
    let after = variants.get(place).or(variants.first());
    after.map_or_else(|| name.to_owned(), |other| format!("{base}+{other}"))
}

/// A number of the robot file that is wrong for the controller only: a key and a factor.
#[derive(Debug, Clone, PartialEq)]
pub struct Belief {
    key: String,
    factor: f64,
}

impl std::str::FromStr for Belief {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once('=').and_then(|(key, factor)| {
            Some((key.to_owned(), factor.parse().ok().filter(|factor: &f64| factor.is_finite())?))
        });
        let (key, factor) = parts.ok_or("expected KEY=FACTOR, as body.mass_kg=2")?;
        Ok(Self { key, factor })
    }
}

impl Belief {
    /// `robot` with the wrong number.
    fn of(&self, robot: &Robot) -> Result<Robot, SettingsError> {
        let wrong = |expected: &str| SettingsError::Value {
            file: PathBuf::from("--believe"),
            line: None,
            key: self.key.clone(),
            value: None,
            expected: expected.to_owned(),
        };
        let mut file = toml::Value::try_from(robot).map_err(|_| wrong("a robot"))?;
        let number = (self.key.split('.'))
            .try_fold(&mut file, |table, key| table.get_mut(key))
            .ok_or_else(|| wrong("a number of the robot file, as body.mass_kg"))?;
        let value = number.as_float().ok_or_else(|| wrong("a number"))?;
        *number = toml::Value::Float(value * self.factor);
        let believed: Robot = file.try_into().map_err(|_| wrong("a number"))?;
        believed.check().map_err(|impossible| wrong(impossible.expected))?;
        Ok(believed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use robot::Drive;

    #[test]
    fn a_wrong_belief_changes_one_number_of_the_robot_file()
    -> Result<(), Box<dyn std::error::Error>> {
        let robot = Robot::example();
        let belief: Belief = "drive.current_limit_a=0.5".parse()?;
        let mut expected = robot;
        expected.drive = expected
            .drive
            .map(|drive| Drive { current_limit_a: 0.5 * drive.current_limit_a, ..drive });
        assert_eq!(belief.of(&robot)?, expected);
        let wider = "wheels.mecanum.track_m=1.1".parse::<Belief>()?.of(&robot)?;
        let lever_m = |robot: &Robot| robot.wheels.lever_m();
        assert!((lever_m(&wider) - lever_m(&robot) - 0.015).abs() < 1e-12);
        for wrong in
            ["drive.curent_limit_a=2", "mass=2", "body.mass_kg=-1", "wheels.mecanum.track_m=0"]
        {
            assert!(wrong.parse::<Belief>()?.of(&robot).is_err(), "{wrong}");
        }
        assert!("body.mass_kg=much".parse::<Belief>().is_err());
        Ok(())
    }

    #[test]
    fn a_stale_start_has_learnt_in_the_next_variant_of_the_same_scenario() {
        let variants = ["deadband", "noise", "soft"].map(str::to_owned);
        for (name, expected) in [
            ("circle", "circle+deadband"),
            ("circle+noise", "circle+soft"),
            ("courier+circle+soft", "courier+circle+deadband"),
        ] {
            assert_eq!(elsewhere(name, &variants), expected);
        }
    }
}
