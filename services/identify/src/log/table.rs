//! A table (CSV) → samples. One row per period, with [`COLUMNS`] in any order.

use super::{Cutter, Log, LogError, Sample, median_period};
use csv::{ReaderBuilder, StringRecord, Trim};
use robot::{PerWheel, WHEELS_MAX};
use serde::Deserialize;
use std::path::Path;

/// Columns that a table must have. `wheel_1_radps` to `wheel_8_radps` may follow.
pub(super) const COLUMNS: &str = "time_s, x_m, y_m, yaw_rad, velocity_forward_mps, \
     velocity_left_mps, yaw_rate_radps, input_forward_mps, input_left_mps, input_yaw_radps";

#[derive(Debug, Deserialize)]
struct Row {
    time_s: f64,
    x_m: f64,
    y_m: f64,
    yaw_rad: f64,
    velocity_forward_mps: f64,
    velocity_left_mps: f64,
    yaw_rate_radps: f64,
    input_forward_mps: f64,
    input_left_mps: f64,
    input_yaw_radps: f64,
}

pub(super) fn read(path: &Path) -> Result<Log, LogError> {
    let failed = |source| LogError::Table { path: path.to_owned(), source };
    let mut reader = ReaderBuilder::new().trim(Trim::All).from_path(path).map_err(failed)?;
    let columns = reader.headers().map_err(failed)?.clone();
    let wheels = wheel_columns(&columns);
    let mut rows = Vec::new();
    for record in reader.records() {
        let record = record.map_err(failed)?;
        let row: Row = record.deserialize(Some(&columns)).map_err(failed)?;
        let line = record.position().map_or(0, csv::Position::line);
        rows.push((line, row.sample(wheel_speeds(&record, &wheels))));
    }
    let times: Vec<f64> = rows.iter().map(|(_, row): &(u64, Sample)| row.time_s).collect();
    let mut cutter = Cutter::new(path, median_period(path, &times, "time_s")?, wheels.len());
    for (line, sample) in rows {
        cutter.add(&format!("line {line}"), sample)?;
    }
    Ok(cutter.finish())
}

fn wheel_columns(columns: &StringRecord) -> Vec<usize> {
    let of_wheel =
        |wheel: usize| columns.iter().position(|column| column == format!("wheel_{wheel}_radps"));
    (1..=WHEELS_MAX).map_while(of_wheel).collect()
}

/// None if a wheel has no number: then the row has no measured wheel speeds.
fn wheel_speeds(record: &StringRecord, columns: &[usize]) -> Option<PerWheel> {
    let mut speeds: PerWheel = [0.0; WHEELS_MAX];
    for (speed, &column) in speeds.iter_mut().zip(columns) {
        *speed = record.get(column)?.parse().ok().filter(|speed: &f64| speed.is_finite())?;
    }
    (!columns.is_empty()).then_some(speeds)
}

impl Row {
    fn sample(&self, wheel_speed: Option<PerWheel>) -> Sample {
        Sample {
            time_s: self.time_s,
            pose: [self.x_m, self.y_m, self.yaw_rad],
            velocity: [self.velocity_forward_mps, self.velocity_left_mps, self.yaw_rate_radps],
            input: [self.input_forward_mps, self.input_left_mps, self.input_yaw_radps],
            wheel_speed,
        }
    }
}
