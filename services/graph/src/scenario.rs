//! The scenario file: reference, control settings, and the true world of the simulator.

use controller::goal::schedule::{self, Scheduled};
use controller::reference::{PLACE_MAX, Reference, ReferenceSettings, is_place};
use controller::settings::MpcSettings;
use driver::piped::Program;
use driver::{ScheduledList, Start};
use learner::settings::LearnerSettings;
use plant_sim::obstacles::ObstacleSettings;
use plant_sim::truth::Truth;
use serde::Deserialize;
use settings::{Check, Impossible, SettingsError};
use std::fs;
use std::path::{Path, PathBuf};

/// Longest run \[s\].
pub const DURATION_MAX_S: f64 = 1e4;

/// Contents of a scenario file.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// Description in one sentence.
    pub description: String,
    /// Control period T \[ms\].
    pub period_millis: f64,
    /// Duration of the run \[s\].
    pub duration_s: f64,
    /// Seed of noise and random forces.
    pub seed: u64,
    /// Initial state of the robot.
    pub start: Start,
    /// Reference to follow.
    pub reference: ReferenceSettings,
    /// Goals that are given at their times.
    #[serde(default)]
    pub goals: Vec<Scheduled>,
    /// Settings of the controller.
    pub mpc: MpcSettings,
    /// Settings of the learner.
    pub learner: LearnerSettings,
    /// Parameters that an earlier run of the same robot identified, as initial values:
    /// `identified.toml` of its run directory.
    #[serde(default)]
    pub identified: Option<PathBuf>,
    /// The true world of the simulator, which the controller does not know.
    #[serde(default)]
    pub truth: Option<Truth>,
    /// A world that is another program, instead of the simulator. Its file is relative to the
    /// scenario's. The program defines its own settings.
    #[serde(default)]
    pub world: Option<Program>,
    /// Known obstacles, zones and border: a map file, relative to the scenario's.
    #[serde(default)]
    pub map: Option<PathBuf>,
    /// Obstacles of the simulated world, which the robot's sensor sees.
    #[serde(default)]
    pub obstacles: Option<ObstacleSettings>,
    /// Lists of obstacles that a planner is taken to send at their times.
    #[serde(default)]
    pub lists: Vec<ScheduledList>,
}

/// Directory of the profiles. A world uses those of our own scenarios.
fn profiles(folder: &Path) -> PathBuf {
    let own = folder.join("profiles");
    if own.is_dir() { own } else { folder.join("../../scenarios/profiles") }
}

impl Scenario {
    /// Control period \[ns\].
    pub fn period_nanos(&self) -> u64 {
        (self.period_millis * 1e6).round() as u64
    }
}

impl Scenario {
    /// Reads the scenario with the name `name` in `folder`: `figure-eight`, or
    /// `figure-eight+payload+noise` with variants from `folder/variants`. A profile, if given,
    /// changes it next, and last `changes`, each a line of TOML.
    ///
    /// # Errors
    /// [`SettingsError`] reports the first error.
    pub fn named(
        folder: &Path,
        name: &str,
        profile: Option<&str>,
        changes: &[String],
    ) -> Result<Self, SettingsError> {
        if !name.contains('+') && profile.is_none() && changes.is_empty() {
            return Self::read(&folder.join(name).with_extension("toml"));
        }
        // Line numbers refer to the merged text, which is in no file; the keys show the place.
        let merged = Self::merged(folder, name, profile, changes)?;
        Ok(settings::parse::<Self>(&merged, &folder.join(name))?.located_in(folder))
    }

    /// Reads a scenario file. `figure-eight+payload.toml` is not a file itself, but its parts are.
    ///
    /// # Errors
    /// [`SettingsError`] reports the first error.
    pub fn read(file: &Path) -> Result<Self, SettingsError> {
        let folder = file.parent().unwrap_or(Path::new(""));
        let stem = file.file_stem().map(|stem| stem.to_string_lossy());
        match stem.filter(|stem| stem.contains('+') && !file.exists()) {
            Some(name) => Self::named(folder, &name, None, &[]),
            None => Ok(settings::read::<Self>(file)?.located_in(folder)),
        }
    }

    /// The same with its paths, which are relative to `folder`, resolved.
    fn located_in(mut self, folder: &Path) -> Self {
        if let Some(world) = &mut self.world {
            world.program = folder.join(&world.program);
        }
        if let Some(map) = &mut self.map {
            *map = folder.join(&*map);
        }
        self
    }

