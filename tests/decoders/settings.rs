//! Every TOML file: refused with file and line, or valid and ready for use.

use super::{Fate, Verdict, as_file, either, promise, refused};
use controller::control::Controller;
use controller::reference::Reference;
use driver::gated::GatedBase;
use graph::assembly::{faults_of, robot_of};
use graph::back_off::Restarts;
use graph::file::Graph;
use graph::role::START_ORDER;
use graph::scenario::Scenario;
use model::main_model::MainModel;
use model::residual::bound;
use plant_sim::truth::World;
use process::{Pace, read_settings};
use protocol::message::Participant;
use protocol::topic::TOPIC_COUNT;
use robot::Robot;
use runs::epochs::Epochs;
use settings::SettingsError;
use std::path::Path;
use std::time::Instant;

/// Periods of a reference that are checked.
const PERIODS: usize = 30;

pub(super) fn graph(bytes: &[u8]) -> Verdict {
    let used = |graph: Graph| {
        for role in START_ORDER {
            let mut restarts = Restarts::default();
            let policy = graph.processes.of(role).restart_policy();
            let wait = (0..5).filter_map(|_| restarts.after_death(&policy, Instant::now())).max();
            promise(wait.is_none_or(|wait| wait <= policy.longest), || {
                format!("{wait:?} is longer than the longest wait")
            })?;
        }
        Ok(())
    };
    read(bytes, settings::read, used)
}

pub(super) fn robot(bytes: &[u8]) -> Verdict {
    read(bytes, robot_of, |robot| believed(&robot, 0.1))
}

/// The bounds of a robot's learned model are finite numbers.
fn believed(robot: &Robot, period: f64) -> Result<(), String> {
    let bound = bound(&MainModel::new(robot, period), robot);
    promise(bound.iter().all(|bound| bound.is_finite() && *bound >= 0.0), || {
        format!("the largest residual is {bound:?}")
    })
}

pub(super) fn faults(bytes: &[u8]) -> Verdict {
    let in_real_time = read(bytes, |file| faults_of(file, Pace::RealTime), |_| Ok(()))?;
    let in_lock_step = read(bytes, |file| faults_of(file, Pace::LockStep), |_| Ok(()))?;
    promise(in_lock_step == Fate::Refused || in_real_time == Fate::Used, || {
        "lock step allows a fault that real time does not".into()
    })?;
    Ok(either(in_real_time, in_lock_step))
}

pub(super) fn scenario(bytes: &[u8]) -> Verdict {
    read(bytes, settings::read, |scenario: Scenario| possible(&scenario))
}

/// A valid scenario: its reference and its world consist of finite numbers.
fn possible(scenario: &Scenario) -> Result<(), String> {
    promise(scenario.period_nanos() > 0, || "a period of no length".into())?;
    let period = scenario.period_millis * 1e-3;
    let reference = Reference::new(&scenario.reference, &scenario.start.pose, period, PERIODS);
    let reference = reference
        .map_err(|error| format!("a scenario that was found possible has no reference: {error}"))?;
    finite_along(&reference)?;
    if let Some(truth) = &scenario.truth {
        World::new(truth, scenario.start, scenario.seed);
    }
    Ok(())
}

/// Every number of a reference is finite.
pub(super) fn finite_along(reference: &Reference) -> Result<(), String> {
    for tick in 0..=PERIODS as u64 {
        let point = reference.at(tick);
        let numbers = point.pose.iter().chain(&point.velocity).chain([&point.course]);
        promise(numbers.into_iter().all(|value| value.is_finite()), || {
            format!("the reference at tick {tick} is {point:?}")
        })?;
    }
    Ok(())
}

/// A change of a scenario, as a variant or the command line gives it.
pub(super) fn scenario_change(bytes: &[u8]) -> Verdict {
    let Ok(change) = std::str::from_utf8(bytes) else { return Ok(Fate::Refused) };
    let folder = crate::repository().join("deploy/scenarios");
    match Scenario::named(&folder, "figure-eight+payload", None, &[change.to_owned()]) {
        Ok(scenario) => possible(&scenario).map(|()| Fate::Used),
        // Lines are those of the merged text, which no user sees.
        Err(SettingsError::Unreadable { file, reason }) => {
            Err(format!("{}: {reason}", file.display()))
        }
        Err(error) => refused(&error.to_string()),
    }
}

