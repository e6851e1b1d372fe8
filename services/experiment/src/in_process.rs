//! The whole graph in one process, over memory, in lock step: the same code as in the processes,
//! each on a thread of its own.
//!
//! Its results are the same bits as those of the processes, without their start-up time. Files go
//! to the same places of the run directory.

use crate::oracle::Oracle;
use controller::settings::Method;
use graph::assembly::Assembly;
use graph::scenario::Scenario;
use model::foresight::Foresight;
use process::{Run, Stop};
use protocol::message::{Health, Participant, Phase};
use recorder::summary::Summary;
use std::path::Path;
use std::thread::{self, ScopedJoinHandle};
use std::time::Duration;
use transport::{Exchange, Identity, OpenError, Ports, Since, Source};

/// Longest wait of a writer for a reader that does not read.
const PATIENCE: Duration = Duration::from_secs(10);
/// Interval between two checks whether a thread has ended.
const ROUND: Duration = Duration::from_millis(1);

/// Why the graph did not finish.
#[derive(Debug, thiserror::Error)]
pub enum InProcessError {
    /// Error of the plant.
    #[error("plant: {0}")]
    Plant(#[from] driver::RunError),
    /// Error of the controller.
    #[error("controller: {0}")]
    Controller(#[from] controller::run::RunError),
    /// Error of the learner.
    #[error("learner: {0}")]
    Learner(#[from] learner::run::RunError),
    /// Error of the recorder.
    #[error("recorder: {0}")]
    Recorder(#[from] recorder::run::RecorderError),
    /// Error of a port.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// A thread ended with a panic.
    #[error("the thread of the {0} has died")]
    Died(&'static str),
}

/// Runs `assembly` to its end in lock step, records it, and returns the summary. `folder` must
/// exist and be empty.
///
/// # Errors
/// [`InProcessError`].
pub fn run(assembly: &Assembly, folder: &Path) -> Result<Summary, InProcessError> {
    drive(assembly, folder, |ports, run, stop| {
        recorder::run::run(ports, &recorder::settings::Settings { run: run.clone() }, stop)
    })?
    .map_err(InProcessError::from)
}

/// Runs `assembly` to its end in lock step, while `witness` receives on a thread of its own. The
/// witness replaces the recorder: it reports by its Health that it is ready, and stops on request.
/// Returns the result of the witness.
///
/// # Errors
/// [`InProcessError`].
pub fn drive<W: Send>(
    assembly: &Assembly,
    folder: &Path,
    witness: impl FnOnce(&Ports, &Run, &Stop) -> W + Send,
) -> Result<W, InProcessError> {
    let exchange = Exchange::new(true, PATIENCE);
    let mut links = assembly.links("in-process", folder);
    links.lock_step = true;
    let run = Run {
        log: assembly.log.clone(),
        ..Run::new(folder, assembly.scenario.period_nanos(), links)
    };
    let identity = || Identity::new(1);
    let ports = |role, identity| {
        Ports::in_memory_with(&exchange, identity, &assembly.faults.of_messages().in_process(role))
    };
    let (others, record) = (Stop::new(), Stop::new());
    let mut ready =
        Ready { healths: Ports::in_memory(&exchange, identity()).source(Since::First)? };
    thread::scope(|scope| {
        let recorder = {
            let (run, stop) = (run.clone(), record.clone());
            scope.spawn(move || witness(&ports(Participant::Recorder, identity()), &run, &stop))
        };
        ready.wait_for(Participant::Recorder, || recorder.is_finished());
        let learner = assembly.learns().then(|| {
            let (settings, stop) = (assembly.learner(run.clone()), others.clone());
            scope.spawn(move || {
                learner::run::run(&settings, &ports(Participant::Learner, identity()), &stop)
            })
        });
        if let Some(learner) = &learner {
            ready.wait_for(Participant::Learner, || learner.is_finished());
        }
        let controller = {
            let (settings, foresight, stop) =
                (assembly.controller(run.clone()), foresight(assembly), others.clone());
            let connect = move |identity| Ok(ports(Participant::Controller, identity));
            scope.spawn(move || {
                controller::run::run_foreseeing(&settings, foresight, connect, &stop)
            })
        };
        ready.wait_for(Participant::Controller, || controller.is_finished());
        let plant = {
            let (settings, stop) = (assembly.plant(run.clone()), others.clone());
            let identity = identity();
            scope.spawn(move || {
                plant_sim::run(&settings, &ports(Participant::Plant, identity), identity, &stop)
            })
        };
        let one_has_ended = || {
            controller.is_finished()
                || recorder.is_finished()
                || learner.as_ref().is_some_and(ScopedJoinHandle::is_finished)
        };
        while !plant.is_finished() && !one_has_ended() {
            thread::sleep(ROUND);
        }
        others.request();
        let plant = plant.join();
        let controller = controller.join();
        let learner = learner.map(ScopedJoinHandle::join);
        // All threads are requested to stop before the first error is returned.
        record.request();
        let witnessed = recorder.join().map_err(|_| InProcessError::Died("recorder"))?;
        controller.map_err(|_| InProcessError::Died("controller"))??;
        if let Some(learner) = learner {
            learner.map_err(|_| InProcessError::Died("learner"))??;
        }
        plant.map_err(|_| InProcessError::Died("plant"))??;
        Ok(witnessed)
    })
}

/// Future knowledge, for a controller that is an oracle.
fn foresight(assembly: &Assembly) -> Option<Box<dyn Foresight>> {
    let Scenario { truth, mpc, .. } = &assembly.scenario;
    let truth = truth.as_ref().filter(|_| mpc.method == Method::Oracle)?;
    Some(Box::new(Oracle::new(truth, assembly.scenario.period_nanos())))
}

/// Receives which participants are ready.
struct Ready {
    healths: Source<Health>,
}

impl Ready {
    /// Waits until `participant` reports that it is ready, or has ended.
    fn wait_for(&mut self, participant: Participant, ended: impl Fn() -> bool) {
        while !ended() {
            while let Ok(Some(health)) = self.healths.next() {
                if health.participant() == Some(participant) && health.phase() >= Phase::Ready {
                    return;
                }
            }
            thread::sleep(ROUND);
        }
    }
}