    /// The same as one text, unchecked.
    ///
    /// # Errors
    /// [`SettingsError`] if a part of it cannot be read.
    pub fn merged(
        folder: &Path,
        name: &str,
        profile: Option<&str>,
        changes: &[String],
    ) -> Result<String, SettingsError> {
        let mut parts = name.split('+');
        let base = folder.join(parts.next().unwrap_or_default()).with_extension("toml");
        let variants =
            parts.map(|variant| folder.join("variants").join(variant).with_extension("toml"));
        let profile = profile.map(|profile| profiles(folder).join(profile).with_extension("toml"));
        let overlays: Vec<PathBuf> = profile.into_iter().chain(variants).collect();
        let mut whole = table(&base)?;
        for overlay in overlays {
            merge(&mut whole, table(&overlay)?);
        }
        for change in changes {
            let Overlay(change) = settings::parse(change, Path::new("--set"))?;
            merge(&mut whole, change);
        }
        Ok(whole.to_string())
    }

    /// The variants in `folder`, by name.
    pub fn variants(folder: &Path) -> Vec<String> {
        let files = fs::read_dir(folder.join("variants")).into_iter().flatten().flatten();
        let mut names: Vec<String> =
            files.filter_map(|file| Some(file.path().file_stem()?.to_str()?.to_owned())).collect();
        names.sort_unstable();
        names
    }
}

fn table(file: &Path) -> Result<toml::Table, SettingsError> {
    settings::read::<Overlay>(file).map(|Overlay(table)| table)
}

/// A part of a scenario, which is not checked by itself.
#[derive(Deserialize)]
#[serde(transparent)]
struct Overlay(toml::Table);

impl Check for Overlay {
    fn check(&self) -> Result<(), Impossible> {
        Ok(())
    }
}

/// Copies the values of `over` into `table`; tables are merged, all other values are replaced.
fn merge(table: &mut toml::Table, over: toml::Table) {
    for (key, value) in over {
        match (table.get_mut(&key), value) {
            (Some(toml::Value::Table(inner)), toml::Value::Table(over)) => merge(inner, over),
            (_, value) => drop(table.insert(key, value)),
        }
    }
}

