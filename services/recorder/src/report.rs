//! records → `report.html`: one self-contained page with the figures of the paper's section 6 and
//! ours.
//!
//! | module     | what it holds                                                                  |
//! |------------|--------------------------------------------------------------------------------|
//! | `record`   | the files of one run → the data of its figures                                 |
//! | `recorded` | recorded JSON → the data of the figures                                        |
//! | `events`   | events and their times                                                         |
//! | `coverage` | residuals against the interval of the learned model                            |
//! | `tracking` | path and tracking errors (the paper's figures 3 and 4)                         |
//! | `motion`   | velocities and wheel speeds (5 and 6)                                          |
//! | `learning` | residual before and after, models, variance band                               |
//! | `running`  | tick times, fallback levels and faults                                         |
//! | `table`    | the summary table                                                              |
//! | `figure`   | one figure: panels, legend, what is missing                                    |
//! | `panel`    | axes, lines, bands and marks → SVG                                             |
//! | `axis`     | numbers → positions, with ticks                                                |
//! | `thin`     | many points → as many as are visible                                           |
//! | `page`     | figures and table → HTML                                                       |
//!
//! A record is read once, message by message. About half a kilobyte per period is kept. A line on
//! the page has at most as many points as it has columns, independent of the length of the run.

pub mod axis;
mod coverage;
mod events;
mod figure;
mod learning;
mod motion;
pub mod page;
pub mod panel;
mod record;
mod recorded;
mod running;
mod table;
mod thin;
mod tracking;

use crate::reader::SourceError;
use process::atomic_file;
use record::Record;
use std::io;
use std::path::{Path, PathBuf};

/// Why there is no report.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The record cannot be read.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The record has no states.
    #[error(
        "{}: expected a record with at least one message of topic \"state\", found none",
        path.display()
    )]
    NoStates {
        /// The record.
        path: PathBuf,
    },
    /// The record has no control period, so its ticks have no time.
    #[error(
        "{}: expected a record with its control period \
         (metadata \"coxswain\", \"period_nanos\", up to one hour)",
        path.display()
    )]
    NoPeriod {
        /// The file.
        path: PathBuf,
    },
    /// The page would overwrite a record.
    #[error("{}: expected another file to write to, not one of the records", path.display())]
    OverRecord {
        /// The file.
        path: PathBuf,
    },
    /// The page cannot be written.
    #[error("{} cannot be written: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
}

/// Writes one page about `records`, files or run directories, to `out` atomically.
///
/// # Errors
/// [`ReportError`].
pub fn write(records: &[PathBuf], out: &Path) -> Result<(), ReportError> {
    let records = read(records)?;
    let place = out.canonicalize().ok();
    if records
        .iter()
        .flat_map(|record| &record.files)
        .any(|file| place.is_some() && file.canonicalize().ok() == place)
    {
        return Err(ReportError::OverRecord { path: out.to_owned() });
    }
    let page = page::page(&records);
    atomic_file::write(out, page.as_bytes())
        .map_err(|source| ReportError::Write { path: out.to_owned(), source })
}

/// The page about `records` as HTML.
///
/// # Errors
/// [`ReportError`].
pub fn page(records: &[PathBuf]) -> Result<String, ReportError> {
    Ok(page::page(&read(records)?))
}

fn read(records: &[PathBuf]) -> Result<Vec<Record>, ReportError> {
    Ok(named_apart(records.iter().map(|path| Record::read(path)).collect::<Result<Vec<_>, _>>()?))
}

/// Default path of the report of the record at `path`: beside it.
pub fn beside(path: &Path) -> PathBuf {
    if path.is_dir() { path.join("report.html") } else { path.with_file_name("report.html") }
}

/// The same records, with distinct names.
fn named_apart(mut records: Vec<Record>) -> Vec<Record> {
    if records.len() > 1 {
        for index in 0..records.len() {
            let (before, rest) = records.split_at_mut(index);
            let Some(record) = rest.first_mut() else { continue };
            let plain = record.name.clone();
            let controller = if record.learned() { "learned MPC" } else { "MPC" };
            record.name = format!("{plain} ({controller})");
            let mut number = 2;
            while before.iter().any(|other| other.name == record.name) {
                record.name = format!("{plain} {number} ({controller})");
                number += 1;
            }
        }
    }
    records
}
