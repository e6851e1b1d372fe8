//! An MCAP file → topics and messages. Its chunks may be compressed with LZ4 or Zstandard.

use super::BagError;
use super::files::{BYTES_MAX, Recorded, Take, Topic};
use crate::log::LogError;
use mcap::io::MessageReader;
use mcap::sans_io::LinearReaderOptions;
use mcap::{McapError, Message};
use recorder::chunks;
use recorder::reader::SourceError;
use std::collections::BTreeSet;
use std::fs::File;
use std::io::{self, BufReader};
use std::path::Path;

pub(super) fn topics(file: &Path) -> Result<BTreeSet<Topic>, LogError> {
    let mut seen = BTreeSet::new();
    let mut topics = BTreeSet::new();
    each(file, |message| {
        if seen.insert(message.channel.id) {
            let schema = message.channel.schema.as_ref();
            topics.insert(Topic {
                name: message.channel.topic.clone(),
                kind: schema.map_or_else(String::new, |schema| schema.name.clone()),
                encoding: message.channel.message_encoding.clone(),
            });
        }
        Ok(())
    })?;
    Ok(topics)
}

pub(super) fn messages(
    file: &Path,
    wanted: &[&str],
    take: &mut Take<'_>,
) -> Result<bool, LogError> {
    each(file, |message| {
        let topic = message.channel.topic.as_str();
        if !wanted.contains(&topic) {
            return Ok(());
        }
        let nanos = i64::try_from(message.log_time).unwrap_or(i64::MAX);
        take(&Recorded { topic, nanos, bytes: &message.data })
    })
}

/// Passes each message to `take`, as far as the file can be read. Returns whether it ends early.
fn each(
    file: &Path,
    mut take: impl FnMut(&Message<'_>) -> Result<(), LogError>,
) -> Result<bool, LogError> {
    check_chunks(file)?;
    for message in MessageReader::new_with_options(open(file)?, options()) {
        match message {
            Ok(message) => take(&message)?,
            Err(source @ McapError::UnsupportedCompression(_)) => return Err(failed(file, source)),
            Err(_) => return Ok(true),
        }
    }
    Ok(false)
}

/// Fails if a record of an uncompressed chunk reaches beyond it.
fn check_chunks(file: &Path) -> Result<(), LogError> {
    match chunks::are_whole(open(file)?, options()) {
        Ok(true) => Ok(()),
        Ok(false) => Err(failed(file, McapError::UnexpectedEoc)),
        Err(McapError::Io(source)) => Err(unreadable(file, source)),
        Err(source) => Err(failed(file, source)),
    }
}

fn options() -> LinearReaderOptions {
    LinearReaderOptions::default().with_record_length_limit(BYTES_MAX)
}

fn open(file: &Path) -> Result<BufReader<File>, LogError> {
    File::open(file).map(BufReader::new).map_err(|source| unreadable(file, source))
}

fn unreadable(file: &Path, source: io::Error) -> LogError {
    SourceError::Read { path: file.to_owned(), source }.into()
}

fn failed(file: &Path, source: McapError) -> LogError {
    BagError::Mcap { path: file.to_owned(), source }.into()
}
