//! The same run without learning, for comparison on the live page: in lock step and in this
//! process, before the run begins.

use crate::in_process::{self, InProcessError};
use controller::settings::Identify;
use gateway::comparison::{self, Row};
use graph::assembly::Assembly;
use graph::faults::FaultsFile;
use process::{Pace, Pulse, Stop};
use protocol::message::{Participant, Phase, Plan};
use std::path::{Path, PathBuf};
use std::time::Duration;
use transport::{OpenError, Ports, ReceiveError, Since, Source};

/// Longest compared part of the run \[s\].
const LONGEST_S: f64 = 30.0;
/// The same in periods: about a second of computation.
const PERIODS_MAX: f64 = 1500.0;
/// Interval between checks of the stop request by the witness.
const PATIENCE: Duration = Duration::from_millis(5);
/// Name of its file in the run directory.
const FILE: &str = "without-learning.csv";

/// Why there is no comparison.
#[derive(Debug, thiserror::Error)]
pub enum WithoutLearningError {
    /// The loop failed.
    #[error(transparent)]
    Loop(#[from] InProcessError),
    /// The witness could not open its links.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// The witness could not receive.
    #[error(transparent)]
    Receive(#[from] ReceiveError),
    /// Its file cannot be written.
    #[error("{}: {source}", file.display())]
    File {
        /// The file.
        file: PathBuf,
        /// Cause.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}

/// Whether the live page is on, the run learns, and its world can be simulated twice.
pub fn is_wanted(assembly: &Assembly) -> bool {
    let is_shown = matches!(assembly.graph.page.address(), Ok(Some(_)));
    let needed =
        [Participant::Plant, Participant::Controller, Participant::Learner, Participant::Gateway];
    let enabled = needed.into_iter().all(|role| assembly.graph.processes.of(role).enabled);
    let is_simulated = assembly.graph.driver.is_none();
    is_shown && enabled && is_simulated && assembly.graph.pace == Pace::RealTime
}

/// Runs `assembly` without its learner and its faults, and writes the result into `folder`. Returns
/// the file.
///
/// # Errors
/// [`WithoutLearningError`].
pub fn run(assembly: &Assembly, folder: &Path) -> Result<PathBuf, WithoutLearningError> {
    let mut alone = assembly.clone();
    alone.graph.pace = Pace::LockStep;
    alone.graph.processes.learner.enabled = false;
    alone.learns_elsewhere = false;
    alone.scenario.mpc.identify = Identify::Off;
    alone.graph.processes.recorder.enabled = false;
    alone.scenario.learner.resume = None;
    alone.scenario.identified = None;
    alone.faults = FaultsFile::default();
    let longest = LONGEST_S.min(PERIODS_MAX * alone.scenario.period_millis * 1e-3);
    alone.scenario.duration_s = alone.scenario.duration_s.min(longest);
    let rows = in_process::drive(&alone, folder, |ports, _, stop| witness(ports, stop))??;
    let file = folder.join(FILE);
    comparison::write(&file, &rows).map_err(|source| WithoutLearningError::File {
        file: file.clone(),
        source: source.into(),
    })?;
    Ok(file)
}

/// Receives instead of the recorder, and stores the positions of the robot.
fn witness(ports: &Ports, stop: &Stop) -> Result<Vec<Row>, WithoutLearningError> {
    let mut pulse = Pulse::new(ports, Participant::Recorder)?;
    let mut plans: Source<Plan> = ports.source(Since::First)?;
    pulse.phase(Phase::Ready);
    let mut rows = Vec::new();
    loop {
        let ending = stop.requested();
        while let Some(plan) = plans.next()? {
            let [[x_m, y_m, ..], ..] = plan.predicted;
            rows.push(Row { tick: plan.stamp.tick, x_m, y_m, error_m: plan.position_error() });
        }
        if ending {
            return Ok(rows);
        }
        plans.wait(PATIENCE)?;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use graph::options::Options;

    fn local() -> Result<Assembly, settings::SettingsError> {
        Assembly::read(&Options::of_graph(
            &Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/graphs/local.toml"),
        ))
    }

    #[test]
    fn the_paper_without_learning_keeps_an_offset_and_every_period_is_recorded()
    -> Result<(), Box<dyn std::error::Error>> {
        let folder = tempfile::tempdir()?;
        let mut assembly = local()?;
        assembly.scenario.duration_s = 6.0;
        let rows = comparison::read(&run(&assembly, folder.path())?)?;
        assert_eq!(
            rows.iter().map(|row| row.tick).collect::<Vec<_>>(),
            (0..rows.len() as u64).collect::<Vec<_>>()
        );
        assert!((60..=61).contains(&rows.len()), "{}", rows.len());
        assert!(rows.iter().skip(30).all(|row| row.error_m > 0.03), "{rows:?}");
        Ok(())
    }

    #[test]
    fn only_a_real_time_run_with_learning_and_live_page_is_compared()
    -> Result<(), settings::SettingsError> {
        let wanted_with = |change: fn(&mut Assembly)| {
            let mut assembly = local()?;
            change(&mut assembly);
            Ok::<_, settings::SettingsError>(is_wanted(&assembly))
        };
        assert!(wanted_with(|_| {})?);
        for change in [
            (|assembly| assembly.graph.pace = Pace::LockStep) as fn(&mut Assembly),
            |assembly| assembly.graph.processes.learner.enabled = false,
            |assembly| assembly.graph.processes.gateway.enabled = false,
            |assembly| assembly.graph.processes.plant.enabled = false,
            |assembly| assembly.graph.page.listen = "off".into(),
        ] {
            assert!(!wanted_with(change)?);
        }
        Ok(())
    }
}