pub(super) fn epochs(bytes: &[u8]) -> Verdict {
    as_file(bytes, |file| match Epochs::open(file, 0) {
        Ok(epochs) => {
            let next = Participant::ALL.iter().map(|&role| epochs.highest(role).saturating_add(1));
            promise(next.into_iter().all(|epoch| i64::try_from(epoch).is_ok()), || {
                "there is no next epoch".into()
            })?;
            Ok(Fate::Used)
        }
        Err(error) => {
            let why = error.get_ref().and_then(|error| error.downcast_ref::<SettingsError>());
            why.map_or_else(
                || Err(format!("which line was meant? {error}")),
                |error| placed(error, file, bytes),
            )
        }
    })
}

pub(super) fn plant(bytes: &[u8]) -> Verdict {
    read(bytes, read_settings, |settings: plant_sim::Settings| {
        settings.driver(None).ticks();
        if let Some(truth) = &settings.truth {
            let world = World::new(truth, settings.start, settings.seed);
            GatedBase::new(world, &settings.driver(None), 1);
        }
        Ok(())
    })
}

pub(super) fn controller(bytes: &[u8]) -> Verdict {
    read(bytes, read_settings, |mut settings: controller::Settings| {
        let period = settings.run.period_nanos as f64 * 1e-9;
        settings.duration_s = settings.duration_s.min(PERIODS as f64 * period);
        if let Ok(reference) = Reference::new(&settings.reference, &settings.start, period, PERIODS)
        {
            finite_along(&reference)?;
        }
        // It may refuse: only its solver can find some errors.
        let made = Controller::new(&settings);
        promise(made.is_ok() || made.is_err_and(|error| !error.to_string().is_empty()), || {
            "a refusal says nothing".into()
        })
    })
}

pub(super) fn learner(bytes: &[u8]) -> Verdict {
    read(bytes, read_settings, |settings: learner::Settings| {
        believed(&settings.robot, settings.run.period_nanos as f64 * 1e-9)
    })
}

pub(super) fn recorder(bytes: &[u8]) -> Verdict {
    read(bytes, read_settings, |_: recorder::settings::Settings| Ok(()))
}

pub(super) fn bridge(bytes: &[u8]) -> Verdict {
    read(bytes, read_settings, |settings: bridge::settings::Settings| {
        let topics = settings.remotes.iter().map(|remote| settings.outgoing(remote).len());
        let most = topics.max().unwrap_or(0);
        promise(most <= TOPIC_COUNT, || format!("{most} topics go to one host"))
    })
}

pub(super) fn gateway(bytes: &[u8]) -> Verdict {
    read(bytes, read_settings, |settings: gateway::settings::Settings| {
        gateway::settings::Rates::interval(settings.rates.state);
        Ok(())
    })
}

/// Reads `bytes` as a file: valid settings are `used`, invalid ones are refused with their place.
fn read<T>(
    bytes: &[u8],
    read: impl FnOnce(&Path) -> Result<T, SettingsError>,
    used: impl FnOnce(T) -> Result<(), String>,
) -> Verdict {
    as_file(bytes, |file| match read(file) {
        Ok(settings) => used(settings).map(|()| Fate::Used),
        Err(error) => placed(&error, file, bytes),
    })
}

/// The error begins with `file:line:`, and that line exists.
fn placed(error: &SettingsError, file: &Path, bytes: &[u8]) -> Verdict {
    let line = match error {
        SettingsError::Unreadable { .. } => None,
        SettingsError::Syntax { line, .. }
        | SettingsError::UnknownKey { line, .. }
        | SettingsError::MissingKey { line, .. } => Some(*line),
        SettingsError::Value { line, .. } => *line,
    };
    let lines = bytes.split(|&byte| byte == b'\n').count();
    let place = line
        .filter(|line| (1..=lines).contains(line))
        .map(|line| format!("{}:{line}: ", file.display()));
    let text = error.to_string();
    promise(place.is_some_and(|place| text.starts_with(&place)), || {
        format!("which of {lines} lines was meant? {text}")
    })?;
    Ok(Fate::Refused)
}
