//! A record → one table (CSV) per topic.
//!
//! One row per message, in the order of the record, and one column per number. Arrays become
//! columns `field_0`, `field_1` …, and arrays of arrays `field_0_0` …. A column name has the unit
//! of the record's schema, as `pose_0 [m]`. A cell is empty where a message has fewer numbers than
//! another one, or a number that is not finite. The record is read twice: for the columns, then for
//! the rows.

mod columns;

use crate::reader::{self, SourceError};
use columns::Columns;
use csv::Writer;
use protocol::topic::{TOPIC_COUNT, Topic};
use std::fs::{self, File, Permissions};
use std::io;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

/// Why no tables were written.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The record cannot be read.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The record has no messages.
    #[error("{}: expected a record with at least one message, found none", path.display())]
    NoMessages {
        /// The record.
        path: PathBuf,
    },
    /// A message that no recorder writes.
    #[error("message {number} of topic {:?}: expected a JSON object: {source}", topic.name())]
    NoObject {
        /// Its topic.
        topic: Topic,
        /// Number of the message within its topic, from 1.
        number: u64,
        /// The parse error.
        source: serde_json::Error,
    },
    /// The folder is not empty: tables of two records would be mixed.
    #[error("{}: expected a new or empty folder", folder.display())]
    NotEmpty {
        /// The folder.
        folder: PathBuf,
    },
    /// A table cannot be written.
    #[error("{} cannot be written: {source}", path.display())]
    Write {
        /// The folder or file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
}

/// Result of an export.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Exported {
    /// Each topic with a table, and its number of rows.
    pub rows: Vec<(Topic, u64)>,
    /// Files of the record that end early.
    pub ended_early: Vec<PathBuf>,
}

/// Writes the tables of the record at `path`, a file or a run directory, into `folder`, which must
/// be new or empty. Writes all tables, or none.
///
/// # Errors
/// [`ExportError`].
pub fn write(path: &Path, folder: &Path) -> Result<Exported, ExportError> {
    check_empty(folder)?;
    let files = reader::files(path)?;
    let mut tables: [Table; TOPIC_COUNT] = Default::default();
    let ended_early =
        reader::all_messages(&files, |message| match topic_of(&message.channel.topic) {
            Some(topic) => {
                let schema =
                    message.channel.schema.as_ref().map_or(&[][..], |schema| &schema.data[..]);
                tables
                    .get_mut(topic.index())
                    .map_or(Ok(()), |table| table.look(topic, schema, &message.data))
            }
            None => Ok(()),
        })?;
    if tables.iter().all(|table| table.messages == 0) {
        return Err(ExportError::NoMessages { path: path.to_owned() });
    }
    let failed = |source| ExportError::Write { path: folder.to_owned(), source };
    let parent =
        folder.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    fs::create_dir_all(parent).map_err(failed)?;
    let half = tempfile::Builder::new()
        .prefix(".csv-")
        .permissions(Permissions::from_mode(0o777))
        .tempdir_in(parent)
        .map_err(failed)?;
    for (topic, table) in Topic::ALL.into_iter().zip(&mut tables) {
        table.open(&half.path().join(topic.name()).with_extension("csv"))?;
    }
    reader::all_messages(&files, |message| match topic_of(&message.channel.topic) {
        Some(topic) => {
            tables.get_mut(topic.index()).map_or(Ok(()), |table| table.write(topic, &message.data))
        }
        None => Ok(()),
    })?;
    let mut rows = Vec::new();
    for (topic, table) in Topic::ALL.into_iter().zip(tables) {
        rows.extend((table.messages > 0).then_some((topic, table.written)));
        table.close().map_err(failed)?;
    }
    // Replaces an empty folder in one step.
    fs::rename(half.path(), folder).map_err(failed)?;
    let _ = half.keep();
    Ok(Exported { rows, ended_early })
}

fn topic_of(name: &str) -> Option<Topic> {
    Topic::ALL.into_iter().find(|topic| topic.name() == name)
}

fn check_empty(folder: &Path) -> Result<(), ExportError> {
    match fs::read_dir(folder) {
        Ok(mut entries) => match entries.next() {
            Some(_) => Err(ExportError::NotEmpty { folder: folder.to_owned() }),
            None => Ok(()),
        },
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(source) => Err(ExportError::Write { path: folder.to_owned(), source }),
    }
}

/// The table of one topic.
#[derive(Default)]
struct Table {
    columns: Columns,
    messages: u64,
    writer: Option<Writer<File>>,
    path: PathBuf,
    written: u64,
}

impl Table {
    /// Adds the columns that a message needs.
    fn look(&mut self, topic: Topic, schema: &[u8], json: &[u8]) -> Result<(), ExportError> {
        self.messages += 1;
        let number = self.messages;
        self.columns.look(schema, json).map_err(|source| ExportError::NoObject {
            topic,
            number,
            source,
        })
    }

    /// Creates the file, if there is anything to write.
    fn open(&mut self, path: &Path) -> Result<(), ExportError> {
        path.clone_into(&mut self.path);
        if self.messages > 0 {
            let file = File::create(path).map_err(|source| self.failed(source))?;
            let mut writer = Writer::from_writer(file);
            writer
                .write_record(self.columns.header())
                .map_err(|error| self.failed(error.into()))?;
            self.writer = Some(writer);
        }
        Ok(())
    }

    /// Writes the row of a message. Skips messages added to the record after the first pass.
    fn write(&mut self, topic: Topic, json: &[u8]) -> Result<(), ExportError> {
        let Some(writer) = self.writer.as_mut().filter(|_| self.written < self.messages) else {
            return Ok(());
        };
        self.written += 1;
        let number = self.written;
        let row = self.columns.row(json).map_err(|source| ExportError::NoObject {
            topic,
            number,
            source,
        })?;
        let written = writer.write_record(row);
        written.map_err(|error| self.failed(error.into()))
    }

    fn close(self) -> io::Result<()> {
        self.writer.map_or(Ok(()), |mut writer| writer.flush())
    }

    fn failed(&self, source: io::Error) -> ExportError {
        ExportError::Write { path: self.path.clone(), source }
    }
}
