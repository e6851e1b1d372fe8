//! The figures of a record: `cargo run -p recorder --example read_record RUN`.
//!
//! RUN is a run directory of `coxswain launch`.

use recorder::rows::Rows;
use recorder::{reader, segment, summary};
use std::env;
use std::error::Error;
use std::io::{self, Write};
use std::path::Path;
use std::process::ExitCode;

fn main() -> Result<ExitCode, Box<dyn Error>> {
    let Some(run) = env::args().nth(1) else {
        writeln!(io::stderr(), "read_record: expected a run directory")?;
        return Ok(ExitCode::from(2));
    };
    let segments = segment::paths(Path::new(&run));
    let head = segments.first().map(|first| reader::head(first)).transpose()?;
    let Some(period_nanos) = head.and_then(|head| head.period_nanos) else {
        writeln!(io::stderr(), "read_record: no record in {run}")?;
        return Ok(ExitCode::FAILURE);
    };
    let rows = Rows::read(&segments)?;
    let figures = summary::Summary::of(&rows, period_nanos);
    let mut out = io::stdout();
    writeln!(out, "periods {} missed {}", figures.periods, figures.periods_missed)?;
    if let (Some(rmse), Some(most)) = (figures.position_rmse_m, figures.position_max_m) {
        writeln!(out, "position_rmse_m {rmse} position_max_m {most} of {}", figures.figures_of)?;
    }
    for (nanos, distance) in summary::distances(&rows, period_nanos).into_iter().step_by(50) {
        writeln!(out, "t {:.1} s distance {distance:.4} m", nanos as f64 * 1e-9)?;
    }
    Ok(ExitCode::SUCCESS)
}
