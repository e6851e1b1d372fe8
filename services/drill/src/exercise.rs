//! One exercise: runs it with real processes, and judges it.

use super::catalogue::{Carrier, Driven, Exercise, Launch, Refused, Rivalry, Task};
use super::ground::Ground;
use super::measure::{Measured, acts_until, is_stopped_astray, measure, worst_reaction};
use super::oracle::{Limits, judge};
use super::record::Record;
use super::session::{Home, Trouble, permits_little_shared_memory};
use super::tracking::{self, Tracked, Windows};
use super::{
    appearing, between, damage, emergency_stop, goals, launchers, refusals, rivals, serial_base,
};
use graph::faults::FaultsFile;
use process::{Stop, Witness};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::fs;
use std::path::Path;
use std::thread;
use std::time::Duration;
use supervisor::fault_injector::{Injected, LIST};

/// Longest time from a launch to the first fresh plan after all processes were killed \[s\].
const DRIVING_WITHIN_S: f64 = 2.0;
/// How long a graph drives before the first fault.
pub(super) const SETTLED: Duration = Duration::from_millis(500);

/// Runs the exercise. Its files are kept in `kept` if there was a violation.
///
/// # Errors
/// If the exercise could not be done.
pub(super) fn run(
    exercise: &Exercise,
    ground: &Ground,
    seed: u64,
    kept: &Path,
    stop: &Stop,
) -> Result<Measured, Trouble> {
    let plain = Launch::default();
    match &exercise.task {
        Task::Damaged(count) => damage::run(*count, seed),
        Task::Launch(Launch { shared_memory_mebibytes: Some(_), .. })
        | Task::LittleSharedMemory(_)
            if !permits_little_shared_memory() =>
        {
            Ok(Measured {
                impossible: Some("unshare --mount and a tmpfs in it are not permitted"),
                ..Measured::default()
            })
        }
        Task::Launch(launch) => {
            launch_with_faults(exercise.carrier, launch, ground, seed, kept, stop)
        }
        Task::KillAll(times) => in_home(exercise.carrier, &plain, ground, seed, kept, |home| {
            kill_all(home, *times, seed, stop)
        }),
        Task::Rivals(rivalry, times) => {
            in_home(exercise.carrier, &plain, ground, seed, kept, |home| match rivalry {
                Rivalry::GreaterEpoch => rivals::greater_epoch(home, *times, stop),
                Rivalry::EqualEpochs => rivals::equal_epochs(home, *times, stop),
                Rivalry::OldEpoch => rivals::old_epoch(home, *times, seed, stop),
            })
        }
        Task::Compete(times) => in_home(exercise.carrier, &plain, ground, seed, kept, |home| {
            launchers::compete(home, *times, seed, stop)
        }),
        Task::Between(failure, millis) => {
            in_home(exercise.carrier, &plain, ground, seed, kept, |home| {
                between::run(home, *failure, millis, stop)
            })
        }
        Task::Goals(fault, times) => {
            in_home(exercise.carrier, &waits_for_goals(String::new()), ground, seed, kept, |home| {
                goals::run(home, *fault, *times, seed, stop)
            })
        }
        Task::EmergencyStop(times) => {
            let launch = waits_for_goals(emergency_stop::faults(*times));
            in_home(exercise.carrier, &launch, ground, seed, kept, |home| {
                emergency_stop::run(home, *times, stop)
            })
        }
        Task::Appearing(times) => {
            let launch = waits_for_goals(appearing::faults(*times, seed));
            in_home(exercise.carrier, &launch, ground, seed, kept, |home| {
                appearing::run(home, *times, stop)
            })
        }
        Task::SerialBase(fault, times) => {
            let launch = Launch { driven: Driven::SerialBase, ..Launch::default() };
            in_home(exercise.carrier, &launch, ground, seed, kept, |home| {
                serial_base::run(home, *fault, *times, seed, stop)
            })
        }
        Task::LittleSharedMemory(sizes) => {
            little_shared_memory(exercise.carrier, sizes, ground, seed, kept, stop)
        }
        Task::SideBySide => in_home(exercise.carrier, &plain, ground, seed, kept, |home| {
            launchers::side_by_side(home, stop)
        }),
    }
}

/// A launch whose robot waits for goals, with these faults.
fn waits_for_goals(faults: String) -> Launch {
    Launch { faults, driven: Driven::WaitingForGoals, ..Launch::default() }
}

