//! MCAP files → messages in order, and the metadata of the run at their head.
//!
//! A file that was cut off by a kill -9 is read as far as it goes.

use crate::{chunks, segment};
use mcap::io::MessageReader;
use mcap::records::{Metadata, Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{MAGIC, McapError, Message};
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Largest record in a file \[bytes\]: far above every chunk, so that a damaged length does not
/// make this process allocate its memory.
pub const RECORD_BYTES_MAX: usize = 1 << 26;

/// How a file ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// With its end mark.
    Whole,
    /// Earlier: cut off, damaged, or still being written.
    Early,
    /// It is not an MCAP file.
    Foreign,
}

/// Profile and metadata of the run at the head of a file.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Head {
    /// Profile of the file: [`segment::PROFILE`] in a record of ours.
    pub profile: String,
    /// Name of its graph.
    pub graph: String,
    /// Source of the time: real time or lock step.
    pub pace: String,
    /// Control period, if the file has one \[ns\].
    pub period_nanos: Option<u64>,
}

/// Why there is no record to read.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// A folder without a record.
    #[error("{}: expected a record, or the folder of a run with record.mcap", path.display())]
    NoFiles {
        /// The folder.
        path: PathBuf,
    },
    /// A file of another kind.
    #[error("{}: expected a record (MCAP), found another kind of file", path.display())]
    NoRecord {
        /// The file.
        path: PathBuf,
    },
    /// A file cannot be read.
    #[error("{} cannot be read: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
}

/// The files of the record at `path`: a file, or a run directory.
///
/// # Errors
/// [`SourceError::NoFiles`] if it is a folder without a record.
pub fn files(path: &Path) -> Result<Vec<PathBuf>, SourceError> {
    if !path.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let files = segment::paths(path);
    if files.is_empty() { Err(SourceError::NoFiles { path: path.to_owned() }) } else { Ok(files) }
}

/// Passes each message of `files` to `take`, file by file. Returns the files that end early.
///
/// # Errors
/// [`SourceError`], or the error of `take`.
pub fn all_messages<E: From<SourceError>>(
    files: &[PathBuf],
    mut take: impl FnMut(&Message<'_>) -> Result<(), E>,
) -> Result<Vec<PathBuf>, E> {
    let mut ended_early = Vec::new();
    for file in files {
        let mut refused = None;
        let read = messages(file, |message| {
            take(message).map_err(|error| {
                refused = Some(error);
                io::Error::other("refused")
            })
        });
        if let Some(error) = refused {
            return Err(error);
        }
        match read.map_err(|source| SourceError::Read { path: file.clone(), source })? {
            Ending::Whole => {}
            Ending::Early => ended_early.push(file.clone()),
            Ending::Foreign => return Err(SourceError::NoRecord { path: file.clone() }.into()),
        }
    }
    Ok(ended_early)
}

/// Passes each message of the file at `path` to `take`, in the order of the file, as far as it can
/// be read.
///
/// # Errors
/// If it cannot be opened, or `take` fails.
pub fn messages(
    path: &Path,
    mut take: impl FnMut(&Message<'_>) -> io::Result<()>,
) -> io::Result<Ending> {
    let mut file = File::open(path)?;
    match chunks::are_whole(BufReader::new(&file), options()) {
        Ok(false) => {
            tracing::warn!(path = %path.display(), "a record reaches beyond its chunk");
            return Ok(Ending::Early);
        }
        Err(McapError::BadMagic) => return Ok(Ending::Foreign),
        // The messages before other damage can be read.
        Ok(true) | Err(_) => file.rewind()?,
    }
    for message in MessageReader::new_with_options(BufReader::new(&file), options()) {
        match message {
            Ok(message) => take(&message)?,
            Err(McapError::BadMagic) => return Ok(Ending::Foreign),
            Err(error) => {
                tracing::warn!(path = %path.display(), %error, "the segment ends early");
                return Ok(Ending::Early);
            }
        }
    }
    Ok(if ends_whole(&mut file)? { Ending::Whole } else { Ending::Early })
}

/// Metadata of the run in the file at `path`; empty where it has none.
///
/// # Errors
/// If it cannot be read.
pub fn head(path: &Path) -> io::Result<Head> {
    let mut file = BufReader::new(File::open(path)?);
    let mut reader = LinearReader::new_with_options(options());
    let mut profile = String::new();
    while let Some(Ok(event)) = reader.next_event() {
        match event {
            LinearReadEvent::ReadRequest(need) => {
                let read = file.read(reader.insert(need))?;
                reader.notify_read(read);
            }
            LinearReadEvent::Record { opcode: op::HEADER, data } => {
                if let Ok(Record::Header(header)) = mcap::parse_record(op::HEADER, data) {
                    profile = header.profile;
                }
            }
            LinearReadEvent::Record { opcode: op::METADATA, data } => {
                if let Ok(Record::Metadata(metadata)) = mcap::parse_record(op::METADATA, data)
                    && metadata.name == "coxswain"
                {
                    return Ok(Head { profile, ..Head::of(&metadata) });
                }
            }
            // The metadata comes before the first message.
            LinearReadEvent::Record { opcode: op::MESSAGE, .. } => break,
            LinearReadEvent::Record { .. } => {}
        }
    }
    Ok(Head { profile, ..Head::default() })
}

impl Head {
    fn of(metadata: &Metadata) -> Self {
        let word = |key: &str| metadata.metadata.get(key).cloned().unwrap_or_default();
        Self {
            graph: word("graph"),
            pace: word("pace"),
            period_nanos: word("period_nanos").parse().ok().filter(|&nanos| nanos > 0),
            ..Self::default()
        }
    }
}

fn options() -> LinearReaderOptions {
    LinearReaderOptions::default()
        .with_skip_end_magic(true)
        .with_record_length_limit(RECORD_BYTES_MAX)
}

fn ends_whole(file: &mut File) -> io::Result<bool> {
    if file.metadata()?.len() < 2 * MAGIC.len() as u64 {
        return Ok(false);
    }
    file.seek(SeekFrom::End(-8))?;
    let mut end = [0; 8];
    file.read_exact(&mut end)?;
    Ok(end == MAGIC)
}
