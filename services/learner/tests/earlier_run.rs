//! A learner that begins with the data of an earlier run.

use learner::settings::{KernelChoice, LearnerSettings, SnapshotFaults};
use learner::{Settings, run};
use model::learned::Layout;
use model::main_model::{MainModel, fingerprint};
use process::{Run, Stop};
use protocol::message::{Health, ModelSnapshot, ResidualSample};
use robot::Robot;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Duration;
use transport::{Exchange, Identity, Links, Ports, Since, Source};

const EVERY_TICKS: u64 = 5;
const DELAY_TICKS: u64 = 3;

fn settings(folder: &Path, resume: Option<PathBuf>) -> Settings {
    let links = Links::on_this_machine("earlier", folder, true, 5000);
    Settings {
        run: Run { log: "off".into(), ..Run::new(folder, 100_000_000, links) },
        robot: Robot::example(),
        learner: LearnerSettings {
            layout: Layout::VelocitySlip,
            kernel: KernelChoice::LinearPlusSquaredExponential,
            every_ticks: EVERY_TICKS,
            delay_ticks: DELAY_TICKS,
            points_max: 100,
            evaluations_max: 15,
            resume,
        },
        snapshot_faults: SnapshotFaults::default(),
    }
}

/// Sample at `tick` of a robot with this friction, which has the sign of each velocity.
fn sample(tick: u64, friction: f64) -> ResidualSample {
    let wave = |k: f64| (k * tick as f64).sin();
    let mut sample: ResidualSample = bytemuck::Zeroable::zeroed();
    (sample.stamp.tick, sample.plant_epoch, sample.usable) = (tick, 1, 1);
    sample.fingerprint =
        fingerprint(&MainModel::new(&Robot::example(), 0.1), Layout::VelocitySlip.name());
    sample.velocity = [1.5 * wave(0.31), wave(0.23), wave(0.17)];
    sample.input = [
        sample.velocity[0] + 0.3 * wave(0.7),
        sample.velocity[1] + 0.2 * wave(0.9),
        sample.velocity[2] + 0.2 * wave(0.5),
    ];
    sample.residual = std::array::from_fn(|axis| {
        -friction * (4.0 * sample.velocity[axis]).tanh() + 1e-3 * wave(7.3 + axis as f64)
    });
    sample
}

/// Number of points of each model of a run.
fn points(
    folder: &Path,
    resume: Option<PathBuf>,
    ticks: u64,
    friction: f64,
) -> Result<Vec<u32>, Box<dyn Error>> {
    points_of(folder, resume, ticks, |tick| sample(tick, friction))
}

/// The same of any samples.
fn points_of(
    folder: &Path,
    resume: Option<PathBuf>,
    ticks: u64,
    sample: impl Fn(u64) -> ResidualSample,
) -> Result<Vec<u32>, Box<dyn Error>> {
    let settings = settings(folder, resume);
    let exchange = Exchange::new(true, Duration::from_secs(5));
    let ports = Ports::in_memory(&exchange, Identity::new(1));
    let mut snapshots: Source<ModelSnapshot> = ports.source(Since::First)?;
    let mut samples = ports.sink::<ResidualSample>()?;
    let mut health: Source<Health> = ports.source(Since::First)?;
    let stop = Stop::new();
    let (exchange, learner_stop) = (exchange.clone(), stop.clone());
    let learner = thread::spawn(move || {
        run::run(&settings, &Ports::in_memory(&exchange, Identity::new(2)), &learner_stop)
            .map_err(|e| e.to_string())
    });
    // Samples that are sent before it reads are lost.
    while !learner.is_finished() && !health.wait(Duration::from_millis(20))? {}
    let mut points = Vec::new();
    for tick in 0..ticks {
        samples.send(&mut sample(tick))?;
        // Like a controller in lock step, which waits for a snapshot that is due.
        let due = tick >= EVERY_TICKS && (tick + 1) % EVERY_TICKS == DELAY_TICKS;
        while due && !learner.is_finished() && !snapshots.wait(Duration::from_millis(20))? {}
        while let Some(snapshot) = snapshots.next()? {
            points.push(snapshot.head.points);
        }
    }
    stop.request();
    learner.join().map_err(|_| "the learner panicked")??;
    Ok(points)
}

#[test]
fn the_data_of_an_earlier_run_is_kept_until_the_robot_contradicts_it() -> Result<(), Box<dyn Error>>
{
    let (earlier, same, other) = (tempfile::tempdir()?, tempfile::tempdir()?, tempfile::tempdir()?);
    let learnt = points(earlier.path(), None, 100, 0.05)?;
    let kept = *learnt.last().ok_or("nothing was learnt")?;
    let resume = Some(earlier.path().join("snapshot.bin"));
    let same = points(same.path(), resume.clone(), 60, 0.05)?;
    assert!(same.iter().all(|&points| points >= kept), "{same:?} after {kept}");
    let other = points(other.path(), resume, 60, -0.05)?;
    assert!(other.iter().any(|&points| points < kept / 2), "{other:?} after {kept}");
    Ok(())
}

/// The same samples, whose dead time is another one from this tick on \[s\].
fn delayed(tick: u64, from: u64, dead_time_s: f64) -> ResidualSample {
    let dead_time_s = if tick < from { 0.0 } else { dead_time_s };
    ResidualSample { dead_time_s, ..sample(tick, 0.05) }
}

#[test]
fn samples_of_another_dead_time_are_dropped() -> Result<(), Box<dyn Error>> {
    const FROM: u64 = 50;
    let (little, much) = (tempfile::tempdir()?, tempfile::tempdir()?);
    // A fifth of a period is no other dead time.
    let little = points_of(little.path(), None, 80, |tick| delayed(tick, FROM, 0.02))?;
    assert!(little.is_sorted(), "{little:?}");
    let much = points_of(much.path(), None, 80, |tick| delayed(tick, FROM, 0.1))?;
    let before = (FROM / EVERY_TICKS) as usize - 1;
    assert_eq!(much[..before], little[..before]);
    let after = much[before + 1];
    assert!(u64::from(after) <= 2 * EVERY_TICKS, "{after} points, {much:?}");
    Ok(())
}

#[test]
fn another_dead_time_keeps_the_data_of_an_earlier_run() -> Result<(), Box<dyn Error>> {
    let (earlier, later) = (tempfile::tempdir()?, tempfile::tempdir()?);
    let learnt = points(earlier.path(), None, 80, 0.05)?;
    let kept = *learnt.last().ok_or("nothing was learnt")?;
    let resume = Some(earlier.path().join("snapshot.bin"));
    // Before the set is full, so that no sample has displaced an earlier one.
    let later = points_of(later.path(), resume, 60, |tick| delayed(tick, 8, 0.1))?;
    assert!(later.iter().all(|&points| points >= kept), "{later:?} after {kept}");
    Ok(())
}
