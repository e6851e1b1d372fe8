//! `coxswain experiment`: compares controllers in scenarios, with the code of the real processes.
//!
//! | file          | what it holds                                             |
//! |---------------|-----------------------------------------------------------|
//! | `cases`       | the requested scenarios, with all that each needs         |
//! | `contender`   | the controllers that are compared                         |
//! | `calibration` | the share of samples in the learner's 95 % interval       |
//! | `figure`      | the figures of a row, and how they are printed            |
//! | `oracle`      | the simulator's own dynamics as a controller's model      |
//! | `trial`       | one closed loop, and its row                              |
//! | `parallel`    | many runs, as many at a time as there are processors      |
//! | `poison`      | deliberate faults in a trial's messages                   |
//! | `table`       | rows → the table that is printed                          |
//! | `in_process`  | the whole graph in one process, in lock step              |
//! | `worlds`      | to a goal among obstacles, in seeded worlds               |
//! | `without_learning` | a run without learning, for the live page            |

mod calibration;
mod cases;
pub mod contender;
pub mod figure;
pub mod in_process;
pub mod oracle;
mod parallel;
pub mod poison;
mod table;
pub mod trial;
pub mod without_learning;
pub mod worlds;

use cases::Cases;
use contender::Contender;
use figure::Figure;
use poison::Poison;
use settings::SettingsError;
use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::{fs, io};
use terminal::Terminal;
use trial::{Row, Start, TrialError};

pub use cases::Belief;

/// Compared if no other scenarios are requested.
const SCENARIOS: [&str; 3] = ["figure-eight", "square", "stop-and-go"];

/// Seed of the run in which a warm start has learned; no trial has it.
const TEACHING_SEED: u64 = 1_000_003;

/// What to compare.
#[derive(Debug, Clone, clap::Args)]
pub struct CompareOptions {
    /// Scenarios: names, with variants as in figure-eight+payload; figure-eight+* is the scenario
    /// with each of its variants. In another world: robot+reference+condition. Each part may be *,
    /// and trailing parts may be omitted. The default is all.
    #[arg(long, value_delimiter = ',')]
    pub scenarios: Vec<String>,
    /// Compare in another world: the name of a folder in deploy/worlds, as mujoco, or its path.
    #[arg(long, value_name = "NAME")]
    pub world: Option<String>,
    /// Variants that are added to every scenario, as noise.
    #[arg(long, value_delimiter = ',', value_name = "NAME")]
    pub variants: Vec<String>,
    /// Measure without noise. Otherwise every scenario has the noise of the variant `noise`; every
    /// scenario of another world has noise.
    #[arg(long, conflicts_with = "world")]
    pub exact_sensors: bool,
    /// Multiply a number of the robot file for the controllers only, as body.mass_kg=2 for a
    /// doubled mass; may be repeated.
    #[arg(long = "believe", value_name = "KEY=FACTOR")]
    pub beliefs: Vec<Belief>,
    /// Controllers to compare; all of them if none is named.
    #[arg(long, value_delimiter = ',')]
    pub controllers: Vec<Contender>,
    /// Number of seeds, from 1 on.
    #[arg(
        long,
        value_name = "N",
        default_value_t = 10,
        value_parser = clap::value_parser!(u64).range(1..=1000)
    )]
    pub seeds: u64,
    /// What is known at the start: nothing, what an earlier run has learned and identified, or what
    /// a run of another variant has.
    #[arg(long, value_delimiter = ',', default_value = "cold")]
    pub start: Vec<Start>,
    /// paper (T = 100 ms, N = 5) or a file of deploy/scenarios/profiles, as agile (T = 20 ms, N =
    /// 20).
    #[arg(long, default_value = "paper")]
    pub profile: String,
    /// A deliberate fault in every trial, but not in the runs that prepare a warm or stale start.
    #[arg(long)]
    pub poison: Option<Poison>,
    /// Figures to print, one table each.
    #[arg(long, value_delimiter = ',', default_value = "position-rmse")]
    pub figures: Vec<Figure>,
    /// Change every scenario by a line of TOML, as mpc.observer_gain=0.3; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub changes: Vec<String>,
    /// Write one JSON row per trial to this file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// A short comparison, in less than a minute: the three dynamic scenarios, 3 seeds, 12 s.
    #[arg(long)]
    pub quick: bool,
    /// Graph file whose robot and scenarios are used.
    #[arg(long, value_name = "FILE", default_value = "deploy/graphs/local.toml")]
    pub graph: PathBuf,
}

