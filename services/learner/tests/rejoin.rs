//! A learner that restarts while the clock of lock step stands still.

use learner::settings::{KernelChoice, LearnerSettings, SnapshotFaults};
use learner::{Settings, run};
use model::learned::Layout;
use model::main_model::{MainModel, fingerprint};
use process::{Run, Stop};
use protocol::message::{ModelSnapshot, ResidualSample};
use robot::Robot;
use std::error::Error;
use std::thread;
use std::time::Duration;
use transport::{Exchange, Identity, Links, Ports, Since, Source};

/// Effective ticks of the snapshots that a restarted learner without data publishes, when its first
/// sample has this tick.
fn published_on_joining(
    tick: u64,
    every_ticks: u64,
    delay_ticks: u64,
    expected: usize,
) -> Result<Vec<u64>, Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let exchange = Exchange::new(true, Duration::from_secs(5));
    let links = Links::on_this_machine("rejoin", folder.path(), true, 5000);
    let settings = Settings {
        run: Run {
            log: "off".into(),
            epoch_floor: 1,
            restarted: true,
            ..Run::new(folder.path(), 100_000_000, links)
        },
        robot: Robot::example(),
        learner: LearnerSettings {
            layout: Layout::VelocitySlip,
            kernel: KernelChoice::LinearPlusSquaredExponential,
            every_ticks,
            delay_ticks,
            points_max: 20,
            evaluations_max: 5,
            resume: None,
        },
        snapshot_faults: SnapshotFaults::default(),
    };
    let ports = Ports::in_memory(&exchange, Identity::new(1));
    let mut snapshots: Source<ModelSnapshot> = ports.source(Since::First)?;
    let mut samples = ports.sink::<ResidualSample>()?;
    let mut sample: ResidualSample = bytemuck::Zeroable::zeroed();
    (sample.stamp.tick, sample.plant_epoch, sample.usable) = (tick, 1, 1);
    sample.fingerprint =
        fingerprint(&MainModel::new(&Robot::example(), 0.1), Layout::VelocitySlip.name());
    samples.send(&mut sample)?;

    let stop = Stop::new();
    let (exchange, learner_stop) = (exchange.clone(), stop.clone());
    let learner = thread::spawn(move || {
        run::run(&settings, &Ports::in_memory(&exchange, Identity::new(2)), &learner_stop)
            .map_err(|e| e.to_string())
    });
    let mut effective = Vec::new();
    while effective.len() < expected && !learner.is_finished() {
        snapshots.wait(Duration::from_millis(20))?;
        while let Some(snapshot) = snapshots.next()? {
            effective.push(snapshot.head.effective_tick);
        }
    }
    stop.request();
    learner.join().map_err(|_| "the learner panicked")??;
    Ok(effective)
}

#[test]
fn every_model_that_is_still_due_is_published_even_without_data() -> Result<(), Box<dyn Error>> {
    assert_eq!(published_on_joining(12, 5, 3, 1)?, [13], "the cut at 10 is due at 13");
    assert_eq!(published_on_joining(16, 5, 8, 2)?, [18, 23], "the cuts at 10 and 15");
    Ok(())
}
