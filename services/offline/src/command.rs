//! `coxswain learn`: logs → snapshot.

use crate::cross_validation::STEPS;
use crate::periods::passages;
use crate::verdict::{Verdict, WORSE_MAX};
use crate::work::Work;
use clap::Args;
use graph::assembly::{Assembly, robot_of};
use graph::first_model;
use graph::options::Options;
use identify::command::{IdentifyError, check_speed};
use identify::log::bag::Topics;
use identify::log::{Log, LogError};
use learner::fit::FailedFit;
use learner::store::{self, StoreError};
use model::learned::{INPUTS, INPUTS_WITH_HEADING, INPUTS_WITH_HISTORY, INPUTS_WITH_PLACE};
use model::main_model::MainModel;
use process::Run;
use protocol::frame::DecodeError;
use protocol::message::ModelSnapshot;
use settings::SettingsError;
use std::path::{Path, PathBuf};
use terminal::Terminal;

/// Logs, the robot, and the file of the snapshot.
#[derive(Debug, Clone, Args)]
pub struct LearnOptions {
    /// Records, run directories, or tables (.csv) of one robot.
    #[arg(value_name = "LOG", required = true)]
    pub logs: Vec<PathBuf>,
    /// What is read of ROS 2 bags.
    #[command(flatten)]
    pub topics: Topics,
    /// Graph file: its robot, and the period and the learner of its scenario.
    #[arg(long, value_name = "GRAPH")]
    pub graph: PathBuf,
    /// Another scenario: a file, or the name of one beside the graph's own.
    #[arg(long, value_name = "FILE|NAME")]
    pub scenario: Option<PathBuf>,
    /// Another robot file.
    #[arg(long, value_name = "FILE")]
    pub robot: Option<PathBuf>,
    /// A snapshot whose data is carried over, if held-out motion shows that it helps. It must not
    /// come from these logs.
    #[arg(long, value_name = "SNAPSHOT")]
    pub from: Option<PathBuf>,
    /// The robot file that this snapshot was learned for, if it is another one.
    #[arg(long, value_name = "FILE", requires = "from")]
    pub from_robot: Option<PathBuf>,
    /// The snapshot.
    #[arg(long, value_name = "FILE")]
    pub to: PathBuf,
}

/// Why no snapshot was written.
#[derive(Debug, thiserror::Error)]
pub enum LearnError {
    /// A file cannot be used.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// A log cannot be used.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The log has other units than the robot file.
    #[error(transparent)]
    Speed(#[from] IdentifyError),
    /// The log has another period than the scenario.
    #[error(
        "the log has a period of {found_s:.4} s: expected {expected_s:.4} s, as the scenario has; \
         give one with that period by --scenario"
    )]
    Period {
        /// Of the log \[s\].
        found_s: f64,
        /// Of the scenario \[s\].
        expected_s: f64,
    },
    /// The log is that of another robot.
    #[error(
        "{:.0} % of the samples differ from the main model by more than is plausible: expected the \
         robot of the robot file",
        100.0 * share
    )]
    OtherRobot {
        /// Share of these samples.
        share: f64,
    },
    /// The fit failed.
    #[error(transparent)]
    Fit(#[from] FailedFit),
    /// The learned model predicts no better.
    #[error(
        "the learned model is no better than the main model, both with an observer: errors {:.3} \
         (1 step) and {:.3} ({STEPS} steps) times as large on average, {:.3} ({STEPS} steps) on \
         the worst axis; expected below 1 on average, and at most {WORSE_MAX} on each axis",
        .0.means()[0], .0.means()[1], .0.worst()
    )]
    NoBetter(Verdict),
    /// The snapshot cannot be made.
    #[error(transparent)]
    Snapshot(#[from] DecodeError),
    /// The snapshot cannot be written.
    #[error(transparent)]
    Write(#[from] StoreError),
}

impl LearnError {
    /// 1 if the model is no better or the system reports a write error, else 2.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::NoBetter(_) | Self::Fit(_) | Self::Snapshot(_) | Self::Write(_) => 1,
            _ => 2,
        }
    }
}

/// Trains a model from the logs of `options`, prints its errors beside those of simpler models, and
/// writes its snapshot.
///
/// # Errors
/// [`LearnError`]; no file was written then.
pub fn learn(options: &LearnOptions) -> Result<(), LearnError> {
    let assembly =
        read_graph(&options.graph, options.scenario.as_deref(), options.robot.as_deref())?;
    let run = offline_run(&assembly);
    let (learner, controller) = (assembly.learner(run.clone()), assembly.controller(run));
    let log = Log::read(&options.logs, &options.topics)?;
    log.check()?;
    check_speed(&log, &assembly.robot)?;
    check_period(&log, &assembly)?;
    let mut terminal = Terminal::new();
    for note in &log.notes {
        terminal.say(format_args!("learn: {note}"));
    }
    let passages = passages(&log, &controller);
    let earlier = earlier(options, &assembly)?;
    let work = Work {
        learner: &learner,
        controller: &controller,
        passages: &passages,
        earlier: earlier.as_ref(),
    };
    let snapshot = match learner.learner.layout.dimension() {
        INPUTS_WITH_HEADING => work.snapshot::<INPUTS_WITH_HEADING>(),
        INPUTS_WITH_HISTORY => work.snapshot::<INPUTS_WITH_HISTORY>(),
        INPUTS_WITH_PLACE => work.snapshot::<INPUTS_WITH_PLACE>(),
        _ => work.snapshot::<INPUTS>(),
    }?;
    store::save(&options.to, &snapshot)?;
    terminal::print(format_args!(
        "{}: {} points of {:.1} s",
        options.to.display(),
        snapshot.head.points,
        log.duration_s()
    ));
    Ok(())
}

/// The files of a graph. Nothing is launched, so nothing can be reached from the network.
pub(crate) fn read_graph(
    graph: &Path,
    scenario: Option<&Path>,
    robot: Option<&Path>,
) -> Result<Assembly, SettingsError> {
    Assembly::read(&Options {
        scenario: scenario.map(Path::to_owned),
        robot: robot.map(Path::to_owned),
        insecure: true,
        ..Options::of_graph(graph)
    })
}

/// Settings of a run that has no files and no links of its own.
pub(crate) fn offline_run(assembly: &Assembly) -> Run {
    let links = assembly.links("offline", Path::new(""));
    Run::new("", assembly.scenario.period_nanos(), links)
}

/// The snapshot to carry over, and the main model that it was learned with.
fn earlier(
    options: &LearnOptions,
    assembly: &Assembly,
) -> Result<Option<(ModelSnapshot, MainModel)>, SettingsError> {
    let Some(file) = &options.from else { return Ok(None) };
    let mut assembly = assembly.clone();
    if let Some(robot) = &options.from_robot {
        assembly.robot = robot_of(robot)?;
    }
    let snapshot = first_model::read(file, &assembly)?;
    let period_s = assembly.scenario.period_nanos() as f64 * 1e-9;
    Ok(Some((snapshot, MainModel::new(&assembly.robot, period_s))))
}

fn check_period(log: &Log, assembly: &Assembly) -> Result<(), LearnError> {
    let expected_s = 1e-3 * assembly.scenario.period_millis;
    if (log.period_s - expected_s).abs() > 1e-3 * expected_s {
        return Err(LearnError::Period { found_s: log.period_s, expected_s });
    }
    Ok(())
}
