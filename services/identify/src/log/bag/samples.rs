//! Series of the topics → samples at a constant period.

use super::messages::{Read, STATE, place};
use super::series::{NoCommand, Point, Series};
use crate::log::{Cutter, Log, LogError, Sample, median_period};
use robot::AXES;
use std::path::Path;

/// A tenth of the steps of the odometry may deviate from the period by this share before it is
/// named.
const JITTER: f64 = 0.2;

/// Why there is no sample at a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Missing {
    Command(NoCommand),
    Wheels,
}

impl Missing {
    fn text(self) -> &'static str {
        match self {
            Self::Command(NoCommand::Before) => "no command yet, left out",
            Self::Command(NoCommand::Old) => {
                "no command for 0.5 s, and the last was not zero, left out"
            }
            Self::Wheels => "no speeds of the wheels, left out",
        }
    }
}

pub(super) fn log(path: &Path, read: &Read, joints: usize) -> Result<Log, LogError> {
    let points = read.odometry.points();
    let start = points.first().map_or(0, |point| point.nanos);
    let seconds = |nanos: i64| (nanos - start) as f64 * 1e-9;
    let times: Vec<f64> = points.iter().map(|point| seconds(point.nanos)).collect();
    let period = (1e9 * median_period(path, &times, "odometry")?).round() as i64;
    let mut cutter = Cutter::new(path, period as f64 * 1e-9, joints);
    for (place, what) in &read.notes {
        cutter.note(place, what);
    }
    note_jitter(&mut cutter, &times);
    let odometry = continuous(&read.odometry);
    let mut missing = None;
    for part in odometry.parts() {
        let (Some(first), Some(last)) = (part.first(), part.last()) else { continue };
        let times = (0..).map(|number| first.nanos + number * period);
        for nanos in times.take_while(|nanos| *nanos <= last.nanos) {
            let Some(measured) = odometry.at(nanos) else { continue };
            let place = place(&read.topic, measured.number);
            let found = sample(read, &measured, period);
            match found {
                Ok(sample) => cutter.add(&place, Sample { time_s: seconds(nanos), ..sample })?,
                Err(why) => {
                    if missing != Some(why) {
                        cutter.note(&place, why.text());
                    }
                    cutter.cut();
                }
            }
            missing = found.err();
        }
    }
    Ok(cutter.finish())
}

/// The sample of a measurement, without its time.
fn sample(read: &Read, measured: &Point<STATE>, period: i64) -> Result<Sample, Missing> {
    let nanos = measured.nanos;
    let input = read.command.mean(nanos - period, nanos).map_err(Missing::Command)?;
    let wheel_speed = match &read.wheels {
        Some(wheels) => Some(wheels.at(nanos).ok_or(Missing::Wheels)?.value),
        None => None,
    };
    let [x, y, yaw, forward, left, turn] = measured.value;
    Ok(Sample {
        time_s: 0.0,
        pose: [x, y, yaw],
        velocity: [forward, left, turn],
        input,
        wheel_speed,
    })
}

/// The odometry with a heading that does not jump by 2π, so that it can be interpolated.
fn continuous(odometry: &Series<STATE>) -> Series<STATE> {
    let mut points = odometry.points().to_vec();
    for place in 1..points.len() {
        let before = points[place - 1].value[AXES - 1];
        let turn = points[place].value[AXES - 1] - before;
        points[place].value[AXES - 1] = before + turn.sin().atan2(turn.cos());
    }
    Series::new(points)
}

fn note_jitter(cutter: &mut Cutter, times: &[f64]) {
    let period = cutter.period_s;
    let mut deviations: Vec<f64> =
        times.windows(2).map(|pair| (pair[1] - pair[0] - period).abs()).collect();
    deviations.sort_by(f64::total_cmp);
    let tenth = deviations.get(deviations.len() * 9 / 10).copied().unwrap_or(0.0);
    if tenth > JITTER * period {
        let text = format!(
            "a tenth of its steps differ from the period of {:.1} ms by more than {:.1} ms",
            1e3 * period,
            1e3 * tenth
        );
        cutter.note("odometry", &text);
    }
}