/// Why a comparison was not made.
#[derive(Debug, thiserror::Error)]
pub enum ExperimentError {
    /// A setting in a file is impossible.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// A file or folder cannot be used.
    #[error("{}: {source}", path.display())]
    File {
        /// Its path.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// The scenario of a trial was not read.
    #[error("there is no scenario {scenario}")]
    NoCase {
        /// Name of the scenario.
        scenario: String,
    },
    /// No scenario is left.
    #[error("no scenario of the world {world} has a name like {asked}")]
    NothingToCompare {
        /// The world that was searched.
        world: String,
        /// The requested scenarios.
        asked: String,
    },
    /// A world failed.
    #[error("world {seed}: {source}")]
    World {
        /// Its seed.
        seed: u64,
        /// Its error.
        source: Box<worlds::WorldError>,
    },
    /// A trial failed.
    #[error("{trial}: {source}")]
    Trial {
        /// Name of the trial.
        trial: String,
        /// Its error.
        source: Box<TrialError>,
    },
}

impl ExperimentError {
    /// 2 if a setting of the user prevented the start, else 1.
    pub fn exit_code(&self) -> u8 {
        if matches!(self, Self::Settings(_)) { 2 } else { 1 }
    }
}

/// One trial to be run.
#[derive(Debug, Clone)]
struct Trial {
    scenario: String,
    contender: Contender,
    start: Start,
    seed: u64,
}

impl Trial {
    fn name(&self) -> String {
        format!("{} {} {} seed {}", self.scenario, self.contender, self.start, self.seed)
    }
}

/// Runs every trial, shows progress, writes the rows and prints the table.
///
/// # Errors
/// [`ExperimentError`]; no trial runs if a setting is impossible.
pub fn compare(options: &CompareOptions) -> Result<(), ExperimentError> {
    let bench = Bench::new(options)?;
    let trials = bench.trials(options);
    let mut json = options.json.as_deref().map(create).transpose()?;
    let home = std::env::temp_dir().join(format!("coxswain-experiment-{}", std::process::id()));
    let swept = Swept(home.clone());
    let lessons: BTreeSet<(String, Contender)> =
        trials.iter().filter_map(|trial| bench.lesson(trial)).collect();
    let mut terminal = Terminal::new();
    let lessons: Vec<Trial> = lessons
        .into_iter()
        .map(|(scenario, contender)| Trial {
            scenario,
            contender,
            start: Start::Cold,
            seed: TEACHING_SEED,
        })
        .collect();
    let taught =
        bench.run_all(&lessons, &home, &BTreeMap::new(), &mut terminal, "learning", |_| Ok(()))?;
    let schools: BTreeMap<(String, Contender), PathBuf> = lessons
        .iter()
        .zip(taught)
        .map(|(lesson, (folder, _))| ((lesson.scenario.clone(), lesson.contender), folder))
        .collect();
    let rows =
        bench.run_all(
            &trials,
            &home,
            &schools,
            &mut terminal,
            "trials",
            |row| match &mut json {
                Some((path, file)) => {
                    let line = serde_json::to_string(row).map_err(io::Error::other);
                    line.and_then(|line| writeln!(file, "{line}"))
                        .map_err(|source| ExperimentError::File { path: path.clone(), source })
                }
                None => Ok(()),
            },
        )?;
    drop(swept);
    let rows: Vec<Row> = rows.into_iter().map(|(_, row)| row).collect();
    for figure in &options.figures {
        terminal::print(table::render(&rows, *figure));
    }
    Ok(())
}

fn create(path: &Path) -> Result<(PathBuf, fs::File), ExperimentError> {
    let file = fs::File::create(path)
        .map_err(|source| ExperimentError::File { path: path.to_path_buf(), source })?;
    Ok((path.to_path_buf(), file))
}

/// Removes the folder of the trials in every case.
struct Swept(PathBuf);

impl Drop for Swept {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// Everything that trials share.
struct Bench {
    cases: Cases,
    profile: String,
    duration_s: Option<f64>,
    poison: Option<Poison>,
}

impl Bench {
    fn new(options: &CompareOptions) -> Result<Self, ExperimentError> {
        Ok(Self {
            cases: Cases::read(options)?,
            profile: options.profile.clone(),
            duration_s: options.quick.then_some(12.0),
            poison: options.poison,
        })
    }

