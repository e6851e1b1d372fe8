//! Promises of a comparison:
//!
//! - The same seed gives the same bits, independent of concurrent trials.
//! - A start with learned results is better.
//! - A chance level keeps the robot in its corridor.

use controller::settings::Identify;
use experiment::contender::Contender;
use experiment::poison::Poison;
use experiment::trial::{self, Row, Start};
use graph::assembly::Assembly;
use graph::options::Options;
use graph::scenario::Scenario;
use process::Pace;
use std::error::Error;
use std::path::{Path, PathBuf};
use std::thread;

type Outcome = Result<(), Box<dyn Error>>;

fn deploy() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy")
}

fn assembly(scenario: &str, contender: Contender, seed: u64) -> Result<Assembly, Box<dyn Error>> {
    let mut assembly = Assembly::read(&Options::of_graph(&deploy().join("graphs/local.toml")))?;
    assembly.scenario = Scenario::named(&deploy().join("scenarios"), scenario, None, &[])?;
    assembly.graph.pace = Pace::LockStep;
    assembly.graph.processes.recorder.enabled = false;
    (assembly.scenario.seed, assembly.scenario.duration_s) = (seed, 8.0);
    contender.take_over(&mut assembly);
    Ok(assembly)
}

fn run(
    assembly: &Assembly,
    contender: Contender,
    start: Start,
    folder: &Path,
) -> Result<Row, Box<dyn Error>> {
    let row = trial::run(assembly, folder, ("figure-eight", "paper", contender, start))?;
    // The tick times depend on the machine.
    Ok(Row { tick_p50_us: None, tick_p99_us: None, ..row })
}

#[test]
fn the_same_seed_gives_the_same_figures_alone_and_beside_others() -> Outcome {
    for contender in Contender::ALL {
        let assembly = assembly("figure-eight+weak-motor", contender, 3)?;
        let alone = run(&assembly, contender, Start::Cold, tempfile::tempdir()?.path())?;
        let beside = thread::scope(|scope| {
            let trial = || -> Result<Row, String> {
                let folder = tempfile::tempdir().map_err(|error| error.to_string())?;
                run(&assembly, contender, Start::Cold, folder.path())
                    .map_err(|error| error.to_string())
            };
            let trials = [scope.spawn(trial), scope.spawn(trial)];
            trials.map(|trial| trial.join().unwrap_or_else(|_| Err("a panic".into())))
        });
        for row in beside {
            assert_eq!(row?, alone);
        }
        assert!(alone.position_rmse_m.is_some_and(|error| error > 0.0));
    }
    Ok(())
}

#[test]
fn a_robot_that_has_learned_before_starts_better() -> Outcome {
    let contender = Contender::GprMpcObserver;
    let school = tempfile::tempdir()?;
    run(&assembly("figure-eight", contender, 1)?, contender, Start::Cold, school.path())?;
    let cold = assembly("figure-eight", contender, 2)?;
    let mut warm = cold.clone();
    warm.scenario.learner.resume = Some(school.path().join("snapshot.bin"));
    let cold = run(&cold, contender, Start::Cold, tempfile::tempdir()?.path())?;
    let warm = run(&warm, contender, Start::Warm, tempfile::tempdir()?.path())?;
    assert!(
        warm.arrival_s.unwrap_or(f64::MAX) <= cold.arrival_s.unwrap_or(f64::MAX),
        "{warm:?}\n{cold:?}"
    );
    assert!(warm.position_rmse_m < cold.position_rmse_m, "{warm:?}\n{cold:?}");
    Ok(())
}

#[test]
fn a_response_that_was_identified_before_is_used_from_the_start() -> Outcome {
    for contender in [Contender::RlsMpcObserver, Contender::PhysicsMpcObserver] {
        let school = tempfile::tempdir()?;
        let lesson = assembly("figure-eight+delay-100", contender, 1)?;
        run(&lesson, contender, Start::Cold, school.path())?;
        let cold = assembly("figure-eight+delay-100", contender, 2)?;
        let mut warm = cold.clone();
        warm.scenario.identified = Some(school.path().join("identified.toml"));
        let cold = run(&cold, contender, Start::Cold, tempfile::tempdir()?.path())?;
        let warm = run(&warm, contender, Start::Warm, tempfile::tempdir()?.path())?;
        assert!(warm.position_rmse_m < cold.position_rmse_m, "{warm:?}\n{cold:?}");
    }
    Ok(())
}

#[test]
fn an_oracle_is_better_than_contenders_without_the_true_model() -> Outcome {
    let rmse = |contender| -> Result<f64, Box<dyn Error>> {
        let assembly = assembly("figure-eight+weak-motor", contender, 1)?;
        let row = run(&assembly, contender, Start::Cold, tempfile::tempdir()?.path())?;
        row.position_rmse_m.ok_or_else(|| "no figure".into())
    };
    let oracle = rmse(Contender::OracleMpc)?;
    for contender in [
        Contender::Mpc,
        Contender::MpcObserver,
        Contender::RlsMpcObserver,
        Contender::GprMpcObserver,
    ] {
        assert!(oracle < rmse(contender)?, "{contender}");
    }
    Ok(())
}

#[test]
fn a_model_that_is_wrong_on_one_axis_is_not_used_there_and_does_no_harm() -> Outcome {
    let lied_to = |contender, no_harm| -> Result<Row, Box<dyn Error>> {
        let mut assembly = assembly("figure-eight", contender, 1)?;
        assembly.scenario.mpc.no_harm = no_harm;
        // The identified response would explain as much as the learned model.
        assembly.scenario.mpc.identify = Identify::Off;
        // Long enough for a model that must be clearly better before it is used.
        assembly.scenario.duration_s = 25.0;
        assembly.faults = Poison::SidewaysFlips.faults(1, 0.1).into();
        run(&assembly, contender, Start::Cold, tempfile::tempdir()?.path())
    };
    let observer = lied_to(Contender::MpcObserver, true)?;
    let (with, without) =
        (lied_to(Contender::GprMpcObserver, true)?, lied_to(Contender::GprMpcObserver, false)?);
    let [forward, sideways, _] = with.learned_share;
    assert!(forward > 0.5 && sideways < 0.1, "{:?}", with.learned_share);
    assert!(
        with.position_rmse_m < observer.position_rmse_m.map(|rmse| 1.05 * rmse),
        "{with:?}\n{observer:?}"
    );
    assert!(without.position_rmse_m > observer.position_rmse_m, "{without:?}\n{observer:?}");
    Ok(())
}

#[test]
fn a_chance_level_keeps_the_robot_in_its_corridor() -> Outcome {
    let outside = |level| -> Result<f64, Box<dyn Error>> {
        let mut sum = 0.0;
        for seed in 1..=4 {
            let contender = Contender::GprMpcObserver;
            let mut assembly = assembly("corridor", contender, seed)?;
            assembly.scenario.mpc.state_limits.chance_level = level;
            let row = run(&assembly, contender, Start::Cold, tempfile::tempdir()?.path())?;
            assert!(
                row.interval
                    .is_some_and(|of| of.coverage.iter().all(|share| (0.0..=1.0).contains(share))),
                "{row:?}"
            );
            sum += row.corridor_violations.ok_or("no figure")?;
        }
        Ok(sum / 4.0)
    };
    let (mean_alone, tightened) = (outside(None)?, outside(Some(0.955))?);
    assert!(
        tightened < 0.5 * mean_alone,
        "{tightened} of all steps are outside, {mean_alone} without tightening"
    );
    Ok(())
}
