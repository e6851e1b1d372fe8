//! `coxswain report`, `coxswain export`: reports and tables from records.

use clap::Args;
use recorder::export::{self, ExportError};
use recorder::report::{self, ReportError};
use std::path::PathBuf;
use terminal::Terminal;

/// The records, and the file of the page.
#[derive(Debug, Clone, Args)]
pub struct ReportOptions {
    /// Records, or run directories; several are drawn in the same figures.
    #[arg(required = true, value_name = "RUN")]
    pub records: Vec<PathBuf>,
    /// The page; by default report.html beside the first record.
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
}

/// The record, and the directory of the tables.
#[derive(Debug, Clone, Args)]
pub struct ExportOptions {
    /// A record, or a run directory.
    #[arg(value_name = "RUN")]
    pub record: PathBuf,
    /// Folder of the tables, new or empty.
    #[arg(long, value_name = "DIR")]
    pub csv: PathBuf,
}

/// Why nothing was created.
#[derive(Debug, thiserror::Error)]
pub enum RecordsError {
    /// The page was not created.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// The tables were not created.
    #[error(transparent)]
    Export(#[from] ExportError),
}

impl RecordsError {
    /// 1 if the system reports a write error, 2 if an option is invalid.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Report(ReportError::Write { .. }) | Self::Export(ExportError::Write { .. }) => 1,
            Self::Report(_) | Self::Export(_) => 2,
        }
    }
}

/// Creates the page, and prints its path.
///
/// # Errors
/// [`RecordsError`].
pub fn report(options: &ReportOptions) -> Result<(), RecordsError> {
    let beside = options.records.first().map(|record| report::beside(record)).unwrap_or_default();
    let out = options.out.clone().unwrap_or(beside);
    report::write(&options.records, &out)?;
    terminal::print(out.display());
    Ok(())
}

/// Writes the tables, and prints each with its number of rows.
///
/// # Errors
/// [`RecordsError`].
pub fn export(options: &ExportOptions) -> Result<(), RecordsError> {
    let exported = export::write(&options.record, &options.csv)?;
    for (topic, rows) in &exported.rows {
        let file = options.csv.join(topic.name()).with_extension("csv");
        terminal::print(format_args!("{}: {rows} rows", file.display()));
    }
    for file in &exported.ended_early {
        Terminal::new()
            .say(format_args!("{} ends early, and was read as far as it goes", file.display()));
    }
    Ok(())
}