    fn trials(&self, options: &CompareOptions) -> Vec<Trial> {
        let contenders = if options.controllers.is_empty() {
            Contender::ALL.to_vec()
        } else {
            options.controllers.clone()
        };
        let seeds = if options.quick { options.seeds.min(3) } else { options.seeds };
        let only_taught: BTreeSet<&String> =
            self.cases.other.values().filter(|it| !self.cases.other.contains_key(*it)).collect();
        let mut trials = Vec::new();
        for scenario in self.cases.assemblies.keys().filter(|name| !only_taught.contains(name)) {
            for &start in &options.start {
                for &contender in &contenders {
                    // A contender without memory starts the same way every time.
                    if !contender.remembers() && options.start.first() != Some(&start) {
                        continue;
                    }
                    trials.extend((1..=seeds).map(|seed| Trial {
                        scenario: scenario.clone(),
                        contender,
                        start,
                        seed,
                    }));
                }
            }
        }
        trials
    }

    /// The earlier run that `trial` needs.
    fn lesson(&self, trial: &Trial) -> Option<(String, Contender)> {
        let scenario = match trial.start {
            _ if !trial.contender.remembers() => None,
            Start::Cold => None,
            Start::Warm => Some(&trial.scenario),
            Start::Stale => self.cases.other.get(&trial.scenario),
        };
        scenario.map(|scenario| (scenario.clone(), trial.contender))
    }

    /// Runs `trials`, as many at a time as there are processors. Returns their folders and rows in
    /// the same order.
    fn run_all(
        &self,
        trials: &[Trial],
        home: &Path,
        schools: &BTreeMap<(String, Contender), PathBuf>,
        terminal: &mut Terminal,
        what: &str,
        mut each: impl FnMut(&Row) -> Result<(), ExperimentError>,
    ) -> Result<Vec<(PathBuf, Row)>, ExperimentError> {
        parallel::run_all(
            trials,
            terminal,
            what,
            |index, trial| {
                let folder = home.join(format!("{what}-{index}"));
                self.run(trial, &folder, schools).map(|row| (folder, row))
            },
            |(_, row)| each(row),
        )
    }

    fn run(
        &self,
        trial: &Trial,
        folder: &Path,
        schools: &BTreeMap<(String, Contender), PathBuf>,
    ) -> Result<Row, ExperimentError> {
        let Some(case) = self.cases.assemblies.get(&trial.scenario) else {
            return Err(ExperimentError::NoCase { scenario: trial.scenario.clone() });
        };
        let mut assembly = case.clone();
        assembly.graph.pace = process::Pace::LockStep;
        assembly.graph.processes.recorder.enabled = false;
        assembly.scenario.seed = trial.seed;
        assembly.scenario.duration_s = self.duration_s.unwrap_or(assembly.scenario.duration_s);
        trial.contender.take_over(&mut assembly);
        let school = self.lesson(trial).and_then(|lesson| schools.get(&lesson));
        let file = |is_used: bool, name| {
            school.filter(|_| is_used).map(|folder: &PathBuf| folder.join(name))
        };
        assembly.scenario.learner.resume = file(trial.contender.learns(), "snapshot.bin");
        assembly.scenario.identified = file(trial.contender.identifies(), "identified.toml");
        fs::create_dir_all(folder)
            .map_err(|source| ExperimentError::File { path: folder.to_path_buf(), source })?;
        let poison = self.poison.filter(|_| trial.seed != TEACHING_SEED);
        if let Some(poison) = poison {
            assembly.faults =
                poison.faults(trial.seed, assembly.scenario.period_millis * 1e-3).into();
        }
        let label = (trial.scenario.as_str(), self.profile.as_str(), trial.contender, trial.start);
        let row = trial::run(&assembly, folder, label).map(|row| Row { poison, ..row });
        row.map_err(|source| ExperimentError::Trial {
            trial: trial.name(),
            source: Box::new(source),
        })
    }
}