impl Check for Scenario {
    fn replaced() -> &'static [(&'static str, &'static str)] {
        &[
            ("truth.wheel_radius_m", "truth.wheels.mecanum.radius_m"),
            ("truth.half_wheelbase_m", "truth.wheels.mecanum.wheelbase_m, twice its value"),
            ("truth.half_track_m", "truth.wheels.mecanum.track_m, twice its value"),
        ]
    }

    fn check(&self) -> Result<(), Impossible> {
        if !(1.0..=1000.0).contains(&self.period_millis) {
            return Err(Impossible::new("period_millis", "1 to 1000 ms"));
        }
        if !(self.duration_s > 0.0 && self.duration_s <= DURATION_MAX_S) {
            return Err(Impossible::new("duration_s", "more than 0 and at most 10000 s"));
        }
        if i64::try_from(self.seed).is_err() {
            return Err(Impossible::new(
                "seed",
                "at most 9223372036854775807, the largest number of TOML",
            ));
        }
        for (key, values) in
            [("start.pose", self.start.pose), ("start.velocity", self.start.velocity)]
        {
            if !is_place(&values) {
                return Err(Impossible::new(
                    key,
                    format!("three numbers of at most {PLACE_MAX}, either way"),
                ));
            }
        }
        self.reference.check().map_err(|impossible| impossible.under("reference"))?;
        // Only a file of points can fail here; the error names the file and the cause.
        Reference::new(&self.reference, &self.start.pose, self.period_millis * 1e-3, 0).map_err(
            |error| {
                Impossible::new(
                    "reference.path.points.file",
                    format!("a usable file of points: {error}"),
                )
            },
        )?;
        schedule::check(&self.goals)?;
        self.mpc.check().map_err(|impossible| impossible.under("mpc"))?;
        self.learner.check().map_err(|impossible| impossible.under("learner"))?;
        if self.learner.resume.as_ref().is_some_and(|file| !file.is_file()) {
            return Err(Impossible::new(
                "learner.resume",
                "the snapshot of an earlier run, but there is no such file",
            ));
        }
        if self.identified.as_ref().is_some_and(|file| !file.is_file()) {
            return Err(Impossible::new(
                "identified",
                "the identified.toml of an earlier run, but there is no such file",
            ));
        }
        if let Some(obstacles) = &self.obstacles {
            obstacles.check().map_err(|impossible| impossible.under("obstacles"))?;
        }
        ScheduledList::check(&self.lists)?;
        if self.truth.is_some() && self.world.is_some() {
            return Err(Impossible::new("world", "nothing beside [truth]: one world at a time"));
        }
        self.truth.as_ref().map_or(Ok(()), Truth::check).map_err(|impossible| {
            Impossible::new(impossible.key, impossible.expected).under("truth")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/scenarios")
    }

    #[test]
    fn every_scenario_with_every_variant_in_every_profile_is_valid() -> Result<(), SettingsError> {
        let named = |path: PathBuf| Some(path.file_stem()?.to_str()?.to_owned());
        let files = fs::read_dir(folder()).into_iter().flatten().flatten();
        let paths = files.map(|file| file.path());
        let bases: Vec<String> = paths
            .filter(|path| path.extension().is_some_and(|it| it == "toml"))
            .filter_map(named)
            .collect();
        assert!(bases.len() > 10, "{bases:?}");
        for base in bases {
            for variant in Scenario::variants(&folder()) {
                for profile in [None, Some("agile")] {
                    Scenario::named(&folder(), &format!("{base}+{variant}"), profile, &[])?;
                }
            }
        }
        Ok(())
    }

    #[test]
    fn a_variant_changes_what_it_names_and_nothing_else() -> Result<(), SettingsError> {
        let base = Scenario::named(&folder(), "figure-eight", None, &[])?;
        let mut soft = Scenario::named(&folder(), "figure-eight+soft", None, &[])?;
        let gain = |scenario: &Scenario| {
            scenario.truth.as_ref().map(|truth| truth.speed_loop_gain_a_s_per_rad)
        };
        assert!(gain(&soft).is_some_and(|gain| (gain - 0.2).abs() < 1e-12));
        soft.truth = base.truth.clone();
        assert_eq!(soft, base);
        let agile = Scenario::named(&folder(), "figure-eight", Some("agile"), &[])?;
        assert_eq!(
            (agile.period_nanos(), agile.mpc.horizon_steps, agile.truth),
            (20_000_000, 20, base.truth)
        );
        Ok(())
    }

    #[test]
    fn changes_of_the_command_line_are_checked_like_a_file() -> Result<(), SettingsError> {
        let named = |change: &str| {
            Scenario::named(&folder(), "figure-eight+soft", Some("agile"), &[change.to_owned()])
        };
        assert!((named("mpc.weights.position = 50.0")?.mpc.weights.position - 50.0).abs() < 1e-12);
        for wrong in ["mpc.weights.position = -1.0", "mpc.weights.positon = 1.0", "mpc.weights"] {
            assert!(named(wrong).is_err(), "{wrong}");
        }
        Ok(())
    }

    #[test]
    fn a_chance_level_that_is_no_probability_is_rejected_with_file_line_and_key()
    -> Result<(), std::io::Error> {
        let text = fs::read_to_string(folder().join("corridor.toml"))?;
        for wrong in ["0.3", "1.0", "95.5", "nan"] {
            let text = text.replace("chance_level = 0.955", &format!("chance_level = {wrong}"));
            let line =
                text.lines().take_while(|line| !line.starts_with("chance_level")).count() + 1;
            let refused = settings::parse::<Scenario>(&text, Path::new("corridor.toml"))
                .err()
                .map(|error| error.to_string());
            let expected = format!(
                "corridor.toml:{line}: mpc.state_limits.chance_level = {wrong}: expected 0.5"
            );
            assert!(
                refused.as_ref().is_some_and(|refused| refused.starts_with(&expected)),
                "{refused:?} does not begin with {expected}"
            );
        }
        Ok(())
    }

    #[test]
    fn a_missing_scenario_or_variant_is_named_in_the_error() {
        for name in ["figure-nine", "figure-eight+tornado"] {
            let refused = Scenario::named(&folder(), name, None, &[])
                .err()
                .map(|error| error.to_string())
                .unwrap_or_default();
            assert!(refused.contains(name.rsplit('+').next().unwrap_or(name)), "{refused}");
        }
    }
}
