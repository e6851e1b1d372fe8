//! A record of a run → samples. Times are those of the ticks.

use super::{Cutter, Log, LogError, Sample};
use protocol::message::{Coded, Reason};
use protocol::topic::Topic;
use recorder::reader::{self, SourceError};
use robot::{PerWheel, WHEELS_MAX};
use serde::Deserialize;
use std::path::Path;

/// The recorded state, as far as it is used. A number that is not finite is recorded as null.
#[derive(Debug, Deserialize)]
struct Row {
    stamp: Mark,
    pose: [Option<f64>; 3],
    velocity: [Option<f64>; 3],
    input: [Option<f64>; 3],
    /// Why the gate has stopped; records of versions below 5 do not tell.
    #[serde(default)]
    stop: Option<String>,
    /// Empty if they are not measured.
    #[serde(default)]
    wheel_speed: Vec<Option<f64>>,
}

#[derive(Debug, Deserialize)]
struct Mark {
    epoch: u64,
    tick: u64,
}

pub(super) fn read(path: &Path) -> Result<Log, LogError> {
    let files = reader::files(path)?;
    let period_s = period_s(path, &files)?;
    let mut cutter = Cutter::new(path, period_s, 0);
    let (mut number, mut epoch, mut stopped) = (0, None, false);
    let ended_early = reader::all_messages(&files, |message| {
        if message.channel.topic != Topic::State.name() {
            return Ok(());
        }
        number += 1;
        let row: Row = serde_json::from_slice(&message.data)
            .map_err(|source| LogError::Message { path: path.to_owned(), number, source })?;
        if epoch.replace(row.stamp.epoch).is_some_and(|before| before != row.stamp.epoch) {
            cutter.note(&format!("state {number}"), "the plant was started again");
            cutter.restart();
        }
        let stop =
            row.stop.as_deref().filter(|reason| *reason != Reason::word(Reason::None as u32));
        if let Some(reason) = stop {
            // What follows is the ramp of the brake, and then rest.
            if !std::mem::replace(&mut stopped, true) {
                cutter.note(&format!("state {number}"), &format!("the gate stopped: {reason}"));
                cutter.is_stopped = true;
                cutter.cut();
            }
            return Ok(());
        }
        stopped = false;
        cutter.wheels = cutter.wheels.max(row.wheel_speed.len());
        cutter.add(&format!("state {number}"), row.sample(period_s))
    })?;
    for file in ended_early {
        cutter.notes.push(format!("{} ends early", file.display()));
    }
    Ok(cutter.finish())
}

fn period_s(path: &Path, files: &[std::path::PathBuf]) -> Result<f64, LogError> {
    for file in files {
        let head = reader::head(file)
            .map_err(|source| SourceError::Read { path: file.clone(), source })?;
        if let Some(nanos) = head.period_nanos {
            return Ok(nanos as f64 * 1e-9);
        }
    }
    Err(LogError::Period {
        path: path.to_owned(),
        found: "unknown".to_owned(),
        expected: "a record with its control period (metadata \"coxswain\", \"period_nanos\")"
            .to_owned(),
    })
}

impl Row {
    fn sample(&self, period_s: f64) -> Sample {
        let numbers = |values: [Option<f64>; 3]| values.map(|value| value.unwrap_or(f64::NAN));
        let mut wheels: PerWheel = [0.0; WHEELS_MAX];
        for (wheel, speed) in wheels.iter_mut().zip(&self.wheel_speed) {
            *wheel = speed.unwrap_or(f64::NAN);
        }
        Sample {
            time_s: self.stamp.tick as f64 * period_s,
            pose: numbers(self.pose),
            velocity: numbers(self.velocity),
            input: numbers(self.input),
            wheel_speed: (!self.wheel_speed.is_empty()).then_some(wheels),
        }
    }
}
