//! launcher → gateway: the same run without learning, period by period, in a file.
//!
//! | column    | what it holds                                      |
//! |-----------|----------------------------------------------------|
//! | `tick`    | control period                                     |
//! | `x_m`     | measured position \[m\]                            |
//! | `y_m`     | the same \[m\]                                     |
//! | `error_m` | distance of that position from the reference \[m\] |

use serde::{Deserialize, Serialize};
use std::path::Path;

/// Largest number of stored periods; later ones are not compared.
pub const PERIODS_MAX: usize = 30_000;

/// One period without learning.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Control period.
    pub tick: u64,
    /// Measured position \[m\].
    pub x_m: f64,
    /// The same \[m\].
    pub y_m: f64,
    /// Distance of that position from the reference \[m\].
    pub error_m: f64,
}

/// Writes a run without learning.
///
/// # Errors
/// Errors of the file system.
pub fn write(file: &Path, rows: &[Row]) -> Result<(), csv::Error> {
    let mut writer = csv::Writer::from_path(file)?;
    rows.iter().try_for_each(|row| writer.serialize(row))?;
    Ok(writer.flush()?)
}

/// Reads a run without learning.
///
/// # Errors
/// The file cannot be read, or a row does not have four numbers.
pub fn read(file: &Path) -> Result<Vec<Row>, csv::Error> {
    csv::Reader::from_path(file)?.into_deserialize().take(PERIODS_MAX).collect()
}

/// RMS errors of both runs so far.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct Standing {
    /// First compared period. It is later than the run's first one if the gateway started later.
    since: u64,
    /// RMS position error of this run over the periods that both have \[m\].
    with: f64,
    /// The same without learning \[m\].
    without: f64,
}

/// This run beside the one without learning.
#[derive(Debug, Default)]
pub(crate) struct Comparison {
    rows: Vec<Row>,
    periods: u64,
    since: u64,
    sum: f64,
    sum_without: f64,
}

impl Comparison {
    /// A comparison with `rows`, in the order of their ticks.
    pub(crate) fn new(mut rows: Vec<Row>) -> Self {
        rows.sort_unstable_by_key(|row| row.tick);
        Self { rows, ..Self::default() }
    }

    pub(crate) fn rows(&self) -> &[Row] {
        &self.rows
    }

    /// Restarts the comparison for another run.
    pub(crate) fn start_again(&mut self) {
        (self.periods, self.sum, self.sum_without) = (0, 0.0, 0.0);
    }

    /// Processes the position error of this run at `tick`.
    pub(crate) fn add(&mut self, tick: u64, error: f64) {
        if let Ok(index) = self.rows.binary_search_by_key(&tick, |row| row.tick)
            && let Some(row) = self.rows.get(index)
            && error.is_finite()
            && row.error_m.is_finite()
        {
            if self.periods == 0 {
                self.since = tick;
            }
            self.periods += 1;
            self.sum += error * error;
            self.sum_without += row.error_m * row.error_m;
        }
    }

    /// The RMS errors so far; `None` before the first period that both runs have.
    pub(crate) fn standing(&self) -> Option<Standing> {
        let rms = |sum: f64| (sum / self.periods as f64).sqrt();
        (self.periods > 0).then(|| Standing {
            since: self.since,
            with: rms(self.sum),
            without: rms(self.sum_without),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(tick: u64, error_m: f64) -> Row {
        Row { tick, x_m: 1.5, y_m: -0.25, error_m }
    }

    #[test]
    fn a_written_run_is_read_back() -> Result<(), Box<dyn std::error::Error>> {
        let folder = tempfile::tempdir()?;
        let (file, rows) = (folder.path().join("without.csv"), [row(0, 1.0), row(1, 0.1 + 0.2)]);
        write(&file, &rows)?;
        assert_eq!(read(&file)?, rows);
        std::fs::write(&file, "tick,x_m,y_m,error_m\n0,1,2,three\n")?;
        assert!(read(&file).is_err());
        assert!(read(&folder.path().join("nowhere.csv")).is_err());
        Ok(())
    }

    #[test]
    fn only_periods_of_both_runs_count() {
        let mut comparison = Comparison::new(vec![row(2, 4.0), row(1, 3.0)]);
        assert_eq!(comparison.standing(), None);
        for (tick, error) in [(0, 100.0), (1, 0.3), (2, 0.4), (3, 100.0), (2, f64::NAN)] {
            comparison.add(tick, error);
        }
        assert!(comparison.standing().is_some_and(|standing| {
            standing.since == 1
                && (standing.with - 0.125_f64.sqrt()).abs() < 1e-12
                && (standing.without - 12.5_f64.sqrt()).abs() < 1e-12
        }));
        comparison.start_again();
        assert_eq!(comparison.standing(), None);
    }
}