/// Runs `work` in a home of its own, which is kept if there was a violation.
fn in_home(
    carrier: Carrier,
    launch: &Launch,
    ground: &Ground,
    seed: u64,
    kept: &Path,
    work: impl FnOnce(&Home<'_>) -> Result<Measured, Trouble>,
) -> Result<Measured, Trouble> {
    let home = Home::new(ground, carrier, launch, seed)?;
    // An exercise that could not be done is a violation too, and its files are kept. The twins run
    // before any real-time run.
    let is_unlike_twins = launch.driven != Driven::Simulator;
    let twins = if is_unlike_twins { Ok(()) } else { ground.course().map(drop) };
    let mut measured = twins.and_then(|()| work(&home)).unwrap_or_else(Measured::not_done);
    if !measured.violations.is_empty()
        && let Err(trouble) = home.keep(kept)
    {
        measured.notes.push(format!("it is not in {}: {trouble}", kept.display()));
    }
    Ok(measured)
}

fn launch_with_faults(
    carrier: Carrier,
    launch: &Launch,
    ground: &Ground,
    seed: u64,
    kept: &Path,
    stop: &Stop,
) -> Result<Measured, Trouble> {
    in_home(carrier, launch, ground, seed, kept, |home| {
        let witness = Witness::begin();
        let mut session = home.launch("run", launch.duration_s)?;
        let status = session.wait(launch.duration_s, stop)?;
        let gaps = witness.end();
        if !session.run().is_dir() {
            return Err(format!(
                "the launch ended with {status}: {}",
                last_line(&home.output("run"))
            )
            .into());
        }
        let injected = injected(session.run());
        let record = session.record()?;
        let mut measured = measure(&record, launch, &home.limits()?, &injected, &gaps);
        judge_tracking(home, &record, launch, &mut measured)?;
        let asked = asked_of_processes(launch)?;
        if injected.len() as u64 != asked {
            measured
                .violations
                .push(format!("{} of {asked} faults of processes were injected", injected.len()));
        }
        let on_links = refusals::on_links(session.run())?;
        measured.injections += on_links.iter().map(|fault| fault.count).sum::<u64>();
        // Faults of the world are deterministic: all of them happen once the run has lasted long
        // enough.
        measured.injections += launch.faults.matches("[[plant]]").count() as u64;
        match launch.refused {
            Some(Refused::Messages) => {
                measured.violations.extend(refusals::judge_messages(&on_links, &record));
            }
            Some(Refused::Snapshots) => {
                let (sent, violations) = refusals::judge_snapshots(session.run(), &record)?;
                measured.injections += sent;
                measured.violations.extend(violations);
            }
            None => {}
        }
        if measured.injections == 0 {
            measured.violations.push("nothing was injected".to_owned());
        }
        if !status.success() {
            measured.violations.push(format!(
                "the launch ended with {status}: {}",
                last_line(&home.output("run"))
            ));
        }
        measured.violations.extend(left_behind(home, &[session.graph_name()?]));
        Ok(measured)
    })
}

fn kill_all(home: &Home<'_>, times: u32, seed: u64, stop: &Stop) -> Result<Measured, Trouble> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let (mut measured, mut names) = (Measured::default(), Vec::new());
    let limits = home.limits()?;
    for round in 0..=times {
        let run = format!("run-{round}");
        let mut session = home.launch(&run, 1000.0)?;
        session.wait_for_log("controller", "answering a plant", 1)?;
        thread::sleep(SETTLED + Duration::from_micros(random.random_range(0..100_000)));
        names.push(session.graph_name()?);
        if round == times || stop.requested() {
            session.end()?;
        } else {
            session.kill_all()?;
            measured.injections += 1;
        }
        let record = session.record()?;
        let fresh = record
            .of("state")
            .find(|state| state.word("fallback_level") == "fresh plan")
            .map(|state| state.stamp("sent_nanos"));
        match fresh.map(|at| at.saturating_sub(session.begun_nanos) as f64 * 1e-9) {
            // The first launch is no restart.
            Some(took) if round > 0 => {
                if took > DRIVING_WITHIN_S {
                    measured.violations.push(format!(
                        "launch {round} drove after {took:.2} s, \
                         expected {DRIVING_WITHIN_S} s at most"
                    ));
                }
                measured.worst_restart = worse(measured.worst_restart, Some(took));
            }
            Some(_) => {}
            None => measured.violations.push(format!("launch {round} never drove")),
        }
        judge_wheels(&record, &limits, &mut measured);
        judge_tracking(home, &record, &Launch::default(), &mut measured)?;
    }
    measured.violations.extend(left_behind(home, &names));
    Ok(measured)
}

/// Launches with less and less shared memory. Each launch is rejected before the robot has moved,
/// or drives normally.
fn little_shared_memory(
    carrier: Carrier,
    sizes: &[u64],
    ground: &Ground,
    seed: u64,
    kept: &Path,
    stop: &Stop,
) -> Result<Measured, Trouble> {
    let duration_s = 3.0;
    let mut measured = Measured::default();
    for &mebibytes in sizes {
        let launch = Launch {
            undisturbed: true,
            shared_memory_mebibytes: Some(mebibytes),
            ..Launch::default()
        };
        let one = in_home(
            carrier,
            &launch,
            ground,
            seed,
            &kept.join(format!("{mebibytes}-MiB")),
            |home| {
                let witness = Witness::begin();
                let mut session = home.launch("run", duration_s)?;
                let status = session.wait(duration_s, stop)?;
                let gaps = witness.end();
                let mut one = Measured::default();
                if status.success() {
                    let record = session.record()?;
                    one = measure(&record, &launch, &home.limits()?, &[], &gaps);
                    judge_tracking(home, &record, &launch, &mut one)?;
                } else {
                    let moved = session.record().is_ok_and(|record| {
                        record.of("truth").any(|truth| truth.count("acting_epoch") > 0)
                    });
                    let output = home.output("run");
                    if moved || !output.contains("/dev/shm") {
                        one.violations.push(format!(
                            "with {mebibytes} MiB it ended with {status}, the robot {}: {}",
                            if moved { "had moved" } else { "stood" },
                            last_line(&output)
                        ));
                    }
                }
                Ok(one)
            },
        )?;
        measured.injections += 1;
        measured.violations.extend(one.violations);
        measured.excused += one.excused;
        measured.worst_reaction = worse(measured.worst_reaction, one.worst_reaction);
        measured.tracking = worse(measured.tracking, one.tracking);
    }
    Ok(measured)
}

/// Judges the wheels with the oracle. Messages that a killed recorder had not yet written cause no
/// violation.
pub(super) fn judge_wheels(record: &Record, limits: &Limits, measured: &mut Measured) {
    let violations = judge(record, limits)
        .into_iter()
        .filter(|violation| violation.rule != super::oracle::Rule::Count);
    measured.violations.extend(violations.map(|violation| violation.to_string()));
    measured.worst_reaction = worse(measured.worst_reaction, worst_reaction(record, limits));
}

/// Judges the distance of the robot from its reference, against what physics allows.
pub(super) fn judge_tracking(
    home: &Home<'_>,
    record: &Record,
    launch: &Launch,
    measured: &mut Measured,
) -> Result<(), Trouble> {
    // A changed command acts until the brake.
    let misled: Vec<_> = launch.misled.iter().chain(&launch.misquoted).map(acts_until).collect();
    let windows = Windows { misled: &misled, slippery: &launch.slippery };
    let Tracked { violations, share } =
        tracking::judge(record, &home.limits()?, home.course()?, windows)?;
    let found = violations.iter().map(ToString::to_string);
    if let Some(why) = launch.goes_astray {
        measured.notes.extend(found.map(|found| format!("{found}; {why}")));
        let stopped = record.of("state").find(|state| is_stopped_astray(state));
        measured.notes.extend(stopped.map(|state| {
            format!("latched with a {} at tick {}", state.word("reason"), state.stamp("tick"))
        }));
    } else {
        measured.violations.extend(found);
    }
    measured.tracking = worse(measured.tracking, share);
    Ok(())
}

/// The greater of the values that are present.
pub(super) fn worse(one: Option<f64>, other: Option<f64>) -> Option<f64> {
    one.into_iter().chain(other).reduce(f64::max)
}

pub(super) fn left_behind(home: &Home<'_>, names: &[String]) -> Vec<String> {
    home.left_behind(names).into_iter().map(|file| format!("{file} was left behind")).collect()
}

/// The number of process faults that a launch must have. The launch lasts until all have happened.
fn asked_of_processes(launch: &Launch) -> Result<u64, Trouble> {
    let faults: FaultsFile = settings::parse(&launch.faults, Path::new("faults.toml"))?;
    Ok(faults.process.iter().map(|fault| u64::from(fault.times)).sum())
}

/// What the launcher did to processes.
fn injected(run: &Path) -> Vec<Injected> {
    let text = fs::read_to_string(run.join(LIST)).unwrap_or_default();
    text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect()
}

fn last_line(text: &str) -> &str {
    text.lines().next_back().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::catalogue::{Extent, exercises};

    #[test]
    fn a_launch_lasts_until_its_last_process_fault() -> Result<(), Trouble> {
        for exercise in
            [Extent::Quick, Extent::Whole].into_iter().flat_map(|extent| exercises(extent, true))
        {
            let Task::Launch(launch) = &exercise.task else { continue };
            let faults: FaultsFile = settings::parse(&launch.faults, Path::new("faults.toml"))?;
            for fault in &faults.process {
                let last = fault
                    .times(Duration::from_millis(20), 1)
                    .last()
                    .unwrap_or_default()
                    .as_secs_f64();
                assert!(
                    last + 1.0 < launch.duration_s,
                    "{} of {}: the last comes after {last} s",
                    exercise.fault,
                    exercise.target
                );
            }
        }
        Ok(())
    }
}
